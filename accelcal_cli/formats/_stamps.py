"""Finds how the rows of a table follow each other in time, and spreads rows that share a stamp.

`shares_stamps` finds out whether several rows share each stamp, such as whole seconds; `SharedStamps` then
gives every row a time of its own, wherever the pieces end in which the rows are read.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, RESET_US

NO_TIME, IMPOSSIBLE, LOST = -(1 << 62), -(1 << 62) + 1, -(1 << 62) + 2
"""Stand for a missing time, for one that does not exist (30 February) or was before all recordings (the
year 1), and for one in a lost part of the file; far enough from every real one to subtract without
overflow."""

HOUR_24, WITH_HOUR_24 = 1 << 60, 1 << 59
"""Added to a time of the hour 24, read as the hour 0 of its date, until `Midnights` knows its day; times from
which on that is added."""

EPOCH_DAYS, PLAUSIBLE_HZ = (25_569.0, 719_529.0), (5.0, 800.0)
"""1970-01-01 in days of spreadsheets and of MATLAB, and rates [Hz] for which only one unit of time fits."""

GAP_PERIODS, LONGEST_GROUP = 3, 4
"""Most sample periods in a step that is not a gap; most usual groups in one, also if the clock stops."""

FILLED, LONGEST_STAMP_S = 1.5, 15.0
"""Most times as long as its rows take that a step to the next stamp is without a gap; longest time [s] of one
stamp among those that become coarser."""

DEVICE_RATES = (1.5625, 3.125, 6.25, 12.5, 25.6, 31.25, 100 / 3, 51.2, 62.5, 200 / 3, 102.4, 204.8)
"""Fractional rates [Hz] of devices in common use."""

NEAR, SLOW_HZ = 0.0005, 9.5
"""Share by which crystals miss their rate; rate [Hz] up to which it need not be a whole number."""

STAMP_STEPS_US = (MICROSECONDS, MICROSECONDS // 10, MICROSECONDS // 100, 1000, 100, 10)
"""Steps [us] in which stamps are written."""

JITTER_ERROR, JITTERED, SPAN_ROWS = 0.005, 0.001, 16
"""Share by which a rate of jittered stamps may be wrong, of steps back that show these, and rows averaged."""

DISAGREEMENT = 1.2
"""Ratio of a stated rate to that of the times beyond which they disagree."""

SHORTFALL = 0.2
"""Share of the usual size by which a group may differ; one that differs more lies next to a gap."""

ROUNDED = 2
"""Rows by which groups differ, as 3 and 5 do, where what lies between two stamps goes to the even one."""

SPREAD = "several rows share a time stamp; they were spread evenly until the next one"


@dataclass(frozen=True, slots=True)
class Pace:
    """The rate of a file's rows.

    Attributes:
        stamp_period_us: time from one stamp to the next if rows share stamps, else 0.
        differs_hz: the rate that the times show, where the user's is nearly that.
    """

    rate_hz: float
    stamp_period_us: int = 0
    differs_hz: float | None = None

    @property
    def period_us(self) -> float:
        """Time from one row to the next [us]."""
        return MICROSECONDS / self.rate_hz

    @property
    def rows_per_stamp(self) -> int:
        """Usual number of rows that share a stamp."""
        return max(1, round(self.rate_hz * self.stamp_period_us / MICROSECONDS))

    @property
    def longest_group(self) -> int:
        """Most rows that are taken to share a stamp."""
        return max(LONGEST_GROUP * self.rows_per_stamp, round(LONGEST_STAMP_S * self.rate_hz))

    @property
    def reach(self) -> int:
        """Rows next to a row on which its time depends: its group, and the one on either side."""
        return 2 * self.longest_group

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for people on changed times, and on a rate that is not that of the times."""
        spread = (SPREAD,) if self.stamp_period_us else ()
        if self.differs_hz is None:
            return spread
        return (
            *spread,
            f"its times say {self.differs_hz:.6g} Hz; the {self.rate_hz:g} Hz that were given are used",
        )

    def agrees(self, rate_hz: float) -> bool:
        """Return True if a stated rate can be the one that the times show."""
        return 1 / DISAGREEMENT < rate_hz / self.rate_hz < DISAGREEMENT


def _groups(stamps: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first rows of groups of equal stamps, and sizes without the first and last, which may be cut."""
    starts = np.flatnonzero(np.diff(stamps, prepend=stamps[:1] - 1))
    return starts, np.diff(starts)[1:]


def shares_stamps(stamps: NDArray[np.int64]) -> bool:
    """Return True if several rows usually share a stamp."""
    _, sizes = _groups(stamps)
    return len(sizes) > 0 and bool(np.median(sizes) >= 2)


def shared_pace(stamps: NDArray[np.int64]) -> Pace | None:
    """Return the pace of rows of which several share each stamp, None if they show none."""
    starts, sizes = _groups(stamps)
    before, steps = (step := np.diff(stamps[starts]))[:-1], step[1:]
    typical = int(np.sort(sizes)[len(sizes) // 2])
    whole = np.abs(sizes - typical) <= max(ROUNDED, SHORTFALL * typical)
    period = int(np.median(steps[whole]))
    usual = whole & (steps > 0) & (2 * steps <= GAP_PERIODS * period)
    usual &= (before < 0) | (steps <= GAP_PERIODS * before)  # a coarser stamp begins with half of its rows
    if period <= 0 or not usual.any():
        return None
    rate = float(sizes[usual].sum()) * MICROSECONDS / float(steps[usual].sum())
    return Pace(nice_rate(rate, 1 / float(sizes[usual].sum())), period)


def only_stamp_period(stamps: NDArray[np.int64]) -> int:
    """Return one second [us] if all rows share one or two whole-second stamps, else 0."""
    shared = len(stamps) > 2 * len(_groups(stamps)[0]) and not (stamps % MICROSECONDS).any()
    return MICROSECONDS if shared else 0


def jittered_step(stamps: NDArray[np.int64]) -> float | None:
    """Return the time from one row to the next [us] of jittered stamps (n,); None for other stamps.

    A mean of steps without those back, or those after a stall, is wrong by a tenth. Spans of `SPAN_ROWS` rows
    have the usual length unless they hold a gap: the result is the mean of those within a row and a half of
    the middle, found by repeating.
    """
    if len(stamps) < 4 * SPAN_ROWS or np.mean(np.diff(stamps) < 0) < JITTERED:
        return None
    spans = stamps[SPAN_ROWS:] - stamps[:-SPAN_ROWS]
    usual = float(np.median(spans))
    for _ in range(8):
        near = spans[np.abs(spans - usual) <= 1.5 * usual / SPAN_ROWS]
        if usual <= 0 or not len(near):
            return None
        usual = float(near.sum()) / len(near)
    return usual / SPAN_ROWS


def stamp_error(stamps: NDArray[np.int64]) -> float:
    """Return the share by which a rate may be wrong that times (n,) show, by how finely they are written."""
    span_us = int(np.ptp(stamps)) if len(stamps) else 0
    step_us = next((step for step in STAMP_STEPS_US if not (stamps % step).any()), 1)
    return step_us / span_us if span_us else 0.0


def nice_rate(measured: float, error: float = 0.0) -> float:
    """Return the rate to which a device was probably set, or the measured one if that is not clear.

    Args:
        error: the share by which the measured rate may be wrong; crystals are wrong by NEAR.
    """
    whole = [grid * round(measured / grid) for grid in (5.0, 1.0) if measured > SLOW_HZ]
    possible = [*((rate, NEAR) for rate in DEVICE_RATES), *((rate, max(NEAR, error)) for rate in whole)]
    near = (rate for rate, share in possible if abs(measured - rate) < share * rate)
    return next(near, float(f"{measured:.6g}"))


class SharedStamps:
    """Spreads the rows of each stamp evenly until the next stamp.

    Stamps may become coarser in the course of a recording: numbers with few digits, 999.96 and then 1000.1,
    share a stamp from some value on. A long step to the next stamp is not a gap if the rows of a stamp fill
    it. Where rows have a stamp each, only coarser ones are spread.

    The times of a group of rows are settled once the second stamp after it is known, so that they do not
    depend on where the pieces end in which the rows come; after `longest` rows a group ends in any case.
    """

    def __init__(self, pace: Pace) -> None:
        self._row_us, self._usual, self.longest = pace.period_us, pace.rows_per_stamp, pace.longest_group
        self._is_shared = pace.stamp_period_us > 0
        self._period = pace.stamp_period_us or round(pace.period_us)
        self._waiting = np.empty(0, np.int64)
        self._before, self._joined, self._coarse_us, self._early_us = NO_TIME, False, 0, 0

    def add(self, stamps: NDArray[np.int64], last: bool) -> NDArray[np.int64]:
        """Take the stamps of the next rows; return the times that are settled.

        Args:
            stamps: (n,) [us]. NO_TIME and IMPOSSIBLE count as the stamp before them, LOST as its own.
            last: no rows follow.

        Returns:
            Times [us] of the settled rows (of all if these are the last), beginning with those left over.
        """
        stamps = self._filled(np.concatenate((self._waiting, stamps)))
        starts = self._starts(stamps)
        ends = np.append(starts[1:], len(stamps))
        settled = len(starts) if last else max(len(starts) - 2, 0)
        self._waiting = stamps
        if not settled:
            return stamps[:0]
        self._waiting = stamps[ends[settled - 1] :].copy()
        around = np.concatenate(([self._before], stamps[starts], [NO_TIME]))
        self._before = int(around[settled])
        alone = not self._is_shared and len(starts) == len(stamps)
        return self._alone(around, settled) if alone else self._spread(around, ends - starts, settled)

    def _filled(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Put rows without a time into the group before them; they are left out later."""
        known = np.where(stamps <= IMPOSSIBLE, 0, np.arange(len(stamps)))
        return stamps[np.maximum.accumulate(known)]

    def _starts(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the first row of every group."""
        if not len(stamps):
            return np.empty(0, np.int64)
        starts = np.append(0, np.flatnonzero(np.diff(stamps)) + 1)
        sizes = np.diff(np.append(starts, len(stamps)))
        if sizes.max() <= self.longest:
            return starts
        groups = zip(starts, starts + sizes, strict=True)
        return np.concatenate([np.arange(start, end, self.longest) for start, end in groups])

    def _alone(self, around: NDArray[np.int64], settled: int) -> NDArray[np.int64]:
        """Return what `_spread` does for groups of one row each, sooner."""
        times, step = around[1 : settled + 1], np.diff(around[1 : settled + 2])
        fine = self._is_fine(step)
        if self._joined:
            times[0] -= self._early_us
        self._joined, self._early_us = bool(fine[-1]), 0
        self._coarse_us = 0 if fine.any() else self._coarse_us
        return times

    def _is_fine(self, step: NDArray[np.int64]) -> NDArray[np.bool_]:
        return (step > 0) & (step <= self._period * 3 // 2)

    def _spread(self, around: NDArray[np.int64], sizes: NDArray[np.int64], settled: int) -> NDArray[np.int64]:
        """Return times of the rows of the first groups of these stamps; `around` has one more at either end.

        A short group next to a gap is the rest of a stamp's time, at the usual pace: its end if the gap is
        before it, else its beginning. Coarser stamps are rounded ones, in the middle of their time.
        """
        steps, row_us = np.diff(around), self._row_us
        coarse, stamps = self._coarse(steps, sizes, settled), around[1 : settled + 1]
        sizes, step = sizes[:settled], steps[1 : settled + 1]
        period = np.where(coarse > 0, coarse, self._period)
        joined = (step > 0) & ((step <= period * 3 // 2) | (step <= self._filled_us(sizes)))
        step = np.where(joined, step, 0)
        period = np.where(joined & (2 * step < period), step, period)
        usual = np.maximum(np.rint(period / row_us), 1).astype(np.int64)
        usual = np.where(period == self._period, self._usual, usual)
        most = LONGEST_GROUP * np.maximum(usual, step // round(row_us))
        if (sizes > most).any():  # the clock stood still
            pieces = -(-sizes // most)
            piece, ends = np.repeat(np.arange(settled), pieces), np.cumsum(pieces) - 1
            left, last = sizes - most * (pieces - 1), np.isin(np.arange(len(piece)), ends)
            sizes = np.where(last, left[piece], most[piece])
            stamps, step, period, usual, coarse = (
                one[piece] for one in (stamps, step, period, usual, coarse)
            )
            step = np.where(last, step, 0)
        after = step > 0
        before, early = np.append(self._joined, after[:-1]), np.append(self._early_us, coarse[:-1] // 2)
        self._joined, self._early_us = bool(after[-1]), int(coarse[-1] // 2)
        early = np.where(before, early, coarse // 2)
        full = (sizes >= usual) | (after & (before | (step <= (sizes + 0.5) * row_us)))
        span = np.where(full & after, step - coarse // 2 + early, period)
        parts = np.where(full, sizes, usual)
        shift = np.where(~full & after, usual - sizes, 0)
        moved = self._is_shared | (coarse > 0)
        group = np.repeat(np.arange(len(sizes)), sizes)
        index = np.arange(len(group)) - np.repeat(np.cumsum(sizes) - sizes, sizes) + shift[group]
        into = (2 * index * (span * moved)[group] + parts[group]) // (2 * parts[group])
        return np.asarray((stamps - early)[group] + into)

    def _filled_us(self, sizes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the longest step [us] to the next stamp that groups of rows fill.

        A stamp is half as long where stamps become coarser: 10000 is all from 9999.95 to 10000.5.
        """
        filled = self._row_us * np.where(sizes >= 2 * self._usual, 2.0 * sizes + 2, FILLED * sizes)
        return np.where(self._is_shared | (sizes > 1), filled, 0.0)

    def _coarse(self, steps: NDArray[np.int64], sizes: NDArray[np.int64], settled: int) -> NDArray[np.int64]:
        """Return for the first groups how far apart [us] coarser stamps than usual are around them, else 0.

        The group before or after shows it by rows that fill a step which is longer than usual. `steps` are
        those before each group, and after the last.
        """
        step = steps[1:]
        fine = self._is_fine(step)
        may_be = ~fine & (self._is_shared | (sizes > 1))
        own = np.where(~fine & (step > 0) & (step <= self._filled_us(sizes)), step, 0)
        known = np.where(fine | (own > 0), np.arange(1, len(own) + 1), 0)
        held = np.append(self._coarse_us, own)[np.maximum.accumulate(np.append(0, known))]
        self._coarse_us = int(held[settled])
        coarse = np.maximum(held[:-1], np.minimum(np.append(own[1:], 0), step))
        return np.where(may_be, coarse, 0)[:settled]


def spread(stamps: NDArray[np.int64], pace: Pace) -> NDArray[np.int64]:
    """Return the times [us] of the rows (n,) that have one, spread if rows share them."""
    return SharedStamps(pace).add(stamps, last=True)[stamps > LOST]


# Makes the times of a table run on where its clock shows less than the time: counters that wrap, lost
# days.
#
# A counter of 16, 24 or 32 bits starts again after 2^16, 2^24 or 2^32 ticks. A logger may write the
# date of its start all night, or hours of a 12-hour clock without AM or PM. `find_wraps` says, by the
# first rows, by what such times may jump back and still run on; `RunningOn` puts them in order. A
# jump is treated as one of these only if no other reading of it is likely: the time after it has to
# be where the clock would have been.

WRAPPED = "clock_wrapped"
"""Code of the problem that says where times were read on."""

BITS = (16, 24, 32)
TICKS_US = (1.0, 1000.0)
"""Ticks of counters besides the unit of a column: a program may have made seconds of them."""

HOUR_US = 3600 * MICROSECONDS
DAY_US, MINUTE_US = 24 * HOUR_US, HOUR_US // 60
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


class Midnights:
    """Finds the day of times of the hour 24; the result does not depend on how the rows are cut.

    In ISO 8601 24:00:00 ends the day that is written; browsers write 24:00:01 for the first second of that
    day. The last row before tells which it is, since times do not go back.

    Args:
        before_us: a time for the rows before the first; see `time_before`.
    """

    def __init__(self, before_us: int = NO_TIME) -> None:
        self._before = before_us

    def settled(self, times: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the next times (n,) [us], each on its day."""
        late = times >= WITH_HOUR_24
        known = np.flatnonzero(~late & (times > LOST))
        if late.any():
            rows = np.flatnonzero(late)
            before = np.append(self._before, times[known])[np.searchsorted(known, rows)]
            times = times.copy()
            times[rows] -= HOUR_24
            times[rows] += np.where(before > times[rows] + MINUTE_US, DAY_US, 0)
        if len(known):
            self._before = int(times[known[-1]])
        return times


def time_before(head: NDArray[np.int64]) -> int:
    """Return a time [us] before the first ones of a table by which `Midnights` puts these on their day.

    If they are of the hour 24, the first other row tells whether that ends their day; if there is none, only
    24:00:00 does.
    """
    known = head[head > LOST]
    late = known >= WITH_HOUR_24
    number = len(late) if late.all() else int(np.argmin(late))
    if not number:
        return NO_TIME
    begun = known[:number] - HOUR_24
    ends = not (begun % MINUTE_US).any() if number == len(known) else begun[-1] + DAY_US <= known[number]
    return int(begun.max()) + 2 * MINUTE_US if ends else NO_TIME


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
