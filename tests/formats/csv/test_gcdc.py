"""Gulf Coast Data Concepts: settings above the table, seconds since a start, counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.make_csv import read, written

COUNTS = np.array([(40 * row, -1000, 1700 + row) for row in range(12)])
START_US = 1_709_548_900_000_000
X16 = (
    ";Title, http://www.gcdataconcepts.com, X16-1D, LIS3DH",
    ";Version, 2000, Build date, Apr 13 2018, SN:CCDC30160000001",
    ";Start_time, 2024-03-04, 10:41:40.250",
    ";Temperature, 24.60, deg C,  Vbat, 4180, mv",
    ";SampleRate, 25,Hz",
    ";Deadband, 0, counts",
    ";DeadbandTimeout, 0,sec",
)


def table(head: tuple[str, ...] = X16, names: str = ";Headers, time,Ax,Ay,Az", first_s: float = 0.0) -> str:
    rows = (f"{first_s + row / 25:.4f},{x},{y},{z}" for row, (x, y, z) in enumerate(COUNTS.tolist()))
    return "\r\n".join([*head, names, *rows, ""])


HAM = (
    X16[0].replace("X16-1D, LIS3DH", "HAM-IMU+alt, MPU9250 BMP280"),
    *X16[1:3],
    ";MPU, SR (Hz), Sens (counts/unit), FullScale (units), Units",
    ";Accel, 25, 2000, 16, g",
    ";Gyro, 25, 1, 250, dps",
    *X16[5:],
)
SAMPLE = table(HAM).encode()


@pytest.mark.parametrize(
    ("text", "first_us", "device"),
    [
        (table(), 250_000, ("X16-1D", "CCDC30160000001", "2000")),
        (table(names=";Time, Ax, Ay, Az", first_s=0.266), 516_000, ("X16-1D", "CCDC30160000001", "2000")),
        (table((*X16[:2], X16[2].replace(".250", ""), ";Gain, low", *X16[4:])), 0, ("X16-1D",)),
        (
            table(("\ufeff" + X16[0].replace("X16-1D", "X2-2"), X16[2], *X16[5:])),
            250_000,
            ("X2-2", None, None),
        ),
    ],
)
def test_t7_seconds_count_from_the_start_in_the_head(
    tmp_path: Path, text: str, first_us: int, device: tuple[str | None, ...]
) -> None:
    found = read(written(tmp_path, text, "DATA-001.CSV"), lsb_per_g=2048)
    assert np.array_equal(found.counts, COUNTS)
    assert (found.times - START_US).tolist() == [first_us + 40_000 * row for row in range(12)]
    assert found.recording.lsb_per_g == 2048 and found.recording.rate_hz == 25 and not found.problems
    model, *rest = device
    about = found.recording.device
    assert about.model == f"Gulf Coast Data Concepts {model}"
    assert [about.serial, about.firmware][: len(rest)] == rest


def test_t7_the_scale_is_asked_for_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match=r"--lsb-per-g \(2048 would fit\)$"):
        read(written(tmp_path, table()))


def test_the_scale_of_a_ham_is_in_its_head(tmp_path: Path) -> None:
    found = read(written(tmp_path, SAMPLE))
    assert found.recording.lsb_per_g == 2000 and np.array_equal(found.counts, COUNTS)
    text = SAMPLE.replace(b"Accel, 25, 2000, 16, g", b"Accel, 25, 0, 16, g")
    with pytest.raises(UnreadableError, match="--lsb-per-g"):
        read(written(tmp_path, text))
