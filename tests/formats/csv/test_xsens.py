"""Xsens MT Manager and Movella DOT: ticks, rate and start of the head, acceleration without gravity."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.make_csv import read, written

ROWS = 60
VALUES = np.array([(0.25 * (row % 12), -0.5, 9.75 + (row % 12) / 64) for row in range(ROWS)])
DOT = """sep=,
DeviceTag:,left wrist
FirmwareVersion:,3.0.0
AppVersion:,2023.6.0
SyncStatus:,Synced
OutputRate:,{rate}Hz
FilterProfile:,General
Measurement Mode:,Custom Mode 5
StartTime: ,2025-07-11_20:06:00_086 {zone}
\u00a9 Movella Technologies B. V. 2005-2025

"""
MANAGER = """// Start Time: Unknown
// Update Rate: {rate:.1f}Hz
// Filter Profile: human (46.1)
// Firmware Version: 4.3.4
"""


def table(names: str, step: int, first: int = 2_268_972_329, mark: str = ",") -> str:
    columns = names.split(",")
    lines = [mark.join(columns)]
    for row, (x, y, z) in enumerate(VALUES.tolist()):
        values = {"PacketCounter": row + 1, "SampleTimeFine": first + row * step, "Status": 0}
        values |= {"Acc_X": x, "Acc_Y": y, "Acc_Z": z, "Gyr_X": 0.5, "Gyr_Y": -0.25, "Gyr_Z": 0.125}
        lines.append(
            mark.join(
                f"{values.get(name, 0.01 * (row % 7)):g}" if name not in values else str(values[name])
                for name in columns
            )
        )
    return "\n".join(lines) + "\n"


ALL = (
    "PacketCounter,SampleTimeFine,Euler_X,Euler_Y,Euler_Z,FreeAcc_X,FreeAcc_Y,FreeAcc_Z,Acc_X,Acc_Y,Acc_Z,"
    "Gyr_X,Gyr_Y,Gyr_Z"
)
SAMPLE = (
    DOT.format(rate=60, zone="WEST") + "".join(table(ALL, 16_667).splitlines(keepends=True)[:13])
).encode()


@pytest.mark.parametrize(("zone", "hours"), [("WEST", 1), ("CEST", 2), ("", None)])
def test_t16_the_head_of_a_dot_is_used(tmp_path: Path, zone: str, hours: int | None) -> None:
    found = read(written(tmp_path, DOT.format(rate=100, zone=zone) + table(ALL, 10_000)))
    start = datetime(2025, 7, 11, 20, 6, 0, 86_000, UTC) - timedelta(hours=hours or 0)
    first_us = (start - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1)
    assert found.times.tolist() == [first_us + row * 10_000 for row in range(ROWS)]
    about = found.recording
    zone_of = "UTC" if zone else None
    assert (about.rate_hz, about.timezone, about.device.serial) == (100.0, zone_of, "left wrist")
    assert about.device.firmware == "3.0.0" and found.codes == []
    assert any("FreeAcc_X" in note for note in about.notes)
    assert np.allclose(found.counts / about.lsb_per_g, VALUES / 9.80665, atol=1e-6)
    assert about.gyro_dps_per_lsb is not None


@pytest.mark.parametrize(("rate", "step"), [(100, 100), (60, 167), (50, 200), (40, 250), (20, 500)])
def test_t13_sample_time_fine_counts_ticks_of_10_khz(tmp_path: Path, rate: int, step: int) -> None:
    names = "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z"
    found = read(written(tmp_path, MANAGER.format(rate=rate) + table(names, step, mark="\t"), "a.txt"))
    assert np.diff(found.times).tolist() == [step * 100] * (ROWS - 1)
    assert found.recording.rate_hz == rate
    assert any("in ticks of 0.1 ms" in note for note in found.recording.notes)


@pytest.mark.parametrize(("step", "us"), [(100, 100), (167, 100), (10_000, 1), (16_667, 1)])
def test_t13_sample_time_fine_without_a_head(tmp_path: Path, step: int, us: int) -> None:
    found = read(written(tmp_path, table("PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z", step)))
    assert np.diff(found.times).tolist() == [step * us] * (ROWS - 1)


def test_t16_acceleration_without_gravity_is_not_taken(tmp_path: Path) -> None:
    names = "PacketCounter,SampleTimeFine,Euler_X,Euler_Y,Euler_Z,FreeAcc_X,FreeAcc_Y,FreeAcc_Z,Status"
    with pytest.raises(UnreadableError, match="without gravity only"):
        read(written(tmp_path, DOT.format(rate=60, zone="") + table(names, 16_667)))


def counted(step: float, name: str = "timestamp", above: str = "") -> str:
    rows = "".join(f"{1000 + row * step:g},0.1,0.2,0.9\n" for row in range(ROWS))
    return f"{above}{name},acc_x,acc_y,acc_z\n{rows}"


@pytest.mark.parametrize(
    ("step", "above", "us"),
    [
        (100, "# Sampling rate: 100 Hz\n", 10_000),
        (10, "# Sample rate (Hz): 100\n", 10_000),
        (5_000, "# sampling_frequency=200.0Hz\n", 5_000),
        (20, "# output data rate 50\n", 20_000),
        (20, "# sampling rate: 3 kHz\n", 20_000),
        (20, "# sampling rate: 1000 Hz\n", 20_000),
    ],
)
def test_t13_the_rate_above_the_table_decides_the_unit_where_it_fits(
    tmp_path: Path, step: int, above: str, us: int
) -> None:
    found = read(written(tmp_path, counted(step, above=above)))
    assert np.diff(found.times).tolist() == [us] * (ROWS - 1)


@pytest.mark.parametrize(
    ("name", "step", "us", "how"),
    [
        ("timestamp_ms", 100, 100_000, "in ms"),
        ("time [us]", 100, 100, "in us"),
        ("time (s)", 0.02, 20_000, "in s"),
        ("timestamp", 20, 20_000, "in ms (judged by the rate)"),
        ("timestamp", 20_000, 20_000, "in us (judged by the rate)"),
    ],
)
def test_t13_the_unit_that_was_chosen_is_noted(
    tmp_path: Path, name: str, step: float, us: int, how: str
) -> None:
    found = read(written(tmp_path, counted(step, name)))
    assert np.diff(found.times).tolist() == [us] * (ROWS - 1)
    assert any(note.startswith("time: ") and note.endswith(how) for note in found.recording.notes)


def test_t13_ticks_of_an_unknown_clock_are_asked_about(tmp_path: Path) -> None:
    path = written(tmp_path, counted(20, "tick time"))
    with pytest.raises(UnreadableError, match="-R time_format=ms"):
        read(path)
    assert np.diff(read(path, time_format="us", rate_hz=50_000.0).times).tolist() == [20] * (ROWS - 1)
    assert np.diff(read(path, rate_hz=50.0).times).tolist() == [20_000] * (ROWS - 1)


def test_t13_time_format_gives_a_unit(tmp_path: Path) -> None:
    path = written(tmp_path, counted(100))
    assert np.diff(read(path, time_format="us").times).tolist() == [100] * (ROWS - 1)


def test_a_rate_above_rows_without_times(tmp_path: Path) -> None:
    rows = "".join(f"{0.1 * (row % 3):g},0.2,0.9\n" for row in range(ROWS))
    found = read(written(tmp_path, f"# Sample Rate: 62.5 Hz\nx,y,z\n{rows}"))
    assert found.recording.rate_hz == 62.5
    assert any("by a line above the rows" in note for note in found.recording.notes)
