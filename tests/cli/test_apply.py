"""`accelcal apply`: what it writes, by whose coefficients, and how it judges them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from tests.cli.run import assert_one_line, codes, nightly, report_of, run, run_process, told
from tests.device_recordings import donor, edit, rest, set_coefficients, week, write_device
from tests.recordings import directions, good_csv


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        (50, ()),
        nightly(499, ("--no-temperature",)),
        nightly(10**7, ("--profile", "paper")),
        nightly(1000, ("--model", "6")),
    ],
)
def test_its_own_coefficients_give_the_same_values(
    tmp_path: Path, samples: int, words: tuple[str, ...]
) -> None:
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    usual = np.concatenate([faces, faces, faces, faces, directions(30)])
    poses = directions(120) if "paper" in words else usual
    path = write_device(tmp_path / "a.raw", *rest(poses, warm=True))
    assert run("calibrate", path, *words).code == 0
    report = tmp_path / "a.calibration.json"
    options = ("-d", tmp_path / "out", "--chunk-samples", samples)
    ran = run("apply", "--coefficients", report, path, *options)
    assert (ran.code, ran.err) == (0, "")
    tables = [pq.read_table(folder / "a.calibrated.parquet") for folder in (tmp_path, tmp_path / "out")]
    assert tables[0].equals(tables[1])
    then, now = report_of(report), report_of(tmp_path / "out" / "a.calibration.json")
    assert now["message"].startswith(then["message"])
    for key in ("provenance", "message"):
        del then[key], now[key]
    used = now.pop("coefficients")
    assert codes(now.pop("notes")) == ["own_coefficients"] and then.pop("notes") == []
    assert now == then
    assert used["recording_sha256"] == then["recording"]["sha256"]


def test_another_recording_of_the_device_is_judged_by_its_own_stillness(tmp_path: Path) -> None:
    coefficients = donor(tmp_path)
    other = week(tmp_path / "other.raw", seed=2, poses=25)
    ran = run("apply", "--coefficients", coefficients, other)
    assert (ran.code, ran.err) == (0, "")
    fields = ran.lines[0].split("\t")
    assert fields[:3] == [str(other), "borrowed", "9"]
    assert fields[6] == str(tmp_path / "other.calibrated.parquet")
    report = report_of(tmp_path / "other.calibration.json")
    held = report["holdout"]
    assert held["method"] == "coefficients of another recording: all points are held out"
    assert held["before_mg"]["mean"] > 20
    assert held["after_mg"]["mean"] < 0.5
    assert held["ci95_mg"][0] <= held["after_mg"]["mean"] <= held["ci95_mg"][1]
    assert (fields[3], fields[4]) == tuple(f"{held[key]['mean']:.3f}" for key in ("before_mg", "after_mg"))
    assert (report["fit"]["points"], report["fit"]["after_mg"]) == (held["points"], None)
    assert report["coverage"]["cells"] == held["points"]
    assert report["models_tried"] == []
    given = report_of(coefficients)
    assert report["calibration"] == given["calibration"]
    used = report["coefficients"]
    assert used["path"] == coefficients.name
    where = report["provenance"]["files"]
    assert where == {"recording": str(other), "coefficients": str(coefficients), "folder": str(Path.cwd())}
    assert used["device"]["serial"] == "A1"
    for part in (given["recording"]["path"], used["recording_sha256"][:12], "A1"):
        assert part in report["message"]


def test_the_errors_are_those_of_the_calibrated_data(tmp_path: Path) -> None:
    """One posture a cell: per posture | |mean| - 1 |, from the Parquet file alone."""
    coefficients = donor(tmp_path)
    edit(coefficients, lambda report: set_coefficients(report, np.diag([1.0, 1.0, 1.02]), np.zeros(3)))
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    write_device(tmp_path / "other.raw", rest(faces, seed=2)[0])
    run("apply", "--coefficients", coefficients, tmp_path / "other.raw")
    xyz = pd.read_parquet(tmp_path / "other.calibrated.parquet")[["x", "y", "z"]].to_numpy(np.float64)
    means = xyz.reshape(6, -1, 3).mean(axis=1)
    expected = np.abs(np.linalg.norm(means, axis=1) - 1).mean() * 1000
    held = report_of(tmp_path / "other.calibration.json")["holdout"]
    assert held["postures"] == 6
    assert held["after_mg"]["mean"] == pytest.approx(expected, abs=0.02)


def test_a_full_gain_is_applied_as_calculated_by_hand(tmp_path: Path) -> None:
    """K (v + o) with v + o = (0.75, 0.5, -0.875): every number is exact in binary."""
    coefficients = donor(tmp_path)
    gain = np.array([[1.25, 0.25, 0.0], [0.0, 1.0, -0.125], [0.5, 0.0, 0.75]])
    edit(coefficients, lambda report: set_coefficients(report, gain, np.array([0.25, -0.5, 0.125])))
    tiny = write_device(tmp_path / "tiny.raw", np.tile([0.5, 1.0, -1.0], (300, 1)))
    run("apply", "--coefficients", coefficients, tiny, code=0)
    frame = pd.read_parquet(tmp_path / "tiny.calibrated.parquet")
    assert (frame[["x", "y", "z"]].to_numpy() == [1.0625, 0.609375, -0.28125]).all()
    report = report_of(tmp_path / "tiny.calibration.json")
    assert report["calibration"]["model"] == "12"
    assert report["calibration"]["gain"] == gain.tolist()


def test_a_recording_without_stillness_is_calibrated_all_the_same(tmp_path: Path) -> None:
    coefficients = donor(tmp_path)
    shaken = 0.5 * np.random.RandomState(3).randn(2000, 3)
    ran = run("apply", "--coefficients", coefficients, write_device(tmp_path / "s.raw", shaken), code=0)
    assert ran.lines[0].split("\t")[3:6] == ["-", "-", "-"]
    report = report_of(tmp_path / "s.calibration.json")
    assert report["holdout"] is None
    assert (report["reason"], report["values"]["orientations"]) == ("borrowed", None)
    assert len(pd.read_parquet(tmp_path / "s.calibrated.parquet")) == 2000


@pytest.mark.parametrize(("gain", "code"), [(0.94, "much_left"), (1.3, "worse_here")])
def test_coefficients_that_do_not_fit_have_a_warning(tmp_path: Path, gain: float, code: str) -> None:
    coefficients = donor(tmp_path)
    edit(coefficients, lambda report: set_coefficients(report, gain * np.eye(3), np.zeros(3)))
    other = week(tmp_path / "other.raw", seed=2)
    for _ in range(2):
        ran = run("apply", "-q", "--coefficients", coefficients, other, code=0)
        caution = told(report_of(tmp_path / "other.calibration.json"), code)
        assert_one_line(ran, str(other), "caution", caution)


def test_other_counts_per_g_are_noted(tmp_path: Path) -> None:
    coefficients = donor(tmp_path)
    other = week(tmp_path / "other.raw", seed=2, lsb_per_g=512.0)
    assert run("apply", "--coefficients", coefficients, other).code == 0
    report = report_of(tmp_path / "other.calibration.json")
    note = {"code": "other_counts_per_g", "values": {"here": 512.0, "there": 256.0}}
    assert note in report["notes"]
    assert report["holdout"]["after_mg"]["mean"] < 0.5


def test_a_place_changes_what_rest_measures(tmp_path: Path) -> None:
    """At 60 degrees north rest measures 1.00128 g, so that a sensor calibrated for 1 g is off by 1.28 mg."""
    coefficients, other = donor(tmp_path), week(tmp_path / "other.raw", seed=2)
    words = ("apply", "--coefficients", coefficients, other, "--latitude", 60, "--json")
    held = json.loads(run(*words).out)["holdout"]
    assert held["after_mg"]["mean"] == pytest.approx(1.28, abs=0.1)


def test_a_report_of_apply_passes_the_coefficients_on_with_their_origin(tmp_path: Path) -> None:
    first, second = donor(tmp_path), week(tmp_path / "b.raw", seed=2, serial="B2")
    assert run("apply", "--coefficients", first, second, "--any-device").code == 0
    by_way, third = tmp_path / "b.calibration.json", week(tmp_path / "c.raw", seed=3)
    assert run("apply", "--coefficients", by_way, week(tmp_path / "d.raw", 4, serial="B2")).code == 2
    assert run("apply", "--coefficients", by_way, third).code == 0
    used = report_of(tmp_path / "c.calibration.json")["coefficients"]
    assert (used["path"], used["device"]["serial"]) == (by_way.name, "A1")
    assert used["recording_sha256"] == report_of(first)["recording"]["sha256"]
    ran = run("apply", "--coefficients", by_way, tmp_path / "donor.raw", "-d", tmp_path / "out")
    assert_one_line(ran, "found from this file", code=2)


def test_json_standard_input_and_several_recordings(tmp_path: Path) -> None:
    assert run("calibrate", good_csv(tmp_path)).code == 0
    coefficients = tmp_path / "good.calibration.json"
    data = (tmp_path / "good.csv").read_bytes()
    ran = run_process("apply", "--coefficients", coefficients, "-", "-d", tmp_path / "out", stdin=data)
    assert (ran.code, ran.err) == (0, "")
    assert ran.lines[0].split("\t")[:3] == ["-", "calibrated", "9"]
    words = ("apply", "--coefficients", coefficients, "-d", tmp_path / "many", "--json")
    ran = run(*words, tmp_path / "absent.csv", tmp_path / "good.csv", code=1)
    absent, good = map(json.loads, ran.lines)
    assert good == report_of(tmp_path / "many" / "good.calibration.json")
    assert (absent["outcome"], absent["recording"]["path"]) == ("failed", "absent.csv")
    assert absent["calibration"] is None
