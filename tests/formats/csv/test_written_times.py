"""Times as people write them, in one column or in two, and clocks of twelve hours."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from email.utils import format_datetime
from pathlib import Path

import pyarrow as pa
import pytest

from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.written_times import is_date, is_time, month_of, stated_zone, written_start
from accelcal_cli.formats.tables.cells import written_form
from tests.cli.run import exit_code
from tests.formats.make_csv import read, written
from tests.formats.reading import Read

FIRST = datetime(2024, 3, 14, 10, 41, 40)
"""When the recordings of these tests begin: 400 rows at 10 Hz, of which some lie behind the next minute."""

LATE = datetime(2024, 2, 28, 23, 59, 50, 300_000)
NOON = datetime(2024, 12, 31, 11, 59, 50)
ONE, TWO = "time,x,y,z", "Date,Time,x,y,z"
ROWS, STEP = 400, timedelta(milliseconds=100)
MONTHS = {
    "en": "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec",
    "de": "Januar Februar März April Mai Juni Juli August September Oktober November Dezember",
    "fr": "janv. févr. mars avr. mai juin juil. août sept. oct. nov. déc.",
    "es": "ene. feb. mar. abr. may. jun. jul. ago. sept. oct. nov. dic.",
    "it": "gen feb mar apr mag giu lug ago set ott nov dic",
    "pt": "jan. fev. mar. abr. mai. jun. jul. ago. set. out. nov. dez.",
    "nl": "jan. feb. mrt. apr. mei jun. jul. aug. sep. okt. nov. dec.",
    "sv": "jan. feb. mars apr. maj juni juli aug. sep. okt. nov. dec.",
}


def us(moment: datetime) -> int:
    return (moment.replace(tzinfo=moment.tzinfo or UTC) - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(
        microseconds=1
    )


def table(cells: list[str], mark: str = ";", names: str = ONE) -> str:
    """Rows with these cells of times, in one column or in two; a cell that holds the mark is quoted."""

    def row(cell: str) -> str:
        shown = cell.replace(",", mark) if names != ONE else f'"{cell}"' if mark in cell else cell
        return shown if names.endswith("Time") else mark.join((shown, "0.1", "0.2", "0.9"))

    return "\n".join([*([names.replace(",", mark)] if names else []), *map(row, cells), ""])


def moments(first: datetime = FIRST) -> list[datetime]:
    return [first + row * STEP for row in range(ROWS)]


def ms(moment: datetime) -> str:
    return f"{moment.microsecond // 1000:03d}"


def clock(t: datetime) -> str:
    return f"{t:%H:%M:%S}.{ms(t)}"


def short(t: datetime) -> str:
    return f"{t.hour}:{clock(t)[3:]}"


def twelve(t: datetime, mark: str = " {}", width: int = 1) -> str:
    half = mark.format("PM" if t.hour >= 12 else "AM")
    return f"{str(t.hour % 12 or 12).zfill(width)}{clock(t)[2:]}{half}"


def check(found: Read, zone: str | None, first: datetime = FIRST) -> None:
    assert found.times.tolist() == [us(moment) for moment in moments(first)]
    assert (found.recording.rate_hz, found.recording.timezone, found.codes) == (10.0, zone, [])
    assert found.breaks == []


GERMAN = {2: "Februar", 3: "März", 12: "Dezember"}
FRENCH = {2: "févr.", 3: "mars", 12: "déc."}
SPANISH = {2: "febrero", 3: "marzo", 12: "diciembre"}
FORMS: dict[str, tuple[str, Callable[[datetime], str]]] = {
    "ISO with T": (ONE, lambda t: f"{t:%Y-%m-%dT%H:%M:%S}.{ms(t)}"),
    "ISO with a comma": (ONE, lambda t: f"{t:%Y-%m-%d %H:%M:%S},{ms(t)}"),
    "ISO basic": (ONE, lambda t: f"{t:%Y%m%dT%H%M%S}.{ms(t)}"),
    "ISO basic with a comma": (ONE, lambda t: f"{t:%Y%m%dT%H%M%S},{ms(t)}"),
    "ISO week": (ONE, lambda t: f"{t:%G-W%V-%uT%H:%M:%S}.{ms(t)}"),
    "ISO basic week": (ONE, lambda t: f"{t:%GW%V%uT%H%M%S}.{ms(t)}"),
    "ISO ordinal": (ONE, lambda t: f"{t:%Y-%jT%H:%M:%S}.{ms(t)}"),
    "an underscore between": (ONE, lambda t: f"{t:%Y-%m-%d_%H:%M:%S}.{ms(t)}"),
    "an underscore, no marks": (ONE, lambda t: f"{t:%Y%m%d_%H%M%S}.{ms(t)}"),
    "a blank, no marks": (ONE, lambda t: f"{t:%Y%m%d %H%M%S}.{ms(t)}"),
    "digits alone": (ONE, lambda t: f"{t:%Y%m%d%H%M%S}.{ms(t)}"),
    "digits alone, with milliseconds": (ONE, lambda t: f"{t:%Y%m%d%H%M%S}{ms(t)}"),
    "MATLAB": (ONE, lambda t: f"{t:%d-%b-%Y %H:%M:%S}.{ms(t)}"),
    "MATLAB, two digits of the year": (ONE, lambda t: f"{t:%d-%b-%y %H:%M:%S}.{ms(t)}"),
    "SAS": (ONE, lambda t: f"{t:%d%b%Y}".upper() + f":{t:%H:%M:%S}.{ms(t)}"),
    "American": (ONE, lambda t: f"{t:%b %d, %Y %H:%M:%S}.{ms(t)}"),
    "American, 12 hours": (ONE, lambda t: f"{t:%B %d, %Y, %I:%M:%S}.{ms(t)} {t:%p}"),
    "browser, 12 hours": (ONE, lambda t: f"{t.month}/{t.day}/{t.year}, {t:%I:%M:%S}.{ms(t)} {t:%p}"),
    "browser, German": (ONE, lambda t: f"{t.day}.{t.month}.{t.year}, {t:%H:%M:%S}.{ms(t)}"),
    "time first": (ONE, lambda t: f"{t:%H:%M:%S}.{ms(t)} {t:%Y-%m-%d}"),
    "time first, day first": (ONE, lambda t: f"{t:%H:%M:%S}.{ms(t)} {t:%d/%m/%Y}"),
    "time first, named month": (ONE, lambda t: f"{t:%H:%M:%S}.{ms(t)} {t:%d %B %Y}"),
    "German": (ONE, lambda t: f"{t.day}. {GERMAN[t.month]} {t:%Y um %H:%M:%S}.{ms(t)}"),
    "French": (ONE, lambda t: f"{t.day} {FRENCH[t.month]} {t:%Y à %H:%M:%S}.{ms(t)}"),
    "Spanish": (ONE, lambda t: f"{t.day} de {SPANISH[t.month]} de {t:%Y, %H:%M:%S}.{ms(t)}"),
    "Korean": (ONE, lambda t: f"{t:%Y. %m. %d. %H:%M:%S}.{ms(t)}"),
    "points between hours and minutes": (ONE, lambda t: f"{t:%Y-%m-%dT%H.%M.%S}.{ms(t)}"),
    "as cameras write it": (ONE, lambda t: f"{t:%Y:%m:%d %H:%M:%S}.{ms(t)}"),
    "Buddhist years": (ONE, lambda t: f"{t.year + 543}{t:-%m-%d %H:%M:%S}.{ms(t)}"),
    "a named weekday": (ONE, lambda t: f"{t:%a %b %d %H:%M:%S}.{ms(t)} {t:%Y}"),
    "afternoon": (ONE, lambda t: f"{t.month}/{t.day}/{t.year} {twelve(t)}"),
    "afternoon, two digits": (ONE, lambda t: f"{t:%Y-%m-%d} {twelve(t, '{}', 2)}"),
    "afternoon, narrow blank": (ONE, lambda t: f"{t:%d/%m/%Y} {twelve(t, chr(0x202F) + '{}')}"),
    "two columns": (TWO, lambda t: f"{t:%Y-%m-%d},{clock(t)}"),
    "two, time first": ("Time,Date,x,y,z", lambda t: f"{clock(t)},{t:%Y-%m-%d}"),
    "two, slashes": (TWO, lambda t: f"{t:%Y/%m/%d},{clock(t)}"),
    "two, day first": (TWO, lambda t: f"{t:%d.%m.%Y},{clock(t)}"),
    "two, short hours": (TWO, lambda t: f"{t.month}/{t.day}/{t.year},{short(t)}"),
    "two, two digits": (TWO, lambda t: f"{t:%d/%m/%y},{clock(t)}"),
    "two, quoted": (TWO, lambda t: f'"{t:%Y-%m-%d}","{short(t)}"'),
    "two, padded": (TWO, lambda t: f"{t:%Y-%m-%d}, {clock(t)}"),
    "two, afternoon": (TWO, lambda t: f"{t.month}/{t.day}/{t.year},{twelve(t)}"),
    "two, afternoon with dots": (TWO, lambda t: f"{t:%d/%m/%Y},{twelve(t).lower().replace('m', '.m.')}"),
    "two, no marks": (TWO, lambda t: f"{t:%Y%m%d,%H%M%S}.{ms(t)}"),
    "two, MATLAB": (TWO, lambda t: f"{t:%d-%b-%Y},{clock(t)}"),
    "two, no marks between hours": (TWO, lambda t: f"{t:%d.%m.%Y,%H%M%S}.{ms(t)}"),
    "two, far apart": ("Date,x,y,z,Time", lambda t: f"{t:%Y-%m-%d},0.1,0.2,0.9,{clock(t)}"),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("first", "mark", "samples"), [(FIRST, ";", 1000), (LATE, "\t", 37), (NOON, ",", 7)], ids=str
)
def test_t6_ways_to_write_a_clocks_time(
    tmp_path: Path, form: str, first: datetime, mark: str, samples: int
) -> None:
    names, write = FORMS[form]
    path = written(tmp_path, table(list(map(write, moments(first))), mark, names))
    check(read(path, samples, date_format="dmy" if form == "two, two digits" else None), None, first)


@pytest.mark.parametrize("mark", ["|", " "])
def test_dates_and_times_of_two_columns_between_other_delimiters(tmp_path: Path, mark: str) -> None:
    cells = [f"{t:%d/%m/%Y},{twelve(t)}" for t in moments(NOON)]
    check(read(written(tmp_path, table(cells, mark, TWO))), None, NOON)


def test_two_columns_without_names_and_compressed(tmp_path: Path) -> None:
    data = table([f"{t:%Y-%m-%d},{clock(t)}" for t in moments(LATE)], ",", "").encode()
    for path in (written(tmp_path, data), written(tmp_path, gzip.compress(data), "a.csv.gz")):
        check(read(path), None, LATE)
        assert "time: column 0 and column 1" in read(path).recording.notes


@pytest.mark.parametrize("named", ["Day", "Clock", "0", "1"])
def test_naming_one_of_both_columns_is_enough(tmp_path: Path, named: str) -> None:
    cells = [f"{t:%Y-%m-%d},{clock(t)}" for t in moments()]
    found = read(written(tmp_path, table(cells, ",", "Day,Clock,x,y,z")), time_column=named)
    check(found, None)
    assert "time: column 0 ('Day') and column 1 ('Clock')" in found.recording.notes


def test_whole_seconds_are_spread_and_changes_of_a_zone_followed(tmp_path: Path) -> None:
    first = datetime(2024, 3, 31, 1, 59, 40)
    shown = [t if t.hour == 1 else t + timedelta(hours=1) for t in moments(first)]
    cells = [f"{t:%Y-%m-%d},{t:%H:%M:%S}" for t in shown]
    found = read(written(tmp_path, table(cells, ",", TWO)), timezone="Europe/Berlin")
    assert found.codes == ["clock_followed"] and found.breaks == []
    assert found.times.tolist() == [us(moment) for moment in moments(first)]


@pytest.mark.parametrize(
    ("cells", "code"),
    [
        (",10:00:01.000", "missing_value"),
        ("2024-03-14,", "missing_value"),
        (",", "missing_value"),
        ("2024-02-30,10:00:01.000", "impossible_time"),
        ("2024-03-14,25:00:01.000", "impossible_time"),
        ("2024-03-14,noon", "bad_line"),
        ("yesterday,10:00:01.000", "bad_line"),
        ("2024-03-14,10:00:01.000,7", "bad_line"),
    ],
)
def test_t17_a_row_without_a_time_is_left_out(tmp_path: Path, cells: str, code: str) -> None:
    stamps = [f"{t:%Y-%m-%d},{clock(t)}" for t in moments()]
    stamps[300] = cells
    found = read(written(tmp_path, table(stamps, ",", TWO)))
    assert code in found.codes and "from line 302 on" in str(found.problems)
    assert found.times.tolist() == [us(t) for row, t in enumerate(moments()) if row != 300]


@pytest.mark.parametrize(
    ("shown", "meant"),
    [
        ("12:00:00 AM", "00:00:00"),
        ("1:00 am", "01:00:00"),
        ("11:59:59.5 AM", "11:59:59.5"),
        ("12:00:00 PM", "12:00:00"),
        ("12:59:59pm", "12:59:59"),
        ("11:00:00:250 p. m.", "23:00:00.25"),
        ("13:00:00 PM", "13:00:00"),
        ("0:30:00 AM", "00:30:00"),
    ],
)
def test_hours_of_a_clock_of_twelve(shown: str, meant: str) -> None:
    form = written_form([f"3/14/2024 {shown}"], "mdy")
    assert form is not None
    times, others = form.read(pa.array([f"3/14/2024 {shown}"]))
    assert times.tolist() == [us(datetime.fromisoformat(f"2024-03-14 {meant}"))] and not len(others)


def test_thirteen_in_the_morning_does_not_exist(tmp_path: Path) -> None:
    cells = [f"{t:%m/%d/%Y} {twelve(t)}" for t in moments()]
    cells[20] = "03/14/2024 13:00:00.000 AM"
    found = read(written(tmp_path, table(cells)))
    assert found.codes[0] == "impossible_time" and len(found.times) == ROWS - 1


ZONED = {
    "biobank": ("{t:%Y-%m-%d %H:%M:%S}.{ms}+0100 [Europe/London]", 1),
    "biobank in winter": ("{t:%Y-%m-%d %H:%M:%S}.{ms}+0000 [Europe/London]", 0),
    "a blank before the offset": ("{t:%Y-%m-%d %H:%M:%S}.{ms} +01:00", 1),
    "ISO basic": ("{t:%Y%m%dT%H%M%S}.{ms}-0530", -5.5),
    "ISO basic, UTC": ("{t:%Y%m%dT%H%M%S}.{ms}Z", 0),
    "UTC by name": ("{t:%Y-%m-%d %H:%M:%S}.{ms} UTC", 0),
    "GMT and hours": ("{t:%Y-%m-%d %H:%M:%S}.{ms} GMT+2", 2),
    "American summer": ("{t:%Y-%m-%d %H:%M:%S}.{ms} EDT", -4),
    "European summer": ("{t:%d.%m.%Y %H:%M:%S}.{ms} CEST", 2),
    "Unix": ("{t:%a %b %d %H:%M:%S}.{ms} PST {t:%Y}", -8),
    "JavaScript": ("{t:%a %b %d %Y %H:%M:%S}.{ms} GMT+0100 (Central European Standard Time)", 1),
}


@pytest.mark.parametrize("form", ZONED)
def test_t6_zones_behind_the_time(tmp_path: Path, form: str) -> None:
    pattern, hours = ZONED[form]
    cells = [pattern.format(t=moment, ms=ms(moment)) for moment in moments()]
    found = read(written(tmp_path, table(cells)))
    check(found, "UTC", FIRST - timedelta(hours=hours))
    assert found.recording.has_offsets == (hours != 0)


def test_t6_mails_times_have_whole_seconds(tmp_path: Path) -> None:
    moments = [
        FIRST.replace(tzinfo=timezone(timedelta(hours=-3))) + timedelta(seconds=row) for row in range(90)
    ]
    found = read(written(tmp_path, table([format_datetime(moment) for moment in moments])))
    assert found.times.tolist() == [us(moment) for moment in moments]
    assert found.recording.timezone == "UTC"


def test_t6_offsets_change_within_a_file(tmp_path: Path) -> None:
    """A computer's log in London at the end of summer time: moments go on evenly."""
    moments = [datetime(2024, 10, 27, 0, 59, 30, tzinfo=UTC) + row * STEP for row in range(ROWS)]
    summer, winter = timezone(timedelta(hours=1)), UTC
    change = datetime(2024, 10, 27, 1, tzinfo=UTC)
    local = [moment.astimezone(summer if moment < change else winter) for moment in moments]
    cells = [f"{moment:%Y-%m-%d %H:%M:%S}.{ms(moment)}{moment:%z} [Europe/London]" for moment in local]
    assert read(written(tmp_path, table(cells))).times.tolist() == [us(moment) for moment in moments]


@pytest.mark.parametrize("name", ["CST", "IST", "BST"])
def test_t6_a_zones_name_that_stands_for_several_is_not_guessed(tmp_path: Path, name: str) -> None:
    cells = [f"{moment:%Y-%m-%d %H:%M:%S}.{ms(moment)} {name}" for moment in moments()]
    found = read(written(tmp_path, table(cells)))
    check(found, None)
    assert f"{name} is " in " ".join(found.recording.notes)
    assert read(written(tmp_path, table(cells)), timezone="Asia/Kolkata").recording.timezone == "Asia/Kolkata"


def test_t6_a_region_behind_the_time_is_the_zone_of_the_clock(tmp_path: Path) -> None:
    cells = [f"{moment:%Y-%m-%d %H:%M:%S}.{ms(moment)} [Europe/Berlin]" for moment in moments()]
    check(read(written(tmp_path, table(cells))), "Europe/Berlin")


@pytest.mark.parametrize("pattern", ["%H%M%S.{ms}", "%H:%M:%S.{ms}"])
def test_t6_digits_of_a_time_of_day_are_no_seconds(tmp_path: Path, pattern: str) -> None:
    cells = [moment.strftime(pattern).format(ms=ms(moment)) for moment in moments()]
    found = read(written(tmp_path, table(cells)))
    assert (found.times - found.times[0]).tolist() == [row * 100_000 for row in range(ROWS)]
    assert found.codes == ["no_start_time"]
    assert "times of day without a date" in " ".join(found.recording.notes)


@pytest.mark.parametrize("first", [104_130.0, 94_158.3, 3_599.9])
def test_t6_seconds_that_look_like_a_time_of_day_are_seconds(tmp_path: Path, first: float) -> None:
    found = read(written(tmp_path, table([f"{first + row / 10:.1f}" for row in range(ROWS)])))
    assert (found.times - found.times[0]).tolist() == [row * 100_000 for row in range(ROWS)]


def test_t6_a_time_that_is_not_read_is_shown_with_its_line_and_a_command(tmp_path: Path) -> None:
    cells = [f"{moment:%d|%m} {ms(moment)}" for moment in moments()]
    with pytest.raises(UnreadableError) as caught:
        read(written(tmp_path, table(cells)), time_column="time")
    assert caught.value.line == 2
    assert "'14|03 000'" in caught.value.message and "RFC 2822" in caught.value.message
    assert "accelcal calibrate a.csv -R time_format" in str(caught.value.hint)


def test_t6_an_odd_time_among_others_is_named_by_its_line(tmp_path: Path) -> None:
    cells = [FORMS["MATLAB"][1](moment) for moment in moments()]
    cells[300] = "14-Foo-2024 10:42:10.000"
    found = read(written(tmp_path, table(cells)), 50)
    assert found.problems[0].told == (
        "1 row left out: column 0 holds '14-Foo-2024 10:42:10.000', which is not a time, from line 302 on"
    )
    cells[300] = "30-Feb-2024 10:42:10.000"
    assert read(written(tmp_path, table(cells)), 50).codes == ["impossible_time"]


ASKED = {
    "%d|%m|%Y %H-%M-%S.%f": None,
    "%y%j:%H%M%S,%f": None,
    "%I.%M.%S.%f%p on %d.%m.%Y": None,
    "%d %B %Y %T.%f": None,
    "%F %T.%f %z": "UTC",
}


@pytest.mark.parametrize("form", ASKED)
def test_t6_time_format_reads_any_other_form(tmp_path: Path, form: str) -> None:
    cells = [moment.replace(tzinfo=UTC).strftime(form.replace("%f", ms(moment))) for moment in moments()]
    found = read(written(tmp_path, table(cells)), 55, time_format=form, time_column="time")
    check(found, ASKED[form])


@pytest.mark.parametrize("form", ["%d.%m.%Y", "%Q %H", "%H:%M %H", "hours"])
def test_t6_a_time_format_that_makes_no_sense_is_said(tmp_path: Path, form: str) -> None:
    with pytest.raises(UsageError, match=r"-R time_format=.* is not understood"):
        read(written(tmp_path, table([FORMS["MATLAB"][1](moment) for moment in moments()])), time_format=form)


@pytest.mark.parametrize("language", MONTHS)
def test_names_of_months(language: str) -> None:
    assert [month_of(name) for name in MONTHS[language].split()] == [*range(1, 13)]


@pytest.mark.parametrize("word", ["", "ma", "jui", "monday", "mitten", "x", "seconds"])
def test_words_that_are_no_months(word: str) -> None:
    assert month_of(word) is None


@pytest.mark.parametrize(
    ("text", "zone"),
    [
        ("GMT +5:30", "+05:30"),
        ("-5", "-05:00"),
        ("-05:00:00", "-05:00"),
        ("02:00:00", "+02:00"),
        ("UTC", "UTC"),
        ("EDT", "-04:00"),
        ("CST", None),
        ("+99", None),
        ("local", None),
        ("Europe/Berlin", "Europe/Berlin"),
        ("Europe/Nowhere", None),
        ("+0545", "+05:45"),
    ],
)
def test_zones_of_headers(text: str, zone: str | None) -> None:
    assert stated_zone(text) == zone


@pytest.mark.parametrize("text", ["12", "0.5", "-0.57", "1.2.3", "walking", "2024", "v1.2", "10-20"])
def test_numbers_and_words_are_no_dates_or_times(text: str) -> None:
    assert not is_date(text) and not is_time(text)


def test_h17_a_second_60_is_the_next_minute() -> None:
    for text in ("2016-12-31T23:59:60Z", "31-Dec-2016 23:59:60", "20161231T235960"):
        start = written_start(text)
        assert start is not None and start.start_us == us(datetime(2017, 1, 1))
    assert written_start("2016-12-31T23:59:61Z") is None


@pytest.mark.parametrize("year", [1, 1601, 1980, 2036, 2262, 9999])
def test_h17_any_year_of_the_calendar_is_read(tmp_path: Path, year: int) -> None:
    first = datetime(year, 3, 4)
    cells = [f"{moment.isoformat(' ', 'milliseconds')}" for moment in moments(first)]
    check(read(written(tmp_path, table(cells))), None, first)


@pytest.mark.parametrize("text", ["0001-01-01 00:00:00", "9999-12-31T23:59:59", "2024-03-04 00:00:00"])
def test_h17_times_that_stand_still_are_shown(tmp_path: Path, text: str) -> None:
    with pytest.raises(UnreadableError, match=f"rows: {text[:10]}T{text[11:]}.* in each of the first 90"):
        read(written(tmp_path, table([text] * 90)))


def test_h17_a_leap_second_in_the_times(tmp_path: Path) -> None:
    """Rows of the second 60 are those of the next minute's first, which comes again."""
    minutes = [("2016-12-31 23:59", second) for second in range(50, 61)]
    minutes += [("2017-01-01 00:00", second) for second in range(60)]
    cells = [f"{minute}:{second:02d}.{tenth}" for minute, second in minutes for tenth in range(10)]
    found = read(written(tmp_path, table(cells)), 33)
    assert len(found.times) == 710 and found.codes == ["clock_back"]
    assert found.times[100] == us(datetime(2017, 1, 1))


@pytest.mark.parametrize(("name", "zone"), [("utc_time", "UTC"), ("time [GMT+1]", "+01:00")])
@pytest.mark.parametrize("form", ["ISO with T", "MATLAB"])
def test_t11_the_zone_in_the_name_of_the_column(
    tmp_path: Path, name: str, zone: str | None, form: str
) -> None:
    text = table([FORMS[form][1](moment) for moment in moments()]).replace("time;", f"{name};", 1)
    check(read(written(tmp_path, text)), zone)


CASES = {
    "19_biobank_times.csv.gz": ("2024-03-14T10:41:40.000000", "UTC", 360),
    "21_matlab_times.csv.gz": ("2024-03-14T10:41:40.000000", None, 360),
    "22_comma_before_milliseconds.csv.gz": ("2024-03-14T10:41:40.000000", None, 360),
    "24_hhmmss.csv.gz": (None, None, 360),
    "26_actigraph_year_first_slash.csv.gz": ("2024-03-04T10:00:00.000000", None, 360),
    "27_actigraph_month_name.csv.gz": ("2024-03-04T10:00:00.000000", None, 360),
}


@pytest.mark.parametrize("name", CASES)
def test_t6_t8_the_cases(real_data: Path, name: str) -> None:
    start, zone, seconds = CASES[name]
    found = read(real_data / "cases" / name)
    about = found.recording
    assert (iso_time(about.start_us, None), about.timezone) == (start, zone)
    assert found.times[-1] - found.times[0] == round(1e6 * (seconds - 1 / about.rate_hz))
    assert [code for code in found.codes if code != "no_start_time"] == []


@pytest.mark.parametrize("digits", [3, 6])
@pytest.mark.parametrize("head", ["time,x,y,z\n", ""])
def test_t6_a_comma_before_decimals_between_commas(tmp_path: Path, digits: int, head: str) -> None:
    """As Python's logging writes times; counts of whole seconds are not taken for decimals."""
    cells = [f"{t:%Y-%m-%d %H:%M:%S},{t.microsecond:06d}"[: 20 + digits] for t in moments()]
    rows = "".join(f"{cell},0.1,0.2,0.9\n" for cell in cells)
    check(read(written(tmp_path, head + rows)), None)
    counts = "".join(f"{FIRST + timedelta(seconds=row)},{100 + row},200,900\n" for row in range(60))
    found = read(written(tmp_path, "time,x,y,z\n" + counts), unit="mg")
    assert found.recording.rate_hz == 1.0


def test_time_format_holds_for_study_and_verify(tmp_path: Path) -> None:
    """What -R time_format says is in the report, and in study.toml."""
    text = table([f"{moment:%d.%m.%Y - %Hh%Mm%S}.{ms(moment)}" for moment in moments()])
    form = "%d.%m.%Y - %Hh%Mm%S.%f"
    path = written(tmp_path, text)
    assert exit_code("inspect", path) == 3
    assert exit_code("inspect", path, "-R", f"time_format={form}") == 0
    (tmp_path / "a.toml").write_text(f'time-format = "{form}"\ntime-column = "time"\n')
    assert exit_code("inspect", path) == 0
    assert exit_code("inspect", path, "-R", "time_format=%Q") == 2
