"""What happened along a recording, block of time by block of time, and the errors in each.

A block is an hour of samples; where there are more than MAX_BLOCKS of them, blocks are twice as long, and so
on, so that memory is bounded. All counts are integers: the length of the chunks makes no difference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import MAX_BLOCKS, ONE_BLOCK
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.points import PointSet, TimedMeans, Windows
from accelcal_cli.core.recording import Chunk, Problem, Recording, Validity
from accelcal_cli.core.results import TimeRows
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.statistics import mean
from accelcal_cli.judge.errors import deviations_mg as deviations_of_points
from accelcal_cli.judge.errors import per_posture
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.judge.quality import Spread, by_block, deviations_mg, point_deviations_mg
from accelcal_cli.judge.verdict import temperatures_c
from accelcal_cli.output.quality import BlockErrors, Errors, PointErrors, QualityInput
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.facts import GAP_PERIODS
from accelcal_cli.pipeline.procedures import Method, TimedCellProcedure
from accelcal_cli.pipeline.survey import Observer

NOT_WORN_G, NOT_WORN_AXES = 0.05, 2
"""A device whose values stay within the first on so many axes for an hour is not worn (van Hees et al. 2011,
PLoS ONE 6(7): e22922; 2013, PLoS ONE 8(4): e61691)."""

LOOK_S = 5
"""Range and temperature are those of one sample in so long: looking at all would slow the pass."""

LEAST_LOOK_S = 900
"""So much of a block has to be measured to tell whether it was worn: a quarter of an hour."""

_SAMPLES, _STILL, _STILL_SAMPLES, _FILLED, _CLIPPED, _RECOVERED = range(6)
_GAP_S, _GAP_REST_US, _LOST_BYTES, _LOOKED, _WARM, _HEAT_MC = range(6, 12)
_COLUMNS = 12
_FLAGS = ((_FILLED, Validity.FILLED), (_CLIPPED, Validity.CLIPPED), (_RECOVERED, Validity.RECOVERED))
_FAR = 1 << 40
"""Beyond all counts."""


class Timeline(Observer):
    """Counts what a recording is made of along time.

    Args:
        block_samples: samples that make a block, as long as there are not too many.
        window_samples: samples of a window.
    """

    def __init__(self, recording: Recording, block_samples: int, window_samples: int) -> None:
        self.block_samples = block_samples
        self._window_samples = window_samples
        self._rate_hz, self._lsb_per_g = recording.rate_hz, recording.lsb_per_g
        self._step = max(1, round(LOOK_S * recording.rate_hz))
        self._sums = np.zeros((MAX_BLOCKS, _COLUMNS), np.int64)
        self._low = np.full((MAX_BLOCKS, 3), _FAR, np.int64)
        self._high = np.full((MAX_BLOCKS, 3), -_FAR, np.int64)
        self._samples = self._last_us = 0

    def see(self, chunk: Chunk) -> None:
        """Count a chunk's rows."""
        end = chunk.first_sample + len(chunk)
        self._make_room(end)
        self._note_damage(chunk.problems, end)
        if not len(chunk):
            return
        for block in range(chunk.first_sample // self.block_samples, 1 + (end - 1) // self.block_samples):
            begins, ends = (one * self.block_samples - chunk.first_sample for one in (block, block + 1))
            self._note_rows(block, chunk, max(0, begins), min(len(chunk), ends))
        self._note_gaps(chunk)
        self._samples = end
        self._last_us = int(chunk.clock.times(len(chunk) - 1, len(chunk))[0])

    def see_still(self, windows: Windows) -> None:
        """Count still windows where they begin."""
        block = windows.first_sample // self.block_samples
        np.add.at(self._sums[:, _STILL], block, 1)
        np.add.at(self._sums[:, _STILL_SAMPLES], block, windows.samples)

    def rows(self, block_samples: int) -> TimeRows:
        """What was found, in blocks of so many samples (a power of two times the first length) or more."""
        while self.block_samples < block_samples:
            self._longer()
        number = -(-self._samples // self.block_samples)
        sums, spread = self._sums[:number].copy(), (self._high - self._low)[:number]
        if number:
            sums[-1, _LOST_BYTES] += int(self._sums[number:, _LOST_BYTES].sum())
        unlike = sums[:, [_FILLED, _CLIPPED, _RECOVERED, _STILL_SAMPLES]].sum(axis=1)
        return TimeRows(
            block_samples=self.block_samples,
            samples=tuple(sums[:, _SAMPLES].tolist()),
            still=tuple(sums[:, _STILL].tolist()),
            moving=tuple((np.maximum(0, sums[:, _SAMPLES] - unlike) // self._window_samples).tolist()),
            filled=tuple(sums[:, _FILLED].tolist()),
            clipped=tuple(sums[:, _CLIPPED].tolist()),
            recovered=tuple(sums[:, _RECOVERED].tolist()),
            lost_bytes=tuple(sums[:, _LOST_BYTES].tolist()),
            gap_us=tuple(
                seconds * MICROSECONDS + rest for seconds, rest in sums[:, [_GAP_S, _GAP_REST_US]].tolist()
            ),
            temperature_mc=tuple(
                heat / number if number else None for number, heat in sums[:, [_WARM, _HEAT_MC]].tolist()
            ),
            worn=tuple(map(self._worn, sums.tolist(), spread.tolist())),
        )

    def result(self) -> TimeRows:
        """What was found, in blocks as they are."""
        return self.rows(self.block_samples)

    def _note_rows(self, block: int, chunk: Chunk, low: int, high: int) -> None:
        """Count the rows low..high-1 of a chunk, which lie in one block."""
        sums = self._sums[block]
        sums[_SAMPLES] += high - low
        first = low + -(chunk.first_sample + low) % self._step
        looked = slice(first, high, self._step)
        counts = chunk.counts[looked]
        if chunk.validity is not None:
            flags = chunk.validity[low:high]
            if flags.any():
                for column, flag in _FLAGS:
                    sums[column] += np.count_nonzero(flags == flag)
                counts = counts[chunk.validity[looked] != Validity.FILLED]
        if len(counts):
            sums[_LOOKED] += len(counts)
            np.minimum(self._low[block], counts.min(axis=0), out=self._low[block])
            np.maximum(self._high[block], counts.max(axis=0), out=self._high[block])
        if chunk.temperature_mc is not None:
            heat = chunk.temperature_mc[looked]
            sums[_WARM] += len(heat)
            sums[_HEAT_MC] += int(heat.sum(dtype=np.int64))

    def _note_gaps(self, chunk: Chunk) -> None:
        """Add up the time that is missing before rows; those of two columns do not overflow."""
        rows = chunk.breaks[chunk.breaks + chunk.first_sample > 0]
        if not len(rows):
            return
        time_us = chunk.time_us
        steps_us = time_us[rows] - np.where(rows > 0, time_us[rows - 1], self._last_us)
        gaps = steps_us / MICROSECONDS * self._rate_hz > GAP_PERIODS
        block = (rows[gaps] + chunk.first_sample) // self.block_samples
        np.add.at(self._sums[:, _GAP_S], block, steps_us[gaps] // MICROSECONDS)
        np.add.at(self._sums[:, _GAP_REST_US], block, steps_us[gaps] % MICROSECONDS)

    def _note_damage(self, problems: tuple[Problem, ...], end: int) -> None:
        for problem in problems:
            if problem.lost_bytes:
                block = min(problem.sample, end) // self.block_samples
                self._sums[block, _LOST_BYTES] += problem.lost_bytes

    def _make_room(self, sample: int) -> None:
        """Make blocks so long that a sample is in one of them."""
        while sample // self.block_samples >= MAX_BLOCKS:
            self._longer()

    def _longer(self) -> None:
        """Make two blocks one."""
        half = MAX_BLOCKS // 2
        pairs = self._sums.reshape(half, 2, _COLUMNS).sum(axis=1)
        low = self._low.reshape(half, 2, 3).min(axis=1)
        high = self._high.reshape(half, 2, 3).max(axis=1)
        self._sums = np.concatenate([pairs, np.zeros_like(pairs)])
        self._low = np.concatenate([low, np.full_like(low, _FAR)])
        self._high = np.concatenate([high, np.full_like(high, -_FAR)])
        self.block_samples *= 2

    def _worn(self, sums: list[int], spread: list[int]) -> bool | None:
        """Whether a device was worn in a block; None where too little of it was measured to tell."""
        if sums[_FILLED] == sums[_SAMPLES]:
            return False
        if sums[_LOOKED] * self._step < LEAST_LOOK_S * self._rate_hz:
            return None
        limit = NOT_WORN_G * self._lsb_per_g
        return sum(one < limit for one in spread) < NOT_WORN_AXES


def timeline_of(method: Method, recording: Recording) -> Timeline | None:
    """What counts along time; None for a procedure that keeps no blocks of time."""
    if not isinstance(method.procedure, TimedCellProcedure):
        return None
    return Timeline(recording, method.procedure.hour_samples, method.segmenter.length)


def along_time(
    data: ReportInput, raw: PointSet, posture: NDArray[np.int64], method: Method, timeline: Timeline
) -> QualityInput:
    """What the quality file says.

    Args:
        raw: the points; posture: (n,) number of each one's posture.
        method: with all still windows taken in, as the timeline has.
    """
    procedure, settings = method.procedure, data.settings.method
    assert isinstance(procedure, TimedCellProcedure) and isinstance(settings, Settings)
    in_time = procedure.collector.block_samples < ONE_BLOCK
    rows = timeline.rows(procedure.collector.block_samples if in_time else 0)
    samples = [block * rows.block_samples for block in range(len(rows))]
    judged = data.judgement
    return QualityInput(
        data=data,
        rows=rows,
        begun_us=[procedure.begun_us(sample) for sample in samples],
        errors=_block_errors(procedure.means(), rows.block_samples, judged.calibration, settings)
        if in_time
        else {},
        points=_point_errors(raw, posture, procedure, data),
        folds=settings.folds if judged.trials and judged.holdout is not None else None,
        convergence=_convergence(procedure.result(), data),
    )


def _block_errors(
    means: TimedMeans, block_samples: int, calibration: Calibration | None, settings: Settings
) -> dict[int, BlockErrors]:
    """Errors by the number of the block, of blocks at least as long as those of the observations."""
    assert means.windows is not None
    block, rest = means.block * means.block_samples // block_samples, settings.gravity
    before = by_block(deviations_mg(means, None, rest), means.windows, block)
    number = np.bincount(block, means.windows).astype(np.int64).tolist() if len(block) else []
    after = {}
    if calibration is not None:
        after = by_block(deviations_mg(means, calibration, rest), means.windows, block)
    return {
        one: BlockErrors(number[one], _errors(raw), _errors(after[one]) if one in after else None)
        for one, raw in before.items()
    }


def _errors(spread: Spread) -> Errors:
    return (spread.mean, spread.p95, *spread.off)


def _convergence(points: PointSet, data: ReportInput) -> tuple[float, ...] | None:
    """Mean error of the postures after each step of the fit [mg], as in the report's `fit`.

    Args:
        points: as they were fitted: put right where the sensor changed.
    """
    fit, settings = data.judgement.fit, data.settings.method
    if fit is None or not fit.history or fit.history[-1] != fit.parameters:
        return None
    assert isinstance(settings, Settings)
    label = postures(points, settings.posture_degrees)
    each = (per_posture(deviations_of_points(points, one), points.weights, label) for one in fit.history)
    return tuple(mean(list(one.values())) for one in each)


def _point_errors(
    raw: PointSet, posture: NDArray[np.int64], procedure: TimedCellProcedure, data: ReportInput
) -> PointErrors:
    """The points with their errors; of a sensor that changed, after it was put right, with new postures."""
    settings, calibration = data.settings.method, data.judgement.calibration
    assert isinstance(settings, Settings)
    rest, right = settings.gravity, raw
    if calibration is not None and calibration.correction is not None:
        right = procedure.collector.points(calibration.correction.in_local_g(rest.local_g()))
        posture = postures(right, settings.posture_degrees)
    return PointErrors(
        raw,
        point_deviations_mg(raw, None, rest),
        None if calibration is None else point_deviations_mg(right, calibration, rest),
        posture,
        temperatures_c(raw) if raw.temperature is not None else None,
    )
