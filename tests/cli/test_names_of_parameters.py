"""One convention of names: k_RC is in row R and column C of K, in reports and tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.cli.run import report_of, run
from tests.cli.studies import rows, study
from tests.device_recordings import donor, edit, set_coefficients, week
from tests.recordings import GAIN, OFFSET_G, good_csv, straightened

PLACES = {f"k_{r}{c}": (row, column) for row, r in enumerate("xyz") for column, c in enumerate("xyz")}


def test_a_name_says_row_and_column_in_report_and_table(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    path = good_csv(tmp_path / "in")
    assert study(tmp_path / "in").code == 0
    (row,), held = (
        rows(tmp_path / "out"),
        report_of(tmp_path / "out" / "good.calibration.json")["calibration"],
    )
    assert held["equation"] == "a = K (v + q v^2 + o + s (T - Tref))"
    for name, (r, c) in PLACES.items():
        assert float(row[name]) == held["gain"][r][c] == held["parameters"].get(name, 0.0)
        assert held["gain"][r][c] == pytest.approx(GAIN[r, c], abs=1e-3)
    assert float(row["k_xy"]) == 0.0 != float(row["k_yx"])
    raw = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(1, 2, 3), max_rows=2000)
    raw = straightened(held, raw)
    x, y = (raw[:, axis] + held["parameters"][f"o{name}"] for axis, name in enumerate("xy"))
    written = pq.read_table(tmp_path / "out" / "good.calibrated.parquet")["y"].to_numpy()[:2000]
    expected = held["parameters"]["k_yx"] * x + held["parameters"]["k_yy"] * y
    assert np.abs(written - expected).max() < 1e-6


def test_a_full_gain_has_the_names_above_the_diagonal_too(tmp_path: Path) -> None:
    gain = GAIN + np.triu([[0, 0.004, -0.003], [0, 0, 0.002], [0, 0, 0]])
    edit(coefficients := donor(tmp_path), lambda held: set_coefficients(held, gain, OFFSET_G))
    path = week(tmp_path / "other.raw", seed=2, poses=12)
    assert run("apply", "--coefficients", coefficients, path).code == 0
    held = report_of(tmp_path / "other.calibration.json")["calibration"]
    for name, (r, c) in PLACES.items():
        assert held["parameters"][name] == held["gain"][r][c] == pytest.approx(gain[r, c], abs=1e-8)
