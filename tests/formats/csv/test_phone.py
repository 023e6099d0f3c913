"""Files of phone loggers: tabs, decimal commas, m/s2, and clocks of every kind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.make_csv import GRID, START_US, read, stamp, written

STANDARD_GRAVITY = 9.80665
VALUES = [(0.25 * row, -0.5, 9.75 + row / 64) for row in range(12)]
COUNTS = np.rint(np.array(VALUES) / STANDARD_GRAVITY * GRID)


def table(header: str, times: list[str], *, delimiter: str = ",", decimal: str = ".", end: str = "") -> str:
    """Return a header and the values, each row with its time before it and text behind."""
    lines = [header.replace(",", delimiter)]
    for time, row in zip(times, VALUES, strict=True):
        cells = [time, *map(repr, row)]
        lines.append(delimiter.join(cell.replace(".", decimal) for cell in cells) + end)
    return "\n".join(lines) + "\n"


def test_tabs_decimal_commas_and_exponents(tmp_path: Path) -> None:
    """phyphox quotes names and writes numbers such as 1,000000000E-2."""
    header = '"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)"'
    lines = [header.replace(",", "\t")]
    for row, values in enumerate(VALUES):
        lines.append("\t".join(f"{value:.9E}".replace(".", ",") for value in (row / 100, *values)))
    found = read(written(tmp_path, "\n".join(lines) + "\n"))
    assert np.array_equal(found.counts, COUNTS)
    assert found.times.tolist() == [row * 10_000 for row in range(12)]
    assert found.codes == ["no_start_time"]


@pytest.mark.parametrize(
    ("name", "times", "start_us"),
    [
        ("time", [str(row * 10) for row in range(12)], 0),
        ("Time since start in ms ", [str(row * 10) for row in range(12)], 0),
        ("time_ns", [str(row * 10_000_000) for row in range(12)], 0),
        ("timestamp", [str(87_654_321_000_000 + row * 10_000_000) for row in range(12)], 87_654_321_000),
        ("time", [str((START_US + row * 10_000) * 1000) for row in range(12)], START_US),
        ("time", [str(START_US // 1000 + row * 10) for row in range(12)], START_US),
        ("time", [f"{START_US / 1e6 + row / 100:.2f}" for row in range(12)], START_US),
        ("time", [stamp(row * 10_000)[:-3].replace("T", " ") for row in range(12)], START_US),
        ("time", [f"2024-03-04 00:00:00:{row * 10:03d}" for row in range(12)], START_US),
        ("time", [f"2024-03-04 00:00:00:{row * 10:03d}0" for row in range(12)], START_US),
    ],
)
def test_clocks(tmp_path: Path, name: str, times: list[str], start_us: int) -> None:
    path = written(tmp_path, table(f"{name},acc_x,acc_y,acc_z", times))
    found = read(path)
    assert np.array_equal(found.counts, COUNTS)
    assert found.times.tolist() == [start_us + row * 10_000 for row in range(12)]
    assert found.recording.rate_hz == 100.0


@pytest.mark.parametrize(("ago", "step"), [(1_234_567_890, 10), (987_654_321_000_000, 10_000_000)])
def test_a_phone_that_ran_for_weeks_is_not_taken_for_a_date(tmp_path: Path, ago: int, step: int) -> None:
    """Times count ms or ns since the phone was switched on, or the next unit since 1970."""
    path = written(
        tmp_path, table("timestamp,acc_x,acc_y,acc_z", [str(ago + row * step) for row in range(12)])
    )
    with pytest.raises(UnreadableError, match="may be seconds or milliseconds; give the right --rate"):
        read(path)
    found = read(path, rate_hz=100.0)
    assert np.diff(found.times).tolist() == [10_000] * 11
    assert found.codes == ["no_start_time"]


def test_many_sensors_between_semicolons(tmp_path: Path) -> None:
    """AndroSensor writes all sensors in a row, the time at its end."""
    header = (
        "ACCELEROMETER X (m/s²);ACCELEROMETER Y (m/s²);ACCELEROMETER Z (m/s²);GRAVITY X (m/s²);"
        "GRAVITY Y (m/s²);GRAVITY Z (m/s²);LINEAR ACCELERATION X (m/s²);LINEAR ACCELERATION Y (m/s²);"
        "LINEAR ACCELERATION Z (m/s²);Time since start in ms ;YYYY-MO-DD HH-MI-SS_SSS"
    )
    lines = [header]
    for row, (x, y, z) in enumerate(VALUES):
        lines.append(f"{x};{y};{z};0;0;9.8;0;0;0;{row * 10};2024-03-04 00:00:00:{row * 10:03d}")
    found = read(written(tmp_path, "\n".join(lines) + "\n"))
    assert np.array_equal(found.counts, COUNTS)
    assert np.diff(found.times).tolist() == [10_000] * 11


def test_epoch_nanoseconds_beside_elapsed_seconds(tmp_path: Path) -> None:
    """Sensor Logger writes `TotalAcceleration.csv` with the axes in reverse order."""
    lines = ["time,seconds_elapsed,z,y,x"]
    for row, (x, y, z) in enumerate(VALUES):
        lines.append(f"{(START_US + row * 10_000) * 1000},{row / 100:.6f},{z},{y},{x}")
    found = read(written(tmp_path, "\n".join(lines) + "\n"))
    assert np.array_equal(found.counts, COUNTS)
    assert (found.times - START_US).tolist() == [row * 10_000 for row in range(12)]


def test_g_force_names(tmp_path: Path) -> None:
    """Physics Toolbox names the columns of its g-force meter gFx, gFy and gFz."""
    lines = ["time,gFx,gFy,gFz,TgF"] + [f"{row / 100},0.5,{row / 64},0.75,1.0" for row in range(12)]
    found = read(written(tmp_path, "\n".join(lines) + "\n"))
    assert found.g.tolist() == [[0.5, row / 64, 0.75] for row in range(12)]
    assert "unit: g" in found.recording.notes


def test_acceleration_without_gravity_is_no_calibration_data(tmp_path: Path) -> None:
    rows = "".join(f"{row / 100},0.0{row % 7},-0.01,0.02\n" for row in range(50))
    with pytest.raises(
        UnreadableError, match="cannot tell the unit: the median length of the acceleration is"
    ):
        read(written(tmp_path, "time,acc_x,acc_y,acc_z\n" + rows))


@pytest.mark.parametrize("delimiter", [";", "\t", " "])
def test_whole_numbers_first_and_decimal_commas_later(tmp_path: Path, delimiter: str) -> None:
    lines = ["x,y,z"] + ["0,0,1"] * 20_000
    later = ["0,25;-0,5;1,015625"] * 3
    text = (
        "\n".join([*(line.replace(",", delimiter) for line in lines), *later]).replace(";", delimiter) + "\n"
    )
    found = read(written(tmp_path, text), 4000, rate_hz=100.0)
    assert found.g[-3:].tolist() == [[0.25, -0.5, 1.015625]] * 3
