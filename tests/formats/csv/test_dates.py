"""Dates that begin with the day or the month: told apart by `tables/cells.py`, or asked about."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.written_times import order_in, read_date
from accelcal_cli.formats.tables.cells import date_texts, find_order, year_first
from accelcal_cli.formats.tables.text import lines as csv_lines
from tests.formats.make_csv import read, written
from tests.formats.reading import Read

DAY_FIRST = datetime(2024, 4, 3)
FORMS = {"dmy": "%d{0}%m{0}%Y", "mdy": "%m{0}%d{0}%Y", "ymd": "%Y{0}%m{0}%d"}


def with_dates(
    folder: Path, order: str, start: datetime, *, mark: str = "/", step_s: float = 0.1, rows: int = 40
) -> Path:
    """Write a resting sensor whose rows carry dates in this order."""
    lines = ["time,x,y,z"]
    for row in range(rows):
        moment = start + timedelta(seconds=row * step_s)
        day = moment.strftime(FORMS[order].format(mark))
        lines.append(f"{day} {moment.strftime('%H:%M:%S.%f')[:-3]},0,0,1")
    return written(folder, "\n".join(lines) + "\n")


def check(found: Read, start: datetime, step_s: float = 0.1) -> None:
    first = round((start - datetime(1970, 1, 1)).total_seconds() * 1e6)
    assert found.times.tolist() == [first + round(row * step_s * 1e6) for row in range(len(found.times))]


@pytest.mark.parametrize("order", ["dmy", "mdy"])
@pytest.mark.parametrize("mark", ["/", "-", "."])
def test_what_can_be_read_in_two_ways_needs_the_users_word(tmp_path: Path, order: str, mark: str) -> None:
    path = with_dates(tmp_path, order, DAY_FIRST, mark=mark)
    with pytest.raises(
        UnreadableError, match=r"line 2: .* can be read as dmy or mdy; .*-R date_format=dmy or"
    ):
        read(path)
    two = path.read_text().replace(" ", ",").replace("time", "date,time")
    with pytest.raises(UnreadableError, match="can be read as dmy or mdy"):
        read(written(tmp_path, two, "two.csv"))
    check(read(path, date_format=order), DAY_FIRST)
    other = {"dmy": "mdy", "mdy": "dmy"}[order]
    check(read(path, date_format=other), datetime(2024, 3, 4))


@pytest.mark.parametrize("order", ["dmy", "mdy"])
def test_a_day_above_twelve_settles_it(tmp_path: Path, order: str) -> None:
    start = datetime(2024, 4, 13)
    path = with_dates(tmp_path, order, start)
    check(read(path), start)
    wrong = {"dmy": "mdy", "mdy": "dmy"}[order]
    with pytest.raises(UnreadableError, match=f"can only be read as {order}; give -R date_format={order}"):
        read(path, date_format=wrong)


def test_a_day_above_twelve_anywhere_in_the_head_settles_it(tmp_path: Path) -> None:
    start = datetime(2024, 4, 12, 23, 59, 30)
    path = with_dates(tmp_path, "mdy", start, rows=600)
    check(read(path), start)


def test_year_first_with_short_months_or_dots_needs_no_word(tmp_path: Path) -> None:
    check(read(with_dates(tmp_path, "ymd", DAY_FIRST, mark=".")), DAY_FIRST)
    lines = "".join(f"2024/4/3 9:05:0{row // 10}.{row % 10},0,0,1\n" for row in range(40))
    check(read(written(tmp_path, "time,x,y,z\n" + lines)), datetime(2024, 4, 3, 9, 5))


def test_the_users_word_means_nothing_where_the_year_comes_first(tmp_path: Path) -> None:
    check(read(with_dates(tmp_path, "ymd", DAY_FIRST, mark="-"), date_format="dmy"), DAY_FIRST)


def test_years_of_two_digits_need_the_users_word(tmp_path: Path) -> None:
    lines = "".join(f"13/04/24 00:00:0{row // 10}.{row % 10},0,0,1\n" for row in range(40))
    path = written(tmp_path, "time,x,y,z\n" + lines)
    with pytest.raises(UnreadableError, match="can be read as dmy or ymd"):
        read(path)
    check(read(path, date_format="dmy"), datetime(2024, 4, 13))


def test_dates_that_are_none(tmp_path: Path) -> None:
    lines = "".join(f"31/31/2024 00:00:0{row // 10}.{row % 10},0,0,1\n" for row in range(40))
    with pytest.raises(UnreadableError, match=r"'31/31/2024' and the like are not dates; .*--rate"):
        read(written(tmp_path, "time,x,y,z\n" + lines))


@pytest.mark.parametrize("piece", [1, 50, 700])
@pytest.mark.parametrize("chunk_samples", [1, 7, 1000])
def test_many_days_in_one_block_and_blocks_in_one_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int, chunk_samples: int
) -> None:
    start = datetime(2024, 1, 28, 7)
    path = with_dates(tmp_path, "mdy", start, step_s=50 * 3600.0, rows=30)
    monkeypatch.setattr(csv_lines, "PIECE_BYTES", piece)
    check(read(path, chunk_samples), start, 50 * 3600.0)


def test_hours_of_one_digit_beside_those_of_two(tmp_path: Path) -> None:
    lines = "".join(f"13.4.2024 {8 + minute // 60}:{minute % 60:02d}:00,0,0,1\n" for minute in range(300))
    found = read(written(tmp_path, "time,x,y,z\n" + lines))
    check(found, datetime(2024, 4, 13, 8), 60.0)


def test_a_date_of_another_kind_is_named_by_its_line(tmp_path: Path) -> None:
    path = with_dates(tmp_path, "dmy", datetime(2024, 4, 13), rows=900)
    lines = path.read_text().splitlines(keepends=True)
    lines[800] = lines[800].replace("13/04/2024", "04/13/2024")
    found = read(written(tmp_path, "".join(lines)), 100, date_format="dmy")
    (problem,) = (problem for problem in found.problems if problem.code == "bad_line")
    assert problem.place == "from line 801 on"
    assert problem.message.startswith("1 row left out: column 0 holds '04/13/2024 ")
    assert problem.message.endswith("which is not a time")


@pytest.mark.parametrize(
    ("words", "order"),
    [
        ("M/d/yyyy", "mdy"),
        ("dd.MM.yyyy", "dmy"),
        ("yyyy-MM-dd", "ymd"),
        ("d MMM yyyy", "dmy"),
        ("yy", None),
        ("dddd, d MMMM yyyy", "dmy"),
        ("gg yyyy. MM. dd.", "ymd"),
        ("HH", None),
    ],
)
def test_patterns(words: str, order: str | None) -> None:
    assert order_in(words) == order


@pytest.mark.parametrize(
    ("text", "order", "iso"),
    [
        ("4/3/2024", "mdy", "2024-04-03"),
        ("04.03.24 10:00", "dmy", "2024-03-04"),
        ("29/02/2023", "dmy", None),
        ("2024/3/4", "dmy", None),
        ("1/2/202", "dmy", None),
        ("0/1/2024", "dmy", None),
        ("today", "dmy", None),
        ("04-Mar-24", "ymd", "2004-03-24"),
        ("04-Mar-24", None, "2024-03-04"),
        ("04/03/2024", None, None),
    ],
)
def test_reading_one_date(text: str, order: str | None, iso: str | None) -> None:
    found = read_date(text, order)
    assert (found and found.isoformat()) == iso


def test_one_date_that_ends_as_another_is_not_mistaken(tmp_path: Path) -> None:
    block = b"1/2/2024 10:00:00,5\n11/2/2024 10:00:00,5\n21/2/2024 10:00:00,5\n"
    want = b"2024-02-01 10:00:00,5\n2024-02-11 10:00:00,5\n2024-02-21 10:00:00,5\n"
    assert year_first(block, "dmy", True) == want
    assert find_order(date_texts(["1/2/2024 10", "21/2/2024 10"]), None, (), tmp_path, 1) == "dmy"
    lines = "".join(f"{day}/2/2024 10:00:00,0,0,1\n" for day in (1, 11, 21, 22, 23, 24, 25))
    found = read(written(tmp_path, "time,x,y,z\n" + lines), rate_hz=1 / 86_400)
    assert [int(time // 86_400_000_000) - 19_753 for time in found.times] == [1, 11, 21, 22, 23, 24, 25]
