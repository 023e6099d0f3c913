"""Iterated closest points: where they settle, how little a far point counts; the ellipsoid in one step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import MODELS, PointSet
from accelcal_cli.laboratory.optimizers.minimizers import FLOAT64
from accelcal_cli.laboratory.optimizers.regressions import (
    CLOSEST_POINT_DEFAULT,
    fit_closest_point,
    fit_ellipsoid,
)
from tests.optimize.oracle import calibrated, directions, measured, points

SIX = np.array([1.03, 0.98, 1.01, 0, 0, 0, 0.02, -0.03, 0.01, 0, 0, 0])
SLOPES = np.array([0.0] * 9 + [0.004, -0.003, 0.002])
TIGHT = replace(CLOSEST_POINT_DEFAULT, tolerance=1e-18)


def noisy(p: np.ndarray, noise: float, *, warm: bool = False) -> PointSet:
    random = np.random.default_rng(5)
    tau = random.uniform(-1.5, 1.5, 80) if warm else None
    v = measured(p, directions(80), tau) + noise * random.standard_normal((80, 3))
    return points(v, weights=random.uniform(0.2, 1, 80), tau=tau)


def distance(p: np.ndarray, held: PointSet) -> np.ndarray:
    tau = None if held.tau is None else held.tau / ONE
    return np.abs(np.sqrt((calibrated(p, held.xyz / ONE, tau) ** 2).sum(axis=1)) - 1)


@pytest.mark.parametrize("noise", [0.002, 0.03], ids=["within 10 mg", "beyond"])
@pytest.mark.parametrize("model", ["6", "6T"])
def test_it_settles_where_the_weighted_distance_is_least(model: str, noise: float) -> None:
    held = noisy(SIX + SLOPES * (model == "6T"), noise, warm=model == "6T")
    p = np.array(fit_closest_point(held, MODELS[model], TIGHT).parameters) / ONE
    weights = held.weights / np.maximum(distance(p, held), 0.01)

    def cost(q: np.ndarray) -> float:
        return float(weights @ distance(q, held) ** 2 / weights.sum())

    slopes = [(cost(p + 1e-6 * one) - cost(p - 1e-6 * one)) / 2e-6 for one in np.eye(12)]
    assert np.abs(np.array(slopes)[list(MODELS[model].free)]).max() < 1e-6


def test_known_errors_with_slopes_come_back_to_all_digits_where_asked() -> None:
    held = noisy(SIX + SLOPES, 0.0, warm=True)
    found = fit_closest_point(held, MODELS["6T"], TIGHT).parameters
    assert np.abs(np.array(found) / ONE - SIX - SLOPES).max() < 1e-7


def test_a_far_point_moves_it_less_than_least_squares() -> None:
    v = measured(SIX, directions(60))
    v[7] *= 1.3
    errors = [
        np.abs(np.array(fit(points(v), MODELS["6"]).parameters) / ONE - SIX).max()
        for fit in (fit_closest_point, FLOAT64.fit)
    ]
    assert errors[0] < errors[1] / 4


def test_too_few_rounds_are_an_error() -> None:
    with pytest.raises(DivergedError, match="not converged after 2 iterations"):
        fit_closest_point(noisy(SIX, 0.01), MODELS["6"], replace(CLOSEST_POINT_DEFAULT, max_iterations=2))


def test_one_posture_is_refused() -> None:
    with pytest.raises(DivergedError, match="do not determine"):
        fit_closest_point(points(np.tile([0.0, 0.6, 0.8], (20, 1))), MODELS["6"])


def test_six_points_on_the_axes_give_the_answer_by_hand() -> None:
    v = np.diag([1.25, 1.0, 0.5])
    p = np.array(fit_ellipsoid(points(np.vstack([v + 0.125, 0.125 - v])), MODELS["6"]).parameters) / ONE
    assert np.abs(p - [0.8, 1, 2, 0, 0, 0, -0.125, -0.125, -0.125, 0, 0, 0]).max() < 1e-8


def test_the_offset_alone_is_the_centre_of_the_sphere_whatever_its_radius() -> None:
    offset = np.array([0.03, -0.02, 0.05])
    for radius in (1.0, 1.04):
        p = np.array(fit_ellipsoid(points(radius * directions(30) - offset), MODELS["3"]).parameters) / ONE
        assert np.abs(p - [1, 1, 1, 0, 0, 0, *offset, 0, 0, 0]).max() < 1e-8


def test_points_of_no_weight_take_no_part() -> None:
    p = np.array([1.02, 0.97, 1.01, 0, 0, 0, 0.02, 0.01, -0.03, 0, 0, 0])
    v = np.vstack([measured(p, directions(20)), 0.7 * directions(5)])
    found = fit_ellipsoid(points(v, weights=np.r_[np.ones(20), np.zeros(5)]), MODELS["6"]).parameters
    assert np.abs(np.array(found) / ONE - p).max() < 1e-8


def test_points_on_a_hyperboloid_are_refused() -> None:
    z = np.linspace(-1, 1, 40)
    ring = np.sqrt(0.5 + z**2)
    v = np.stack([ring * np.cos(7 * z), ring * np.sin(7 * z), z], axis=1)
    with pytest.raises(DivergedError, match="no ellipsoid"):
        fit_ellipsoid(points(v), MODELS["6"])


def test_points_in_one_plane_are_refused() -> None:
    v = directions(30) * [1, 1, 0]
    for model in ("3", "6"):
        with pytest.raises(DivergedError, match="do not determine"):
            fit_ellipsoid(points(v), MODELS[model])
