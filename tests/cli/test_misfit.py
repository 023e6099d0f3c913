"""A sensor whose response is bent: with the square it is corrected, with the cube it is said."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.run import run
from tests.recordings import LSB_PER_G, directions, still_counts, write_raw

BEND = 0.02


def recording(path: Path, bend: float, power: int = 3) -> Path:
    """Sixty postures of a sensor that measures v + bend v^power in place of v [g]."""
    g = still_counts(directions(60)) / LSB_PER_G
    return write_raw(path, np.rint((g + bend * g**power) * LSB_PER_G).astype(np.int16))


def report_of(*words: object) -> dict[str, Any]:
    report: dict[str, Any] = json.loads(run(*words, "--json").out)
    return report


def test_a_bend_with_the_square_is_corrected(tmp_path: Path) -> None:
    """In the report, the Parquet, and for another recording of the sensor."""
    path, windows = recording(tmp_path / "bent.raw", BEND, power=2), tmp_path / "windows.csv"
    report = report_of("calibrate", path, "--windows", windows)
    assert report["calibration"]["bend"]["quadratic"] == pytest.approx([-BEND] * 3, abs=0.0015)
    assert not any(one["found"] for one in report["misfits"]) and report["outcome"] == "calibrated"
    assert report["holdout"]["after_mg"]["mean"] < 1
    assert report_of("fit", windows)["misfits"] == report["misfits"]
    assert run("verify", tmp_path / "bent.calibration.json", path).code == 0
    other = recording(tmp_path / "other.raw", BEND, power=2)
    words = ("apply", "--coefficients", tmp_path / "bent.calibration.json", other, "--any-device")
    assert report_of(*words)["holdout"]["after_mg"]["mean"] < 1


def test_a_bend_with_the_cube_is_said(tmp_path: Path) -> None:
    report = report_of("calibrate", recording(tmp_path / "bent.raw", BEND))
    cubic, *others = report["misfits"]
    assert cubic["kind"] == "cubic" and cubic["found"] and not any(one["found"] for one in others)
    assert cubic["size"] == pytest.approx([100 * BEND] * 3, abs=0.5)
    assert [one["values"]["kind"] for one in report["cautions"] if one["code"] == "misfit"] == ["cubic"]


def test_a_straight_response_is_not_called_bent(tmp_path: Path) -> None:
    recording(tmp_path / "straight.raw", 0.0)
    recording(tmp_path / "bent.raw", BEND)
    run("study", tmp_path, "-d", tmp_path / "out", "-j", 1, "--report-only", "-q")
    with (tmp_path / "out/study.csv").open() as file:
        rows = {row["path"]: row for row in csv.DictReader(file)}
    assert {name: row["misfits"] for name, row in rows.items()} == {
        "bent.raw": "cubic",
        "straight.raw": "none",
    }
    report = json.loads((tmp_path / "out/straight.calibration.json").read_text())
    assert all(one["code"] != "misfit" for one in report["cautions"]) and len(report["misfits"]) == 2


def test_nobody_looks_without_a_prior(tmp_path: Path) -> None:
    path = recording(tmp_path / "bent.raw", BEND)
    assert report_of("calibrate", path, "--prior", "none")["misfits"] is None
