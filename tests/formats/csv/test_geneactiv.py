"""GENEActiv: 100 lines of key and value, then rows whose seconds have a colon before their decimals."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from tests.formats.make_csv import GRID, START_US, read, written

TOLD = {
    1: "Device Type,GENEActiv           ",
    2: "Device Model,1.1",
    3: "Device Unique Serial Code,012967",
    4: "Device Firmware Version,Ver2.03 date14Aug11",
    5: "Calibration Date,2011-10-13 17:34:27:000",
    11: "Measurement Frequency,50 Hz",
    12: "Start Time,2024-03-04 00:00:00:000",
    15: "Time Zone,GMT +01:00",
    21: "Subject Code,17",
    51: "Sensor type,MEMS accelerometer x-axis",
    52: "Range,-8 to 8             ",
    53: "Resolution,0.0039",
    54: "Units,g",
    56: "Sensor type,MEMS accelerometer y-axis",
    57: "Range,-8 to 8",
    66: "Sensor type,Lux Photodiode 400nm - 1100nm",
    67: "Range,0 to 5000",
    69: "Units,lux",
}
HEADER = "".join(TOLD.get(number, "") + "\n" for number in range(1, 101))
VALUES = [(0.0166, -0.5 + 0.0039 * row, 0.8301) for row in range(12)]
ROWS = "".join(
    f"2024-03-04 00:00:00:{20 * row:03d},{x:.4f},{y:.4f},{z:.4f},{row},0,{20.5 + row / 10:.1f}\n"
    for row, (x, y, z) in enumerate(VALUES)
)
COUNTS = np.rint(np.array([[round(value, 4) for value in row] for row in VALUES]) * GRID)

SAMPLE = (HEADER + ROWS).encode()


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_header_and_rows(tmp_path: Path, end: str) -> None:
    found = read(written(tmp_path, (HEADER + ROWS).replace("\n", end)))
    assert np.array_equal(found.counts, COUNTS)
    assert (found.times - START_US).tolist() == [row * 20_000 for row in range(12)]
    assert found.temperature is not None
    assert found.temperature.tolist() == [20_500 + 100 * row for row in range(12)]
    about = found.recording
    assert (about.rate_hz, about.range_g, about.timezone) == (50.0, 8.0, "+01:00")
    device = about.device
    assert (device.model, device.serial) == ("GENEActiv 1.1", "012967")
    assert device.firmware == "Ver2.03 date14Aug11"
    assert found.problems == []


def test_the_headers_zone_counts_more_than_the_users(tmp_path: Path) -> None:
    path = written(tmp_path, SAMPLE)
    assert read(path, timezone="Europe/Berlin").recording.timezone == "+01:00"
    assert read(path, timezone="Asia/Tokyo", force_timezone=True).recording.timezone == "Asia/Tokyo"
    with pytest.raises(UsageError, match=r"\+01:00, which is not Asia/Tokyo"):
        read(path, timezone="Asia/Tokyo")


@pytest.mark.parametrize(
    ("zone", "read_as"),
    [("GMT -05:30", "-05:30"), ("GMT +00", "+00:00"), ("GMT +99:00", None), ("local", None), ("", None)],
)
def test_zones(tmp_path: Path, zone: str, read_as: str | None) -> None:
    found = read(written(tmp_path, (HEADER + ROWS).replace("GMT +01:00", zone)))
    assert found.recording.timezone == read_as


def test_a_shorter_header_and_names_of_columns(tmp_path: Path) -> None:
    short = "".join(line + "\n" for line in HEADER.splitlines() if line)
    names = "timestamp,x,y,z,light,button,temperature\n"
    for header in (short, HEADER + names, short + names):
        found = read(written(tmp_path, header + ROWS))
        assert np.array_equal(found.counts, COUNTS)
        assert found.temperature is not None


def test_fewer_columns_with_names(tmp_path: Path) -> None:
    rows = "".join(f"2024-03-04 00:00:00:{20 * row:03d},20.5,1.0,0.5,0.25\n" for row in range(12))
    found = read(written(tmp_path, HEADER + "time,temperature,z,y,x\n" + rows))
    assert found.g.tolist() == [[0.25, 0.5, 1.0]] * 12
    assert found.temperature is not None


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_other_delimiters_with_decimal_commas(tmp_path: Path, delimiter: str) -> None:
    rows = ROWS.replace(",", delimiter).replace(".", ",")
    found = read(written(tmp_path, HEADER.replace(",", delimiter) + rows))
    assert np.array_equal(found.counts, COUNTS)
    assert found.recording.device.serial == "012967"


def test_the_nominal_rate_is_the_headers(tmp_path: Path) -> None:
    header = HEADER.replace("50 Hz", "85.7 Hz")
    times_ms = [round(row * 10_000 / 857) for row in range(500)]
    rows = "".join(f"2024-03-04 00:00:{ms // 1000:02d}:{ms % 1000:03d},0,0,1,0,0,20\n" for ms in times_ms)
    found = read(written(tmp_path, header + rows))
    assert found.recording.rate_hz == 85.7
    assert (found.times - START_US).tolist() == [1000 * ms for ms in times_ms]


def test_summaries_per_epoch_are_refused(tmp_path: Path) -> None:
    rows = "".join(f"2024-03-04 00:{row:02d}:00:000,0,0,1,0,0,20,0,0,0,0,0\n" for row in range(20))
    with pytest.raises(UnreadableError, match="means and sums over epochs, not raw acceleration"):
        read(written(tmp_path, HEADER + rows))


def test_epochs_of_raw_columns_contradict_the_rate(tmp_path: Path) -> None:
    rows = "".join(f"2024-03-04 00:{row:02d}:00:000,0,0,1,0,0,20\n" for row in range(20))
    with pytest.raises(UnreadableError, match=r"header says 50 Hz, the times of its rows say 0\.0166667 Hz"):
        read(written(tmp_path, HEADER + rows))


def test_a_gap_stays_a_gap(tmp_path: Path) -> None:
    lines = ROWS.splitlines(keepends=True)
    found = read(written(tmp_path, HEADER + "".join(lines[:4] + lines[9:])))
    assert (found.breaks, found.codes) == ([4], ["clock_gap"])


def test_a_damaged_row_is_named_by_its_line(tmp_path: Path) -> None:
    times = [f"2024-03-04 00:00:{row // 50:02d}:{row % 50 * 20:03d}" for row in range(252)]
    times[240] = "2024-03-04 00:00:00:2x0"
    text = HEADER + "".join(f"{time},0,0,1,0,0,20\n" for time in times)
    (problem,) = read(written(tmp_path, text)).problems
    assert problem.place == "from line 341 on"
    assert re.search(r"1 row left out: column 0 holds '2024-03-04 00:00:00[:.]2x0'", problem.message)
