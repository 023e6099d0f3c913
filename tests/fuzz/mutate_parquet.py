"""Parquet files of all types, packings and metadata, sound ones and absurd ones, and damaged bytes."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from functools import cache
from random import Random

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli.core.formats import ReadOptions
from tests.fuzz.blind import blind
from tests.fuzz.mutant import Mutant, Truth

SUFFIX = ".parquet"
ROWS = 480
RATE = 50.0
START_US = 1_709_510_400_000_000
NAMES = (
    *("x", "acc_x", "accel", "time", "timestamp", "X [m/s^2]", "gyro_x", "temperature", "__index_level_0__"),
    *("", "a.b", "a/b", "\x1b[31m", "\u00e9", "=1", "x_mg", "list", "validity"),
)
KEYS = (
    "unit",
    "units",
    "lsb_per_g",
    "sample_rate",
    "fs",
    "serial",
    "timezone",
    "range_g",
    "pandas",
    "accelcal",
)
TEXTS = (
    "g",
    "mg",
    "m/s2",
    "counts",
    "256",
    "nan",
    "-1",
    "1e400",
    "x" * 9000,
    "\ud800",
    "[[[[",
    "UTC",
    '{"a": 1}',
)
OPTIONS = (
    *(ReadOptions() for _ in range(6)),
    *(ReadOptions(rate_hz=50.0), ReadOptions(unit="counts", lsb_per_g=256.0), ReadOptions(sensor="imu")),
    *(ReadOptions(time_column="none"), ReadOptions(columns=("x", "y", "z"))),
)


@cache
def counts() -> np.ndarray:
    return np.random.RandomState(11).randint(-120, 120, (ROWS, 3))


def stamps(random: Random) -> pa.Array:
    us = START_US + np.arange(ROWS) * 20_000
    at, form = random.randrange(ROWS), random.randrange(10)
    if form == 0:
        us[at:] += random.choice([3_600_000_000, -1_000_000, 40_000])
    if form == 1:
        us = us // 1_000_000 * 1_000_000
    if form == 2:
        us = us[::-1].copy()
    if form == 3:
        return pa.array(us / random.choice([1e6, 1e3]))
    empty = np.zeros(ROWS, bool)
    empty[at : at + 3] = form == 4
    times = pa.array(us, mask=empty).cast(pa.timestamp("us", random.choice([None, "UTC", "Europe/Berlin"])))
    return times if random.random() < 0.7 else times.cast(pa.timestamp("ns", times.type.tz))


def sound(random: Random) -> tuple[pa.Table, Truth]:
    """A table in which all is well but for its times and some empty cells, and its rows."""
    kind, unit = random.choice(["i2", "i4", "i8", "f4", "f8"]), "counts"
    if "f" in kind:
        unit = random.choice(["counts", "g", "mg"])
    factor = {"counts": 1.0, "g": 1 / 256, "mg": 1000 / 256}[unit]
    data = (counts() * factor).astype(kind)
    empty = np.zeros((ROWS, 3), bool)
    if random.random() < 0.3:
        at = random.randrange(ROWS)
        empty[at : at + random.choice([1, 50]), random.randrange(3)] = True
    times = stamps(random)
    lost = empty.any(axis=1) | np.asarray(times.is_null())
    about = {"unit": unit, "sample_rate": "50", **({"lsb_per_g": "256"} if unit == "counts" else {})}
    made = pa.table({"time": times, **placed(random, data, empty)})
    rows = counts() / 256
    return made.replace_schema_metadata(about), Truth(rows[~lost], rows[~lost], int(lost.any()))


def placed(random: Random, data: np.ndarray, empty: np.ndarray) -> dict[str, pa.Array]:
    """The samples as three columns, as a structure, or as lists."""
    axes = [pa.array(data[:, axis], mask=empty[:, axis]) for axis in range(3)]
    form = random.random()
    if form < 0.5:
        return dict(zip("xyz", axes, strict=True))
    if form < 0.7:
        return {"imu": pa.StructArray.from_arrays(axes, list("xyz"))}
    flat = pa.array(data.ravel(), mask=empty.ravel())
    if form < 0.85:
        return {"accel": pa.FixedSizeListArray.from_arrays(flat, 3)}
    return {"accel": pa.ListArray.from_arrays(pa.array(np.arange(ROWS + 1, dtype="i4") * 3), flat)}


def absurd(random: Random) -> pa.Table:
    made, _ = sound(random)
    for _ in range(random.choice([1, 1, 2, 4])):
        form, name = random.randrange(6), random.choice(NAMES)
        if form == 0:
            made = made.append_column(name, odd(random))
        elif form == 1 and made.num_columns > 1:
            made = made.remove_column(random.randrange(made.num_columns))
        elif form == 2:
            at = random.randrange(made.num_columns)
            made = made.set_column(at, made.schema.names[at], odd(random))
        elif form == 3:
            made = made.slice(0, random.choice([0, 1, 2, 5, 100]))
            break
        elif form == 4:
            made = made.rename_columns([random.choice([one, name]) for one in made.schema.names])
        else:
            key, text = random.choice(KEYS), random.choice(TEXTS).encode("utf-8", "surrogatepass")
            made = made.replace_schema_metadata({**(made.schema.metadata or {}), key.encode(): text})
    return made


def odd(random: Random) -> pa.Array:
    numbers = np.arange(ROWS)
    builders: tuple[Callable[[], pa.Array], ...] = (
        lambda: pa.array([str(number) for number in numbers]),
        lambda: pa.array(numbers > 5),
        lambda: pa.array([random.choice([[], [1.0, 2.0, 3.0], [1.0], None]) for _ in numbers]),
        lambda: pa.array(np.full(ROWS, random.choice([np.nan, np.inf, 1e300, -1e30, 0.0, 1.7e18]))),
        lambda: pa.array(numbers.astype(random.choice(["u1", "i1", "u8", "f2"]))),
        lambda: pa.array([None] * ROWS, random.choice([pa.null(), pa.float32(), pa.timestamp("s")])),
        lambda: pa.array(numbers).cast(random.choice([pa.duration("ns"), pa.timestamp("s"), pa.date64()])),
        lambda: pa.array((numbers % 7).astype(float)).dictionary_encode(),
        lambda: pa.array([{"x": float(n), "y": None, "z": {"x": 1}} for n in numbers]),
        lambda: pa.array([b"\xff"] * ROWS),
        lambda: pa.array(numbers).cast(pa.decimal128(25, 3)),
        lambda: pa.array(np.full(ROWS, 2**62)),
    )
    return random.choice(builders)()


def bytes_of(made: pa.Table, random: Random) -> bytes:
    """The file; what the library refuses is empty."""
    buffer = io.BytesIO()
    refused = contextlib.suppress(pa.ArrowException, ValueError, TypeError, OSError)
    with refused:
        pq.write_table(
            made,
            buffer,
            row_group_size=random.choice([1 + ROWS // 100, 7, 100, ROWS, ROWS]),
            compression=random.choice(["none", "snappy", "zstd", "gzip"]),
            use_dictionary=random.random() < 0.5,
            data_page_size=random.choice([64, 1 << 20]),
            data_page_version=random.choice(["1.0", "2.0"]),
            write_page_checksum=random.random() < 0.3,
            version=random.choice(["1.0", "2.6"]),
        )
        return buffer.getvalue()
    return b""


def footer(data: bytes, random: Random) -> bytes:
    length = int.from_bytes(data[-8:-4], "little")
    new, start = bytearray(data), len(data) - 8 - length
    for _ in range(random.choice([1, 1, 3])):
        at = random.randrange(start, len(data) - 8)
        new[at] = random.choice([0, 0xFF, new[at] ^ 1 << random.randrange(8), random.randrange(256)])
    return bytes(new)


def mutant(random: Random) -> Mutant:
    choice = random.random()
    made, truth = sound(random)
    if choice < 0.35:
        return Mutant(bytes_of(made, random), "sound", truth)
    if choice < 0.6:
        return Mutant(bytes_of(absurd(random), random) or b"PAR1", "absurd", None, random.choice(OPTIONS))
    how = random.choice([footer, footer, blind])
    return Mutant(how(bytes_of(made, random), random), how.__name__, None, random.choice(OPTIONS))
