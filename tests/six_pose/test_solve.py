"""The least squares of Bragge et al.: against their stacked equations, exact arithmetic and simulation."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.errors import DivergedError, FixedPointOverflowError
from accelcal_cli.core.gravity import STANDARD
from accelcal_cli.six_pose.solve import calibrated, check_range, condition_number, solve, uncertainty
from tests.six_pose.known import poses_of, stacked
from tests.six_pose.made import UP, K, O, turned

FACES = np.array(list(UP.values()), float)


def as_floats(rows: tuple[tuple[Fraction, ...], ...]) -> np.ndarray:
    return np.array([[float(value) for value in row] for row in rows])


def directions(number: int, seed: int = 3) -> np.ndarray:
    a = np.random.default_rng(seed).standard_normal((number, 3))
    return a / np.linalg.norm(a, axis=1, keepdims=True)


@pytest.mark.parametrize("references", [FACES, directions(5), directions(40)])
def test_k_and_o_are_those_of_the_stacked_equations(references: np.ndarray) -> None:
    raw = references @ K.T + O + 0.01 * directions(len(references), 9)
    k, o = stacked(references, raw)
    found = solve(poses_of(references, raw), STANDARD)
    np.testing.assert_allclose(as_floats(found.k), k, atol=2e-8)
    np.testing.assert_allclose([float(value) for value in found.o], o, atol=2e-8)
    np.testing.assert_allclose(found.calibration.gain(), np.linalg.inv(k), atol=4e-8)
    np.testing.assert_allclose(found.calibration.offset_g(), -o, atol=4e-8)


def test_every_orientation_weighs_the_same_however_many_states_it_has() -> None:
    references = np.vstack([FACES, FACES[:1], FACES[:1]])
    raw = references @ K.T + O + 0.01 * directions(8, 9)
    k, o = stacked(references, raw, np.array([1 / 3, 1, 1, 1, 1, 1, 1 / 3, 1 / 3]))
    found = solve(poses_of(references, raw, [0, 1, 2, 3, 4, 5, 0, 0]), STANDARD)
    np.testing.assert_allclose(as_floats(found.k), k, atol=1e-8)
    np.testing.assert_allclose([float(value) for value in found.o], o, atol=1e-8)


def test_without_noise_the_fractions_are_the_truth_itself() -> None:
    k = np.array([[261, -3, 2], [5, 250, -4], [-2, 3, 257]]) / 256
    o = np.array([9, -15, 11]) / 256
    found = solve(poses_of(FACES, FACES @ k.T + o), STANDARD)
    assert found.k == tuple(tuple(Fraction(value) for value in row) for row in k.tolist())
    assert found.o == tuple(Fraction(value) for value in o.tolist())
    assert found.calibration.parameters[6:9] == tuple(round(-value * ONE) for value in o.tolist())
    for pose in poses_of(FACES, FACES @ k.T + o):
        a = calibrated(pose.state.raw, found.calibration)
        np.testing.assert_allclose(np.array(a) * ONE, pose.reference, atol=3)


def test_the_order_of_the_states_does_not_matter() -> None:
    poses = poses_of(FACES, FACES @ K.T + O + 0.01 * directions(6, 9))
    assert solve(poses, STANDARD) == solve(poses[::-1], STANDARD)


@pytest.mark.parametrize("which", [[0], [0, 1, 2, 3], [0, 2, 4], [0, 1, 2, 3, 0, 1]])
def test_poses_in_one_plane_determine_nothing(which: list[int]) -> None:
    poses = poses_of(FACES[which], FACES[which] @ K.T + O)
    assert condition_number(poses) == float("inf") or condition_number(poses) > 1e12
    with pytest.raises(DivergedError):
        solve(poses, STANDARD)


def test_four_poses_of_rank_four_are_enough_to_solve() -> None:
    which = [0, 1, 2, 4]
    poses = poses_of(FACES[which], FACES[which] @ K.T + O)
    np.testing.assert_allclose(as_floats(solve(poses, STANDARD).k), K, atol=1e-8)
    assert condition_number(poses) < 5
    assert condition_number(poses_of(FACES, FACES)) == pytest.approx(np.sqrt(3))


def test_an_axis_that_never_changes_and_one_beyond_range_are_refused() -> None:
    dead = FACES @ np.diag([1.0, 1.0, 0.0])
    with pytest.raises(DivergedError, match="no inverse"):
        solve(poses_of(FACES, dead), STANDARD)
    small = solve(poses_of(FACES, FACES * 0.2), STANDARD)
    with pytest.raises(FixedPointOverflowError):
        check_range(small.calibration)
    check_range(solve(poses_of(FACES, FACES * 0.26), STANDARD).calibration)


def test_errors_of_the_inverse_are_those_of_k_carried_through() -> None:
    """To first order G(K + dK) = G - G dK G: here by differences, with K far from symmetric."""
    k = np.array([[1.2, 0.5, -0.3], [-0.1, 0.8, 0.4], [0.3, 0.2, 1.5]])
    references = np.vstack([FACES[:5], turned(UP["-z"], 40.0, axis=1)[None]])
    poses = poses_of(references, references @ k.T + O + 0.003 * directions(6, 9))
    solution = solve(poses, STANDARD)
    known = uncertainty(poses, solution)
    rows = np.hstack([references, np.ones((6, 1))])
    cover = np.linalg.inv(rows.T @ rows)
    sigma = known.o[0] / np.sqrt(cover[3, 3])
    factor, found = np.linalg.cholesky(cover[:3, :3]), as_floats(solution.k)
    variance = np.zeros((3, 3))
    for row in range(3):
        for column in factor.T:
            step = np.zeros((3, 3))
            step[row] = 1e-6 * column
            change = (np.linalg.inv(found + step) - np.linalg.inv(found - step)) / 2e-6
            variance += (sigma * change) ** 2
    expected = np.sqrt(variance)[[0, 1, 2, 1, 2, 2, 0, 0, 1], [0, 1, 2, 0, 0, 1, 1, 2, 2]]
    np.testing.assert_allclose([*known.parameters[:6], *known.parameters[12:]], expected, rtol=1e-4)


def test_the_least_certain_direction_is_that_of_a_missing_face() -> None:
    """By hand: [a 1] M [a 1]' is 2/3 everywhere with six faces, and 2 at -z without it; an entry of K
    in the columns of x has s^2 / 2 either way.
    """
    raw = FACES + 0.004 * np.random.default_rng(2).standard_normal((6, 3))
    for number, worst in ((6, 2 / 3), (5, 2)):
        poses = poses_of(FACES[:number], raw[:number])
        known = uncertainty(poses, solve(poses, STANDARD))
        ratio = known.worst_direction_mg / 1000 / known.k[0][0]
        assert ratio == pytest.approx(np.sqrt(worst / 0.5), rel=0.01)
