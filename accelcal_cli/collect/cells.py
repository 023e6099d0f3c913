"""The default collector: running integer means of plausible still windows in orientation cells.

A wrist rests for hours in a few postures; one mean per cell of the raw acceleration space keeps
all orientations and bounds the memory. Cells are cubes of about 0.05 g (the mean of a wider cell
lies inside the sphere by the square of its spread: 0.1 g cells leave a bias of 0.03 mg on simulated
days, 0.05 g cells no visible one, and 0.2 mg where windows fill them evenly). Each group of 2 x 2 x 2
cells counts as one point, shared by its cells in proportion to their windows, so that frequent postures
do not outweigh rare ones. Where temperature is used, cells are also split by whole degrees C (by more if
there are too many); and they are kept apart by blocks of time, so that a change of the sensor can be found.

All sums are integers: adding windows in batches of any size, or merging collectors, gives the same result.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice, pairwise
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE, rounded_quotient, three, weighted_percentile
from accelcal_cli.core.calibration import Correction, TemperatureScale
from accelcal_cli.core.points import WEIGHT_ONE, PointSet, Role, Saturated, Windows, WindowUses
from accelcal_cli.core.settings import Settings

# Cells of orientation and temperature: what was measured in each, and the points of a fit made of
# them.
#
# A long recording fills thousands of cells, more than a fit takes. Those of one orientation at
# several temperatures are joined first, up to 8 degrees C, which leaves a fit the contrasts it needs:
# what depends linearly on temperature is, in the mean, what it is at the mean temperature. If that is
# not enough, cells are made wider. The mean of several orientations lies inside the sphere, the
# further the more they spread. It is moved out, away from raw zero, which is right except for the
# product of the spread with the offset: at an offset of 0.1 g, to 0.1 mg in cells of 0.1 g and to 0.3
# mg in cells of 0.2 g.

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


# The default collector.

MAX_TIMED, MAX_BLOCKS = 1 << 15, 1 << 9
"""Most cells of all blocks of time, and most blocks; beyond them, blocks become twice as long."""

ONE_BLOCK, MOST_DEGREES = 1 << 40, 1 << 12
"""Samples and degrees C that no recording exceeds: if one block has too many cells, time is not kept, and
cells are made wider in temperature."""

LEADING_BITS = 8
"""Bits of a value that a histogram keeps."""

FAR_MC, FAR_DEVIATIONS = 40_000, 10
"""Distance of a temperature from the median of the windows [thousandths of a degree C], and in median
distances, beyond both of which the thermometer is at fault: no wrist is so hot or so cold."""

NEARLY_CONSTANT_SHARE = 10
"""Constant windows are used if nearly constant ones are at least a tenth as many."""

NEAR_G = 0.05
"""Distance [g] from saturation within which a still window is discarded: breath and noise may exceed it."""

LEAST_MOVED = 3
"""Counts that another axis must move while a saturated axis stands still."""

LEAST_G = 0.5
"""Smallest |value| [g] at which an axis may saturate; a wrist takes an axis further."""

LEAST_WINDOWS = 12
"""Fewest windows at a value for saturation: one minute in windows of 5 s."""

MOST_ELSEWHERE = 10
"""An axis that stands at other values in more than a tenth as many windows is not saturated."""


def norms_g(windows: Windows, lsb_per_g: float) -> NDArray[np.float64]:
    """Return the length of each window's raw mean [g], (m,)."""
    mean_g = windows.sums / (windows.samples[:, np.newaxis] * lsb_per_g)
    squares = mean_g * mean_g
    return np.asarray(np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2]))


def plausible(windows: Windows, lsb_per_g: float, settings: Settings) -> NDArray[np.bool_]:
    """Return a mask (m,) of windows whose mean has a length near 1 g; zeros written by a device have not."""
    norms = norms_g(windows, lsb_per_g)
    return np.asarray((norms > settings.norm_low_g) & (norms < settings.norm_high_g))


@dataclass(frozen=True, slots=True)
class CellCounts:
    """Numbers of windows that the collector left out."""

    implausible: int
    constant: int
    constant_used: bool
    far_temperature: int = 0
    saturated: int = 0


class Histogram:
    """A histogram of whole numbers from 0: exact below 256, then by eight leading bits, so it stays small."""

    def __init__(self) -> None:
        self.numbers: dict[int, int] = defaultdict(int)

    def add(self, values: NDArray[np.int64]) -> None:
        """Count values."""
        unique, numbers = np.unique(values, return_counts=True)
        for value, number in zip(unique.tolist(), numbers.tolist(), strict=True):
            drop = max(0, value.bit_length() - LEADING_BITS)
            self.numbers[value >> drop << drop] += number

    def merge(self, other: Histogram) -> None:
        """Add the counts of another histogram."""
        for value, number in other.numbers.items():
            self.numbers[value] += number

    def quantile(self, percent: int) -> int | None:
        """Return a percentile; None without values."""
        return weighted_percentile(sorted(self.numbers.items()), percent) if self.numbers else None


def _summed(keys: NDArray[np.int64], values: NDArray[np.int64]) -> Iterator[tuple[Key, Value]]:
    """Sum the values (m, c) that have the same key (m, k), in the order of the keys."""
    order = np.lexsort(keys.T[::-1])
    keys = keys[order]
    first = np.flatnonzero(np.append(True, (keys[1:] != keys[:-1]).any(axis=1)))
    sums = np.add.reduceat(values[order], first, axis=0)
    return zip(map(tuple, keys[first].tolist()), sums.tolist(), strict=True)


class CellCollector:
    """Collects the still windows of one recording in orientation cells.

    Args:
        block_samples: samples in a block of time; 0 for no blocks.
    """

    def __init__(
        self, lsb_per_g: float, settings: Settings, *, temperature: bool, block_samples: int = 0
    ) -> None:
        self.lsb_per_g = lsb_per_g
        self.block_samples = block_samples
        self.temperature = temperature
        self.settings = settings
        self.implausible = 0
        self.spreads = Histogram()
        self.saturation = Saturation()
        self._previous = PreviousPosture()
        border = Fraction(lsb_per_g).limit_denominator(1000)
        self._cells = Cells(Grid(border, settings.cells_per_g, int(temperature)))

    def add(self, windows: Windows) -> None:
        """Take further still windows, in the order of time."""
        usable = plausible(windows, self.lsb_per_g, self.settings)
        self.implausible += int(len(windows) - usable.sum())
        windows = windows.select(usable)
        if not len(windows):
            return
        self.saturation.add(windows)
        widest = windows.spread.max(axis=1)
        self.spreads.add(widest)
        keys = self._keys(windows, widest == 0)
        samples, heat = windows.samples, windows.temperature_sums
        before = self._previous.of(windows, keys[:, :3] >> 1) * samples[:, np.newaxis]
        heat = np.zeros_like(samples) if heat is None else heat
        values = np.column_stack([np.ones_like(samples), samples, windows.sums, heat, before])
        for key, value in _summed(keys, values):
            add_sums(self._cells, key, value)
        self._limit(int(windows.first_sample[-1]))

    def _limit(self, last_sample: int = 0) -> None:
        """Make blocks of time longer, or else cells wider in temperature, while there are too many.

        The result does not depend on how many windows come at a time.
        """
        while True:
            blocks = last_sample // self.block_samples if self.block_samples else 0
            degrees = self._cells.grid.degrees
            if blocks < MAX_BLOCKS and len(self._cells) <= MAX_TIMED:
                return
            if blocks:
                self._cells = self._cells.with_blocks(lambda block: block >> 1)
                self.block_samples *= 2
            elif 0 < degrees < MOST_DEGREES:
                self._cells = self._cells.with_degrees(2 * degrees)
                self.block_samples = self.block_samples and ONE_BLOCK
            else:
                return

    def forget_first_block(self) -> None:
        """Drop the windows of the first block of time; the next one becomes the first."""
        self._cells = self._cells.with_blocks(lambda block: block - 1)

    def merge(self, other: CellCollector) -> None:
        """Add the windows of another collector, exactly, without their blocks of time.

        It must have the same scale and settings, and temperature if this one has.
        """
        self.implausible += other.implausible
        self.spreads.merge(other.spreads)
        self.saturation.merge(other.saturation)
        degrees = max(self._cells.grid.degrees, other._cells.grid.degrees) if self.temperature else 0
        if degrees != self._cells.grid.degrees:
            self._cells = self._cells.with_degrees(degrees)
        for key, value in other._cells.with_degrees(degrees).items():
            add_sums(self._cells, (*key[:BLOCK], 0), value)
        self._limit()

    def orientations(self) -> int:
        """Return the number of groups of 2 x 2 x 2 cells that hold windows, used or not."""
        return self._cells.orientations()

    def points(self, correction: Correction | None = None) -> PointSet:
        """Return one point per cell, in the order of the cells' coordinates.

        Args:
            correction: of a sensor that changed, in units of local gravity; applied as in the middle of each
                block of time.
        """
        cells, scale = self._fitted(), Fraction(self.lsb_per_g)
        width = width_for(cells, self._cells.grid.degrees)
        if correction is not None:
            corrected, scale = self._corrected(correction), scale * scale.denominator * ONE
            cells = {key: corrected[key] for key in cells}
        sums = {key: _sums(value) for key, value in cells.items()}
        return points_of(sums, width, shared_weights, scale, temperature=self.temperature)[1]

    def _corrected(self, correction: Correction) -> dict[Key, Value]:
        """Return the cells with corrected sums, in whole parts of a count."""
        scale, real = Fraction(self.lsb_per_g), self._constants_are_real()
        found: dict[Key, Value] = {}
        for key, (windows, samples, *sums) in self._cells.items():
            if real or not key[CONSTANT]:
                middle = key[BLOCK] * self.block_samples + self.block_samples // 2
                right = [
                    total * scale.denominator * stretch + samples * scale.numerator * shift
                    for total, stretch, shift in zip(sums[:3], *correction.at(middle), strict=True)
                ]
                before = [total * scale.denominator * ONE for total in sums[4:]]
                add_sums(found, key[:CONSTANT], [windows, samples, *right, sums[3], *before])
        return found

    def timed(self) -> list[tuple[int, CellSums]]:
        """Return the sums of each orientation in each block of time, with the block's number, in order."""
        _, left_out = self._settled()
        real = self._constants_are_real()
        found: dict[Key, Value] = {}
        for key, value in self._cells.items():
            if (real or not key[CONSTANT]) and key[:CONSTANT] not in left_out:
                add_sums(found, (key[BLOCK], *group_of(key)), value)
        return [(key[0], _sums(value)) for key, value in sorted(found.items())]

    def counts(self) -> CellCounts:
        """Return how many windows were left out, by reason."""
        constant, real = self.spreads.numbers.get(0, 0), self._constants_are_real()
        cells, left_out = self._settled()
        number = dict.fromkeys((Role.TEMPERATURE, Role.SATURATED), 0)
        for key, role in left_out.items():
            number[role] += cells[key][0]
        return CellCounts(self.implausible, constant, real, number[Role.TEMPERATURE], number[Role.SATURATED])

    def saturated(self) -> Saturated:
        """Return the axes that saturate, in units of local gravity."""
        return self.saturation.found(self.lsb_per_g)

    def window_uses(self, windows: Windows) -> WindowUses:
        """Return what became of windows that were added; call after the last one."""
        role, point = np.full(len(windows), Role.IMPLAUSIBLE), np.full(len(windows), -1)
        near_1_g = np.flatnonzero(plausible(windows, self.lsb_per_g, self.settings))
        constant = windows.spread[near_1_g].max(axis=1, initial=0) == 0
        keys = self._keys(windows.select(near_1_g), constant)[:, :CONSTANT]
        _, left_out = self._settled()
        fitted = self._fitted()
        number = numbers_of(fitted, width_for(fitted, self._cells.grid.degrees))
        unbelieved = (constant & (not self._constants_are_real())).tolist()
        for place, key, never_changed in zip(near_1_g.tolist(), keys.tolist(), unbelieved, strict=True):
            if never_changed:
                role[place] = Role.CONSTANT
            elif tuple(key) in left_out:
                role[place] = left_out[tuple(key)]
            else:
                role[place], point[place] = Role.FIT, number[tuple(key)]
        return WindowUses(role, point)

    def _fitted(self) -> dict[Key, Value]:
        """Return the cells that make points."""
        cells, left_out = self._settled()
        return {key: value for key, value in cells.items() if key not in left_out}

    def _settled(self) -> tuple[dict[Key, Value], dict[Key, Role]]:
        """Return the cells of windows that are used, and the role of those cells that make no points."""
        real = self._constants_are_real()
        cells: dict[Key, Value] = {}
        for key, value in self._cells.items():
            if real or not key[CONSTANT]:
                add_sums(cells, key[:CONSTANT], value)
        far = _far_off(cells) if self.temperature else set()
        saturated = [
            key
            for axis, limit_g in self.saturated()
            for key, value in cells.items()
            if (limit_g - value[2 + axis] / (value[1] * self.lsb_per_g)) * (1 if limit_g > 0 else -1) < NEAR_G
        ]
        return cells, dict.fromkeys(far, Role.TEMPERATURE) | dict.fromkeys(saturated, Role.SATURATED)

    def _keys(self, windows: Windows, constant: NDArray[np.bool_]) -> NDArray[np.int64]:
        heat, block = windows.temperature_sums, np.zeros_like(windows.samples)
        cells = self._cells.grid.keys(windows.samples, windows.sums, block if heat is None else heat)
        if self.block_samples:
            block = windows.first_sample // self.block_samples
        return np.column_stack([cells, constant, block])

    def _constants_are_real(self) -> bool:
        """Return True if windows without any spread can be a coarse sensor's stillness.

        A sensor whose noise is far below its step shows many windows of one step as well; where a
        device repeats a sample or writes a constant (idle sleep mode), there are none.
        """
        spreads = self.spreads.numbers
        step = _step(spreads)
        limit = step * 3 // 2
        nearly = sum(number for spread, number in spreads.items() if 0 < spread <= limit)
        return step > 0 and nearly * NEARLY_CONSTANT_SHARE >= spreads.get(0, 0)


def _step(spreads: dict[int, int]) -> int:
    """Return the sensor's step, the smallest difference between spreads (and 0).

    Differences below 1/64 of the smallest spread are the rounding of printed decimals.
    """
    ordered = sorted({0, *spreads})
    if len(ordered) < 2:
        return 0
    return min(b - a for a, b in pairwise(ordered) if (b - a) * 64 >= ordered[1])


def _sums(value: Value) -> CellSums:
    windows, samples, x, y, z, heat, *before = value
    return CellSums(windows, samples, (x, y, z), heat, (before[0], before[1], before[2]))


def _far_off(cells: dict[Key, Value]) -> set[Key]:
    """Return cells whose temperature is far from all others': one such point would decide the slopes."""
    if not cells:
        return set()
    means = {key: value[5] // value[1] for key, value in cells.items()}
    middle = weighted_percentile(sorted((means[key], value[0]) for key, value in cells.items()), 50)
    away = {key: abs(mean - middle) for key, mean in means.items()}
    usual = weighted_percentile(sorted((away[key], value[0]) for key, value in cells.items()), 50)
    limit = max(FAR_MC, FAR_DEVIATIONS * usual)
    return {key for key, distance in away.items() if distance > limit}


class Saturation:
    """Finds axes that measure nothing beyond some value, although their range goes further.

    Such an axis never changes there, while another axis moves with the wearer. An axis that never changes
    elsewhere belongs to a device on a table, or to a coarse sensor, whose other axes hardly change either.
    """

    def __init__(self) -> None:
        self._constant: list[Counter[int]] = [Counter() for _ in range(3)]
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, windows: Windows) -> None:
        """Take further still windows, in any order."""
        if not len(windows):
            return
        means = windows.sums / windows.samples[:, np.newaxis]
        self._low = np.minimum(self._low, means.min(axis=0))
        self._high = np.maximum(self._high, means.max(axis=0))
        moved = windows.spread.max(axis=1) >= LEAST_MOVED
        for axis, constant in enumerate(self._constant):
            which = np.flatnonzero(moved & (windows.spread[:, axis] == 0))
            values, numbers = np.unique(
                windows.sums[which, axis] // windows.samples[which], return_counts=True
            )
            constant.update(dict(zip(values.tolist(), numbers.tolist(), strict=True)))

    def merge(self, other: Saturation) -> None:
        """Add the windows of another one."""
        self._low, self._high = np.minimum(self._low, other._low), np.maximum(self._high, other._high)
        for constant, more in zip(self._constant, other._constant, strict=True):
            constant.update(more)

    def found(self, lsb_per_g: float) -> Saturated:
        """Return the axes that saturate, and at which value [g]."""
        return tuple(
            (axis, value / lsb_per_g)
            for axis, constant in enumerate(self._constant)
            for value in _ends(constant, self._low[axis], self._high[axis])
            if abs(value) >= LEAST_G * lsb_per_g
        )


def _ends(constant: Counter[int], low: float, high: float) -> list[int]:
    """Return the extreme values at which an axis is often constant, if it hardly is at others."""
    ends = {int(value): constant[int(value)] for value in (low, high) if float(value).is_integer()}
    often = {value: number for value, number in ends.items() if number >= LEAST_WINDOWS}
    elsewhere = constant.total() - sum(often.values())
    return [value for value, number in often.items() if elsewhere * MOST_ELSEWHERE <= number]
