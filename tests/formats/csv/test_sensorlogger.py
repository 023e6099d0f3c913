"""Sensor Logger: every sensor's file has the same columns, and only values tell what it holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.make_csv import GRID, START_US, read, written

STANDARD_GRAVITY = 9.80665
HEADER = "time,seconds_elapsed,z,y,x\n"
VALUES = np.array([(0.25 * row, -0.5, 9.75 + row / 64) for row in range(12)])
COUNTS = np.rint(VALUES / STANDARD_GRAVITY * GRID)


def rows(values: np.ndarray) -> str:
    lines = (
        f"{(START_US + row * 10_000) * 1000},{row / 100:.6f},{z!r},{y!r},{x!r}\n"
        for row, (x, y, z) in enumerate(values.tolist())
    )
    return "".join(lines)


SAMPLE = (HEADER + rows(VALUES)).encode()


def test_total_acceleration_is_read_from_z_to_x(tmp_path: Path) -> None:
    found = read(written(tmp_path, SAMPLE, "TotalAcceleration.csv"))
    assert np.array_equal(found.counts, COUNTS)
    assert found.times.tolist() == [START_US + row * 10_000 for row in range(12)]
    about = found.recording
    assert (about.rate_hz, about.timezone) == (100.0, "UTC")
    assert about.notes[0] == "an export of Sensor Logger"


def wearing(length: float) -> np.ndarray:
    """Return acceleration of the wearer alone, in any unit."""
    return np.random.RandomState(3).normal(0, length, (60, 3))


@pytest.mark.parametrize("length", [0.02, 0.5, 0.75, 3.0])
def test_acceleration_without_gravity_is_refused_and_the_right_file_named(
    tmp_path: Path, length: float
) -> None:
    path = written(tmp_path, HEADER + rows(wearing(length)), "Accelerometer.csv")
    with pytest.raises(UnreadableError, match=r"without gravity.*TotalAcceleration\.csv"):
        read(path)
    assert len(read(path, unit="m/s2").counts) == 60


def test_gravity_alone_is_refused(tmp_path: Path) -> None:
    turned = wearing(1.0)
    turned *= STANDARD_GRAVITY / np.linalg.norm(turned, axis=1)[:, np.newaxis]
    with pytest.raises(UnreadableError, match=r"direction of gravity alone.*TotalAcceleration\.csv"):
        read(written(tmp_path, HEADER + rows(turned), "Gravity.csv"))
