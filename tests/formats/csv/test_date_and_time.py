"""Dates and times of day in two columns, and clocks of twelve hours."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.formats.tables.text.dialect import Normaliser
from tests.formats.make_csv import Read, read

Written = Callable[[datetime], str]
MIDNIGHT = datetime(2024, 3, 14, 23, 59, 50)
NOON = datetime(2024, 12, 31, 11, 59, 50)
NINE = datetime(2024, 3, 14, 9, 59, 50)
EPOCH = datetime(1970, 1, 1)


def clock(t: datetime) -> str:
    return f"{t:%H:%M:%S}.{t.microsecond // 1000:03d}"


def twelve(t: datetime, mark: str = " {}", short: bool = True) -> str:
    hour = str(t.hour % 12 or 12)
    half = mark.format("PM" if t.hour >= 12 else "AM")
    return f"{hour if short else hour.zfill(2)}:{t:%M:%S}.{t.microsecond // 1000:03d}{half}"


def moments(start: datetime, rows: int = 500) -> list[datetime]:
    return [start + timedelta(milliseconds=40 * row) for row in range(rows)]


def us(times: list[datetime]) -> list[int]:
    return [(t - EPOCH) // timedelta(microseconds=1) for t in times]


def table(folder: Path, stamps: list[str], header: str, delimiter: str = ",") -> Path:
    values = [f"{0.001 * (row % 7):g},0.02,1".replace(",", delimiter) for row in range(len(stamps))]
    rows = [f"{stamp}{delimiter}{value}" for stamp, value in zip(stamps, values, strict=True)]
    path = folder / "a.csv"
    path.write_text("\n".join([*([header.replace(",", delimiter)] if header else []), *rows, ""]), "utf-8")
    return path


TWO = "Date,Time,x [g],y [g],z [g]"
ONE = "time,x [g],y [g],z [g]"
FORMS: dict[str, tuple[str, Written]] = {
    "iso": (TWO, lambda t: f"{t:%Y-%m-%d},{clock(t)}"),
    "time first": ("Time,Date,x [g],y [g],z [g]", lambda t: f"{clock(t)},{t:%Y-%m-%d}"),
    "slashes": (TWO, lambda t: f"{t:%Y/%m/%d},{clock(t)}"),
    "day first": (TWO, lambda t: f"{t:%d.%m.%Y},{clock(t)}"),
    "month first, short hours": (TWO, lambda t: f"{t.month}/{t.day}/{t.year},{t.hour}:{clock(t)[3:]}"),
    "two digits": (TWO, lambda t: f"{t:%d/%m/%y},{clock(t)}"),
    "quoted": (TWO, lambda t: f'"{t:%Y-%m-%d}","{t.hour}:{clock(t)[3:]}"'),
    "padded": (TWO, lambda t: f"{t:%Y-%m-%d}, {clock(t)}"),
    "afternoon in two": (TWO, lambda t: f"{t.month}/{t.day}/{t.year},{twelve(t)}"),
    "afternoon in one": (ONE, lambda t: f"{t.month}/{t.day}/{t.year} {twelve(t)}"),
    "afternoon, two digits": (ONE, lambda t: f"{t:%Y-%m-%d} {twelve(t, '{}', short=False)}"),
    "afternoon, narrow blank": (ONE, lambda t: f"{t:%d/%m/%Y} {twelve(t, chr(0x202F) + '{}')}"),
    "afternoon, dots": (TWO, lambda t: f"{t:%d/%m/%Y},{twelve(t).lower().replace('m', '.m.')}"),
    "far apart": ("Date,x [g],y [g],z [g],Time", lambda t: f"{t:%Y-%m-%d}"),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("start", [MIDNIGHT, NOON, pytest.param(NINE, marks=pytest.mark.nightly)])
def test_every_row_has_its_time(tmp_path: Path, form: str, start: datetime) -> None:
    header, written = FORMS[form]
    times = moments(start)
    path = table(tmp_path, list(map(written, times)), header)
    if form == "far apart":
        first, *rows = path.read_text().splitlines()
        rows = [f"{row},{clock(t)}" for row, t in zip(rows, times, strict=True)]
        path.write_text("\n".join([first, *rows, ""]))
    order = {"day first": "dmy", "two digits": "dmy"}.get(form)
    found = read(path, 1000, date_format=order)
    assert found.times.tolist() == us(times)
    assert (found.codes, found.breaks, found.recording.timezone) == ([], [], None)
    assert read(path, 7, date_format=order).same_as(found)


@pytest.mark.parametrize("delimiter", [";", "\t", "|", " "])
def test_other_delimiters(tmp_path: Path, delimiter: str) -> None:
    times = moments(NOON)
    stamps = [f"{t:%d/%m/%Y}{delimiter}{twelve(t)}" for t in times]
    header = "Date,Time,x_g,y_g,z_g"
    assert read(table(tmp_path, stamps, header, delimiter)).times.tolist() == us(times)


def test_without_names_and_compressed(tmp_path: Path) -> None:
    times = moments(MIDNIGHT)
    path = table(tmp_path, [f"{t:%Y-%m-%d},{clock(t)}" for t in times], "")
    packed = tmp_path / "a.csv.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert read(path).times.tolist() == read(packed).times.tolist() == us(times)
    assert "time: column 0 and column 1" in read(path).recording.notes


@pytest.mark.parametrize("named", ["Day", "Clock", "0", "1"])
def test_naming_one_of_both_is_enough(tmp_path: Path, named: str) -> None:
    times = moments(MIDNIGHT)
    path = table(tmp_path, [f"{t:%Y-%m-%d},{clock(t)}" for t in times], "Day,Clock,x [g],y [g],z [g]")
    found = read(path, time_column=named)
    assert found.times.tolist() == us(times)
    assert "time: column 0 ('Day') and column 1 ('Clock')" in found.recording.notes


def test_whole_seconds_are_spread_and_changes_of_a_zone_followed(tmp_path: Path) -> None:
    before, after = (datetime(2024, 3, 31, 1, 59, 50), datetime(2024, 3, 31, 3, 0, 0))
    times = [*moments(before, 250), *moments(after, 250)]
    path = table(tmp_path, [f"{t:%Y-%m-%d},{t:%H:%M:%S}" for t in times], TWO)
    found = read(path, timezone="Europe/Berlin")
    assert found.codes == ["clock_followed"] and found.breaks == []
    assert found.times.tolist() == us(moments(before))


def faulty(tmp_path: Path, row: int, cells: str) -> Read:
    stamps = [f"{t:%Y-%m-%d},{clock(t)}" for t in moments(NINE)]
    stamps[row] = cells
    return read(table(tmp_path, stamps, TWO))


@pytest.mark.parametrize(
    ("cells", "code"),
    [
        (",10:00:01.000", "missing_value"),
        ("2024-03-14,", "missing_value"),
        (",", "missing_value"),
        ("2024-02-30,10:00:01.000", "impossible_time"),
        ("2024-03-14,25:00:01.000", "impossible_time"),
    ],
)
def test_a_row_without_a_time_is_left_out(tmp_path: Path, cells: str, code: str) -> None:
    found = faulty(tmp_path, 300, cells)
    assert code in found.codes
    assert found.times.tolist() == us([t for row, t in enumerate(moments(NINE)) if row != 300])


@pytest.mark.parametrize("cells", ["2024-03-14,noon", "yesterday,10:00:01.000", "2024-03-14,10:00:01.000,7"])
def test_t17_a_line_that_is_not_a_row_is_named(tmp_path: Path, cells: str) -> None:
    found = faulty(tmp_path, 300, cells)
    assert "bad_line" in found.codes and "from line 302 on" in str(found.problems)
    assert found.times.tolist() == us([t for row, t in enumerate(moments(NINE)) if row != 300])


def test_an_order_of_dates_that_is_not_clear_is_asked_for(tmp_path: Path) -> None:
    times = moments(datetime(2024, 3, 4, 10))
    path = table(tmp_path, [f"{t:%d/%m/%Y},{clock(t)}" for t in times], TWO)
    with pytest.raises(UnreadableError, match="'04/03/2024' can be read as dmy or mdy"):
        read(path)
    assert read(path, date_format="dmy").times.tolist() == us(times)


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("12:00:00 AM", "00:00:00"),
        ("1:00 am", "01:00"),
        ("11:59:59.5 AM", "11:59:59.5"),
        ("12:00:00 PM", "12:00:00"),
        ("12:59:59pm", "12:59:59"),
        ("11:00:00:250 p. m.", "23:00:00:250"),
        ("13:00:00 PM", "13:00:00"),
        ("0:30:00 AM", "00:30:00"),
        ("13:00:00 AM", "99:00:00"),
        ("1:00:00 amp", "1:00:00 amp"),
    ],
)
def test_hours_of_a_clock_of_twelve(written: str, meant: str) -> None:
    block = f"3/14/2024 {written},1\n{written};2\n"
    told = Normaliser(",", twelve_hours=True)(block.encode()).decode()
    assert told == f"3/14/2024 {meant},1\n{meant};2\n"


def test_thirteen_in_the_morning_does_not_exist(tmp_path: Path) -> None:
    stamps = [f"{t:%m/%d/%Y} {twelve(t)}" for t in moments(NINE)]
    stamps[20] = "03/14/2024 13:00:00.000 AM"
    found = read(table(tmp_path, stamps, ONE))
    assert found.codes[0] == "impossible_time" and len(found.times) == 499


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_counts_since_1970_are_utc(tmp_path: Path, unit: str) -> None:
    size = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    times = moments(NINE)
    stamps = [
        f"{value * size / 10**6:.3f}" if unit == "s" else str(value * size // 10**6) for value in us(times)
    ]
    found = read(table(tmp_path, stamps, ONE))
    assert found.times.tolist() == us(times)
    assert found.recording.timezone == "UTC"
    assert found.recording.start_us == us([NINE])[0] == NINE.replace(tzinfo=UTC).timestamp() * 1e6
