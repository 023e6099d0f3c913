"""The start time of a layout."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from accelcal_cli.readers._layout.keys import Keys
from accelcal_cli.readers._layout.model import StartTime

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
HINT = 'write it as "2024-03-04T00:00:00", with an offset such as +01:00 if it is known'


def parse_start(dump: Keys) -> StartTime | None:
    """`start_time` of [dump], as an ISO 8601 text or a TOML date and time."""
    value = dump.raw("start_time")
    if value is None:
        return None
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value.strip())
        except ValueError:
            raise dump.error("start_time", f"is {value!r}, which is not a date and time", HINT) from None
    if not isinstance(value, datetime):
        raise dump.error("start_time", f"is {value}, which is not a date and time", HINT)
    known = value.tzinfo is not None
    moment = value if known else value.replace(tzinfo=UTC)
    return StartTime((moment - EPOCH) // timedelta(microseconds=1), "UTC" if known else None)
