"""Damaged Unisens folders: absurd or damaged descriptions, and files of accelerations cut or changed."""

from __future__ import annotations

from functools import cache
from random import Random

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats import make_unisens
from tests.fuzz.blind import blind
from tests.fuzz.mutant import Mutant, Truth

SUFFIX, BESIDE = ".xml", ".acc.bin"
NAME = "mutant.acc.bin"
HARD = {
    "unit": ("g", "mg", "m/s²", "", "furlong", "&#27;[31m", None),
    "sampleRate": (64, 0, -1, "nan", "inf", 1e9, "", None, 12.5, 0.001),
    "lsbValue": (0.00048828125, 0, -1, "nan", 1e300, 1e-300, None, "1,5"),
    "baseline": (0, 2048, -(10**12), 1e300, "x", None),
    "adcResolution": (16, 0, -5, 1e9, 1e300, "x", None),
}
CODES = {"int16": "<i2", "int32": "<i4", "uint32": "<u4", "int8": "i1", "float": "<f4", "double": "<f8"}
STARTS = ("0001-01-01T00:00:00", "9999-12-31T23:59:59", "9999-12-31T23:59:59-14:00", "2008-07-04", "", "now")


@cache
def values() -> np.ndarray:
    return np.random.RandomState(11).randint(-9000, 9000, (800, 3))


def usual(data_type: str) -> str:
    return make_unisens.description(make_unisens.signal(NAME, "acc", data_type=data_type))


def hard(random: Random) -> str:
    said = {key: random.choice(known) for key, known in HARD.items() if random.random() < 0.25}
    channels = random.choice(
        [("accX", "accY", "accZ")] * 4 + [("a", "b"), (), ("x", "y", "z", "x"), ("t",) * 40]
    )
    acc = make_unisens.signal(
        random.choice([NAME] * 9 + ["", "gone.bin", "/etc/passwd", "\ufffd", "a&amp;b"]),
        random.choice(["acc"] * 9 + ["ACC", "ecg"]),
        channels=channels,
        data_type=random.choice([*CODES, "int16", "int16", "int64", ""]),
        order=random.choice(["LITTLE", "LITTLE", "BIG", "x"]),
        **said,
    )
    rate = random.choice([1, 64, 0.01, 1e6, 0])
    warm = make_unisens.signal(NAME, "temp", channels=("t",), sampleRate=rate, unit="C", lsbValue=0.01)
    turn = make_unisens.signal(NAME, "gyro", unit="dps", sampleRate=random.choice([64, 32]), lsbValue=0.07)
    signals = [acc, *([warm] if random.random() < 0.3 else []), *([turn] if random.random() < 0.3 else [])]
    random.shuffle(signals)
    start = random.choice(STARTS) if random.random() < 0.3 else make_unisens.START
    return make_unisens.description(*signals, start=start)


def mutant(random: Random) -> Mutant:
    kind = random.choice(["data", "description", "attributes", "attributes"])
    data_type = random.choice(list(CODES))
    numbers = values() if data_type != "int8" else values() % 100
    data = numbers.astype(CODES[data_type]).tobytes()
    if kind == "data":
        text = usual(data_type).encode()
        data = blind(data, random)
        return Mutant(text, f"{kind} {data_type}", truth(data, data_type), layout=data)
    if kind == "description":
        return Mutant(blind(usual(data_type).encode(), random), kind, layout=data)
    options = random.choice([ReadOptions()] * 3 + [ReadOptions(rate_hz=64.0), ReadOptions(lsb_per_g=2048.0)])
    return Mutant(hard(random).encode(), kind, options=options, layout=data)


def truth(data: bytes, data_type: str) -> Truth | None:
    """Rows of whole samples; of floating-point numbers those that are at most 100 g."""
    kind = np.dtype(CODES[data_type])
    if data.startswith(b"\x1f\x8b"):
        return None
    numbers = np.frombuffer(data, kind, len(data) // (3 * kind.itemsize) * 3).reshape(-1, 3)
    with np.errstate(all="ignore"):
        rows = numbers.astype(float)
        g = rows * 0.00048828125
        fine = np.abs(g) <= 100 if kind.kind == "f" else (rows >= -(1 << 31)) & (rows < 1 << 31)
    usable = np.asarray(fine).all(axis=1)
    found = g[usable]
    return Truth(found, found, int(not usable.all()))
