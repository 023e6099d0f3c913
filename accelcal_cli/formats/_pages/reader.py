"""The reader that formats made of pages share: blocks of pages become chunks.

A format says where its pages lie (`files.py`), how a block of them is decoded (`PageDecoder`) and what times
they have (`timeline.py`); a `PageScheme` holds that together. A `PageJoiner` gives chunks their times, breaks
and problems across the borders of blocks, and `PagedReader` streams them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, PageClock
from accelcal_cli.core.recording import Chunk, Intake, Problem, Reader, Recording, cut_columns
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
from accelcal_cli.formats._pages.timeline import PageLinks, PageSteps, PageTimeline, Spacing, steps
from accelcal_cli.formats._problems import Event, ProblemLog
from accelcal_cli.formats._rows import MISSING, HeldChannels, RowFilter, first_values, missing_kind

MISSING_PAGES = "sequence_gap", "pages missing by their sequence numbers"
SEQUENCE_BACK = "sequence_back", "pages whose sequence number does not rise"
CLOCK_AHEAD = "clock_gap", "jumps of the device clock ahead"
CLOCK_BACK = "clock_back", "jumps of the device clock back"
FAULTY_ROWS = "missing_value", "samples without a usable value, left out"
BLANK_BYTES = 16
"""Least number of bytes of 0xFF at the end that were never written; fewer may belong to a number."""

CUT_OFF = "an incomplete page or frame at the end of the file, bytes left out"
BROKEN_OFF = "the compressed data is damaged or ends early"

NO_PAGES = np.empty(0, np.int64)

LAST_PAGES = 64
"""Pages before the end of the data among which the last valid page is looked for."""

FIRST_ROWS = 1 << 16
"""Rows that are decoded at a time until a page is valid."""

START_SAMPLES = 8192
"""Samples that are read at a time until the first one has its time."""


class EventMaker:
    """Turns findings into events with their place in the file.

    Attributes:
        block: the block that is being read, which knows where its pages lie.

    Args:
        kinds: code and text for each kind of unusable page that is a problem.
        damaged: the kinds whose bytes are lost.
    """

    block: Block

    def __init__(self, kinds: Mapping[int, tuple[str, str]], damaged: Collection[int]) -> None:
        self._kinds = kinds
        self._damaged = damaged
        self._erased: BadRun | None = None

    def bad_pages(
        self, position: NDArray[np.int64], rows: NDArray[np.int64], bad: list[BadRun], rows_in: int
    ) -> Iterator[Event]:
        """Report unusable pages; erased ones only once anything else follows them.

        Args:
            position, rows: (p,) of the valid pages among them, and their usable rows.
            bad: the unusable ones.
            rows_in: number of the first row.
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
            elif run.kind in self._kinds:
                sample = int(rows_before[np.searchsorted(position, run.position)])
                lost = self.block.length(run.position, run.pages) if run.kind in self._damaged else 0
                event = self.event(run.position, self._kinds[run.kind], sample, run.pages)
                yield replace(event, length=run.pages, lost_bytes=lost)

    def event(self, position: int, kind: tuple[str, str], sample: int, count: int = 1) -> Event:
        """Return an event at a page that concerns `count` units."""
        return Event(position, 1, *kind, self.block.offset(position), sample, count)


class PageEvents(EventMaker):
    """Turns what a PageJoiner finds into events.

    Args:
        row_bytes: bytes of a page for each of its rows.
        channels: names of those that may lack values.
    """

    def __init__(self, row_bytes: int, channels: Iterable[str]) -> None:
        super().__init__(BAD_KINDS, DAMAGED)
        self._row_bytes = row_bytes
        self._channels = channels

    def rows(self, block: PageBlock, rows_in: int) -> Iterator[Event]:
        """Report rows without usable values, and samples without a value of a channel, page by page."""
        numbers = {FAULTY_ROWS: block.count_per_page(block.faulty)}
        for name in self._channels:
            numbers[missing_kind(name)] = block.count_per_page(block.channels[name] == MISSING)
        after = rows_in + np.cumsum(block.usable_rows)
        for page in np.flatnonzero(sum(numbers.values())).tolist():
            position, sample = int(block.position[page]), int(after[page])
            for kind, column in numbers.items():
                if count := int(column[page]):
                    lost_bytes = count * self._row_bytes if kind == FAULTY_ROWS else 0
                    yield replace(self.event(position, kind, sample, count), lost_bytes=lost_bytes)

    def links(self, pages: PageBlock, step: PageSteps, links: PageLinks, rows_before: int) -> Iterator[Event]:
        """Report lost pages and jumps of the clock between pages."""
        samples = rows_before + np.cumsum(pages.usable_rows)
        columns = (step.missing, step.back, links.ahead_us, links.behind_us)
        for page in np.flatnonzero(np.logical_or.reduce(columns)).tolist():
            place, sample = int(pages.position[page + 1]), int(samples[page])
            missing, back, ahead, behind = (int(column[page]) for column in columns)
            if missing:
                yield self.event(place, MISSING_PAGES, sample, missing)
            if back:
                yield self.event(place, SEQUENCE_BACK, sample)
            if ahead:
                yield replace(self.event(place, CLOCK_AHEAD, sample), amount_us=ahead)
            if behind:
                yield replace(self.event(place, CLOCK_BACK, sample), amount_us=behind)

    def ending(self, leftover: bytes, rows_in: int, *, unused: bool) -> Iterator[Event]:
        """Report an incomplete page or frame at the end, unless it is erased flash.

        Args:
            unused: the frames before these bytes were never written.
        """
        blank = len(leftover) >= BLANK_BYTES or self._erased is not None or unused
        block = self.block
        if not block.broken and is_erased(leftover) and (blank or not leftover):
            return
        text = f"{BROKEN_OFF}; an incomplete page or frame, bytes left out" if block.broken else CUT_OFF
        offset = block.end - len(leftover)
        event = Event(block.next_position, 1, "truncated", text, offset, rows_in, len(leftover))
        yield replace(event, lost_bytes=len(leftover) + block.undecoded)


class PageDecoder(Generic[AnyBlock]):
    """Decodes the blocks of one pass over a file, in their order; a format subclasses it."""

    def decode(self, block: AnyBlock) -> Decoded:
        """Return the valid pages of a block, and the others."""
        raise NotImplementedError

    def finish(self, chunk: Chunk) -> Chunk:
        """Add to a chunk of decoded rows what only the format knows, such as which are clipped."""
        return chunk

    def ending(self, block: AnyBlock, chunk: Chunk) -> tuple[Problem, ...]:
        """Return what is missing at the end of a whole file.

        Args:
            block, chunk: the last ones.
        """
        return ()


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Pages whose times are settled: the block, and columns of shape (p,) as in PageClock."""

    block: PageBlock
    time_us: NDArray[np.int64]
    span_rows: NDArray[np.int64]
    span_us: NDArray[np.int64]
    broken: NDArray[np.bool_]

    def cut(self, pages: int) -> tuple[Stretch, Stretch]:
        """Return the first `pages` pages, and the rest."""
        above, below = self.block.split(pages)
        columns = ("time_us", "span_rows", "span_us", "broken")
        return (
            Stretch(above, **cut_columns(self, columns, slice(None, pages))),
            Stretch(below, **cut_columns(self, columns, slice(pages, None))),
        )


class Assembler(Generic[AnyBlock]):
    """Takes the blocks of a file in order and gives chunks as soon as their times are known."""

    def feed(self, block: AnyBlock) -> Iterator[Chunk]:
        """Add a block; the last one releases everything. Chunks have rows or problems."""
        raise NotImplementedError


class PageJoiner(Assembler[AnyBlock]):
    """Gives a chunk for each block.

    The last page is held back until the next one shows how long it lasted.

    Args:
        sample: number of the first row.
        whole: the blocks are a whole file, and not a piece that is read as a recording of its own.
    """

    def __init__(self, scheme: PageScheme[AnyBlock], sample: int, *, whole: bool) -> None:
        self._decoder = scheme.decoder()
        self._spacing = scheme.spacing
        self._timeline = scheme.timeline()
        self._whole = whole
        self._page_bytes = scheme.file.page_bytes
        self._row_bytes = self._page_bytes // scheme.spacing.rows
        channels = [name for name, value in scheme.first_values.items() if value is not None]
        self._events = PageEvents(self._row_bytes, channels)
        self._log = ProblemLog(scheme.problems if whole else ())
        self._channels = HeldChannels(scheme.first_values)
        self._filter = RowFilter()
        self._last: Stretch | None = None
        self._unused_end = False
        self._rows_in = self._rows_out = sample

    def feed(self, block: AnyBlock) -> Iterator[Chunk]:
        """See Assembler."""
        self._events.block = block
        chunk = self._decoder.finish(self._joined(block, self._decoder.decode(block)))
        if block.last and self._whole:
            chunk = replace(chunk, problems=chunk.problems + self._decoder.ending(block, chunk))
        if len(chunk) or chunk.problems:
            yield chunk

    def _joined(self, block: AnyBlock, decoded: Decoded) -> Chunk:
        pages = decoded.block
        rows = pages.usable_rows
        events = [*self._events.bad_pages(pages.position, rows, decoded.bad, self._rows_in)]
        events += self._events.rows(pages, self._rows_in)
        stretch = self._settled(pages, events)
        self._rows_in += int(rows.sum())
        if len(pages) or decoded.bad:
            self._unused_end = decoded.unused_end
        if block.last and decoded.leftover is not None:
            events += self._events.ending(decoded.leftover, self._rows_in, unused=self._unused_end)
        if not block.last and len(stretch.block):  # the last page waits for the one that follows it
            stretch, self._last = stretch.cut(len(stretch.block) - 1)
        for event in sorted(events, key=lambda event: event.position):
            self._log.add(event)
        problems = self._log.take(None if block.last else block.next_position)
        return self._chunk(stretch, block.end_byte, problems)

    def _settled(self, block: PageBlock, events: list[Event]) -> Stretch:
        """Return the held page and the new ones with their times."""
        last = self._last
        pages = block if last is None else last.block.followed_by(block)
        if not len(pages):
            return Stretch(pages, *(NO_PAGES,) * 3, NO_PAGES.astype(np.bool_))
        start_us = self._timeline.start(pages) if last is None else int(last.time_us[0])
        step = steps(pages, self._spacing)
        links = self._timeline.link(pages, step, start_us)
        before = self._rows_in - (0 if last is None else int(last.block.usable_rows.sum()))
        events += self._events.links(pages, step, links, before)
        return self._spread(pages, links, last is not None and bool(last.broken[0]))

    def _spread(self, pages: PageBlock, links: PageLinks, broken: bool) -> Stretch:
        """Spread each page up to the next, or at the nominal rate where no next one limits it."""
        lasted = np.diff(links.time_us)
        # a page before a gap, or before a clock that goes back, has no next page that limits it
        free = links.broken & ((lasted > self._spacing.rows_us(pages.rows[:-1])) | (links.behind_us > 0))
        free |= lasted <= 0
        rate = self._spacing.rate
        nominal_us = MICROSECONDS * rate.denominator
        return Stretch(
            pages,
            links.time_us,
            np.append(np.where(free, rate.numerator, pages.rows[:-1]), rate.numerator),
            np.append(np.where(free, nominal_us, lasted), nominal_us),
            np.append(broken, links.broken),
        )

    def _chunk(self, stretch: Stretch, end_byte: int, problems: tuple[Problem, ...]) -> Chunk:
        block = stretch.block
        first_row = np.cumsum(block.rows) - block.rows
        faults = 0 if block.faulty is None else int(block.faulty.sum())
        chunk = Chunk(
            first_sample=self._rows_out,
            counts=block.counts,
            clock=PageClock(first_row, stretch.time_us, stretch.span_rows, stretch.span_us),
            end_byte=end_byte,
            breaks=first_row[stretch.broken],
            problems=problems,
            used_bytes=len(block) * self._page_bytes - faults * self._row_bytes,
            **self._channels.fill(block.channels),
        )
        chunk = self._filter.apply(chunk, block.faulty)
        self._rows_out += len(chunk)
        return chunk


@dataclass(frozen=True, slots=True)
class FileScheme(Generic[AnyBlock]):
    """Describes how one file is read in blocks.

    Attributes:
        spacing: rate and samples of a full page.
        first_values: for each channel that may lack values, the first measured one, which the rows before it
            are given; None if none is measured.
        problems: what was found before the first page; given with the first chunk.
    """

    file: PageFile[AnyBlock]
    spacing: Spacing
    first_values: Mapping[str, int | None] = field(default_factory=dict, kw_only=True)
    problems: tuple[Problem, ...] = field(default=(), kw_only=True)

    def assembler(self, sample: int = 0, *, whole: bool = True) -> Assembler[AnyBlock]:
        """Return an assembler for one pass over the file; the arguments are those of PageJoiner."""
        raise NotImplementedError

    def amount(self, chunk_samples: int) -> int:
        """Return how much of the file makes a chunk: whole pages, at least one."""
        return self.file.amount(chunk_samples // self.spacing.rows)

    def stream(self, chunk_samples: int, threads: int = 1) -> Generator[Chunk]:
        """Yield all rows of the file; `threads` may work at a time on a gzip file."""
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


@dataclass(frozen=True, slots=True)
class PageScheme(FileScheme[AnyBlock]):
    """Describes how the pages of one file are read.

    Attributes:
        decoder: makes a decoder for one pass over the file.
        timeline: makes a timeline for one pass.
    """

    decoder: Callable[[], PageDecoder[AnyBlock]]
    timeline: Callable[[], PageTimeline]

    def assembler(self, sample: int = 0, *, whole: bool = True) -> PageJoiner[AnyBlock]:
        """See FileScheme."""
        return PageJoiner(self, sample, whole=whole)


class PageIntake(Intake, Generic[AnyBlock]):
    """Takes a file of pages as it grows."""

    def __init__(self, scheme: FileScheme[AnyBlock]) -> None:
        file = scheme.file
        self._cutter = Cutter(file.scanner(file.start_byte), file.start_byte)
        self._assembler = scheme.assembler()
        self._skip, self._taken = scheme.file.start_byte, 0

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

    def __init__(self, recording: Recording, scheme: FileScheme[AnyBlock]) -> None:
        self.recording = recording
        self._scheme = scheme

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, whole pages, at least one."""
        return self._scheme.stream(chunk_samples, self.threads)

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
class Opening:
    """The first block with a valid page.

    Attributes:
        block: the valid pages.
        start_us: time of the first sample.
        first_values: as in FileScheme.
    """

    block: PageBlock
    start_us: int
    first_values: dict[str, int | None]


@dataclass(frozen=True, slots=True)
class FixedPages(PageScheme[RawBlock]):
    """Describes how a file of pages of one length is read."""

    file: PagedFile

    def look_inside(self) -> Opening | None:
        """Read on until a page is valid; return None if there is none in the whole file."""
        for raw in self.file.blocks(self.amount(FIRST_ROWS)):
            block = self.decoder().decode(raw).block
            if len(block) and (block.faulty is None or not block.faulty.all()):
                return Opening(block, self.timeline().start(block), first_values(block.channels))
        return None

    def extent(self, opening: Opening) -> tuple[int | None, float | None]:
        """Return samples and seconds, by the first valid page and the last; None if these do not show it.

        The number of samples assumes that all pages between are full and present; it is None if the
        sequence numbers contradict that, and for a gzip file, whose end is not known.
        """
        if self.file.compressed:
            return None, None
        ending = self.decoder().decode(self.file.last_block(LAST_PAGES)).block
        if not len(ending):
            return None, None
        (ends, _), (_, last) = opening.block.split(1), ending.split(len(ending) - 1)
        if last.position[0] > ends.position[0]:
            ends = ends.followed_by(last)
        step = steps(ends, self.spacing)
        timeline = self.timeline()
        links = timeline.link(ends, step, timeline.start(ends))
        rows = int(np.ptp(ends.position)) * self.spacing.rows + int(ends.rows[-1])
        lasted_us = int(np.ptp(links.time_us)) + float(self.spacing.rows_us(ends.rows[-1]))
        certain = ends.faulty is None and not step.missing.any()
        return rows if certain else None, lasted_us / MICROSECONDS
