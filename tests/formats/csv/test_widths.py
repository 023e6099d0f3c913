"""Rows of more or fewer cells than there are names, a first column without a name, lines of units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.make_csv import read, stamp, written

ROWS = 60
TRUTH = np.column_stack([np.full(ROWS, 0.125), np.arange(ROWS) / 64 - 0.5, np.full(ROWS, 0.875)])


def rows(*, before: str = "", behind: object = "", order: str = "xyz") -> str:
    """Return lines of times and x, y, z in an order; `behind` may be a function of the row's number."""
    lines = []
    for number, row in enumerate(TRUTH):
        cells = dict(zip("xyz", map(repr, row.tolist()), strict=True))
        more = behind(number) if callable(behind) else behind
        line = ",".join([stamp(number * 40_000), *(cells[axis] for axis in order)])
        lines.append(before.format(number) + line + str(more))
    return "\n".join(lines) + "\n"


def check(path: Path, note: bool = True, **options: object) -> None:
    for chunk in (1000, 7):
        found = read(path, chunk_samples=chunk, unit="g", **options)
        assert np.array_equal(found.g, TRUTH) and found.problems == []
        assert np.array_equal(found.times - found.times[0], np.arange(ROWS) * 40_000)
        assert any("names belong to columns from the left" in one for one in found.recording.notes) == note


@pytest.mark.parametrize("order", ["xyz", "zyx"])
@pytest.mark.parametrize("names", ["note", "note,mark", '"a note, in quotes",mark'])
def test_names_without_cells(tmp_path: Path, order: str, names: str) -> None:
    check(written(tmp_path, f"time,{','.join(order)},{names}\n" + rows(order=order)))


def test_an_empty_name_at_the_end(tmp_path: Path) -> None:
    check(written(tmp_path, "time,x,y,z,\n" + rows()))


@pytest.mark.parametrize("first", [0, 1, 9])
def test_a_field_now_and_then(tmp_path: Path, first: int) -> None:
    """Its own column is not read; rows with it are."""
    beats = rows(behind=lambda number: ",71" if number % 10 == first else "")
    check(written(tmp_path, "time,x,y,z,heart_rate\n" + beats))
    words = rows(behind=lambda number: ',"pushed, twice"' if number % 10 == first else "")
    check(written(tmp_path, "time,x,y,z,event,more\n" + words))


def test_a_field_in_half_of_the_rows(tmp_path: Path) -> None:
    check(written(tmp_path, "time,x,y,z,note\n" + rows(behind=lambda number: ",71" if number % 2 else "")))


def test_rows_that_end_sooner(tmp_path: Path) -> None:
    """Nearly all rows have a note, and one in ten ends before it."""
    short = rows(behind=lambda number: "" if number % 10 == 3 else ",walk")
    check(written(tmp_path, "time,x,y,z,note\n" + short), note=False)


def test_more_cells_than_names_are_no_row(tmp_path: Path) -> None:
    path = written(tmp_path, "time,x,y,z,note\n" + rows(behind=lambda n: ",a,b" if n == 30 else ",a"))
    found = read(path, unit="g")
    assert len(found.g) == ROWS - 1
    assert found.problems[0].message.startswith("1 row left out: the line has 6 columns, not 5")


def test_two_cells_more_than_names_are_told(tmp_path: Path) -> None:
    path = written(tmp_path, "time,x,y,z\n" + rows(behind=",3.9,a"))
    with pytest.raises(UnreadableError, match="cannot tell which of 6 columns") as refusal:
        read(path, unit="g")
    assert "names 4 columns and they have 6: unused" in (refusal.value.hint or "")


def test_a_cut_line_is_damage(tmp_path: Path) -> None:
    lines = ("time,x,y,z,note\n" + rows(behind=",walk")).splitlines()
    lines[20] = lines[20][: lines[20].rfind(",") - 2]
    found = read(written(tmp_path, "\n".join(lines) + "\n"), unit="g")
    assert len(found.g) == ROWS - 1 and found.problems[0].code == "bad_line"


def test_names_of_another_sensor_are_not_lost(tmp_path: Path) -> None:
    for names in (
        "time,gx,gy,gz,note",
        "time,x [deg/s],y [deg/s],z [deg/s],note",
        "time,mag_x,mag_y,mag_z,n",
    ):
        with pytest.raises(UnreadableError, match="no column has a name known for acceleration"):
            read(written(tmp_path, names + "\n" + rows()))


@pytest.mark.parametrize("behind", [",3.9", ",0.002", ",17"])
def test_an_unnamed_number_behind(tmp_path: Path, behind: str) -> None:
    check(written(tmp_path, "time,x,y,z\n" + rows(behind=behind)))


def test_an_unnamed_number_behind_a_column_of_texts(tmp_path: Path) -> None:
    path = written(tmp_path, "device,time,x,y,z\n" + rows(before="AX3,", behind=",3.9"))
    check(path)


@pytest.mark.parametrize("before", ["{},", '"{}",', "r{},"])
def test_an_unnamed_column_that_counts_the_rows(tmp_path: Path, before: str) -> None:
    check(written(tmp_path, "time,x,y,z\n" + rows(before=before)), note=False)


def test_every_second_row_of_a_frame(tmp_path: Path) -> None:
    text = "time,x,y,z\n" + "".join(
        f"{2 * number},{line}\n" for number, line in enumerate(rows().splitlines())
    )
    check(written(tmp_path, text), note=False)


@pytest.mark.parametrize(
    "units",
    ["s,g,g,g,kOhms", "s,g,g,g,arbitrary units", "yyyy-mm-dd,g,g,g,", "date and time,[g],[g],[g],arb. units"],
)
def test_a_line_of_units_with_unknown_words(tmp_path: Path, units: str) -> None:
    found = read(written(tmp_path, f"time,x,y,z,skin\n{units}\n" + rows(behind=",4.5")))
    assert np.array_equal(found.g, TRUTH) and found.recording.notes[:1] != ("unit: g",)


@pytest.mark.parametrize("label", [";Headers", "#fields", "% Columns"])
def test_a_word_before_the_names_in_a_comment(tmp_path: Path, label: str) -> None:
    check(written(tmp_path, f"{label}, time,z,y,x\n" + rows(order="zyx")), note=False)


@pytest.mark.parametrize("head", ["# Labels:= Z\tY\tX", "# Labels:= Z\tY\tX\n"])
def test_labels_of_biosppy(tmp_path: Path, head: str) -> None:
    lines = "\n".join("\t".join(map(repr, row[::-1].tolist())) for row in TRUTH)
    path = written(tmp_path, f"# Simple Text Format\n# Sampling Rate (Hz):= 25.00\n{head}\n{lines}\n")
    found = read(path, unit="g", rate_hz=25)
    assert np.array_equal(found.g, TRUTH)


@pytest.mark.parametrize(
    "between", ["EVENT start", "# started by button", "-----", "x\ny", "a note, of two cells"]
)
@pytest.mark.parametrize("order", ["xyz", "zyx"])
def test_lines_between_names_and_rows(tmp_path: Path, between: str, order: str) -> None:
    """They hide no names, which may say that z comes first, or that nothing is acceleration."""
    text = f"time,{','.join(order)}\n{between}\n" + rows(order=order)
    check(written(tmp_path, text), note=False)
    for names in ("time,gx,gy,gz", "time,x [rad/s],y [rad/s],z [rad/s]"):
        with pytest.raises(UnreadableError, match="no column has a name known for acceleration"):
            read(written(tmp_path, f"{names}\n{between}\n" + rows()))


@pytest.mark.parametrize("cell", ["ERR", "over"])
def test_a_text_in_the_first_row_hides_no_names(tmp_path: Path, cell: str) -> None:
    lines = rows(order="zyx", behind=",5").splitlines()
    for column in (1, 4):
        cells = lines[0].split(",")
        cells[column] = cell
        path = written(tmp_path, "\n".join(["time,z,y,x,light", ",".join(cells), *lines[1:]]) + "\n")
        assert np.array_equal(read(path, unit="g").g, TRUTH[1:])
