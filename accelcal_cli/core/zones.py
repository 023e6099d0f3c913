"""Time zones of device clocks.

A device's clock is set once and then runs on: it keeps the offset from UTC that its zone had when
the recording began, whatever daylight saving does in the meantime.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from accelcal_cli.core.errors import UsageError

_EPOCH = datetime(1970, 1, 1)
WIDEST_OFFSET_H = 14
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


def iso_time(time_us: int | None, offset_s: int | None) -> str | None:
    """ISO 8601 of a device's clock with microseconds, and its offset from UTC where known."""
    if time_us is None:
        return None
    shown = (_EPOCH + timedelta(microseconds=time_us)).isoformat(timespec="microseconds")
    if offset_s is None:
        return shown
    zone = datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=abs(offset_s))
    return f"{shown}{'-' if offset_s < 0 else '+'}{zone:%H:%M}"
