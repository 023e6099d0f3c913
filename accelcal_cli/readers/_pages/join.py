"""From blocks of decoded pages to chunks: times, breaks and problems across block borders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, PageClock
from accelcal_cli.core.recording import Chunk, Problem
from accelcal_cli.readers._pages.blocks import Block, Places
from accelcal_cli.readers._pages.events import EventMaker
from accelcal_cli.readers._pages.pages import NO_TEMPERATURE, Decoded, PageBlock, joined, page_rows, split
from accelcal_cli.readers._pages.problems import Event, ProblemLog
from accelcal_cli.readers._pages.rows import RowFilter, TemperatureHold
from accelcal_cli.readers._pages.timeline import Links, Spacing, Timeline, steps

NO_PAGES = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class Start:
    """Where a joiner begins.

    Attributes:
        sample: number of the first row.
        temperature_mc: temperature of rows before the first measured one.
        problems: what was found before any page.
    """

    sample: int
    temperature_mc: int
    problems: tuple[Problem, ...] = ()


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
        above, below = split(self.block, pages)
        columns = (self.time_us, self.span_rows, self.span_us, self.broken)
        return (
            Stretch(above, *(column[:pages] for column in columns)),  # type: ignore[arg-type]
            Stretch(below, *(column[pages:] for column in columns)),  # type: ignore[arg-type]
        )


class PageJoiner:
    """Takes blocks of decoded pages in order and gives a chunk for each.

    The last page is held back until the next one tells how long it lasted.
    """

    def __init__(self, file: Places, spacing: Spacing, timeline: Timeline, start: Start) -> None:
        self._spacing = spacing
        self._timeline = timeline
        self._page_bytes, self._row_bytes = file.page_bytes, file.page_bytes // spacing.rows
        self._events = EventMaker(file, self._row_bytes, warm=start.temperature_mc != NO_TEMPERATURE)
        self._log = ProblemLog(start.problems)
        self._temperature = TemperatureHold(start.temperature_mc)
        self._filter = RowFilter()
        self._held: Stretch | None = None
        self._rows_in = start.sample
        self._rows_out = start.sample

    def feed(self, raw: Block, decoded: Decoded) -> Chunk:
        """Add a block; the last one releases the held page too."""
        block = decoded.block
        events = [*self._events.bad_pages(block, decoded.bad, self._rows_in)]
        events += self._events.rows(block, self._rows_in)
        stretch = self._settled(block, events)
        self._rows_in += int(page_rows(block).sum())
        if raw.last:
            events += self._events.ending(raw, decoded, self._rows_in)
        elif len(stretch.block):
            stretch, self._held = stretch.cut(len(stretch.block) - 1)
        for event in sorted(events, key=lambda event: event.position):
            self._log.add(event)
        scanned = None if raw.last else raw.next_position
        return self._chunk(stretch, raw.end_byte, self._log.take(scanned))

    def _settled(self, block: PageBlock, events: list[Event]) -> Stretch:
        """Times of the held page and the new ones."""
        held = self._held
        pages = block if held is None else joined(held.block, block)
        if not len(pages):
            return Stretch(pages, *(NO_PAGES,) * 3, NO_PAGES.astype(np.bool_))
        start_us = self._timeline.start(pages) if held is None else int(held.time_us[0])
        step = steps(pages, self._spacing)
        links = self._timeline.link(pages, step, start_us)
        before = self._rows_in - (0 if held is None else int(page_rows(held.block).sum()))
        events += self._events.links(pages, step, links, before)
        return self._spread(pages, links, held is not None and bool(held.broken[0]))

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
            temperature_mc=self._temperature.fill(block.temperature_mc),
            gyro_counts=block.gyro,
            problems=problems,
            used_bytes=self._used_bytes(block),
        )
        chunk = self._filter.apply(chunk, block.faulty)
        self._rows_out += len(chunk)
        return chunk

    def _used_bytes(self, block: PageBlock) -> int:
        faults = 0 if block.faulty is None else int(block.faulty.sum())
        return len(block) * self._page_bytes - faults * self._row_bytes
