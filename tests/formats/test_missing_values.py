"""T7: rows without values are missing time, in any share; damage is another thing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run import codes, exit_code
from tests.formats.make_csv import read, written
from tests.formats.one_table import CONTAINERS, table
from tests.recordings import RATE_HZ, directions, still_counts

ROWS = 30_000
EPOCH_S = 1_709_548_900


def rested() -> np.ndarray:
    """Values [g] of 40 poses, worn for the last two fifths of the time."""
    values = (still_counts(directions(40)) / 256)[:ROWS]
    values[: 3 * ROWS // 5] = np.nan
    return values


def made(folder: Path, kind: str, time: np.ndarray, values: np.ndarray) -> Path:
    columns = {"time": time, **dict(zip("xyz", values.T, strict=True))}
    return CONTAINERS[kind].file(folder, table("a", columns), "a")


@pytest.mark.parametrize("kind", ["csv", "npz", "mat", "h5", "parquet"])
def test_t7_rows_without_values_are_a_gap(tmp_path: Path, kind: str) -> None:
    """Three fifths at one end are missing: nothing is lost, and the share is said."""
    values, begins = rested(), "2024-03-04T10:53:40"
    if kind == "csv":
        values, begins = values[::-1], "2024-03-04T10:41:40"
    path = made(tmp_path, kind, EPOCH_S + np.arange(ROWS) / RATE_HZ, values)
    assert exit_code("calibrate", path, "--report-only", "-R", "max_damage=0", "-q") == 0
    report = json.loads((tmp_path / "a.calibration.json").read_text())
    assert report["recording"]["samples"] == 2 * ROWS // 5
    assert report["recording"]["start_time"].startswith(begins)
    assert report["file_health"]["lost_bytes"] == 0
    (said,) = [one for one in report["cautions"] if one["code"] == "rows_without_values"]
    assert said["values"] == {"empty_percent": 60.0, "empty_rows": 3 * ROWS // 5}
    assert "cut_short" not in codes(report["cautions"])


WORDS = [
    *("", "NaN", "NA", "null", "NULL", "None", "n/a", "#N/A", "missing", "nil", "undefined", "#DIV/0!"),
    *("-", "--", "---", "\u2013", "\u2014", "?", ".", " - "),
]  # a dash by itself is a missing value, as in the tables of spreadsheets; in a number it is damage


@pytest.mark.parametrize("empty", WORDS)
def test_t7_values_missing_in_the_middle_make_a_gap(tmp_path: Path, empty: str) -> None:
    values = np.tile([0.1, 0.2, 0.97], (1000, 1)) + 0.01 * np.random.RandomState(1).randn(1000, 3)
    values[300:900] = np.nan
    path = made(tmp_path, "csv", EPOCH_S + np.arange(1000) / 25, values)
    path.write_text(path.read_text().replace(",,,", f",{empty},{empty},{empty}"))
    for samples in (64, 1_000_000):
        found = read(path, samples)
        assert (len(found.counts), found.breaks, found.codes) == (400, [300], ["missing_value"])
        assert (found.problems[0].count, found.problems[0].lost_bytes) == (600, 0)
        assert found.problems[0].empty_rows == 600


def test_t7_a_table_without_any_value_is_refused(tmp_path: Path) -> None:
    text = "time,x,y,z\n" + "".join(f"{EPOCH_S + row / 25:.3f},0,0,1\n" for row in range(3))
    rows = "".join(f"{EPOCH_S + row / 25:.3f},900,900,900\n" for row in range(3, 200))
    assert exit_code("calibrate", written(tmp_path, text + rows), "--report-only", "--unit", "g") == 3
