"""Cells as points of a fit: their means and weights, and wider cells where there would be too many.

A long recording fills thousands of cells. Those of one orientation at several temperatures are joined
first, up to 8 degrees C, which leaves a fit the contrasts that it needs: what depends linearly on temperature
is, in the mean, what it is at the mean temperature. The mean of several orientations is not one of them: it
lies inside the sphere, by how much they spread. It is moved out, away from raw zero, which is right but for
the product of that with the offset: of 0.1 g, to 0.1 mg in cells of 0.1 g, to 0.3 mg in those of 0.2 g.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.grid import Key
from accelcal_cli.core.calibration import TemperatureScale
from accelcal_cli.core.fixed import FRACTION_BITS, ONE, rounded_quotient
from accelcal_cli.core.points import WEIGHT_ONE, PointSet

MAX_POINTS = 4096

FEW_DEGREES, ALL_DEGREES = 8, 1 << 12
"""Of temperature that are joined as long as there is another way, and where there is none [degrees C]."""

HARMLESS_SPACE, MOST_SPACE = 2, 12
"""Doublings of a cell's sides: up to which moving means out is as good as that, and up to which cells are."""

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
    """How often the sides of cells are doubled, and how many of their degrees are joined."""

    space: int = 0
    degrees: int = 1

    def of(self, key: Key) -> Key:
        """The wider cell that a cell is part of; its last four numbers say where it lies."""
        *first, x, y, z, degree = key
        warm = 0 if self.degrees == ALL_DEGREES else degree // self.degrees
        return *first, x >> self.space, y >> self.space, z >> self.space, warm


def points_of(
    cells: Mapping[Key, Sums], width: Width, weigh: Weigh, lsb_per_g: float | Fraction, *, temperature: bool
) -> tuple[list[Key], PointSet]:
    """Cells made so wide, and one point for each; in the order of their coordinates."""
    parts = defaultdict[Key, list[Sums]](list)
    for key, sums in cells.items():
        parts[width.of(key)].append(sums)
    ordered = [(key, _added(parts[key])) for key in sorted(parts)]
    points = to_points([sums for _, sums in ordered], weigh(ordered), lsb_per_g, temperature=temperature)
    if width.space:
        points = _moved_out(points, [parts[key] for key, _ in ordered], Fraction(lsb_per_g))
    return [key for key, _ in ordered], points


def numbers_of(cells: Collection[Key], width: Width) -> dict[Key, int]:
    """The number of the point of `points_of` that each cell is part of."""
    number = {key: index for index, key in enumerate(sorted({*map(width.of, cells)}))}
    return {key: number[width.of(key)] for key in cells}


def width_for(cells: Collection[Key], degrees: int = 1) -> Width:
    """The narrowest that leaves few enough cells, else the widest.

    Args:
        degrees: of temperature that cells are wide [degrees C].
    """
    if len(cells) <= MAX_POINTS:
        return Width()
    few = (width for width in _widths(degrees) if len({*map(width.of, cells)}) <= MAX_POINTS)
    return next(few, Width(MOST_SPACE, ALL_DEGREES))


def _widths(degrees: int) -> Iterator[Width]:
    """From narrow to wide."""
    joined = [number for number in (1, 2, 4, 8) if number * max(1, degrees) <= FEW_DEGREES]
    for space in range(MOST_SPACE + 1):
        yield from (Width(space, number) for number in joined or [1])
        if space >= HARMLESS_SPACE:
            yield Width(space, ALL_DEGREES)


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
