"""Clocks of devices: their offsets from UTC, and the times of samples in whole microseconds.

A device's clock is set once and then runs on: it keeps the offset from UTC that its zone had when the
recording began, whatever daylight saving does in the meantime (`core/local_time.py`).

Sample times are computed only when they are needed: a `Clock` answers `times(start, stop)` for rows of one
chunk. All arithmetic is integer, so that the time of a sample does not depend on where its chunk begins.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from fractions import Fraction
from math import gcd
from typing import Any, NamedTuple, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UsageError, did_you_mean

_EPOCH = datetime(1970, 1, 1)
WIDEST_OFFSET_H = 14
MICROSECONDS = 1_000_000
_DAY_S = 86_400

FIRST_US, LAST_US = -62_135_596_800 * MICROSECONDS, 253_402_300_800 * MICROSECONDS - 1
"""First and last moment [us since 1970] at which a recording may begin, the years 1 to 9999."""

DIVIDED = 1 << 10
"""Smallest number of terms that `quotients` divides; dividing fewer saves no time."""

_CYCLE_YEARS, _CYCLE_US = 400, 146_097 * _DAY_S * MICROSECONDS
"""Length of the cycle after which the Gregorian calendar repeats itself."""

RESET_US = 366 * _DAY_S * MICROSECONDS
"""Jump of a clock, ahead or back, that no recording lasts: the clock was reset."""

LOOK_BACK = 16
"""Rows over which jitter does not set a clock back."""

ABBREVIATIONS = {
    "WET": ("Europe/Lisbon", "+00:00"), "BST": ("Europe/London", "+01:00"),
    "CET": ("Europe/Berlin", "+01:00"), "MET": ("Europe/Berlin", "+01:00"),
    "MEZ": ("Europe/Berlin", "+01:00"), "CEST": ("Europe/Berlin", "+02:00"),
    "EET": ("Europe/Helsinki", "+02:00"), "EEST": ("Europe/Helsinki", "+03:00"),
    "EST": ("America/New_York", "-05:00"), "EDT": ("America/New_York", "-04:00"),
    "CDT": ("America/Chicago", "-05:00"), "MST": ("America/Denver", "-07:00"),
    "MDT": ("America/Denver", "-06:00"), "PST": ("America/Los_Angeles", "-08:00"),
    "PDT": ("America/Los_Angeles", "-07:00"), "AEST": ("Australia/Sydney", "+10:00"),
    "AEDT": ("Australia/Sydney", "+11:00"), "NZST": ("Pacific/Auckland", "+12:00"),
}  # fmt: skip
"""Abbreviations of zones with summer time: a place, and the offset from UTC that each stands for."""

_FIXED = re.compile(r"(?:UTC|GMT)?\s*([+-])(\d{1,2}):?(\d{2})?")
CACHED = 1 << 14
"""Number of steps that are processed together; the processor's cache holds them."""

WIDEST = int(np.iinfo(np.uint8).max)
"""Largest difference between steps [us] that fits into one byte each."""


def utc_offset_s(zone: str | None, start_us: int, *, fold: int = 0) -> int | None:
    """Return the seconds that a clock of this zone was ahead of UTC at `start_us`; None for no zone.

    Args:
        zone: an IANA name of a region and place, such as Europe/Berlin; `UTC`; or a fixed offset
            such as +01:00.
        start_us: local time of the first sample, microseconds since 1970.
        fold: which of two equal local times is meant: 0 for the first, as in `datetime`.

    Raises:
        UsageError: the zone does not exist.
    """
    if zone is None:
        return None
    place = _place_of(zone)
    offset = (_EPOCH + timedelta(microseconds=start_us)).replace(tzinfo=place, fold=fold).utcoffset()
    return 0 if offset is None else round(offset.total_seconds())


def _place_of(zone: str) -> tzinfo:
    """Return the zone of this name; raises UsageError if there is none."""
    if zone.upper() in ("UTC", "GMT", "Z"):
        return UTC
    fixed = _FIXED.fullmatch(zone)
    if fixed is not None and int(fixed[2]) <= WIDEST_OFFSET_H and int(fixed[3] or 0) < 60:
        ahead = timedelta(hours=int(fixed[2]), minutes=int(fixed[3] or 0))
        return timezone(-ahead if fixed[1] == "-" else ahead)
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones  # few name a region and place

    try:
        if "/" not in zone:
            raise ZoneInfoNotFoundError(zone)
        return ZoneInfo(zone)
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        if (known := ABBREVIATIONS.get(zone.upper())) is not None:
            what = f"time zone {zone!r} does not say whether its clocks change in summer"
            raise UsageError(what, hint="give {} if they do, or {} if not".format(*known)) from error
        meant = did_you_mean(zone, (name for name in available_timezones() if "/" in name))
        raise UsageError(
            f"unknown time zone {zone!r}",
            hint=meant or "give a name such as Europe/Berlin, or an offset such as +01:00",
        ) from error


def offset_at_s(zone: str, utc_us: int) -> int:
    """Return the seconds that a clock of this zone is ahead of UTC at a moment [us since 1970, UTC].

    Raises:
        UsageError: the zone does not exist.
    """
    day_us = _DAY_S * MICROSECONDS
    inside_us = min(max(utc_us, FIRST_US + day_us), LAST_US - day_us)
    moment = _EPOCH.replace(tzinfo=UTC) + timedelta(microseconds=inside_us)
    offset = moment.astimezone(_place_of(zone)).utcoffset()
    return 0 if offset is None else round(offset.total_seconds())


@dataclass(frozen=True, slots=True)
class StartTime:
    """Time of the first sample [us since 1970]; `timezone` is UTC if it was written with Z or an offset."""

    start_us: int
    timezone: str | None
    had_offset: bool = False


def start_of(written: datetime) -> StartTime | None:
    """Return a start time that was written; None if it lies outside the years 1 to 9999 in UTC."""
    known = written.tzinfo is not None
    moment = written if known else written.replace(tzinfo=UTC)
    start_us = (moment - _EPOCH.replace(tzinfo=UTC)) // timedelta(microseconds=1)
    if not FIRST_US <= start_us <= LAST_US:
        return None
    return StartTime(start_us, "UTC" if known else None, bool(moment.utcoffset()))


@overload
def iso_time(time_us: int, offset_s: int | None) -> str: ...
@overload
def iso_time(time_us: int | None, offset_s: int | None) -> str | None: ...
def iso_time(time_us: int | None, offset_s: int | None) -> str | None:
    """Format a time of a device's clock as ISO 8601 with microseconds, and its offset from UTC where known.

    Times outside the years 1 to 9999 take the expanded form, `+10000-01-01T...`.
    """
    if time_us is None:
        return None
    cycles = 0 if FIRST_US <= time_us <= LAST_US else time_us // _CYCLE_US
    moment = _EPOCH + timedelta(microseconds=time_us - cycles * _CYCLE_US)
    shown = moment.isoformat(timespec="microseconds")
    if cycles:
        shown = f"{moment.year + cycles * _CYCLE_YEARS:+06d}{shown[4:]}"
    if offset_s is None:
        return shown
    zone = datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=abs(offset_s))
    return f"{shown}{'-' if offset_s < 0 else '+'}{zone:%H:%M}"


@dataclass(frozen=True, slots=True, eq=False)
class TimeSteps:
    """Times of n rows, at least one, stored as the steps between them.

    The steps of a steady clock differ by less than a byte holds, an eighth of the memory of times; and clocks
    often know the steps without computing the time of any row.

    Attributes:
        first_us, last_us: times of the first and of the last row [us since 1970].
        least_us: the shortest step from a row to the next, negative where time goes back; 0 for one row.
        above: (n - 1,) how much longer each step is: uint8, or int64 if they differ by more than WIDEST.
    """

    first_us: int
    last_us: int
    least_us: int
    above: NDArray[Any]

    def __len__(self) -> int:
        return len(self.above) + 1

    def times(self) -> NDArray[np.int64]:
        """Return the times of all rows [us since 1970], (n,)."""
        times = np.empty(len(self), np.int64)
        times[0] = self.first_us
        np.add(self.above, self.least_us, out=times[1:], dtype=np.int64)
        return np.cumsum(times, out=times)


def steps_of(times_us: NDArray[np.int64]) -> TimeSteps:
    """Return the steps between times (n,) of at least one row."""
    last = len(times_us) - 1
    ends = [(start, min(start + CACHED, last)) for start in range(0, last, CACHED)]
    bounds = [_bounds(np.diff(times_us[start : stop + 1])) for start, stop in ends]
    least, most = min((low for low, _ in bounds), default=0), max((high for _, high in bounds), default=0)
    above: NDArray[Any] = np.empty(last, _kind(least, most))
    for start, stop in ends:
        np.subtract(np.diff(times_us[start : stop + 1]), least, out=above[start:stop], casting="unsafe")
    return TimeSteps(int(times_us[0]), int(times_us[-1]), least, above)


def joined_steps(parts: Sequence[TimeSteps]) -> TimeSteps:
    """Join the steps of rows, at least one, that follow one another."""
    if len(parts) == 1:
        return parts[0]
    first, last = (np.array([getattr(part, end) for part in parts]) for end in ("first_us", "last_us"))
    between = first[1:] - last[:-1]
    least, most = _bounds(between)
    several = [part for part in parts if len(part.above)]
    least = min([least, *(part.least_us for part in several)])
    most = max([most, *(part.least_us + int(part.above.max()) for part in several)])
    if _kind(least, most) is np.int64 or any(part.above.dtype == np.int64 for part in several):
        return steps_of(np.concatenate([part.times() for part in parts]))
    above, at = np.empty(sum(map(len, parts)) - 1, np.uint8), 0
    for part, step in zip(parts, [*between.tolist(), least], strict=True):
        if len(part.above):
            np.add(part.above, np.uint8(part.least_us - least), out=above[at : at + len(part.above)])
        at += len(part)
        above[at - 1 : at] = step - least  # nothing behind the last part
    return TimeSteps(parts[0].first_us, parts[-1].last_us, least, above)


def _bounds(steps: NDArray[np.int64]) -> tuple[int, int]:
    return int(steps.min()), int(steps.max())


def _kind(least: int, most: int) -> type:
    """Return the type that holds the differences from the shortest step."""
    return np.uint8 if most - least <= WIDEST else np.int64


class Clock(Protocol):
    """Times of the rows of a chunk."""

    def times(self, start: int, stop: int) -> NDArray[np.int64]:
        """Return the times of rows start..stop-1 [us since 1970, device clock], (stop - start,)."""

    def steps(self, start: int, stop: int) -> TimeSteps:
        """Return the same times, of at least one row, as the steps between them."""

    def part(self, start: int, stop: int) -> Clock:
        """Return the clock of rows start..stop-1, counted from 0."""

    def shifted(self, by_us: int) -> Clock:
        """Return the clock of the same rows, put forward by `by_us`."""


class ClockReset(NamedTuple):
    """A jump by which a clock was reset: the first sample after it, and the times around it [us]."""

    sample: int
    before_us: int
    after_us: int


class Stretches:
    """Follows the times of all rows, and adds up the stretches of a clock that may restart.

    A new one begins where it jumps by more than `RESET_US`, or goes back, unless it only returns: to
    a time after the one before the last jump ahead, as after stamps that came late, or after the one
    `LOOK_BACK` rows before, as where stamps jitter.

    Args:
        period_us: time from one sample to the next.

    Attributes:
        samples: number of rows so far.
        first_us, last_us: times of the first and the last; None before the first.
        resets: jumps by a day back, or by more than `RESET_US` ahead, the first MOST of them.
    """

    MOST = 100

    def __init__(self, period_us: int) -> None:
        self._period_us = period_us
        self._left_us = int(np.iinfo(np.int64).max)
        self._excess_us = self.samples = 0
        self._last_times = np.empty(0, np.int64)
        self.first_us: int | None = None
        self.resets: list[ClockReset] = []

    @property
    def last_us(self) -> int | None:
        """See the attributes."""
        return int(self._last_times[-1]) if self.samples else None

    @property
    def span_us(self) -> int:
        """Time from the first row to the last, with one period in place of each jump to a new beginning."""
        if self.first_us is None:
            return 0
        return max(0, int(self._last_times[-1]) - self.first_us - self._excess_us)

    def add(
        self, clock: Clock, rows: int, breaks: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Take the next rows, at least one.

        Args:
            breaks: (n,) rows before which the times may jump, not the first of all.

        Returns:
            Times (n,) of the rows before them, and of these rows [us].
        """
        if self.first_us is None:
            self.first_us = int(clock.times(0, 1)[0])
            self._last_times = np.full(LOOK_BACK, self.first_us)
        before = after = breaks
        if len(breaks):
            times = np.append(self._last_times, clock.times(0, rows))
            earlier, before, after = (times[breaks + ahead] for ahead in (0, LOOK_BACK - 1, LOOK_BACK))
            steps = after - before
            far, ahead = np.abs(steps) > RESET_US, steps > self._period_us
            left = np.append(self._left_us, np.where(far, after, before))
            last = np.maximum.accumulate(np.append(0, np.where(ahead, np.arange(1, len(steps) + 1), 0)))
            self._left_us = int(left[last[-1]])
            anew = far | ((steps < 0) & (after <= earlier) & (after <= left[last[:-1]]))
            self._excess_us += sum((steps[anew] - self._period_us).tolist())
            large = np.flatnonzero(far | (anew & (steps <= -_DAY_S * MICROSECONDS)))
            for row in large[: self.MOST - len(self.resets)].tolist():
                sample = int(self.samples + breaks[row])
                self.resets.append(ClockReset(sample, int(before[row]), int(after[row])))
        last = clock.times(max(0, rows - LOOK_BACK), rows)
        self._last_times = np.append(self._last_times, last)[-LOOK_BACK:]
        self.samples += rows
        return before, after


def rate_fraction(rate_hz: float) -> Fraction:
    """Return the sampling rate as a fraction small enough for exact 64-bit time arithmetic."""
    return Fraction(rate_hz).limit_denominator(10_000)


@dataclass(frozen=True, slots=True)
class UniformClock:
    """Clock of an even rate: sample k lies at start_us + k / rate, rounded to the nearest us.

    `first_index` is the sample number of the chunk's row 0, counted from `start_us`.
    """

    start_us: int
    first_index: int
    rate: Fraction

    def times(self, start: int, stop: int) -> NDArray[np.int64]:
        """See `Clock`."""
        step = MICROSECONDS * self.rate.denominator
        base = (self.first_index + start) * step + self.rate.numerator // 2
        return self.start_us + quotients(base, step, self.rate.numerator, stop - start)

    def steps(self, start: int, stop: int) -> TimeSteps:
        """See `Clock`."""
        return steps_of(self.times(start, stop))

    def part(self, start: int, stop: int) -> UniformClock:
        """See `Clock`."""
        return UniformClock(self.start_us, self.first_index + start, self.rate)

    def shifted(self, by_us: int) -> UniformClock:
        """See `Clock`."""
        return UniformClock(self.start_us + by_us, self.first_index, self.rate)


def quotients(first: int, step: int, divisor: int, number: int) -> NDArray[np.int64]:
    """Return (first + i step) // divisor for i = 0 to number - 1, for a positive divisor.

    The terms repeat, plus a whole number, after divisor / gcd(step, divisor) of them: only these are divided.
    """
    whole, rest = divmod(first, divisor)
    period = divisor // gcd(step, divisor)
    length = min(number, -(-DIVIDED // period) * period)
    once = whole + (rest + np.arange(length, dtype=np.int64) * step) // divisor
    if length == number:
        return once
    again = np.arange(-(-number // length), dtype=np.int64) * (length * step // divisor)
    return np.add(once, again[:, np.newaxis]).reshape(-1)[:number]


@dataclass(frozen=True, slots=True)
class StampClock:
    """Clock that stores the time of every row: `time_us` (n,) int64."""

    time_us: NDArray[np.int64]

    def times(self, start: int, stop: int) -> NDArray[np.int64]:
        """See `Clock`."""
        return self.time_us[start:stop]

    def steps(self, start: int, stop: int) -> TimeSteps:
        """See `Clock`."""
        return steps_of(self.times(start, stop))

    def part(self, start: int, stop: int) -> StampClock:
        """See `Clock`."""
        return StampClock(self.time_us[start:stop])

    def shifted(self, by_us: int) -> StampClock:
        """See `Clock`."""
        return StampClock(self.time_us + by_us)


@dataclass(frozen=True, slots=True)
class PageClock:
    """Clock of rows that are evenly spread between the time stamps of pages.

    Page j starts at row `first_row[j]` and at `time_us[j]`; `span_rows[j]` rows take
    `span_us[j]`. All are int64 arrays of shape (pages,); first_row ascends from 0 or below.
    """

    first_row: NDArray[np.int64]
    time_us: NDArray[np.int64]
    span_rows: NDArray[np.int64]
    span_us: NDArray[np.int64]

    def times(self, start: int, stop: int) -> NDArray[np.int64]:
        """See `Clock`."""
        if stop <= start:
            return np.empty(0, np.int64)
        pages = self._pages(start, stop)
        if pages.stop - pages.start == 1:
            return self._of_one(pages.start, start, stop - start)
        skipped = start - int(self.first_row[pages.start])
        rows = self._rows_of_each(pages, stop)
        if rows is not None:
            into, which = self._spread(pages, rows)
            times: NDArray[np.int64] = into[which]
            times += self.time_us[pages, np.newaxis]
            return times.reshape(-1)[skipped : skipped + stop - start]
        on_each = np.diff(np.append(self.first_row[pages], stop))
        on_each[0] -= skipped
        span = np.repeat(self.span_rows[pages], on_each)
        uneven = np.arange(len(span), dtype=np.int64) - np.repeat(np.cumsum(on_each) - on_each, on_each)
        uneven[: on_each[0]] += skipped
        uneven *= np.repeat(self.span_us[pages], on_each)
        return np.asarray(np.repeat(self.time_us[pages], on_each) + (2 * uneven + span) // (2 * span))

    def steps(self, start: int, stop: int) -> TimeSteps:
        """See `Clock`."""
        pages = self._pages(start, stop)
        rows = None if pages.stop - pages.start == 1 else self._rows_of_each(pages, stop)
        steps = None if rows is None or rows == 1 else self._even_steps(pages, rows, start, stop)
        return steps_of(self.times(start, stop)) if steps is None else steps

    def part(self, start: int, stop: int) -> PageClock:
        """See `Clock`; keeps only the pages that the rows lie on."""
        low = int(np.searchsorted(self.first_row, start, side="right")) - 1
        pages = slice(max(low, 0), int(np.searchsorted(self.first_row, stop, side="left")))
        first_row, columns = self.first_row[pages] - start, (self.time_us, self.span_rows, self.span_us)
        return PageClock(first_row, *(column[pages] for column in columns))

    def shifted(self, by_us: int) -> PageClock:
        """See `Clock`."""
        return PageClock(self.first_row, self.time_us + by_us, self.span_rows, self.span_us)

    def _of_one(self, page: int, start: int, number: int) -> NDArray[np.int64]:
        """Return the times of `number` rows of one page from row `start` on."""
        into, rows = start - int(self.first_row[page]), int(self.span_rows[page])
        span_us = int(self.span_us[page])
        return quotients(2 * into * span_us + rows, 2 * span_us, 2 * rows, number) + int(self.time_us[page])

    def _pages(self, start: int, stop: int) -> slice:
        low, last = np.searchsorted(self.first_row, (start, stop - 1), side="right") - 1
        return slice(int(low), int(last) + 1)

    def _rows_of_each(self, pages: slice, stop: int) -> int | None:
        """Return the number of rows of each page; None if they differ.

        The last page may continue after row stop-1.
        """
        rows = np.diff(np.append(self.first_row[pages], stop))
        longest = int(rows.max())
        alike = (rows[:-1] == longest).all() and (self.span_rows[pages] == longest).all()
        return longest if alike else None

    def _spread(self, pages: slice, rows: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return how long after its page's time each of `rows` rows lies, and the line of that for each page.

        Few different spans occur among the pages of a device: each is divided up once.
        """
        spans, which = np.unique(self.span_us[pages], return_inverse=True)
        into = np.outer(spans, 2 * np.arange(rows, dtype=np.int64))
        into += rows
        into //= 2 * rows
        return into, which

    def _even_steps(self, pages: slice, rows: int, start: int, stop: int) -> TimeSteps | None:
        """Return the steps between rows of pages with equally many; None if they differ too much."""
        into, which = self._spread(pages, rows)
        begins = self.time_us[pages]
        within, across = np.diff(into), np.diff(begins) - into[which[:-1], -1]
        least = min(int(within.min()), int(across.min()))
        most = max(int(within.max()), int(across.max()))
        if most - least > WIDEST:
            return None
        lines = np.zeros(into.shape, np.uint8)
        lines[:, :-1] = within - least
        above = lines.take(which, axis=0)
        above[:-1, -1] = across - least
        first, last = start - int(self.first_row[pages.start]), stop - 1 - int(self.first_row[pages.stop - 1])
        wanted = above.reshape(-1)[first : first + stop - start - 1]
        shorter = int(wanted.min())
        return TimeSteps(
            int(begins[0] + into[which[0], first]),
            int(begins[-1] + into[which[-1], last]),
            least + shorter,
            wanted - np.uint8(shorter) if shorter else wanted,
        )


@dataclass(frozen=True, slots=True)
class JoinedClock:
    """Clock of the `rows` rows of one clock, then those of another."""

    first: Clock
    rows: int
    second: Clock

    def times(self, start: int, stop: int) -> NDArray[np.int64]:
        """See `Clock`."""
        before = self.first.times(min(start, self.rows), min(stop, self.rows))
        after = self.second.times(max(start - self.rows, 0), max(stop - self.rows, 0))
        return np.concatenate((before, after))

    def steps(self, start: int, stop: int) -> TimeSteps:
        """See `Clock`."""
        if start >= self.rows:
            return self.second.steps(start - self.rows, stop - self.rows)
        if stop <= self.rows:
            return self.first.steps(start, stop)
        return joined_steps([self.first.steps(start, self.rows), self.second.steps(0, stop - self.rows)])

    def part(self, start: int, stop: int) -> Clock:
        """See `Clock`."""
        if start >= self.rows:
            return self.second.part(start - self.rows, stop - self.rows)
        if stop <= self.rows:
            return self.first.part(start, stop)
        return JoinedClock(
            self.first.part(start, self.rows), self.rows - start, self.second.part(0, stop - self.rows)
        )

    def shifted(self, by_us: int) -> JoinedClock:
        """See `Clock`."""
        return JoinedClock(self.first.shifted(by_us), self.rows, self.second.shifted(by_us))
