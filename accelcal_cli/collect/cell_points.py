"""Cells as points of a fit: their means and weights, and wider cells where there would be too many.

A long recording fills thousands of cells. Those of one orientation at several temperatures are joined first:
what depends linearly on temperature is, in the mean, what it is at the mean temperature. The mean of several
orientations is not one of them: it lies inside the sphere, by how much they spread, and is moved out again.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.grid import Key
from accelcal_cli.core.fixed import FRACTION_BITS, ONE, rounded_quotient
from accelcal_cli.core.points import WEIGHT_ONE, PointSet, TemperatureScale

MAX_POINTS = 4096

SPACE_DOUBLINGS, HEAT_DOUBLINGS = 6, 6
"""Of 0.05 g and a degree C: an axis then has two cells, and so have temperatures that a wrist sees."""

Vector = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Sums:
    """One point before its division: sums over `samples` samples of `windows` windows.

    Attributes:
        previous: sums of what was measured in the posture before; None where it is not known.
    """

    windows: int
    samples: int
    xyz: Vector
    temperature_mc: int = 0
    previous: Vector | None = None


Weigh = Callable[[Sequence[tuple[Key, Sums]]], Sequence[int]]
"""Weights of cells."""


@dataclass(frozen=True, slots=True)
class Width:
    """How often the width of cells is doubled, in space and in temperature; beyond the most, all are one."""

    space: int = 0
    heat: int = 0

    def of(self, key: Key) -> Key:
        """The wider cell that a cell is part of; its last four numbers say where it lies."""
        *first, x, y, z, degree = key
        if self.space > SPACE_DOUBLINGS:
            return *first, 0, 0, 0, 0
        return *first, x >> self.space, y >> self.space, z >> self.space, degree >> self.heat


def points_of(
    cells: Mapping[Key, Sums], weigh: Weigh, lsb_per_g: float | Fraction, *, temperature: bool
) -> tuple[list[Key], PointSet]:
    """The cells, as wide as they have to be, and one point for each; in the order of their coordinates."""
    width = _width_for(cells)
    parts = defaultdict[Key, list[Sums]](list)
    for key, sums in cells.items():
        parts[width.of(key)].append(sums)
    ordered = [(key, _added(parts[key])) for key in sorted(parts)]
    points = to_points([sums for _, sums in ordered], weigh(ordered), lsb_per_g, temperature=temperature)
    if width.space:
        points = _moved_out(points, [parts[key] for key, _ in ordered], Fraction(lsb_per_g))
    return [key for key, _ in ordered], points


def numbers_of(cells: Collection[Key]) -> dict[Key, int]:
    """The number of the point of `points_of` that each cell is part of."""
    width = _width_for(cells)
    number = {key: index for index, key in enumerate(sorted({*map(width.of, cells)}))}
    return {key: number[width.of(key)] for key in cells}


def _width_for(cells: Collection[Key]) -> Width:
    """The narrowest that leaves few enough cells, else the widest."""
    if len(cells) <= MAX_POINTS:
        return Width()
    widths = (Width(*doubled) for doubled in product(range(SPACE_DOUBLINGS + 1), range(HEAT_DOUBLINGS + 1)))
    few = (width for width in widths if len({*map(width.of, cells)}) <= MAX_POINTS)
    return next(few, Width(SPACE_DOUBLINGS + 1))


def _added(parts: Sequence[Sums]) -> Sums:
    """What several cells hold together."""
    if len(parts) == 1:
        return parts[0]
    before = [part.previous for part in parts if part.previous is not None]
    return Sums(
        sum(part.windows for part in parts),
        sum(part.samples for part in parts),
        _total([part.xyz for part in parts]),
        sum(part.temperature_mc for part in parts),
        _total(before) if len(before) == len(parts) else None,
    )


def _total(vectors: Sequence[Vector]) -> Vector:
    x, y, z = (sum(axis) for axis in zip(*vectors, strict=True))
    return x, y, z


def _moved_out(points: PointSet, parts: Sequence[Sequence[Sums]], scale: Fraction) -> PointSet:
    """Means of wide cells, lengthened until their squares are the mean squares of their parts."""
    one, lsb, places = ONE * scale.denominator, scale.numerator, []
    for mean, held in zip(points.xyz.tolist(), parts, strict=True):
        squares = sum(part.samples * _square(_mean(part.xyz, part.samples, one, lsb)) for part in held)
        own = _square(mean) * sum(part.samples for part in held)
        longer = isqrt((squares << 2 * FRACTION_BITS) // own) if own else ONE
        places.append([rounded_quotient(axis * longer, ONE) for axis in mean])
    return replace(points, xyz=np.array(places, np.int64))


def _square(vector: Sequence[int]) -> int:
    return sum(axis * axis for axis in vector)


def _mean(sums: Vector, samples: int, one: int, lsb: int) -> list[int]:
    """In fixed-point g."""
    return [rounded_quotient(axis * one, samples * lsb) for axis in sums]


def to_points(
    sums: Sequence[Sums], weights: Sequence[int], lsb_per_g: float | Fraction, *, temperature: bool
) -> PointSet:
    """Means in fixed-point g; temperatures scaled to a power-of-two span about their mean."""
    scale = Fraction(lsb_per_g)
    one, lsb = ONE * scale.denominator, scale.numerator
    windows = np.array([item.windows for item in sums], np.int64)
    shares = np.array(weights, np.int64)
    places = _rows([_mean(item.xyz, item.samples, one, lsb) for item in sums])
    held = PointSet(places, shares, windows, previous=_previous(sums, one, lsb))
    if not temperature or not sums:
        return held
    means = [rounded_quotient(item.temperature_mc, item.samples) for item in sums]
    reference = rounded_quotient(sum(w * t for w, t in zip(weights, means, strict=True)), sum(weights))
    span = _span_c(max(abs(mean - reference) for mean in means))
    tau = [
        rounded_quotient((item.temperature_mc - reference * item.samples) * ONE, item.samples * 1000 * span)
        for item in sums
    ]
    temperatures = TemperatureScale(reference, float(span))
    return replace(held, tau=np.array(tau, np.int64), temperature=temperatures)


def _previous(sums: Sequence[Sums], one: int, lsb: int) -> NDArray[np.int64] | None:
    """Means of the postures before, in fixed-point g; None where one is not known."""
    known = [(item.previous, item.samples) for item in sums if item.previous is not None]
    return None if len(known) < len(sums) else _rows([_mean(total, n, one, lsb) for total, n in known])


def _rows(vectors: Sequence[Sequence[int]]) -> NDArray[np.int64]:
    return np.array(vectors, np.int64).reshape(-1, 3)


def shared_weights(groups: Sequence[tuple[int, ...]], windows: Sequence[int]) -> list[int]:
    """Weights of cells: each group counts as one point, shared by its cells' numbers of windows."""
    totals: dict[tuple[int, ...], int] = defaultdict(int)
    for group, number in zip(groups, windows, strict=True):
        totals[group] += number
    pairs = zip(groups, windows, strict=True)
    return [max(1, rounded_quotient(number * WEIGHT_ONE, totals[group])) for group, number in pairs]


def _span_c(largest_mc: int) -> int:
    span = 1
    while largest_mc >= 2000 * span:
        span *= 2
    return span
