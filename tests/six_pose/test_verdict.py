"""The verdict of `six_pose/solve.py` on known orientations."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import Reason, significant
from accelcal_cli.core.results import Judgement, Outcome
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.six_pose.poses import Session, SixPoseFit, VectorErrors
from accelcal_cli.six_pose.solve import judge_six_pose, six_pose_fit
from tests.six_pose.known import poses_of, session_of
from tests.six_pose.made import UP, K, O, turned

FACES = np.array(list(UP.values()), float)
SETTINGS = PoseSettings()


def judged(
    true: np.ndarray, k: np.ndarray = K, o: np.ndarray = O
) -> tuple[Judgement, VectorErrors, SixPoseFit]:
    session: Session = session_of(poses_of(FACES[: len(true)], true @ k.T + o))
    fit = six_pose_fit(session, SETTINGS)
    return *judge_six_pose(session, fit, SETTINGS), fit


def test_good_poses_are_calibrated_and_the_figures_are_those_of_the_orientations() -> None:
    true = FACES + 0.002 * np.random.default_rng(1).standard_normal((6, 3))
    verdict, vectors, fit = judged(true)
    assert verdict.outcome is Outcome.CALIBRATED
    assert verdict.calibration == fit.calibration
    assert verdict.holdout is not None
    assert (verdict.holdout.points, verdict.holdout.postures) == (6, 6)
    assert verdict.holdout.after.mean == pytest.approx(np.mean([e.held_out_norm for e in fit.errors]))
    assert vectors.after.mean == pytest.approx(np.mean([e.held_out for e in fit.errors]))
    raw = FACES @ K.T + O
    assert vectors.before.mean == pytest.approx(1000 * np.linalg.norm(raw - FACES, axis=1).mean(), abs=3)
    assert [trial.model for trial in verdict.trials] == ["0", "12"]
    assert verdict.coverage.condition_number == pytest.approx(np.sqrt(3))


@pytest.mark.parametrize(
    ("degrees", "outcome"), [(1.5, Outcome.CALIBRATED), (1.9, Outcome.REFUSED), (8.0, Outcome.REFUSED)]
)
def test_one_tilted_face_is_refused_beyond_the_limit(degrees: float, outcome: Outcome) -> None:
    true = FACES.copy()
    true[4] = turned(UP["+z"], degrees, axis=0)
    verdict, vectors, _ = judged(true)
    assert verdict.outcome is outcome
    assert vectors.after.mean == pytest.approx(1000 * np.sin(np.radians(degrees)) * 2 / 3, rel=0.05)
    if outcome is Outcome.REFUSED:
        assert verdict.calibration is None
        assert verdict.reason.code == "poses_disagree"
        assert verdict.reason.values["worst"] in ("+z", "-z")
        assert verdict.reason.values["after_mg"] == significant(vectors.after.mean)
        assert verdict.advice == (Reason("rest_on_faces"),)


def test_lengths_that_disagree_are_refused_below_the_limit_of_the_vectors() -> None:
    true = FACES.copy()
    true[[0, 2, 4]] *= 1.014
    verdict, vectors, _ = judged(true, np.eye(3), np.array([0.1, 0.0, 0.0]))
    assert vectors.after.mean < SETTINGS.max_vector_error_mg
    assert verdict.holdout is not None
    assert verdict.holdout.after.mean > SETTINGS.max_error_mg
    assert verdict.outcome is Outcome.REFUSED


def test_a_sensor_that_is_better_than_the_poses_is_left_alone() -> None:
    true = FACES + 0.004 * np.random.default_rng(1).standard_normal((6, 3))
    verdict, vectors, _ = judged(true, np.eye(3), np.zeros(3))
    assert verdict.outcome is Outcome.ALREADY_GOOD
    assert vectors.after.mean > vectors.before.mean
    assert verdict.calibration is not None
    assert (verdict.calibration.model, verdict.calibration.parameters) == ("0", IDENTITY)
    assert verdict.holdout is not None
    assert verdict.holdout.after == verdict.holdout.before


def test_a_missing_face_is_tolerated_and_what_nothing_checks_is_said() -> None:
    verdict, _, _ = judged(FACES[:5])
    assert verdict.outcome is Outcome.CALIBRATED
    assert verdict.reason.code == "poses_calibrated"
    assert (verdict.reason.values["unchecked"], verdict.reason.values["missing"]) == (["+z"], ["-z"])
    assert verdict.holdout is not None
    assert verdict.holdout.postures == 4
    assert verdict.fit_errors is not None
    assert verdict.fit_errors.postures == 5
