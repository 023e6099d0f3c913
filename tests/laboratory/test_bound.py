"""The Cramer-Rao bound against a calculation that keeps every unknown, and against fits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.laboratory.cases import CasePlan, make_case
from accelcal_cli.laboratory.simulation import expected_errors, fisher_information
from tests.optimize.oracle import calibrated, measured


def turned(a: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Unit vectors moved by two angles each along their tangents."""
    helper = np.where(np.abs(a[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    one = np.cross(a, helper)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    moved = a + angles[:, :1] * one + angles[:, 1:] * np.cross(a, one)
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


def all_unknowns(p: np.ndarray, a: np.ndarray, noise_g: float) -> np.ndarray:
    """Covariance of nine parameters when the orientations (two angles a point) are estimated too."""
    number = len(a)

    def expected(x: np.ndarray) -> np.ndarray:
        return measured(np.append(x[:9], [0, 0, 0]), turned(a, x[9:].reshape(number, 2))).ravel()

    x, h = np.concatenate([p[:9], np.zeros(2 * number)]), 1e-5
    slopes = np.stack([(expected(x + h * e) - expected(x - h * e)) / (2 * h) for e in np.eye(len(x))], axis=1)
    return np.linalg.inv(slopes.T @ slopes / noise_g**2)[:9, :9]


@pytest.mark.parametrize("index", range(4))
@pytest.mark.parametrize("number", [18, 45])
def test_it_equals_the_information_of_all_unknowns_together(index: int, number: int) -> None:
    case = make_case(CasePlan(number, 0.002), 1, index)
    p = np.array(case.truth) / ONE
    oracle = all_unknowns(p, calibrated(p, case.still_g), 0.002)
    found = np.linalg.inv(fisher_information(case.still_g, case.truth, 0.002))
    assert found == pytest.approx(oracle, rel=1e-5, abs=1e-11)


def test_the_expected_error_is_0_798_standard_deviations() -> None:
    case = make_case(CasePlan(18, 0.002), 1, 0)
    sd = np.sqrt(np.diag(np.linalg.inv(fisher_information(case.still_g, case.truth, 0.002))))
    assert expected_errors(case.still_g, case.truth, 0.002) == pytest.approx(0.79788456 * sd, rel=1e-8)


def test_it_grows_with_the_noise_and_falls_with_the_points() -> None:
    case = make_case(CasePlan(18, 0.001), 1, 0)
    one = expected_errors(case.still_g, case.truth, 0.001)
    assert expected_errors(case.still_g, case.truth, 0.005) == pytest.approx(5 * one)
    assert expected_errors(np.tile(case.still_g, (4, 1)), case.truth, 0.001) == pytest.approx(one / 2)


@pytest.mark.nightly
def test_repeated_fits_of_one_sensor_spread_as_it_says() -> None:
    """Efficient estimates by SciPy (each residual over its own spread) reach the bound."""
    case, noise = make_case(CasePlan(45, 0.001), 1, 2), 0.001
    p = np.array(case.truth[:9]) / ONE
    random = np.random.default_rng(1)

    def residuals(x: np.ndarray, v: np.ndarray) -> np.ndarray:
        a = calibrated(np.append(x, [0, 0, 0]), v)
        k = np.array([[x[0], 0, 0], [x[3], x[1], 0], [x[4], x[5], x[2]]])
        return ((a**2).sum(axis=1) - 1) / np.linalg.norm(2 * a @ k, axis=1)

    noisy = [case.still_g + noise * random.standard_normal(case.still_g.shape) for _ in range(400)]
    errors = np.array([least_squares(residuals, p, args=(v,)).x - p for v in noisy])
    ratio = np.abs(errors).mean(axis=0) / expected_errors(case.still_g, case.truth, noise)
    assert np.abs(ratio - 1).max() < 0.12  # a mean of 400 has a standard error of 4 %
    assert abs(ratio.mean() - 1) < 0.05
