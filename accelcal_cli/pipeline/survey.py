"""The first pass over a recording: every chunk and every still window is shown, once, to all observers.

An `Observer` collects facts about a recording as it is read; a procedure (`procedures`) is one, too. Still
windows reach the observers in batches of a few thousand; the results depend neither on how they are batched
nor on the length of the chunks. Recordings are opened with `open_marked`, for this pass and any other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from accelcal_cli.collect.still_windows import Repetitions
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.points import WindowCounts, Windows, joined_windows
from accelcal_cli.core.recording import Chunk, Intake, PlacedFile, Reader, Recording, clipped_at, in_columns
from accelcal_cli.formats import open_recording
from accelcal_cli.pipeline.jobs import Progress
from accelcal_cli.segment.segmenter import Segmenter

BATCH_WINDOWS = 4096
"""Still windows that are shown to observers at a time."""


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
    """Show a recording's chunks, and its still windows but for exact repetitions, to all observers.

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
) -> Reader:
    """Open a recording; rows at the sensor's range are marked in their chunks' `validity`.

    Args:
        session: see `formats.open_recording`.

    Raises:
        UnreadableError, UsageError: see `formats.open_recording`.
    """
    return MarkingReader(open_recording(path, options, threads, unused, session=session))


class MarkingReader(Reader):
    """Reads the chunks of another reader, and marks rows at the sensor's range."""

    def __init__(self, reader: Reader) -> None:
        self.reader, self.recording, self.threads = reader, reader.recording, reader.threads

    @property
    def files(self) -> tuple[PlacedFile, ...]:  # type: ignore[override]
        """See `Reader`."""
        return self.reader.files

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`."""
        chunks = map(in_columns, self.reader.chunks(chunk_samples))
        return map(partial(with_clipping, recording=self.recording), chunks)

    def intake(self) -> Intake:
        """See `Reader`."""
        return MarkingIntake(self.reader.intake(), self.recording)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """See `Reader`."""
        return (with_clipping(chunk, self.recording) for chunk in self.reader.preview(chunk_samples, pieces))

    def close(self) -> None:
        """Release the file."""
        self.reader.close()


class MarkingIntake(Intake):
    """Takes chunks from another intake, and marks rows at the sensor's range."""

    def __init__(self, intake: Intake, recording: Recording) -> None:
        self._intake, self._recording = intake, recording

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        return (with_clipping(chunk, self._recording) for chunk in self._intake.take(data, last=last))


def with_clipping(chunk: Chunk, recording: Recording) -> Chunk:
    """Return the chunk with rows at the sensor's range marked in `validity`.

    Counts that the maker has calibrated no longer show the range; their reader has marked the rows.
    """
    if recording.range_g is None or recording.of_bare_sensor:
        return chunk
    limit = int(recording.range_g * recording.lsb_per_g)
    return clipped_at(chunk, -limit, limit - 1)
