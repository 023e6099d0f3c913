"""Cells of orientation and temperature: what was measured in each, and the points of a fit made of them.

A long recording fills thousands of cells, more than a fit takes. Those of one orientation at several
temperatures are joined first, up to 8 degrees C, which leaves a fit the contrasts it needs: what depends
linearly on temperature is, in the mean, what it is at the mean temperature. If that is not enough, cells are
made wider. The mean of several orientations lies inside the sphere, the further the more they spread. It is
moved out, away from raw zero, which is right except for the product of the spread with the offset: at an
offset of 0.1 g, to 0.1 mg in cells of 0.1 g and to 0.3 mg in cells of 0.2 g.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE, rounded_quotient, three
from accelcal_cli.core.calibration import TemperatureScale
from accelcal_cli.core.points import WEIGHT_ONE, PointSet, Windows

Key = tuple[int, ...]
"""Cell of a mean: x, y, z, degrees C; then 1 if its windows never changed, and the block of time."""

TEMPERATURE, CONSTANT, BLOCK = 3, 4, 5
"""Places in a Key."""

Value = list[int]
"""Sums in a cell: windows, samples, x, y, z, temperature, and x, y, z in the posture before."""

Vector = tuple[int, int, int]

MAX_POINTS = 4096
"""Most points of a fit, unless even the widest cells are more."""

FEW_DEGREES, ALL_DEGREES = 8, 1 << 12
"""Widest cells in temperature [degrees C] while they may also widen in space, and if that is not enough."""

HARMLESS_SPACE, MOST_SPACE = 2, 12
"""Doublings of a cell's sides that do no harm to a mean that is moved out, and the most doublings."""

COS_SQUARED = (956, 1024)
"""Squared cosine of 15 degrees, as a fraction: windows within this angle belong to one posture."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Borders of cells of orientation and temperature.

    Attributes:
        lsb_per_g: counts in 1 g.
        cells_per_g: cells in 1 g on each axis.
        degrees: width of a cell [degrees C], a power of two; 0 for a single cell.
    """

    lsb_per_g: Fraction
    cells_per_g: int
    degrees: int

    def keys(self, samples: NDArray[Any], sums: NDArray[Any], heat: NDArray[Any]) -> NDArray[np.int64]:
        """Return the cells that means lie in, (m, 4).

        Args:
            samples: (m,) number of samples of each mean.
            sums: (m, 3) sums of counts.
            heat: (m,) sums of thousandths of a degree C.
        """
        keys = np.zeros((len(samples), TEMPERATURE + 1), np.int64)
        g = samples[:, np.newaxis] * self.lsb_per_g.numerator
        keys[:, :TEMPERATURE] = sums * (self.cells_per_g * self.lsb_per_g.denominator) // g
        if self.degrees:
            keys[:, TEMPERATURE] = heat // (samples * 1000 * self.degrees)
        return keys


class Cells(dict[Key, Value]):
    """Sums by cell; cells are never removed."""

    def __init__(self, grid: Grid) -> None:
        super().__init__()
        self.grid = grid
        self._groups: set[Key] = set()
        self._grouped = 0

    def orientations(self) -> int:
        """Return the number of groups of 2 x 2 x 2 cells that hold windows; only new cells are looked at."""
        self._groups.update(map(group_of, islice(self, self._grouped, None)))
        self._grouped = len(self)
        return len(self._groups)

    def with_blocks(self, number: Callable[[int], int]) -> Cells:
        """Return cells with renumbered blocks of time; blocks with a new number below 0 are left out."""
        made = Cells(self.grid)
        for key, value in self.items():
            if (block := number(key[BLOCK])) >= 0:
                add_sums(made, (*key[:BLOCK], block), value)
        return made

    def with_degrees(self, degrees: int) -> Cells:
        """Return cells that are wider in temperature [degrees C]; 0 for a single cell."""
        made = Cells(replace(self.grid, degrees=degrees))
        for key, value in self.items():
            degree = key[TEMPERATURE] * self.grid.degrees // degrees if degrees else 0
            add_sums(made, (*key[:TEMPERATURE], degree, *key[CONSTANT:]), value)
        return made


def add_sums(cells: dict[Key, Value], key: Key, value: Value) -> None:
    """Add sums to those of a cell."""
    total = cells.get(key)
    cells[key] = list(value) if total is None else [a + b for a, b in zip(total, value, strict=True)]


def group_of(key: Key) -> Key:
    """Return the group of 2 x 2 x 2 cells that a cell belongs to."""
    return tuple(part >> 1 for part in key[:TEMPERATURE])


@dataclass(frozen=True, slots=True)
class CellSums:
    """One point before division: sums over `samples` samples of `windows` windows.

    Attributes:
        previous: sums of what was measured in the posture before; None if unknown.
    """

    windows: int
    samples: int
    xyz: Vector
    temperature_mc: int = 0
    previous: Vector | None = None


Weigh = Callable[[Sequence[tuple[Key, CellSums]]], Sequence[int]]
"""Gives the weights of cells."""


@dataclass(frozen=True, slots=True)
class Width:
    """Number of doublings of the sides of cells, and number of their temperatures that are joined."""

    space: int = 0
    degrees: int = 1

    def of(self, key: Key) -> Key:
        """Return the wider cell that contains a cell; the last four numbers are its place."""
        *first, x, y, z, degree = key
        warm = 0 if self.degrees == ALL_DEGREES else degree // self.degrees
        return *first, x >> self.space, y >> self.space, z >> self.space, warm


def points_of(
    cells: Mapping[Key, CellSums],
    width: Width,
    weigh: Weigh,
    lsb_per_g: float | Fraction,
    *,
    temperature: bool,
) -> tuple[list[Key], PointSet]:
    """Return cells of a width and one point for each, in the order of their coordinates."""
    parts = defaultdict[Key, list[CellSums]](list)
    for key, sums in cells.items():
        parts[width.of(key)].append(sums)
    ordered = [(key, _added(parts[key])) for key in sorted(parts)]
    points = to_points([sums for _, sums in ordered], weigh(ordered), lsb_per_g, temperature=temperature)
    if width.space:
        points = _moved_out(points, [parts[key] for key, _ in ordered], Fraction(lsb_per_g))
    return [key for key, _ in ordered], points


def numbers_of(cells: Collection[Key], width: Width) -> dict[Key, int]:
    """Return the number of the point of `points_of` that each cell is part of."""
    number = {key: index for index, key in enumerate(sorted({*map(width.of, cells)}))}
    return {key: number[width.of(key)] for key in cells}


def width_for(cells: Collection[Key], degrees: int = 1) -> Width:
    """Return the narrowest width that leaves at most MAX_POINTS cells, else the widest.

    Args:
        degrees: present width of the cells [degrees C].
    """
    if len(cells) <= MAX_POINTS:
        return Width()
    few = (width for width in _widths(degrees) if len({*map(width.of, cells)}) <= MAX_POINTS)
    return next(few, Width(MOST_SPACE, ALL_DEGREES))


def _widths(degrees: int) -> Iterator[Width]:
    """Yield widths from narrow to wide."""
    joined = [number for number in (1, 2, 4, 8) if number * max(1, degrees) <= FEW_DEGREES]
    for space in range(MOST_SPACE + 1):
        yield from (Width(space, number) for number in joined or [1])
        if space >= HARMLESS_SPACE:
            yield Width(space, ALL_DEGREES)


def _added(parts: Sequence[CellSums]) -> CellSums:
    if len(parts) == 1:
        return parts[0]
    before = [part.previous for part in parts if part.previous is not None]
    return CellSums(
        sum(part.windows for part in parts),
        sum(part.samples for part in parts),
        _total([part.xyz for part in parts]),
        sum(part.temperature_mc for part in parts),
        _total(before) if len(before) == len(parts) else None,
    )


def _total(vectors: Sequence[Vector]) -> Vector:
    return three(map(sum, zip(*vectors, strict=True)))


def _moved_out(points: PointSet, parts: Sequence[Sequence[CellSums]], scale: Fraction) -> PointSet:
    """Lengthen means of wide cells until their squares are the mean squares of their parts."""
    one, lsb, places = ONE * scale.denominator, scale.numerator, []
    for mean, joined in zip(points.xyz.tolist(), parts, strict=True):
        squares = sum(part.samples * _square(_mean(part.xyz, part.samples, one, lsb)) for part in joined)
        own = _square(mean) * sum(part.samples for part in joined)
        longer = isqrt((squares << 2 * FRACTION_BITS) // own) if own else ONE
        places.append([rounded_quotient(axis * longer, ONE) for axis in mean])
    return replace(points, xyz=np.array(places, np.int64))


def _square(vector: Sequence[int]) -> int:
    return sum(axis * axis for axis in vector)


def _mean(sums: Vector, samples: int, one: int, lsb: int) -> list[int]:
    """Return a mean in fixed-point g."""
    return [rounded_quotient(axis * one, samples * lsb) for axis in sums]


def to_points(
    sums: Sequence[CellSums], weights: Sequence[int], lsb_per_g: float | Fraction, *, temperature: bool
) -> PointSet:
    """Return points: means in fixed-point g, temperatures scaled to a power-of-two span about their mean."""
    scale = Fraction(lsb_per_g)
    one, lsb = ONE * scale.denominator, scale.numerator
    windows = np.array([item.windows for item in sums], np.int64)
    shares = np.array(weights, np.int64)
    places = _rows([_mean(item.xyz, item.samples, one, lsb) for item in sums])
    known = [_mean(item.previous, item.samples, one, lsb) for item in sums if item.previous is not None]
    points = PointSet(places, shares, windows, previous=_rows(known) if len(known) == len(sums) else None)
    if not temperature or not sums:
        return points
    means = [rounded_quotient(item.temperature_mc, item.samples) for item in sums]
    reference = rounded_quotient(sum(w * t for w, t in zip(weights, means, strict=True)), sum(weights))
    largest_mc, span = max(abs(mean - reference) for mean in means), 1
    while largest_mc >= 2000 * span:
        span *= 2
    tau = [
        rounded_quotient((item.temperature_mc - reference * item.samples) * ONE, item.samples * 1000 * span)
        for item in sums
    ]
    temperatures = TemperatureScale(reference, float(span))
    return replace(points, tau=np.array(tau, np.int64), temperature=temperatures)


def _rows(vectors: Sequence[Sequence[int]]) -> NDArray[np.int64]:
    return np.array(vectors, np.int64).reshape(-1, 3)


def shared_weights(cells: Sequence[tuple[Key, CellSums]]) -> list[int]:
    """Return weights by which each 2 x 2 x 2 group counts as one point, shared by its cells' windows.

    Args:
        cells: the last four numbers of a key are the place; groups that differ in the others stay apart.
    """
    pairs = [((*key[:-4], *(part >> 1 for part in key[-4:-1])), sums.windows) for key, sums in cells]
    totals: dict[Key, int] = defaultdict(int)
    for group, number in pairs:
        totals[group] += number
    return [max(1, rounded_quotient(number * WEIGHT_ONE, totals[group])) for group, number in pairs]


class PreviousPosture:
    """Finds the posture before that of each still window, for sensors whose values depend on it.

    A posture lasts while windows lie within 15 degrees of its first one.
    """

    def __init__(self) -> None:
        self._leader: Vector | None = None
        self._last_cell: tuple[int, ...] | None = None
        self._last: Vector = (0, 0, 0)
        self._before: Vector | None = None

    def of(self, windows: Windows, cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return mean counts of the last window of the posture before each window, (m, 3).

        Windows of the first posture, which has none before it, get their own.

        Args:
            windows: the next ones in the order of time.
            cell: (m, c) whole numbers, the same for windows that measure the same direction.
        """
        means = windows.sums // windows.samples[:, np.newaxis]
        last = cell[:1] - 1 if self._last_cell is None else [self._last_cell]
        fresh = (np.diff(cell, axis=0, prepend=last) != 0).any(axis=1)
        starts = np.flatnonzero(np.append(True, fresh[1:]))
        ends = np.append(starts[1:], len(windows))
        self._last_cell = tuple(cell[-1].tolist())
        before = means.copy()
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
            first, last = means[start].tolist(), means[end - 1].tolist()
            if self._leader is None or (fresh[start] and not _alike(self._leader, first)):
                self._before = None if self._leader is None else self._last
                self._leader = first
            self._last = last
            if self._before is not None:
                before[start:end] = self._before
        return before


def _alike(one: Vector, other: Vector) -> bool:
    """Return True if two vectors are at most 15 degrees apart."""
    share, whole = COS_SQUARED
    dot = sum(a * b for a, b in zip(one, other, strict=True))
    norms = sum(a * a for a in one) * sum(b * b for b in other)
    return dot > 0 and dot * dot * whole >= share * norms
