"""The first pass over a recording: every chunk and every still window, once, to all observers.

An `Observer` collects facts about a recording as it is read. Still windows reach the observers in batches of
a few thousand; the results depend neither on how they are batched nor on the length of the chunks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.collect.cells import norms_g
from accelcal_cli.core.clock import ZoneChange, utc_offset_s, zone_change
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.points import Windows, joined_windows
from accelcal_cli.core.recording import Chunk, Problem, Reader, Recording, Validity
from accelcal_cli.core.results import Facts, Gap, Jumps
from accelcal_cli.formats import open_recording
from accelcal_cli.pipeline.jobs import Progress
from accelcal_cli.segment.segmenter import Segmenter

BATCH_WINDOWS = 4096
MAX_GAPS = 1000
MAX_PROBLEMS = 1000
GAP_PERIODS = 1.5
PLAUSIBLE_ERROR_G = 0.5


class Observer:
    """Finds something out along a recording; a subclass overrides what it needs."""

    def see(self, chunk: Chunk) -> None:
        """Take a chunk in, in the order of time."""

    def see_still(self, windows: Windows) -> None:
        """Take still windows in, in the order of time; their chunk has been seen."""

    def result(self) -> Any:
        """What was found; call after the last chunk."""
        raise NotImplementedError


def survey(
    chunks: Iterable[Chunk],
    segmenter: Segmenter,
    observers: Sequence[Observer],
    progress: Progress = lambda _end_byte: None,
    threads: int = 1,
) -> None:
    """Show a recording's chunks, and its still windows, to all observers.

    Args:
        chunks: of `open_marked`, so that rows at the sensor's range are no stillness.

    Raises:
        UnreadableError: the recording cannot be read on.
    """

    def still() -> Iterator[Windows]:
        for chunk in prefetch(iter(chunks), threads):
            for observer in observers:
                observer.see(chunk)
            yield from segmenter.feed(chunk)
            progress(chunk.end_byte)
        yield from segmenter.finish()

    for windows in _batched(still()):
        for observer in observers:
            observer.see_still(windows)


def _batched(still: Iterable[Windows]) -> Iterator[Windows]:
    """The same windows a few thousand at a time; a batch has temperatures throughout, or none."""
    batch: list[Windows] = []
    number = 0
    for windows in still:
        if batch and (batch[0].temperature_sums is None) != (windows.temperature_sums is None):
            yield joined_windows(batch)
            batch, number = [], 0
        batch.append(windows)
        number += len(windows)
        if number >= BATCH_WINDOWS:
            yield joined_windows(batch)
            batch, number = [], 0
    if batch:
        yield joined_windows(batch)


def open_marked(path: Path, options: ReadOptions, threads: int = 1) -> Reader:
    """Open a recording; rows at the sensor's range are marked in their chunks' `validity`.

    Raises:
        UnreadableError, UsageError: see `formats.open_recording`.
    """
    return MarkingReader(open_recording(path, options, threads))


class MarkingReader(Reader):
    """A reader of another one's chunks, with rows at the sensor's range marked."""

    def __init__(self, reader: Reader) -> None:
        self.reader, self.recording, self.threads = reader, reader.recording, reader.threads

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`."""
        return (with_clipping(chunk, self.recording) for chunk in self.reader.chunks(chunk_samples))

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """See `Reader`."""
        return (with_clipping(chunk, self.recording) for chunk in self.reader.preview(chunk_samples, pieces))

    def close(self) -> None:
        """Release the file."""
        self.reader.close()


def with_clipping(chunk: Chunk, recording: Recording) -> Chunk:
    """The chunk with rows at the sensor's range marked in `validity`."""
    if recording.range_g is None or not len(chunk):
        return chunk
    limit = int(recording.range_g * recording.lsb_per_g)
    low, high = -limit, limit - 1
    if chunk.counts.min() > low and chunk.counts.max() < high:
        return chunk
    clipped = ((chunk.counts <= low) | (chunk.counts >= high)).any(axis=1)
    validity = np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity.copy()
    validity[clipped & (validity == Validity.MEASURED)] = Validity.CLIPPED
    return replace(chunk, validity=validity)


class FactsObserver(Observer):
    """The facts of a recording.

    Args:
        rest_lsb: raw counts that rest should measure.
    """

    def __init__(self, recording: Recording, rest_lsb: float) -> None:
        self.recording = recording
        self.rest_lsb = rest_lsb
        self.samples = self.filled = self.clipped = 0
        self.first_us: int | None = None
        self.last_us: int | None = None
        self.has_temperature = self.has_gyroscope = False
        self.gaps: list[Gap] = []
        self.gaps_omitted = self._gap_us = self._back = 0
        self.problems: list[Problem] = []
        self._problems_omitted = 0
        self._lost_bytes = self._used_bytes = 0
        self._run_start_us = self._run_first = 0
        self._run_steps = self._run_us = 0
        self._still_ng = self._still_windows = 0

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
        self.samples += len(chunk)

    def see_still(self, windows: Windows) -> None:
        """Take still windows' raw errors in, as whole nano-g so that the sum is exact.

        Windows of less than 0.5 or more than 1.5 g, such as zeros, are not rest under gravity.
        """
        error_g = np.abs(norms_g(windows, self.rest_lsb) - 1)
        plausible = np.rint(error_g[error_g < PLAUSIBLE_ERROR_G] * 1e9).astype(np.int64)
        self._still_ng += int(plausible.sum())
        self._still_windows += len(plausible)

    def result(self) -> Facts:
        """What was found; call after the last chunk."""
        problems = list(self.problems)
        if self._problems_omitted:
            text = f"{self._problems_omitted} further problems are not listed"
            problems.append(Problem("more_problems", text, None, self.samples, self._problems_omitted))
        return Facts(
            self.samples,
            self.first_us,
            self.last_us,
            self._rate_hz(),
            tuple(self.gaps),
            self.gaps_omitted,
            tuple(problems),
            self.filled,
            self.clipped,
            self.has_temperature,
            self.has_gyroscope,
            self._still_ng / self._still_windows / 1e6 if self._still_windows else None,
            self._utc_offset_s(),
            self._lost_bytes,
            self._used_bytes,
            Jumps(len(self.gaps) + self.gaps_omitted - self._back, self._gap_us, self._back),
            self._zone_change(),
        )

    @property
    def _dated(self) -> bool:
        return all(problem.code != "no_start_time" for problem in self.problems)

    def _utc_offset_s(self) -> int | None:
        """Of the device's clock at the start; None for a recording without a date."""
        return utc_offset_s(self.recording.timezone, self.first_us or 0) if self._dated else None

    def _zone_change(self) -> ZoneChange | None:
        zone = self.recording.timezone
        known = self._dated and self.first_us is not None and self.last_us is not None
        return zone_change(zone, self.first_us or 0, self.last_us or 0) if known else None

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

    def _note_times(self, chunk: Chunk) -> None:
        if self.first_us is None:
            self.first_us = self._run_start_us = int(chunk.clock.times(0, 1)[0])
        for row in chunk.breaks.tolist():
            if self.samples + row:
                self._break(chunk, row)
        self.last_us = int(chunk.clock.times(len(chunk) - 1, len(chunk))[0])

    def _break(self, chunk: Chunk, row: int) -> None:
        before = int(chunk.clock.times(row - 1, row)[0]) if row else (self.last_us or 0)
        after = int(chunk.clock.times(row, row + 1)[0])
        sample = self.samples + row
        self._run_us += before - self._run_start_us
        self._run_steps += sample - self._run_first - 1
        self._run_start_us, self._run_first = after, sample
        seconds = (after - before) / 1e6
        if abs(seconds) * self.recording.rate_hz <= GAP_PERIODS and seconds > 0:
            return
        if seconds > 0:
            self._gap_us += after - before
        else:
            self._back += 1
        if len(self.gaps) < MAX_GAPS:
            self.gaps.append(Gap(sample, before, seconds))
        else:
            self.gaps_omitted += 1
