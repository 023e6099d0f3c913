"""A sensor that changes while it records: in the report, in the values, and in the table of a study."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from accelcal_cli.cli.main import cli
from tests.cli.run import assert_one_line, nightly, run, told
from tests.recordings import GAIN, LSB_PER_G, OFFSET_G, directions, write_raw

RATE_HZ, HOURS, HOUR = 0.5, 24, 1800
STEP_G = np.array([0.012, -0.010, 0.012])


def long_raw(path: Path, course: np.ndarray | float = 0.0) -> Path:
    """A day at half a hertz from midnight on, with a new posture every ten minutes.

    Args:
        course: (n, 1) how much of STEP_G is added to the offsets, sample by sample.
    """
    poses = np.repeat(directions(6 * HOURS), HOUR // 6, axis=0)
    raw = poses @ np.linalg.inv(GAIN).T - OFFSET_G + course * STEP_G
    noise = 0.003 * np.random.RandomState(4).standard_normal(raw.shape)
    write_raw(path, np.rint((raw + noise) * LSB_PER_G).astype(np.int16))
    layout = path.with_name(path.stem + ".layout.toml")
    layout.write_text(layout.read_text().replace("rate_hz = 25.0", f"rate_hz = {RATE_HZ}"))
    return path


def jumping(path: Path) -> Path:
    """The offsets change at two in the afternoon."""
    return long_raw(path, (np.arange(HOURS * HOUR) >= 14 * HOUR)[:, None])


def drifting(path: Path) -> Path:
    """The offsets change from beginning to end."""
    return long_raw(path, np.linspace(0, 1.5, HOURS * HOUR)[:, None])


def calibrated(path: Path, *words: object) -> dict[str, Any]:
    report: dict[str, Any] = json.loads(run("calibrate", path, "--json", "--force", *words).out)
    return report


def still_errors_mg(path: Path) -> np.ndarray:
    """| |a| - 1 g | of each posture's ten minutes, without their ends."""
    table = pq.read_table(path)
    xyz = np.stack([table[name].to_numpy() for name in "xyz"], axis=1).reshape(-1, HOUR // 6, 3)
    errors: np.ndarray = 1000 * np.abs(np.linalg.norm(xyz[:, 5:-5].mean(axis=1), axis=1) - 1)
    return errors


@pytest.fixture(scope="module")
def jumped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording that jumps, its report and values, and its windows."""
    folder = tmp_path_factory.mktemp("jumped")
    recording = jumping(folder / "jumps.raw")
    cli.main(["calibrate", str(recording), "--windows", str(folder / "all.parquet")], standalone_mode=False)
    return folder


def test_a_step_in_the_offsets_is_told_and_followed(jumped: Path) -> None:
    report = json.loads((jumped / "jumps.calibration.json").read_text())
    change = report["change"]
    assert (change["kind"], change["at"]) == ("step", "2024-03-04T14:00:00.000000")
    assert change["offset_mg"] == pytest.approx((12, -10, 12), abs=1)
    text = told(report, "sensor_changed")
    assert "its offsets jump at 2024-03-04T14:00:00," in text and text.endswith("The calibration follows it.")
    course = report["calibration"]["course"]
    assert (course["between"], [knot["sample"] for knot in course["knots"]]) == ("jumps", [0, 14 * HOUR])
    assert still_errors_mg(jumped / "jumps.calibrated.parquet").mean() < 0.7
    assert report["calibration_error_mg"]["mean"] < 1.5


def test_never_only_tells(tmp_path: Path) -> None:
    report = calibrated(jumping(tmp_path / "jumps.raw"), "--recalibrate", "never")
    assert report["change"]["kind"] == "step" and report["calibration"]["course"] is None
    (change,) = [one["values"] for one in report["cautions"] if one["code"] == "sensor_changed"]
    assert change["followed"] is False and change["constant_mg"] > 2 * change["changing_mg"]
    assert "one calibration for all of the recording leaves" in told(report, "sensor_changed")
    assert still_errors_mg(tmp_path / "jumps.calibrated.parquet").mean() > 3


def test_a_drift_is_followed_on_a_line(tmp_path: Path) -> None:
    report = calibrated(drifting(tmp_path / "drifts.raw"))
    assert (report["change"]["kind"], report["change"]["at"]) == ("drift", None)
    assert report["change"]["offset_mg"] == pytest.approx((18, -15, 18), abs=1)
    course = report["calibration"]["course"]
    assert (course["between"], [knot["sample"] for knot in course["knots"]]) == ("lines", [0, 24 * HOUR])
    assert still_errors_mg(tmp_path / "drifts.calibrated.parquet").mean() < 0.7


@pytest.mark.parametrize("made", [jumping, nightly(drifting)])
def test_the_length_of_chunks_makes_no_difference(tmp_path: Path, made: Any) -> None:
    path = made(tmp_path / "a.raw")
    first = calibrated(path)
    table = pq.read_table(tmp_path / "a.calibrated.parquet")
    again = calibrated(path, "--chunk-samples", "499")
    for section in (
        "calibration", "change", "reason", "values", "cautions", "holdout", "calibration_error_mg",
    ):  # fmt: skip
        assert again[section] == first[section], section
    assert pq.read_table(tmp_path / "a.calibrated.parquet").equals(table)


def test_a_sensor_that_stays_as_it_is_is_said_to(tmp_path: Path) -> None:
    report = calibrated(long_raw(tmp_path / "same.raw"), "--report-only")
    assert report["change"]["kind"] == "none" and "changes" not in report["message"]
    assert report["calibration"]["course"] is None
    assert report["change"]["holdout"]["stretches"] == 24
    assert report["change"]["holdout"]["constant_mg"] < 1.5


def test_its_own_coefficients_give_the_same_values_again(jumped: Path, tmp_path: Path) -> None:
    path, report = jumped / "jumps.raw", jumped / "jumps.calibration.json"
    assert run("verify", report, path, "--values").code == 0
    assert run("apply", "--coefficients", report, path, "-d", tmp_path).code == 0
    tables = [pq.read_table(folder / "jumps.calibrated.parquet") for folder in (jumped, tmp_path)]
    assert tables[0].equals(tables[1])


def test_what_is_fitted_without_misalignment_follows_too_but_no_other_tool_can(jumped: Path) -> None:
    path = jumped / "jumps.calibration.json"
    report = json.loads(path.read_text())
    simpler = report["without_misalignment"]
    assert simpler["calibration"]["course"] == report["calibration"]["course"] is not None
    assert simpler["holdout"]["before_mg"] == report["holdout"]["before_mg"]
    assert simpler["holdout"]["after_mg"]["mean"] > report["holdout"]["after_mg"]["mean"]
    ran = run("export", path, "--to", "ggir")
    assert_one_line(ran, "follows a sensor that changed while it recorded", "--recalibrate never", code=2)
    shown = json.loads(run("export", path, "--to", "json").out)
    assert shown["without_misalignment"] == simpler


def test_another_recording_does_not_get_them(jumped: Path, tmp_path: Path) -> None:
    other, report = long_raw(tmp_path / "other.raw"), jumped / "jumps.calibration.json"
    ran = run("apply", "--coefficients", report, other, "-d", tmp_path / "out", "--any-device")
    assert_one_line(ran, "follow a sensor that changed", "--recalibrate never", code=2)


def test_windows_are_put_right_too(jumped: Path) -> None:
    held = pq.read_table(jumped / "all.parquet").to_pandas()
    late = held[held["first_sample"] >= 14 * HOUR]
    assert abs((late["calibrated_g"] - 1).mean()) < 2e-4
    assert abs((held["calibrated_g"] - 1).mean()) < 2e-4


def knot(sample: int, stretch: float = 1 << 29, shift: float = 0) -> dict[str, Any]:
    return {"sample": sample, "fixed_point": {"stretch": [stretch] * 3, "shift": [shift] * 3}}


def test_a_damaged_course_is_refused(jumped: Path, tmp_path: Path) -> None:
    path, report = jumped / "jumps.raw", tmp_path / "jumps.calibration.json"
    held = json.loads((jumped / report.name).read_text())
    whole = held["calibration"]["course"]["knots"][0]
    for change in (
        {"between": "curves"},
        {"knots": []},
        {"knots": [whole | {"sample": 5}]},
        {"knots": [whole, whole]},
        {"knots": [whole | knot(0, stretch=5)]},
        {"knots": [whole | knot(0, shift=1 << 30)]},
        {"knots": [whole | knot(0, shift=0.5)]},
        {"knots": [whole | knot(0, shift=1000)]},
        {"knots": [knot(0)]},
    ):
        course = held["calibration"]["course"] | change
        report.write_text(json.dumps(held | {"calibration": held["calibration"] | {"course": course}}))
        ran = run("apply", "--coefficients", report, path, "-d", tmp_path / "out")
        assert_one_line(ran, "is a damaged report: calibration.course", code=3)


def test_profile_paper_does_not_follow(tmp_path: Path) -> None:
    path = jumping(tmp_path / "jumps.raw")
    ran = run("calibrate", path, "--profile", "paper", "--recalibrate", "auto")
    assert_one_line(ran, "does not go with --profile paper", code=2)
    report = calibrated(path, "--profile", "paper", "--report-only")
    assert report["change"] is None and report["settings"]["recalibrate"] == "never"


def test_the_table_of_a_study_has_it(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    jumping(folder / "jumps.raw")
    long_raw(folder / "same.raw")
    run("study", folder, "-d", tmp_path / "out", "--report-only", "-j", "1")
    rows = list(csv.DictReader((tmp_path / "out" / "study.csv").read_text().splitlines()))
    assert [(row["path"], row["change"], row["change_at"]) for row in rows] == [
        ("jumps.raw", "step", "2024-03-04T14:00:00.000000"),
        ("same.raw", "none", ""),
    ]
    assert float(rows[0]["change_mg"]) == pytest.approx(19.6, abs=1)


def test_a_change_is_followed_without_a_posterior_too(tmp_path: Path) -> None:
    """Where none can bear it out, held-out stretches of time decide alone."""
    change = calibrated(jumping(tmp_path / "a.raw"), "--prior", "none")["change"]
    assert (change["kind"], change["probability"]) == ("step", None) and change["at"].startswith(
        "2024-03-04T14"
    )
