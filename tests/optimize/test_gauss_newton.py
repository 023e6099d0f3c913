"""G's damped Gauss-Newton: its three forms, its stop rule, and what gravity cannot tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import MODELS
from accelcal_cli.optimize import gauss_newton
from accelcal_cli.optimize.gauss_newton import DEFAULT
from tests.optimize.oracle import directions, gain, least_squares, measured, points
from tests.optimize.test_fixed32 import made


@pytest.mark.parametrize("form", ["lower", "symmetric", "full"])
@pytest.mark.parametrize("model", ["3", "6", "9", "6T", "9T"])
def test_every_form_ends_at_the_least_squares_optimum(form: str, model: str) -> None:
    held = made(2, 60, warm=model.endswith("T"), weighted=True)
    found = gauss_newton.fit(held, MODELS[model], replace(DEFAULT, form=form)).parameters
    assert np.abs(np.array(found) / ONE - least_squares(held, MODELS[model].free).p).max() < 1e-7


def test_a_symmetric_sensor_comes_back_as_the_triangular_one_of_the_same_metric() -> None:
    s = np.array([[1.03, 0.01, -0.02], [0.01, 0.98, 0.015], [-0.02, 0.015, 1.01]])
    offset = np.array([0.02, -0.03, 0.01])
    v = directions(50) @ np.linalg.inv(s).T - offset
    for form in ("lower", "symmetric", "full"):
        found = gauss_newton.fit(points(v), MODELS["9"], replace(DEFAULT, form=form)).parameters
        p = np.array(found) / ONE
        assert np.abs(gain(p).T @ gain(p) - s.T @ s).max() < 1e-7
        assert np.abs(p[6:9] - offset).max() < 1e-7


def test_less_damping_needs_fewer_iterations() -> None:
    held = points(
        measured(np.array([1.05, 0.96, 1.02, 0.01, -0.02, 0.01, 0.05, 0, 0, 0, 0, 0]), directions(40))
    )
    counts = [
        gauss_newton.fit(held, MODELS["9"], replace(DEFAULT, damping=damping)).iterations
        for damping in (1.0, 0.9, 0.5)
    ]
    assert counts == sorted(counts) and counts[0] < 8 and len(set(counts)) == 3


def test_a_parameter_of_zero_does_not_divide_by_zero() -> None:
    found = gauss_newton.fit(points(directions(40)), MODELS["9"])
    assert found.stop == "small change" and found.iterations <= 3


def test_too_few_iterations_are_an_error() -> None:
    held = made(2, 60, warm=False, weighted=False)
    with pytest.raises(DivergedError, match="not converged after 2 iterations"):
        gauss_newton.fit(held, MODELS["9"], replace(DEFAULT, max_iterations=2))


@pytest.mark.parametrize("form", ["lower", "symmetric", "full"])
def test_eight_points_do_not_determine_nine_parameters(form: str) -> None:
    with pytest.raises(DivergedError, match="do not determine"):
        gauss_newton.fit(points(directions(8)), MODELS["9"], replace(DEFAULT, form=form))
