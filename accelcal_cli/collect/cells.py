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
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.grid import (
    BLOCK,
    CONSTANT,
    Cells,
    CellSums,
    Grid,
    Key,
    PreviousPosture,
    Value,
    add_sums,
    group_of,
    numbers_of,
    points_of,
    shared_weights,
    width_for,
)
from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import Correction
from accelcal_cli.core.points import Fates, PointSet, Role, Saturated, Windows
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.statistics import weighted_percentile

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

    def fates(self, windows: Windows) -> Fates:
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
        return Fates(role, point)

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
