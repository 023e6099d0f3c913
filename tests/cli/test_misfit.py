"""A sensor whose response is bent: said, counted, and told apart from one that is straight."""

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


def recording(path: Path, bend: float) -> Path:
    """Sixty postures of a sensor that measures v + bend v^2 in place of v [g]."""
    g = still_counts(directions(60)) / LSB_PER_G
    return write_raw(path, np.rint((g + bend * g * g) * LSB_PER_G).astype(np.int16))


def report_of(*words: object) -> dict[str, Any]:
    report: dict[str, Any] = json.loads(run(*words, "--json").out)
    return report


def test_a_bend_is_said_and_counted(tmp_path: Path) -> None:
    path, windows = recording(tmp_path / "bent.raw", BEND), tmp_path / "windows.csv"
    report = report_of("calibrate", path, "--windows", windows)
    quadratic, *others = report["misfits"]
    assert quadratic["kind"] == "quadratic" and quadratic["found"]
    assert quadratic["size"] == pytest.approx([100 * BEND] * 3, abs=0.15)
    assert not any(one["found"] for one in others)
    assert [one["values"]["kind"] for one in report["cautions"] if one["code"] == "misfit"] == ["quadratic"]
    assert report["outcome"] == "calibrated"
    worst_mg = report["calibration_error_mg"]["worst_direction"]
    assert worst_mg == pytest.approx(quadratic["largest_mg"], rel=0.1)
    assert report_of("fit", windows)["misfits"] == report["misfits"]
    assert run("verify", tmp_path / "bent.calibration.json", path).code == 0


def test_a_straight_response_is_not_called_bent(tmp_path: Path) -> None:
    recording(tmp_path / "straight.raw", 0.0)
    recording(tmp_path / "bent.raw", BEND)
    run("study", tmp_path, "-d", tmp_path / "out", "-j", 1, "--report-only", "-q")
    with (tmp_path / "out/study.csv").open() as file:
        rows = {row["path"]: row for row in csv.DictReader(file)}
    assert {name: row["misfits"] for name, row in rows.items()} == {
        "bent.raw": "quadratic",
        "straight.raw": "none",
    }
    report = json.loads((tmp_path / "out/straight.calibration.json").read_text())
    assert all(one["code"] != "misfit" for one in report["cautions"]) and len(report["misfits"]) == 3


def test_nobody_looks_without_a_prior(tmp_path: Path) -> None:
    path = recording(tmp_path / "bent.raw", BEND)
    assert report_of("calibrate", path, "--prior", "none")["misfits"] is None
