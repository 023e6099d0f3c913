"""Times of the rows of a table, from a track of stamps: they run on where they follow daylight saving,
and rows that share a stamp are spread.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.local_time import FOLLOWED, LocalStamps
from accelcal_cli.formats._stamps import LOST, NO_TIME, SharedStamps
from accelcal_cli.formats._tables.description import Stamps, stored_stamps
from accelcal_cli.formats._tables.table import RowSelection, RowSource

UNBELIEVABLE = ("missing_value", "rows without a believable time left out")
WITH_ITS_ZONE = "the times follow a change of the clocks in {}"


class RowTimes:
    """Gives the times of rows in their order.

    Stamps are read ahead, and in the middle of a file from before the first row that is wanted, as far as
    rows that share one may reach; each is read once. What was read and not yet asked for is all that is kept.

    Args:
        start: the first row that is wanted.
        zone: whose daylight saving the times may follow.
    """

    def __init__(self, source: RowSource, stamps: Stamps, start: int, zone: str | None) -> None:
        self._source, self._scale, self._rows = source, stamps.scale, stamps.track.rows
        self._shared = SharedStamps(stamps.pace) if stamps.pace.stamp_period_us else None
        self._reach = self._shared.longest if self._shared else 0
        self._first = self._next = max(0, start - self._reach)
        self._stamps = self._times = np.empty(0, np.int64)
        self._running, self._with_its_zone = LocalStamps(zone), (FOLLOWED, WITH_ITS_ZONE.format(zone))
        self._followed = np.empty(0, np.int64)

    def next(self, selection: RowSelection) -> NDArray[np.int64]:
        """Times (n,) [us] of a selection's rows, the next ones in order; rows without a time are left out."""
        self._read(min(selection.stop + self._reach, self._rows))
        begin, end = selection.start - self._first, selection.stop - self._first
        stamps, times = self._stamps[begin:end], self._times[begin:end]
        self._first, self._stamps, self._times = selection.stop, self._stamps[end:], self._times[end:]
        if len(stamps) and stamps.min() <= LOST:
            selection.lose(self._source, stamps == LOST)
            selection.leave_out(UNBELIEVABLE, stamps == NO_TIME)
        followed, self._followed = np.split(self._followed, np.searchsorted(self._followed, [selection.stop]))
        selection.note(self._with_its_zone, followed[followed >= selection.start] - selection.start)
        return times

    def _read(self, stop: int) -> None:
        """The next stamps, up to a row, and the times that they settle."""
        if stop <= self._next:
            return
        stamps = stored_stamps(self._source, self._scale, self._next, stop)
        known = np.flatnonzero(stamps > LOST)
        if len(known) == len(stamps):
            stamps, followed = self._running.running_on(stamps)
        else:
            stamps[known], followed = self._running.running_on(stamps[known])
        times = self._shared.add(stamps, last=stop == self._rows) if self._shared else stamps
        self._followed = np.append(self._followed, self._next + known[followed])
        if len(self._stamps):
            stamps, times = np.append(self._stamps, stamps), np.append(self._times, times)
        self._stamps, self._times = stamps, times
        self._next = stop
