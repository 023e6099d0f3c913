"""Time zones of device clocks.

A device's clock is set once and then runs on: it keeps the offset from UTC that its zone had when
the recording began, whatever daylight saving does in the meantime.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, tzinfo

from accelcal_cli.core.errors import UsageError

_EPOCH = datetime(1970, 1, 1)
WIDEST_OFFSET_H = 14
MICROSECONDS = 1_000_000
_DAY_S = 86_400
_FIXED = re.compile(r"(?:UTC|GMT)?\s*([+-])(\d{1,2}):?(\d{2})?")


def utc_offset_s(zone: str | None, start_us: int) -> int | None:
    """Seconds that a clock of this zone was ahead of UTC at `start_us`; None for no zone.

    Args:
        zone: an IANA name of a region and place, such as Europe/Berlin; `UTC`; or a fixed offset
            such as +01:00.
        start_us: local time of the first sample, microseconds since 1970.

    Raises:
        UsageError: the zone does not exist.
    """
    if zone is None:
        return None
    if zone.upper() in ("UTC", "GMT", "Z"):
        return 0
    fixed = _FIXED.fullmatch(zone)
    if fixed is not None and int(fixed[2]) <= WIDEST_OFFSET_H and int(fixed[3] or 0) < 60:
        seconds = int(fixed[2]) * 3600 + int(fixed[3] or 0) * 60
        return -seconds if fixed[1] == "-" else seconds
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError  # few recordings name a region and place

    try:
        if "/" not in zone:
            raise ZoneInfoNotFoundError(zone)
        local = (_EPOCH + timedelta(microseconds=start_us)).replace(tzinfo=ZoneInfo(zone))
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        raise UsageError(
            f"unknown time zone {zone!r}",
            hint="give a name such as Europe/Berlin, or an offset such as +01:00",
        ) from error
    offset = local.utcoffset()
    return 0 if offset is None else round(offset.total_seconds())


@dataclass(frozen=True, slots=True)
class ZoneChange:
    """A zone changes its offset from UTC while a device's clock keeps the one it had.

    Attributes:
        at_us: when, on the device's clock [us since 1970].
        before_s, after_s: seconds ahead of UTC.
    """

    zone: str
    at_us: int
    before_s: int
    after_s: int

    def note(self) -> str:
        """For the report."""
        shift_s = self.after_s - self.before_s
        hours = f"{abs(shift_s) / 3600:g} h"
        put, off = ("forward", "behind") if shift_s > 0 else ("back", "ahead of")
        return (
            f"clocks in {self.zone} were put {put} by {hours} at {iso_time(self.at_us, self.before_s)}; the "
            f"device's clock was not, and is {hours} {off} local time from then on"
        )


def zone_change(zone: str | None, start_us: int, end_us: int) -> ZoneChange | None:
    """The first change of a zone's offset during a recording; None for a fixed or unknown zone.

    Args:
        start_us, end_us: local times of the first and last sample, on a clock that keeps its offset.
    """
    if zone is None or "/" not in zone:
        return None
    from zoneinfo import ZoneInfo

    try:
        before_s = utc_offset_s(zone, start_us) or 0
        low_s = start_us // MICROSECONDS - before_s
        end_s = end_us // MICROSECONDS - before_s
        place = ZoneInfo(zone)
        while low_s < end_s:
            high_s = min(low_s + _DAY_S, end_s)
            if (after_s := _offset_at(place, high_s)) != before_s:
                at_s = _first_other(place, low_s, high_s, before_s)
                return ZoneChange(zone, (at_s + before_s) * MICROSECONDS, before_s, after_s)
            low_s = high_s
    except (OverflowError, ValueError, OSError):
        return None
    return None


def _first_other(place: tzinfo, low_s: int, high_s: int, offset_s: int) -> int:
    """The first second with another offset, between one that has it and one that has not."""
    while high_s - low_s > 1:
        middle = (low_s + high_s) // 2
        low_s, high_s = (middle, high_s) if _offset_at(place, middle) == offset_s else (low_s, middle)
    return high_s


def _offset_at(place: tzinfo, utc_s: int) -> int:
    offset = datetime.fromtimestamp(utc_s, place).utcoffset()
    return 0 if offset is None else round(offset.total_seconds())


def iso_time(time_us: int | None, offset_s: int | None) -> str | None:
    """ISO 8601 of a device's clock with microseconds, and its offset from UTC where known."""
    if time_us is None:
        return None
    shown = (_EPOCH + timedelta(microseconds=time_us)).isoformat(timespec="microseconds")
    if offset_s is None:
        return shown
    zone = datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=abs(offset_s))
    return f"{shown}{'-' if offset_s < 0 else '+'}{zone:%H:%M}"
