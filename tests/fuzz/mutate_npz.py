"""NumPy archives of all layouts and types, sound ones and absurd ones, and damaged heads and bytes."""

from __future__ import annotations

from functools import cache
from random import Random
from typing import Any

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats.make_npz import archive, member
from tests.fuzz.blind import blind
from tests.fuzz.mutant import Mutant, Truth

SUFFIX = ".npz"
ROWS = 480
RATE = 50.0
START_S = 1_709_510_400.0
NAMES = (
    "accel",
    "acc_x",
    "time",
    "timestamp_ms",
    "fs",
    "unit",
    "gyro",
    "temperature",
    "a/b",
    "\x1b[31m",
    "",
    "xyz",
)
OPTIONS = (
    *(ReadOptions() for _ in range(6)),
    *(ReadOptions(rate_hz=50.0), ReadOptions(unit="counts", lsb_per_g=256.0), ReadOptions(sensor="imu")),
    *(ReadOptions(time_column="none"), ReadOptions(columns=("accel", "accel", "accel"))),
)
VALUES: tuple[Any, ...] = (
    *(50.0, "g", "mg", "counts", 256, -1, 0, np.nan, np.inf, b"\xff", "\x1b[31m", "x" * 20_000, True, 1j),
    *(np.zeros(0), np.zeros((2, 2, 2)), np.arange(ROWS), np.zeros((ROWS, 3), "f2"), np.zeros((3, 3), ">i8")),
    *(np.full(ROWS, np.nan), np.full((ROWS, 3), 2.0**62), np.arange(ROWS).astype("M8[s]")),
    np.datetime64("NaT"), np.zeros(ROWS, [("x", "f4"), ("y", "f4")]), np.array(["a"] * ROWS),
    np.zeros((ROWS, 3), "m8[25us]"),
)  # fmt: skip
HEADS = (
    "{{'descr': '<f8', 'fortran_order': False, 'shape': ({0}, 3), }}",
    "{{'descr': '|O', 'fortran_order': False, 'shape': ({0}, 3), }}",
    "{{'descr': '<f8', 'fortran_order': True, 'shape': (3, {0}), }}",
    "{{'descr': '<V99999999', 'fortran_order': False, 'shape': (), }}",
    "{{'descr': '<U{0}', 'fortran_order': False, 'shape': (), }}",
    "[[[[[[[[[[[[[[[[{0}",
)


@cache
def counts() -> np.ndarray:
    return np.random.RandomState(11).randint(-120, 120, (ROWS, 3))


def times(random: Random) -> np.ndarray:
    seconds = START_S + np.arange(ROWS) / RATE
    at, form = random.randrange(ROWS), random.randrange(8)
    if form == 0:
        seconds[at:] += random.choice([3600.0, -1.0, 1e9])
    if form == 1:
        seconds = np.floor(seconds)
    if form == 2:
        seconds = seconds[::-1]
    return (seconds * 1e6).astype("M8[us]") if random.random() < 0.2 else seconds


def arrays(random: Random) -> tuple[dict[str, Any], Truth]:
    kind, unit = random.choice(["<i2", "<i4", "<i8", "<f4", "<f8", ">f8"]), "counts"
    if "f" in kind:
        unit = random.choice(["counts", "g", "mg"])
    data = (counts() * {"counts": 1.0, "g": 1 / 256, "mg": 1000 / 256}[unit]).astype(kind)
    missing = np.zeros(ROWS, bool)
    if "f" in kind and random.random() < 0.3:
        at = random.randrange(ROWS)
        data[at : at + random.choice([1, 50])] = np.nan
        missing = ~np.isfinite(data).all(axis=1)
    found: dict[str, Any] = {"fs": RATE, "unit": unit, **({"lsb_per_g": 256.0} if unit == "counts" else {})}
    form = random.random()
    if form < 0.3:
        found["accel"] = data
    elif form < 0.5:
        found["accel"] = np.asfortranarray(data)
    elif form < 0.7:
        found["accel"] = data.T.copy()
    else:
        found |= {f"acc_{name}": data[:, axis].copy() for axis, name in enumerate("xyz")}
    if random.random() < 0.6:
        found["time"] = times(random)
    rows = counts()[~missing] / 256
    return found, Truth(rows, rows, int(missing.any()))


def absurd(random: Random) -> bytes:
    found, _ = arrays(random)
    for _ in range(random.choice([1, 1, 3])):
        found[random.choice(NAMES)] = random.choice(VALUES)
    members = {name: member(value) for name, value in found.items()}
    if random.random() < 0.4:
        length = random.choice([0, 1, ROWS, ROWS + 1, 10**9, 10**15, -5])
        name = random.choice([*members])
        members[name] = member(counts() / 256, head=random.choice(HEADS).format(length))
    return archive(members, random.random() < 0.5)


def mutant(random: Random) -> Mutant:
    choice = random.random()
    found, truth = arrays(random)
    data = archive({name: member(value) for name, value in found.items()}, random.random() < 0.5)
    if choice < 0.4:
        return Mutant(data, "sound", truth)
    if choice < 0.7:
        return Mutant(absurd(random), "absurd", None, random.choice(OPTIONS))
    return Mutant(blind(data, random), "blind", None, random.choice(OPTIONS))
