"""Reports of `accelcal fit`: applied to a recording, and verified."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.run import assert_one_line, run, told, verify
from tests.device_recordings import edit, rest, week
from tests.recordings import RATE_HZ, SECONDS, directions


@pytest.fixture
def fitted(tmp_path: Path) -> Path:
    """The report of a fit to the means of a device's still stretches."""
    values, _ = rest(directions(40))
    means = values.reshape(40, round(SECONDS * RATE_HZ), 3).mean(axis=1)
    rows = (",".join(f"{value:.9f}" for value in row) for row in means.tolist())
    (tmp_path / "points.csv").write_text("x,y,z\n" + "\n".join(rows) + "\n")
    report = tmp_path / "points.calibration.json"
    assert run("fit", tmp_path / "points.csv", "-o", report).code == 0
    return report


def test_its_coefficients_are_applied_where_the_user_says_so(tmp_path: Path, fitted: Path) -> None:
    other = week(tmp_path / "other.raw", seed=2, poses=15)
    ran = run("apply", "--coefficients", fitted, other)
    assert_one_line(ran, "do not say which device they belong to", "--any-device", code=2)
    ran = run("apply", "--coefficients", fitted, other, "--any-device")
    assert (ran.code, ran.err) == (0, "")
    report = json.loads((tmp_path / "other.calibration.json").read_text())
    assert report["calibration"] == json.loads(fitted.read_text())["calibration"]
    assert report["holdout"]["after_mg"]["mean"] < 0.5
    assert "device unknown" in report["message"] and told(report, "other_device") in report["message"]
    assert verify(tmp_path / "other.calibration.json", other)[0].code == 0


def test_it_is_verified_by_its_table(tmp_path: Path, fitted: Path) -> None:
    points = tmp_path / "points.csv"
    ran, found = verify(fitted, points)
    assert (ran.code, found["differs"], found["settings_assumed"]) == (0, [], [])
    assert verify(fitted, points, "--values")[0].code == 2
    edit(fitted, lambda held: held["holdout"].update(points=41))
    assert verify(fitted, points)[1]["differs"] == ["holdout.points"]
    points.write_text(points.read_text() + "0,0,1\n")
    assert verify(fitted, points)[0].code == 2
