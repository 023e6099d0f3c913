"""Errors of a calibration along a recording, and the test for degradation.

The check is that of Grammenos et al. (2018): the deviation of |a| from g on still windows is examined every
hour, and a sensor whose deviation has grown is calibrated again. Here a calibration is compared with fits to
the recording itself, on stretches of time that they have not seen. If a new calibration would gain little,
the old one holds; if it would gain much and clearly, or if the error is beyond the limit, it has degraded.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from math import fsum

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import interval95, mean, weighted_percentile
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import PointSet, TimedMeans
from accelcal_cli.core.results import Change
from accelcal_cli.judge.change import LEAST_MG, ComparedErrors
from accelcal_cli.judge.errors import applied

PARTS = 4
"""Number of parts of time in which a calibration is judged if the sensor changed slowly."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ErrorSpread:
    """Mean and 95th percentile of | |a| - 1 g | [mg]; windows count alike.

    Attributes:
        off: 5th, 50th and 95th percentile of |a| - 1 g, with its sign.
    """

    mean: float
    p95: float
    off: tuple[float, float, float]


def deviations_mg(means: TimedMeans, calibration: Calibration | None, rest: Gravity) -> Floats:
    """Return |a| - 1 g of each observation [mg], (n,), relative to local gravity; None: of raw values."""
    right = means
    if calibration is not None and calibration.correction is not None and len(means.block):
        right = means.corrected(calibration.correction)
    a = [right.mean_g[:, axis] for axis in range(3)]
    if calibration is not None:
        a = calibration.applied(a, means.celsius)
    return _lengths_off_mg([value / float(rest.local_g()) for value in a])


def point_deviations_mg(points: PointSet, calibration: Calibration | None, rest: Gravity) -> Floats:
    """Return |a| - 1 g of points [mg], (n,), after the correction if the calibration has one."""
    if calibration is not None:
        return _lengths_off_mg(applied(points, calibration, rest))
    g = points.xyz_g()
    return _lengths_off_mg([g[:, axis] for axis in range(3)])


def _lengths_off_mg(a: list[Floats]) -> Floats:
    return np.asarray(1000 * (np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) - 1.0))


def by_block(
    deviations: Floats, windows: NDArray[np.int64], block: NDArray[np.int64]
) -> dict[int, ErrorSpread]:
    """Summarise the deviations in each block of time that has observations.

    Args:
        windows: (n,) number of windows behind each observation.
        block: (n,) number of its block.
    """
    of_block: dict[int, list[tuple[float, int]]] = defaultdict(list)
    columns = (deviations.tolist(), windows.tolist(), block.tolist())
    for deviation, number, one in zip(*columns, strict=True):
        of_block[one].append((deviation, number))
    spreads = {}
    for one in sorted(of_block):
        signed = sorted(of_block[one])
        errors = sorted((abs(value), number) for value, number in signed)
        average = fsum(error * number for error, number in errors) / sum(number for _, number in errors)
        low, middle, high = (weighted_percentile(signed, percent) for percent in (5, 50, 95))
        spreads[one] = ErrorSpread(average, weighted_percentile(errors, 95), (low, middle, high))
    return spreads


@dataclass(frozen=True, slots=True)
class Period:
    """A part of a recording in which a calibration is judged as a whole.

    Attributes:
        first, end: numbers of its first block, and of the one after its last.
        given_mg: mean error of the calibration over its stretches of time.
        unseen_mg: mean error of fits to the recording itself, on stretches that they have not seen.
        fall_mg: 95 % interval of the difference.
        degraded: True if the calibration does not hold there.
    """

    first: int
    end: int
    given_mg: float
    unseen_mg: float
    fall_mg: tuple[float, float]
    degraded: bool


@dataclass(frozen=True, slots=True)
class QualityCheck:
    """The judgement of a calibration along a recording.

    Attributes:
        periods: one, unless the sensor changed during the recording or the error rose at the end.
        rises: True if the error of the last period is far above all before.
    """

    periods: tuple[Period, ...]
    rises: bool = False

    @property
    def degraded(self) -> tuple[Period, ...]:
        """Periods in which the calibration does not hold."""
        return tuple(period for period in self.periods if period.degraded)


def check(compared: ComparedErrors, change: Change, blocks: int, limit_mg: float) -> QualityCheck:
    """Judge a calibration of other data along a recording.

    Args:
        change: how the sensor changed during the recording, relative to the calibration.
        blocks: number of blocks of time in the recording.
        limit_mg: error that no usable calibration reaches.
    """
    whole = _fall_interval(_falls(compared, 0, blocks))[0] > 0
    rise = None if change.at_block is not None else _rise(compared)
    moment = change.at_block if rise is None else rise
    edges = [0, blocks]
    if change.kind != "none":
        edges = sorted({round(part * blocks / PARTS) for part in range(PARTS + 1)})
    if moment is not None:
        edges = [0, moment, blocks]
    periods = [
        _period(compared, first, end, limit_mg, clear=whole and moment is not None)
        for first, end in pairwise(edges)
    ]
    return QualityCheck(tuple(period for period in periods if period is not None), rise is not None)


def _rise(compared: ComparedErrors) -> int | None:
    """Return the block from which on every stretch has an error far above all before, or None.

    A change in a recording's last hours is too short for `ChangeSearch`. By chance the last two of n
    stretches are the worst ones once in n (n - 1) / 2 times, and hardly ever far above all others.
    """
    numbers = sorted(set(compared.stretch.tolist()))
    errors = [float(compared.given_mg[compared.stretch == number].mean()) for number in numbers]
    for place in range(len(errors) // 2, len(errors) - 1):
        if min(errors[place:]) >= max(errors[:place]) + LEAST_MG:
            return int(compared.block[compared.stretch == numbers[place]].min())
    return None


def _period(compared: ComparedErrors, first: int, end: int, limit_mg: float, *, clear: bool) -> Period | None:
    """Judge a part of the recording; None without stillness.

    Args:
        clear: True if a fall is already known from all of the recording.
    """
    pairs = _falls(compared, first, end)
    if not pairs:
        return None
    given, unseen = mean([one for one, _ in pairs]), mean([other for _, other in pairs])
    interval = _fall_interval(pairs)
    better = given - unseen >= LEAST_MG and (clear or interval[0] > 0)
    return Period(first, end, given, unseen, interval, better or given >= limit_mg)


def _falls(compared: ComparedErrors, first: int, end: int) -> list[tuple[float, float]]:
    """Return (given, unseen) mean errors of each stretch, as far as it lies within some blocks."""
    inside = (compared.block >= first) & (compared.block < end)
    return [
        (float(compared.given_mg[one].mean()), float(compared.unseen_mg[one].mean()))
        for number in sorted(set(compared.stretch[inside].tolist()))
        for one in [inside & (compared.stretch == number)]
    ]


def _fall_interval(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the 95 % interval of the mean fall over stretches."""
    return interval95([given - unseen for given, unseen in pairs])
