"""ActiGraph's raw CSV: its header, its dates, and the rows that it wrote while it slept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from accelcal_cli.core.errors import UnreadableError, UsageError
from tests.formats.make_csv import GRID, read, written

HEADER = """\
------------ Data File Created By ActiGraph GT3X+ ActiLife v6.13.3 Firmware v2.5.0 date format M/d/yyyy \
at 30 Hz  Filter Normal -----------
Serial Number: NEO1D00000017
Start Time 10:54:00
Start Date 6/27/2012
Epoch Period (hh:mm:ss) 00:00:00
Download Time 16:25:52
Download Date 6/28/2012
Current Memory Address: 0
Current Battery Voltage: 4.22     Mode = 12
--------------------------------------------------
"""
NAMES = "Accelerometer X,Accelerometer Y,Accelerometer Z\n"
VALUES = [(0.003, -0.001 * row, 1.0 + 0.001 * row) for row in range(12)]
ROWS = "".join(f"{x:.3f},{y:.3f},{z:.3f}\n" for x, y, z in VALUES)
COUNTS = np.rint(np.array(VALUES) * GRID)
START_US = 1_340_794_440_000_000
"""2012-06-27 10:54:00, by `date -u -d '2012-06-27 10:54:00' +%s`."""

SAMPLE = (HEADER + NAMES + ROWS).encode()


def stamped(form: str, seconds: str = "{:06.3f}") -> str:
    """Return the rows with a time before each, a tenth of a second apart."""
    lines = ROWS.splitlines()
    return "".join(f"{form}{seconds.format(row / 10)},{line}\n" for row, line in enumerate(lines))


@pytest.mark.parametrize("names", [NAMES, "", "\n", "\n" + NAMES])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_header_tells_rate_start_unit_and_device(tmp_path: Path, names: str, end: str) -> None:
    found = read(written(tmp_path, (HEADER + names + ROWS).replace("\n", end)))
    assert np.array_equal(found.counts, COUNTS)
    assert found.times.tolist() == [START_US + (row * 1_000_000 + 15) // 30 for row in range(12)]
    about = found.recording
    assert (about.rate_hz, about.start_us, about.timezone) == (30.0, START_US, None)
    device = about.device
    assert (device.model, device.serial, device.firmware) == ("ActiGraph GT3X+", "NEO1D00000017", "2.5.0")
    assert about.notes[0] == "an export of ActiGraph"
    assert (found.problems, found.breaks) == ([], [])
    assert not any("not used" in note for note in about.notes)


@pytest.mark.parametrize(
    ("pattern", "day"),
    [
        ("dd/MM/yyyy", "05/06/2012"),
        ("d.M.yyyy", "5.6.2012"),
        ("d. M. yyyy", "5. 6. 2012"),
        ("M/d/yyyy", "6/5/2012"),
        ("yyyy-MM-dd", "2012-06-05"),
        ("M/d/yy", "6/5/12"),
        ("dd-MM-yyyy", "05-06-2012,,,"),
        ("dd/MMM/yyyy", "15-06-2012"),
        ("yyyy/M/d", "2012/6/5"),
        ("dd-MMM-yy", "05-Jun-12"),
        ("dd MMM yyyy", "05 Jun 2012"),
        ("yyyy. MM. dd.", "2012. 06. 05."),
        ("d.M.yy", "5.6.12"),
        ("d MMMM yyyy", "5 Juni 2012"),
        ("dd-MMM-yy", "05-juin-12"),
        ("d/M/yyyy", "5/6/2555"),
        ("yy/MM/dd", "12/06/05"),
        ("yyyyMMdd", "20120605"),
    ],
)
def test_t8_date_format_of_the_header_is_used(tmp_path: Path, pattern: str, day: str) -> None:
    header = HEADER.replace("M/d/yyyy", pattern).replace("Start Date 6/27/2012", f"Start Date {day}")
    days = 12 if day.startswith("15") else 22
    assert read(written(tmp_path, header + ROWS)).recording.start_us == START_US - days * 86_400_000_000


@pytest.mark.parametrize("clock", ["10:54:00 AM", "22:54:00", "10:54:00 PM"])
def test_both_ways_to_write_the_time_of_day(tmp_path: Path, clock: str) -> None:
    path = written(tmp_path, HEADER.replace("10:54:00", clock) + ROWS)
    late = 0 if "AM" in clock else 12 * 3_600_000_000
    assert read(path).recording.start_us == START_US + late


def test_a_start_that_can_be_read_in_two_ways_is_asked_about(tmp_path: Path) -> None:
    header = HEADER.replace("date format M/d/yyyy ", "").replace("6/27/2012", "6/5/2012")
    path = written(tmp_path, header + ROWS)
    told = r"line 4: the date '6/5/2012' can be read as dmy or mdy; say which with -R date_format=dmy or"
    with pytest.raises(UnreadableError, match=told):
        read(path)
    month = read(path, date_format="mdy").recording.start_us
    assert read(path, date_format="dmy").recording.start_us == month - 30 * 86_400_000_000


def test_a_start_that_contradicts_its_format_is_asked_about(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER.replace("M/d/yyyy", "d/M/yyyy") + ROWS)
    with pytest.raises(UnreadableError, match="can only be read as mdy; give -R date_format=mdy"):
        read(path)
    assert read(path, date_format="mdy").recording.start_us == START_US


@pytest.mark.parametrize(
    ("form", "pattern"),
    [
        ("6/27/2012 10:54:", "M/d/yyyy"),
        ("06/27/2012 10:54:", "M/d/yyyy"),
        ("27.6.2012 10:54:", "d.M.yyyy"),
        ("2012-06-27T10:54:", "M/d/yyyy"),
    ],
)
def test_stamps_of_rows(tmp_path: Path, form: str, pattern: str) -> None:
    day = "27.6.2012" if pattern[0] == "d" else "6/27/2012"
    header = HEADER.replace("M/d/yyyy at 30 Hz", f"{pattern} at 10 Hz").replace("6/27/2012", day)
    found = read(written(tmp_path, header + "Timestamp," + NAMES + stamped(form)))
    assert (found.times - START_US).tolist() == [row * 100_000 for row in range(12)]
    assert np.array_equal(found.counts, COUNTS)
    assert found.recording.rate_hz == 10.0


def test_rows_are_dated_as_the_day_of_the_start_shows(tmp_path: Path) -> None:
    header = HEADER.replace("6/27/2012", "2012-06-05").replace("M/d/yyyy at 30", "yyyy-MM-dd at 10")
    for form in ("5/6/2012 10:54:", "6/5/2012 10:54:"):
        found = read(written(tmp_path, header + "Timestamp," + NAMES + stamped(form)))
        assert found.recording.start_us == START_US - 22 * 86_400_000_000


def test_rows_of_a_later_day_are_dated_as_the_header_says(tmp_path: Path) -> None:
    for order, form in (("M/d/yyyy", "6/9/2012 10:54:"), ("d/M/yyyy", "9/6/2012 10:54:")):
        day = "6/5/2012" if order[0] == "M" else "5/6/2012"
        header = HEADER.replace("6/27/2012", day).replace("M/d/yyyy at 30", f"{order} at 10")
        found = read(written(tmp_path, header + "Timestamp," + NAMES + stamped(form)))
        assert found.recording.start_us == START_US - 18 * 86_400_000_000


def test_european_delimiter_and_decimals(tmp_path: Path) -> None:
    rows = stamped("27.06.2012 10:54:").replace(",", ";").replace(".", ",").replace("27,06,", "27.06.")
    header = HEADER.replace("M/d/yyyy at 30", "dd.MM.yyyy at 10").replace("6/27/2012", "27.06.2012")
    names = "Timestamp," + NAMES
    found = read(written(tmp_path, header + names.replace(",", ";") + rows))
    assert np.array_equal(found.counts, COUNTS)
    assert (found.times - START_US).tolist() == [row * 100_000 for row in range(12)]


def test_decimal_commas_between_commas_are_refused(tmp_path: Path) -> None:
    rows = ROWS.replace(".", ",")
    with pytest.raises(UnreadableError, match="if it also uses commas as decimals, export it with another"):
        read(written(tmp_path, HEADER + NAMES + rows))


def test_counts_per_epoch_are_refused(tmp_path: Path) -> None:
    header = HEADER.replace("Period (hh:mm:ss) 00:00:00", "Period (hh:mm:ss) 00:00:15")
    path = written(tmp_path, header + "Axis1,Axis2,Axis3\n" + "0,12,3\n" * 20)
    with pytest.raises(UnreadableError, match=r"counts of 15 s each, not raw acceleration; .*--unit"):
        read(path)


def test_another_unit_than_g_is_doubted(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + "12,-5,341\n" * 20)
    with pytest.raises(UnreadableError, match=r"341 g, so that its unit is in doubt; give --unit"):
        read(path)
    assert read(path, unit="counts", lsb_per_g=341.0).counts[0].tolist() == [12, -5, 341]


def test_a_rate_that_contradicts_the_header(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="made at 30 Hz, not 100"):
        read(written(tmp_path, HEADER + ROWS), rate_hz=100.0)
    path = written(tmp_path, HEADER + "Timestamp," + NAMES + stamped("6/27/2012 10:54:"))
    with pytest.raises(
        UnreadableError, match=r"header says 30 Hz, the times of its rows say 10 Hz; .*--rate 10"
    ):
        read(path)
    assert read(path, rate_hz=10.0).recording.rate_hz == 10.0


def test_without_rate_or_start_the_header_leaves_them_open(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER.replace("at 30 Hz", "").replace("Start Date 6", "Start Date ?") + ROWS)
    with pytest.raises(UnreadableError, match="--rate"):
        read(path)
    found = read(path, rate_hz=30.0)
    assert (found.recording.start_us, found.codes) == (None, ["no_start_time"])


def test_sleep_is_marked_whatever_the_blocks(tmp_path: Path) -> None:
    noise = ["0.100,0.200,0.900\n", "0.103,0.200,0.900\n"]
    lines = ["0,0,0\n"] * 3 + noise * 5 + noise[:1] * 29 + noise[::-1] + noise[1:] * 30 + noise[:1]
    lines += ["0,0,0\n"] * 40 + [",,\n"] + noise[1:] * 29 + ["\n"] + noise[:1] + ["0,0,0\n"] + noise[1:] * 31
    path = written(tmp_path, HEADER + NAMES + "".join(lines))
    whole = read(path)
    runs = [(0, 3), (45, 74), (75, 115), (145, 146), (147, 177)]
    marked = np.zeros(177, np.uint8)
    for start, stop in runs:
        marked[start:stop] = 1
    assert whole.validity.tolist() == marked.tolist()
    asleep = [problem for problem in whole.problems if problem.code == "idle_sleep"]
    assert [(item.sample, item.count) for item in asleep] == [(start, stop - start) for start, stop in runs]
    assert asleep[1].place == "from line 57 on"
    assert asleep[1].message.startswith("29 rows not measured: ")
    for chunk_samples in (1, 7, 30, 31, 100):
        assert read(path, chunk_samples).same_as(whole)


def test_real_export_without_names(real_data: Path) -> None:
    path = real_data / "vendor" / "actigraph_gt3xplus_30hz_9h.csv.gz"
    found = read(path, 100_000)
    truth = pd.read_csv(path, skiprows=10, header=None).to_numpy()
    assert np.array_equal(found.counts, np.rint(truth * GRID))
    assert found.recording.start_us == START_US
    assert found.times[-1] == START_US + ((len(truth) - 1) * 1_000_000 + 15) // 30
    zeros = ~truth.any(axis=1)
    assert found.validity[zeros].all()
    assert int(found.validity.sum()) == 100_180 + 238_590


def test_real_export_sleeps_when_the_device_says_so(real_data: Path) -> None:
    """182 200 rows of idle sleep, as ActiGraph's own reader finds in the .gt3x (pygt3x, issue 53)."""
    path = real_data / "vendor" / "gt3x_link_100hz_36min.actilife.csv.gz"
    found = read(path, 50_000)
    truth = pd.read_csv(path, skiprows=10).to_numpy()
    assert np.array_equal(found.counts, np.rint(truth * GRID))
    zeros = int((~truth.any(axis=1)).sum())
    repeated = int(found.validity.sum()) - zeros
    assert zeros == 25_200
    assert repeated == 182_200 + 100 + 1
    assert found.recording.rate_hz == 100.0
    assert found.recording.device.serial == "TAS1H30182785"


def test_verisense_has_the_same_header_and_rates_that_are_not_whole(tmp_path: Path) -> None:
    header = HEADER.replace("ActiGraph GT3X+ ActiLife", "Verisense IMU Verisense")
    found = read(written(tmp_path, header.replace("30 Hz", "26.041667 Hz") + NAMES + "0,0,1\n" * 60))
    about, device = found.recording, found.recording.device
    assert (about.rate_hz, device.model, device.serial) == (26.041667, "Verisense IMU", "NEO1D00000017")
    assert about.notes[0] == "an export of Verisense"
    assert (found.problems, found.validity.any()) == ([], False)
