"""Rows that a device wrote while it slept: zeros, or its last sample over and over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._csv.rows import Fault, Rows


class FillFinder:
    """Marks rows of zeros, and runs of rows that repeat the one before.

    Rows are given on once it is known whether their run is long enough, so that the marks do not
    depend on where the blocks of the file end.

    Args:
        least: rows of a run of equal ones, its first included, from which on all but the first are
            marked; a sensor's noise makes shorter ones.
    """

    def __init__(self, least: int) -> None:
        self._least = max(least, 2)
        self._held: Rows | None = None
        self._asleep: NDArray[np.int32] | None = None

    def add(self, rows: Rows, last: bool) -> Rows:
        """Take the next rows; gives those that are settled (all, where these are the last)."""
        rows = rows if self._held is None else self._held.then(rows)
        if not len(rows):
            return rows
        repeats = self._repeats(rows)
        begins = ~repeats
        begins[0] = True
        starts = np.flatnonzero(begins)
        sizes = np.diff(starts, append=len(rows))
        long = sizes >= self._least
        long[0] |= repeats[0]
        settled = len(rows) if last or long[-1] else int(starts[-1])
        filled = (np.repeat(long, sizes) & repeats) | self._zeros(rows)
        self._asleep = rows.counts[-1].copy() if long[-1] else None
        self._held = rows.part(settled, len(rows)) if settled < len(rows) else None
        return replace(rows.part(0, settled), filled=filled[:settled])

    def _repeats(self, rows: Rows) -> NDArray[np.bool_]:
        """Rows that equal the one before, (n,); one that cannot be used equals none."""
        same = rows.fault == Fault.NONE
        same[0] &= self._asleep is not None and np.array_equal(rows.counts[0], self._asleep)
        for axis in rows.counts.T:
            same[1:] &= axis[1:] == axis[:-1]
        return np.asarray(same)

    def _zeros(self, rows: Rows) -> NDArray[np.bool_]:
        x, y, z = rows.counts.T
        return np.asarray((rows.fault == Fault.NONE) & ((x | y | z) == 0))
