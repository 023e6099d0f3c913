"""MetaWear: three columns of time, of which only the first can be read in every version."""

from __future__ import annotations

from pathlib import Path

import pytest

from accelcal_cli.core.errors import UnreadableError
from tests.formats.make_csv import START_US, read, written

HEADER = "epoc (ms),timestamp (+0100),elapsed (s),x-axis (g),y-axis (g),z-axis (g)\n"
LATER = "epoch (ms),time (01:00),elapsed (s),x-axis (g),y-axis (g),z-axis (g)\n"
VALUES = [[0.5, row / 64, 0.75] for row in range(12)]


def rows(factor: float = 1.0) -> str:
    lines = []
    for row, (x, y, z) in enumerate(VALUES):
        stamp = f"2024-03-04T01.00.00.{row * 10:03d}"
        cells = f"{x * factor:.6f},{y * factor:.6f},{z * factor:.6f}"
        lines.append(f"{START_US // 1000 + row * 10},{stamp},{row / 100:.3f},{cells}\n")
    return "".join(lines)


SAMPLE = (HEADER + rows()).encode()


@pytest.mark.parametrize("header", [HEADER, LATER])
def test_milliseconds_since_1970_are_the_time(tmp_path: Path, header: str) -> None:
    found = read(written(tmp_path, header + rows()))
    assert found.g.tolist() == VALUES
    assert found.times.tolist() == [START_US + row * 10_000 for row in range(12)]
    about = found.recording
    assert (about.timezone, about.rate_hz, about.device.model) == ("UTC", 100.0, "MetaWear")
    axes = "x, y, z: column 3 ('x-axis (g)'), column 4 ('y-axis (g)'), column 5 ('z-axis (g)')"
    assert axes in about.notes


def test_a_sensor_fusion_without_gravity_is_doubted(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="its unit is in doubt"):
        read(written(tmp_path, HEADER + rows(0.01)))
