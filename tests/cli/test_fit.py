"""`accelcal fit`: points of other tools, judged like a recording."""

from __future__ import annotations

import json
from collections.abc import Iterable
from math import radians, sin
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.output.sentences import begun_small
from tests.cli.run import codes, run, told
from tests.recordings import GAIN, OFFSET_G, directions
from tests.schema import check_report


def rows(path: Path, g: np.ndarray, head: str = "x,y,z", more: Iterable[str] = ()) -> Path:
    ends = [f",{end}" for end in more] or [""] * len(g)
    lines = [f"{x:.9f},{y:.9f},{z:.9f}{end}" for (x, y, z), end in zip(g, ends, strict=True)]
    path.write_text("\n".join([head, *lines]) + "\n")
    return path


def sensed(poses: np.ndarray, noise_g: float = 0.0005, seed: int = 1) -> np.ndarray:
    exact = poses @ np.linalg.inv(GAIN).T - OFFSET_G
    return exact + noise_g * np.random.RandomState(seed).randn(*exact.shape)


def test_points_are_fitted_and_judged(tmp_path: Path) -> None:
    path = rows(tmp_path / "points.csv", sensed(directions(120)))
    ran = run("fit", path, "--json")
    report = json.loads(ran.out)
    check_report(report)
    assert (ran.code, report["outcome"], report["calibration"]["model"]) == (0, "calibrated", "9")
    assert np.abs(np.array(report["calibration"]["gain"]) - GAIN).max() < 5e-4
    assert np.abs(np.array(report["calibration"]["offset_g"]) - OFFSET_G).max() < 5e-4
    assert report["holdout"]["after_mg"]["mean"] < 0.6
    assert report["recording"]["format"] == "points" and report["recording"]["samples"] == 120
    assert sorted(tmp_path.iterdir()) == [path], "nothing is written unless asked for"


def test_the_line_is_that_of_calibrate(tmp_path: Path) -> None:
    path = rows(tmp_path / "points.csv", sensed(directions(120)))
    out = tmp_path / "points.json"
    ran = run("fit", path, "-o", out)
    fields = ran.lines[0].split("\t")
    assert (fields[0], fields[1], fields[2], fields[6]) == (str(path), "calibrated", "9", str(out))
    report = json.loads(out.read_text())
    assert fields[4] == f"{report['holdout']['after_mg']['mean']:.3f}"
    assert report["provenance"]["command"][0] == "accelcal"


def test_the_same_table_gives_the_same_report(tmp_path: Path) -> None:
    path = rows(tmp_path / "points.csv", sensed(directions(80)))
    first, second = (json.loads(run("fit", path, "--json").out) for _ in range(2))
    del first["provenance"], second["provenance"]
    assert first == second


def test_a_foreign_file_is_not_overwritten(tmp_path: Path) -> None:
    path = rows(tmp_path / "points.csv", sensed(directions(80)))
    foreign = tmp_path / "mine.json"
    foreign.write_text("{}")
    ran = run("fit", path, "-o", foreign)
    assert ran.code == 5 and "not written by accelcal" in ran.err
    assert foreign.read_text() == "{}"
    assert run("fit", path, "-o", foreign, "--force").code == 0
    assert "accelcal_version" in foreign.read_text()


def flat(number: int = 60) -> np.ndarray:
    turn = np.linspace(0, 2 * np.pi, number, endpoint=False)
    return np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)


@pytest.mark.parametrize(
    ("g", "code"),
    [
        (flat(), "no_model_tried"),
        (np.tile([[0.0, 0.0, 1.0]], (50, 1)), "too_few_orientations"),
        (9.81 * directions(50), "no_point_near_1_g"),
        (np.empty((0, 3)), "no_points"),
        (directions(60) * np.linspace(0.8, 1.2, 60)[:, None], "no_model_tried"),
    ],
    ids=["rank deficient", "one posture", "far from the sphere", "empty", "no sphere"],
)
def test_points_that_cannot_be_fitted_are_refused(tmp_path: Path, g: np.ndarray, code: str) -> None:
    path = rows(tmp_path / "points.csv", g)
    ran = run("fit", path, "-o", tmp_path / "out.json", "--prior", "none", code=4)
    shown = json.loads(run("fit", path, "--json", "--prior", "none").out)
    assert shown["reason"] == code and begun_small(told(shown, code)) in ran.err and ran.err.count("\n") == 1
    assert ran.lines[0].split("\t")[1:3] == ["refused", "-"]
    assert not (tmp_path / "out.json").exists()


def test_with_a_prior_points_in_a_plane_are_calibrated_provisionally(tmp_path: Path) -> None:
    """Nothing is known of the axis across the plane but what sensors are like: 35 mg of offset and more."""
    ran = run("fit", rows(tmp_path / "points.csv", flat() * 1.02), "--json")
    report = json.loads(ran.out)
    assert (ran.code, report["outcome"]) == (0, "provisional")
    low, high = report["calibration_error_mg"]["ci95"]
    assert (
        high > 3 * low and report["calibration_error_mg"]["mean"] < report["calibration_error_mg"]["before"]
    )
    assert report["values"]["percent"] >= 95
    strict = run("fit", tmp_path / "points.csv", "--strict", "--json")
    refused = json.loads(strict.out)
    assert (strict.code, refused["outcome"], refused["calibration"]) == (4, "refused", None)
    assert codes(refused["advice"])[0] == "omit_strict"
    assert {"code": "rest_on_sides", "values": {"sides": ["-z", "+z"]}} in refused["advice"]


def test_a_value_that_is_no_number_is_an_error_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("x,y,z\n0,0,1\nNaN,0,1\n")
    ran = run("fit", path, "-o", tmp_path / "out.json")
    assert (ran.code, ran.out) == (3, "")
    assert "line 3" in ran.err and "not a number" in ran.err
    assert not (tmp_path / "out.json").exists()


def test_given_postures_are_held_out(tmp_path: Path) -> None:
    names = [f"p{number % 20}" for number in range(120)]
    path = rows(tmp_path / "points.csv", sensed(directions(120)), "x,y,z,posture", names)
    assert json.loads(run("fit", path, "--json").out)["holdout"]["postures"] == 20


def test_the_place_and_the_model_can_be_said(tmp_path: Path) -> None:
    path = rows(tmp_path / "points.csv", sensed(directions(120)))
    report = json.loads(run("fit", path, "--json", "--latitude", 47.5, "--altitude", 300).out)
    assert report["calibration"]["gravity"]["latitude"] == 47.5
    sine, double = sin(radians(47.5)), sin(radians(95.0))
    metres = 9.780327 * (1 + 0.0053024 * sine**2 - 0.0000058 * double**2) - 3.086e-6 * 300
    assert report["calibration"]["gravity"]["local_g"] == pytest.approx(metres / 9.80665, abs=1e-9)
    assert run("fit", path, "--altitude", 300).code == 2
    forced = json.loads(run("fit", path, "--json", "--model", "3").out)
    assert forced["calibration"] is None or forced["calibration"]["model"] == "3"


@pytest.mark.nightly
def test_84_hours_of_a_geneactiv_as_ggir_saw_them(real_data: Path) -> None:
    ran = run("fit", real_data / "points" / "geneactiv_84h_points.csv.gz", "--json")
    report = json.loads(ran.out)
    assert report["calibration"]["model"] == "9T"
    assert report["holdout"]["after_mg"]["mean"] < 2.1
    windows = report["fit"]["windows"]
    assert windows["used"] == 10_958
    assert windows["raw_error_mg"] == pytest.approx(14.89, abs=0.01), "GGIR's own figure before"
    assert windows["after_error_mg"] < 2.294, "GGIR's own figure after, on the same windows"


def still_means(samples: np.ndarray, length: int = 200) -> np.ndarray:
    blocks = samples[: len(samples) // length * length].reshape(-1, length, 3)
    return blocks.mean(axis=1)[(blocks.std(axis=1) < 0.003).all(axis=1)]


def test_static_poses_of_an_xsens_leave_less_than_a_fifth_of_a_mg(real_data: Path, tmp_path: Path) -> None:
    counts = np.loadtxt(real_data / "imu" / "xsens_mti_acc.txt")[:, 1:]
    means = still_means((counts - 32_768) / 4096)
    path = rows(tmp_path / "xsens.csv", means)
    report = json.loads(run("fit", path, "--json").out)
    assert report["calibration"]["model"] == "9"
    assert report["holdout"]["after_mg"]["mean"] < 0.2


def test_a_posture_without_plausible_rows_is_as_if_it_were_not_there(tmp_path: Path) -> None:
    random, found = np.random.RandomState(1), []
    table = [
        (*(1.02 * one + 0.02 + 0.001 * random.randn(3)), f"p{pose:02}")
        for pose, one in enumerate(directions(40))
        for _ in range(3)
    ]
    far = [(3.0, 0.0, 0.0, "p07b")] * 3
    for name, held in (("without", table), ("with", table[:24] + far + table[24:])):
        path = tmp_path / f"{name}.csv"
        path.write_text("x,y,z,posture\n" + "".join(f"{x},{y},{z},{pose}\n" for x, y, z, pose in held))
        found.append(json.loads(run("fit", path, "--json").out))
    for key in (
        "outcome", "calibration", "calibration_error_mg", "holdout", "misfits", "coverage", "models_tried",
    ):  # fmt: skip
        assert found[0][key] == found[1][key], key
