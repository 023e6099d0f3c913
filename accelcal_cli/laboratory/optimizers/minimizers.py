"""Minimisers of the cost in floating point: F's gradient descent, and two general ones of SciPy.

F: Farago, Maczak, Gingl 2024, section II.C. BFGS, a quasi-Newton solver, stands for MATLAB's fminunc and
differential evolution, a global search, for LabVIEW's in F's Table 3. The cost and its gradient are those of
all points at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from accelcal_cli.core.errors import DivergedError, UsageError
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.optimize.fixed32 import RATES_OF_F
from accelcal_cli.optimize.gauss_newton import (
    ENTRIES,
    FloatPoints,
    Real,
    as_floats,
    as_integers,
    ideal,
    no_overflow,
    nothing_to_fit,
)

RISE_TOLERANCE = 2.0**-12
"""Relative rise of the cost that counts as one, as in fixed point."""


@dataclass(frozen=True, slots=True, eq=False)
class FloatState:
    """The model at the points: u = v + o + s tau and a = K u, (..., n, 3); r = |a|^2 - 1, (..., n)."""

    shifted: Real
    calibrated: Real
    residual: Real


def gain(p: Real) -> Real:
    """Return K of (..., 12) parameters, (..., 3, 3) lower triangular (F eq. 7-9)."""
    k = np.zeros((*p.shape[:-1], 3, 3), p.dtype)
    for index, (row, column) in enumerate(ENTRIES):
        k[..., row, column] = p[..., index]
    return k


def evaluate(points: FloatPoints, p: Real) -> FloatState:
    """Evaluate the model at (..., 12) parameters."""
    slopes = points.tau[:, np.newaxis] * p[..., np.newaxis, 9:12]
    shifted = points.v + p[..., np.newaxis, 6:9] + slopes
    calibrated = shifted @ np.swapaxes(gain(p), -1, -2)
    return FloatState(shifted, calibrated, (calibrated**2).sum(axis=-1) - 1)


def cost(points: FloatPoints, state: FloatState) -> Real:
    """Return the weighted mean of r^2 for each set of parameters."""
    return np.asarray((state.residual**2) @ points.weights)


def gradient(points: FloatPoints, state: FloatState, p: Real) -> Real:
    """Return the gradient of the cost, (12,)."""
    columns = [state.calibrated[:, row] * state.shifted[:, column] for row, column in ENTRIES]
    back = state.calibrated @ gain(p)
    of_residual = 2 * np.column_stack([*columns, back, back * points.tau[:, np.newaxis]])
    return np.asarray(2 * ((points.weights * state.residual) @ of_residual))


@dataclass(frozen=True, slots=True)
class DescentSettings:
    """Numbers of the descent.

    Attributes:
        max_iterations: bound on the iterations.
        smallest_step: converged when every step is below this; 0: run all iterations with
            forward differences instead.
        forward_step: h of F eq. 13 [g, or none].
        keep_history: return the parameters after every iteration.
    """

    max_iterations: int
    smallest_step: float
    forward_step: float = 1e-5
    rates: dict[str, float] = field(default_factory=lambda: dict(RATES_OF_F))
    keep_history: bool = False


PAPER = DescentSettings(max_iterations=50, smallest_step=0.0)


def gradient_descent(precision: str, kind: type[np.floating[Any]], smallest_step: float) -> Optimizer:
    """Return the optimizer that descends in numbers of one floating-point type.

    Args:
        smallest_step: by default; a step below half the last bit of the result rounds to nothing.
    """
    default = DescentSettings(max_iterations=20_000, smallest_step=smallest_step)

    def fit(points: PointSet, model: Model, settings: DescentSettings = default) -> Fit:
        if not model.free or not len(points):
            return nothing_to_fit()
        descent = _accelerated if settings.smallest_step else _forward
        converted = as_floats(points, kind)
        with no_overflow():
            return descent(converted, model, settings)

    return Optimizer(
        name=kind.__name__,
        title=f"gradient descent in {precision} precision (Farago, Maczak, Gingl 2024)",
        fit=fit,
        settings={"default": default, "paper": PAPER},
    )


def _rates(settings: DescentSettings, model: Model, kind: np.dtype[Any]) -> Real:
    groups = ("scale", "misalignment", "offset", "slope")
    every = np.array([settings.rates[name] for name in groups for _ in range(3)], kind)
    rates = np.zeros(12, kind)
    rates[list(model.free)] = every[list(model.free)]
    return rates


def _forward(points: FloatPoints, model: Model, settings: DescentSettings) -> Fit:
    """Iterate exactly as F does: forward differences, fixed rates, a fixed number of iterations."""
    kind, free = points.v.dtype, list(model.free)
    rates = _rates(settings, model, kind)[free]
    h = kind.type(settings.forward_step)
    p = ideal(kind.type)
    probes = np.zeros((len(free) + 1, 12), kind)
    probes[range(1, len(free) + 1), free] = h
    history: list[tuple[int, ...]] = []
    for _ in range(settings.max_iterations):
        costs = cost(points, evaluate(points, p + probes))
        p[free] -= rates * ((costs[1:] - costs[0]) / h)
        if settings.keep_history:
            history.append(as_integers(p))
    # as F counts: ten of each for a point and a set of parameters, one for three parameters
    each = settings.max_iterations * (len(probes) * 10 * len(points.v) + len(free) // 3)
    operations = Operations(each, each)
    number = settings.max_iterations
    return Fit(as_integers(p), number, "iterations", operations, tuple(history), converged=False)


def _accelerated(points: FloatPoints, model: Model, settings: DescentSettings) -> Fit:
    """Descend with momentum along the exact gradient until a step vanishes.

    Momentum age / (age + 3) (Nesterov 1983) is dropped where it points uphill (O'Donoghue,
    Candes 2015) and where the cost rises; a rise after a plain step halves the rates.
    """
    kind = points.v.dtype
    rates = _rates(settings, model, kind)
    rounding = float(np.finfo(kind).eps) ** 2
    history: list[tuple[int, ...]] = []
    here = before = best = ideal(kind.type)
    lowest = np.inf
    age = 0
    for iteration in range(1, settings.max_iterations + 1):
        ahead = here + (here - before) * kind.type(age / (age + 3))
        state = evaluate(points, ahead)
        reached = float(cost(points, state))
        if reached > lowest * (1 + RISE_TOLERANCE) + rounding:
            rates = rates / 2
            here = before = best
            age = 0
            continue
        if reached < lowest:
            lowest, best = reached, ahead
        slope = gradient(points, state, ahead)
        step = rates * slope
        if settings.keep_history:
            history.append(as_integers(ahead - step))
        longest = float(np.abs(step).max())
        if longest < settings.smallest_step and age == 0:
            return Fit(as_integers(ahead), iteration, "small step", Operations(), tuple(history))
        before, here = here, ahead - step
        downhill = float(slope @ (here - before)) < 0
        age = age + 1 if longest > 2 * settings.smallest_step and downhill else 0
    raise DivergedError(f"the fit has not converged after {settings.max_iterations} iterations")


def _scipy_optimize(optimizer: str) -> Any:
    """Import scipy.optimize; raises UsageError if SciPy is not installed."""
    try:
        import scipy.optimize
    except ImportError as error:
        raise UsageError(f"optimizer {optimizer} needs SciPy", hint="pip install scipy") from error
    return scipy.optimize


@dataclass(frozen=True, slots=True)
class BfgsSettings:
    """Numbers of the solver.

    Attributes:
        gradient_tolerance: the solver aims at a gradient below this.
        accepted_gradient: gradient that is accepted if rounding stops the line search earlier.
        max_iterations: bound on the iterations.
    """

    gradient_tolerance: float = 1e-10
    accepted_gradient: float = 1e-7
    max_iterations: int = 1000


BFGS_DEFAULT = BfgsSettings()


def fit_bfgs(points: PointSet, model: Model, settings: BfgsSettings = BFGS_DEFAULT) -> Fit:
    """Fit the free parameters of a model by BFGS.

    Raises:
        DivergedError: the solver overflows or does not converge.
        UsageError: SciPy is not installed.
    """
    if not model.free or not len(points):
        return nothing_to_fit()
    minimize, free = _scipy_optimize("bfgs").minimize, list(model.free)
    options = {"gtol": settings.gradient_tolerance, "maxiter": settings.max_iterations}
    with no_overflow():
        target = partial(_cost_and_gradient, as_floats(points), free)
        found = minimize(target, ideal()[free], jac=True, method="BFGS", options=options)
    if not float(np.abs(found.jac).max()) < settings.accepted_gradient:
        raise DivergedError(f"the fit has not converged after {int(found.nit)} iterations")
    p = ideal()
    p[free] = found.x
    return Fit(as_integers(p), int(found.nit), "small gradient", Operations())


def _cost_and_gradient(points: FloatPoints, free: list[int], x: Real) -> tuple[float, Real]:
    p = ideal()
    p[free] = x
    state = evaluate(points, p)
    return float(cost(points, state)), gradient(points, state, p)[free]


BFGS = Optimizer(
    name="bfgs",
    title="BFGS of SciPy, a general quasi-Newton solver",
    fit=fit_bfgs,
    settings={"default": BFGS_DEFAULT},
    needs="scipy",
)


@dataclass(frozen=True, slots=True)
class EvolutionSettings:
    """Numbers of the search.

    Attributes:
        reach: how far scale, misalignment, offset [g] and slope [g per span] may lie from ideal.
        seed: of the random numbers; the same seed gives the same result.
        population: members for each free parameter.
        tolerance: converged when the costs' standard deviation is below this part of their mean.
        smallest_spread: or below this [g^4].
        max_generations: bound on the generations.
    """

    reach: tuple[float, float, float, float] = (0.2, 0.2, 0.3, 0.1)
    seed: int = 1
    population: int = 8
    tolerance: float = 1e-8
    smallest_spread: float = 1e-16
    max_generations: int = 3000


EVOLUTION_DEFAULT = EvolutionSettings()


def fit_evolution(points: PointSet, model: Model, settings: EvolutionSettings = EVOLUTION_DEFAULT) -> Fit:
    """Fit the free parameters of a model by differential evolution.

    Raises:
        DivergedError: the search ends at the edge of its box, or does not converge.
        UsageError: SciPy is not installed.
    """
    if not model.free or not len(points):
        return nothing_to_fit()
    search, free = _scipy_optimize("differential-evolution").differential_evolution, list(model.free)
    reach = np.repeat(settings.reach, 3)[free]
    with no_overflow():
        found = search(
            partial(_costs, as_floats(points), free),
            list(zip(ideal()[free] - reach, ideal()[free] + reach, strict=True)),
            seed=settings.seed,
            popsize=settings.population,
            tol=settings.tolerance,
            atol=settings.smallest_spread,
            maxiter=settings.max_generations,
            polish=False,
            updating="deferred",
            vectorized=True,
        )
    if not found.success:
        raise DivergedError(f"the fit has not converged after {int(found.nit)} generations")
    p = ideal()
    p[free] = found.x
    if (np.abs(p - ideal())[free] > 0.999 * reach).any():
        raise DivergedError("the search ends at the edge of its box")
    return Fit(as_integers(p), int(found.nit), "equal costs", Operations())


def _costs(points: FloatPoints, free: list[int], x: Real) -> Real:
    """Return the costs (k,) of (number of parameters, k) candidates."""
    p = np.tile(ideal(), (x.shape[1], 1))
    p[:, free] = x.T
    return cost(points, evaluate(points, p))


EVOLUTION = Optimizer(
    name="differential-evolution",
    title="differential evolution of SciPy, a global search",
    fit=fit_evolution,
    settings={"default": EVOLUTION_DEFAULT},
    needs="scipy",
)


FLOAT32 = gradient_descent("single", np.float32, smallest_step=2.0**-23)
FLOAT64 = gradient_descent("double", np.float64, smallest_step=2.0**-30)
OPTIMIZER = (FLOAT32, FLOAT64, BFGS, EVOLUTION)
