"""Delimiters, headers, decimals and columns that the CSV reader has to understand, or ask about."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats import open_recording
from tests.formats.make_csv import START_US, read, stamp, written

ROWS = [(0.25 * row - 2, -0.5, 1.0 + row / 64) for row in range(12)]
TRUTH = np.array(ROWS)


def table(delimiter: str, header: str = "", decimal: str = ".", end: str = "\n", time: bool = True) -> str:
    """Return the rows as text."""
    lines = [header] if header else []
    for number, row in enumerate(ROWS):
        cells = [repr(value).replace(".", decimal) for value in row]
        lines.append(delimiter.join([stamp(number * 10_000)] * time + cells))
    return end.join(lines) + end


def check(path: Path, **options: object) -> None:
    """Check that values and times are those of the rows."""
    found = read(path, unit="g", **options)
    assert np.array_equal(found.g, TRUTH)
    assert np.array_equal(found.times - found.times[0], np.arange(len(ROWS)) * 10_000)
    assert found.recording.start_us in (START_US, None)
    assert found.breaks == []


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " ", "   ", " \t ", ", ", " ; "])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("names", [(), ("time", "x", "y", "z")])
def test_delimiters_and_line_ends(tmp_path: Path, delimiter: str, end: str, names: tuple[str, ...]) -> None:
    check(written(tmp_path, table(delimiter, delimiter.join(names), end=end)))


@pytest.mark.parametrize("delimiter", [";", "\t", "|", " "])
def test_decimal_commas(tmp_path: Path, delimiter: str) -> None:
    check(written(tmp_path, table(delimiter, delimiter.join(("time", "x", "y", "z")), decimal=",")))


@pytest.mark.parametrize(
    "header",
    [
        "Time,X,Y,Z",
        '"time","X-axis","Y-axis","Z-axis"',
        "Sample Time,Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)",
        "# time,x,y,z",
        "no,known,names,here",
        "\ufefftime,x,y,z",
        "made by a logger\nserial: 17\nrate 100 Hz\n\ntime,x,y,z",
        "sep=,\ntime,x,y,z",
        "time,x,y,z\nyyyy,g,g,g".replace("yyyy", "-"),
        "a preamble line of text",
    ],
)
def test_headers(tmp_path: Path, header: str) -> None:
    options = {"columns": ("1", "2", "3")} if header.startswith("no,") else {}
    check(written(tmp_path, table(",", header)), **options)


def in_any_order() -> str:
    lines = ["gyro_x,z,label,y,time,x,gyro_y,gyro_z"]
    lines += [f"7,{z},walk,{y},{stamp(row * 10_000)},{x},8,9" for row, (x, y, z) in enumerate(ROWS)]
    return "\n".join(lines) + "\n"


def of_androsensor() -> str:
    """All sensors in a row, the times at its end."""
    kinds = ("ACCELEROMETER", "GRAVITY", "LINEAR ACCELERATION")
    names = [f"{kind} {axis} (g)" for kind in kinds for axis in "XYZ"]
    lines = [";".join([*names, "Time since start in ms ", "YYYY-MO-DD HH-MI-SS_SSS"])]
    for row, (x, y, z) in enumerate(ROWS):
        lines.append(f"{x};{y};{z};0;0;1;0;0;0;{row * 10};2024-03-04 00:00:00:{row * 10:03d}")
    return "\n".join(lines) + "\n"


NAMED = table(",", "time,x,y,z").splitlines()
LAYOUTS = {
    "a mark before rows": "\ufeff" + table(","),
    "quoted cells": "".join(",".join(f'"{cell}"' for cell in line.split(",")) + "\n" for line in NAMED),
    "date and time split by blanks": table(" ").replace("T", " "),
    "decimal commas in times too": table(";", "time;x;y;z").replace(".", ","),
    "any order": in_any_order(),
    "AndroSensor": of_androsensor(),
    "names of rows": "\n".join([NAMED[0], *(f"{row},{line}" for row, line in enumerate(NAMED[1:], 1)), ""]),
    "empty cells behind": "\n".join([NAMED[0], *(f"{line}," for line in NAMED[1:]), ""]),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts(tmp_path: Path, layout: str) -> None:
    check(written(tmp_path, LAYOUTS[layout]))


@pytest.mark.parametrize("delimiter", [";", "\t", " "])
def test_whole_numbers_first_and_decimal_commas_later(tmp_path: Path, delimiter: str) -> None:
    lines = ["x,y,z"] + ["0,0,1"] * 20_000
    later = ["0,25;-0,5;1,015625"] * 3
    text = "\n".join([*(line.replace(",", delimiter) for line in lines), *later, ""]).replace(";", delimiter)
    found = read(written(tmp_path, text), 4000, rate_hz=100.0)
    assert found.g[-3:].tolist() == [[0.25, -0.5, 1.015625]] * 3


def test_columns_by_number_and_time_by_name(tmp_path: Path) -> None:
    path = written(tmp_path, table(",", "when,a,b,c"))
    check(path, columns=("1", "b", "3"), time_column="when")
    check(path, columns=("1", "2", "3"), time_column="0")


@pytest.mark.parametrize("row", ["0,0,1,0,0,0,1", "0,0,1,0,0", "0,0,1,0,0,0", "5,4,1,9"])
def test_columns_without_names_are_asked_about(tmp_path: Path, row: str) -> None:
    path = written(tmp_path, f"{row}\n" * 9)
    with pytest.raises(
        UnreadableError, match=r"line 1: cannot tell which of .* are x, y and z; .* --columns"
    ):
        read(path, rate_hz=30.0)


@pytest.mark.parametrize("above", ["", "time,x,y,z\n", "time,x,y,z\n\n"])
@pytest.mark.parametrize("below", ["", "\n", "s,g,g,g\n"])
def test_names_that_say_nothing_are_asked_about_in_their_line(tmp_path: Path, above: str, below: str) -> None:
    path = written(tmp_path, f"{above}a,b,c,d\n{below}" + "1,0,0,1\n" * 9)
    line = 1 + above.count("\n")
    with pytest.raises(UnreadableError, match=f"line {line}: cannot tell which of the columns a, b, c, d"):
        read(path, rate_hz=30.0)


@pytest.mark.parametrize(
    "said", [{"columns": ("x", "y", "w")}, {"columns": ("0", "1", "9")}, {"time_column": "w"}]
)
def test_unknown_columns_are_named_with_the_known_ones(tmp_path: Path, said: dict[str, object]) -> None:
    with pytest.raises(
        UsageError, match=r"is not a column of this file; its columns are 0 to 3 \(time, x, y, z\)"
    ):
        read(written(tmp_path, table(",", "time,x,y,z")), **said)


@pytest.mark.parametrize("text", ["", "\n\n", "a,b,c\n", "prose\n" * 99, "1,2\n" * 99, "{}\n"])
def test_files_without_rows_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(UnreadableError, match="no rows of three or more numbers"):
        read(written(tmp_path, text))


@pytest.mark.parametrize("name", ["utf-16-le", "utf-16-be", "utf-32-le", "utf-32-be"])
@pytest.mark.parametrize("mark", ["\ufeff", ""])
@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_t2_wide_text_is_read_like_utf8(tmp_path: Path, name: str, mark: str, pack: object) -> None:
    text = table(",", "time,x,y,z")
    file = "a.csv" if pack is bytes else "a.csv.gz"
    path = written(tmp_path, pack((mark + text).encode(name)), file)
    with open_recording(path, ReadOptions(unit="g")) as reader:
        counts = np.concatenate([chunk.counts for chunk in reader.chunks(7)])
    assert counts.tolist() == read(written(tmp_path, text.encode()), unit="g").counts.tolist()


def test_latin1_in_names_and_unused_cells(tmp_path: Path) -> None:
    text = (
        "time,x,y,z,Temperature (°C),Ort\n"
        + f"{stamp(0)},0,0,1,30.5,K\xf6ln\n{stamp(10_000)},0,0,1,30.5,K\xf6ln\n"
    )
    found = read(written(tmp_path, text.encode("latin-1")))
    assert found.temperature is not None
    assert found.temperature.tolist() == [30500, 30500]


LOG = "a line of a log without numbers\n"


@pytest.mark.parametrize("names", ["", "time,x,y,z\n"])
def test_numbers_that_begin_megabytes_behind_a_text(tmp_path: Path, names: str) -> None:
    rows = "".join(f"{stamp(row * 10_000)},{row / 4096 - 0.5},0.25,0.75\n" for row in range(4000))
    found = read(written(tmp_path, LOG * 480_000 + names + rows), unit="g")
    assert np.array_equal(found.g[:, 0], np.arange(4000) / 4096 - 0.5)
    assert np.array_equal(found.times - found.times[0], np.arange(4000) * 10_000)


def test_numbers_that_begin_behind_16_mb_are_not_looked_for(tmp_path: Path) -> None:
    path = written(tmp_path, LOG * 530_000 + table(","))
    with pytest.raises(UnreadableError, match=r"no rows of three or more numbers in its first 16 MB"):
        open_recording(path, ReadOptions(format="csv"))


@pytest.mark.parametrize(
    "again", ["x.1,y.1,z.1", "x_1,y_1,z_1", "x...5,y...6,z...7", "x.2,y.2,z.2", "X 2,Y 2,Z 2"]
)
@pytest.mark.parametrize("first", ["x,y,z", "x...2,y...3,z...4"])
def test_columns_that_a_program_renamed_are_another_sensors(tmp_path: Path, first: str, again: str) -> None:
    """As pandas, MATLAB and R rename columns of one name; `--columns` chooses."""
    lines = table(",").splitlines()
    text = "\n".join([f"time,{first},{again}", *(line + ",0.5,0.25,1.0" for line in lines)]) + "\n"
    path = written(tmp_path, text)
    with pytest.raises(UnreadableError, match="several groups of columns are named like an accelerometer's"):
        read(path, unit="g")
    check(path, columns=tuple(first.split(",")))


def test_numbered_columns_of_one_sensor_are_read(tmp_path: Path) -> None:
    for names in ("x_1,y_1,z_1", "x...2,y...3,z...4"):
        check(written(tmp_path, table(",", f"time,{names}")))
