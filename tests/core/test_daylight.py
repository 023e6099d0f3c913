"""Changes of a zone's offset while a device's clock runs on, against published dates."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from accelcal_cli.core.daylight import zone_change


def us(text: str) -> int:
    return int(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()) * 1_000_000


@pytest.mark.parametrize(
    ("zone", "start", "end", "at", "hours"),
    [
        ("Europe/Berlin", "2024-03-28T12:00", "2024-04-04T12:00", "2024-03-31T02:00", 1),
        ("Europe/Berlin", "2024-10-25T12:00", "2024-11-01T12:00", "2024-10-27T03:00", -1),
        ("America/New_York", "2024-03-08T12:00", "2024-03-12T12:00", "2024-03-10T02:00", 1),
        ("Australia/Lord_Howe", "2024-04-01T00:00", "2024-04-12T00:00", "2024-04-07T02:00", -0.5),
        ("Europe/Berlin", "2024-01-01T00:00", "2024-12-31T00:00", "2024-03-31T02:00", 1),
    ],
)
def test_a_change_is_found_to_the_second(zone: str, start: str, end: str, at: str, hours: float) -> None:
    found = zone_change(zone, us(start), us(end))
    assert found is not None
    assert found.at_us == us(at)
    assert found.after_s - found.before_s == hours * 3600
    assert ("forward" in found.note()) == (hours > 0)
    assert f"{at}:00" in found.note()
    assert zone_change(zone, us(start), us(at) - 1_000_000) is None
    later = us(at) + 7_200_000_000
    assert zone_change(zone, later, later + 86_400_000_000) is None


@pytest.mark.parametrize("zone", [None, "UTC", "+01:00", "Africa/Nairobi"])
def test_what_has_no_change_has_none(zone: str | None) -> None:
    assert zone_change(zone, us("2024-01-01T00:00"), us("2024-12-31T00:00")) is None


def test_times_beyond_any_calendar_have_none() -> None:
    assert zone_change("Europe/Berlin", 1 << 60, (1 << 60) + 10**12) is None
