"""Against an independent generator with known errors: six hours, and nightly whole days in six formats."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.cli.run import exit_code
from tests.recordings import straightened

LAYOUT = """
[dump]
rate_hz = 100.0
lsb_per_g = 256.0
range_g = 8.0
start_time = "2024-03-04T00:00:00"
[fields]
x = { offset = 0, type = "int16" }
y = { offset = 2, type = "int16" }
z = { offset = 4, type = "int16" }
"""
SUFFIXES = ("cwa", "raw", "h5", "csv", "bin", "gt3x")
OPTIONS = {"raw": "--raw", "h5": "--hdf5", "csv": "--csv", "bin": "--bin", "gt3x": "--gt3x"}
"""What makes the generator write a format beside `.cwa`, which it always writes."""

START = np.datetime64("2024-03-04T00:00:00", "us")


@dataclass(frozen=True)
class Day:
    folder: Path
    truth: dict
    counts: np.ndarray
    still: np.ndarray
    reports: dict[str, dict]

    def parquet(self, suffix: str) -> Path:
        return self.folder / suffix / "day.calibrated.parquet"


def make(real_data: Path, folder: Path, truth: int, words: tuple[str, ...]) -> None:
    tool = real_data.parent / "tools" / "make_recording.py"
    command = [
        sys.executable, str(tool), "--truth", str(truth), "--seed", str(truth), "--out",
        str(folder / "day"),
    ]  # fmt: skip
    subprocess.run([*command, *words], check=True, capture_output=True)
    (folder / "day.layout.toml").write_text(LAYOUT)


def calibrated(folder: Path, suffix: str, *words: str) -> dict:
    assert exit_code("calibrate", folder / f"day.{suffix}", "-d", folder / suffix, "-q", *words) == 0
    report = json.loads((folder / suffix / "day.calibration.json").read_text())
    del report["provenance"]
    return report


def calibrated_day(real_data: Path, folder: Path, truth: int, days: str, suffixes: tuple[str, ...]) -> Day:
    make(real_data, folder, truth, ("--days", days, *(OPTIONS[suffix] for suffix in suffixes[1:])))
    reports = {suffix: calibrated(folder, suffix, "--no-temperature") for suffix in suffixes}
    known = json.loads((folder / "day.truth.json").read_text())
    return Day(folder, known, np.load(folder / "day.i16.npy"), np.load(folder / "day.still.npy"), reports)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param((3, "0.25", ("cwa", "gt3x")), id="6h"),
        *(
            pytest.param((seed, "1", SUFFIXES), id=f"day-{seed}", marks=pytest.mark.nightly)
            for seed in (3, 5, 8, 21)
        ),
    ],
)
def day(request: pytest.FixtureRequest, real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Day:
    if not (real_data.parent / "tools" / "make_recording.py").exists():
        pytest.skip("the independent generator is absent")
    pytest.importorskip("polars")
    return calibrated_day(real_data, tmp_path_factory.mktemp("day"), *request.param)


def gain_and_offset(report: dict) -> tuple[np.ndarray, np.ndarray]:
    return np.array(report["calibration"]["gain"]), np.array(report["calibration"]["offset_g"])


def test_the_true_errors_are_found(day: Day) -> None:
    for suffix, report in day.reports.items():
        gain, offset = gain_and_offset(report)
        assert np.abs(gain - day.truth["K"]).max() < 1e-4, suffix
        assert np.abs(offset + day.truth["b"]).max() < 0.1e-3, suffix


def test_stillness_measures_one_g(day: Day) -> None:
    gain, offset = gain_and_offset(day.reports["cwa"])
    means = np.stack([day.counts[at : at + 1000].mean(axis=0) for at in day.still]) / 256
    left_mg = 1000 * np.abs(np.linalg.norm((means + offset) @ gain.T, axis=1) - 1).mean()
    assert left_mg < day.truth["err_perfect_mg"] + 0.01 < 0.1


def test_the_same_counts_give_the_same_integers(day: Day) -> None:
    found = [report["calibration"]["fixed_point"] for report in day.reports.values()]
    assert all(item == found[0] for item in found)


def test_parquet_is_the_calibration_of_every_sample_at_its_time(day: Day) -> None:
    for suffix, report in day.reports.items():
        gain, offset = gain_and_offset(report)
        table = pq.read_table(day.parquet(suffix), columns=["time", "x", "y", "z"])
        assert table.num_rows == len(day.counts) == report["recording"]["samples"]
        expected = (straightened(report["calibration"], day.counts / 256) + offset) @ gain.T
        for axis, name in enumerate("xyz"):
            np.testing.assert_allclose(table[name].to_numpy(), expected[:, axis], rtol=2**-23, atol=2**-26)
        times = table["time"].to_numpy()
        exact = START + (np.arange(len(times)) * 10_000).astype("timedelta64[us]")
        stamp_resolution_us = 31 if suffix == "cwa" else 0
        assert np.abs((times - exact).astype(np.int64)).max() <= stamp_resolution_us, suffix


@pytest.mark.parametrize(
    "samples", [9000, *(pytest.param(n, marks=pytest.mark.nightly) for n in (77_777, 10**7))]
)
def test_the_chunk_size_changes_nothing(day: Day, samples: int) -> None:
    report = calibrated(
        day.folder, "cwa", "--no-temperature", "--report-only", "--chunk-samples", str(samples), "--force"
    )
    for key in ("calibration", "holdout", "fit", "coverage", "models_tried"):
        assert report[key] == day.reports["cwa"][key]


@pytest.mark.nightly
def test_temperature_slopes_are_found(real_data: Path, tmp_path: Path) -> None:
    make(real_data, tmp_path, 4, ("--days", "2", "--temp-slope", "1", "-0.5", "0.8"))
    report = calibrated(tmp_path, "cwa", "--report-only")
    assert report["calibration"]["model"] == "9T"
    slopes = 1000 * np.array(report["calibration"]["temperature"]["slope_g_per_c"])
    np.testing.assert_allclose(-slopes, [1, -0.5, 0.8], atol=0.05)
