"""The gyroscope along the first pass: when it rests, and what it does between one rest and the next.

It has windows of its own, a second long, and looks at both sensors: the borders of a rest matter more here
than in a calibration of the accelerometer, and a slow turn that the accelerometer does not see shows in
the angular rate (G 4.4 asks both). The windows of the accelerometer, and what it is calibrated by, stay as
they are.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil, isfinite, isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.turns import GyroWindows, TurnCollector
from accelcal_cli.core.gyroscope import Gyroscope, Turns
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, Recording, Validity
from accelcal_cli.core.results import Judgement
from accelcal_cli.core.settings import DEFAULT, Settings
from accelcal_cli.judge.gyroscope import judge_gyroscope
from accelcal_cli.judge.revolutions import judge_revolutions
from accelcal_cli.pipeline.survey import Observer
from accelcal_cli.segment import MOST_SQUARES, still_rule
from accelcal_cli.segment.segmenter import Blocks, Segmenter, centred_squares, exact_sums

WINDOW_S = 1.0
"""Length [s] of a window; at least a second (G 4.4)."""

QUIET_DPS = 1.0
"""Standard deviation [deg/s] of each axis below which a gyroscope is at rest. Measured at rest: 0.02 to 0.3,
of sensors from an AX6 to an Xsens MTi; a wrist that moves slowly has several."""


class Turning(Observer):
    """Collects the turns of a recording that has a gyroscope.

    Args:
        revolutions: also whole revolutions, which bring gravity back to where it was.
    """

    def __init__(self, recording: Recording, *, revolutions: bool = False) -> None:
        self.revolutions = revolutions
        assert recording.gyro_dps_per_lsb is not None
        length = max(2, round(WINDOW_S * recording.rate_hz))
        dps_per_lsb, lsb_per_g = recording.gyro_dps_per_lsb, recording.lsb_per_g
        self._collector = TurnCollector(
            length, recording.rate_hz, dps_per_lsb, lsb_per_g, revolutions=revolutions
        )
        rule = _Resting(self._collector, dps_per_lsb, lsb_per_g)
        self._segmenter = Segmenter(length, rule)

    def see(self, chunk: Chunk) -> None:
        """Take a chunk in."""
        for _ in self._segmenter.feed(chunk):
            pass

    def result(self) -> Turns:
        """Return the turns."""
        return self._collector.result()


def gyroscope_of(turns: Turning, judgement: Judgement, settings: Settings) -> Gyroscope:
    """Return the verdict, by the calibration that the recording has in the end, its own or another's."""
    least_range_c = settings.min_temperature_range_c if settings.temperature else None
    found, calibration = turns.result(), judgement.calibration
    whole = judge_revolutions(found, calibration, least_range_c) if turns.revolutions else None
    return whole or judge_gyroscope(found, calibration, least_range_c)


class _Resting:
    """A `Rule` that hands all windows on to a collector and keeps none."""

    def __init__(
        self, collector: TurnCollector, dps_per_lsb: tuple[float, float, float], lsb_per_g: float
    ) -> None:
        self._collector = collector
        self._still = still_rule(
            (0, 1, 2), DEFAULT.stillness_threshold_g, DEFAULT.stillness_deviation_g, lsb_per_g
        )
        self._limits = [_variance_limit(scale) for scale in dps_per_lsb]
        self._run = -1

    def take(self, blocks: Blocks) -> list[Windows]:
        """Take windows in."""
        counts, number = blocks.rows.gyro_counts, len(blocks)
        if counts is None:
            self._run = -1
            return []
        still = self._still.still(blocks.columns, blocks.high - blocks.low, blocks.sums) & blocks.usable
        columns = np.ascontiguousarray(counts.T).reshape(3, number, blocks.length)
        index = np.flatnonzero(still)
        still[index] = self._quiet(columns[:, index])
        self._collector.add(
            GyroWindows(
                fresh=blocks.run != self._run,
                first_sample=blocks.rows.first_sample,
                time_us=blocks.rows.time_us[:: blocks.length],
                resting=still,
                usable=_measured(blocks),
                sums=blocks.sums.T,
                gyro_sums=exact_sums(columns, blocks.length * (1 << 8 * columns.itemsize - 1)).T,
                counts=counts,
                temperature_sums=blocks.temperature_sums,
            )
        )
        self._run = blocks.run
        return []

    def rest(self) -> list[Windows]:
        """Return nothing: no window is held back."""
        return []

    def _quiet(self, columns: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which of (3, m, n) gyroscope counts vary little, by exact variances."""
        _, number, length = columns.shape
        quiet = np.ones(number, np.bool_)
        for axis, limit in enumerate(self._limits):
            index = np.flatnonzero(quiet)
            counts = columns[axis, index]
            if not len(counts):
                break
            spread = counts.max(axis=1).astype(np.int64) - counts.min(axis=1)
            near = spread <= isqrt(2 * length * limit)  # wider ones vary more
            quiet[index] = near
            index, counts = index[near], counts[near]
            if len(index):
                centred, r = centred_squares(counts, spread[near], counts.sum(axis=1, dtype=np.int64))
                quiet[index] = centred - r * r // length < min(length * limit, MOST_SQUARES)
        return quiet


def _variance_limit(dps_per_lsb: float) -> int:
    """Return the limit in counts squared; 0, so that nothing is at rest, for a scale that says nothing."""
    if not isfinite(dps_per_lsb) or not dps_per_lsb:
        return 0
    return ceil((Fraction(QUIET_DPS) / Fraction(dps_per_lsb)) ** 2)


def _measured(blocks: Blocks) -> NDArray[np.bool_]:
    """Return which windows both sensors measured, at the accelerometer's range or not."""
    validity, number = blocks.rows.validity, len(blocks)
    if validity is None:
        return np.ones(number, np.bool_)
    flags = validity.reshape(number, blocks.length)
    unmeasured = (flags == Validity.FILLED) | (flags == Validity.RECOVERED)
    return np.asarray(~unmeasured.any(axis=1))
