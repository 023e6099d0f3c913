"""The same descent in double precision: the paper's run, and the optimum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import MODELS, Operations, PointSet
from accelcal_cli.optimize import _float, fixed32, float64
from tests.optimize.oracle import (
    IDEAL,
    directions,
    drawn_errors,
    least_squares,
    measured,
    paper_descent,
    points,
    random_directions,
    residual,
)


def drawn(seed: int, number: int = 18, noise: float = 0.003) -> PointSet:
    random = np.random.default_rng(seed)
    v = measured(drawn_errors(random), random_directions(random, number))
    return points(v + noise * random.standard_normal((number, 3)))


def test_profile_paper_is_the_paper_s_iteration() -> None:
    for seed in range(5):
        held = drawn(seed)
        found = float64.fit(held, MODELS["9"], replace(float64.PAPER, keep_history=True))
        expected = paper_descent(held.xyz_g(), 50)
        assert len(found.history) == 50
        for ours, theirs in zip(found.history, expected, strict=True):
            assert np.abs(np.array(ours) / ONE - theirs).max() < 2e-9


def test_profile_paper_counts_the_paper_s_operations() -> None:
    found = float64.fit(drawn(1), MODELS["9"], float64.PAPER)
    assert found.operations == Operations(90_150, 90_150)


def test_profile_paper_agrees_with_fixed_point() -> None:
    for seed in range(5):
        held = drawn(seed)
        real, fixed = (item.fit(held, MODELS["9"], item.PAPER).parameters for item in (float64, fixed32))
        assert np.abs(np.array(real) - np.array(fixed)).max() < 2e-5 * ONE


@pytest.mark.parametrize("model", ["3", "6", "9"])
def test_it_ends_at_the_least_squares_optimum_to_eight_digits(model: str) -> None:
    held = drawn(3, 120)
    found = np.array(float64.fit(held, MODELS[model]).parameters) / ONE
    assert np.abs(found - least_squares(held, MODELS[model].free).p).max() < 1e-8


def test_too_few_iterations_are_an_error() -> None:
    with pytest.raises(DivergedError, match="not converged after 3 iterations"):
        float64.fit(drawn(2), MODELS["9"], replace(float64.DEFAULT, max_iterations=3))


def test_rates_that_are_too_large_are_halved_until_the_cost_falls() -> None:
    held = points(measured(drawn_errors(np.random.default_rng(4)), directions(60)))
    fast = {name: 3 * rate for name, rate in fixed32.RATES_OF_F.items()}
    found = float64.fit(held, MODELS["9"], replace(float64.DEFAULT, rates=fast))
    assert np.abs(np.array(found.parameters) / ONE - least_squares(held, MODELS["9"].free).p).max() < 1e-8


def test_a_descent_that_leaves_all_numbers_behind_is_an_error() -> None:
    wild = {name: 1e3 * rate for name, rate in fixed32.RATES_OF_F.items()}
    with pytest.raises(DivergedError, match="leave"):
        float64.fit(drawn(2), MODELS["9"], replace(float64.PAPER, rates=wild))


def test_the_gradient_is_the_slope_of_the_cost() -> None:
    random = np.random.default_rng(8)
    tau, weights = random.uniform(-1.5, 1.5, 30), random.uniform(0.1, 1, 30)
    held = points(directions(30), weights=weights, tau=tau)
    p = IDEAL + 0.02 * random.standard_normal(12)
    real = _float.as_floats(held)
    state = _float.evaluate(real, p)
    w = held.weights / held.weights.sum()

    def cost(q: np.ndarray) -> float:
        return float(w @ residual(q, held.xyz / ONE, held.tau / ONE) ** 2)

    slopes = [(cost(p + 1e-6 * one) - cost(p - 1e-6 * one)) / 2e-6 for one in np.eye(12)]
    assert np.allclose(_float.gradient(real, state, p), slopes, atol=1e-9)
    assert float(_float.cost(real, state)) == pytest.approx(cost(p), rel=1e-12)


@pytest.mark.parametrize("broken", [[np.nan], [np.inf], [4.0], [-1.0], [0.0]])
def test_parameters_that_mean_nothing_are_refused(broken: list[float]) -> None:
    with pytest.raises(DivergedError):
        _float.as_integers(np.array(broken + [1.0, 1.0] + [0.0] * 9))
