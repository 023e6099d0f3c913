"""Times as people write them: T6 and T8 of the list of defects, and files that show them."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from email.utils import format_datetime
from pathlib import Path

import pytest

from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.written_times import (
    is_date,
    is_time,
    month_of,
    order_in,
    read_date,
    stated_zone,
    written_start,
)
from tests.cli.run import exit_code
from tests.formats.make_csv import Read, read, written

FIRST = datetime(2024, 3, 14, 10, 41, 40)
"""When the recordings of these tests begin: 400 rows at 10 Hz, of which some lie behind the next minute."""

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


def _us(moment: datetime) -> int:
    return (moment.replace(tzinfo=moment.tzinfo or UTC) - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(
        microseconds=1
    )


def _table(cells: list[str], delimiter: str = ";") -> str:
    rows = "".join(f"{cell}{delimiter}0.1{delimiter}0.2{delimiter}0.9\n" for cell in cells)
    return delimiter.join(("time", "x", "y", "z")) + "\n" + rows


def _moments(first: datetime = FIRST) -> list[datetime]:
    return [first + row * STEP for row in range(ROWS)]


def _ms(moment: datetime) -> str:
    return f"{moment.microsecond // 1000:03d}"


def _check(found: Read, zone: str | None, first: datetime = FIRST) -> None:
    assert found.times.tolist() == [_us(moment) for moment in _moments(first)]
    assert (found.recording.rate_hz, found.recording.timezone, found.codes) == (10.0, zone, [])


FORMS = {
    "ISO with T": lambda t: f"{t:%Y-%m-%dT%H:%M:%S}.{_ms(t)}",
    "ISO with a comma": lambda t: f"{t:%Y-%m-%d %H:%M:%S},{_ms(t)}",
    "ISO basic": lambda t: f"{t:%Y%m%dT%H%M%S}.{_ms(t)}",
    "ISO basic with a comma": lambda t: f"{t:%Y%m%dT%H%M%S},{_ms(t)}",
    "ISO week": lambda t: f"{t:%G-W%V-%uT%H:%M:%S}.{_ms(t)}",
    "ISO basic week": lambda t: f"{t:%GW%V%uT%H%M%S}.{_ms(t)}",
    "ISO ordinal": lambda t: f"{t:%Y-%jT%H:%M:%S}.{_ms(t)}",
    "an underscore between": lambda t: f"{t:%Y-%m-%d_%H:%M:%S}.{_ms(t)}",
    "an underscore, no marks": lambda t: f"{t:%Y%m%d_%H%M%S}.{_ms(t)}",
    "a blank, no marks": lambda t: f"{t:%Y%m%d %H%M%S}.{_ms(t)}",
    "digits alone": lambda t: f"{t:%Y%m%d%H%M%S}.{_ms(t)}",
    "digits alone, with milliseconds": lambda t: f"{t:%Y%m%d%H%M%S}{_ms(t)}",
    "MATLAB": lambda t: f"{t:%d-%b-%Y %H:%M:%S}.{_ms(t)}",
    "MATLAB, two digits of the year": lambda t: f"{t:%d-%b-%y %H:%M:%S}.{_ms(t)}",
    "SAS": lambda t: f"{t:%d%b%Y}".upper() + f":{t:%H:%M:%S}.{_ms(t)}",
    "American": lambda t: f"{t:%b %d, %Y %H:%M:%S}.{_ms(t)}",
    "American, 12 hours": lambda t: f"{t:%B %d, %Y, %I:%M:%S}.{_ms(t)} {t:%p}",
    "browser, 12 hours": lambda t: f"{t.month}/{t.day}/{t.year}, {t:%I:%M:%S}.{_ms(t)} {t:%p}",
    "browser, German": lambda t: f"{t.day}.{t.month}.{t.year}, {t:%H:%M:%S}.{_ms(t)}",
    "time first": lambda t: f"{t:%H:%M:%S}.{_ms(t)} {t:%Y-%m-%d}",
    "time first, day first": lambda t: f"{t:%H:%M:%S}.{_ms(t)} {t:%d/%m/%Y}",
    "time first, named month": lambda t: f"{t:%H:%M:%S}.{_ms(t)} {t:%d %B %Y}",
    "German": lambda t: f"{t.day}. März {t:%Y um %H:%M:%S}.{_ms(t)}",
    "French": lambda t: f"{t.day} mars {t:%Y à %H:%M:%S}.{_ms(t)}",
    "Spanish": lambda t: f"{t.day} de marzo de {t:%Y, %H:%M:%S}.{_ms(t)}",
    "Korean": lambda t: f"{t:%Y. %m. %d. %H:%M:%S}.{_ms(t)}",
    "points between hours and minutes": lambda t: f"{t:%Y-%m-%dT%H.%M.%S}.{_ms(t)}",
    "as cameras write it": lambda t: f"{t:%Y:%m:%d %H:%M:%S}.{_ms(t)}",
    "Buddhist years": lambda t: f"{t.year + 543}{t:-%m-%d %H:%M:%S}.{_ms(t)}",
    "a named weekday": lambda t: f"{t:%a %b %d %H:%M:%S}.{_ms(t)} {t:%Y}",
}


@pytest.mark.parametrize("form", FORMS)
def test_t6_ways_to_write_a_clocks_time(tmp_path: Path, form: str) -> None:
    found = read(written(tmp_path, _table([FORMS[form](moment) for moment in _moments()])))
    _check(found, None)


@pytest.mark.parametrize("form", FORMS)
def test_t6_ways_to_write_a_time_between_tabs_in_chunks_of_any_size(tmp_path: Path, form: str) -> None:
    first = datetime(2024, 2, 28, 23, 59, 50, 300_000)
    cells = [FORMS[form](moment) for moment in _moments(first)]
    if form in ("German", "French", "Spanish"):
        cells = [cell.replace("März", "Februar").replace("marzo", "febrero") for cell in cells]
        cells = [cell.replace("mars", "févr.") for cell in cells]
    _check(read(written(tmp_path, _table(cells, "\t")), 37), None, first)


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
    cells = [pattern.format(t=moment, ms=_ms(moment)) for moment in _moments()]
    found = read(written(tmp_path, _table(cells)))
    _check(found, "UTC", FIRST - timedelta(hours=hours))
    assert found.recording.has_offsets == (hours != 0)


def test_t6_mails_times_have_whole_seconds(tmp_path: Path) -> None:
    moments = [
        FIRST.replace(tzinfo=timezone(timedelta(hours=-3))) + timedelta(seconds=row) for row in range(90)
    ]
    found = read(written(tmp_path, _table([format_datetime(moment) for moment in moments])))
    assert found.times.tolist() == [_us(moment) for moment in moments]
    assert found.recording.timezone == "UTC"


def test_t6_offsets_change_within_a_file(tmp_path: Path) -> None:
    """A computer's log in London at the end of summer time: moments go on evenly."""
    moments = [datetime(2024, 10, 27, 0, 59, 30, tzinfo=UTC) + row * STEP for row in range(ROWS)]
    summer, winter = timezone(timedelta(hours=1)), UTC
    change = datetime(2024, 10, 27, 1, tzinfo=UTC)
    local = [moment.astimezone(summer if moment < change else winter) for moment in moments]
    cells = [f"{moment:%Y-%m-%d %H:%M:%S}.{_ms(moment)}{moment:%z} [Europe/London]" for moment in local]
    assert read(written(tmp_path, _table(cells))).times.tolist() == [_us(moment) for moment in moments]


@pytest.mark.parametrize("name", ["CST", "IST", "BST"])
def test_t6_a_zones_name_that_stands_for_several_is_not_guessed(tmp_path: Path, name: str) -> None:
    cells = [f"{moment:%Y-%m-%d %H:%M:%S}.{_ms(moment)} {name}" for moment in _moments()]
    found = read(written(tmp_path, _table(cells)))
    _check(found, None)
    assert f"{name} is " in " ".join(found.recording.notes)
    assert (
        read(written(tmp_path, _table(cells)), timezone="Asia/Kolkata").recording.timezone == "Asia/Kolkata"
    )


def test_t6_a_region_behind_the_time_is_the_zone_of_the_clock(tmp_path: Path) -> None:
    cells = [f"{moment:%Y-%m-%d %H:%M:%S}.{_ms(moment)} [Europe/Berlin]" for moment in _moments()]
    _check(read(written(tmp_path, _table(cells))), "Europe/Berlin")


@pytest.mark.parametrize("pattern", ["%H%M%S.{ms}", "%H:%M:%S.{ms}"])
def test_t6_digits_of_a_time_of_day_are_no_seconds(tmp_path: Path, pattern: str) -> None:
    cells = [moment.strftime(pattern).format(ms=_ms(moment)) for moment in _moments()]
    found = read(written(tmp_path, _table(cells)))
    assert (found.times - found.times[0]).tolist() == [row * 100_000 for row in range(ROWS)]
    assert found.codes == ["no_start_time"]
    assert "times of day without a date" in " ".join(found.recording.notes)


@pytest.mark.parametrize("first", [104_130.0, 94_158.3, 3_599.9])
def test_t6_seconds_that_look_like_a_time_of_day_are_seconds(tmp_path: Path, first: float) -> None:
    found = read(written(tmp_path, _table([f"{first + row / 10:.1f}" for row in range(ROWS)])))
    assert (found.times - found.times[0]).tolist() == [row * 100_000 for row in range(ROWS)]


@pytest.mark.parametrize("date", ["%Y%m%d", "%d-%b-%Y", "%d.%m.%Y"])
@pytest.mark.parametrize("clock", ["%H%M%S", "%H:%M:%S"])
def test_t6_a_date_in_a_column_of_its_own(tmp_path: Path, date: str, clock: str) -> None:
    rows = "".join(f"{t.strftime(date)};{t.strftime(clock)}.{_ms(t)};0.1;0.2;0.9\n" for t in _moments())
    _check(read(written(tmp_path, f"date;time;x;y;z\n{rows}")), None)


def test_t6_a_time_that_is_not_read_is_shown_with_its_line_and_a_command(tmp_path: Path) -> None:
    cells = [f"{moment:%d|%m} {_ms(moment)}" for moment in _moments()]
    with pytest.raises(UnreadableError) as caught:
        read(written(tmp_path, _table(cells)), time_column="time")
    assert caught.value.line == 2
    assert "'14|03 000'" in caught.value.message and "RFC 2822" in caught.value.message
    assert "accelcal calibrate a.csv -R time_format" in str(caught.value.hint)


def test_t6_an_odd_time_among_others_is_named_by_its_line(tmp_path: Path) -> None:
    cells = [FORMS["MATLAB"](moment) for moment in _moments()]
    cells[300] = "14-Foo-2024 10:42:10.000"
    found = read(written(tmp_path, _table(cells)), 50)
    assert found.problems[0].told == (
        "1 row left out: column 0 holds '14-Foo-2024 10:42:10.000', which is not a time, from line 302 on"
    )
    cells[300] = "30-Feb-2024 10:42:10.000"
    assert read(written(tmp_path, _table(cells)), 50).codes == ["impossible_time"]


ASKED = {
    "%d|%m|%Y %H-%M-%S.%f": None,
    "%y%j:%H%M%S,%f": None,
    "%I.%M.%S.%f%p on %d.%m.%Y": None,
    "%d %B %Y %T.%f": None,
    "%F %T.%f %z": "UTC",
}


@pytest.mark.parametrize("form", ASKED)
def test_t6_time_format_reads_any_other_form(tmp_path: Path, form: str) -> None:
    cells = [moment.replace(tzinfo=UTC).strftime(form.replace("%f", _ms(moment))) for moment in _moments()]
    found = read(written(tmp_path, _table(cells)), 55, time_format=form, time_column="time")
    _check(found, ASKED[form])


@pytest.mark.parametrize("form", ["%d.%m.%Y", "%Q %H", "%H:%M %H", "hours"])
def test_t6_a_time_format_that_makes_no_sense_is_said(tmp_path: Path, form: str) -> None:
    with pytest.raises(UsageError, match=r"-R time_format=.* is not understood"):
        read(written(tmp_path, _table([FORMS["MATLAB"](moment) for moment in _moments()])), time_format=form)


HEADER = """- Data File Created By ActiGraph GT3X+ ActiLife v6.13.3 Firmware v3.2.1 date format {} at 30 Hz \
Filter Normal -----
Serial Number: NEO1X00000000
Start Time 10:00:00
Start Date {}
Epoch Period (hh:mm:ss) 00:00:00
Download Time 16:30:15
Download Date {}
Current Memory Address: 0
Current Battery Voltage: 4.08     Mode = 12
--------------------------------------------------
Accelerometer X,Accelerometer Y,Accelerometer Z
"""


@pytest.mark.parametrize(
    ("form", "day"),
    [
        ("yyyy/M/d", "2024/3/4"),
        ("dd-MMM-yy", "04-Mar-24"),
        ("dd MMM yyyy", "04 Mar 2024"),
        ("yyyy. MM. dd.", "2024. 03. 04."),
        ("M/d/yyyy", "3/4/2024"),
        ("d.M.yyyy", "4.3.2024"),
        ("d.M.yy", "4.3.24"),
        ("dd/MM/yyyy", "04/03/2024"),
        ("d MMMM yyyy", "4 März 2024"),
        ("dd-MMM-yy", "04-mars-24"),
        ("d/M/yyyy", "4/3/2567"),
        ("yy/MM/dd", "24/03/04"),
        ("yyyyMMdd", "20240304"),
    ],
)
def test_t8_actigraphs_dates(tmp_path: Path, form: str, day: str) -> None:
    text = HEADER.format(form, day, day) + "".join(
        f"{0.1 * (row % 3):.3f},0.200,0.900\n" for row in range(90)
    )
    found = read(written(tmp_path, text))
    assert found.recording.start_us == _us(datetime(2024, 3, 4, 10))
    assert (found.recording.rate_hz, found.codes) == (30.0, [])


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
        assert start is not None and start.start_us == _us(datetime(2017, 1, 1))
    assert written_start("2016-12-31T23:59:61Z") is None


def test_dates_and_their_patterns() -> None:
    assert read_date("04-Mar-24", "ymd") == datetime(2004, 3, 24).date()
    assert read_date("04-Mar-24") == datetime(2024, 3, 4).date()
    assert read_date("04/03/2024") is None
    assert (order_in("dddd, d MMMM yyyy"), order_in("gg yyyy. MM. dd."), order_in("HH")) == (
        "dmy",
        "ymd",
        None,
    )


@pytest.mark.parametrize("year", [1, 1601, 1980, 2036, 2262, 9999])
def test_h17_any_year_of_the_calendar_is_read(tmp_path: Path, year: int) -> None:
    first = datetime(year, 3, 4)
    cells = [f"{moment.isoformat(' ', 'milliseconds')}" for moment in _moments(first)]
    _check(read(written(tmp_path, _table(cells))), None, first)


@pytest.mark.parametrize("text", ["0001-01-01 00:00:00", "9999-12-31T23:59:59", "2024-03-04 00:00:00"])
def test_h17_times_that_stand_still_are_shown(tmp_path: Path, text: str) -> None:
    with pytest.raises(UnreadableError, match=f"rows: {text[:10]}T{text[11:]}.* in each of the first 90"):
        read(written(tmp_path, _table([text] * 90)))


def test_h17_a_leap_second_in_the_times(tmp_path: Path) -> None:
    """Rows of the second 60 are those of the next minute's first, which comes again."""
    minutes = [("2016-12-31 23:59", second) for second in range(50, 61)]
    minutes += [("2017-01-01 00:00", second) for second in range(60)]
    cells = [f"{minute}:{second:02d}.{tenth}" for minute, second in minutes for tenth in range(10)]
    found = read(written(tmp_path, _table(cells)), 33)
    assert len(found.times) == 710 and found.codes == ["clock_back"]
    assert found.times[100] == _us(datetime(2017, 1, 1))


@pytest.mark.parametrize(
    ("name", "zone"),
    [
        ("Timestamp UTC", "UTC"),
        ("time (UTC)", "UTC"),
        ("utc_time", "UTC"),
        ("TimestampUTC", "UTC"),
        ("time [GMT+1]", "+01:00"),
        ("timestamp (+0530)", "+05:30"),
        ("time (Europe/Berlin)", "Europe/Berlin"),
        ("timestamp", None),
        ("local time", None),
    ],
)
@pytest.mark.parametrize("form", ["ISO with T", "MATLAB"])
def test_t11_the_zone_in_the_name_of_the_column(
    tmp_path: Path, name: str, zone: str | None, form: str
) -> None:
    text = _table([FORMS[form](moment) for moment in _moments()]).replace("time;", f"{name};", 1)
    _check(read(written(tmp_path, text)), zone)


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
    cells = [f"{t:%Y-%m-%d %H:%M:%S},{t.microsecond:06d}"[: 20 + digits] for t in _moments()]
    rows = "".join(f"{cell},0.1,0.2,0.9\n" for cell in cells)
    _check(read(written(tmp_path, head + rows)), None)
    counts = "".join(f"{FIRST + timedelta(seconds=row)},{100 + row},200,900\n" for row in range(60))
    found = read(written(tmp_path, "time,x,y,z\n" + counts), unit="mg")
    assert found.recording.rate_hz == 1.0


def test_time_format_holds_for_study_and_verify(tmp_path: Path) -> None:
    """What -R time_format says is in the report, and in study.toml."""
    text = _table([f"{moment:%d.%m.%Y - %Hh%Mm%S}.{_ms(moment)}" for moment in _moments()])
    form = "%d.%m.%Y - %Hh%Mm%S.%f"
    path = written(tmp_path, text)
    assert exit_code("inspect", path) == 3
    assert exit_code("inspect", path, "-R", f"time_format={form}") == 0
    (tmp_path / "a.toml").write_text(f'time-format = "{form}"\ntime-column = "time"\n')
    assert exit_code("inspect", path) == 0
    assert exit_code("inspect", path, "-R", "time_format=%Q") == 2
