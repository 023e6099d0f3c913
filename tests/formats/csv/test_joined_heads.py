"""Exports joined with their own heads: of one device, of two, with other columns or another start."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.csv import test_actigraph as actigraph
from tests.formats.csv import test_gcdc as gcdc
from tests.formats.csv import test_geneactiv as geneactiv
from tests.formats.make_csv import read, stamp, written

FIRST = actigraph.HEADER + actigraph.NAMES + actigraph.ROWS
LATER_US = 3600 * 1_000_000
HEADS = {
    "serial number": (FIRST, "NEO1D00000017", "NEO1D00000018"),
    "rate": (FIRST, "at 30 Hz", "at 60 Hz"),
    "start": (gcdc.table(gcdc.HAM), "10:41:40", "11:41:40"),  # its rows count from there
}


@pytest.mark.parametrize("chunk", [1000, 5, 1])
@pytest.mark.parametrize("times", [1, 2, 3])
def test_a_later_start_is_a_gap_of_the_clock(tmp_path: Path, chunk: int, times: int) -> None:
    """Rows carry no times; each head says when its own begin."""
    heads = [FIRST.replace("Start Time 10:54:00", f"Start Time {11 + hour}:54:00") for hour in range(times)]
    found = read(written(tmp_path, FIRST + "".join(heads)), chunk)
    rows = len(actigraph.VALUES)
    even = (np.arange(rows) * 1_000_000 + 15) // 30
    expected = [actigraph.START_US + hour * LATER_US + even for hour in range(times + 1)]
    assert np.abs(found.times - np.concatenate(expected)).max() <= 1
    assert found.breaks == [rows * hour for hour in range(1, times + 1)]
    assert np.array_equal(found.counts, np.tile(actigraph.COUNTS, (times + 1, 1)))
    assert {problem.code for problem in found.problems} == {"clock_gap", "repeated_head"}


@pytest.mark.parametrize("fault", HEADS)
@pytest.mark.parametrize("chunk", [1000, 5])
def test_another_recordings_head_is_refused(tmp_path: Path, fault: str, chunk: int) -> None:
    first, old, new = HEADS[fault]
    line = first.count("\n") + 1
    with pytest.raises(
        UnreadableError, match=f"head of another recording begins: it has the {fault}"
    ) as refusal:
        read(written(tmp_path, first + first.replace(old, new)), chunk)
    assert refusal.value.line == line and "cut the file before that line" in (refusal.value.hint or "")


def geneactiv_export(hour: int, serial: str = "012967") -> str:
    """Return an export of 50 s, which begins at an hour."""
    rows = (
        f"2024-03-04 {hour:02d}:00:{row // 50:02d}:{row % 50 * 20:03d},0.25,0.5,0.75,1,0,20.5"
        for row in range(500)
    )
    head = geneactiv.HEADER.replace("00:00:00:000", f"{hour:02d}:00:00:000").replace("012967", serial)
    return head + "\n".join(rows) + "\n"


@pytest.mark.parametrize("chunk", [1000, 90])
def test_another_geneactiv_is_refused(tmp_path: Path, chunk: int) -> None:
    with pytest.raises(UnreadableError, match="it has the serial number 054321, not 012967"):
        read(written(tmp_path, geneactiv_export(0) + geneactiv_export(2, "054321")), chunk)


def test_the_same_geneactiv_goes_on(tmp_path: Path) -> None:
    found = read(written(tmp_path, geneactiv_export(0) + geneactiv_export(2)))
    assert np.array_equal(found.g, np.tile([0.25, 0.5, 0.75], (1000, 1)))
    assert found.times[500] - found.times[0] == 2 * LATER_US and found.breaks == [500]
    assert {problem.code for problem in found.problems} == {"clock_gap", "repeated_head"}


def rows(order: str, first: int, scale: float = 1.0) -> str:
    """Return lines of x, y and z in an order, 0.25, 0.5 and 0.75 g."""
    value = dict(zip("xyz", (0.25 * scale, 0.5 * scale, 0.75 * scale), strict=True))
    return "".join(
        ",".join([stamp(number * 40_000), *(f"{value[axis]:g}" for axis in order)]) + "\n"
        for number in range(first, first + 40)
    )


@pytest.mark.parametrize("names", ["time,z,y,x", "z,y,x,time", "time,x [mg],y [mg],z [mg]", "time,gx,gy,gz"])
@pytest.mark.parametrize("chunk", [1000, 7])
def test_other_columns_are_refused(tmp_path: Path, names: str, chunk: int) -> None:
    text = "time,x,y,z\n" + rows("xyz", 0) + names + "\n" + rows("zyx", 40)
    with pytest.raises(
        UnreadableError, match=f"it names the columns {re.escape(names).replace(',', ', ')}, not"
    ):
        read(written(tmp_path, text), chunk)


@pytest.mark.parametrize("line", ["time,x", "time,,,", "x,y,z,w,v", "time: 10:00,x,y,z,w", "time,1,2,3"])
def test_a_line_that_begins_as_the_names_do_is_damage(tmp_path: Path, line: str) -> None:
    found = read(written(tmp_path, "time,x,y,z\n" + rows("xyz", 0) + line + "\n" + rows("xyz", 40)), unit="g")
    assert len(found.g) == 80 and [problem.code for problem in found.problems] == ["bad_line"]


@pytest.mark.parametrize(
    "head", ["# Serial: {}\n", "Serial Number: {}\nSampling rate: 25 Hz\n", "Logger\nserial={}\n"]
)
@pytest.mark.parametrize("chunk", [1000, 7])
def test_another_serial_number_is_refused_whoever_made_the_file(
    tmp_path: Path, head: str, chunk: int
) -> None:
    def text(serial: str, first: int) -> str:
        return head.format(serial) + "time,x,y,z\n" + rows("xyz", first)

    with pytest.raises(UnreadableError, match=r"it has the line of the serial number .*B2, not .*A1"):
        read(written(tmp_path, text("A1", 0) + text("B2", 40)), chunk)
    found = read(written(tmp_path, text("A1", 0) + text("A1", 40)), chunk, unit="g")
    assert len(found.g) == 80 and [problem.code for problem in found.problems] == ["repeated_head"]


def test_what_a_second_head_does_not_say_is_not_another(tmp_path: Path) -> None:
    found = read(written(tmp_path, FIRST + FIRST.replace("Serial Number: NEO1D00000017\n", "\n")))
    assert len(found.counts) == 2 * len(actigraph.VALUES)
