"""What was wrong with sectors and between them, as events for the problem log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._cwa.decode import (
    CHECKSUM,
    EMPTY,
    FOREIGN,
    NONSENSE,
    OTHER,
    RATE,
    SETTINGS,
    SectorBlock,
)
from accelcal_cli.readers._cwa.links import Links
from accelcal_cli.readers._cwa.signature import SECTOR_BYTES
from accelcal_cli.readers._pages.blocks import PagedFile, RawBlock, is_erased
from accelcal_cli.readers._pages.pages import BadRun, bad_runs
from accelcal_cli.readers._pages.problems import Event

LEFT_OUT = {
    EMPTY: ("bad_page", "empty sectors between sectors with data, left out"),
    FOREIGN: ("bad_page", "sectors that are not Axivity data, left out"),
    CHECKSUM: ("checksum", "data sectors with a wrong checksum, left out"),
    NONSENSE: ("bad_page", "data sectors with an impossible number or layout of samples, left out"),
    RATE: ("rate_change", "data sectors recorded at another rate than the first, left out"),
    SETTINGS: ("settings_change", "data sectors with another range, scale or axes than the first, left out"),
}
DAMAGED = (EMPTY, FOREIGN, CHECKSUM, NONSENSE)
"""Kinds whose bytes are lost; a sector recorded with other settings is sound."""

MISSING = ("sequence_gap", "data sectors missing by their sequence numbers")
RESTARTED = ("sequence_back", "restarts of the logging, where the sequence numbers begin anew")
SESSION = ("session_change", "changes of the session number: the device was set up anew")
OVERFLOW = ("device_overflow", "data sectors where the device says that it lost samples")
UNTIMED = (
    "missing_value",
    "data sectors without a valid time, placed by counting samples at the nominal rate",
)
AHEAD = ("clock_gap", "jumps of the device clock ahead")
BACK = ("clock_back", "jumps of the device clock back")
CUT_OFF = "bytes of an incomplete sector at the end of the file, left out"
BROKEN_OFF = "the compressed data is damaged or ends early; bytes of an incomplete sector, left out"


@dataclass(frozen=True, slots=True)
class Size:
    """Units that an event concerns, sectors that it reaches over, the time it takes, bytes lost."""

    count: int
    sectors: int = 1
    amount_us: int = 0
    lost_bytes: int = 0


class EventMaker:
    """Turns findings into events with their place in the file."""

    def __init__(self, file: PagedFile) -> None:
        self._file = file
        self._empty: BadRun | None = None

    def left_out(
        self, raw: RawBlock, status: NDArray[np.uint8], block: SectorBlock, sample: int
    ) -> Iterator[Event]:
        """Unusable sectors. Empty ones are held back until anything else follows them.

        Args:
            status: (n,) what each sector is.
            sample: number of the block's first sample.
        """
        if not status.any() and self._empty is None:
            return
        used = np.flatnonzero(status != EMPTY)
        followed = raw.first_position + int(used[-1]) if len(used) else -1
        samples = sample + np.concatenate(([0], np.cumsum(block.rows)))
        waiting = [] if self._empty is None else [self._empty]
        self._empty = None
        for run in [*waiting, *bad_runs(status, raw.first_position)]:
            if run.kind == EMPTY and run.position > followed:
                self._hold(run)
            elif run.kind != OTHER:
                after = int(samples[np.searchsorted(block.position, run.position)])
                lost = run.pages * SECTOR_BYTES if run.kind in DAMAGED else 0
                size = Size(run.pages, run.pages, lost_bytes=lost)
                yield self._event(run.position, LEFT_OUT[run.kind], after, size)

    def _hold(self, run: BadRun) -> None:
        first, before = (
            (run.position, 0) if self._empty is None else (self._empty.position, self._empty.pages)
        )
        self._empty = BadRun(first, before + run.pages, EMPTY)

    def links(self, block: SectorBlock, links: Links, sample: int) -> Iterator[Event]:
        """What stands between sectors."""
        if not (links.broken | links.overflow | links.untimed).any():
            return
        counted = {MISSING: links.missing, RESTARTED: links.restarted, SESSION: links.session}
        counted |= {OVERFLOW: links.overflow, UNTIMED: links.untimed}
        measured = {AHEAD: links.ahead_us, BACK: links.behind_us}
        samples = sample + np.cumsum(block.rows) - block.rows
        for kind, column in (counted | measured).items():
            for sector in np.flatnonzero(column).tolist():
                amount = int(column[sector])
                size = Size(1, amount_us=amount) if kind in measured else Size(amount)
                yield self._event(int(block.position[sector]), kind, int(samples[sector]), size)

    def ending(self, raw: RawBlock, sample: int) -> Iterator[Event]:
        """An incomplete sector at the end, unless it is empty."""
        if not raw.broken and (is_erased(raw.tail) or not any(raw.tail)):
            return
        position = raw.first_position + len(raw.pages)
        text = BROKEN_OFF if raw.broken else CUT_OFF
        size = Size(len(raw.tail), lost_bytes=len(raw.tail) + raw.undecoded)
        yield self._event(position, ("truncated", text), sample, size)

    def _event(self, position: int, kind: tuple[str, str], sample: int, size: Size) -> Event:
        offset = self._file.offset(position)
        amounts = (size.count, size.amount_us, size.lost_bytes)
        return Event(position, size.sectors, *kind, offset, sample, *amounts)
