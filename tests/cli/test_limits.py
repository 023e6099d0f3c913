"""`--max-error` and `--strict`: what counts as a usable calibration."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from accelcal_cli.output.sentences import SENTENCES
from tests.cli.run import run
from tests.cli.test_fit import rows, sensed
from tests.recordings import directions

NAMES = ("points.csv", "points.json")


@pytest.fixture
def points(tmp_path: Path) -> Path:
    """Points of 40 orientations, whose calibration has an error of about half a mg."""
    return rows(tmp_path / NAMES[0], sensed(directions(40), noise_g=0.002))


def test_verdicts_1_the_limit_is_the_users(points: Path) -> None:
    usual = json.loads(run("fit", points, "--json").out)
    low_mg, high_mg = usual["calibration_error_mg"]["ci95"]
    assert (usual["outcome"], usual["settings"]["max_error_mg"]) == ("calibrated", 10.0)
    above = json.loads(run("fit", points, "--json", "--max-error", high_mg).out)
    assert (above["outcome"], above["calibration"]) == ("calibrated", usual["calibration"])
    assert above["settings"]["max_error_mg"] == high_mg
    below = json.loads(run("fit", points, "--json", "--max-error", low_mg).out)
    assert below["outcome"] in ("provisional", "refused")
    strict = run("fit", points, "--json", "--strict", "--max-error", low_mg)
    report = json.loads(strict.out)
    assert (strict.code, report["outcome"], report["calibration"]) == (4, "refused", None)
    assert report["reason"] in SENTENCES and report["settings"]["strict"] is True
