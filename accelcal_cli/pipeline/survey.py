"""The first pass over a recording: every chunk and every still window is shown, once, to all observers.

An `Observer` collects facts about a recording as it is read; a procedure (`procedures`) is one, too. Still
windows reach the observers in batches of a few thousand; the results depend neither on how they are batched
nor on the length of the chunks. Recordings are opened with `open_marked`, for this pass and any other, which
marks rows that are not measurements, or not whole ones, whatever the format.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.still_windows import Repetitions
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.points import WindowCounts, Windows, joined_windows
from accelcal_cli.core.recording import (
    Chunk,
    Intake,
    PlacedFile,
    Reader,
    Recording,
    Validity,
    clipped_at,
    in_columns,
)
from accelcal_cli.formats import open_recording
from accelcal_cli.pipeline.jobs import Progress
from accelcal_cli.segment.segmenter import Segmenter

BATCH_WINDOWS = 4096
"""Still windows that are shown to observers at a time."""

ZERO_RUN_S, LEAST_ZEROS = 0.5, 3
"""Length [s], and number of rows, from which on a run of exactly 0, 0, 0 was not measured. At rest there is
gravity; in a fall of half a second, which is 1.2 m, coarse counts may be zero."""


class Observer:
    """Finds something out along a recording; a subclass overrides what it needs."""

    def see(self, chunk: Chunk) -> None:
        """Take a chunk in, in the order of time."""

    def see_still(self, windows: Windows) -> None:
        """Take still windows in, in the order of time; their chunk has been seen."""

    def result(self) -> Any:
        """Return the facts; call after the last chunk."""
        raise NotImplementedError


class StillWindows(Observer):
    """Keeps all still windows, some 90 bytes each."""

    def __init__(self) -> None:
        self._parts: list[Windows] = []

    def see_still(self, windows: Windows) -> None:
        """Take windows in."""
        self._parts.append(windows)

    def result(self) -> Windows:
        """Return all windows."""
        return joined_windows(self._parts)


def survey(
    chunks: Iterable[Chunk],
    segmenter: Segmenter,
    observers: Sequence[Observer],
    progress: Progress = lambda _end_byte: None,
    threads: int = 1,
) -> None:
    """Show a recording's chunks, and its still windows except exact repetitions, to all observers.

    Args:
        chunks: of `open_marked`, so that rows at the sensor's range are not stillness.

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

    repetitions = Repetitions()
    for windows in repetitions.once(_batched(still())):
        for observer in observers:
            observer.see_still(windows)
    segmenter.counts += WindowCounts(still=-repetitions.windows, repeated=repetitions.windows)


def _batched(still: Iterable[Windows]) -> Iterator[Windows]:
    """Yield the windows a few thousand at a time; a batch has temperatures throughout, or none."""
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


def open_marked(
    path: Path,
    options: ReadOptions,
    threads: int = 1,
    unused: tuple[str, ...] = (),
    *,
    session: bool = False,
    joined: bool = False,
) -> Reader:
    """Open a recording; rows at the sensor's range, and runs of zeros, are marked in `validity`.

    Args:
        session, joined: see `formats.open_recording`.

    Raises:
        UnreadableError, UsageError: see `formats.open_recording`.
    """
    return MarkingReader(open_recording(path, options, threads, unused, session=session, joined=joined))


class MarkingReader(Reader):
    """Reads the chunks of another reader, and marks rows at the sensor's range and runs of zeros."""

    def __init__(self, reader: Reader) -> None:
        self.reader, self.recording, self.threads = reader, reader.recording, reader.threads

    @property
    def files(self) -> tuple[PlacedFile, ...]:  # type: ignore[override]
        """See `Reader`."""
        return self.reader.files

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`."""
        self.reader.with_others = self.with_others
        return self._marked(map(in_columns, self.reader.chunks(chunk_samples)))

    def intake(self) -> Intake:
        """See `Reader`."""
        return MarkingIntake(self.reader.intake(), self.recording)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """See `Reader`."""
        for chunk in self.reader.preview(chunk_samples, pieces):
            yield from self._marked([chunk])

    def close(self) -> None:
        """Release the file."""
        self.reader.close()

    def _marked(self, chunks: Iterable[Chunk]) -> Iterator[Chunk]:
        marks = ZeroRuns(self.recording)
        for chunk in chunks:
            yield from marks.add(with_clipping(chunk, self.recording))
        yield from marks.finish()


class MarkingIntake(Intake):
    """Takes chunks from another intake, and marks rows at the sensor's range and runs of zeros."""

    def __init__(self, intake: Intake, recording: Recording) -> None:
        self._intake, self._recording = intake, recording
        self._zeros = ZeroRuns(recording)

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        for chunk in self._intake.take(data, last=last):
            yield from self._zeros.add(with_clipping(chunk, self._recording))
        if last:
            yield from self._zeros.finish()


class ZeroRuns:
    """Marks long runs of rows that are exactly 0, 0, 0, in counts or in the file, wherever chunks end.

    A device that sleeps, or software that lacks samples, writes such rows. A chunk that ends in a run that
    may still become long enough waits for the next ones.
    """

    def __init__(self, recording: Recording) -> None:
        self._least = max(LEAST_ZEROS, ceil(ZERO_RUN_S * recording.rate_hz))
        self._zeros = {(0, 0, 0), recording.zero_counts}
        self._waiting: list[tuple[Chunk, int]] = []
        self._run = 0

    def add(self, chunk: Chunk) -> Iterator[Chunk]:
        """Take the next chunk; yield those that are settled, in their order."""
        if not len(chunk):
            yield from self._passed(chunk, 0 if self._waiting else None)
            return
        starts, ends = zero_runs(chunk.counts, self._least, self._zeros)
        lengths = ends - starts
        leads, trails = (bool(len(ends)) and there for there in (starts[:1] == 0, ends[-1:] == len(chunk)))
        if leads:
            lengths[0] += self._run
        long = lengths >= self._least
        if not (leads and ends[0] == len(chunk) and not long[0]):
            yield from self._released(filled=bool(leads and long[0]))
        self._run = int(lengths[-1]) if trails else 0
        undecided = trails and not long[-1]
        yield from self._passed(_filled(chunk, starts[long], ends[long]), starts[-1] if undecided else None)

    def finish(self) -> Iterator[Chunk]:
        """Yield the chunks that still wait: nothing follows."""
        return self._released(filled=False)

    def _passed(self, chunk: Chunk, undecided: int | None) -> Iterator[Chunk]:
        """Yield a chunk, or let it wait if zeros that begin at a row are undecided."""
        if undecided is None:
            yield chunk
        else:
            self._waiting.append((chunk, undecided))

    def _released(self, *, filled: bool) -> Iterator[Chunk]:
        waiting, self._waiting = self._waiting, []
        for chunk, start in waiting:
            yield _filled(chunk, np.array([start]), np.array([len(chunk)])) if filled else chunk


def zero_runs(
    counts: NDArray[Any], least: int, zeros: Iterable[tuple[int, int, int]] = ((0, 0, 0),)
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where runs of zeros begin and end; none if no run of `least` rows can be among them.

    A run that long holds one of each `least` rows; a shorter one that matters reaches the first or last row.

    Args:
        zeros: rows that count as such.
    """
    looked = counts[::least], counts[-1:]
    if not any(_equal(rows, row).any() for rows in looked for row in zeros):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    found = np.logical_or.reduce([_equal(counts, row) for row in zeros])
    edges = np.flatnonzero(np.diff(found, prepend=False, append=False))
    return edges[::2], edges[1::2]


def _equal(counts: NDArray[Any], row: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Mark the rows (n, 3) that equal one, (n,)."""
    x, y, z = counts.T
    equal: NDArray[np.bool_] = (x == row[0]) & (y == row[1]) & (z == row[2])
    return equal


def _filled(chunk: Chunk, starts: NDArray[np.int64], ends: NDArray[np.int64]) -> Chunk:
    """Return the chunk with the rows of some runs marked as filled, unless they are of a damaged block."""
    if not len(starts):
        return chunk
    edges = np.zeros(len(chunk) + 1, np.int8)
    edges[starts], edges[ends] = 1, -1
    validity = np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity.copy()
    validity[(np.cumsum(edges[:-1]) > 0) & (validity != Validity.RECOVERED)] = Validity.FILLED
    return replace(chunk, validity=validity)


def with_clipping(chunk: Chunk, recording: Recording) -> Chunk:
    """Return the chunk with rows at the sensor's range marked in `validity`.

    Counts that the maker has calibrated no longer show the range; their reader has marked the rows.
    """
    if recording.range_g is None or recording.of_bare_sensor:
        return chunk
    limit = int(recording.range_g * recording.lsb_per_g)
    return clipped_at(chunk, -limit, limit - 1)
