"""The reader that all dumps of fixed-size pages share.

Blocks of decoded pages become chunks, with times, breaks and problems across block borders. What is wrong
with pages, between pages and with rows goes to the problem log as events.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, PageClock
from accelcal_cli.core.recording import Chunk, Intake, Problem, Reader, Recording, cut_columns
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages.pages import (
    BadRun,
    Block,
    Decoded,
    PageBlock,
    PageCutter,
    PagedFile,
    Places,
    RawBlock,
)
from accelcal_cli.formats._pages.timeline import Links, Spacing, Steps, Timeline, steps
from accelcal_cli.formats._problems import Event, ProblemLog
from accelcal_cli.formats._rows import MISSING, HeldChannels, RowFilter, first_values, missing_kind

MISSING_PAGES = "sequence_gap", "pages missing by their sequence numbers"
SEQUENCE_BACK = "sequence_back", "pages whose sequence number does not rise"
CLOCK_AHEAD = "clock_gap", "jumps of the device clock ahead"
CLOCK_BACK = "clock_back", "jumps of the device clock back"
FAULTY_ROWS = "missing_value", "samples without a usable value, left out"
BLANK_BYTES = 16
"""A few bytes of 0xFF may belong to a number; so many, or after erased ones, were never written."""

CUT_OFF = "bytes of an incomplete page or frame at the end of the file, left out"
BROKEN_OFF = "the compressed data is damaged or ends early; bytes of an incomplete page or frame, left out"

NO_PAGES = np.empty(0, np.int64)

LAST_PAGES = 64
FIRST_ROWS = 1 << 16


class EventMaker:
    """Turns findings into events with their place in the file.

    Args:
        kinds: code and text of the kinds of unusable pages; those of other kinds are no matter.
        damaged: the kinds whose bytes are lost.
    """

    def __init__(self, file: Places, kinds: Mapping[int, tuple[str, str]], damaged: Collection[int]) -> None:
        self._file = file
        self._kinds = kinds
        self._damaged = damaged
        self._erased: BadRun | None = None

    def bad_pages(
        self, position: NDArray[np.int64], rows: NDArray[np.int64], bad: list[BadRun], rows_in: int
    ) -> Iterator[Event]:
        """Unusable pages. Erased ones are held back until anything else follows them.

        Args:
            position, rows: (p,) of the valid pages among them, and their usable rows.
            bad: the unusable ones.
            rows_in: number of the first row.
        """
        waiting, self._erased = [] if self._erased is None else [self._erased], None
        if not bad and not waiting:
            return
        sound = [*(run.position for run in bad if run.kind != paged.ERASED), *position[-1:].tolist()]
        followed = max(sound, default=-1)
        rows_before = np.concatenate(([0], np.cumsum(rows))) + rows_in
        for run in [*waiting, *bad]:
            if run.kind == paged.ERASED and run.position > followed:
                self._hold(run)
            elif run.kind in self._kinds:
                sample = int(rows_before[np.searchsorted(position, run.position)])
                lost = self._file.length(run.position, run.pages) if run.kind in self._damaged else 0
                event = self.event(run.position, self._kinds[run.kind], sample, run.pages)
                yield replace(event, length=run.pages, lost_bytes=lost)

    def _hold(self, run: BadRun) -> None:
        before = self._erased or BadRun(run.position, 0, paged.ERASED)
        self._erased = BadRun(before.position, before.pages + run.pages, paged.ERASED)

    def event(self, position: int, kind: tuple[str, str], sample: int, count: int = 1) -> Event:
        """So many units at a page."""
        return Event(position, 1, *kind, self._file.offset(position), sample, count)


class PageEvents(EventMaker):
    """Of pages as a PageJoiner takes them.

    Args:
        row_bytes: bytes of a page for each of its rows.
        first_values: as in PageJoiner.
    """

    def __init__(self, file: Places, row_bytes: int, first_values: Mapping[str, int | None]) -> None:
        super().__init__(file, paged.BAD_KINDS, paged.DAMAGED)
        self._row_bytes = row_bytes
        self._held = [name for name, value in first_values.items() if value is not None]

    def rows(self, block: PageBlock, rows_in: int) -> Iterator[Event]:
        """Rows without usable values, and samples without a value of a channel, page by page."""
        numbers = {FAULTY_ROWS: paged.per_page(block, block.faulty)}
        for name in self._held:
            numbers[missing_kind(name)] = paged.per_page(block, block.channels[name] == MISSING)
        after = rows_in + np.cumsum(paged.page_rows(block))
        for page in np.flatnonzero(sum(numbers.values())).tolist():
            position, sample = int(block.position[page]), int(after[page])
            for kind, column in numbers.items():
                if count := int(column[page]):
                    lost_bytes = count * self._row_bytes if kind == FAULTY_ROWS else 0
                    yield replace(self.event(position, kind, sample, count), lost_bytes=lost_bytes)

    def links(self, pages: PageBlock, step: Steps, links: Links, rows_before: int) -> Iterator[Event]:
        """What stands between pages."""
        samples = rows_before + np.cumsum(paged.page_rows(pages))
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

    def ending(self, raw: Block, leftover: bytes, rows_in: int, *, unused: bool) -> Iterator[Event]:
        """An incomplete page or frame at the end, unless it is erased flash.

        Args:
            unused: the frames before these bytes were never written.
        """
        blank = len(leftover) >= BLANK_BYTES or self._erased is not None or unused
        if not raw.broken and paged.is_erased(leftover) and (blank or not leftover):
            return
        position = raw.next_position
        offset = self._file.offset(position) + len(raw.tail) - len(leftover)
        text = BROKEN_OFF if raw.broken else CUT_OFF
        lost = len(leftover) + raw.undecoded
        event = Event(position, 1, "truncated", text, offset, rows_in, len(leftover))
        yield replace(event, lost_bytes=lost)


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Pages whose times are settled: the block, and columns of shape (p,) as in PageClock."""

    block: PageBlock
    time_us: NDArray[np.int64]
    span_rows: NDArray[np.int64]
    span_us: NDArray[np.int64]
    broken: NDArray[np.bool_]

    def cut(self, pages: int) -> tuple[Stretch, Stretch]:
        """The first `pages` pages, and the rest."""
        above, below = paged.split(self.block, pages)
        columns = ("time_us", "span_rows", "span_us", "broken")
        return (
            Stretch(above, **cut_columns(self, columns, slice(None, pages))),
            Stretch(below, **cut_columns(self, columns, slice(pages, None))),
        )


class PageJoiner:
    """Takes blocks of decoded pages in order and gives a chunk for each.

    The last page is held back until the next one shows how long it lasted.

    Args:
        sample: number of the first row.
        first_values: of channels that may lack values, the first measured one, which rows before it are
            given; None where none is measured.
        problems: what was found before any page.
    """

    def __init__(
        self,
        file: Places,
        spacing: Spacing,
        timeline: Timeline,
        sample: int,
        first_values: Mapping[str, int | None],
        problems: tuple[Problem, ...],
    ) -> None:
        self._spacing = spacing
        self._timeline = timeline
        self._page_bytes, self._row_bytes = file.page_bytes, file.page_bytes // spacing.rows
        self._events = PageEvents(file, self._row_bytes, first_values)
        self._log = ProblemLog(problems)
        self._channels = HeldChannels(first_values)
        self._filter = RowFilter()
        self._last: Stretch | None = None
        self._unused_end = False
        self._rows_in = self._rows_out = sample

    def feed(self, raw: Block, decoded: Decoded) -> Chunk:
        """Add a block; the last one releases the held page too."""
        block = decoded.block
        rows = paged.page_rows(block)
        events = [*self._events.bad_pages(block.position, rows, decoded.bad, self._rows_in)]
        events += self._events.rows(block, self._rows_in)
        stretch = self._settled(block, events)
        self._rows_in += int(rows.sum())
        if len(block) or decoded.bad:
            self._unused_end = decoded.unused_end
        if raw.last:
            events += self._events.ending(raw, decoded.leftover, self._rows_in, unused=self._unused_end)
        elif len(stretch.block):
            stretch, self._last = stretch.cut(len(stretch.block) - 1)
        for event in sorted(events, key=lambda event: event.position):
            self._log.add(event)
        scanned = None if raw.last else raw.next_position
        return self._chunk(stretch, raw.end_byte, self._log.take(scanned))

    def _settled(self, block: PageBlock, events: list[Event]) -> Stretch:
        """Times of the held page and the new ones."""
        last = self._last
        pages = block if last is None else paged.joined(last.block, block)
        if not len(pages):
            return Stretch(pages, *(NO_PAGES,) * 3, NO_PAGES.astype(np.bool_))
        start_us = self._timeline.start(pages) if last is None else int(last.time_us[0])
        step = steps(pages, self._spacing)
        links = self._timeline.link(pages, step, start_us)
        before = self._rows_in - (0 if last is None else int(paged.page_rows(last.block).sum()))
        events += self._events.links(pages, step, links, before)
        return self._spread(pages, links, last is not None and bool(last.broken[0]))

    def _spread(self, pages: PageBlock, links: Links, broken: bool) -> Stretch:
        """Spread each page up to the next, or at the nominal rate where no next one limits it."""
        lasted = np.diff(links.time_us)
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
        chunk = Chunk(
            first_sample=self._rows_out,
            counts=block.counts,
            clock=PageClock(first_row, stretch.time_us, stretch.span_rows, stretch.span_us),
            end_byte=end_byte,
            breaks=first_row[stretch.broken],
            problems=problems,
            used_bytes=self._used_bytes(block),
            **self._channels.fill(block.channels),
        )
        chunk = self._filter.apply(chunk, block.faulty)
        self._rows_out += len(chunk)
        return chunk

    def _used_bytes(self, block: PageBlock) -> int:
        faults = 0 if block.faulty is None else int(block.faulty.sum())
        return len(block) * self._page_bytes - faults * self._row_bytes


@dataclass(frozen=True, slots=True)
class PageScheme:
    """How to read the pages of one file.

    Attributes:
        decode: turns a block into valid pages and the rest.
        timeline: makes a fresh timeline.
    """

    file: PagedFile
    spacing: Spacing
    decode: Callable[[RawBlock], Decoded]
    timeline: Callable[[], Timeline]


@dataclass(frozen=True, slots=True)
class Opening:
    """What the first block with a valid page shows.

    Attributes:
        block: its valid pages.
        start_us: time of the first sample.
        first_values: as in PageJoiner.
    """

    block: PageBlock
    start_us: int
    first_values: dict[str, int | None]


def look_inside(scheme: PageScheme) -> Opening | None:
    """Read on until a page is valid; None if there is none in the whole file."""
    pages = scheme.file.fitting(FIRST_ROWS // scheme.spacing.rows)
    for raw in scheme.file.blocks(pages):
        block = scheme.decode(raw).block
        if len(block) and (block.faulty is None or not block.faulty.all()):
            return Opening(block, scheme.timeline().start(block), first_values(block.channels))
    return None


def extent(scheme: PageScheme, opening: Opening) -> tuple[int | None, float | None]:
    """Samples and seconds, by the first valid page and the last; None if these do not show it.

    The number of samples takes all pages between for full and present; it is None if the
    sequence numbers contradict that, and for a gzip file, whose end is not known.
    """
    last = None if scheme.file.compressed else last_page(scheme)
    if last is None:
        return None, None
    ends, _ = paged.split(opening.block, 1)
    if last.position[0] > ends.position[0]:
        ends = paged.joined(ends, last)
    step = steps(ends, scheme.spacing)
    timeline = scheme.timeline()
    links = timeline.link(ends, step, timeline.start(ends))
    rows = int(np.ptp(ends.position)) * scheme.spacing.rows + int(ends.rows[-1])
    lasted_us = int(np.ptp(links.time_us)) + float(scheme.spacing.rows_us(ends.rows[-1]))
    certain = ends.faulty is None and not step.missing.any()
    return rows if certain else None, lasted_us / MICROSECONDS


def last_page(scheme: PageScheme) -> PageBlock | None:
    """The last valid page, looked for among the last few before erased ones; None if not there."""
    pages = scheme.file.fitting(LAST_PAGES)
    first = max(0, scheme.file.data_pages() - pages)
    with closing(scheme.file.blocks(pages + 1, first)) as blocks:
        block = scheme.decode(next(blocks)).block
    return paged.split(block, len(block) - 1)[1] if len(block) else None


def first_time(stream: Generator[Chunk]) -> int:
    """Time of the first sample of chunks, at least one of which has any [us]."""
    with closing(stream) as chunks:
        return int(next(chunk for chunk in chunks if len(chunk)).clock.times(0, 1)[0])


class PageIntake(Intake):
    """Takes a dump of pages as it grows."""

    def __init__(self, file: PagedFile, decode: Callable[[RawBlock], Decoded], joiner: PageJoiner) -> None:
        self._cutter, self._decode, self._joiner = PageCutter(file), decode, joiner

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        raw = self._cutter.cut(data, last=last)
        if len(raw.pages) or last:
            yield self._joiner.feed(raw, self._decode(raw))


class PagedReader(Reader):
    """Streams the pages of a dump; each call of `chunks` reads the file from its beginning.

    Args:
        problems: what was found while opening; reported with the first chunk.
    """

    def __init__(
        self, recording: Recording, scheme: PageScheme, opening: Opening, problems: tuple[Problem, ...] = ()
    ) -> None:
        self.recording = recording
        self._scheme = scheme
        self._opening = opening
        self._problems = problems

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, whole pages, at least one."""
        joiner = self._joiner(0, self._problems)
        for raw in self._scheme.file.blocks(self._pages(chunk_samples), threads=self.threads):
            chunk = joiner.feed(raw, self._scheme.decode(raw))
            if len(chunk) or chunk.problems:
                yield chunk

    def intake(self) -> Intake:
        """See `Reader`."""
        return PageIntake(self._scheme.file, self._scheme.decode, self._joiner(0, self._problems))

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Enter the file at evenly spread pages; a gzip file gives its first chunks."""
        if self._scheme.file.compressed:
            yield from super().preview(chunk_samples, pieces)
            return
        total = self._scheme.file.data_pages()
        pages = min(self._pages(chunk_samples), max(1, total // max(1, pieces)))
        for piece in range(min(pieces, max(1, total))):
            chunk = self._piece(piece * total // pieces, pages)
            if len(chunk) or chunk.problems:
                yield chunk

    def _piece(self, position: int, pages: int) -> Chunk:
        with closing(self._scheme.file.blocks(pages, position)) as blocks:
            raw = next(blocks)
        joiner = self._joiner(position * self._scheme.spacing.rows, ())
        whole = replace(raw, last=True, tail=raw.tail if raw.last else b"")
        return joiner.feed(whole, self._scheme.decode(whole))

    def _pages(self, chunk_samples: int) -> int:
        return self._scheme.file.fitting(chunk_samples // self._scheme.spacing.rows)

    def _joiner(self, sample: int, problems: tuple[Problem, ...]) -> PageJoiner:
        scheme = self._scheme
        first = self._opening.first_values
        return PageJoiner(scheme.file, scheme.spacing, scheme.timeline(), sample, first, problems)
