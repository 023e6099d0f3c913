"""Damaged text files: nothing is invented, nothing is dropped silently, nothing crashes."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import AccelcalError, UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from accelcal_cli.formats.tables import rows as csv_rows
from accelcal_cli.formats.tables.text import lines as csv_lines
from accelcal_cli.formats.tables.text import source as detect
from tests.cli.run import exit_code
from tests.formats.cuts import cuts, every_byte
from tests.formats.make_csv import make, read, stamp, written
from tests.recordings import good_csv

HEADER = "time,x,y,z\n"
COUNTS = np.random.default_rng(5).integers(-256, 256, (40, 3)).astype(np.int16)


def row(number: int, cells: str = "0,0,1") -> str:
    return f"{stamp(number * 10_000)},{cells}\n"


def rows(count: int, start: int = 0) -> str:
    return "".join(row(number) for number in range(start, start + count))


def precise(count: int) -> str:
    return "".join(row(number, "0.0100,0.0200,0.9900") for number in range(count))


@every_byte
def test_truncation_at_every_byte_gives_a_prefix_or_one_clear_error(tmp_path: Path, step: int) -> None:
    truth = make(tmp_path, COUNTS[:12], 100.0, 256.0)
    data = truth.path.read_bytes()
    whole = read(truth.path)
    for size in cuts(data, step):
        path = written(tmp_path, data[:size], "cut.csv")
        try:
            found = read(path)
        except UnreadableError as error:
            assert data[:size].count(b"\n") < 4
            assert str(path) in str(error) and error.hint
            continue
        lines = data[:size].count(b"\n") - 1
        assert len(found.counts) in (lines, lines + 1)
        assert np.array_equal(found.counts[:lines], whole.counts[:lines])
        kept = data[:size].endswith(b"\n") or len(found.counts) == lines + 1
        cells = data[:size].rpartition(b"\n")[2].split(b",")
        full = len(cells) == 4 and bool(cells[-1])
        assert found.codes == ([] if kept else ["no_line_end" if full else "truncated"])


@every_byte
def test_gzip_truncated_at_every_byte_gives_a_prefix_or_one_clear_error(tmp_path: Path, step: int) -> None:
    truth = make(tmp_path, COUNTS[:20], 100.0, 256.0)
    data = gzip.compress(truth.path.read_bytes(), mtime=0)
    whole = read(truth.path)
    for size in cuts(data, step, 2):
        path = written(tmp_path, data[:size], "cut.csv.gz")
        try:
            found = read(path)
        except UnreadableError as error:
            assert str(path) in str(error)
            continue
        assert np.array_equal(found.counts, whole.counts[: len(found.counts)])
        assert found.codes == ["truncated"]


def test_gzip_with_a_flipped_byte_never_crashes_nor_depends_on_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = make(tmp_path, COUNTS[:20], 100.0, 256.0)
    data = gzip.compress(truth.path.read_bytes(), mtime=0)
    monkeypatch.setattr(csv_lines, "PIECE_BYTES", 200)
    for place in range(10, len(data), 5):
        path = written(tmp_path, data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :], "bad.csv.gz")
        try:
            found = read(path)
        except AccelcalError:
            continue
        assert read(path, 3).same_as(found)
        assert "truncated" in found.codes


def test_missing_values_leave_their_rows_out_and_break(tmp_path: Path) -> None:
    bad = [row(5, "0,,1"), row(6, "nan,0,1"), row(7, "0,0,NA"), ",0,0,1\n"]
    path = written(tmp_path, HEADER + rows(5) + "".join(bad) + rows(11, 9))
    found = read(path)
    assert len(found.counts) == 16
    assert found.breaks == [5]
    (problem,) = found.problems
    assert (problem.code, problem.sample, problem.count) == ("missing_value", 5, 4)
    assert (problem.message, problem.place) == ("4 rows left out: a value is missing", "from line 7 on")


@pytest.mark.parametrize("value", ["128", "-1e30", "inf", "1e400", "127.01"])
def test_values_out_of_range_leave_their_rows_out(tmp_path: Path, value: str) -> None:
    path = written(tmp_path, HEADER + rows(5) + row(5, f"0,{value},1") + rows(5, 6))
    found = read(path)
    assert (len(found.counts), found.breaks, found.codes) == (10, [5], ["out_of_range"])


def test_the_largest_values_are_kept(tmp_path: Path) -> None:
    found = read(written(tmp_path, HEADER + rows(5) + row(5, "0,127,-127")))
    assert found.g[-1].tolist() == [0, 127, -127]


def test_missing_rows_at_either_end(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + row(0, ",,") + rows(8, 1) + row(9, ",,"))
    found = read(path)
    assert (len(found.counts), found.breaks) == (8, [])
    assert [(problem.sample, problem.count) for problem in found.problems] == [(0, 1), (8, 1)]
    assert found.recording.start_us == found.times[0]


@pytest.mark.parametrize(
    ("chunk_samples", "piece"),
    [
        (1, 1000),
        (30, 100),
        (1000, 1000),
        *(
            pytest.param(samples, piece, marks=pytest.mark.nightly)
            for samples, piece in ((1, 1), (1, 100), (30, 1), (30, 1000), (1000, 1), (1000, 100))
        ),
    ],
)
def test_many_problems_become_few_records_whatever_the_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int, chunk_samples: int
) -> None:
    cells = ["0,0,1", "0,,1", "0,0,1", "0,999,1", "0,0,1", "0,0,", ",0,0", "0,0,1", "0,0,1"]
    text = "".join(row(number + 5 * (number % 50 == 49), cells[number % 9]) for number in range(700))
    path = written(tmp_path, HEADER + text)
    whole = read(path)
    assert whole.codes.count("missing_value") == 51
    assert whole.codes.count("out_of_range") == 51
    counted = {
        code: sum(problem.count for problem in whole.problems if problem.code == code) for code in whole.codes
    }
    wrong = [cells[number % 9] for number in range(700)]
    assert counted["missing_value"] == sum(wrong.count(cell) for cell in ("0,,1", "0,0,", ",0,0"))
    assert counted["out_of_range"] == wrong.count("0,999,1")
    assert len(whole.counts) == wrong.count("0,0,1")
    monkeypatch.setattr(csv_lines, "PIECE_BYTES", piece)
    assert read(path, chunk_samples).same_as(whole)


def test_mostly_unusable_rows_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + rows(40) + "".join(row(number, "0,999,0") for number in range(40, 90)))
    with pytest.raises(UnreadableError, match="only 40 of 90 rows hold usable values"):
        read(path, unit="g")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("oops,0,1", "column 1 holds 'oops', which is not a number"),
        ("0,1,2,3", "the line has 5 columns, not 4 ('2024-03-04T00:00:02.000000,0,1,2,3')"),
        ('0,"0,1', "the line has 3 columns, not 4 ('2024-03-04T00:00:02.000000,0,\"0,1')"),
    ],
)
@pytest.mark.parametrize("chunk_samples", [10, 1000])
@pytest.mark.parametrize("blank", ["", "\n"])
def test_t17_a_line_that_is_not_a_row_is_damage_and_is_named(
    tmp_path: Path, line: str, message: str, chunk_samples: int, blank: str
) -> None:
    text = HEADER + rows(200) + blank + row(200, line) + rows(100, 201)
    found = read(written(tmp_path, text), chunk_samples)
    assert (len(found.counts), found.breaks, found.codes) == (300, [200], ["bad_line"])
    (problem,) = found.problems
    assert problem.told == f"1 row left out: {message}, from line {202 + len(blank)} on"
    assert problem.lost_bytes > 20 and problem.empty_rows == 0


@pytest.mark.parametrize("chunk_samples", [1, 7, 100_000])
def test_t17_lines_that_are_not_rows_keep_their_place_in_a_file_without_times(
    tmp_path: Path, chunk_samples: int
) -> None:
    lines = [f"{0.001 * (line % 7):.3f},0.5,0.8\n" for line in range(400)]
    lines[100], lines[200:203] = "0.1\n", ["a,b,c\n"] * 3
    found = read(written(tmp_path, "x,y,z\n" + "".join(lines)), chunk_samples, rate_hz=50.0)
    assert (len(found.counts), found.breaks) == (396, [100, 199])
    assert [problem.count for problem in found.problems if problem.code == "bad_line"] == [1, 3]
    assert found.times[199] - found.times[198] == 4 * 20_000


@pytest.mark.parametrize("chunk_samples", [7, 5000])
def test_t17_a_file_most_of_whose_lines_are_not_rows_is_refused_with_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_samples: int
) -> None:
    """Another table follows on the first; nothing is read on once it is the larger part."""
    monkeypatch.setattr(detect, "HEAD_BYTES", 1000)
    monkeypatch.setattr(csv_rows, "MOST_BAD", 1000)
    for number in (200, 5000):
        path = written(tmp_path, HEADER + rows(number) + "a,b\n" * (number + 1))
        with pytest.raises(
            UnreadableError, match=rf"line {number + 2}: the line has 2 columns, not 4 \('a,b'\)"
        ):
            read(path, chunk_samples)


def test_t17_max_damage_judges_lines_that_are_not_rows(tmp_path: Path) -> None:
    """A fifth of the lines is damage, which is allowed unless the user says otherwise."""
    lines = good_csv(tmp_path).read_text().splitlines(keepends=True)
    fifth = len(lines) // 5
    path = written(tmp_path, "".join([*lines[:fifth], *["?!\n"] * fifth, *lines[2 * fifth :]]))
    assert exit_code("calibrate", path, "--report-only", "-q") == 0
    assert exit_code("calibrate", path, "--report-only", "-q", "--force", "-R", "max_damage=10") == 4


def test_blank_lines_are_no_rows(tmp_path: Path) -> None:
    text = HEADER + rows(10) + "\n   \n\n" + rows(10, 10) + "\n\n"
    found = read(written(tmp_path, text))
    assert (len(found.counts), found.breaks, found.problems) == (20, [], [])
    broken = text.replace(row(15), row(15, "0,,1"))
    assert read(written(tmp_path, broken)).problems[0].place == "from line 20 on"


@pytest.mark.parametrize(
    ("tail", "code"),
    [
        ("0.0100,0.0200,0.9900", None),
        ("0.0100,0.0200,0.99", "no_line_end"),
        ("0.0100,0.0200,0.", "no_line_end"),
        ("0.0100,oops,0.9900", "no_line_end"),
        ("0.0100,0.0200", "truncated"),
        ("0.0100,0.0200,", "truncated"),
    ],
)
def test_t15_a_last_row_without_a_line_end_is_kept_unless_it_is_cut(
    tmp_path: Path, tail: str, code: str | None
) -> None:
    text = HEADER + precise(50)
    whole = read(written(tmp_path, text + f"{stamp(500_000)},{tail}"))
    assert (len(whole.counts), whole.codes) == ((51, []) if code is None else (50, [code]))
    if code is not None:
        (problem,) = whole.problems
        assert problem.message == "line 52, the last one, has no end: it may be cut off and was left out"
        assert problem.byte_offset == len(text)
    for samples in (1, 7, 50):
        assert read(tmp_path / "a.csv", samples).same_as(whole)


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
    good = precise(number).splitlines(keepends=True)
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


@pytest.mark.parametrize("number", [1000, 2 << 20])
@pytest.mark.parametrize(
    ("tail", "said"), [("", "zeros, which hold no rows"), ("2024-03-04T00:", "has no end")]
)
def test_zeros_that_were_never_written_over_end_the_rows(
    tmp_path: Path, number: int, tail: str, said: str
) -> None:
    text = HEADER + rows(10) + tail
    path = written(tmp_path, text.encode() + bytes(number))
    found = read(path, 7)
    assert (len(found.counts), found.codes) == (10, ["truncated"])
    assert said in found.problems[0].message
    assert found.problems[0].lost_bytes == len(tail) + number
    after = written(tmp_path, text.encode() + bytes(number) + rows(3).encode())
    with pytest.raises(UnreadableError):
        read(after, 7)


def test_an_endless_line_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + rows(10) + "7" * 3_000_000)
    with pytest.raises(UnreadableError, match=r"line 12.*a line has no end"):
        read(path)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="file not found"):
        read(tmp_path / "none.csv")


@pytest.mark.parametrize(
    "time",
    [
        "2024-02-30 10:00:00",
        "2024-03-04T25:00:00",
        "2024-13-01",
        "0001-01-01 00:00:00",
        "2300-01-01T00:00:00.5",
    ],
)
@pytest.mark.parametrize("place", [1, 25, 39])
def test_a_row_with_an_impossible_time_is_left_out(tmp_path: Path, time: str, place: int) -> None:
    lines = [row(number, f"0,0,{1 + number / 1000}") for number in range(40)]
    path = written(tmp_path, HEADER + "".join([*lines[:place], f"{time},0,0,1\n", *lines[place + 1 :]]))
    found = read(path)
    assert found.codes == ["impossible_time"]
    assert found.problems[0].told == f"1 row left out: an impossible time, from line {place + 2} on"
    whole = read(written(tmp_path, HEADER + "".join(lines), "whole.csv"))
    assert np.array_equal(found.counts, np.delete(whole.counts, place, axis=0))
    assert np.array_equal(found.times, np.delete(whole.times, place))
    assert read(path, 3).same_as(found)


BAD_LINES = {
    "a time with a zone among times without": "2024-03-04T00:00:10.5Z,0,0,1\n",
    "a date in another order": "04.03.2024 00:00:11,0,0,1\n",
    "a number too long for a float": "2024-03-04T00:00:11,0,0,1e\n",
    "a digit that the parser does not know": "2024-03-04T00:00:11,0,0,\u0661\n",
    "a byte order mark": "\ufeff2024-03-04T00:00:09.52,0,0,1\n",
}


@pytest.mark.parametrize("chunk_samples", [1, 7, 100, 100_000])
@pytest.mark.parametrize("line", BAD_LINES.values(), ids=BAD_LINES)
def test_t17_bad_lines_are_the_same_whatever_the_chunk_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, chunk_samples: int
) -> None:
    monkeypatch.setattr(detect, "HEAD_BYTES", 1000)
    monkeypatch.setattr(csv_lines, "PIECE_BYTES", 200)
    text = HEADER + rows(900) + "2024-02-30,0,0,1\n" + rows(50, 901) + line + rows(40, 952)
    text += "x\ny\n" + rows(9, 994)
    found = read(written(tmp_path, text), chunk_samples)
    assert len(found.counts) == 999
    said = [(problem.count, problem.place) for problem in found.problems if problem.code == "bad_line"]
    assert said == [(1, "from line 953 on"), (2, "from line 994 on")]
    assert "impossible_time" in found.codes


@pytest.mark.parametrize("chunk_samples", [1, 7, 100_000])
def test_each_stretch_of_bad_lines_has_its_reason_whatever_the_chunk_size(
    tmp_path: Path, chunk_samples: int
) -> None:
    text = HEADER + rows(300) + 60 * "long\n" + rows(10, 360) + 3 * "short\n" + rows(200, 373)
    found = read(written(tmp_path, text), chunk_samples)
    said = [problem.message for problem in found.problems if problem.code == "bad_line"]
    assert said == [
        "60 rows left out: the line has 1 column, not 4 ('long')",
        "3 rows left out: the line has 1 column, not 4 ('short')",
    ]


@pytest.mark.parametrize("chunk_samples", [1, 7, 100_000])
def test_a_fraction_behind_whole_counts_is_a_bad_row_whatever_the_chunk_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_samples: int
) -> None:
    monkeypatch.setattr(detect, "HEAD_BYTES", 1000)
    text = HEADER + rows(900).replace(",0,0,1", ",0,0,256") + row(900, "0,0,2.5") + rows(9, 901) + "x\n"
    found = read(written(tmp_path, text), chunk_samples, unit="counts", lsb_per_g=256)
    assert (len(found.counts), found.breaks, found.codes) == (909, [900], ["bad_row", "bad_line"])
    assert [problem.told for problem in found.problems] == [
        "1 row left out: a count is not a whole number, from line 902 on",
        "1 row left out: the line has 1 column, not 4 ('x'), from line 912 on",
    ]


@pytest.mark.parametrize("chunk_samples", [1, 7, 100_000])
@pytest.mark.parametrize("line", ["\ufeff\n", "\ufeff" + row(400)])
def test_t17_a_mark_in_the_middle_is_a_bad_line_whatever_the_chunk_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, chunk_samples: int
) -> None:
    """Found by fuzzing: Arrow leaves out a byte order mark at the beginning of whatever it reads."""
    monkeypatch.setattr(csv_lines, "PIECE_BYTES", 200)
    text = HEADER + rows(400) + line + rows(300, 401)
    found = read(written(tmp_path, "\ufeff" + text), chunk_samples)
    assert len(found.counts) == 700
    assert [(problem.count, problem.place) for problem in found.problems] == [(1, "from line 402 on")]


def test_damage_in_the_second_row_does_not_hide_the_first(tmp_path: Path) -> None:
    rows = "".join(f"2024-03-04 00:00:{n:02d},{0.01 * n:.2f},0.10,0.99\n" for n in range(40))
    found = read(written(tmp_path, "time,x,y,z\n" + rows.replace("0.01,0.10", "\ufeff,0.10", 1)))
    assert len(found.g) == 39 and found.g[0, 0] == 0 and found.g[1, 0] == pytest.approx(0.02, abs=1e-6)
    assert [(one.count, one.place) for one in found.problems] == [(1, "from line 3 on")]
