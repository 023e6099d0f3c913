"""Times of the hour 24, and fractions of seconds without leading zeros, in text and in other files."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from accelcal_cli.core.written_times import written_start
from accelcal_cli.formats._stamps import HOUR_24, LOST, NO_TIME, Midnights, time_before
from accelcal_cli.formats.tables import PARQUET
from tests.formats.make_csv import read, written
from tests.formats.reading import Read, read_all

BEGUN = datetime(2024, 3, 4, 23, 59, 50, tzinfo=UTC)
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
DAY, STEP = timedelta(days=1), timedelta(milliseconds=40)
DAY_US, MINUTE_US = 86_400_000_000, 60_000_000
MIDNIGHT_US = 1_709_596_800_000_000
ROWS = 500

Stamp = Callable[[datetime], str]


def us(moment: datetime) -> int:
    return (moment - EPOCH) // timedelta(microseconds=1)


def of_day(t: datetime) -> str:
    """As browsers with `hour12: false`."""
    return f"{t.hour or 24:02}:{t:%M:%S}.{t.microsecond // 1000:03}"


def counted_late(t: datetime) -> str:
    """The date counts on only behind the hour 24."""
    return f"{t - DAY * (t.hour == 0):%Y-%m-%d} {of_day(t)}"


def ends_the_day(t: datetime) -> str:
    """Midnight alone belongs to the day before."""
    midnight = us(t) % DAY_US == 0
    return f"{t - DAY:%Y-%m-%d} 24:00:00.000" if midnight else f"{t:%Y-%m-%d %H:%M:%S.%f}"[:-3]


WRITTEN: dict[str, tuple[str, Stamp]] = {
    "ISO": ("time", lambda t: f"{t:%Y-%m-%d} {of_day(t)}"),
    "with T and an offset": ("time", lambda t: f"{t:%Y-%m-%d}T{of_day(t)}+00:00"),
    "US": ("time", lambda t: f'"{t.month}/{t.day}/{t.year}, {of_day(t)}"'),
    "German": ("time", lambda t: f"{t:%d.%m.%Y} {of_day(t)}"),
    "in two columns": ("date,time", lambda t: f"{t:%Y-%m-%d},{of_day(t)}"),
    "in two columns, US": ("date,time", lambda t: f"{t.month}/{t.day}/{t.year},{of_day(t)}"),
    "a date that counts late": ("time", counted_late),
    "midnight ends the day": ("time", ends_the_day),
}


def in_text(folder: Path, names: str, stamp: Stamp, first: datetime, samples: int, **options: object) -> Read:
    rows = [f"{stamp(first + row * STEP)},0.1,0.{row % 10},0.9" for row in range(ROWS)]
    return read(written(folder, "\n".join([f"{names},x,y,z", *rows, ""])), samples, **options)


@pytest.mark.parametrize("form", WRITTEN)
@pytest.mark.parametrize("seconds", [-20, 0, 9, 9.96, 10, 10.04])
def test_every_row_around_midnight_has_its_own_time(tmp_path: Path, form: str, seconds: float) -> None:
    names, stamp = WRITTEN[form]
    first = BEGUN + timedelta(seconds=seconds)
    options = {"date_format": "mdy" if "US" in form else "dmy"} if form not in ("ISO",) else {}
    found = in_text(tmp_path, names, stamp, first, 1000, **options)
    if form == "a date that counts late" and seconds >= 10:
        first -= DAY  # nothing tells it from a browser's date
    assert found.times.tolist() == [us(first + row * STEP) for row in range(ROWS)]
    assert found.codes == []
    assert in_text(tmp_path, names, stamp, BEGUN, 7, **options).times.tolist()[0] == us(BEGUN)


def test_a_time_of_day_alone_continues_behind_midnight(tmp_path: Path) -> None:
    found = in_text(tmp_path, "time", of_day, BEGUN, 1000)
    assert np.diff(found.times).tolist() == [40_000] * (ROWS - 1)


def test_whole_seconds_of_the_hour_24_are_spread(tmp_path: Path) -> None:
    found = in_text(tmp_path, "time", lambda t: f"{t:%Y-%m-%d} {of_day(t)[:8]}", BEGUN, 64)
    assert found.times.tolist() == [us(BEGUN + row * STEP) for row in range(ROWS)]


def test_texts_of_a_parquet_file_have_the_same_times(tmp_path: Path) -> None:
    for form in ("ISO", "midnight ends the day", "a date that counts late"):
        cells = [WRITTEN[form][1](BEGUN + row * STEP) for row in range(ROWS)]
        axes = {name: np.full(ROWS, value) for name, value in (("x", 0.1), ("y", 0.2), ("z", 0.9))}
        pq.write_table(pa.table({"time": cells, **axes}), tmp_path / "a.parquet")
        for samples in (9, 1000):
            found = read_all(tmp_path / "a.parquet", PARQUET, samples)
            assert found.times.tolist() == [us(BEGUN + row * STEP) for row in range(ROWS)]


def test_the_last_row_of_the_hour_24_ends_the_recording(tmp_path: Path) -> None:
    cells = [f"2024-03-04 {of_day(BEGUN + row * STEP)},0.1,0.2,0.9" for row in range(251)]
    path = written(tmp_path, "\n".join(["time,x,y,z", *cells, ""]))
    found = read(path)
    assert (found.times[-1], found.recording.duration_s) == (MIDNIGHT_US, 10.04)


@pytest.mark.parametrize("before_us", [NO_TIME, LOST, MIDNIGHT_US - 40_000, MIDNIGHT_US + 30_000])
def test_the_hour_24_is_that_of_its_date_unless_times_would_go_back(before_us: int) -> None:
    late = np.array([0, 40_000, 20_000]) + MIDNIGHT_US + HOUR_24
    found = Midnights().settled(np.append(before_us, late))
    assert found[1:].tolist() == [MIDNIGHT_US, MIDNIGHT_US + 40_000, MIDNIGHT_US + 20_000]
    next_day = Midnights().settled(np.append(MIDNIGHT_US + DAY_US - 40_000, late))
    assert next_day[1:].tolist() == (found[1:] + DAY_US).tolist()


@pytest.mark.parametrize(
    ("after_us", "ends"),
    [
        ([], True),
        ([40_000 + HOUR_24], False),
        ([40_000], False),
        ([DAY_US + 40_000], True),
        ([40_000 + HOUR_24, 3600 * 1_000_000], False),
        ([40_000 + HOUR_24, DAY_US + 80_000], True),
    ],
)
def test_rows_of_the_hour_24_at_the_beginning(after_us: list[int], ends: bool) -> None:
    head = MIDNIGHT_US + np.array([HOUR_24, *after_us])
    first = Midnights(time_before(head)).settled(head)[0]
    assert first == MIDNIGHT_US + DAY_US * ends


def test_a_header_that_begins_in_the_hour_24() -> None:
    seconds = {text: written_start(f"2024-03-05 {text}") for text in ("24:00:00", "24:00:01", "24:59:59")}
    assert [None if start is None else start.start_us - MIDNIGHT_US for start in seconds.values()] == [
        *(DAY_US, 1_000_000, 3_599_000_000)
    ]
    assert written_start("2024-03-05 25:00:00") is None


UNPADDED: dict[str, tuple[str, Callable[[datetime, str], str]]] = {
    "point": ("time", lambda t, part: f"{t:%Y-%m-%d %H:%M:%S}.{part}"),
    "colon": ("time", lambda t, part: f"{t:%Y-%m-%d %H:%M:%S}:{part}"),
    "zoned": ("time", lambda t, part: f"{t:%Y-%m-%dT%H:%M:%S}.{part}Z"),
    "US": ("time", lambda t, part: f"{t.month}/{t.day}/{t.year} {t:%H:%M:%S}.{part}"),
    "AM or PM": ("time", lambda t, part: f"{t.month}/{t.day}/{t.year} {t:%I:%M:%S}.{part} {t:%p}"),
    "two columns": ("date,time", lambda t, part: f"{t:%Y-%m-%d},{t:%H:%M:%S}.{part}"),
}


@pytest.mark.parametrize("form", UNPADDED)
@pytest.mark.parametrize("unit_us", [1, 1000, 10_000])
def test_fractions_of_seconds_without_leading_zeros(tmp_path: Path, form: str, unit_us: int) -> None:
    names, stamp = UNPADDED[form]
    options = {"date_format": "mdy"} if form in ("US", "AM or PM") else {}

    def numbered(t: datetime) -> str:
        return stamp(t, str(t.microsecond // unit_us))

    found = in_text(tmp_path, names, numbered, BEGUN, 1000, **options)
    assert found.times.tolist() == [us(BEGUN + row * STEP) for row in range(ROWS)]


@pytest.mark.parametrize("form", ["point", "zoned", "two columns"])
def test_decimals_without_zeros_at_their_end_stay_decimals(tmp_path: Path, form: str) -> None:
    names, stamp = UNPADDED[form]

    def trimmed(t: datetime) -> str:
        return stamp(t, f"{t.microsecond:06}".rstrip("0") or "0")

    found = in_text(tmp_path, names, trimmed, BEGUN, 1000)
    assert found.times.tolist() == [us(BEGUN + row * STEP) for row in range(ROWS)]
