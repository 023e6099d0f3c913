"""phyphox: quoted names, exponents, and a clock that begins with the measurement."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.formats.make_csv import GRID, read, written

NAMES = ["Time (s)", *(f"Acceleration {axis} (m/s^2)" for axis in "xyz"), "Absolute acceleration (m/s^2)"]
VALUES = np.array([(0.25 * row, -0.5, 9.75 + row / 64) for row in range(12)])
COUNTS = np.rint(VALUES / 9.80665 * GRID)


def table(delimiter: str = ",", decimal: str = ".", linear: str = "") -> str:
    names = [f'"{name.replace("Acceleration ", linear + "Acceleration ")}"' for name in NAMES]
    lines = [delimiter.join(names)]
    for row, values in enumerate(VALUES.tolist()):
        cells = (row / 100, *values, float(np.linalg.norm(values)))
        lines.append(delimiter.join(f"{cell:.9E}".replace(".", decimal) for cell in cells))
    return "\n".join(lines) + "\n"


SAMPLE = table().encode()


@pytest.mark.parametrize(("delimiter", "decimal"), [(",", "."), ("\t", ","), (";", ","), (";", ".")])
def test_all_its_ways_to_write_numbers(tmp_path: Path, delimiter: str, decimal: str) -> None:
    found = read(written(tmp_path, table(delimiter, decimal), "Raw Data.csv"))
    assert np.array_equal(found.counts, COUNTS)
    assert found.times.tolist() == [row * 10_000 for row in range(12)]
    assert found.codes == ["no_start_time"]
    assert found.recording.notes[0] == "an export of phyphox"
