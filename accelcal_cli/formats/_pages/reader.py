"""The reader that formats made of pages share: blocks of pages become chunks.

A format says where its pages lie (`files.py`), how a block of them is decoded (`PageDecoder`) and what times
they have (`timeline.py`); a `PageScheme` holds that together. An `Assembler` gives chunks their times, breaks
and problems across the borders of blocks, and `PagedReader` streams them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import ClassVar, Generic, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, PageClock
from accelcal_cli.core.recording import Chunk, Intake, Problem, Reader, Recording
from accelcal_cli.formats._pages.files import (
    AnyBlock,
    Block,
    Cutter,
    PagedFile,
    PageFile,
    RawBlock,
    is_erased,
)
from accelcal_cli.formats._pages.pages import BAD_KINDS, DAMAGED, ERASED, BadRun, Decoded, PageBlock
from accelcal_cli.formats._pages.timeline import NO_SPANS, Findings, PageTimeline, Spacing, Timeline, steps
from accelcal_cli.formats._problems import Event, Kind, ProblemLog
from accelcal_cli.formats._rows import MISSING, HeldChannels, RowFilter, first_values, missing_kind

FAULTY_ROWS = "missing_value", "samples without a usable value, left out"
BLANK_BYTES = 16
"""Least number of bytes of 0xFF at the end that were never written; fewer may belong to a number."""

BROKEN_OFF = "the compressed data is damaged or ends early"

LAST_PAGES, FIRST_ROWS, START_SAMPLES = 64, 1 << 16, 8192
"""Pages at the end of the data, rows, and samples that are read at a time in search of a valid one."""


class PageEvents:
    """Turns findings into events with their place in the file.

    Attributes:
        kinds: code and text for each kind of unusable page that is a problem.
        damaged: the kinds whose bytes are lost.
        unit: name of what a page is, for people.
        block: the block that is being read, which knows where its pages lie.

    Args:
        row_bytes: bytes of a page for each of its rows.
        channels: names of those that may lack values.
    """

    kinds: ClassVar[Mapping[int, Kind]] = BAD_KINDS
    damaged: ClassVar[Collection[int]] = DAMAGED
    unit: ClassVar[str] = "page or frame"
    block: Block

    def __init__(self, row_bytes: int, channels: Iterable[str]) -> None:
        self._row_bytes, self.channels = row_bytes, channels
        self._erased: BadRun | None = None

    def bad_pages(
        self, position: NDArray[np.int64], rows: NDArray[np.int64], bad: list[BadRun], rows_in: int
    ) -> Iterator[Event]:
        """Report unusable pages among valid ones (p,) with these usable rows, the first being `rows_in`.

        Erased ones are reported only once anything else follows them.
        """
        waiting, self._erased = [] if self._erased is None else [self._erased], None
        if not bad and not waiting:
            return
        sound = [*(run.position for run in bad if run.kind != ERASED), *position[-1:].tolist()]
        followed = max(sound, default=-1)
        rows_before = np.concatenate(([0], np.cumsum(rows))) + rows_in
        for run in [*waiting, *bad]:
            if run.kind == ERASED and run.position > followed:
                before = self._erased or BadRun(run.position, 0, ERASED)
                self._erased = replace(before, pages=before.pages + run.pages)
            elif run.kind in self.kinds:
                sample = int(rows_before[np.searchsorted(position, run.position)])
                lost = self.block.length(run.position, run.pages) if run.kind in self.damaged else 0
                event = self.event(run.position, self.kinds[run.kind], sample, run.pages)
                yield replace(event, length=run.pages, lost_bytes=lost)

    def event(self, position: int, kind: Kind, sample: int, count: int = 1) -> Event:
        """Return an event at a page that concerns `count` units."""
        return Event(position, 1, *kind, self.block.offset(position), sample, count)

    def findings(self, block: PageBlock, found: Findings, rows_in: int) -> Iterator[Event]:
        """Report findings about valid pages, of which `rows_in` is the first row, and about their rows."""
        yield from self.rows(block, rows_in)
        yield from self.links(block, found, rows_in)

    def rows(self, block: PageBlock, rows_in: int) -> Iterator[Event]:
        """Report rows without usable values, and samples without a value of a channel, page by page."""
        numbers = {FAULTY_ROWS: block.count_per_page(block.faulty)}
        for name in self.channels:
            numbers[missing_kind(name)] = block.count_per_page(block.channels[name] == MISSING)
        after = rows_in + np.cumsum(block.usable_rows)
        for page in np.flatnonzero(sum(numbers.values())).tolist():
            position, sample = int(block.position[page]), int(after[page])
            for kind, column in numbers.items():
                if count := int(column[page]):
                    lost_bytes = count * self._row_bytes if kind == FAULTY_ROWS else 0
                    yield replace(self.event(position, kind, sample, count), lost_bytes=lost_bytes)

    def links(self, block: PageBlock, found: Findings, rows_in: int) -> Iterator[Event]:
        """Report lost pages and jumps of the clock before the pages of a block."""
        samples = rows_in + np.cumsum(block.usable_rows) - block.usable_rows
        for kind, column in found.counts.items():
            for page in np.flatnonzero(column).tolist():
                yield self.event(int(block.position[page]), kind, int(samples[page]), int(column[page]))
        for kind, column in found.times_us.items():
            for page in np.flatnonzero(column).tolist():
                event = self.event(int(block.position[page]), kind, int(samples[page]))
                yield replace(event, amount_us=int(column[page]))

    def ending(self, leftover: bytes, rows_in: int, *, unused: bool) -> Iterator[Event]:
        """Report an incomplete page or frame at the end, unless it is erased flash like `unused` frames."""
        blank = len(leftover) >= BLANK_BYTES or self._erased is not None or unused
        block = self.block
        if not block.broken and is_erased(leftover) and (blank or not leftover):
            return
        cut_off = f"an incomplete {self.unit}"
        where = f"{BROKEN_OFF}; {cut_off}" if block.broken else f"{cut_off} at the end of the file"
        kind, offset = ("truncated", f"{where}, bytes left out"), block.end - len(leftover)
        event = Event(block.next_position, 1, *kind, offset, rows_in, len(leftover))
        yield replace(event, lost_bytes=len(leftover) + block.undecoded)


class PageDecoder(Generic[AnyBlock]):
    """Decodes the blocks of one pass over a file, in their order; a format subclasses it."""

    with_others = False
    """True if pages are to be decoded with the channel `others`."""

    def decode(self, block: AnyBlock) -> Decoded:
        """Return the valid pages of a block, and the others."""
        raise NotImplementedError

    def finish(self, chunk: Chunk) -> Chunk:
        """Add to a chunk of decoded rows what only the format knows, such as which are clipped."""
        return chunk

    def ending(self, block: AnyBlock, sample: int) -> tuple[Problem, ...]:
        """Return what is missing at the end of a whole file, after its last block and `sample` samples."""
        return ()


class Waiting(NamedTuple):
    """Pages that wait until their times are settled, and which of them (p,) do not continue those before."""

    block: PageBlock
    broken: NDArray[np.bool_]
    end_byte: int


class Assembler(Generic[AnyBlock]):
    """Takes the blocks of a file in order; gives a chunk for each as soon as all of its times are known.

    They are a `whole` file, or a piece that is read as a recording of its own, from row `sample` on.
    """

    def __init__(self, scheme: PageScheme[AnyBlock], sample: int, *, whole: bool) -> None:
        self._decoder, self._timeline, self._whole = scheme.decoder(), scheme.timeline(), whole
        self._decoder.with_others = scheme.with_others
        self._page_bytes = scheme.file.page_bytes
        self._row_bytes = self._page_bytes // scheme.spacing.rows
        channels = [name for name, value in scheme.first_values.items() if value is not None]
        self._events = scheme.events(self._row_bytes, channels)
        self._log = ProblemLog(scheme.problems if whole else ())
        self._channels, self._filter = HeldChannels(scheme.first_values), RowFilter()
        self._problems: tuple[Problem, ...] = ()
        self._waiting: deque[Waiting] = deque()
        self._spans, self._unused_end = NO_SPANS, False
        self._rows_in = self._rows_out = sample

    def feed(self, block: AnyBlock) -> Iterator[Chunk]:
        """Add a block; the last one releases everything. Problems go with the next chunk."""
        self._events.block = block
        self._add(decoded := self._decoder.decode(block), block)
        self._problems += self._log.take(None if block.last else block.next_position)
        while self._waiting and len(self._waiting[0].block) <= len(self._spans):
            chunk = self._chunk(self._waiting.popleft())
            if len(chunk) or chunk.problems or chunk.used_bytes:
                yield chunk
        if block.last and self._whole:
            self._problems += self._decoder.ending(block, self._rows_out)
        if self._problems and not self._waiting:
            nothing, _ = decoded.block.split(0)
            yield self._chunk(Waiting(nothing, np.empty(0, np.bool_), block.end_byte))

    def _add(self, decoded: Decoded, block: AnyBlock) -> None:
        pages, rows_in = decoded.block, self._rows_in
        placed = self._timeline.feed(pages, last=block.last)
        rows = pages.usable_rows
        self._rows_in += int(rows.sum())
        events = [
            *self._events.bad_pages(pages.position, rows, decoded.bad, rows_in),
            *self._events.findings(pages, placed.found, rows_in),
        ]
        if len(pages) or decoded.bad:
            self._unused_end = decoded.unused_end
        if block.last and decoded.leftover is not None:
            events += self._events.ending(decoded.leftover, self._rows_in, unused=self._unused_end)
        for event in sorted(events, key=lambda event: event.position):
            self._log.add(event)
        self._spans = self._spans.followed_by(placed.spans)
        if len(pages):
            self._waiting.append(Waiting(pages, placed.broken, block.end_byte))

    def _chunk(self, waiting: Waiting) -> Chunk:
        block = waiting.block
        problems, self._problems = self._problems, ()
        spans, self._spans = self._spans.split(len(block))
        first_row = np.cumsum(block.rows) - block.rows
        faults = 0 if block.faulty is None else int(block.faulty.sum())
        chunk = Chunk(
            first_sample=self._rows_out,
            counts=block.counts,
            clock=PageClock(first_row, spans.time_us, spans.span_rows, spans.span_us),
            end_byte=waiting.end_byte,
            breaks=first_row[waiting.broken],
            problems=problems,
            used_bytes=len(block) * self._page_bytes - faults * self._row_bytes,
            **self._channels.fill(block.channels),
        )
        chunk = self._filter.apply(chunk, block.faulty)
        self._rows_out += len(chunk)
        return self._decoder.finish(chunk)


@dataclass(frozen=True, slots=True)
class PageScheme(Generic[AnyBlock]):
    """Describes how the pages of one file are read.

    Attributes:
        spacing: rate and samples of a full page.
        decoder, timeline: make those of one pass over the file.
        events: makes the events.
        first_values: for each channel that may lack values, the first measured one, which the rows before it
            are given; None if none is measured.
        problems: what was found before the first page; given with the first chunk.
        with_others: see `Reader`.
    """

    file: PageFile[AnyBlock]
    spacing: Spacing
    decoder: Callable[[], PageDecoder[AnyBlock]]
    timeline: Callable[[], Timeline]
    events: type[PageEvents] = field(default=PageEvents, kw_only=True)
    first_values: Mapping[str, int | None] = field(default_factory=dict, kw_only=True)
    problems: tuple[Problem, ...] = field(default=(), kw_only=True)
    with_others: bool = field(default=False, kw_only=True)

    def assembler(self, sample: int = 0, *, whole: bool = True) -> Assembler[AnyBlock]:
        """Return an assembler for one pass over the file, or over a piece of it."""
        return Assembler(self, sample, whole=whole)

    def amount(self, chunk_samples: int) -> int:
        """Return the bytes of the file that make a chunk: whole pages, at least one."""
        return self.file.amount(chunk_samples // self.spacing.rows)

    def stream(self, chunk_samples: int, threads: int = 1) -> Generator[Chunk]:
        """Yield all rows of the file; `threads` may work at a time on a packed file."""
        assembler = self.assembler()
        with closing(self.file.blocks(self.amount(chunk_samples), threads=threads)) as blocks:
            for block in blocks:
                yield from assembler.feed(block)

    def first_time_us(self) -> int:
        """Return the time of the first sample [us]; raise StopIteration if there is none."""
        with closing(self.stream(START_SAMPLES)) as chunks:
            return int(next(filter(len, chunks)).clock.times(0, 1)[0])

    def pieces(self, chunk_samples: int, pieces: int) -> Iterator[tuple[int, AnyBlock]]:
        """Yield blocks spread evenly over the file, each with the number of its first sample.

        None if the file can only be read from its beginning.
        """
        for block in self.file.pieces(self.amount(chunk_samples), pieces):
            yield block.first_position * self.spacing.rows, block


class PageIntake(Intake, Generic[AnyBlock]):
    """Takes a file of pages as it grows."""

    def __init__(self, scheme: PageScheme[AnyBlock]) -> None:
        start = scheme.file.start_byte
        self._cutter, self._assembler = Cutter(scheme.file.scanner(start), start), scheme.assembler()
        self._skip, self._taken = start, 0

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        self._taken += len(data)
        skipped = min(self._skip, len(data))
        self._skip -= skipped
        block = self._cutter.cut(data[skipped:], self._taken, last=last)
        if last or len(block):
            yield from self._assembler.feed(block)


class PagedReader(Reader, Generic[AnyBlock]):
    """Streams the pages of a file; each call of `chunks` reads it from its beginning."""

    def __init__(self, recording: Recording, scheme: PageScheme[AnyBlock]) -> None:
        self.recording, self._scheme = recording, scheme

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, whole pages, at least one."""
        return replace(self._scheme, with_others=self.with_others).stream(chunk_samples, self.threads)

    def intake(self) -> Intake:
        """See `Reader`."""
        return PageIntake(self._scheme)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Enter the file at evenly spread places, or give its first chunks if that is not possible."""
        entered = False
        for sample, block in self._scheme.pieces(chunk_samples, pieces):
            entered = True
            yield from self._scheme.assembler(sample, whole=False).feed(block)
        if not entered:
            yield from super().preview(chunk_samples, pieces)


@dataclass(frozen=True, slots=True)
class FixedPages(PageScheme[RawBlock]):
    """Describes how a file of pages of one length is read."""

    file: PagedFile
    timeline: Callable[[], PageTimeline]

    def look_inside(self) -> PageBlock | None:
        """Return the first block with a valid page; None if there is none in the whole file."""
        for raw in self.file.blocks(self.amount(FIRST_ROWS)):
            block = self.decoder().decode(raw).block
            if len(block) and (block.faulty is None or not block.faulty.all()):
                return block
        return None

    def reader(
        self, opening: PageBlock, about: Recording, problems: Iterable[Problem], *, dated: bool
    ) -> PagedReader[RawBlock]:
        """Return the reader of a recording, completed by its first valid pages; times may have no date."""
        samples, duration_s = self.extent(opening)
        values = first_values(opening.channels)
        about = replace(
            about,
            start_us=self.timeline().start(opening) if dated else None,
            samples=samples,
            duration_s=duration_s,
            has_temperature=values.get("temperature_mc") is not None,
        )
        return PagedReader(about, replace(self, first_values=values, problems=tuple(problems)))

    def extent(self, opening: PageBlock) -> tuple[int | None, float | None]:
        """Return samples and seconds, by the first valid page and the last; None if these do not show it.

        The number of samples assumes that all pages between are full and present; it is None if the
        sequence numbers contradict that, and for a packed file, whose end is not known.
        """
        if self.file.compressed:
            return None, None
        ending = self.decoder().decode(self.file.last_block(LAST_PAGES)).block
        if not len(ending):
            return None, None
        (ends, _), (_, last) = opening.split(1), ending.split(len(ending) - 1)
        if last.position[0] > ends.position[0]:
            ends = ends.followed_by(last)
        step = steps(ends, self.spacing)
        timeline = self.timeline()
        links = timeline.link(ends, step, timeline.start(ends))
        rows = int(np.ptp(ends.position)) * self.spacing.rows + int(ends.rows[-1])
        lasted_us = int(np.ptp(links.time_us)) + float(self.spacing.rows_us(ends.rows[-1]))
        certain = ends.faulty is None and not step.missing.any()
        return rows if certain else None, lasted_us / MICROSECONDS
