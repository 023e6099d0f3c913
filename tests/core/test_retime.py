"""What a user states of times: starts, shifts and zones, against `datetime` and `zoneinfo`."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path
from random import Random
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow.parquet as pq
import pytest

import accelcal
from accelcal_cli.core.clock import (
    Clock,
    JoinedClock,
    PageClock,
    StampClock,
    UniformClock,
    offset_at_s,
    utc_offset_s,
)
from accelcal_cli.core.errors import UsageError
from tests.cli.run import assert_one_line, run, verify
from tests.device_recordings import edit
from tests.formats import make_csv, make_hdf5
from tests.formats.reading import Read
from tests.recordings import directions, good_csv, good_raw, still_counts

Capture = pytest.CaptureFixture[str]
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
NOON = datetime(2024, 3, 4, 12, tzinfo=UTC)
ROWS = "".join(f"{0.001 * (row % 7):g},0.02,1\n" for row in range(100))
PLAIN = "x [g],y [g],z [g]\n" + ROWS
ZONES = ("Europe/Berlin", "America/New_York", "Asia/Kolkata", "Australia/Lord_Howe", "Pacific/Apia", "UTC")


def us(moment: datetime) -> int:
    return (moment - EPOCH) // timedelta(microseconds=1)


def utc_us(found: Read) -> list[int]:
    """Its times as the Parquet file has them."""
    offset_s = utc_offset_s(found.recording.timezone, int(found.times[0]))
    assert offset_s is not None
    return (found.times - offset_s * 10**6).tolist()


def written_by(zone: str, times: list[datetime], path: Path) -> Path:
    """A table with the local times of a computer in a zone."""
    stamps = [moment.astimezone(ZoneInfo(zone)).strftime("%Y-%m-%d %H:%M:%S.%f") for moment in times]
    rows = [f"{stamp},{0.001 * (k % 7):g},0.02,1" for k, stamp in enumerate(stamps)]
    path.write_text("\n".join(["time,x [g],y [g],z [g]", *rows, ""]))
    return path


CLOCKS: list[Clock] = [
    UniformClock(5, 3, Fraction(100, 3)),
    StampClock(np.arange(20) ** 2),
    PageClock(*(np.array(v, np.int64) for v in ([-3, 7, 9], [0, 90, 500], [10, 2, 30], [80, 33, 1000]))),
]
CLOCKS.append(JoinedClock(CLOCKS[0], 6, CLOCKS[2]))


@pytest.mark.parametrize("clock", CLOCKS, ids=lambda clock: type(clock).__name__)
def test_a_clock_is_put_forward_as_a_whole(clock: Clock) -> None:
    for by_us in (0, 1, -(10**13), 10**15):
        assert (clock.shifted(by_us).times(2, 18) == clock.times(2, 18) + by_us).all()
        assert (clock.shifted(by_us).part(3, 15).times(0, 12) == clock.times(3, 15) + by_us).all()


@pytest.mark.parametrize("zone", [*ZONES, "+05:45", "-11:00"])
def test_the_offset_at_a_moment_is_that_of_zoneinfo(zone: str) -> None:
    dice, place = Random(5), ZoneInfo(zone) if "/" in zone else None
    moments = [
        datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=dice.randrange(10**9)) for _ in range(300)
    ]
    moments += [datetime(2024, 10, 27, hour, 30, tzinfo=UTC) for hour in range(3)]
    moments += [datetime(2024, 11, 3, hour, 30, tzinfo=UTC) for hour in range(4, 8)]
    moments += [
        datetime(2024, 4, 6, hour, minute, tzinfo=UTC) for hour in range(13, 17) for minute in (10, 40)
    ]
    for moment in moments:
        if place is not None:
            expected = moment.astimezone(place).utcoffset() or timedelta()
            assert offset_at_s(zone, us(moment)) == expected.total_seconds(), moment
        else:
            assert offset_at_s(zone, us(moment)) == utc_offset_s(zone, 0)


@pytest.mark.parametrize(
    ("start", "first", "zone"),
    [
        ("2024-03-04T10:00:00.25", datetime(2024, 3, 4, 10, 0, 0, 250_000, UTC), None),
        ("2024-03-04 10:00", datetime(2024, 3, 4, 10, tzinfo=UTC), None),
        ("2024-03-04", datetime(2024, 3, 4, tzinfo=UTC), None),
        ("2024-03-04T10:00:00+05:30", datetime(2024, 3, 4, 4, 30, tzinfo=UTC), "UTC"),
        ("2024-03-04T10:00:00Z", datetime(2024, 3, 4, 10, tzinfo=UTC), "UTC"),
    ],
)
@pytest.mark.parametrize("kind", ["none", "since start", "uptime", "first row lost", "hdf5"])
def test_a_start_dates_what_has_no_dates(
    tmp_path: Path, kind: str, start: str, first: datetime, zone: str | None
) -> None:
    offset = {"since start": 0.0, "uptime": 81_234.5}.get(kind)
    text = PLAIN.replace("\n0,", "\n,", 1) if kind == "first row lost" else PLAIN
    if offset is not None:
        rows = [f"{offset + 0.04 * k:.2f},{row}" for k, row in enumerate(ROWS.splitlines())]
        text = "\n".join(["seconds,x [g],y [g],z [g]", *rows, ""])
    if kind == "hdf5":
        about = make_hdf5.about(start_time=None, sample_rate=25.0)
        path = make_hdf5.write(tmp_path / "a.h5", {"acc": still_counts(directions(1))[:100]}, about)
        found = make_hdf5.read(path, 7, start=start)
    else:
        found = make_csv.read(make_csv.written(tmp_path, text), 7, rate_hz=25.0, start=start)
    assert found.times[0] == us(first) == found.recording.start_us
    assert (np.diff(found.times) == 40_000).all()
    assert found.recording.timezone == zone
    assert "no_start_time" not in found.codes
    assert f"it does not say when it began: {start} was given with -R start" in found.recording.notes


def test_a_start_goes_with_a_zone_but_not_against_one(tmp_path: Path) -> None:
    path = make_csv.written(tmp_path, PLAIN)
    found = make_csv.read(path, rate_hz=25.0, start="2024-07-04T10:00", timezone="Europe/Berlin")
    assert utc_us(found)[0] == us(datetime(2024, 7, 4, 8, tzinfo=UTC))
    with pytest.raises(UsageError, match="states its time zone, UTC, which is not Europe/Berlin"):
        make_csv.read(path, rate_hz=25.0, start="2024-07-04T10:00Z", timezone="Europe/Berlin")


def test_a_start_that_the_file_states_is_not_replaced(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"states its own start, 2024-03-04T00:00:00\.000000") as caught:
        make_csv.read(good_csv(tmp_path), start="2024-03-04T10:00")
    assert "-R shift" in caught.value.hint


@pytest.mark.parametrize("shift_s", [3600.0, -86_400.5, 0.000001, 7.5e8])
def test_a_shift_moves_all_times(tmp_path: Path, shift_s: float) -> None:
    path = good_csv(tmp_path)
    plain, moved = make_csv.read(path), make_csv.read(path, shift_s=shift_s)
    assert (moved.times - plain.times == round(shift_s * 1e6)).all()
    assert moved.recording.start_us == moved.times[0]
    assert f"{shift_s:+g} s were added to all times (-R shift)" in moved.recording.notes
    assert moved.recording.timezone is None


def test_a_shift_of_nothing_dated_or_out_of_the_calendar_is_refused(tmp_path: Path, capsys: Capture) -> None:
    path = make_csv.written(tmp_path, PLAIN)
    ran = run(capsys, "inspect", path, "--rate", 25, "-R", "shift=5")
    assert ran.code == 2
    assert_one_line(ran, "has no dates that -R shift could change", "-R start")
    found = make_csv.read(path, rate_hz=25.0, start="2024-03-04T10:00", shift_s=5)
    assert found.times[0] == us(datetime(2024, 3, 4, 10, 0, 5, tzinfo=UTC))
    ran = run(capsys, "inspect", path, "--rate", 25, "-R", "start=0001-01-01", "-R", "shift=-5")
    assert ran.code == 3
    assert_one_line(ran, "begins outside the years 1 to 9999")


CHANGE = datetime(2024, 3, 31, 1, tzinfo=UTC)
"""In Berlin; in New York it is three weeks earlier."""


@pytest.mark.parametrize("worn", ZONES)
@pytest.mark.parametrize(
    "begin", [CHANGE - timedelta(seconds=4), datetime(2024, 10, 27, 0, 59, 56, tzinfo=UTC)]
)
def test_worn_elsewhere_moments_are_the_same_and_none_is_lost_or_doubled(
    tmp_path: Path, worn: str, begin: datetime
) -> None:
    """A computer's log of Berlin, over a change there."""
    times = [begin + timedelta(milliseconds=40 * k) for k in range(250)]
    path = written_by("Europe/Berlin", times, tmp_path / "a.csv")
    found = make_csv.read(path, 7, configured_zone="Europe/Berlin", worn_zone=worn)
    assert utc_us(found) == list(map(us, times)) and found.breaks == []
    first = times[0].astimezone(ZoneInfo(worn))
    assert found.times[0] == us(first.replace(tzinfo=UTC))
    assert found.recording.timezone == worn
    assert any(f"set in Europe/Berlin and worn in {worn}" in note for note in found.recording.notes)


@pytest.mark.parametrize("fold", [0, 1])
def test_a_start_that_occurs_twice_where_it_was_worn_is_the_right_one(tmp_path: Path, fold: int) -> None:
    begin = datetime(2024, 10, 27, 0, 30, tzinfo=UTC) + fold * timedelta(hours=1)
    path = written_by("UTC", [begin + timedelta(milliseconds=40 * k) for k in range(100)], tmp_path / "a.csv")
    found = make_csv.read(path, configured_zone="UTC", worn_zone="Europe/Berlin")
    assert utc_us(found)[0] == us(begin)
    assert found.recording.timezone == ("+01:00" if fold else "Europe/Berlin")


def test_the_files_own_zone_is_that_of_its_clock(tmp_path: Path) -> None:
    begin = datetime(2024, 7, 4, 10, tzinfo=UTC)
    path = written_by("UTC", [begin + timedelta(milliseconds=40 * k) for k in range(100)], tmp_path / "a.csv")
    path.write_text(path.read_text().replace("00,0", "00Z,0"))
    found = make_csv.read(path, worn_zone="America/New_York")
    assert (utc_us(found)[0], found.times[0]) == (us(begin), us(begin) - 4 * 3600 * 10**6)
    with pytest.raises(UsageError, match="states its time zone, UTC, which is not Asia/Tokyo") as caught:
        make_csv.read(path, configured_zone="Asia/Tokyo", worn_zone="America/New_York")
    assert "omit -R configured_zone" in caught.value.hint


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("-R", "worn_zone=Asia/Tokyo"), "does not say in which zone its clock was set; say it with"),
        (("-R", "configured_zone=Asia/Tokyo"), "-R configured_zone is for -R worn_zone"),
        (("-R", "worn_zone=Asia/Nowhere"), "unknown time zone 'Asia/Nowhere'"),
        (("-R", "configured_zone=UTC", "--timezone", "UTC", "-R", "worn_zone=UTC"), "give one of them"),
        (("-R", "start=today"), "-R start='today' is not a date and time"),
        (("-R", "start=0001-01-01T00:00+14:00"), "is not a date and time"),
        (("-R", "shift=nan"), "shift cannot be nan"),
        (("-R", "force_timezone=true"), "-R force_timezone has no zone to use"),
    ],
)
def test_what_is_not_enough_or_contradicts_itself(
    tmp_path: Path, capsys: Capture, words: tuple[str, ...], text: str
) -> None:
    ran = run(capsys, "inspect", good_csv(tmp_path), *words)
    assert ran.code == 2 and text in ran.err


def test_report_and_parquet_have_it_and_verify_gives_it_again(tmp_path: Path, capsys: Capture) -> None:
    path, report = good_raw(tmp_path), tmp_path / "good.calibration.json"
    zones = ("-R", "configured_zone=Europe/Berlin", "-R", "worn_zone=America/New_York")
    assert run(capsys, "calibrate", path, "-q", *zones, "-R", "shift=60").code == 0
    held = json.loads(report.read_text())
    stated = {"shift_s": 60.0, "configured_zone": "Europe/Berlin", "worn_zone": "America/New_York"}
    assert held["settings"]["input"].items() >= stated.items() and "start" not in held["settings"]["input"]
    about = held["recording"]
    assert about["start_time"] == "2024-03-03T18:01:00.000000-05:00"
    assert (about["timezone"], about["time_zone"]) == ("America/New_York", "UTC")
    first = pq.read_table(tmp_path / "good.calibrated.parquet")["time"][0].as_py()
    assert first == datetime(2024, 3, 3, 23, 1, tzinfo=UTC)
    ran, _ = verify(capsys, report, path)
    assert ran.code == 0
    assert run(capsys, "calibrate", path, *zones, "-R", "shift=60").err.count("up to date") == 1


def test_reports_without_them_do_not_name_them(tmp_path: Path, capsys: Capture) -> None:
    path, report = good_csv(tmp_path), tmp_path / "good.calibration.json"
    assert run(capsys, "calibrate", path, "-q", "--report-only").code == 0
    settings = json.loads(report.read_text())["settings"]["input"]
    assert not {"start", "shift_s", "configured_zone", "worn_zone"} & set(settings)
    edit(report, lambda held: held["settings"]["input"].update(shift_s=1e300))
    ran, _ = verify(capsys, report, path)
    assert ran.code == 3 and "shift_s cannot be" in ran.err


@pytest.mark.parametrize("start", ["2024-03-04T10:00:00+01:00", '"2024-03-04T10:00:00+01:00"'])
def test_a_file_beside_the_recording_may_say_it(tmp_path: Path, capsys: Capture, start: str) -> None:
    path = make_csv.written(tmp_path, PLAIN)
    (tmp_path / "a.toml").write_text(f"rate = 25\nstart = {start}\nshift = -5\nworn-zone = 'Asia/Tokyo'\n")
    told = json.loads(run(capsys, "inspect", path, "--json").out)["recording"]
    assert told["start_time"] == "2024-03-04T17:59:55.000000+09:00"
    (tmp_path / "a.toml").unlink()
    assert accelcal.read(path, rate=25, start=NOON).recording.start_us == us(NOON)
