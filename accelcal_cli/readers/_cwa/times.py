"""Times of samples by straight lines between the anchors of their sectors.

The sensor has its own oscillator, percents off its nominal rate and drifting with temperature, so
that only the anchors tell when a sample was taken. Before the first and after the last anchor of
an unbroken run the line goes on with the run's own rate at that end. Sectors begin and end on these
lines; the samples of a sector are evenly spread.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.readers._cwa.links import Links

END_ANCHORS = 32
"""The rate at the end of a run is measured over this many anchors."""

RUN_SHIFT = 42
ROW_ORIGIN = 1 << 20
"""Run number and sample number together make a key that ascends: rows stay below 2**41."""


@dataclass(frozen=True, slots=True, eq=False)
class Spans:
    """When sectors begin and how long they last [us], (p,) int64 each."""

    time_us: NDArray[np.int64]
    span_us: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.time_us)


NO_SPANS = Spans(np.empty(0, np.int64), np.empty(0, np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """Sectors that are still needed; columns as in Links, (w,) each."""

    row: NDArray[np.int64]
    rows: NDArray[np.int64]
    anchor_row: NDArray[np.int64]
    anchor_us: NDArray[np.int64]
    fresh: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.row)

    def extended(self, links: Links) -> _Window:
        return _Window(
            np.concatenate((self.row, links.row)),
            np.concatenate((self.rows, links.rows)),
            np.concatenate((self.anchor_row, links.anchor_row)),
            np.concatenate((self.anchor_us, links.anchor_us)),
            np.concatenate((self.fresh, links.fresh)),
        )

    def cut(self, first: int) -> _Window:
        return _Window(
            self.row[first:],
            self.rows[first:],
            self.anchor_row[first:],
            self.anchor_us[first:],
            self.fresh[first:],
        )


class _Lines:
    """Straight lines from each anchor of a window to the next, and on at both ends of each run."""

    def __init__(self, window: _Window, rate: Fraction) -> None:
        self._window = window
        self._rate = rate
        run = np.cumsum(window.fresh, dtype=np.int64)
        self._run = run - run[0]
        self._starts = np.append(0, np.flatnonzero(window.fresh[1:]) + 1)
        self._key = (self._run << RUN_SHIFT) + (window.anchor_row + ROW_ORIGIN)
        ends = np.append(self._starts[1:], len(window)) - 1
        self._over_rows = np.append(window.anchor_row[1:] - window.anchor_row[:-1], 0)
        self._over_us = np.append(window.anchor_us[1:] - window.anchor_us[:-1], 0)
        back = np.maximum(self._starts, ends - END_ANCHORS + 1)
        self._over_rows[ends], self._over_us[ends] = self._chord(back, ends)
        self._head = self._chord(self._starts, np.minimum(self._starts + END_ANCHORS - 1, ends))

    def _chord(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> tuple[Any, Any]:
        """Samples and time [us] between two anchors; as at the nominal rate where they are one."""
        window, alone = self._window, first == second
        over_rows = window.anchor_row[second] - window.anchor_row[first]
        over_us = window.anchor_us[second] - window.anchor_us[first]
        nominal = self._rate.numerator, MICROSECONDS * self._rate.denominator
        return np.where(alone, nominal[0], over_rows), np.where(alone, nominal[1], over_us)

    def at(self, sector: NDArray[np.int64], row: NDArray[np.int64]) -> NDArray[np.int64]:
        """Times of samples `row` of the runs to which the sectors belong, rounded half up."""
        run = self._run[sector]
        key = (run << RUN_SHIFT) + (row + ROW_ORIGIN)
        found = np.searchsorted(self._key, key, side="right") - 1
        anchor = np.maximum(found, self._starts[run])
        over_rows, over_us = self._over_rows[anchor], self._over_us[anchor]
        early = np.flatnonzero(found < anchor)
        over_rows[early], over_us[early] = self._head[0][run[early]], self._head[1][run[early]]
        into = (row - self._window.anchor_row[anchor]) * over_us
        return np.asarray(self._window.anchor_us[anchor] + (2 * into + over_rows) // (2 * over_rows))


class Timeline:
    """Takes linked sectors in file order; gives times as soon as they are settled.

    A sector is settled when an anchor behind its end is known, or its run has ended; those at the
    beginning of a run wait for the anchors that tell its rate.
    """

    def __init__(self, rate: Fraction) -> None:
        self._rate = rate
        none = np.empty(0, np.int64)
        self._window = _Window(none, none, none, none, none.astype(np.bool_))
        self._done = 0

    def feed(self, links: Links) -> Spans:
        """Add sectors; gives the next settled ones."""
        self._window = self._window.extended(links)
        return self._release(self._settled())

    def finish(self) -> Spans:
        """All that remain; no sector follows."""
        return self._release(len(self._window))

    def _settled(self) -> int:
        window = self._window
        begun = self._last_run()
        known_rate = not window.fresh[begun] or len(window) - begun >= END_ANCHORS
        if not known_rate:
            return begun
        ends = window.row[begun:] + window.rows[begun:]
        return max(self._done, begun + int(np.searchsorted(ends, window.anchor_row[-1], side="right")))

    def _last_run(self) -> int:
        """Where the last run begins in the window."""
        begun = np.flatnonzero(self._window.fresh)
        return int(begun[-1]) if len(begun) else 0

    def _release(self, settled: int) -> Spans:
        """Times of the sectors up to `settled`; one ends where the next begins, if that follows."""
        if settled == self._done:
            return NO_SPANS
        window, lines = self._window, _Lines(self._window, self._rate)
        ends = window.row + window.rows
        apart = window.fresh[1:settled] | (ends[: settled - 1] != window.row[1:settled])
        lonely = np.append(np.flatnonzero(apart[self._done :]) + self._done, settled - 1)
        sector = np.append(np.arange(self._done, settled), lonely)
        time_us = lines.at(sector, np.append(window.row[self._done : settled], ends[lonely]))
        begin, end = time_us[: settled - self._done], time_us[1 : settled - self._done + 1].copy()
        end[lonely - self._done] = time_us[settled - self._done :]
        self._forget(settled)
        return Spans(begin, end - begin)

    def _forget(self, settled: int) -> None:
        """Keep what is unsettled, the anchor before it, and enough anchors for the end's rate."""
        window, begun = self._window, self._last_run()
        reached = window.row[settled - 1] + window.rows[settled - 1]
        before = begun + int(np.searchsorted(window.anchor_row[begun:], reached, side="right")) - 1
        first = max(begun, min(settled, before, len(window) - END_ANCHORS))
        self._window, self._done = window.cut(first), settled - first
