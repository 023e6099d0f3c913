"""log.bin as a stream of chunks."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass

from accelcal_cli.core.recording import Chunk, Problem
from accelcal_cli.formats._problems import ProblemLog
from accelcal_cli.formats.gt3x.archive import Archive, Member, MemberStream
from accelcal_cli.formats.gt3x.records import Batch, Framer, Span
from accelcal_cli.formats.gt3x.sensors import Samples, Sensor
from accelcal_cli.formats.gt3x.timeline import (
    ChunkPlace,
    RowSpan,
    Timeline,
    chunk_of,
    cut,
    fault_problem,
    groups,
)

PIECE_BYTES = 3 << 18
"""log.bin is taken in equal spans, so that nothing depends on the size of the chunks."""

MOST_ROWS = 1 << 18


def batches(stream: MemberStream, span: Span) -> Iterator[Batch]:
    """All records of log.bin, piece by piece.

    Raises:
        UnreadableError: the disk fails.
    """
    framer = Framer(span)
    last = False
    while not last:
        data = stream.read(PIECE_BYTES)
        last = len(data) < PIECE_BYTES
        yield framer.feed(data, last=last)


@dataclass(frozen=True, slots=True)
class LogFile:
    """A log.bin whose settings are known.

    Attributes:
        problems: what was found before any sample.
    """

    archive: Archive
    member: Member
    sensor: Sensor
    span: Span
    problems: tuple[Problem, ...] = ()

    def stream(self, chunk_samples: int) -> Generator[Chunk, None, None]:
        """All chunks, of at least a second.

        Raises:
            UnreadableError: the disk fails.
        """
        most = max(chunk_samples, self.sensor.rate)
        timeline, log = Timeline(self.sensor, self.span), ProblemLog(self.problems)
        rows = 0
        with MemberStream(self.archive, self.member) as source:
            for batch in batches(source, self.span):
                spans, samples, events = timeline.feed(batch)
                for event in events:
                    log.add(event)
                problems = log.take(None if batch.page.last else timeline.position)
                if batch.page.last and (fault := fault_problem(source, timeline.rows)) is not None:
                    problems += (fault,)
                place = ChunkPlace(rows, source.disk_position, batch.records.framed_bytes())
                for chunk in chunks_of(spans, samples, place, problems):
                    rows += len(chunk)
                    yield from cut(chunk, most)


def chunks_of(
    spans: list[RowSpan], samples: Samples, place: ChunkPlace, problems: tuple[Problem, ...]
) -> Iterator[Chunk]:
    """Chunks of a batch's spans; problems and bytes go with the first, which may be empty."""
    parts = list(groups(spans, MOST_ROWS)) or ([[]] if problems or place.used_bytes else [])
    rows, used = place.first_sample, place.used_bytes
    for part in parts:
        chunk = chunk_of(part, samples, ChunkPlace(rows, place.end_byte, used), problems)
        problems, used, rows = (), 0, rows + len(chunk)
        yield chunk
