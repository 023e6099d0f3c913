"""Simulated recordings through the whole chain: what the ladder makes of misalignment, or of its absence."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tests.cli.run import run


def simulated(folder: Path, *words: object) -> Path:
    made = ("simulate", folder / "day", "--days", 0.25, "--rate", 50, "--seed", 11, "-q", *words)
    assert run(*made, "--format", "raw", "--no-temperature").code == 0
    return folder / "day.raw"


def report(path: Path, folder: Path, *words: object) -> dict:
    return json.loads(run("calibrate", path, "-d", folder, "--report-only", "--json", *words).out)


def test_nine_parameters_cost_nothing_where_six_would_do(tmp_path: Path) -> None:
    path = simulated(tmp_path, "--misalignment", 0)
    six = report(path, tmp_path / "6", "--model", "6")
    nine = report(path, tmp_path / "9", "--model", "9")
    assert nine["holdout"]["after_mg"]["mean"] < six["holdout"]["after_mg"]["mean"] + 0.02
    truth = json.loads((tmp_path / "day.truth.json").read_text())["sensor"]
    assert np.abs(np.array(nine["calibration"]["gain"]) - np.array(truth["gain"])).max() < 2e-4
    assert "as asked for" in nine["message"]


def test_misalignment_is_found_where_there_is_some(tmp_path: Path) -> None:
    found = report(simulated(tmp_path), tmp_path / "auto")
    errors = {trial["model"]: trial["after_mg"] for trial in found["models_tried"]}
    assert found["calibration"]["model"] == "9"
    assert errors["9"] < errors["6"] / 10
