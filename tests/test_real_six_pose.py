"""A real session on six faces (data/SOURCES.md, Ferraris), and real ones that are none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.cli.run import assert_one_line, run
from tests.schema import check_report
from tests.six_pose.known import stacked
from tests.six_pose.made import UP, write_list
from tests.test_real_recordings import NILSPOD

Capture = pytest.CaptureFixture[str]
RATE_HZ = 102.4
LENGTH = 102
G = 9.80665
RANGES = {"+x": (5, 12), "-x": (16, 23), "+y": (27, 33), "-y": (37, 41), "+z": (44, 49), "-z": (53, 58)}
"""Picked by eye from the plotted session: windows of 102 samples in which nothing moves."""


def samples(real_data: Path, kind: str = "acc") -> np.ndarray:
    frame = pd.read_csv(real_data / "imu" / "ferraris_session.csv")
    return frame[[f"{kind}_{axis}" for axis in "xyz"]].to_numpy()


def picked(values: np.ndarray) -> dict[str, np.ndarray]:
    return {face: values[LENGTH * first : LENGTH * last] for face, (first, last) in RANGES.items()}


def calibrated(capsys: Capture, real_data: Path, folder: Path, *words: object) -> dict[str, Any]:
    path = real_data / "imu" / "ferraris_session.csv"
    options = ("--rate", RATE_HZ, "--unit", "m/s2", "-d", folder, "--json", "-q")
    ran = run(capsys, "six-pose", path, *options, *words)
    assert ran.code == 0, ran.err
    report = json.loads(ran.out)
    check_report(report)
    return report


def by_list(capsys: Capture, real_data: Path, folder: Path) -> dict[str, Any]:
    lines = [
        f"{LENGTH * first / RATE_HZ:.6f},{LENGTH * last / RATE_HZ:.6f},{','.join(map(str, UP[face]))}"
        for face, (first, last) in RANGES.items()
    ]
    return calibrated(capsys, real_data, folder, "--poses", write_list(folder / "poses.csv", lines))


def test_listed_ranges_give_what_numpy_gives(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    report = by_list(capsys, real_data, tmp_path)
    means = np.array([part.mean(axis=0) for part in picked(samples(real_data)).values()]) / G
    k, o = stacked(np.array(list(UP.values()), float), means)
    np.testing.assert_allclose(report["known_orientations"]["K"], k, atol=1e-7)
    np.testing.assert_allclose(report["known_orientations"]["O"], o, atol=1e-7)
    np.testing.assert_allclose(report["calibration"]["gain"], np.linalg.inv(k), atol=1e-7)


def test_the_faces_are_found_and_agree_with_the_picked_ranges(
    real_data: Path, tmp_path: Path, capsys: Capture
) -> None:
    report = calibrated(capsys, real_data, tmp_path)
    poses, known = report["poses"], report["known_orientations"]
    assert [pose["face"] for pose in poses[1:7]] == list(RANGES)
    assert len(poses) == 12
    assert known["orientations"] == 6
    assert report["holdout"]["before_mg"]["mean"] > 50
    assert report["holdout"]["after_mg"]["mean"] < 4
    assert known["holdout_vector_mg"]["after"]["mean"] < 6.5
    assert known["repeat_spread_mg"] < 4
    errors = known["standard_errors"]
    listed = by_list(capsys, real_data, tmp_path)["known_orientations"]
    assert np.all(np.abs(np.subtract(known["K"], listed["K"])) < 3 * np.array(errors["K"]))
    assert np.all(np.abs(np.subtract(known["O"], listed["O"])) < 3 * np.array(errors["O"]))


def test_four_faces_of_it_unchecked_are_what_numpy_gives_and_fair_on_the_others(
    real_data: Path, tmp_path: Path, capsys: Capture
) -> None:
    faces = ("+x", "-x", "+y", "+z")
    lines = [
        f"{LENGTH * RANGES[face][0] / RATE_HZ:.6f},{LENGTH * RANGES[face][1] / RATE_HZ:.6f},"
        f"{','.join(map(str, UP[face]))}"
        for face in faces
    ]
    listed = write_list(tmp_path / "poses.csv", lines)
    report = calibrated(capsys, real_data, tmp_path, "--poses", listed, "--unchecked")
    means = {face: part.mean(axis=0) / G for face, part in picked(samples(real_data)).items()}
    k, o = stacked(np.array([UP[face] for face in faces], float), np.array([means[face] for face in faces]))
    known = report["known_orientations"]
    np.testing.assert_allclose(known["K"], k, atol=1e-7)
    np.testing.assert_allclose(known["O"], o, atol=1e-7)
    assert report["holdout"] is known["holdout_vector_mg"] is None
    for face in ("-y", "-z"):
        a = np.linalg.solve(known["K"], means[face] - known["O"])
        assert 1000 * np.linalg.norm(a - UP[face]) < 20
        assert 1000 * np.linalg.norm(means[face] - UP[face]) > 40


def test_cut_into_one_file_a_face_it_gives_the_same(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    folder, names = tmp_path / "faces", {}
    folder.mkdir()
    for face, part in picked(samples(real_data)).items():
        names[face] = f"{'m' if face[0] == '-' else 'p'}{face[1]}.csv"
        frame = pd.DataFrame(np.vstack([part[-1:] + 9, part, part[:1] - 9]), columns=list("xyz"))
        frame.to_csv(folder / names[face], index=False)
    lines = [f"{name},{1 / RATE_HZ},99,{','.join(map(str, UP[face]))}" for face, name in names.items()]
    listed = write_list(tmp_path / "poses.csv", lines, "file,start,end,ax,ay,az")
    words = ("--rate", RATE_HZ, "--unit", "m/s2", "--poses", listed, "--json", "-q")
    ran = run(capsys, "six-pose", folder, *words)
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    check_report(found)
    whole = by_list(capsys, real_data, tmp_path)
    held = [one["known_orientations"]["holdout_vector_mg"]["after"]["mean"] for one in (found, whole)]
    assert held[0] == pytest.approx(held[1], abs=0.5)
    np.testing.assert_allclose(found["known_orientations"]["K"], whole["known_orientations"]["K"], atol=5e-4)


def test_the_ferraris_method_finds_the_same_matrix(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    """imucal computes each column of K from a pair of faces, as least squares over six faces does; its
    offset of an axis comes from that axis' own pair alone, ours from all six.
    """
    imucal = pytest.importorskip("imucal.ferraris_calibration")
    turns = {"rot": (LENGTH * 66, LENGTH * 70)}
    parts: dict[str, np.ndarray] = {}
    for kind in ("acc", "gyr"):
        values = samples(real_data, kind)
        for face, part in picked(values).items():
            parts[f"{kind}_{face[1]}_{'p' if face[0] == '+' else 'a'}"] = part
        parts |= {f"{kind}_{axis}_rot": values[slice(*turns["rot"])] for axis in "xyz"}
    regions = imucal.FerrarisSignalRegions(**parts)
    theirs = imucal.FerrarisCalibration(grav=G).compute(
        regions, RATE_HZ, from_acc_unit="m/s^2", from_gyr_unit="deg/s"
    )
    ours = by_list(capsys, real_data, tmp_path)["known_orientations"]
    np.testing.assert_allclose(ours["K"], theirs.K_a @ theirs.R_a, atol=1e-7)
    np.testing.assert_allclose(ours["O"], theirs.b_a / G, atol=0.003)


def test_whole_revolutions_give_the_gyroscope_that_the_ferraris_method_gives(
    real_data: Path, tmp_path: Path, capsys: Capture
) -> None:
    """imucal is given the revolutions as picked from the plotted session; they are found here."""
    imucal = pytest.importorskip("imucal.ferraris_calibration")
    turns = {"x": (66, 70), "y": (79, 83), "z": (90, 94)}
    parts: dict[str, np.ndarray] = {}
    for kind in ("acc", "gyr"):
        values = samples(real_data, kind)
        for face, part in picked(values).items():
            parts[f"{kind}_{face[1]}_{'p' if face[0] == '+' else 'a'}"] = part
        for axis, (first, last) in turns.items():
            parts[f"{kind}_{axis}_rot"] = values[LENGTH * first : LENGTH * last]
    theirs = imucal.FerrarisCalibration(grav=G, expected_angle=-360).compute(
        imucal.FerrarisSignalRegions(**parts), RATE_HZ, from_acc_unit="m/s^2", from_gyr_unit="deg/s"
    )
    ours = calibrated(capsys, real_data, tmp_path, "-R", "gyro_unit=deg/s")["gyroscope"]
    assert (ours["outcome"], ours["reason"]) == ("calibrated", "gyroscope_by_revolutions")
    assert ours["values"]["revolutions"] == 3 and ours["values"]["turns"] == 8
    scale = np.diag(np.linalg.inv(theirs.K_g @ theirs.R_g))
    np.testing.assert_allclose(np.diag(ours["scale"]), scale, rtol=0.005)
    np.testing.assert_allclose(ours["bias_dps"], theirs.b_g, atol=0.3)
    assert ours["holdout_deg"]["after"] < 0.5 * ours["holdout_deg"]["before"]


@pytest.mark.parametrize("name", ["nilspod_84965c0.bin", "nilspod_92338c81.bin"])
def test_a_device_held_by_hand_is_refused(
    real_data: Path, tmp_path: Path, capsys: Capture, name: str
) -> None:
    path = real_data / "imu" / name
    layout = tmp_path / "nilspod.toml"
    layout.write_text(NILSPOD.format(header=path.stat().st_size % 20))
    ran = run(capsys, "six-pose", path, "--layout", layout, "-d", tmp_path, "--json", "-q")
    assert ran.code == 4
    assert_one_line(ran, "the poses disagree")
    report = json.loads(ran.out)
    check_report(report)
    assert report["known_orientations"]["missing_faces"] == []
    assert report["known_orientations"]["holdout_vector_mg"]["after"]["mean"] > 100


def test_rest_in_other_orientations_is_no_session(real_data: Path, tmp_path: Path, capsys: Capture) -> None:
    path = real_data / "imu" / "mpu9150_imu0.log"
    ran = run(capsys, "six-pose", path, "--columns", "0,1,2", "--rate", 100, "-d", tmp_path)
    assert ran.code == 4
    assert_one_line(ran, "poses found (", "missing: ")
    assert list(tmp_path.iterdir()) == []
