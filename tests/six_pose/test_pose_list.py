"""The list of poses: how it is read, and what is wrong with a damaged one."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.errors import DivergedError, UsageError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.six_pose.poses import Origin, Session, find_listed, read_list
from tests.six_pose.made import write_list
from tests.six_pose.test_faces import LSB, windows

SETTINGS = PoseSettings()
NOON_US = 1_709_553_600_000_000
"""2024-03-04T12:00:00, the first sample below."""


def listed(folder: Path, *lines: str, origin: Origin | None = None) -> Session:
    """The poses of a recording of ten windows on +x, one moving, ten on +z."""
    still = windows(("+x", 10), None, ("+z", 10))
    shift = NOON_US - int(still.start_us[0])
    still = replace(still, start_us=still.start_us + shift, end_us=still.end_us + shift)
    lines_read = read_list(write_list(folder / "poses.csv", list(lines)))
    return find_listed(still, lines_read, origin or Origin(NOON_US, True, None), LSB, SETTINGS)


def test_seconds_and_directions_are_exact(tmp_path: Path) -> None:
    path = write_list(tmp_path / "p.csv", ["# a remark", "", '"3.25",10, 0 , -0.6,0.8'])
    (item,) = read_list(path)
    assert (item.start, item.end) == (Fraction("3.25"), Fraction(10))
    assert item.direction == (0, Fraction("-0.6"), Fraction("0.8"))
    assert item.place.line == 4


@pytest.mark.parametrize(
    "text",
    [
        "start,end,ax,ay,az\n1.5,10,0,-0.6,0.8\n",
        "start;end;ax;ay;az\r\n1,5;10;0;-0,6;0,8\r\n",
        "\ufeffAz\tAy\tAx\tStart\tEnd\n0.8\t-0.6\t0\t1.5\t10",
    ],
)
def test_spreadsheets_write_it_in_several_ways(tmp_path: Path, text: str) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(text.encode())
    (item,) = read_list(path)
    assert (item.start, item.end) == (Fraction(3, 2), 10)
    assert item.direction == (0, Fraction(-3, 5), Fraction(4, 5))


@pytest.mark.parametrize(
    ("lines", "line", "told"),
    [
        ([], 1, "lists no poses"),
        (["1,2,1,0"], 2, "has 4 values, the header 5"),
        (["1,2,1,0,0", "", "1,x,1,0,0"], 4, "'x' is neither a number of seconds nor a time"),
        (["1,2,nan,0,0"], 2, "not a usable number"),
        (["1,1e300,1,0,0"], 2, "not a usable number"),
        (["1,2,one,0,0"], 2, "'one' is not a number"),
        (["1,2,,0,1"], 2, "'' is not a number"),
        (["1,2,9.81,0,0"], 2, "length 9.81; ax, ay, az are in g"),
        (["1,2,0,0,0"], 2, "the reference has the length 0"),
        (["04/03/2024 12:00,2,1,0,0"], 2, "neither a number of seconds nor a time"),
    ],
)
def test_a_damaged_line_is_named(tmp_path: Path, lines: list[str], line: int, told: str) -> None:
    path = write_list(tmp_path / "p.csv", lines)
    with pytest.raises(UsageError) as caught:
        read_list(path)
    assert f"{path}, line {line}: " in str(caught.value)
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "lists no poses"),
        (
            b"start,end,ax,ay\n1,2,1,0\n",
            "line 1: the first line is 'start,end,ax,ay'; write start,end,ax,ay,az",
        ),
        (b"1,2,1,0,0\n", "line 1"),
        (b"start,end,ax,ay,az\n1,2,1,0,\xff\n", "byte 27: the list of poses is not UTF-8"),
        (b"#" * (1 << 20) + b"\n", "too large"),
    ],
)
def test_a_file_that_is_no_list_is_refused(tmp_path: Path, content: bytes, told: str) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(content)
    with pytest.raises(UsageError, match="csv") as caught:
        read_list(path)
    assert told in str(caught.value)


@given(
    content=st.binary().map(lambda data: data.decode("utf-8", "replace"))
    | st.text("start,end,axyz\n0123.;e-", max_size=80).map("start,end,ax,ay,az\n".__add__)
)
def test_any_text_is_a_list_or_an_error(tmp_path_factory: pytest.TempPathFactory, content: str) -> None:
    path = tmp_path_factory.mktemp("any") / "p.csv"
    path.write_text(content, encoding="utf-8", errors="replace")
    try:
        assert read_list(path)
    except UsageError as error:
        assert error.path == path


def test_windows_within_the_times_are_averaged(tmp_path: Path) -> None:
    session = listed(tmp_path, "12.9,17.1,0,0,1", "2,5,1,0,0")
    assert [pose.face for pose in session.poses] == ["+x", "+z"]
    assert [pose.state.windows for pose in session.poses] == [3, 4]
    assert session.poses[0].state.start_us == NOON_US + 2_000_000
    assert session.poses[1].state.raw == (0, 0, ONE)


def test_other_directions_within_some_degrees_are_one_orientation(tmp_path: Path) -> None:
    session = listed(tmp_path, "0,2,1,0,0", "3,5,0.98,0.2,0", "6,8,0.9,0.4358899,0")
    assert [(pose.face, pose.number) for pose in session.poses] == [("+x", 0), ("listed", 0), ("listed", 1)]


@pytest.mark.parametrize(
    ("start", "zone_s"),
    [("2024-03-04T12:00:02", None), ("2024-03-04T11:00:02Z", 3600), ("2024-03-04 13:00:02+02:00", 3600)],
)
def test_iso_times_are_the_devices_clock_or_have_a_zone(
    tmp_path: Path, start: str, zone_s: int | None
) -> None:
    session = listed(tmp_path, f"{start},5,1,0,0", origin=Origin(NOON_US, True, zone_s))
    assert session.poses[0].state.start_us == NOON_US + 2_000_000
    assert datetime.fromtimestamp(NOON_US / 1e6, UTC).isoformat() == "2024-03-04T12:00:00+00:00"


@pytest.mark.parametrize(
    ("lines", "origin", "told"),
    [
        (["5,4,1,0,0"], Origin(NOON_US, True, None), "line 2: ends before it starts"),
        (["0,4,1,0,0", "3,5,1,0,0"], Origin(NOON_US, True, None), "line 3: overlaps line 2"),
        (["2024-03-04T12:00:00,4,1,0,0"], Origin(0, False, None), "line 2: the recording has no date"),
        (["2024-03-04T12:00:00Z,4,1,0,0"], Origin(NOON_US, True, None), "give --timezone"),
        (["0001-01-01T00:00:00+14:00,4,1,0,0"], Origin(NOON_US, True, None), "give --timezone"),
    ],
)
def test_times_that_cannot_be_used(tmp_path: Path, lines: list[str], origin: Origin, told: str) -> None:
    with pytest.raises(UsageError, match=told):
        listed(tmp_path, *lines, origin=origin)


def test_times_without_stillness_are_refused_with_their_line(tmp_path: Path) -> None:
    with pytest.raises(DivergedError, match="line 3: no still window of 1 s lies within these times"):
        listed(tmp_path, "0,4,1,0,0", "9.5,11.5,0,0,1")
