"""The facts of a recording: what its first pass counts besides stillness."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.rest import RestSums
from accelcal_cli.core.clock import MICROSECONDS, utc_offset_s
from accelcal_cli.core.local_time import FOLLOWED, ZoneChange, zone_changes
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, Problem, Recording, Validity
from accelcal_cli.core.results import Facts, Gap, Jumps, SampleCounts
from accelcal_cli.pipeline.survey import Observer
from accelcal_cli.segment.segmenter import NO_GAPS, ShortGaps

MAX_GAPS = 1000
MAX_PROBLEMS = 1000
GAP_PERIODS = 1.5


class FactsObserver(Observer):
    """The facts of a recording.

    Args:
        rest_lsb: raw counts that rest should measure.
        short: jumps that end no window; those back by a period at most end no run for the measured rate
            either (where a late stamp makes the next go back by more, the gap before it ended one, too).
    """

    def __init__(self, recording: Recording, rest_lsb: float, short: ShortGaps = NO_GAPS) -> None:
        self.recording = recording
        self._jitter_us = min(short.longest_us, round(MICROSECONDS / recording.rate_hz))
        self._rest = RestSums(rest_lsb)
        self.samples = self.filled = self.clipped = 0
        self.first_us: int | None = None
        self.last_us: int | None = None
        self.has_temperature = self.has_gyroscope = False
        self.gaps: list[Gap] = []
        self.gaps_omitted = self._gap_us = self._back = 0
        self.problems: list[Problem] = []
        self._problems_omitted = self._followed = 0
        self._lost_bytes = self._used_bytes = 0
        self._run_start_us = self._run_first = 0
        self._run_steps = self._run_us = 0

    def see(self, chunk: Chunk) -> None:
        """Take a chunk's facts in."""
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
        self.samples += len(chunk)

    def see_still(self, windows: Windows) -> None:
        """Take in what still windows measure."""
        self._rest.add_windows(windows)

    def result(self) -> Facts:
        """What was found; call after the last chunk."""
        problems = list(self.problems)
        if self._problems_omitted:
            text = f"{self._problems_omitted} further problems are not listed"
            problems.append(Problem("more_problems", text, None, self.samples, self._problems_omitted))
        return Facts(
            samples=self.samples,
            first_us=self.first_us,
            last_us=self.last_us,
            rate_hz=self._rate_hz(),
            gaps=tuple(self.gaps),
            gaps_omitted=self.gaps_omitted,
            problems=tuple(problems),
            counts=SampleCounts(self.filled, self.clipped),
            has_temperature=self.has_temperature,
            has_gyroscope=self.has_gyroscope,
            rest=self._rest.result(),
            utc_offset_s=utc_offset_s(self.recording.timezone, self.first_us or 0) if self._dated else None,
            lost_bytes=self._lost_bytes,
            used_bytes=self._used_bytes,
            jumps=Jumps(len(self.gaps) + self.gaps_omitted - self._back, self._gap_us, self._back),
            zone_change=self._zone_change(),
        )

    @property
    def _dated(self) -> bool:
        return all(problem.code != "no_start_time" for problem in self.problems)

    def _zone_change(self) -> ZoneChange | None:
        """The first change that the times do not follow; else the first one."""
        zone = self.recording.timezone
        if not self._dated or self.first_us is None or self.last_us is None:
            return None
        end_us = max((self.last_us, *(end for _, end in self._jumps_of_stamps())))
        changes = [*islice(zone_changes(zone, self.first_us, end_us), self._followed + 1)]
        if len(changes) > self._followed:
            return replace(changes[-1], followed=None if self._unseen(changes[-1]) else False)
        return replace(changes[0], followed=True) if changes else None

    def _unseen(self, change: ZoneChange) -> bool:
        """Whether no rows show if the times follow a change."""
        start_s = utc_offset_s(self.recording.timezone, self.first_us or 0) or 0
        at_us = change.at_us + (start_s - change.before_s) * MICROSECONDS
        omitted = self.recording.stamped and self.gaps_omitted > 0
        return omitted or any(start < at_us <= end for start, end in self._jumps_of_stamps())

    def _jumps_of_stamps(self) -> list[tuple[int, int]]:
        """From when to when a change may hide behind a jump of a clock that may have followed it [us].

        One that goes back by less than an hour may be put back after a pause.
        """
        gaps = self.gaps if self.recording.stamped else []
        return [(gap.start_us, gap.start_us + round(abs(gap.seconds) * 1e6)) for gap in gaps]

    def _rate_hz(self) -> float | None:
        """Steps over time within unbroken runs, the last of which is still open."""
        if self.last_us is None:
            return None
        span_us = self._run_us + self.last_us - self._run_start_us
        steps = self._run_steps + self.samples - self._run_first - 1
        return steps * 1e6 / span_us if span_us > 0 and steps > 0 else None

    def _note_problems(self, problems: tuple[Problem, ...]) -> None:
        left = MAX_PROBLEMS - len(self.problems)
        self.problems += problems[:left]
        self._problems_omitted += len(problems[left:])
        self._lost_bytes += sum(problem.lost_bytes for problem in problems)
        if self.recording.stamped:
            self._followed += sum(problem.count for problem in problems if problem.code == FOLLOWED)

    def _note_times(self, chunk: Chunk) -> None:
        if self.first_us is None:
            self.first_us = self._run_start_us = int(chunk.clock.times(0, 1)[0])
        rows = chunk.breaks[chunk.breaks + self.samples > 0]
        if len(rows):
            self._note_breaks(rows, chunk)
        self.last_us = int(chunk.clock.times(len(chunk) - 1, len(chunk))[0])

    def _note_breaks(self, rows: NDArray[np.int64], chunk: Chunk) -> None:
        """The breaks before these rows of a chunk; a step back that is jitter ends no run.

        All at once: a damaged file may have a break before each row.
        """
        time_us = chunk.time_us
        before, after = np.where(rows > 0, time_us[rows - 1], self.last_us or 0), time_us[rows]
        steps_us = after - before
        jitter = np.isin(rows, chunk.clock_jumps) & (steps_us < 0) & (steps_us >= -self._jitter_us)
        if not jitter.all():
            self._end_runs(rows[~jitter], before[~jitter], after[~jitter])
        self._note_gaps(rows, before, steps_us)

    def _end_runs(self, rows: NDArray[np.int64], before: NDArray[np.int64], after: NDArray[np.int64]) -> None:
        """Runs that end before these rows; sums of times are of Python's integers, which do not overflow."""
        first = self.samples + int(rows[-1])
        self._run_us += sum(before.tolist()) - sum(after[:-1].tolist()) - self._run_start_us
        self._run_steps += first - self._run_first - len(rows)
        self._run_start_us, self._run_first = int(after[-1]), first

    def _note_gaps(
        self, rows: NDArray[np.int64], before: NDArray[np.int64], steps_us: NDArray[np.int64]
    ) -> None:
        seconds = steps_us / 1e6
        jumps = (seconds <= 0) | (seconds * self.recording.rate_hz > GAP_PERIODS)
        self._gap_us += sum(steps_us[jumps & (seconds > 0)].tolist())
        self._back += int((seconds <= 0).sum())
        places = np.flatnonzero(jumps)
        listed = places[: MAX_GAPS - len(self.gaps)]
        columns = (self.samples + rows[listed], before[listed], seconds[listed])
        self.gaps += map(Gap, *(column.tolist() for column in columns))
        self.gaps_omitted += len(places) - len(listed)
