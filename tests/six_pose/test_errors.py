"""Errors of poses left out: against numpy, and what a tilt shows up as."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.six_pose.poses import StillState
from accelcal_cli.six_pose.solve import six_pose_fit
from tests.six_pose.known import fixed3, poses_of, session_of, stacked
from tests.six_pose.made import UP, K, O, turned

FACES = np.array(list(UP.values()), float)
SETTINGS = PoseSettings()
DEGREE_MG = 1000 * 2 * np.sin(np.radians(0.5))


def raw_of(a: np.ndarray) -> np.ndarray:
    return a @ K.T + O


def test_each_orientation_is_judged_by_the_others() -> None:
    references = np.vstack([FACES, FACES[:1]])
    numbers = [0, 1, 2, 3, 4, 5, 0]
    raw = raw_of(references) + 0.005 * np.random.default_rng(4).standard_normal((7, 3))
    fit = six_pose_fit(session_of(poses_of(references, raw, numbers)), SETTINGS)
    for index, number in enumerate(numbers):
        others = np.array([other != number for other in numbers])
        weights = np.array([0.5 if other == 0 else 1.0 for other in numbers])[others]
        k, o = stacked(references[others], raw[others], weights)
        guess = np.linalg.solve(k, raw[index] - o)
        error = fit.errors[index]
        assert error.held_out == pytest.approx(1000 * np.linalg.norm(guess - references[index]), abs=1e-3)
        assert error.held_out_norm == pytest.approx(1000 * abs(np.linalg.norm(guess) - 1), abs=1e-3)
        assert error.raw == pytest.approx(1000 * np.linalg.norm(raw[index] - references[index]), abs=1e-5)
        angle = np.degrees(np.arccos(guess @ references[index] / np.linalg.norm(guess)))
        assert error.tilt_degrees == pytest.approx(angle, abs=1e-4)


def test_repeated_states_are_compared_with_their_mean() -> None:
    references = np.vstack([FACES, FACES[:1]])
    true = np.vstack([FACES, turned(UP["+x"], 0.4)[None]])
    fit = six_pose_fit(session_of(poses_of(references, raw_of(true), [0, 1, 2, 3, 4, 5, 0])), SETTINGS)
    assert [error.repeat is None for error in fit.errors] == [False, True, True, True, True, True, False]
    assert fit.errors[0].repeat == pytest.approx(0.2 * DEGREE_MG, rel=0.02)
    assert fit.errors[0].repeat == pytest.approx(fit.errors[6].repeat)


def test_one_tilted_face_shows_in_full_on_it_and_its_opposite_and_by_half_on_the_rest() -> None:
    true = FACES.copy()
    true[0] = turned(UP["+x"], 1.0)
    fit = six_pose_fit(session_of(poses_of(FACES, raw_of(true))), SETTINGS)
    shown = [error.held_out for error in fit.errors]
    assert shown[0] == pytest.approx(DEGREE_MG, rel=0.02)
    assert shown[1] == pytest.approx(DEGREE_MG, rel=0.02)
    np.testing.assert_allclose(shown[2:], DEGREE_MG / 2, rtol=0.03)
    assert all(error.held_out_norm < 0.6 * DEGREE_MG for error in fit.errors)


def test_a_box_that_is_not_square_shows_nowhere_but_in_the_misalignment() -> None:
    true = FACES.copy()
    true[:2] = [turned(UP["+x"], 1.0), turned(UP["-x"], 1.0)]
    fit = six_pose_fit(session_of(poses_of(FACES, raw_of(true))), SETTINGS)
    assert max(error.held_out for error in fit.errors) < 1e-3
    assert abs(fit.k[1][0] - K[1, 0]) * 1000 == pytest.approx(DEGREE_MG, rel=0.02)
    diagonal = fixed3((np.array([1.0, 1.0, 0.0]) / np.sqrt(2)) @ K.T + O)
    session = replace(session_of(poses_of(FACES, raw_of(true))), between=(StillState(0, 1, 1, diagonal),))
    assert six_pose_fit(session, SETTINGS).between_norm_mg == pytest.approx(DEGREE_MG / 2, rel=0.05)


def test_a_slanted_surface_cancels_when_each_face_is_turned_by_half_a_turn() -> None:
    tilt = np.random.default_rng(5).normal(0, 0.02, (6, 3)) * (FACES == 0)
    references, numbers = np.vstack([FACES, FACES]), [*range(6), *range(6)]
    true = np.vstack([FACES + tilt, FACES - tilt])
    fit = six_pose_fit(session_of(poses_of(references, raw_of(true), numbers)), SETTINGS)
    np.testing.assert_allclose(fit.k, K, atol=1e-8)
    np.testing.assert_allclose(fit.o, O, atol=1e-8)
    expected = 1000 * np.linalg.norm(tilt, axis=1)
    np.testing.assert_allclose([error.repeat for error in fit.errors[:6]], expected, rtol=1e-4)


def test_without_one_face_the_opposite_one_cannot_be_left_out() -> None:
    fit = six_pose_fit(session_of(poses_of(FACES[:5], raw_of(FACES[:5]))), SETTINGS)
    assert [error.held_out is None for error in fit.errors] == [False] * 4 + [True]


@pytest.mark.parametrize(
    ("which", "words", "missing"),
    [
        ([0], "only 1 pose found (+x), and at least 5", "missing: -x, +y, -y, +z, -z"),
        ([0, 1, 2, 3], "the poses (+x, +y, -x, -y) do not determine", "missing: +z, -z"),
        ([0, 1, 2, 4], "enough for a fit, but not to check it", "missing: -y, -z"),
        ([], "no still state lies within 15 degrees of a face", "list the poses with --poses"),
    ],
)
def test_too_few_poses_are_named(which: list[int], words: str, missing: str) -> None:
    poses = poses_of(FACES[which], raw_of(FACES[which]), which)
    with pytest.raises(DivergedError) as caught:
        six_pose_fit(session_of(poses), SETTINGS)
    assert words in str(caught.value)
    assert missing in str(caught.value)
    assert caught.value.exit_code == 4


def test_references_that_are_almost_in_one_plane_are_refused() -> None:
    a = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0.0002], [0, -1, 0], [0.6, 0.8, 0.0001]])
    with pytest.raises(DivergedError, match="do not determine twelve parameters: the condition number"):
        six_pose_fit(session_of(poses_of(a, raw_of(a))), SETTINGS)
