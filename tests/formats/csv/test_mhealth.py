"""mHealth: tables of NHANES, whose names say what their heads do not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.recording import Device
from tests.formats.make_csv import GRID, START_US, read, written

ROWS = [(-0.044, 0.001 * row, 0.999 - 0.001 * row) for row in range(12)]
SAMPLE = (
    "HEADER_TIMESTAMP,X,Y,Z\n"
    + "".join(
        f"2024-03-04 00:00:00.{10 * row:03d},{x:.3f},{y:.3f},{z:.3f}\n" for row, (x, y, z) in enumerate(ROWS)
    )
).encode()
NAME = "GT3XPLUS-AccelerationCalibrated-1x5x0.NEO1D26171071.2024-03-04-00-00-00-000-P0000.sensor.csv"


def test_rows_are_in_g_at_the_device_s_clock(tmp_path: Path) -> None:
    found = read(written(tmp_path, SAMPLE))
    assert np.array_equal(found.counts, np.rint(np.round(np.array(ROWS), 3) * GRID))
    assert (found.times - START_US).tolist() == [row * 10_000 for row in range(12)]
    assert (found.recording.rate_hz, found.recording.timezone) == (100.0, None)
    assert found.recording.notes[:1] == ("an export of mHealth",)
    assert found.recording.device == Device()


@pytest.mark.parametrize(
    ("name", "device", "range_g"),
    [
        (NAME, Device("GT3XPLUS", "NEO1D26171071", "1.5.0"), 6.0),
        (NAME.replace("-1x5x0", "-NA"), Device(), None),
        (NAME.replace("-1x5x0", ""), Device("GT3XPLUS", "NEO1D26171071"), 6.0),
        (NAME.replace("GT3XPLUS", "Watch"), Device("Watch", "NEO1D26171071", "1.5.0"), None),
        ("S01.csv", Device(), None),
    ],
)
def test_the_name_says_whose_it_is(tmp_path: Path, name: str, device: Device, range_g: float | None) -> None:
    found = read(written(tmp_path, SAMPLE, name))
    assert (found.recording.device, found.recording.range_g) == (device, range_g)


@pytest.mark.parametrize(("name", "filled"), [(NAME, 199), ("S01.csv", 0)])
def test_an_actigraph_that_sleeps_repeats_its_last_sample(tmp_path: Path, name: str, filled: int) -> None:
    stamps = (f"2024-03-04 00:00:{row // 100:02d}.{10 * (row % 100):03d}" for row in range(300))
    still = "".join(
        f"{stamp},0.{row if row < 100 else 100:03d},0.002,0.998\n" for row, stamp in enumerate(stamps)
    )
    found = read(written(tmp_path, "HEADER_TIMESTAMP,X,Y,Z\n" + still, name))
    assert int((found.validity == 1).sum()) == filled
