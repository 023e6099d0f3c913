"""The minimisers: the paper's run in double and single precision, and the optimum; SciPy's two."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError, UsageError
from accelcal_cli.core.points import MODELS, Operations, PointSet
from accelcal_cli.laboratory.optimizers.minimizers import (
    BFGS_DEFAULT,
    EVOLUTION_DEFAULT,
    FLOAT32,
    FLOAT64,
    PAPER,
    evaluate,
    fit_bfgs,
    fit_evolution,
    gradient,
)
from accelcal_cli.laboratory.optimizers.minimizers import cost as cost_of
from accelcal_cli.optimize import all_optimizers, fixed32, gauss_newton, named_optimizer
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
from tests.optimize.test_fixed32 import made


def drawn(seed: int, number: int = 18, noise: float = 0.003) -> PointSet:
    random = np.random.default_rng(seed)
    v = measured(drawn_errors(random), random_directions(random, number))
    return points(v + noise * random.standard_normal((number, 3)))


def test_profile_paper_is_the_paper_s_iteration() -> None:
    for seed in range(5):
        held = drawn(seed)
        found = FLOAT64.fit(held, MODELS["9"], replace(PAPER, keep_history=True))
        expected = paper_descent(held.xyz_g(), 50)
        assert len(found.history) == 50
        for ours, theirs in zip(found.history, expected, strict=True):
            assert np.abs(np.array(ours) / ONE - theirs).max() < 2e-9


def test_profile_paper_counts_the_paper_s_operations() -> None:
    found = FLOAT64.fit(drawn(1), MODELS["9"], PAPER)
    assert found.operations == Operations(90_150, 90_150)


def test_profile_paper_agrees_with_fixed_point() -> None:
    for seed in range(5):
        held = drawn(seed)
        real, fixed = (
            fit(held, MODELS["9"], paper).parameters
            for fit, paper in ((FLOAT64.fit, PAPER), (fixed32.fit, fixed32.PAPER))
        )
        assert np.abs(np.array(real) - np.array(fixed)).max() < 2e-5 * ONE


@pytest.mark.parametrize("model", ["3", "6", "9"])
def test_it_ends_at_the_least_squares_optimum_to_eight_digits(model: str) -> None:
    held = drawn(3, 120)
    found = np.array(FLOAT64.fit(held, MODELS[model]).parameters) / ONE
    assert np.abs(found - least_squares(held, MODELS[model].free).p).max() < 1e-8


def test_too_few_iterations_are_an_error() -> None:
    with pytest.raises(DivergedError, match="not converged after 3 iterations"):
        FLOAT64.fit(drawn(2), MODELS["9"], replace(FLOAT64.settings["default"], max_iterations=3))


def test_rates_that_are_too_large_are_halved_until_the_cost_falls() -> None:
    held = points(measured(drawn_errors(np.random.default_rng(4)), directions(60)))
    fast = {name: 3 * rate for name, rate in fixed32.RATES_OF_F.items()}
    found = FLOAT64.fit(held, MODELS["9"], replace(FLOAT64.settings["default"], rates=fast))
    assert np.abs(np.array(found.parameters) / ONE - least_squares(held, MODELS["9"].free).p).max() < 1e-8


def test_a_descent_that_leaves_all_numbers_behind_is_an_error() -> None:
    wild = {name: 1e3 * rate for name, rate in fixed32.RATES_OF_F.items()}
    with pytest.raises(DivergedError, match="leave"):
        FLOAT64.fit(drawn(2), MODELS["9"], replace(PAPER, rates=wild))


def test_the_gradient_is_the_slope_of_the_cost() -> None:
    random = np.random.default_rng(8)
    tau, weights = random.uniform(-1.5, 1.5, 30), random.uniform(0.1, 1, 30)
    held = points(directions(30), weights=weights, tau=tau)
    p = IDEAL + 0.02 * random.standard_normal(12)
    real = gauss_newton.as_floats(held)
    state = evaluate(real, p)
    w = held.weights / held.weights.sum()

    def cost(q: np.ndarray) -> float:
        return float(w @ residual(q, held.xyz / ONE, held.tau / ONE) ** 2)

    slopes = [(cost(p + 1e-6 * one) - cost(p - 1e-6 * one)) / 2e-6 for one in np.eye(12)]
    assert np.allclose(gradient(real, state, p), slopes, atol=1e-9)
    assert float(cost_of(real, state)) == pytest.approx(cost(p), rel=1e-12)


@pytest.mark.parametrize("broken", [[np.nan], [np.inf], [4.0], [-1.0], [0.0]])
def test_parameters_that_mean_nothing_are_refused(broken: list[float]) -> None:
    with pytest.raises(DivergedError):
        gauss_newton.as_integers(np.array(broken + [1.0, 1.0] + [0.0] * 9))


@pytest.mark.parametrize("model", ["6", "9", "9T"])
def test_single_precision_agrees_with_double_precision_to_five_digits(model: str) -> None:
    for seed in range(6):
        held = made(seed, 80, warm=model.endswith("T"), weighted=True)
        short, long = (np.array(item.fit(held, MODELS[model]).parameters) for item in (FLOAT32, FLOAT64))
        assert np.abs(short - long).max() < 5e-6 * ONE


def test_single_precision_of_profile_paper_agrees_with_double_precision_to_four_digits() -> None:
    for seed in range(6):
        held = drawn(seed)
        short, long = (np.array(item.fit(held, MODELS["9"], PAPER).parameters) for item in (FLOAT32, FLOAT64))
        assert 0 < np.abs(short - long).max() < 5e-4 * ONE


def test_everything_of_it_stays_in_single_precision() -> None:
    held = gauss_newton.as_floats(made(1, 20, warm=True, weighted=True), np.float32)
    p = gauss_newton.ideal(np.float32)
    state = evaluate(held, p)
    results = [held.v, held.tau, held.weights, state.shifted, state.calibrated, state.residual]
    results += [cost_of(held, state), gradient(held, state, p)]
    assert {item.dtype for item in results} == {np.dtype(np.float32)}


def test_its_result_is_exact_in_fixed_point() -> None:
    found = FLOAT32.fit(drawn(1, 60), MODELS["9"]).parameters
    assert all(np.float32(value / ONE) * ONE == value for value in found)


@pytest.mark.parametrize("model", ["6", "9", "9T"])
def test_bfgs_ends_at_the_least_squares_optimum_to_eight_digits(model: str) -> None:
    held = made(1, 70, warm=model.endswith("T"), weighted=True)
    found = np.array(fit_bfgs(held, MODELS[model]).parameters) / ONE
    assert np.abs(found - least_squares(held, MODELS[model].free).p).max() < 1e-8


def test_too_few_iterations_of_bfgs_are_an_error() -> None:
    held = made(1, 70, warm=False, weighted=False)
    with pytest.raises(DivergedError, match="not converged after 3 iterations"):
        fit_bfgs(held, MODELS["9"], replace(BFGS_DEFAULT, max_iterations=3))


@pytest.mark.parametrize("name", ["bfgs", "differential-evolution"])
def test_without_scipy_the_remedy_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    optimizer = named_optimizer(name)
    held = made(1, 20, warm=False, weighted=False)
    with pytest.raises(UsageError, match=rf"{name} needs SciPy; pip install scipy$"):
        optimizer.fit(held, MODELS["6"], optimizer.settings["default"])
    assert optimizer.fit(held, MODELS["0"], optimizer.settings["default"]).parameters == IDENTITY


def test_without_scipy_the_others_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    held = made(1, 30, warm=False, weighted=False)
    for optimizer in all_optimizers():
        if optimizer.name not in ("bfgs", "differential-evolution"):
            assert optimizer.fit(held, MODELS["6"], optimizer.settings["default"]).iterations >= 1


def test_any_seed_ends_at_the_optimum_and_the_same_seed_at_the_same_bits() -> None:
    held = made(1, 40, warm=False, weighted=True)
    best = least_squares(held, MODELS["9"].free).p
    runs = [fit_evolution(held, MODELS["9"], replace(EVOLUTION_DEFAULT, seed=seed)) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]
    for run in runs:
        assert np.abs(np.array(run.parameters) / ONE - best).max() < 1e-5


def test_a_search_that_ends_at_the_edge_of_its_box_is_an_error() -> None:
    with pytest.raises(DivergedError, match="edge of its box"):
        fit_evolution(points(0.7 * directions(30)), MODELS["6"])


def test_too_few_generations_are_an_error() -> None:
    with pytest.raises(DivergedError, match="not converged after 5 generations"):
        fit_evolution(
            made(1, 40, warm=False, weighted=False),
            MODELS["9"],
            replace(EVOLUTION_DEFAULT, max_generations=5),
        )
