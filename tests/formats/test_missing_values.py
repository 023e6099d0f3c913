"""T7: rows without values are missing time, in any share; damage is another thing."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from tests.cli.run import codes, exit_code
from tests.formats.make_csv import read, written
from tests.recordings import RATE_HZ, directions, still_counts

ROWS = 30_000
EPOCH_S = 1_709_548_900


def rested() -> np.ndarray:
    """Values [g] of 40 poses, worn for the last two fifths of the time."""
    values = (still_counts(directions(40)) / 256)[:ROWS]
    values[: 3 * ROWS // 5] = np.nan
    return values


def as_csv(path: Path, time: np.ndarray, values: np.ndarray, empty: str = "") -> Path:
    cells = np.where(np.isnan(values), empty, np.char.mod("%.4f", values))
    lines = [f"{when:.3f},{','.join(row)}" for when, row in zip(time, cells, strict=True)]
    path.write_text("\n".join(["time,x,y,z", *lines, ""]))
    return path


def as_npz(path: Path, time: np.ndarray, values: np.ndarray) -> Path:
    np.savez(path, time=time, acc=values)
    return path


def as_mat(path: Path, time: np.ndarray, values: np.ndarray) -> Path:
    scipy.io.savemat(path, {"time": time, "acc": values})
    return path


def as_hdf5(path: Path, time: np.ndarray, values: np.ndarray) -> Path:
    with h5py.File(path, "w") as file:
        file["time"], file["acc"] = time, values
    return path


def as_parquet(path: Path, time: np.ndarray, values: np.ndarray) -> Path:
    columns = {axis: values[:, number] for number, axis in enumerate("xyz")}
    pq.write_table(pa.table({"time": time, **columns}), path)
    return path


@pytest.mark.parametrize(
    ("name", "write"),
    [("a.csv", as_csv), ("a.npz", as_npz), ("a.mat", as_mat), ("a.h5", as_hdf5), ("a.parquet", as_parquet)],
)
def test_t7_rows_without_values_are_a_gap(tmp_path: Path, name: str, write: object) -> None:
    """Three fifths at one end are missing: nothing is lost, and the share is said."""
    time = EPOCH_S + np.arange(ROWS) / RATE_HZ
    values, begins = rested(), "2024-03-04T10:53:40"
    if write is as_csv:
        values, begins = values[::-1], "2024-03-04T10:41:40"
    path = write(tmp_path / name, time, values)
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
    time = EPOCH_S + np.arange(1000) / 25
    for samples in (64, 1_000_000):
        found = read(as_csv(tmp_path / "a.csv", time, values, empty), samples)
        assert (len(found.counts), found.breaks, found.codes) == (400, [300], ["missing_value"])
        assert (found.problems[0].count, found.problems[0].lost_bytes) == (600, 0)
        assert found.problems[0].empty_rows == 600


def test_t7_rows_that_are_shared_with_other_sensors_are_no_gaps(tmp_path: Path) -> None:
    """One row in three is of the accelerometer, which then runs at 25 Hz; 200 rows of it are missing."""
    values = np.full((9000, 3), np.nan)
    values[::3] = np.tile([0.1, 0.2, 0.97], (3000, 1)) + 0.01 * np.random.RandomState(1).randn(3000, 3)
    values[3000:3600] = np.nan
    for samples in (64, 1_000_000):
        found = read(as_csv(tmp_path / "a.csv", EPOCH_S + np.arange(9000) / 75, values), samples)
        assert (found.recording.rate_hz, len(found.counts), found.breaks) == (25.0, 2800, [1000])
        assert "one row in 3 holds acceleration" in " ".join(found.recording.notes)


def test_t7_a_table_without_any_value_is_refused(tmp_path: Path) -> None:
    text = "time,x,y,z\n" + "".join(f"{EPOCH_S + row / 25:.3f},0,0,1\n" for row in range(3))
    rows = "".join(f"{EPOCH_S + row / 25:.3f},900,900,900\n" for row in range(3, 200))
    assert exit_code("calibrate", written(tmp_path, text + rows), "--report-only", "--unit", "g") == 3
