"""Whose time zone counts, and what daylight saving makes of a start."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from accelcal_cli.core.clock import utc_offset_s
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.local_time import ZoneChange, in_its_zone, zone_changes
from accelcal_cli.core.recording import Recording

WINTER, SUMMER = "2024-01-15T12:00", "2024-07-15T12:00"


def recording(zone: str | None, start: str | None = WINTER, *, has_offsets: bool = False) -> Recording:
    start_us = (
        None if start is None else round(datetime.fromisoformat(start).replace(tzinfo=UTC).timestamp() * 1e6)
    )
    return Recording(
        Path("a.bin"), "flash", 100.0, 256.0, 0, start_us=start_us, timezone=zone, has_offsets=has_offsets
    )


@pytest.mark.parametrize(
    ("stated", "wanted", "force", "counts"),
    [
        (None, None, False, None),
        (None, "Europe/Berlin", False, "Europe/Berlin"),
        ("-05:00", None, False, "-05:00"),
        ("+01:00", "Europe/Berlin", False, "+01:00"),
        ("UTC", "+00:00", False, "UTC"),
        ("+01:00", "Europe/Berlin", True, "Europe/Berlin"),
        ("UTC", "Asia/Tokyo", True, "Asia/Tokyo"),
        (None, "Asia/Tokyo", True, "Asia/Tokyo"),
    ],
)
def test_the_files_own_zone_counts_unless_the_users_is_forced(
    stated: str | None, wanted: str | None, force: bool, counts: str | None
) -> None:
    assert in_its_zone(recording(stated), wanted, force=force).timezone == counts


@pytest.mark.parametrize(("stated", "start"), [("+01:00", SUMMER), ("UTC", WINTER), ("-05:00", None)])
def test_a_contradiction_names_both_zones_and_the_way_out(stated: str, start: str | None) -> None:
    with pytest.raises(UsageError) as failure:
        in_its_zone(recording(stated, start), "Europe/Berlin", force=False)
    text = str(failure.value)
    assert all(
        word in text
        for word in (stated, "Europe/Berlin", "a.bin", "omit --timezone", "-R force_timezone=true")
    )


def test_offsets_written_with_the_times_cannot_be_replaced() -> None:
    with pytest.raises(UsageError, match="offsets from UTC, which -R force_timezone cannot replace"):
        in_its_zone(recording("UTC", has_offsets=True), "Europe/Berlin", force=True)


@pytest.mark.parametrize(
    ("start", "offset_h", "note"),
    [
        ("2024-10-27T02:30", 2, "occurs twice in Europe/Berlin on that day: it is taken to be the first"),
        ("2024-03-31T02:30", 1, "does not occur in Europe/Berlin on that day"),
        ("2024-10-27T03:00", 1, None),
        ("2024-03-31T03:00", 2, None),
    ],
)
def test_a_start_that_daylight_saving_made_ambiguous_is_told(
    start: str, offset_h: int, note: str | None
) -> None:
    found = in_its_zone(recording(None, start), "Europe/Berlin", force=False)
    assert [note in text for text in found.notes] == ([] if note is None else [True])  # type: ignore[operator]
    assert utc_offset_s(found.timezone, found.start_us or 0) == 3600 * offset_h


def zone_change(zone: str | None, start_us: int, end_us: int) -> ZoneChange | None:
    return next(zone_changes(zone, start_us, end_us), None)


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
