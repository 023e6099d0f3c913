"""T15, T17, T20: rows at the end of a text file, lines below them, and names of several accelerometers."""

from __future__ import annotations

from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from tests.formats.make_csv import read, stamp, written

HEADER = "time,x,y,z\n"


def rows(number: int) -> str:
    return "".join(f"{stamp(10_000 * row)},0.0100,0.0200,0.9900\n" for row in range(number))


@pytest.mark.parametrize(
    ("tail", "kept"),
    [
        ("0.0100,0.0200,0.9900", True),
        ("0.0100,0.0200,0.99", False),
        ("0.0100,0.0200,0.", False),
        ("0.0100,0.0200", False),
        ("0.0100,0.0200,", False),
        ("0.0100,oops,0.9900", False),
    ],
)
def test_t15_a_last_row_without_a_line_end_is_kept_unless_it_is_cut(
    tmp_path: Path, tail: str, kept: bool
) -> None:
    path = written(tmp_path, HEADER + rows(50) + f"{stamp(500_000)},{tail}")
    whole = read(path)
    assert len(whole.counts) == 50 + kept
    assert (whole.problems == []) == kept
    for samples in (1, 7, 50):
        assert read(path, samples).same_as(whole)


BELOW = {
    "a word": "end of file\n",
    "totals": "\nTotal,,\nmean 3,4\n",
    "ragged rows": "1,2\n1,2,3,4,5,6\n",
    "comments": "# done\n# bye\n",
    "a row of words": "Summary:,0.01,0.02,0.99\n",
    "a rule": "-----,-----,-----,-----\n",
    "a sentence with commas": "Recording stopped by user; battery 3 %, OK\n",
}
AMONG = {
    "a word": "ERROR: sensor timeout\n",
    "too few cells": f"{stamp(150_000)},0.01,0.02\n",
    "too many cells": f"{stamp(150_000)},0.01,0.02,0.99,7\n",
    "a text": f"{stamp(150_000)},0.01,x,0.99\n",
    "no time": "yesterday,0.01,0.02,0.99\n",
    "a quote": '"unfinished,1,2,3\n',
}


@pytest.mark.parametrize("number", [12, 30, 300])
@pytest.mark.parametrize("header", [HEADER, ""], ids=["names", "no names"])
@pytest.mark.parametrize("line", [*BELOW.items(), *AMONG.items()], ids=lambda line: line[0])
def test_t17_lines_that_are_not_rows_refuse_no_recording(
    tmp_path: Path, number: int, header: str, line: tuple[str, str]
) -> None:
    """They made a small file none of a known format, and a large one unreadable."""
    name, text = line
    place = number if name in BELOW and BELOW[name] == text else number // 2
    good = rows(number).splitlines(keepends=True)
    path = written(tmp_path, header + "".join([*good[:place], text, *good[place:]]), "small.csv")
    with open_recording(path, ReadOptions()) as reader:
        chunks = list(reader.chunks(1000))
    assert sum(map(len, chunks)) == number
    problems = [problem for chunk in chunks for problem in chunk.problems if problem.code == "bad_line"]
    first = len(header.splitlines()) + place + 1 + text.startswith("\n")
    assert problems[0].place == f"from line {first} on"
    assert " left out: " in problems[0].message
    assert sum(problem.count for problem in problems) == len(text.strip().splitlines())
    assert reader.recording.duration_s == pytest.approx(number / 100)


def test_t20_several_accelerometers_are_named_with_a_command(tmp_path: Path) -> None:
    head = "Timestamp,Accel_LN_X,Accel_LN_Y,Accel_LN_Z,Accel_WR_X,Accel_WR_Y,Accel_WR_Z\n"
    lines = "".join(f"{stamp(10_000 * row)},0.1,0.2,0.9,0.1,0.2,0.9\n" for row in range(30))
    with pytest.raises(UnreadableError) as error:
        read(written(tmp_path, head + lines))
    assert "Accel_LN_X,Accel_LN_Y,Accel_LN_Z; Accel_WR_X" in str(error.value)
    assert "--columns Accel_LN_X,Accel_LN_Y,Accel_LN_Z" in str(error.value)


def test_t20_a_workbook_is_to_be_saved_as_csv(tmp_path: Path) -> None:
    path = written(tmp_path, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600), "a.xls")
    with pytest.raises(UnreadableError, match="save its sheet as CSV"):
        open_recording(path, ReadOptions())
