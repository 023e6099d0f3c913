"""Times of sectors whose stamps are whole seconds, as early firmware and other writers have them.

Such a stamp says that a sample was taken within the second that follows. Firmware that knows the fraction of
the second moves the number of the sample instead, to the one that was taken as the second began: these stamps
are exact (`ax3-technical.md`, `timestampOffset`). `stamp_unit` tells the two apart.

Neighbouring stamps together are better than one: of the lines that lie within the second of each of `WINDOW`
stamps, or miss the fewest microseconds, the middle one is taken. Windows overlap by half. Times lie on
straight lines from the middle of each window to that of the next, so that a clock that drifts is followed.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.formats._pages.timeline import NO_SPANS, Spans
from accelcal_cli.formats.cwa.sector import SectorBlock
from accelcal_cli.formats.cwa.timeline import NO_LINKS, Linker, Links, Timeline

WINDOW, LEAST_SECTORS = 128, 4
"""Sectors whose stamps make one line (a minute and more), and fewest that show how exact they are."""

LEAST_SPREAD_US = 100_000
"""Spread of the middle half of stamps around a line [us] from which they are not exact: half a second for
whole seconds, 30 ms for exact ones at a rate that is 6 % off."""

SLOPES, ROUNDS = 33, 5
"""Slopes of a line that are tried at a time, and how often; each time they lie 16 times as close."""


def stamp_unit(block: SectorBlock, rate: Fraction, full_rows: int) -> int | None:
    """Return by how much stamps may be early [us], 0 or a second, by some sectors; None if they are finer."""
    known = block.anchors.known
    if (block.anchors.time_us[known] % MICROSECONDS).any():
        return None
    links, *_ = Linker(rate, full_rows, MICROSECONDS).link(block)
    run = (np.cumsum(links.fresh) == 1) & known
    row, time_us = links.anchor_row[run], links.anchor_us[run]
    half = len(row) // 2
    if len(row) < LEAST_SECTORS:
        return None
    slope = float(np.median((time_us[half:] - time_us[:-half]) / np.maximum(row[half:] - row[:-half], 1)))
    low, high = np.percentile(time_us - time_us[0] - slope * (row - row[0]), (25, 75))
    return MICROSECONDS if high - low > LEAST_SPREAD_US else 0


class _Line(NamedTuple):
    """A straight line through a sample and its time [us], with the time from one sample to the next."""

    row: int
    time_us: int
    slope: float

    def times(self, row: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.asarray(self.time_us + np.rint(self.slope * (row - self.row)).astype(np.int64))


class SecondsTimeline:
    """Gives sectors times as `Timeline` does, by anchors on lines instead of the stamps."""

    def __init__(self, rate: Fraction, unit_us: int) -> None:
        self._timeline, self._unit_us = Timeline(rate), unit_us
        self._nominal = float(MICROSECONDS / rate)
        self._held = NO_LINKS
        self._before: _Line | None = None

    def feed(self, links: Links) -> Spans:
        """Add sectors; return the times of the next settled ones."""
        held, found = self._held.followed_by(links), NO_LINKS
        while True:
            fresh = np.flatnonzero(held.fresh[1:])
            end = int(fresh[0]) + 1 if len(fresh) else len(held)
            if len(fresh) and end <= WINDOW:
                found = found.followed_by(self._placed(held.part(slice(end)), whole=True))
                self._before = None
                held = held.part(slice(end, None))
            elif end > WINDOW:
                placed = self._placed(held.part(slice(WINDOW)), whole=False)
                found, held = found.followed_by(placed), held.part(slice(len(placed), None))
            else:
                break
        self._held = held
        return self._timeline.feed(found) if len(found) else NO_SPANS

    def finish(self) -> Spans:
        """Return the times of all sectors that remain; none follows."""
        spans = self._timeline.feed(self._placed(self._held, whole=True)) if len(self._held) else NO_SPANS
        return spans.followed_by(self._timeline.finish())

    def _placed(self, links: Links, *, whole: bool) -> Links:
        """Return sectors with anchors on the line from the last one to theirs: all, or up to the middle."""
        middle = (len(links) + 1) // 2
        line, before = self._line(links, int(links.row[middle - 1])), self._before
        anchor_us = line.times(links.row)
        if before is not None:
            slope = (line.time_us - before.time_us) / (line.row - before.row)
            anchor_us[:middle] = line._replace(slope=slope).times(links.row[:middle])
        self._before = line
        placed = replace(links, anchor_row=links.row, anchor_us=anchor_us)
        return placed if whole else placed.part(slice(middle))

    def _line(self, links: Links, at: int) -> _Line:
        """Return the line that lies best within the seconds of the stamps, by its time at a sample."""
        known = ~links.untimed
        if not known.any():
            known = ~known
        row, origin = links.anchor_row[known] - at, int(links.anchor_us[known][0])
        time_us = links.anchor_us[known] - origin
        slope = self._nominal
        fits = np.ptp(time_us - slope * row) <= self._unit_us
        if not fits or self._before is not None or len(row) >= WINDOW // 2:
            slope = _best_slope(row, time_us, slope)
        off = time_us - slope * row
        return _Line(at, origin + round((off.min() + off.max() + self._unit_us) / 2), slope)


def _best_slope(row: NDArray[np.int64], time_us: NDArray[np.int64], nominal: float) -> float:
    """Return the slope of the narrowest band that holds all stamps."""
    over = int(row[-1] - row[0])
    if over <= 0:
        return nominal
    best, reach = float(time_us[-1] - time_us[0]) / over, 2 * MICROSECONDS / over
    for _ in range(ROUNDS):
        slopes = best + reach * np.linspace(-1, 1, SLOPES)
        widths = np.ptp(time_us - slopes[:, np.newaxis] * row, axis=1)
        best, reach = float(slopes[np.argmin(widths)]), 2 * reach / (SLOPES - 1)
    return best
