"""F's gradient descent in floating point, for any floating-point type."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Fit, Model, Operations, PointSet
from accelcal_cli.optimize._float_model import (
    FloatPoints,
    Real,
    as_floats,
    as_integers,
    cost,
    evaluate,
    gradient,
    ideal,
    no_overflow,
    nothing_to_fit,
)

RISE_TOLERANCE = 2.0**-12
"""A rise of the cost counts from one part in 4096, as in fixed point."""

RATES_OF_F = {"scale": 0.3, "misalignment": 0.8, "offset": 0.2, "slope": 0.2}
"""F section II.C; the slopes act on the offsets through scaled temperatures of order 1."""


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


def descend(points: PointSet, model: Model, settings: Settings, kind: type[np.floating[Any]]) -> Fit:
    """Fit the free parameters of a model in numbers of one kind.

    Raises:
        DivergedError: the descent overflows or has not converged after all its iterations.
    """
    if not model.free or not len(points):
        return nothing_to_fit()
    held = as_floats(points, kind)
    with no_overflow():
        if settings.smallest_step:
            return _accelerated(held, model, settings)
        return _forward(held, model, settings)


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
