"""Physics Toolbox: of two accelerations in one table, the one with gravity, and the gyroscope."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.formats.make_csv import GRID, read, written

VALUES = np.array([(0.25 - row / 64, -0.5, 0.75) for row in range(12)])
LINEAR, RATES = (0.125, 0.25, -0.5), (0.5, -1.0, 1.5)
GROUPS = {"gF": VALUES.tolist(), "a": [LINEAR] * 12, "w": [RATES] * 12}


def table(order: str = "gF a w", delimiter: str = ",") -> str:
    groups = order.split()
    lines = [delimiter.join(["time", *(f"{group}{axis}" for group in groups for axis in "xyz")])]
    for row in range(12):
        cells = [row / 50, *(cell for group in groups for cell in GROUPS[group][row])]
        lines.append(delimiter.join(f"{cell:.6f}" for cell in cells))
    return "\n".join(lines) + "\n"


SAMPLE = table().encode()


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("order", ["gF a w", "a gF w", "w a gF", "gF"])
def test_t5_the_acceleration_with_gravity_is_chosen(tmp_path: Path, order: str, delimiter: str) -> None:
    found = read(written(tmp_path, table(order, delimiter), "export.csv"))
    assert np.array_equal(found.counts, np.rint(VALUES * GRID))
    assert found.recording.rate_hz == 50
    assert found.recording.notes[0] == "an export of Physics Toolbox"
    assert (found.recording.gyro_dps_per_lsb is not None) == ("w" in order)
