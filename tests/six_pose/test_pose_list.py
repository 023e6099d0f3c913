"""The list of poses: how it is read, and what is wrong with a damaged one."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.errors import DivergedError, UsageError
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
    return find_listed(still, lines_read, [origin or Origin(NOON_US, True, None)], LSB, SETTINGS)


def test_seconds_and_directions_are_exact(tmp_path: Path) -> None:
    path = write_list(tmp_path / "p.csv", ["# a remark", "", '"3.25",10, 0 , -0.6,0.8'])
    (item,) = read_list(path)
    assert (item.start, item.end) == (Fraction("3.25"), Fraction(10))
    assert item.reference == (0, Fraction("-0.6"), Fraction("0.8"))
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
    assert item.reference == (0, Fraction(-3, 5), Fraction(4, 5))


@pytest.mark.parametrize(
    ("lines", "line", "words"),
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
def test_a_damaged_line_is_named(tmp_path: Path, lines: list[str], line: int, words: str) -> None:
    path = write_list(tmp_path / "p.csv", lines)
    with pytest.raises(UsageError) as caught:
        read_list(path)
    assert f"{path}, line {line}: " in str(caught.value)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
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
def test_a_file_that_is_no_list_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(content)
    with pytest.raises(UsageError, match="csv") as caught:
        read_list(path)
    assert words in str(caught.value)


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
    ("end", "x", "g"), [("_g", "2.5", "5/2"), ("_ms2", "19.6133", "2"), ("_ms2", "-1", "-100000/980665")]
)
def test_accelerations_of_any_size_have_their_unit_in_the_header(
    tmp_path: Path, end: str, x: str, g: str
) -> None:
    path = write_list(tmp_path / "p.csv", [f"1,2,{x},0,0"], f"start,end,ax{end},ay{end},az{end}")
    (item,) = read_list(path)
    assert item.reference == (Fraction(g), 0, 0)
    assert item.in_g(Fraction(99, 100)) == item.reference, "gravity is among them"
    assert item.of_rest is False


def test_directions_of_rest_become_local_gravity(tmp_path: Path) -> None:
    (item,) = read_list(write_list(tmp_path / "p.csv", ["1,2,0,0.6,-0.8"]))
    assert item.in_g(Fraction(99, 100)) == (0, Fraction("0.594"), Fraction("-0.792"))


@pytest.mark.parametrize(
    ("lines", "header", "words"),
    [
        (["1,2,0,0,0"], "start,end,ax_g,ay_g,az_g", "length 0 g; possible are 0.1 to 32 g"),
        (["1,2,30,20,0"], "start,end,ax_g,ay_g,az_g", "length 36.06 g; possible are 0.1 to 32 g"),
        (["1,2,0.9,0,0"], "start,end,ax_ms2,ay_ms2,az_ms2", "length 0.09177 g; possible"),
        (["1,2,1,0,0"], "start,end,ax_g,ay_g,az", "the first line is"),
        (["1,2,1,0,0"], "start,end,ax_g,ay_g,az_ms2", "the first line is"),
        (["1,1,0,0"], "start,ax,ay,az", "the first line is"),
        ([",1,0,0"], "file,ax,ay,az", "names no file"),
        (["a.csv,3,,1,0,0"], "file,start,end,ax,ay,az", "'' is neither a number of seconds"),
    ],
)
def test_columns_and_sizes_that_cannot_be(tmp_path: Path, lines: list[str], header: str, words: str) -> None:
    path = write_list(tmp_path / "p.csv", lines, header)
    with pytest.raises(UsageError, match=r"csv, line [12]: ") as caught:
        read_list(path)
    assert words in str(caught.value)


def test_a_file_stands_for_its_times_or_has_some(tmp_path: Path) -> None:
    lines = ["up.csv;;;1;0;0", "Übung 1,5.csv;2,5;8;0;0;1"]
    whole, part = read_list(write_list(tmp_path / "p.csv", lines, "file;start;end;ax;ay;az"))
    assert (whole.file, whole.start, whole.end) == ("up.csv", None, None)
    assert (part.file, part.start, part.end) == ("Übung 1,5.csv", Fraction(5, 2), 8)


def test_lengths_that_differ_are_different_orientations(tmp_path: Path) -> None:
    """15 degrees of 1 g are 0.26 g: so much may lengths differ as well."""
    lines = ["0,2,1,0,0", "3,5,1.25,0,0", "6,8,1.3,0,0", "12,14,0,0,2"]
    path = write_list(tmp_path / "p.csv", lines, "start,end,ax_g,ay_g,az_g")
    session = find_listed(
        windows(("+x", 10), None, ("+z", 10)), read_list(path), [Origin(5_000_000, True, None)], LSB, SETTINGS
    )
    assert [(pose.face, pose.number) for pose in session.poses] == [
        ("+x", 0), ("listed", 0), ("listed", 1), ("listed", 2),
    ]  # fmt: skip
    assert session.poses[3].reference == (0, 0, 2 * ONE)


FILES = [Origin(5_000_000, True, None, name, 500 * n, 500 * (n + 1)) for n, name in enumerate(("a", "b"))]
"""Of the windows below, which follow one another without a gap."""


def of_files(folder: Path, *lines: str, header: str = "file,ax,ay,az", **more: object) -> Session:
    still = windows(("+x", 2), ("+y", 5), ("+x", 3), ("+z", 10))
    lines_read = read_list(write_list(folder / "poses.csv", list(lines), header))
    return find_listed(still, lines_read, FILES, LSB, SETTINGS, **more)


def test_of_a_file_the_longest_rest_counts_without_its_ends(tmp_path: Path) -> None:
    session = of_files(tmp_path, "b,0,0,1", "a,0,1,0")
    assert [(pose.face, pose.state.file, pose.state.windows) for pose in session.poses] == [
        ("+y", 0, 3),
        ("+z", 1, 8),
    ]
    assert session.poses[0].state.raw == (0, ONE, 0)
    assert session.poses[0].state.start_us == 5_000_000 + 3_000_000


@pytest.mark.parametrize(
    ("lines", "header", "words"),
    [
        (["a,0,1,0"], "file,ax,ay,az", "poses.csv: does not list b; write a line for each"),
        (["a,0,1,0", "c,0,0,1"], "file,ax,ay,az", "line 3: 'c' is not a file of the session"),
        (["a,0,1,0", "a,0,1,0", "b,0,0,1"], "file,ax,ay,az", "line 3: overlaps line 2"),
        (["0,9,0,1,0"], "start,end,ax,ay,az", "names no file, but the session is in several"),
        (["a,2,1,0,1,0"], "file,start,end,ax,ay,az", "ends before it starts"),
    ],
)
def test_lists_that_are_not_of_the_files(tmp_path: Path, lines: list[str], header: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        of_files(tmp_path, *lines, header=header)
    assert words in str(caught.value)


def test_times_within_files_may_reach_beyond_their_ends(tmp_path: Path) -> None:
    lines = ("a,2,100,0,1,0", "b,0,100,0,0,1")
    still = windows(("+y", 10), ("+z", 10))
    placed = [FILES[0], replace(FILES[1], first_us=15_000_000)]
    lines_read = read_list(write_list(tmp_path / "poses.csv", list(lines), "file,start,end,ax,ay,az"))
    session = find_listed(still, lines_read, placed, LSB, SETTINGS)
    assert [pose.state.windows for pose in session.poses] == [8, 10]
    assert session.seconds(session.poses[1].state.start_us, 1) == 0.0
    dated = [replace(one, moved_us=7_000_000) for one in placed]
    lines = ("a,1970-01-01T00:00:00,60,0,1,0", "b,1970-01-01T00:00:10,60,0,0,1")
    lines_read = read_list(write_list(tmp_path / "poses.csv", list(lines), "file,start,end,ax,ay,az"))
    session = find_listed(still, lines_read, dated, LSB, SETTINGS)
    assert [pose.state.start_us for pose in session.poses] == [7_000_000, 17_000_000]


def test_a_file_that_rests_too_shortly_is_refused_with_its_line(tmp_path: Path) -> None:
    still = windows(("+y", 1), None, ("+y", 1))
    lines = read_list(write_list(tmp_path / "p.csv", ["a,0,1,0", "b,0,0,1"], "file,ax,ay,az"))
    with pytest.raises(DivergedError, match="line 2: the longest rest of its file is shorter than 2 s"):
        find_listed(still, lines, FILES, LSB, SETTINGS)
    with pytest.raises(DivergedError, match="line 3: no still window of 1 s is in b"):
        find_listed(windows(("+y", 9)), lines, FILES, LSB, SETTINGS)


def test_a_file_is_named_only_where_there_are_several(tmp_path: Path) -> None:
    lines = read_list(write_list(tmp_path / "p.csv", ["a,0,1,0"], "file,ax,ay,az"))
    with pytest.raises(UsageError, match="names a file, but the session is one recording"):
        find_listed(windows(("+y", 9)), lines, [Origin(0, True, None)], LSB, SETTINGS)


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
    ("lines", "origin", "words"),
    [
        (["5,4,1,0,0"], Origin(NOON_US, True, None), "line 2: ends before it starts"),
        (["0,4,1,0,0", "3,5,1,0,0"], Origin(NOON_US, True, None), "line 3: overlaps line 2"),
        (["2024-03-04T12:00:00,4,1,0,0"], Origin(0, False, None), "line 2: the recording has no date"),
        (["2024-03-04T12:00:00Z,4,1,0,0"], Origin(NOON_US, True, None), "give --timezone"),
        (["0001-01-01T00:00:00+14:00,4,1,0,0"], Origin(NOON_US, True, None), "give --timezone"),
    ],
)
def test_times_that_cannot_be_used(tmp_path: Path, lines: list[str], origin: Origin, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        listed(tmp_path, *lines, origin=origin)


def test_times_without_stillness_are_refused_with_their_line(tmp_path: Path) -> None:
    with pytest.raises(DivergedError, match="line 3: no still window of 1 s lies within these times"):
        listed(tmp_path, "0,4,1,0,0", "9.5,11.5,0,0,1")
