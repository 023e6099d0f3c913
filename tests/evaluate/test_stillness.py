"""The comparison of rules against reports of single runs, and against the equation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import PointSet, TemperatureScale
from accelcal_cli.core.settings import DEFAULT, STILLNESS
from accelcal_cli.evaluate.stillness import RAW, Comparison, compare, on_scale
from tests.recordings import good_csv, still_counts, write_csv


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
    by, on = good.found[0], good.found[3]
    calibration = by.judgement.calibration
    assert calibration is not None
    a = (on.points.xyz / ONE + calibration.offset_g()) @ calibration.gain().T
    off_mg = 1000 * np.abs(np.linalg.norm(a, axis=1) - 1)
    means = [
        np.average(off_mg[on.label == posture], weights=on.points.weights[on.label == posture])
        for posture in range(on.postures)
    ]
    assert good.errors_mg()[by.rule][on.rule] == pytest.approx(np.mean(means), rel=1e-9)
    raw_mg = 1000 * np.abs(np.linalg.norm(on.points.xyz / ONE, axis=1) - 1)
    means = [
        np.average(raw_mg[on.label == posture], weights=on.points.weights[on.label == posture])
        for posture in range(on.postures)
    ]
    assert good.errors_mg()[RAW][on.rule] == pytest.approx(np.mean(means), rel=1e-9)


def test_on_its_own_points_a_calibration_leaves_the_error_of_its_fit(good: Comparison) -> None:
    errors = good.errors_mg()
    for found in good.found:
        assert found.judgement.fit_errors is not None
        assert errors[found.rule][found.rule] == found.judgement.fit_errors.after_mg
        assert errors[RAW][found.rule] == found.judgement.fit_errors.before_mg


def test_stillness_is_counted_in_samples(good: Comparison) -> None:
    """60 rests of 30 s; a 10 s window fits in three times."""
    still = {found.rule: found.still_s for found in good.found}
    assert (still["both"], still["deviation"]) == (1800, 1800)
    assert 1400 < still["adaptive"] < 1800
    assert {found.rule: found.windows for found in good.found}["adaptive"] == 60


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
    points = PointSet(
        np.zeros((2, 3), np.int64),
        np.ones(2, np.int64),
        np.ones(2, np.int64),
        np.array([-ONE, ONE]),
        TemperatureScale(27_000, 2.0),
    )
    scaled = on_scale(points, TemperatureScale(21_000, 8.0))
    assert scaled.tau is not None and scaled.tau.tolist() == [ONE // 2, ONE]
    assert on_scale(points, None) is points
