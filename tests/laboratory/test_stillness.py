"""The comparison of rules against reports of single runs, and against the equation."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import Calibration, TemperatureScale
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import PointSet
from accelcal_cli.core.settings import DEFAULT, STILLNESS
from accelcal_cli.laboratory.stillness import RAW, Comparison, compare, on_scale, true_errors
from accelcal_cli.simulate import TrueParameters
from tests.cli.run import assert_one_line, run
from tests.recordings import GAIN, OFFSET_G, good_csv, good_raw, still_counts, worst_errors, write_csv


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    return compare(good_csv(tmp_path_factory.mktemp("good")), ReadOptions(), DEFAULT, 10_000)


def test_every_rule_is_compared_on_the_points_of_every_rule(good: Comparison) -> None:
    errors = good.errors_mg()
    assert list(errors) == [RAW, *STILLNESS]
    assert all(list(row) == list(STILLNESS) for row in errors.values())
    assert good.truth is None


def test_errors_are_those_of_the_equation(good: Comparison) -> None:
    """a = K (v + o) on the other rule's points, weighted within each posture."""
    by, on = good.results[0], good.results[3]
    calibration = by.judgement.calibration
    assert calibration is not None
    a = (calibration.straight(on.points.xyz / ONE) + calibration.offset_g()) @ calibration.gain().T
    off_mg = 1000 * np.abs(np.linalg.norm(a, axis=1) - 1)
    means = [
        np.average(off_mg[on.label == posture], weights=on.points.weights[on.label == posture])
        for posture in range(on.postures)
    ]
    assert good.errors_mg()[by.rule][on.rule] == pytest.approx(np.mean(means), rel=1e-5)
    raw_mg = 1000 * np.abs(np.linalg.norm(on.points.xyz / ONE, axis=1) - 1)
    means = [
        np.average(raw_mg[on.label == posture], weights=on.points.weights[on.label == posture])
        for posture in range(on.postures)
    ]
    assert good.errors_mg()[RAW][on.rule] == pytest.approx(np.mean(means), rel=1e-9)


def test_on_its_own_points_a_calibration_leaves_the_error_of_its_fit(good: Comparison) -> None:
    errors = good.errors_mg()
    for found in good.results:
        assert found.judgement.fit_errors is not None
        assert errors[found.rule][found.rule] == found.judgement.fit_errors.after_mg
        assert errors[RAW][found.rule] == found.judgement.fit_errors.before_mg


def test_stillness_is_counted_in_samples(good: Comparison) -> None:
    """60 rests of 30 s; a 10 s window fits in three times."""
    still = {found.rule: found.still_s for found in good.results}
    assert (still["both"], still["deviation"]) == (1800, 1800)
    assert 1400 < still["adaptive"] < 1800
    assert {found.rule: found.windows for found in good.results}["adaptive"] == 60


def test_a_refused_rule_has_no_row_and_no_points_no_column(tmp_path: Path) -> None:
    poses = np.tile([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], (6, 1))
    path = write_csv(tmp_path / "two.csv", still_counts(poses, noise_g=0.05))
    errors = compare(path, ReadOptions(), DEFAULT, 10_000).errors_mg()
    assert errors["both"] == dict.fromkeys(STILLNESS)
    assert errors[RAW]["both"] is None
    assert errors[RAW]["adaptive"] is not None


def test_points_in_local_g_are_judged_in_local_g(tmp_path: Path) -> None:
    """At the equator rest measures 0.9973 g; parameters in standard g would be 2.7 mg off."""
    made = compare(good_csv(tmp_path), ReadOptions(), replace(DEFAULT, latitude=0.0), 10_000)
    error_mg = made.errors_mg()["both"]["range"]
    assert error_mg is not None and error_mg < 0.2


def test_temperatures_change_their_scale() -> None:
    """25 and 29 C about 27 C by 2 C are -1 and 1; about 21 C by 8 C they are 0.5 and 1."""
    one, tau = np.ones(2, np.int64), np.array([-ONE, ONE])
    points = PointSet(np.zeros((2, 3), np.int64), one, one, tau, TemperatureScale(27_000, 2.0))
    scaled = on_scale(points, TemperatureScale(21_000, 8.0))
    assert scaled.tau is not None and scaled.tau.tolist() == [ONE // 2, ONE]
    assert on_scale(points, None) is points


Capture = pytest.CaptureFixture[str]


def evaluated(capsys: Capture, *words: object) -> list[dict]:
    ran = run(capsys, "evaluate", "stillness", *words, "--json")
    assert ran.code == 0, ran
    return json.loads(ran.out)["rules"]


def with_truth(folder: Path) -> Path:
    path = good_raw(folder)
    known = {"K": GAIN.tolist(), "b": (-OFFSET_G).tolist()}
    (folder / "good.truth.json").write_text(json.dumps(known))
    return path


def test_figures_are_those_of_calibrate(tmp_path: Path, capsys: Capture) -> None:
    path = with_truth(tmp_path)
    raw, *rows = evaluated(capsys, path)
    assert raw["rule"] == "raw"
    assert [row["rule"] for row in rows] == list(STILLNESS)
    for row in rows:
        words = ("--stillness", row["rule"], "--report-only", "--json", "--force")
        report = json.loads(run(capsys, "calibrate", path, *words).out)
        assert (row["outcome"], row["model"]) == (report["outcome"], report["calibration"]["model"])
        assert row["after_mg"] == report["holdout"]["after_mg"]["mean"]
        assert row["before_mg"] == report["holdout"]["before_mg"]["mean"]
        assert (row["points"], row["windows"]) == (report["fit"]["points"], report["fit"]["windows"]["used"])
        assert row["postures"] == report["fit"]["postures"]
        gain, offset_g = worst_errors(report)
        assert row["gain_error"] == pytest.approx(gain, abs=1e-8)
        assert row["offset_error_mg"] == pytest.approx(1000 * offset_g, abs=1e-4)
        assert row["on_points_of_mg"][row["rule"]] == report["fit"]["after_mg"]


@pytest.mark.nightly
def test_csv_is_one_table_of_all_recordings(tmp_path: Path, capsys: Capture) -> None:
    one, two = good_raw(tmp_path, "one.raw"), good_raw(tmp_path, "two.raw")
    ran = run(capsys, "evaluate", "stillness", one, two, "--csv")
    assert ran.code == 0
    table = list(csv.DictReader(ran.lines))
    assert [(row["recording"], row["rule"]) for row in table] == [
        (str(path), rule) for path in (one, two) for rule in ("raw", *STILLNESS)
    ]
    assert [row["on_range_mg"] for row in table[:5]] == [row["on_range_mg"] for row in table[5:]]
    (both,) = [row for row in evaluated(capsys, one) if row["rule"] == "both"]
    assert float(table[1]["after_mg"]) == both["after_mg"]
    assert float(table[1]["on_range_mg"]) == both["on_points_of_mg"]["range"]
    assert table[0]["after_mg"] == table[1]["gain_error"] == ""


@pytest.mark.nightly
def test_text_shows_the_truth_only_where_it_is_known(tmp_path: Path, capsys: Capture) -> None:
    unknown = run(capsys, "evaluate", "stillness", good_raw(tmp_path))
    known = run(capsys, "evaluate", "stillness", with_truth(tmp_path))
    assert (unknown.code, known.code, known.err) == (0, 0, "")
    assert "gain error" in known.out
    assert "gain error" not in unknown.out
    assert all(unknown.out.count(rule) >= 2 for rule in STILLNESS)


def test_one_unreadable_recording_does_not_stop_the_others(tmp_path: Path, capsys: Capture) -> None:
    missing, good = tmp_path / "missing.csv", good_csv(tmp_path)
    ran = run(capsys, "evaluate", "stillness", missing, good)
    assert ran.code == 1
    assert_one_line(ran, "missing.csv")
    assert str(good) in ran.out
    assert run(capsys, "evaluate", "stillness", missing).code == 3


def test_wrong_usage(tmp_path: Path, capsys: Capture) -> None:
    path = good_csv(tmp_path)
    wrong = (("--json", "--csv"), ("--stillness", "both"), ("--profile", "paper"), ("--altitude", 3))
    for words in (*wrong, ("--optimizer", "none")):
        ran = run(capsys, "evaluate", "stillness", path, *words)
        assert ran.code == 2, ran
    assert run(capsys, "evaluate", "nothing").code == 2


def test_offsets_are_compared_at_the_reference_temperature_of_the_truth() -> None:
    """o = 0.25 g at 20 C and 1/64 g per degree: 0.25 + 10 / 64 at 30 C."""
    slope = ONE // 64 * 8
    parameters = (ONE + ONE // 2, ONE, ONE, 0, 0, 0, ONE // 4, 0, 0, slope, 0, 0)
    calibration = Calibration("9T", parameters, TemperatureScale(20_000, 8.0))
    gain, offset_mg = true_errors(calibration, TrueParameters(np.eye(3), np.array([0.25, 0.0625, 0.0]), 30.0))
    assert gain == 0.5
    assert offset_mg == pytest.approx(10_000 / 64, rel=1e-12)
