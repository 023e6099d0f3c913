"""A rolling mean of calibrated samples, a stretch at a time: none is averaged with what lies across a gap.

The mean is centred, so that nothing is delayed; G, whose filter runs while it measures, takes the samples
before. Rows that the device filled in, and those of damaged blocks, stay as they are and end a stretch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from accelcal_cli.core.rolling import reach, rolling_means
from accelcal_cli.exports.resample import breaks
from accelcal_cli.exports.rows import NOT_MEASURED, Rows, joined_rows

BLOCK_ROWS = 1 << 17
"""Rows that are averaged at a time."""


def smoothed(portions: Iterable[Rows], rate_hz: float, width: int) -> Iterator[Rows]:
    """The same rows with means of up to so many samples around each, whatever the portions are."""
    stretch, last_us = _Stretch(width), None
    for rows in portions:
        times = rows.time_us if last_us is None else np.concatenate([[last_us], rows.time_us])
        starts = set((breaks(times, rate_hz) - (last_us is not None)).tolist())
        measured = ~np.isin(rows.validity, NOT_MEASURED)
        changes = np.flatnonzero(np.diff(measured)) + 1
        borders = sorted({0, len(rows), *starts, *changes.tolist()})
        for start, stop in pairwise(borders):
            if start in starts or not measured[start]:
                yield from stretch.take(None)
            if measured[start]:
                for begin in range(start, stop, BLOCK_ROWS):
                    yield from stretch.take(rows.part(begin, min(begin + BLOCK_ROWS, stop)))
            else:
                yield rows.part(start, stop)
        last_us = int(rows.time_us[-1])
    yield from stretch.take(None)


class _Stretch:
    """The stretch at hand: rows whose means still wait for what comes, and those before that they need."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._before, self._after = reach(width)
        self._held: Rows | None = None
        self._done = 0

    def take(self, rows: Rows | None) -> Iterator[Rows]:
        """Rows whose means are known; None: the stretch ends here."""
        held = [one for one in (self._held, rows) if one is not None]
        if not held:
            return
        all_rows = joined_rows(held)
        stop = len(all_rows) - (0 if rows is None else self._after)
        if stop > self._done:
            means = rolling_means(all_rows.xyz, self._width, self._done, stop)
            yield replace(all_rows.part(self._done, stop), xyz=means)
            self._done = stop
        kept = max(0, self._done - self._before)
        self._held = None if rows is None else all_rows.part(kept, len(all_rows))
        self._done = 0 if rows is None else self._done - kept
