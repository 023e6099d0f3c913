"""Poses that leave none to judge a fit by, and accelerations of any size: against numpy and simulation."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.errors import DivergedError, Reason
from accelcal_cli.core.gravity import STANDARD
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.six_pose.solve import (
    condition_number,
    judge_six_pose,
    known_json,
    poses_json,
    six_pose_fit,
    solve,
    uncertainty,
)
from tests.six_pose.known import poses_of, session_of, stacked
from tests.six_pose.made import UP, K, O

FACES = np.array(list(UP.values()), float)
CHECKED = PoseSettings()
SETTINGS = replace(CHECKED, unchecked=True)
FOUR = FACES[[0, 1, 2, 4]]
ANY = np.array(
    [[0, 0, 1], [0, 0, -1], [0, 2, 1], [0, -2, 1], [3, 0, 1], [-3, 0, 1], [0, 5, 1], [1, 2, 2]], float
)


def test_four_poses_give_the_truth_by_hand() -> None:
    """On +x, -x, +y and +z: O is half the sum of the first two, and so on for K's columns."""
    k = np.array([[264, -8, 4], [8, 248, -4], [-4, 8, 260]]) / 256
    o = np.array([8, -16, 12]) / 256
    raw = FOUR @ k.T + o
    np.testing.assert_array_equal((raw[0] + raw[1]) / 2, o)
    np.testing.assert_array_equal(np.stack([raw[0] - o, raw[2] - o, raw[3] - o], axis=1), k)
    found = solve(poses_of(FOUR, raw), STANDARD)
    assert found.k == tuple(tuple(Fraction(value) for value in row) for row in k.tolist())
    assert found.o == tuple(Fraction(value) for value in o.tolist())


def test_four_poses_are_fitted_only_if_asked_for_and_claim_nothing() -> None:
    raw = FOUR @ K.T + O
    session = session_of(poses_of(FOUR, raw))
    with pytest.raises(DivergedError, match=r"enough for a fit, but not to check it; .* with --unchecked"):
        six_pose_fit(session, CHECKED)
    fit = six_pose_fit(session, SETTINGS)
    verdict, vectors = judge_six_pose(session, fit, SETTINGS)
    assert verdict.outcome is Outcome.CALIBRATED
    assert verdict.calibration == fit.calibration
    np.testing.assert_allclose(fit.k, np.array(stacked(FOUR, raw)[0]), atol=1e-8)
    assert (verdict.holdout, verdict.standard_errors, verdict.fit_errors, vectors) == (None,) * 4
    assert verdict.coverage.worst_direction_mg is None
    before = 1000 * np.linalg.norm(raw - FOUR, axis=1).mean()
    assert verdict.reason == Reason.of("poses_unchecked", orientations=4, before_mg=before)
    unknown = Reason("nothing_held_out")
    assert [(trial.holdout, trial.reason) for trial in verdict.trials] == [(None, unknown)] * 2
    known = known_json(session, fit, verdict.outcome, vectors)
    assert known["unchecked"] == "nothing_held_out"
    assert known["standard_errors"] is known["holdout_vector_mg"] is None
    for pose in poses_json(session, fit):
        assert pose["raw_mg"] > 20
        assert all(pose[name] is None for name in ("residual_mg", "held_out_mg", "held_out_norm_mg"))


def test_poses_that_can_be_left_out_are_judged_all_the_same() -> None:
    raw = FACES @ K.T + O + 0.001 * np.random.default_rng(1).standard_normal((6, 3))
    session = session_of(poses_of(FACES, raw))
    asked, usual = (judge_six_pose(session, six_pose_fit(session, s), s) for s in (SETTINGS, CHECKED))
    assert asked == usual
    assert asked[0].holdout is not None
    raw[0] += 0.2
    session = session_of(poses_of(FACES, raw))
    assert judge_six_pose(session, six_pose_fit(session, SETTINGS), SETTINGS)[0].outcome is Outcome.REFUSED


@pytest.mark.parametrize(
    ("references", "words"),
    [
        (
            FACES[[0, 2, 4]],
            "only 3 poses found (+x, +y, +z), and at least 4 are needed; missing: -x, -y, -z; ",
        ),
        (FACES[:4], " do not determine twelve parameters: the condition number of [a 1] is "),
        (np.array([[0.6, 0.8, 0], [1, 2, 0], [3, 1, 0], [2, 2, 0], [0, 1, 0]]), "list more poses, in other"),
        (np.array([[2, 0, 0], [4, 0, 0], [0, 1, 0], [0, 0, 1]]) + [[0, 0, 1e-4]] * 4, None),
        (np.array([[3, 0, 0], [0, 3, 0], [0, 0, 3], [1, 1, 1.0]]), "do not determine"),
        (np.array([[3, 0, 0], [0, 3, 0], [0, 0, 3], [1, 1, 1.003]]), "the limit 1000"),
    ],
)
def test_references_that_do_not_span_are_refused_unchecked_too(
    references: np.ndarray, words: str | None
) -> None:
    session = session_of(poses_of(references, references @ K.T + O))
    if words is None:
        assert six_pose_fit(session, SETTINGS).condition_number < 20
        return
    with pytest.raises(DivergedError) as caught:
        six_pose_fit(session, SETTINGS)
    assert words in str(caught.value)
    assert "a fifth" not in str(caught.value)


def test_the_condition_number_is_that_of_the_references_in_g() -> None:
    rows = np.hstack([ANY, np.ones((8, 1))])
    assert condition_number(poses_of(ANY, ANY)) == pytest.approx(np.linalg.cond(rows), rel=1e-9)


def test_accelerations_of_any_size_give_k_and_o_of_the_stacked_equations() -> None:
    raw = ANY @ K.T + O + 0.002 * np.random.default_rng(2).standard_normal((8, 3))
    k, o = stacked(ANY, raw)
    session = session_of(poses_of(ANY, raw))
    fit = six_pose_fit(session, CHECKED)
    np.testing.assert_allclose(fit.k, k, atol=2e-8)
    np.testing.assert_allclose(fit.o, o, atol=2e-8)
    for index, error in enumerate(fit.errors):
        others = np.arange(8) != index
        k, o = stacked(ANY[others], raw[others])
        guess = np.linalg.solve(k, raw[index] - o)
        assert error.held_out == pytest.approx(1000 * np.linalg.norm(guess - ANY[index]), abs=1e-3)
        norms = np.linalg.norm(guess), np.linalg.norm(ANY[index])
        assert error.held_out_norm == pytest.approx(1000 * abs(norms[0] - norms[1]), abs=1e-3)
    verdict, _ = judge_six_pose(session, fit, CHECKED)
    assert verdict.outcome is Outcome.CALIBRATED


def test_accelerations_that_disagree_are_refused_with_other_advice() -> None:
    raw = ANY @ K.T + O
    raw[4] += 0.3
    session = session_of(poses_of(ANY, raw))
    verdict, _ = judge_six_pose(session, six_pose_fit(session, CHECKED), CHECKED)
    assert verdict.outcome is Outcome.REFUSED
    assert verdict.reason.code == "poses_disagree"
    assert verdict.advice == (Reason("check_references"),)


@pytest.mark.parametrize(
    "references",
    [
        pytest.param(ANY[[0, 1, 2, 4, 6]], id="5"),
        pytest.param(FACES, id="6"),
        pytest.param(ANY, id="8", marks=pytest.mark.nightly),
        pytest.param(np.vstack([FACES, 4 * FACES]), id="12", marks=pytest.mark.nightly),
    ],
)
def test_intervals_of_95_percent_hold_the_truth_so_often(references: np.ndarray) -> None:
    """Student's t with 3 (N - 4) degrees of freedom; 400 sessions of twelve parameters."""
    random, sessions, number = np.random.default_rng(5), 400, len(references)
    wide = stats.t.ppf(0.975, 3 * (number - 4))
    gain, held = np.linalg.inv(K), []
    truth = np.array([*gain[[0, 1, 2, 1, 2, 2], [0, 1, 2, 0, 0, 1]], *-O, *gain[[0, 0, 1], [1, 2, 2]]])
    for _ in range(sessions):
        poses = poses_of(references, references @ K.T + O + 0.003 * random.standard_normal((number, 3)))
        solution = solve(poses, STANDARD)
        known, found = uncertainty(poses, solution), solution.calibration
        off = np.array([*found.parameters[:9], *found.upper]) / ONE - truth
        errors = np.array([*known.parameters[:9], *known.parameters[12:]])
        held.append(np.abs(off) < wide * errors)
    assert np.mean(held) == pytest.approx(0.95, abs=0.015)
    assert np.all(np.abs(np.mean(held, axis=0) - 0.95) < 0.04)
