"""Stamps that several rows share, such as whole seconds, made into a time for every row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._csv.rate import Pace
from accelcal_cli.readers._csv.rows import Rows
from accelcal_cli.readers._csv.time import NO_TIME

LONGEST_GROUP = 4
"""A group longer than this many usual ones is cut: a stopped clock must not fill the memory."""


class Spreader:
    """Spreads the rows of each stamp evenly until the next stamp.

    A group of rows is given on once the stamp after it is known, so that its times do not
    depend on where the blocks of the file end.
    """

    def __init__(self, pace: Pace) -> None:
        self._period = pace.stamp_period_us
        self._usual = pace.rows_per_stamp
        self._held: Rows | None = None
        self._before = NO_TIME

    def add(self, rows: Rows, last: bool) -> Rows:
        """Take the next rows; gives those whose times are settled (all, where these are the last)."""
        rows = rows if self._held is None else self._held.then(rows)
        stamps = self._filled(rows.time_us)
        starts = self._starts(stamps)
        ends = np.append(starts[1:], len(stamps))
        settled = len(starts) if last else max(len(starts) - 1, 0)
        cut = int(ends[settled - 1]) if settled else 0
        times = stamps[:0]
        if settled:
            after = stamps[starts[settled]] if settled < len(starts) else NO_TIME
            around = np.concatenate(([self._before], stamps[starts[:settled]], [after]))
            times = self._spread(around, (ends - starts)[:settled])
            self._before = int(around[-2])
        self._held = None if last else replace(rows.part(cut, len(rows)), time_us=stamps[cut:])
        return replace(rows.part(0, cut), time_us=times)

    def _filled(self, stamps: NDArray[np.int64] | None) -> NDArray[np.int64]:
        """Rows without a time belong to the group before them; they are left out later."""
        if stamps is None or not len(stamps):
            return np.empty(0, np.int64)
        known = np.where(stamps == NO_TIME, 0, np.arange(len(stamps)))
        return stamps[np.maximum.accumulate(known)]

    def _starts(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """First row of every group."""
        if not len(stamps):
            return np.empty(0, np.int64)
        changes = np.flatnonzero(np.diff(stamps)) + 1
        starts = np.concatenate(([0], changes))
        sizes = np.diff(np.append(starts, len(stamps)))
        longest = LONGEST_GROUP * self._usual
        if sizes.max() <= longest:
            return starts
        return np.concatenate(
            [np.arange(start, start + size, longest) for start, size in zip(starts, sizes, strict=True)]
        )

    def _spread(self, around: NDArray[np.int64], sizes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Times of the rows of groups with these stamps; `around` has one more at either end.

        A short group beside a gap is the rest of a stamp's time, at the usual pace: its end
        where the gap is before it, else its beginning.
        """
        steps = np.diff(around)
        joined = (steps > 0) & (steps <= self._period * 3 // 2)
        before, after = joined[:-1], joined[1:]
        full = (sizes >= self._usual) | (before & after)
        span = np.where(full & after, steps[1:], self._period)
        parts = np.where(full, sizes, self._usual)
        shift = np.where(~full & after, self._usual - sizes, 0)
        group = np.repeat(np.arange(len(sizes)), sizes)
        place = np.arange(len(group)) - np.repeat(np.cumsum(sizes) - sizes, sizes) + shift[group]
        into = (2 * place * span[group] + parts[group]) // (2 * parts[group])
        times: NDArray[np.int64] = around[1:-1][group] + into
        return times
