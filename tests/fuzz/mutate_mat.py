"""MATLAB files of level 5 of all layouts and types, sound ones and absurd ones, and damaged bytes."""

from __future__ import annotations

import struct
from random import Random
from typing import Any

import numpy as np

from tests.formats.make_mat import CELL, OPAQUE, array, element, file_of, matrix
from tests.fuzz.blind import blind
from tests.fuzz.mutant import Mutant, Truth
from tests.fuzz.mutate_npz import NAMES, OPTIONS, ROWS, arrays, counts

SUFFIX = ".mat"
VALUES: tuple[Any, ...] = (
    *(50.0, "g", "mg", "counts", 256.0, -1.0, np.nan, "", "\u00e9" * 3000, {"a": {"b": 1.0}}, {"x": "y"}),
    *(np.zeros((3, 3)), np.arange(ROWS, dtype="f8"), np.full((ROWS, 3), 2.0**62), np.zeros((ROWS, 3), "u8")),
)


def sound(random: Random, order: str) -> tuple[list[bytes], Truth]:
    found, truth = arrays(random)
    found = {name: plain(value) for name, value in found.items()}
    if random.random() < 0.3:
        found = {"rec": found}
    return [matrix(name, value, order) for name, value in found.items()], truth


def plain(value: Any) -> Any:
    """As MATLAB has it: times in milliseconds, numbers of the machine's order."""
    if not isinstance(value, np.ndarray):
        return value
    if value.dtype.kind == "M":
        return value.astype("M8[us]").astype("i8") / 1e6
    return value.astype(value.dtype.newbyteorder("="))


def absurd(random: Random, order: str) -> list[bytes]:
    parts, _ = sound(random, order)
    for _ in range(random.choice([1, 1, 3])):
        name, form = random.choice(NAMES).encode("ascii", "replace").decode(), random.randrange(6)
        if form < 2:
            made = matrix(name, random.choice(VALUES), order)
        elif form == 2:
            made = array(random.choice([CELL, OPAQUE, 5, 200]), (1, 1), name, bytes(64), order)
            if random.random() < 0.5:
                made = opaque(name, order)
        elif form == 3:
            shape = random.choice([(0, 3), (-1, 3), (1 << 30, 3), (ROWS,), (2, 2, 2), (ROWS, 3, 1), ()])
            made = array(6, shape, name, element(9, (counts() / 256).tobytes("F"), order), order)
        elif form == 4:
            made = array(6, (ROWS, 3), name, element(9, (counts() / 256).tobytes("F"), order), order, flags=8)
        else:
            made = matrix(name, counts() / 256, order)[: random.choice([8, 20, 60, 1000])]
        parts.insert(random.randrange(len(parts) + 1), made)
    return parts


def opaque(name: str, order: str) -> bytes:
    head = element(6, struct.pack(f"{order}II", OPAQUE, 0), order)
    head += element(1, name.encode(), order) + element(1, b"MCOS", order) + element(1, b"timetable", order)
    return struct.pack(f"{order}II", 14, len(head)) + head


def tags(data: bytes, random: Random) -> bytes:
    new = bytearray(data)
    for _ in range(random.choice([1, 1, 3])):
        at = random.randrange(120, min(len(new) - 4, random.choice([200, 400, len(new)]))) & ~3
        words = [0, 1, 5, 14, 15, 0xFFFFFFFF, 1 << 31, len(new), random.getrandbits(32)]
        struct.pack_into("<I", new, at, random.choice(words))
    return bytes(new)


def mutant(random: Random) -> Mutant:
    choice, order, packed = random.random(), random.choice("<<>"), random.random() < 0.5
    parts, truth = sound(random, order)
    if choice < 0.4:
        return Mutant(file_of(parts, order, packed), "sound", truth)
    if choice < 0.65:
        return Mutant(file_of(absurd(random, order), order, packed), "absurd", None, random.choice(OPTIONS))
    how = random.choice([tags, blind])
    return Mutant(how(file_of(parts, order, packed), random), how.__name__, None, random.choice(OPTIONS))
