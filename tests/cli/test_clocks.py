"""T3: whatever a clock does, all that accelcal writes of a recording is read by its own commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.cli.run import codes, exit_code, nightly, told
from tests.recordings import RATE_HZ, directions, still_counts, write_csv

PERIOD_US = round(1e6 / RATE_HZ)
DAY_US = 86_400_000_000
STARTS = {
    name: np.datetime64(name, "us").astype(np.int64)
    for name in ("1970-01-01", "1980-01-06", "2000-01-01", "2010-01-01", "2024-03-04", "2079-06-06")
}


def with_clock(path: Path, stretches: list[int]) -> int:
    """A recording of 30 poses whose rows are shared evenly by stretches with these begins [us since 1970]."""
    counts = still_counts(directions(30))
    lines = write_csv(path, counts).read_text().splitlines()
    edges = np.linspace(0, len(counts), len(stretches) + 1).astype(int)
    times = [
        start + PERIOD_US * np.arange(rows) for start, rows in zip(stretches, np.diff(edges), strict=True)
    ]
    stamps = np.datetime_as_string(np.concatenate(times).astype("datetime64[us]"))
    rows = [f"{stamp},{line.partition(',')[2]}" for stamp, line in zip(stamps, lines[1:], strict=True)]
    path.write_text("\n".join(["time,x,y,z", *rows, ""]))
    return len(counts)


def check_all_commands(folder: Path, stretches: list[int]) -> dict:
    """Calibrate, and read what was written by every command that takes it; return the report."""
    path, data = folder / "a.csv", folder / "out/a.calibrated.parquet"
    rows = with_clock(path, stretches)
    assert exit_code("calibrate", path, "--html", "-d", folder / "out", "-q") == 0
    found = read_by_all(folder, path)
    for words in (
        ("export", data, "--to", "parquet", "--resample", 20, "-o", folder / "data.parquet"),
        ("inspect", path),
        ("calibrate", path, "--effect", "--report-only", "-d", folder / "effect"),
    ):
        assert exit_code(*words) == 0, words
    assert found["recording"]["samples"] == rows
    return found


def read_by_all(folder: Path, path: Path) -> dict:
    """The report of a recording that has been calibrated, once commands have read it and the data."""
    report, data = folder / "out/a.calibration.json", folder / "out/a.calibrated.parquet"
    for words in (
        ("verify", report, path),
        ("report", report),
        ("apply", "--coefficients", report, path, "-d", folder / "applied"),
        ("export", report, "--to", "ggir", "-o", folder / "ggir.csv"),
        ("export", data, "--to", "csv", "-o", folder / "data.csv"),
    ):
        assert exit_code(*words) == 0, words
    return json.loads(report.read_text())


@pytest.mark.parametrize(
    ("then", "resets"), [("2000-01-01", 1), nightly("2010-01-01", 1), nightly("2079-06-06", 1)]
)
def test_t3_a_clock_that_was_reset_is_a_stretch_of_its_own(tmp_path: Path, then: str, resets: int) -> None:
    report = check_all_commands(tmp_path, [STARTS["2024-03-04"], STARTS[then]])
    assert report["recording"]["duration_s"] == pytest.approx(900)
    assert codes(report["cautions"]).count("clock_reset") == resets
    assert f"from 2024-03-04T00:07:29 to {then}T00:00:00 at sample 11250" in told(report, "clock_reset")
    assert report["file_health"]["clock"]["gap_seconds"] == 0


@pytest.mark.parametrize(
    ("year", "unlikely"), [("1970", 1), ("1980", 1), ("2036", 1), ("2106", 1), ("1990", 0), ("2035", 0)]
)
def test_t11_a_year_in_which_nobody_records_has_a_caution(tmp_path: Path, year: str, unlikely: int) -> None:
    path = tmp_path / "a.csv"
    with_clock(path, [np.datetime64(f"{year}-03-04", "us").astype(np.int64)])
    assert exit_code("calibrate", path, "-d", tmp_path, "-q") == 0
    report = json.loads((tmp_path / "a.calibration.json").read_text())
    assert codes(report["cautions"]).count("unlikely_year") == unlikely
    assert not unlikely or f"begins in {year}-03-04T00:00:00" in told(report, "unlikely_year")


@pytest.mark.nightly
@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.sampled_from(sorted(STARTS.values())),
            st.integers(0, 400 * DAY_US).map(lambda by: STARTS["2024-03-04"] + by),
            st.integers(0, 900_000_000).map(lambda by: STARTS["2024-03-04"] + by),
        ),
        min_size=1,
        max_size=7,
    )
)
def test_t3_any_interleaving_of_clocks_is_read_by_all_commands(
    tmp_path_factory: pytest.TempPathFactory, stretches: list[int]
) -> None:
    report = check_all_commands(tmp_path_factory.mktemp("clocks"), stretches)
    assert report["recording"]["duration_s"] >= 0
