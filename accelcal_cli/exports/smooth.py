"""A rolling mean of calibrated samples within each unbroken stretch, as wide as the sampling rate asks.

G's noise filter (Grammenos, Mascolo, Crowcroft 2018, section 4.6 and Table 2), but centred, so that nothing
is delayed; G, whose filter runs while it measures, takes the samples before. Rows that the device filled in,
and those of damaged blocks, stay as they are and end a stretch. Only values that are written are filtered: a
filter before the test of stillness would make movement look still.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.exports.resample import breaks
from accelcal_cli.exports.rows import NOT_MEASURED, Rows, joined_rows

BLOCK_ROWS = 1 << 17
"""Rows that are averaged at a time."""

WIDTHS = (3, 5, 10, 20)
"""Widths of the filter [samples], as in Table 2."""

UP_TO_HZ = (20.0, 80.0, 120.0)
"""Rates [Hz] up to which each width but the last is meant; the table has 80 Hz twice."""

MOST = 1000
"""The widest filter [samples]."""

STEPS = float(1 << 32)
"""Steps in one unit: values are summed as whole numbers of them, so that their order does not matter."""


def smoothed(portions: Iterable[Rows], rate_hz: float, width: int) -> Iterator[Rows]:
    """Yield the rows with the mean of up to `width` samples around each, however they are portioned."""
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
    """The current stretch: rows whose means still need later rows, and the rows before that they need."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._before, self._after = reach(width)
        self._held: Rows | None = None
        self._done = 0

    def take(self, rows: Rows | None) -> Iterator[Rows]:
        """Take further rows and yield those whose means are known; None ends the stretch."""
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


def width_for(rate_hz: float) -> int:
    """Return the width of the filter for a sampling rate, by Table 2."""
    return next((width for width, most in zip(WIDTHS, UP_TO_HZ, strict=False) if rate_hz <= most), WIDTHS[-1])


def reach(width: int) -> tuple[int, int]:
    """Return how many samples before and after its own a mean includes; an even width has one more before."""
    return width // 2, (width - 1) // 2


def rolling_means(values: NDArray[np.float32], width: int, start: int, stop: int) -> NDArray[np.float32]:
    """Return means (m, k) of the samples around rows start..stop-1 of an unbroken stretch (n, k).

    Near an end of the stretch, fewer samples are averaged. Values are rounded to 2^-32 first (|value| < 2^21,
    width up to 1000), so a mean does not depend on what else is in memory.
    """
    before, after = reach(width)
    low, high = max(0, start - before), min(len(values), stop + after)
    whole = np.rint(values[low:high].astype(np.float64) * STEPS).astype(np.int64)
    # what a sum loses beyond 64 bits does not show in a difference that fits them
    sums = np.concatenate([np.zeros((1, values.shape[1]), np.int64), np.cumsum(whole, axis=0)])
    rows = np.arange(start, stop)
    first, last = np.maximum(rows - before, 0), np.minimum(rows + after + 1, len(values))
    total = sums[last - low] - sums[first - low]
    return np.asarray(total / ((last - first) * STEPS)[:, np.newaxis], np.float32)
