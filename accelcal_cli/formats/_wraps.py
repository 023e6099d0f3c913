"""Makes the times of a table run on where its clock shows less than the time: counters that wrap, lost days.

A counter of 16, 24 or 32 bits starts again after 2^16, 2^24 or 2^32 ticks. A logger may write the date of its
start all night, or hours of a 12-hour clock without AM or PM. `find_wraps` says, by the first rows, by what
such times may jump back and still run on; `RunningOn` puts them in order. A jump is treated as one of these
only if no other reading of it is likely: the time after it has to be where the clock would have been.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, RESET_US
from accelcal_cli.formats._stamps import GAP_PERIODS, LOST

WRAPPED = "clock_wrapped"
"""Code of the problem that says where times were read on."""

BITS = (16, 24, 32)
TICKS_US = (1.0, 1000.0)
"""Ticks of counters besides the unit of a column: a program may have made seconds of them."""

HOUR_US = 3600 * MICROSECONDS
DAY_US = 24 * HOUR_US
LONG_US = 60 * MICROSECONDS
"""Length of a cycle from which on a second may be missing where it ends."""

READ_ON = "the times start again{jump}{repeated}: read as those of a clock that runs on"
TWELVE_HOURS = (
    "the hours are those of a 12-hour clock without AM or PM{repeated}: read as those of a clock that runs on"
    "; add -R shift=43200 if its first time is in the afternoon"
)
HALF_DAYS_US = (DAY_US // 2, -DAY_US)

TIMES_OF_DAY, DATES = "times of day", "dates"
"""Contents of texts of times."""


@dataclass(frozen=True, slots=True)
class Wraps:
    """Jumps that a clock may make while time runs on.

    Attributes:
        cycles: (cycle, longest) [us]: if the times jump back by a cycle less at most `longest`, they run on.
        day_us: longest time [us] between two rows around midnight or noon, at which dates may stay or change.
    """

    cycles: tuple[tuple[int, int], ...] = ()
    day_us: int = 0


def find_wraps(head: NDArray[np.int64], unit_us: float | None, written: str | None = None) -> Wraps:
    """Return what the clock may do whose first times are `head` (n,) [us].

    Numbers that count from some start are in units of `unit_us`; `written` is what times that are texts hold.
    """
    times = head[head > LOST]
    steps = np.diff(times)
    if not (steps > 0).any():
        return Wraps()
    near_us = GAP_PERIODS * int(np.median(steps[steps > 0]))
    if written is not None:
        cycles = ((DAY_US, DAY_US // 2),) if written == TIMES_OF_DAY else ()
        return Wraps(cycles, near_us if near_us < HOUR_US else 0)
    ticks = {unit_us, *TICKS_US} if unit_us is not None else set()
    lengths = {round(tick * (1 << bits)) for tick in ticks if tick is not None for bits in BITS}
    fitting = sorted(cycle for cycle in lengths if np.ptp(times) < cycle <= RESET_US)
    return Wraps(tuple((cycle, _longest(cycle, near_us, steps[steps < 0])) for cycle in fitting))


def _longest(cycle_us: int, near_us: int, back: NDArray[np.int64]) -> int:
    """Return the longest time between rows around the end of a cycle: half of one that was seen already."""
    near_us = min(near_us, cycle_us // 2)
    ahead = back + cycle_us
    if len(ahead) and (ahead > 0).all() and (ahead <= near_us).all():
        return cycle_us // 2
    return max(near_us, MICROSECONDS) if cycle_us >= LONG_US else near_us


def text_of(jump_us: int) -> str:
    """Return the text of the problem that times were read on by a jump."""
    return TWELVE_HOURS if jump_us in HALF_DAYS_US else READ_ON


class RunningOn:
    """Makes the times of consecutive rows run on; the result does not depend on how the rows are cut."""

    def __init__(self, wraps: Wraps) -> None:
        self._wraps = wraps
        self._least_us = min((cycle - longest for cycle, longest in wraps.cycles), default=DAY_US)
        if wraps.day_us:
            self._least_us = min(self._least_us, DAY_US // 2 - wraps.day_us)
        self._before: int | None = None
        self._low = self._high = self._ahead_us = self._row = 0
        self._twelve = True
        self._jumps: deque[tuple[int, int]] = deque()

    def running_on(self, times: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the next times (n,) [us] as a clock would show them that runs on; gaps in them stay."""
        first, self._row = self._row, self._row + len(times)
        known = np.flatnonzero(times > LOST)
        if not len(known) or self._wraps == Wraps():
            return times
        own = times[known]
        if self._before is None:
            self._before = self._low = self._high = int(own[0])
        steps, begun_us = np.diff(own, prepend=self._before), self._ahead_us
        added, seen = np.zeros(len(own), np.int64), 0
        for row in np.flatnonzero((steps <= -self._least_us) | (steps >= DAY_US)).tolist():
            self._see(own[seen:row])
            seen = row
            if jump_us := self._jump_us(int(own[row]) - int(steps[row]), int(own[row])):
                added[row] = jump_us
                self._ahead_us += jump_us
                self._jumps.append((first + int(known[row]), jump_us))
        self._see(own[seen:])
        self._before = int(own[-1])
        if not begun_us and not added.any():
            return times
        running = times.copy()
        running[known] += begun_us + np.cumsum(added)
        return running

    def taken(self, stop: int) -> Iterator[tuple[int, int]]:
        """Yield once each row below `stop`, from 0, from which on times were moved, and by what [us]."""
        while self._jumps and self._jumps[0][0] < stop:
            yield self._jumps.popleft()

    def _see(self, times: NDArray[np.int64]) -> None:
        if not len(times):
            return
        low, high = int(times.min()), int(times.max())
        self._low, self._high = min(self._low, low), max(self._high, high)
        half_days = {(time_us - HOUR_US) // (DAY_US // 2) for time_us in (low, high)}
        self._twelve &= len(half_days) == 1 and min(half_days) % 2 == 0

    def _jump_us(self, before_us: int, after_us: int) -> int:
        """Return what is to be added from a row on, 0 for an ordinary jump."""
        step_us = after_us - before_us
        span_us = max(self._high, after_us) - min(self._low, after_us)
        for cycle_us, longest_us in self._wraps.cycles:
            if 0 < step_us + cycle_us <= longest_us and span_us < cycle_us:
                return cycle_us
        allowed = [(DAY_US, 0)] + [(-DAY_US, 0)] * (self._ahead_us >= DAY_US)
        allowed += [(DAY_US // 2, 1), (-DAY_US, 12)] * self._twelve
        for jump_us, hour in allowed:
            begins = (after_us - hour * HOUR_US) % DAY_US <= self._wraps.day_us
            if begins and 0 < step_us + jump_us <= self._wraps.day_us:
                return jump_us
        return 0
