"""HDF5 files of all shapes, types, filters and attributes, sound ones and absurd ones, and damaged bytes."""

from __future__ import annotations

import contextlib
import io
from functools import cache
from random import Random
from typing import Any

import h5py
import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.fuzz.blind import blind, replace_number
from tests.fuzz.mutant import Mutant, Truth

SUFFIX = ".h5"
ROWS = 480
RATE = 50.0
START_S = 1_709_510_400.0
NAMES = (
    *(
        "accel",
        "acc",
        "Acceleration",
        "acc_x",
        "raw",
        "xyz",
        "data",
        "x",
        "time",
        "timestamp",
        "timestamp_ms",
    ),
    *("temperature", "temp_c", "gyro", "gyr_x", "mag", "a b", "\u00e9", "\x1b[31m", "=1", "acc2"),
)
KEYS = (
    *("sample_rate", "rate", "fs", "sampling_rate_hz", "lsb_per_g", "units", "unit", "range_g", "start_time"),
    *("start", "serial", "model", "timezone", "firmware"),
)
VALUES: tuple[Any, ...] = (
    *(25.0, 50, "50 Hz", "50", np.float16(50), 256.0, "256", "g", "mg", "m/s^2", "counts", "", b"\xff", "x"),
    *("2024-03-04T00:00:00", "2024-03-04", np.nan, np.inf, -1, 0, 1e300, True, np.array([50.0]), 2**40),
    *(np.array([[50]]), np.array(["g"], "S2"), h5py.Empty("f4"), "\x1b[31m\x07", "a\nb", "1e400", "UTC"),
    *("Europe/Berlin", "+01:00", "9999-12-31T23:59:59+00:00", "0001-01-01T00:00:00+05:00", 1.7e18),
    *(np.bytes_(b"M\xfcller"), 1_709_510_400, 1_709_510_400_000, "9" * 5000, np.zeros(5000), "\ud800"),
)
SOUND_TYPES = ("<i2", "<i2", "<i2", ">i2", "<i4", "<f4", "<f8", ">f8", "<i8")
ODD_TYPES = ("<f2", "u2", "i1", "g", "?", "S4", "<u8", "c16")
OPTIONS = (
    *(ReadOptions() for _ in range(6)),
    *(ReadOptions(rate_hz=50.0), ReadOptions(unit="counts", lsb_per_g=256.0), ReadOptions(sensor="sensor1")),
    *(ReadOptions(time_column="none"), ReadOptions(columns=("accel", "accel", "accel"))),
)


@cache
def counts() -> np.ndarray:
    return np.random.RandomState(11).randint(-120, 120, (ROWS, 3))


def packing(random: Random, rows: int, width: int) -> dict[str, Any]:
    length = random.choice([0, 0, 7, 64, 100, 300, ROWS])
    if not length or not rows:
        return {}
    how: dict[str, Any] = {"chunks": (min(length, rows), *([width] if width else []))}
    if random.random() < 0.6:
        how |= {"compression": random.choice(["gzip", "lzf"]), "shuffle": random.random() < 0.5}
    if random.random() < 0.15:
        how["fletcher32"] = True
    return how


def times(random: Random, rows: int) -> tuple[np.ndarray, str, bool]:
    """Times of rows, the name of their dataset, and whether they are sound."""
    unit, factor = random.choice([("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
    values = (START_S + np.arange(rows) / RATE) * factor
    odd = random.choice([np.nan, np.inf, -1, 0, 1e300, 4.2e9 * factor, 2.0**62])
    at, form = random.randrange(max(1, rows)), random.randrange(14)
    step = random.choice([1, -1, 3600, -(10.0**8), 1e9, 1e12]) * factor
    if form == 0:
        values[at : at + 1] = odd
    if form == 1:
        values = values[::-1].copy()
    if form == 2:
        values = values[np.random.RandomState(at).permutation(rows)]
    if form == 3:
        values[at:] += step
    if form == 4:
        values = np.floor(values)
    if form == 5:
        values = values[: random.choice([max(0, rows - 1), 1])]
    if form == 6:
        values = np.zeros(rows)
    if form == 7:
        values = np.arange(rows) / RATE
    if form == 8:
        values[at : at + 60] += step
    whole = np.isfinite(values).all() and (np.abs(values) < 2**62).all() and random.random() < 0.4
    return values.astype("i8") if whole else values, f"timestamp_{unit}", form > 8


def sound(file: Any, random: Random) -> Truth | None:
    """A file in which all is well but for its times, and its rows."""
    values, kind = counts().copy(), random.choice(SOUND_TYPES)
    unit = random.choice(["counts", "counts", "g", "mg"]) if "f" in kind else "counts"
    factor = {"counts": 1.0, "g": 1 / 256, "mg": 1000 / 256}[unit]
    data = (values * factor).astype(kind)
    missing = np.zeros(ROWS, bool)
    if "f" in kind and random.random() < 0.3:
        at = random.randrange(ROWS)
        data[at : at + random.choice([1, 50])] = np.nan
        missing = ~np.isfinite(data).all(axis=1)
    about = {"sample_rate": RATE, "units": unit, "start_time": "2024-03-04T00:00:00"}
    about |= {"lsb_per_g": 256.0} if unit == "counts" else {}
    group = file.create_group("sensor1") if random.random() < 0.2 else file
    place(group, data, random, about)
    add_times(group, random, ROWS)
    add_channels(group, random, ROWS)
    rows = values[~missing] / 256
    return Truth(rows, rows, int(missing.any()))


def place(group: Any, data: np.ndarray, random: Random, about: dict[str, Any]) -> None:
    form = random.random()
    if form < 0.6:
        made = [group.create_dataset("accel", data=data, **packing(random, len(data), 3))]
    elif form < 0.7:
        made = [group.create_dataset("accel", data=data.T.copy())]
    else:
        how = packing(random, len(data), 0)
        made = [group.create_dataset(f"acc_{axis}", data=data[:, k], **how) for k, axis in enumerate("xyz")]
    for one in made:
        one.attrs.update(about)


def add_times(group: Any, random: Random, rows: int) -> bool:
    """Perhaps times; whether the rows are as before."""
    if random.random() < 0.5:
        return True
    values, name, good = times(random, rows)
    how = (
        random.choice([{}, {"chunks": (min(100, len(values)),), "compression": "gzip"}])
        if len(values)
        else {}
    )
    made = group.create_dataset(name, data=values, **how)
    if random.random() < 0.2:
        made.attrs["units"] = random.choice(["s", "ms", "seconds since 1970-01-01", "x"])
        return False
    return good


def add_channels(group: Any, random: Random, rows: int) -> None:
    """Perhaps a temperature and a gyroscope, with values that are none."""
    if random.random() < 0.3:
        warm = np.full(rows, 25, random.choice(["f4", "f8", "i2"]))
        if warm.dtype.kind == "f":
            warm[random.randrange(rows)] = random.choice([np.nan, np.inf, 1e30, -300, 85])
        made = group.create_dataset("temperature", data=warm)
        made.attrs["units"] = random.choice(["C", "K", "F", "mC", "x"])
    if random.random() < 0.2:
        made = group.create_dataset("gyro", data=np.zeros((rows - random.randrange(2), 3), "f4"))
        made.attrs["units"] = random.choice(["deg/s", "rad/s", "x"])
        if random.random() < 0.3:
            made[5] = [np.nan, np.inf, 1e38]


def absurd(file: Any, random: Random) -> None:
    data = counts().astype(random.choice(SOUND_TYPES + ODD_TYPES))
    group = (
        file.create_group(random.choice(["sensor1", "Sensors", "a", "gyro"]))
        if random.random() < 0.3
        else file
    )
    name = random.choice([*NAMES, "accel", "accel"])
    if random.random() < 0.3:
        rows = random.choice([0, 1, 5, 10**6, 10**9, 10**13])
        chunk = (random.choice([1, 10, 1000, 10**6]), 3)
        made = group.create_dataset(name, (rows, 3), data.dtype, maxshape=(None, 3), chunks=chunk)
        if rows >= 5:
            made[: min(rows, ROWS)] = data[: min(rows, ROWS)]
    else:
        shape = random.choice([(ROWS, 3), (3, ROWS), (ROWS * 3,), (ROWS, 3, 1), (1, ROWS, 3), (ROWS // 2, 6)])
        made = group.create_dataset(name, data=data.reshape(shape), **packing(random, 0, 0))
    made.attrs.update(sample_rate=RATE, units="counts", lsb_per_g=256.0, start_time="2024-03-04T00:00:00")
    for _ in range(random.choice([0, 1, 2, 4])):
        random.choice([file, group, made]).attrs[random.choice(KEYS)] = random.choice(VALUES)
    add_times(group, random, ROWS)
    add_channels(group, random, ROWS)
    links = [h5py.SoftLink("/accel"), h5py.SoftLink("/link"), h5py.ExternalLink("/etc/passwd", "/x")]
    if random.random() < 0.15:
        file["link"] = random.choice(links)
    if random.random() < 0.05:
        file.create_group("loop")["again"] = file["/"]
    if random.random() < 0.1:
        file.create_dataset("mixed", data=np.zeros(5, [("x", "i2"), ("r", h5py.ref_dtype)]))


def file_of(random: Random, build: Any) -> tuple[bytes, Any]:
    """The bytes of a file, and what building it gave; what the library refuses is left out."""
    buffer, made = io.BytesIO(), None
    refused = contextlib.suppress(ValueError, TypeError, OSError, RuntimeError, KeyError, OverflowError)
    with h5py.File(buffer, "w", libver=random.choice([None, "latest", "earliest"])) as file, refused:
        made = build(file, random)
    return buffer.getvalue(), made


def damaged(data: bytes, random: Random) -> bytes:
    new = bytearray(data)
    for _ in range(random.choice([1, 1, 3, 10])):
        at = random.randrange(min(len(new) - 8, random.choice([100, 2000, 6000, len(new)])))
        words = [0, 1, (1 << 64) - 1, 1 << 63, len(new), random.getrandbits(64)]
        replace_number(new, at, words, random)
    return bytes(new)


def mutant(random: Random) -> Mutant:
    choice = random.random()
    if choice < 0.35:
        data, truth = file_of(random, sound)
        return Mutant(data, "sound", truth)
    data, _ = file_of(random, absurd if choice < 0.7 else sound)
    if choice < 0.7:
        return Mutant(data, "absurd", None, random.choice(OPTIONS))
    how = random.choice([damaged, damaged, blind])
    return Mutant(how(data, random), how.__name__, None, random.choice(OPTIONS))
