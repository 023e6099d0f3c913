"""A damaged file, what it truly holds, and how the rows that a reader gives are held against that."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import TypeVar

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G

GRID = 4096.0
"""Rows are compared in units of 1/4096 g."""

Item = TypeVar("Item")
Records = list[bytes]
Change = Callable[[Records, Random], None]
SetField = Callable[[bytes, str, int, int], bytes]
"""A record with one field, of a form as `struct` has it, set at a byte; its checksum is right again."""


@dataclass(frozen=True)
class Truth:
    """Rows of a damaged file, by a decoder that has nothing of the package.

    Attributes:
        sure: (n, 3) in g; where a reader leaves one out, it says so.
        possible: (m, 3) in g, in the order of the file: all that a reader may give.
        damaged: how many places of the file are neither sound nor unused; a reader says so.
    """

    sure: np.ndarray
    possible: np.ndarray
    damaged: int = 0


@dataclass(frozen=True)
class Mutant:
    """A damaged file.

    Attributes:
        what: the changes, for people.
        truth: None where nobody can tell what the file holds.
        layout: the file beside it, such as one that says how to read it.
        sound_lines: lines below the first in which nothing is wrong; an error names none of them.
    """

    data: bytes
    what: str
    truth: Truth | None = None
    options: ReadOptions = field(default_factory=ReadOptions)
    layout: bytes | None = None
    sound_lines: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Rows:
    """What a reader gave.

    Attributes:
        values: (n, 3) in g, of rows that are not filled in.
        told: whether it told of anything wrong.
        number: of all rows.
    """

    values: np.ndarray
    told: bool
    number: int = 0


def keys(values: np.ndarray) -> list[bytes]:
    """Something to compare for each row: decimal numbers are read on a grid of FLOAT_LSB_PER_G."""
    read = np.rint(np.asarray(values, float) * FLOAT_LSB_PER_G) / FLOAT_LSB_PER_G
    grid = np.rint(read * GRID).astype(np.int64)
    joined: list[bytes] = np.ascontiguousarray(grid).view("V24").ravel().tolist()
    return joined


def verdict(rows: Rows, truth: Truth) -> tuple[str | None, int]:
    """What is wrong with the rows, and how many were lost and told."""
    if truth.damaged and not rows.told:
        return f"SILENTLY LOST: {truth.damaged} damaged places, and no problem told", 0
    given, possible, sure = keys(rows.values), keys(truth.possible), keys(truth.sure)
    if given == sure:
        return None, 0
    invented = Counter(given) - Counter(possible)
    if invented:
        return f"INVENTED: {invented.total()} of {len(given)} rows are not in the file", 0
    lost = (Counter(sure) - Counter(given)).total()
    if lost and not rows.told:
        return f"SILENTLY LOST: {lost} of {len(sure)} rows, and no problem told", 0
    if not is_part(given, possible):
        return "ORDER: rows come in another order than in the file", 0
    return None, lost


def is_part(given: Sequence[bytes], whole: Sequence[bytes]) -> bool:
    rest = iter(whole)
    return all(item in rest for item in given)


def stretch(records: Records, random: Random, sizes: Sequence[int] = (1, 1, 2, 4)) -> slice:
    at = random.randrange(len(records))
    return slice(at, min(len(records), at + random.choice(sizes)))


def swap(records: Records, random: Random) -> None:
    one, two = (random.randrange(len(records)) for _ in range(2))
    records[one], records[two] = records[two], records[one]


def duplicate(records: Records, random: Random) -> None:
    at = random.randrange(len(records) + 1)
    records[at:at] = records[stretch(records, random)]


def delete(records: Records, random: Random) -> None:
    del records[stretch(records, random)]


def reverse(records: Records, random: Random) -> None:
    where = stretch(records, random, (2, 3, 100))
    records[where] = records[where][::-1]


def rotate(records: Records, random: Random) -> None:
    """What was written round a ring: the end comes first."""
    at = random.randrange(len(records))
    records[:] = records[at:] + records[:at]


ORDER: tuple[Change, ...] = (swap, duplicate, delete, reverse, rotate)
"""Changes of which records a file holds, and in which order; each record stays sound."""


def flip(record: bytes, random: Random) -> bytes:
    at = random.randrange(len(record))
    return record[:at] + bytes([record[at] ^ 1 << random.randrange(8)]) + record[at + 1 :]


def broken(records: Records, random: Random) -> None:
    """A bit is wrong, and so is the checksum, if there is one."""
    at = random.randrange(len(records))
    records[at] = flip(records[at], random)


def blank(records: Records, random: Random) -> None:
    """Records, all of one size, are empty, erased or noise."""
    where = stretch(records, random, (1, 2, 5))
    size = len(records[where.start])
    filling = random.choice([bytes(size), b"\xff" * size, random.randbytes(size)])
    records[where] = [filling] * len(records[where])


def field_setter(
    set_field: SetField,
    name: str,
    form: str,
    at: int,
    values: tuple[int, ...],
    lengths: tuple[int, ...] = (1,),
) -> Change:
    """A change that sets one field of a few records to one of these values, or to any."""
    bits = 8 * struct.calcsize(form)
    low = -(1 << bits - 1) if form == "<h" else 0

    def change(records: Records, random: Random) -> None:
        value = random.choice([*values, random.randrange(low, low + (1 << bits))])
        where = stretch(records, random, lengths)
        records[where] = [set_field(record, form, at, value) for record in records[where]]

    change.__name__ = name
    return change


def changed(records: Records, random: Random, changes: Sequence[Change], most: int = 4) -> str:
    names = []
    for _ in range(random.randint(1, most)):
        if len(records) > 1:
            change = random.choice(changes)
            change(records, random)
            names.append(change.__name__)
    return " ".join(names)


def together(parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.empty((0, 3)), *parts])
