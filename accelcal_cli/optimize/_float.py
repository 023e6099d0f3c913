"""The calibration model, its cost and its derivatives in floating point, over all points at once.

Also F's gradient descent for any floating-point type, and access to SciPy, which only two optimizers need.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError, UsageError
from accelcal_cli.core.fixed import LIMIT, ONE
from accelcal_cli.core.points import IDENTITY, Fit, Model, Operations, Optimizer, PointSet

Real = NDArray[np.floating[Any]]
ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
"""Where the first six parameters stand in K."""

RISE_TOLERANCE = 2.0**-12
"""A rise of the cost counts from one part in 4096, as in fixed point."""

RATES_OF_F = {"scale": 0.3, "misalignment": 0.8, "offset": 0.2, "slope": 0.2}
"""F section II.C; the slopes act on the offsets through scaled temperatures of order 1."""


@dataclass(frozen=True, slots=True, eq=False)
class FloatPoints:
    """Points as floating-point numbers of one type.

    Attributes:
        v: (n, 3) raw positions [g].
        tau: (n,) scaled temperatures, zeros without temperature.
        weights: (n,) with a sum of one.
    """

    v: Real
    tau: Real
    weights: Real


@dataclass(frozen=True, slots=True, eq=False)
class FloatState:
    """u = v + o + s tau and a = K u, (..., n, 3); r = |a|^2 - 1, (..., n)."""

    shifted: Real
    calibrated: Real
    residual: Real


def nothing_to_fit() -> Fit:
    """The ideal sensor, for a model without free parameters and for no points."""
    return Fit(IDENTITY, 0, "nothing to fit", Operations())


def ideal(kind: type[np.floating[Any]] = np.float64) -> Real:
    """The twelve parameters of an ideal sensor."""
    return np.asarray(np.array(IDENTITY, kind) / kind(ONE))


def as_floats(points: PointSet, kind: type[np.floating[Any]] = np.float64) -> FloatPoints:
    """Points of one floating-point type; raises DivergedError if no point has weight."""
    total = int(points.weights.sum())
    if total <= 0:
        raise DivergedError("no point has any weight")
    tau = np.zeros(len(points)) if points.tau is None else points.tau / ONE
    return FloatPoints(points.xyz_g().astype(kind), tau.astype(kind), (points.weights / total).astype(kind))


def gain(p: Real) -> Real:
    """K of (..., 12) parameters, (..., 3, 3) lower triangular (F eq. 7-9)."""
    k = np.zeros((*p.shape[:-1], 3, 3), p.dtype)
    for index, (row, column) in enumerate(ENTRIES):
        k[..., row, column] = p[..., index]
    return k


def evaluate(points: FloatPoints, p: Real) -> FloatState:
    """The model at (..., 12) parameters."""
    slopes = points.tau[:, np.newaxis] * p[..., np.newaxis, 9:12]
    shifted = points.v + p[..., np.newaxis, 6:9] + slopes
    calibrated = shifted @ np.swapaxes(gain(p), -1, -2)
    return FloatState(shifted, calibrated, (calibrated**2).sum(axis=-1) - 1)


def cost(points: FloatPoints, state: FloatState) -> Real:
    """Weighted mean of r^2, one for each set of parameters."""
    return np.asarray((state.residual**2) @ points.weights)


def jacobian(points: FloatPoints, state: FloatState, p: Real) -> Real:
    """dr/dp, (n, 12), for one set of parameters."""
    columns = [state.calibrated[:, row] * state.shifted[:, column] for row, column in ENTRIES]
    back = state.calibrated @ gain(p)
    return 2 * np.column_stack([*columns, back, back * points.tau[:, np.newaxis]])


def gradient(points: FloatPoints, state: FloatState, p: Real) -> Real:
    """Gradient of the cost, (12,)."""
    return 2 * ((points.weights * state.residual) @ jacobian(points, state, p))


@contextmanager
def no_overflow() -> Iterator[None]:
    """Turn overflow, division by zero and not-a-number into a DivergedError."""
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            yield
    except (FloatingPointError, np.linalg.LinAlgError) as error:
        raise DivergedError("the fit leaves the range of floating-point numbers") from error


def as_integers(p: Real) -> tuple[int, ...]:
    """Twelve fixed-point integers.

    Raises:
        DivergedError: a parameter is no number or beyond the fixed-point range, or an axis has
            collapsed or turned round.
    """
    if not np.isfinite(p).all() or float(np.abs(p).max()) * ONE > LIMIT - 1:
        raise DivergedError("a parameter leaves the fixed-point range")
    if float(p[:3].min()) <= 0:
        raise DivergedError("the fit turns an axis round")
    return tuple(round(float(value) * ONE) for value in p)


def least_squares(columns: Real, values: Real, weights: Real, singular: float) -> Real:
    """Weighted least squares of (n,) values on (n, m) columns, (m,).

    Args:
        singular: singular values below this part of the largest one are taken for zero.

    Raises:
        DivergedError: the points do not determine the parameters.
    """
    root = np.sqrt(weights)
    solution, _, rank, _ = np.linalg.lstsq(columns * root[:, np.newaxis], values * root, rcond=singular)
    if rank < columns.shape[1]:
        raise DivergedError("the points do not determine the parameters")
    return np.asarray(solution)


@dataclass(frozen=True, slots=True)
class Settings:
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


PAPER = Settings(max_iterations=50, smallest_step=0.0)


def gradient_descent(precision: str, kind: type[np.floating[Any]], smallest_step: float) -> Optimizer:
    """The optimizer that descends in numbers of one kind.

    Args:
        smallest_step: by default; a step below half the last bit of the result rounds to nothing.
    """
    default = Settings(max_iterations=20_000, smallest_step=smallest_step)

    def fit(points: PointSet, model: Model, settings: Settings = default) -> Fit:
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


def _rates(settings: Settings, model: Model, kind: np.dtype[Any]) -> Real:
    groups = ("scale", "misalignment", "offset", "slope")
    every = np.array([settings.rates[name] for name in groups for _ in range(3)], kind)
    rates = np.zeros(12, kind)
    rates[list(model.free)] = every[list(model.free)]
    return rates


def _forward(points: FloatPoints, model: Model, settings: Settings) -> Fit:
    """F's iteration to the letter: forward differences, fixed rates, so many iterations."""
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
    operations = _operations(settings.max_iterations, len(free), len(points.v))
    return Fit(as_integers(p), settings.max_iterations, "iterations", operations, tuple(history))


def _operations(iterations: int, free: int, number: int) -> Operations:
    """As F counts them: ten of each for a point and a set of parameters, one for three parameters."""
    each = iterations * ((free + 1) * 10 * number + free // 3)
    return Operations(each, each)


def _accelerated(points: FloatPoints, model: Model, settings: Settings) -> Fit:
    """Descent with momentum along the exact gradient until a step vanishes.

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


def scipy_optimize(optimizer: str) -> Any:
    """The module scipy.optimize.

    Raises:
        UsageError: SciPy is not installed.
    """
    try:
        import scipy.optimize
    except ImportError as error:
        raise UsageError(
            f"optimizer {optimizer} needs SciPy", hint="pip install 'accelcal[methods]'"
        ) from error
    return scipy.optimize
