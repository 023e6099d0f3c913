"""What was wrong with pages, between pages and with rows, as events for the problem log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from accelcal_cli.readers._pages.blocks import Block, Places, is_erased
from accelcal_cli.readers._pages.pages import (
    BAD_KINDS,
    DAMAGED,
    ERASED,
    NO_TEMPERATURE,
    BadRun,
    Decoded,
    PageBlock,
    page_rows,
    per_page,
)
from accelcal_cli.readers._pages.problems import Event
from accelcal_cli.readers._pages.timeline import Links, Steps

MISSING_PAGES = "pages missing by their sequence numbers"
SEQUENCE_BACK = "pages whose sequence number does not rise"
CLOCK_AHEAD = "jumps of the device clock ahead"
CLOCK_BACK = "jumps of the device clock back"
FAULTY_ROWS = "samples without a usable value, left out"
COLD_ROWS = "samples without a temperature, given the last one measured"
BLANK_BYTES = 16
"""A few bytes of 0xFF may belong to a number; so many, or after erased ones, were never written."""

CUT_OFF = "bytes of an incomplete page or frame at the end of the file, left out"
BROKEN_OFF = "the compressed data is damaged or ends early; bytes of an incomplete page or frame, left out"


class EventMaker:
    """Turns findings into events with their place in the file.

    Args:
        row_bytes: bytes of a page for each of its rows.
        warm: the recording has a temperature at all.
    """

    def __init__(self, file: Places, row_bytes: int, *, warm: bool) -> None:
        self._file = file
        self._row_bytes = row_bytes
        self._warm = warm
        self._erased: BadRun | None = None

    def bad_pages(self, block: PageBlock, bad: list[BadRun], rows_in: int) -> Iterator[Event]:
        """Unusable pages. Erased ones are held back until anything else follows them."""
        followed = max(
            [*(run.position for run in bad if run.kind != ERASED), *block.position[-1:].tolist()], default=-1
        )
        rows_before = np.concatenate(([0], np.cumsum(page_rows(block)))) + rows_in
        waiting = [] if self._erased is None else [self._erased]
        self._erased = None
        for run in [*waiting, *bad]:
            if run.kind == ERASED and run.position > followed:
                self._hold(run)
                continue
            code, text = BAD_KINDS[run.kind]
            sample = int(rows_before[np.searchsorted(block.position, run.position)])
            lost = self._file.length(run.position, run.pages) if run.kind in DAMAGED else 0
            event = self._event(run.position, code, text, sample, run.pages)
            yield replace(event, pages=run.pages, lost_bytes=lost)

    def _hold(self, run: BadRun) -> None:
        first, pages = (
            (run.position, 0) if self._erased is None else (self._erased.position, self._erased.pages)
        )
        self._erased = BadRun(first, pages + run.pages, ERASED)

    def rows(self, block: PageBlock, rows_in: int) -> Iterator[Event]:
        """Rows without usable values, and samples without a temperature, page by page."""
        faults = per_page(block, block.faulty)
        heat = block.temperature_mc if self._warm else None
        cold = per_page(block, None if heat is None else heat == NO_TEMPERATURE)
        after = rows_in + np.cumsum(page_rows(block))
        for page in np.flatnonzero(faults + cold).tolist():
            position, sample = int(block.position[page]), int(after[page])
            for text, count, lost in (
                (FAULTY_ROWS, faults[page], self._row_bytes),
                (COLD_ROWS, cold[page], 0),
            ):
                if count:
                    event = self._event(position, "missing_value", text, sample, int(count))
                    yield replace(event, lost_bytes=int(count) * lost)

    def links(self, pages: PageBlock, step: Steps, links: Links, rows_before: int) -> Iterator[Event]:
        """What stands between pages."""
        samples = rows_before + np.cumsum(page_rows(pages))
        columns = (step.missing, step.back, links.ahead_us, links.behind_us)
        for page in np.flatnonzero(np.logical_or.reduce(columns)).tolist():
            place, sample = int(pages.position[page + 1]), int(samples[page])
            missing, back, ahead, behind = (int(column[page]) for column in columns)
            if missing:
                yield self._event(place, "sequence_gap", MISSING_PAGES, sample, missing)
            if back:
                yield self._event(place, "sequence_back", SEQUENCE_BACK, sample)
            if ahead:
                yield replace(self._event(place, "clock_gap", CLOCK_AHEAD, sample), amount_us=ahead)
            if behind:
                yield replace(self._event(place, "clock_back", CLOCK_BACK, sample), amount_us=behind)

    def ending(self, raw: Block, decoded: Decoded, rows_in: int) -> Iterator[Event]:
        """An incomplete page or frame at the end, unless it is erased flash."""
        blank = len(decoded.leftover) >= BLANK_BYTES or self._erased is not None or decoded.unused_end
        if not raw.broken and is_erased(decoded.leftover) and (blank or not decoded.leftover):
            return
        position = raw.next_position
        offset = self._file.offset(position) + len(raw.tail) - len(decoded.leftover)
        text = BROKEN_OFF if raw.broken else CUT_OFF
        lost = len(decoded.leftover) + raw.undecoded
        event = Event(position, 1, "truncated", text, offset, rows_in, len(decoded.leftover))
        yield replace(event, lost_bytes=lost)

    def _event(self, place: int, code: str, text: str, sample: int, count: int = 1) -> Event:
        return Event(place, 1, code, text, self._file.offset(place), sample, count)
