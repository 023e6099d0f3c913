"""A month of a wrist that was everywhere: more orientation cells than points may be."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.collect.cells import MAX_POINTS
from tests.cli.run import run

Capture = pytest.CaptureFixture[str]


@pytest.mark.nightly
def test_a_month_is_calibrated_as_well_as_a_week(tmp_path: Path, capsys: Capture) -> None:
    recording = tmp_path / "month.cwa"
    made = ("--format", "cwa", "--days", 30, "--rate", 12.5, "--seed", 5)
    assert run(capsys, "simulate", recording, *made, "-q").code == 0
    truth = json.loads((tmp_path / "month.truth.json").read_text())["sensor"]
    windows = tmp_path / "windows.parquet"
    done = run(capsys, "calibrate", recording, "--json", "-q", "--report-only", "--windows", windows)
    recording.unlink()
    report = json.loads(done.out)
    assert 1000 < report["fit"]["points"] <= MAX_POINTS
    gain, offset = np.array(report["calibration"]["gain"]), np.array(report["calibration"]["offset_g"])
    assert gain == pytest.approx(np.array(truth["gain"]), abs=1e-4)
    assert offset == pytest.approx(np.array(truth["offset_g"]), abs=1e-4)
    again = json.loads(run(capsys, "fit", windows, "--json").out)
    assert again["calibration"]["gain"] == report["calibration"]["gain"]
