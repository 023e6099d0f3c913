"""Observers of the first pass: facts of a recording and of each block of time, and its gyroscope."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import islice
from math import ceil, isfinite, isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import MAX_BLOCKS, ONE_BLOCK
from accelcal_cli.collect.still_windows import RestSums
from accelcal_cli.collect.turns import GyroWindows, TurnCollector
from accelcal_cli.core.arithmetic import mean
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.clock import MICROSECONDS, RESET_US, Stretches, utc_offset_s
from accelcal_cli.core.gyroscope import Gyroscope, Turns
from accelcal_cli.core.local_time import FOLLOWED, ZoneChange, zone_changes
from accelcal_cli.core.points import PointSet, TimedMeans, Windows
from accelcal_cli.core.recording import CUT_SHORT, Chunk, Problem, Recording, Validity
from accelcal_cli.core.results import Facts, Gap, Judgement, Jumps, SampleCounts, TimeRows
from accelcal_cli.core.settings import DEFAULT, Settings
from accelcal_cli.judge.errors import deviations_mg as deviations_of_points
from accelcal_cli.judge.errors import per_posture, temperatures_c
from accelcal_cli.judge.gyroscope import judge_gyroscope, judge_revolutions
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.judge.quality import ErrorSpread, by_block, deviations_mg, point_deviations_mg
from accelcal_cli.output.quality import BlockErrors, Errors, PointErrors, QualityInput
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.procedures import Method, TimedCellProcedure
from accelcal_cli.pipeline.survey import Observer
from accelcal_cli.segment import MOST_SQUARES, still_rule
from accelcal_cli.segment.segmenter import NO_GAPS, Blocks, Segmenter, ShortGaps, centred_squares, exact_sums

# Counts of the first pass besides stillness: facts of the whole recording, and of each block of time.
#
# A block of time is an hour of samples; where there are more than MAX_BLOCKS of them, blocks are
# twice as long, and so on, so that memory is bounded. All counts are integers: the length of the
# chunks makes no difference.

MAX_GAPS = 1000
"""Most gaps that a report lists."""

MAX_PROBLEMS = 1000
"""Most problems that a report lists."""

GAP_PERIODS = 1.5
"""Length [sampling periods] of a step between samples beyond which it is a gap."""

NOT_WORN_G, NOT_WORN_AXES = 0.05, 2
"""A device is not worn in an hour in which values stay within NOT_WORN_G on NOT_WORN_AXES axes (van Hees et
al. 2011, PLoS ONE 6(7): e22922; 2013, PLoS ONE 8(4): e61691)."""

LOOK_S = 5
"""Distance [s] of the samples that range and temperature are taken from; all would slow the pass."""

LEAST_LOOK_S = 900
"""Part [s] of a block that has to be measured to tell whether the device was worn."""

_SAMPLES, _STILL, _STILL_SAMPLES, _FILLED, _CLIPPED, _RECOVERED = range(6)
_GAP_S, _GAP_REST_US, _LOST_BYTES, _LOOKED, _WARM, _HEAT_MC = range(6, 12)
_COLUMNS = 12
_FLAGS = ((_FILLED, Validity.FILLED), (_CLIPPED, Validity.CLIPPED), (_RECOVERED, Validity.RECOVERED))
_FAR = 1 << 40
"""A number beyond all counts."""


class FactsObserver(Observer):
    """Finds the facts of a recording.

    Args:
        rest_lsb: raw counts that rest should measure.
        short: jumps that end no window. Those back by a period at most do not end a run of the measured rate
            either; where a late stamp makes the next go back by more, the gap before it has ended one.
    """

    def __init__(self, recording: Recording, rest_lsb: float, short: ShortGaps = NO_GAPS) -> None:
        self.recording = recording
        self._jitter_us = min(short.longest_us, round(MICROSECONDS / recording.rate_hz))
        self._rest = RestSums(rest_lsb)
        self.filled = self.clipped = 0
        self._stretches = Stretches(round(MICROSECONDS / recording.rate_hz))
        self.has_temperature = self.has_gyroscope = False
        self.gaps: list[Gap] = []
        self.gaps_omitted = self._gaps = self._gap_us = self._back = 0
        self.problems: list[Problem] = []
        self._problems_omitted = self._followed = 0
        self._damaged_bytes = self._missing_bytes = self._used_bytes = self._empty_rows = 0
        self._cut_short = False
        self._run_start_us = self._run_first = 0
        self._run_steps = self._run_us = 0

    def see(self, chunk: Chunk) -> None:
        """Take a chunk in."""
        self._note_problems(chunk.problems)
        self._used_bytes += chunk.used_bytes
        if not len(chunk):
            return
        self.has_temperature |= chunk.temperature_mc is not None
        self.has_gyroscope |= chunk.gyro_counts is not None
        if chunk.validity is not None:
            self.filled += int((chunk.validity == Validity.FILLED).sum())
            self.clipped += int((chunk.validity == Validity.CLIPPED).sum())
        self._note_times(chunk)
        self._rest.add_samples(chunk)

    def see_still(self, windows: Windows) -> None:
        """Take still windows in."""
        self._rest.add_windows(windows)

    def result(self) -> Facts:
        """Return the facts; call after the last chunk."""
        problems = list(self.problems)
        if self._problems_omitted:
            text = f"{self._problems_omitted} further problems are not listed"
            problems.append(Problem("more_problems", text, None, self.samples, self._problems_omitted))
        return Facts(
            samples=self.samples,
            first_us=self._stretches.first_us,
            last_us=self._stretches.last_us,
            rate_hz=self._rate_hz(),
            gaps=tuple(self.gaps),
            gaps_omitted=self.gaps_omitted,
            problems=tuple(problems),
            counts=SampleCounts(self.filled, self.clipped),
            has_temperature=self.has_temperature,
            has_gyroscope=self.has_gyroscope,
            rest=self._rest.result(),
            utc_offset_s=utc_offset_s(self.recording.timezone, self._stretches.first_us or 0)
            if self._dated
            else None,
            damaged_bytes=self._damaged_bytes,
            missing_bytes=self._missing_bytes,
            used_bytes=self._used_bytes,
            empty_rows=self._empty_rows,
            cut_short=self._cut_short,
            jumps=Jumps(self._gaps, self._gap_us, self._back),
            span_us=self._stretches.span_us,
            resets=tuple(self._stretches.resets),
            zone_change=self._zone_change(),
        )

    @property
    def samples(self) -> int:
        """Number of rows so far."""
        return self._stretches.samples

    @property
    def _dated(self) -> bool:
        return all(problem.code != "no_start_time" for problem in self.problems)

    def _zone_change(self) -> ZoneChange | None:
        """Return the first change of the zone that the times do not follow, else the first one."""
        zone, first_us = self.recording.timezone, self._stretches.first_us
        if not self._dated or first_us is None:
            return None
        end_us = max((first_us + self._stretches.span_us, *(end for _, end in self._jumps_of_stamps())))
        changes = [*islice(zone_changes(zone, first_us, end_us), self._followed + 1)]
        if len(changes) <= self._followed:
            return replace(changes[0], followed=True) if changes else None
        change, start_s = changes[-1], utc_offset_s(zone, first_us) or 0
        at_us = change.at_us + (start_s - change.before_s) * MICROSECONDS
        unseen = self.recording.stamped and self.gaps_omitted > 0
        unseen |= any(start < at_us <= end for start, end in self._jumps_of_stamps())
        return replace(change, followed=None if unseen else False)  # None: no rows show it

    def _jumps_of_stamps(self) -> list[tuple[int, int]]:
        """Return the spans [us] of jumps of a clock, which may have followed a change of the zone there.

        A clock that goes back by less than an hour may have been put back after a pause.
        """
        gaps = self.gaps if self.recording.stamped else []
        spans = ((gap.start_us, round(abs(gap.seconds) * MICROSECONDS)) for gap in gaps)
        return [(start, start + length) for start, length in spans if length <= RESET_US]

    def _rate_hz(self) -> float | None:
        """Return steps over time within unbroken runs, the last of which is still open."""
        last_us = self._stretches.last_us
        if last_us is None:
            return None
        span_us = self._run_us + last_us - self._run_start_us
        steps = self._run_steps + self.samples - self._run_first - 1
        return steps * 1e6 / span_us if span_us > 0 and steps > 0 else None

    def _note_problems(self, problems: tuple[Problem, ...]) -> None:
        left = MAX_PROBLEMS - len(self.problems)
        self.problems += problems[:left]
        self._problems_omitted += len(problems[left:])
        self._damaged_bytes += sum(problem.lost_bytes for problem in problems)
        self._empty_rows += sum(problem.empty_rows for problem in problems)
        self._missing_bytes += sum(problem.missing_bytes for problem in problems)
        self._cut_short |= any(problem.code == CUT_SHORT for problem in problems)
        if self.recording.stamped:
            self._followed += sum(problem.count for problem in problems if problem.code == FOLLOWED)

    def _note_times(self, chunk: Chunk) -> None:
        first = self.samples
        rows = chunk.breaks[chunk.breaks + first > 0]
        before, after = self._stretches.add(chunk.clock, len(chunk), rows)
        if not first:
            self._run_start_us = self._stretches.first_us or 0
        if not len(rows):
            return
        # All at once: a damaged file may have a break before each row. Jitter, a step back, ends no run.
        steps_us = after - before
        jitter = np.isin(rows, chunk.clock_jumps) & (steps_us < 0) & (steps_us >= -self._jitter_us)
        if len(ends := np.flatnonzero(~jitter)):
            # Sums of times are of Python's integers, which do not overflow.
            end, begun = first + int(rows[ends[-1]]), after[ends]
            self._run_us += sum(before[ends].tolist()) - sum(begun[:-1].tolist()) - self._run_start_us
            self._run_steps += end - self._run_first - len(ends)
            self._run_start_us, self._run_first = int(begun[-1]), end
        self._note_gaps(first + rows, before, steps_us)

    def _note_gaps(
        self, samples: NDArray[np.int64], before: NDArray[np.int64], steps_us: NDArray[np.int64]
    ) -> None:
        seconds = steps_us / 1e6
        jumps = (seconds <= 0) | (seconds * self.recording.rate_hz > GAP_PERIODS)
        gaps = jumps & (seconds > 0) & (steps_us <= RESET_US)
        self._gaps += int(gaps.sum())
        self._gap_us += sum(steps_us[gaps].tolist())
        self._back += int((seconds <= 0).sum())
        places = np.flatnonzero(jumps)
        listed = places[: MAX_GAPS - len(self.gaps)]
        columns = (samples[listed], before[listed], seconds[listed])
        self.gaps += map(Gap, *(column.tolist() for column in columns))
        self.gaps_omitted += len(places) - len(listed)


class Timeline(Observer):
    """Counts samples, stillness and damage in each block of time.

    Args:
        block_samples: length of a block, as long as there are not too many.
        window_samples: length of a window.
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
        while end // self.block_samples >= MAX_BLOCKS:
            self._join_pairs()
        for problem in chunk.problems:
            if lost := problem.lost_bytes + problem.missing_bytes:
                self._sums[min(problem.sample, end) // self.block_samples, _LOST_BYTES] += lost
        if not len(chunk):
            return
        for block in range(chunk.first_sample // self.block_samples, 1 + (end - 1) // self.block_samples):
            begins, ends = (one * self.block_samples - chunk.first_sample for one in (block, block + 1))
            self._note_rows(block, chunk, max(0, begins), min(len(chunk), ends))
        self._note_gaps(chunk)
        self._samples = end
        self._last_us = int(chunk.clock.times(len(chunk) - 1, len(chunk))[0])

    def see_still(self, windows: Windows) -> None:
        """Count still windows in the blocks in which they begin."""
        block = windows.first_sample // self.block_samples
        np.add.at(self._sums[:, _STILL], block, 1)
        np.add.at(self._sums[:, _STILL_SAMPLES], block, windows.samples)

    def rows(self, block_samples: int) -> TimeRows:
        """Return the counts in blocks of at least `block_samples`, a power of two times the first length."""
        while self.block_samples < block_samples:
            self._join_pairs()
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
        """Return the counts in blocks as they are."""
        return self.rows(self.block_samples)

    def _note_rows(self, block: int, chunk: Chunk, low: int, high: int) -> None:
        """Count rows low..high-1 of a chunk, which lie in one block."""
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
        """Add up the time that is missing before rows, in two columns, which do not overflow."""
        rows = chunk.breaks[chunk.breaks + chunk.first_sample > 0]
        if not len(rows):
            return
        time_us = chunk.time_us
        steps_us = time_us[rows] - np.where(rows > 0, time_us[rows - 1], self._last_us)
        gaps = (steps_us / MICROSECONDS * self._rate_hz > GAP_PERIODS) & (steps_us <= RESET_US)
        block = (rows[gaps] + chunk.first_sample) // self.block_samples
        np.add.at(self._sums[:, _GAP_S], block, steps_us[gaps] // MICROSECONDS)
        np.add.at(self._sums[:, _GAP_REST_US], block, steps_us[gaps] % MICROSECONDS)

    def _join_pairs(self) -> None:
        half = MAX_BLOCKS // 2
        pairs = self._sums.reshape(half, 2, _COLUMNS).sum(axis=1)
        low = self._low.reshape(half, 2, 3).min(axis=1)
        high = self._high.reshape(half, 2, 3).max(axis=1)
        self._sums = np.concatenate([pairs, np.zeros_like(pairs)])
        self._low = np.concatenate([low, np.full_like(low, _FAR)])
        self._high = np.concatenate([high, np.full_like(high, -_FAR)])
        self.block_samples *= 2

    def _worn(self, sums: list[int], spread: list[int]) -> bool | None:
        """Return True if the device was worn in a block; None if too little was measured to tell."""
        if sums[_FILLED] == sums[_SAMPLES]:
            return False
        if sums[_LOOKED] * self._step < LEAST_LOOK_S * self._rate_hz:
            return None
        limit = NOT_WORN_G * self._lsb_per_g
        return sum(one < limit for one in spread) < NOT_WORN_AXES


def timeline_of(method: Method, recording: Recording) -> Timeline | None:
    """Return what counts along time; None if the procedure keeps no blocks of time."""
    if not isinstance(method.procedure, TimedCellProcedure):
        return None
    return Timeline(recording, method.procedure.hour_samples, method.segmenter.length)


def along_time(
    data: ReportInput, raw: PointSet, posture: NDArray[np.int64], method: Method, timeline: Timeline
) -> QualityInput:
    """Return the content of the quality file.

    Args:
        raw: the points before a correction for a change of the sensor.
        posture: (n,) number of each point's posture.
        method: its procedure and `timeline` have taken all still windows in.
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
    """Return the errors by number of the block; blocks are at least as long as those of the means."""
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


def _errors(spread: ErrorSpread) -> Errors:
    return (spread.mean, spread.p95, *spread.off)


def _convergence(points: PointSet, data: ReportInput) -> tuple[float, ...] | None:
    """Return the mean error of the postures after each step of the fit [mg], as in the report's `fit`.

    Args:
        points: as they were fitted, corrected where the sensor changed.
    """
    fit, settings = data.judgement.fit, data.settings.method
    if fit is None or not fit.history or fit.history[-1] != fit.parameters:
        return None
    assert isinstance(settings, Settings)
    label = postures(points, settings.posture_degrees)
    straight = points.straightened(fit.bend)
    held = (points if one == IDENTITY else straight for one in fit.history)
    pairs = zip(held, fit.history, strict=True)
    each = (per_posture(deviations_of_points(own, one), points.weights, label) for own, one in pairs)
    return tuple(mean(list(one.values())) for one in each)


def _point_errors(
    raw: PointSet, posture: NDArray[np.int64], procedure: TimedCellProcedure, data: ReportInput
) -> PointErrors:
    """Return the points with their errors; where the sensor changed, corrected and with new postures."""
    settings, calibration = data.settings.method, data.judgement.calibration
    assert isinstance(settings, Settings)
    rest, corrected = settings.gravity, raw
    if calibration is not None and calibration.correction is not None:
        corrected = procedure.collector.points(calibration.correction.in_local_g(rest.local_g()))
        posture = postures(corrected, settings.posture_degrees)
    return PointErrors(
        raw,
        point_deviations_mg(raw, None, rest),
        None if calibration is None else point_deviations_mg(corrected, calibration, rest),
        posture,
        temperatures_c(raw) if raw.temperature is not None else None,
    )


# The gyroscope along the first pass: when it rests, and what it does between one rest and the next.
#
# It has windows of its own, a second long, and looks at both sensors: the borders of a rest matter
# more here than in a calibration of the accelerometer, and a slow turn that the accelerometer does
# not see shows in the angular rate (G 4.4 asks both). The windows of the accelerometer, and what it
# is calibrated by, stay as they are.

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
