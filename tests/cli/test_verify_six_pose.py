"""Reports of `accelcal six-pose`: made again by `accelcal verify`, and applied by `accelcal apply`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.cli.run import run, verify
from tests.device_recordings import edit
from tests.recordings import directions
from tests.six_pose.made import UP, K, O, sensed, session, six_faces, start_s, write_csv, write_list

Capture = pytest.CaptureFixture[str]


def test_twelve_parameters_give_back_what_the_sensor_sensed(tmp_path: Path, capsys: Capture) -> None:
    """Bragge's K and O made the data; a = K^-1 (z - O) must come out, to the noise of the fit."""
    assert run(capsys, "six-pose", six_faces(tmp_path)).code == 0
    a = np.repeat(directions(15), 300, axis=0)
    raw = sensed(a, seed=7)
    other = write_csv(tmp_path / "other.csv", raw)
    coefficients = tmp_path / "session.calibration.json"
    assert run(capsys, "apply", "--coefficients", coefficients, other).code == 2
    ran = run(capsys, "apply", "--coefficients", coefficients, other, "--any-device")
    assert (ran.code, ran.err) == (0, "")
    assert ran.lines[0].split("\t")[1:3] == ["borrowed", "12"]
    xyz = pd.read_parquet(tmp_path / "other.calibrated.parquet")[["x", "y", "z"]].to_numpy(np.float64)
    np.testing.assert_allclose(xyz, (raw - O) @ np.linalg.inv(K).T, atol=5e-4)
    report = json.loads((tmp_path / "other.calibration.json").read_text())
    assert np.abs(np.triu(np.array(report["calibration"]["gain"]), 1)).max() > 0.005
    found = report["calibration"]
    np.testing.assert_allclose(
        xyz, (raw + found["offset_g"]) @ np.array(found["gain"]).T, rtol=2**-22, atol=1e-6
    )
    assert report["holdout"]["after_mg"]["mean"] < 1
    assert verify(capsys, tmp_path / "other.calibration.json", other, "--values")[0].code == 0


def test_a_session_can_be_applied_to_itself(tmp_path: Path, capsys: Capture) -> None:
    path = six_faces(tmp_path)
    run(capsys, "six-pose", path)
    coefficients, out = tmp_path / "session.calibration.json", tmp_path / "out"
    ran = run(capsys, "apply", "--coefficients", coefficients, path, "-d", out)
    assert (ran.code, ran.lines[0].split("\t")[1]) == (0, "calibrated")
    reports = [json.loads((folder / coefficients.name).read_text()) for folder in (tmp_path, out)]
    assert reports[0]["holdout"] == reports[1]["holdout"]
    assert verify(capsys, out / coefficients.name, path)[0].code == 0


@pytest.mark.parametrize("words", [(), ("--face-degrees", 20, "--latitude", 40, "--segment-seconds", 2)])
def test_a_session_is_verified(tmp_path: Path, capsys: Capture, words: tuple[object, ...]) -> None:
    path = six_faces(tmp_path)
    assert run(capsys, "six-pose", path, *words).code == 0
    report = tmp_path / "session.calibration.json"
    ran, found = verify(capsys, report, path)
    assert (ran.code, found["differs"]) == (0, [])
    assert found["settings_assumed"] == found["settings_unknown"] == []
    assert verify(capsys, report, path, "--values")[0].code == 2
    key = "k_xy"
    edit(report, lambda held: held["calibration"]["fixed_point"]["parameters"].update({key: 12345}))
    edit(report, lambda held: held["poses"][0].update(face="-x"))
    found = verify(capsys, report, path)[1]
    assert found["differs"] == [f"calibration.fixed_point.parameters.{key}", "poses[0].face"]
    assert found["largest_mg"] > 1


def test_a_session_with_a_list_needs_the_list(tmp_path: Path, capsys: Capture) -> None:
    path = write_csv(tmp_path / "listed.csv", session(list(UP)))
    lines = [
        f"{start_s(index) + 1},{start_s(index) + 9},{x},{y},{z}"
        for index, (x, y, z) in enumerate(UP.values())
    ]
    poses = write_list(tmp_path / "list.csv", lines)
    assert run(capsys, "six-pose", path, "--poses", poses).code == 0
    report = tmp_path / "listed.calibration.json"
    assert verify(capsys, report, path)[0].code == 0
    moved = poses.rename(tmp_path / "moved.csv")
    ran, _ = verify(capsys, report, path)
    assert (ran.code, "--poses" in ran.err) == (2, True)
    assert verify(capsys, report, path, "--poses", moved)[0].code == 0
