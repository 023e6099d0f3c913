"""Changes of a zone's offset from UTC, and clocks that follow them.

The clock of a device runs on. The clock of a computer follows the change: times in its tables skip an hour in
spring and repeat one in autumn. `LocalStamps` makes such times run on too, so that everything behind a reader
has one offset for a whole recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, tzinfo

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, iso_time, utc_offset_s

_DAY_S = 86_400

FOLLOWED = "clock_followed"
"""Code of the problem that says where times followed a change."""

PAUSE_US = 60 * MICROSECONDS
"""The longest pause between two rows of which one lies before a change and one behind it, if their times are
said to follow it."""

SHIFT_STEP_US, LARGEST_SHIFT_US = 1800 * MICROSECONDS, 3 * 3600 * MICROSECONDS
"""Clocks are put forward and back by multiples of half an hour, and by no more than that."""


@dataclass(frozen=True, slots=True)
class ZoneChange:
    """A zone changes its offset from UTC during a recording.

    Attributes:
        at_us: when, on a clock that had the zone's offset until then [us since 1970].
        before_s, after_s: seconds ahead of UTC.
        followed: whether the times did; None if they do not show it, and are taken for those of a clock
            that runs on.
    """

    zone: str
    at_us: int
    before_s: int
    after_s: int
    followed: bool | None = False

    def note(self) -> str:
        """For the report."""
        shift_s = self.after_s - self.before_s
        hours = f"{abs(shift_s) / 3600:g} h"
        put, off, wrong = ("forward", "behind", "late") if shift_s > 0 else ("back", "ahead of", "early")
        then = {
            True: "the times of this file follow that, and were read so",
            False: f"the device's clock was not, and is {hours} {off} local time from then on",
            None: "the rows that were read do not show whether the clock of this file was, too: it is taken "
            f"to be one that was not; if it was, later times are {hours} too {wrong}",
        }
        at = iso_time(self.at_us, self.before_s)
        return f"clocks in {self.zone} were put {put} by {hours} at {at}; {then[self.followed]}"


def zone_changes(zone: str | None, start_us: int, end_us: int) -> Iterator[ZoneChange]:
    """The changes of a zone's offset during a recording; none of a fixed or unknown zone.

    Args:
        start_us, end_us: local times of the first and last sample, on a clock that keeps its offset.
    """
    place = _place(zone)
    if zone is None or place is None:
        return
    try:
        offset_s = before_s = utc_offset_s(zone, start_us) or 0
        low_s, end_s = (time_us // MICROSECONDS - offset_s for time_us in (start_us, end_us))
        while low_s < end_s:
            high_s = min(low_s + _DAY_S, end_s)
            if (after_s := _offset_at(place, high_s)) != before_s:
                at_s = _first_other(place, low_s, high_s, before_s)
                yield ZoneChange(zone, (at_s + before_s) * MICROSECONDS, before_s, after_s)
                before_s = after_s
            low_s = high_s
    except (OverflowError, ValueError, OSError):
        return


def zone_change(zone: str | None, start_us: int, end_us: int) -> ZoneChange | None:
    """The first of them."""
    return next(zone_changes(zone, start_us, end_us), None)


def _place(zone: str | None) -> tzinfo | None:
    """A zone that may change its offset: one of a region and place."""
    from zoneinfo import ZoneInfo  # few recordings name one

    return None if zone is None or "/" not in zone else ZoneInfo(zone)


def _first_other(place: tzinfo, low_s: int, high_s: int, offset_s: int) -> int:
    """The first second with another offset, between one that has it and one that has not."""
    while high_s - low_s > 1:
        middle = (low_s + high_s) // 2
        low_s, high_s = (middle, high_s) if _offset_at(place, middle) == offset_s else (low_s, middle)
    return high_s


def _offset_at(place: tzinfo, utc_s: int) -> int:
    offset = datetime.fromtimestamp(utc_s, place).utcoffset()
    return 0 if offset is None else round(offset.total_seconds())


class LocalStamps:
    """Times of a table's rows, made those of a clock that runs on where they follow a change of their zone.

    They follow it where they jump by as much as its clocks did, right when these did. Any other jump stays.
    """

    def __init__(self, zone: str | None) -> None:
        self._zone = zone
        self._place = _place(zone)
        self._start_s: int | None = None
        self._offset_s = 0
        self._before = 0

    def running_on(self, times: NDArray[np.int64]) -> tuple[NDArray[np.int64], list[int]]:
        """The next times (n,) [us] on a clock that runs on; the rows before which they follow a change."""
        if self._place is None or not len(times):
            return times, []
        if self._start_s is None:
            self._before = int(times[0])
            self._start_s = self._offset_s = utc_offset_s(self._zone, self._before) or 0
        before = np.concatenate(([self._before], times[:-1]))
        self._before = int(times[-1])
        rows, running = [], times + (self._start_s - self._offset_s) * MICROSECONDS
        for row in _like_a_change(times - before):
            shift_s = self._shift_s(int(before[row]), int(times[row]))
            if shift_s:
                self._offset_s += shift_s
                running[row:] -= shift_s * MICROSECONDS
                rows.append(row)
        return running, rows

    def _shift_s(self, before_us: int, after_us: int) -> int:
        """By how much clocks were put forward between two rows, if the times were too; else 0."""
        assert self._place is not None
        utc_us = before_us - self._offset_s * MICROSECONDS
        try:
            now_s, then_s = (
                _offset_at(self._place, moment // MICROSECONDS) for moment in (utc_us, utc_us + PAUSE_US)
            )
            lasted_us = after_us - before_us - (then_s - now_s) * MICROSECONDS
            moved = now_s == self._offset_s and 0 <= lasted_us <= PAUSE_US
            moved = moved and _offset_at(self._place, (utc_us + lasted_us) // MICROSECONDS) == then_s
        except (OverflowError, ValueError, OSError):
            return 0
        return then_s - now_s if moved else 0


def _like_a_change(steps: NDArray[np.int64]) -> list[int]:
    """Which steps [us] may be those of clocks that are put forward or back, and a pause."""
    far = np.flatnonzero((np.abs(steps) > SHIFT_STEP_US // 2) & (np.abs(steps) <= LARGEST_SHIFT_US))
    rows: list[int] = far[steps[far] % SHIFT_STEP_US <= PAUSE_US].tolist()
    return rows
