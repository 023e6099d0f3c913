"""The penalized fit against scipy's minimum of the same sum, and what must hold for all points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares as solve

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import MODELS, PENALTY_BITS, WEIGHT_ONE, Penalty, PointSet
from accelcal_cli.optimize.fixed32 import OPTIMIZER
from tests.optimize.oracle import IDEAL, directions, drawn_errors, measured, points, random_directions

fit = OPTIMIZER.fit_penalized
assert fit is not None


def penalty(strength: float, *, centre: tuple[int, ...] = IDENTITY) -> Penalty:
    return Penalty(centre, (round(strength * (1 << PENALTY_BITS)),) * 12)


def minimum(held: PointSet, strength: float) -> np.ndarray:
    """Nine parameters by scipy, in float64, by rows of their own."""
    g, weights = held.xyz / ONE, np.sqrt(held.weights / WEIGHT_ONE)

    def rows(p: np.ndarray) -> np.ndarray:
        k = np.array([[p[0], 0, 0], [p[3], p[1], 0], [p[4], p[5], p[2]]])
        residual = (((g + p[6:9]) @ k.T) ** 2).sum(axis=1) - 1
        return np.concatenate([weights * residual, np.sqrt(strength) * (p - IDEAL[:9])])

    return np.asarray(solve(rows, IDEAL[:9], xtol=1e-15, ftol=1e-15, gtol=1e-15).x)


@pytest.mark.parametrize(("number", "strength"), [(4, 1e-3), (4, 1.0), (60, 1e-6), (60, 1e-3), (60, 1.0)])
def test_it_is_the_minimum_that_scipy_finds(number: int, strength: float) -> None:
    """Also of four points, which alone do not determine nine parameters."""
    p = drawn_errors(np.random.default_rng(number))
    held = points(
        measured(p, directions(number)) + 0.001 * np.random.default_rng(1).standard_normal((number, 3))
    )
    found = fit(held, MODELS["9"], penalty(strength), IDENTITY)
    away = np.abs(np.array(found.fit.parameters[:9]) / ONE - minimum(held, strength)).max()
    assert away < (1e-5 if (number, strength) == (4, 1e-3) else 1e-7), "flat by 2.5e-4: a bit of the gradient"
    assert found.fit.parameters[9:] == (0, 0, 0)


def test_a_strong_prior_is_its_centre_and_none_is_the_plain_fit() -> None:
    held = points(measured(drawn_errors(np.random.default_rng(3)), directions(60)))
    centre = (*(np.array(IDENTITY[:9]) + 12345).tolist(), 0, 0, 0)
    strong = fit(held, MODELS["9"], penalty(1e9, centre=centre), IDENTITY).fit.parameters
    assert np.abs(np.array(strong) - centre).max() < 10
    weak = np.array(fit(held, MODELS["9"], Penalty(IDENTITY, (1,) * 12), IDENTITY).fit.parameters)
    plain = np.array(OPTIMIZER.fit(held, MODELS["9"], OPTIMIZER.settings["default"]).parameters)
    assert np.abs(weak - plain).max() < 100


def test_the_curvature_is_that_of_the_squares() -> None:
    """Mean of J J^T by differences of the residuals."""
    held = points(measured(drawn_errors(np.random.default_rng(5)), directions(40)))
    found = fit(held, MODELS["9"], penalty(1e-4), IDENTITY)
    p, g = np.array(found.fit.parameters[:9]) / ONE, held.xyz / ONE

    def residual(q: np.ndarray) -> np.ndarray:
        k = np.array([[q[0], 0, 0], [q[3], q[1], 0], [q[4], q[5], q[2]]])
        return np.asarray((((g + q[6:9]) @ k.T) ** 2).sum(axis=1) - 1)

    step = 1e-6
    columns = [(residual(p + step * e) - residual(p - step * e)) / (2 * step) for e in np.eye(9)]
    expected = np.stack(columns) @ np.stack(columns).T / len(g)
    assert np.abs(np.array(found.curvature) - expected).max() < 1e-3
    assert found.mean_square == pytest.approx((residual(p) ** 2).mean(), rel=1e-3, abs=1e-14)


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.integers(1, 30))
def test_the_order_of_the_points_makes_no_difference(seed: int, number: int) -> None:
    random = np.random.default_rng(seed)
    held = points(random_directions(random, number) * random.uniform(0.95, 1.05, (number, 1)))
    mixed = held.select(random.permutation(number))
    there, again = (fit(one, MODELS["9"], penalty(1e-3), IDENTITY) for one in (held, mixed))
    assert there.fit.parameters == again.fit.parameters
    assert (there.curvature, there.mean_square) == (again.curvature, again.mean_square)


def test_points_without_weight_are_refused() -> None:
    held = points(directions(5))
    empty = PointSet(held.xyz, np.zeros(5, np.int64), held.windows)
    with pytest.raises(DivergedError, match="no point has any weight"):
        fit(empty, MODELS["9"], penalty(1e-3), IDENTITY)
