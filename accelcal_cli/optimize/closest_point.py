"""Iterated closest points on the unit sphere (van Hees et al. 2014), the method of GGIR and others.

Each calibrated point is drawn to the nearest point of the sphere by a weighted straight-line
regression on each axis, with temperature as a second regressor where the model has slopes. After
each round a point weighs the inverse of its distance, bounded so that points within 10 mg weigh the
same: far points lose influence. J. Appl. Physiol. 117, 738-744.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.optimize import _float

MODELS = ("0", "6", "6T")


@dataclass(frozen=True, slots=True)
class Settings:
    """Numbers of the iteration.

    Attributes:
        nearest_g: points within this distance of the sphere weigh the same [g].
        tolerance: converged when the weighted mean squared distance changes by less [g^2].
        max_iterations: bound on the iterations.
        singular: singular values below this part of the largest one are taken for zero.
    """

    nearest_g: float = 0.01
    tolerance: float = 1e-10
    max_iterations: int = 1000
    singular: float = 1e-9


DEFAULT = Settings()


def fit(points: PointSet, model: Model, settings: Settings = DEFAULT) -> Fit:
    """Fit scale and offset, and slopes where the model has them.

    Raises:
        DivergedError: the points do not determine the parameters, the iteration overflows or does
            not converge, or the model is not one of MODELS.
    """
    if model.name not in MODELS:
        raise DivergedError(f"optimizer closest-point does not fit model {model.name}")
    if not model.free or not len(points):
        return _float.nothing_to_fit()
    with _float.no_overflow():
        return _iterate(_float.as_floats(points), model.has_temperature, settings)


def _iterate(points: _float.FloatPoints, has_temperature: bool, settings: Settings) -> Fit:
    """a = line[0] + line[1] v + line[2] tau on each axis, refined round by round."""
    line = np.array([[0.0] * 3, [1.0] * 3, [0.0] * 3])
    one, warmth = np.ones(len(points.v)), [points.tau] if has_temperature else []
    weights, spread = points.weights, np.inf
    for iteration in range(1, settings.max_iterations + 1):
        here = line[0] + line[1] * points.v + np.outer(points.tau, line[2])
        target = here / np.sqrt((here**2).sum(axis=1, keepdims=True))
        moves = [
            _regression([one, here[:, axis], *warmth], target[:, axis], weights, settings.singular)
            for axis in range(3)
        ]
        shift, stretch, slope = np.stack(moves, axis=1)
        line = np.stack([line[0] * stretch + shift, line[1] * stretch, line[2] * stretch + slope])
        moved = shift + stretch * here + np.outer(points.tau, slope)
        squared = ((moved - target) ** 2).sum(axis=1)
        before, spread = spread, float(weights @ squared / weights.sum())
        if abs(before - spread) < settings.tolerance:
            return Fit(_float.as_integers(_parameters(line)), iteration, "small change", Operations())
        weights = points.weights / np.maximum(np.sqrt(squared), settings.nearest_g)
    raise DivergedError(f"the fit has not converged after {settings.max_iterations} iterations")


def _regression(
    regressors: list[_float.Real], target: _float.Real, weights: _float.Real, singular: float
) -> _float.Real:
    """Intercept, slope and temperature coefficient of one axis; the last is 0 where it is not asked for."""
    found = _float.least_squares(np.stack(regressors, axis=1), target, weights, singular)
    return np.append(found, np.zeros(3 - len(found)))


def _parameters(line: _float.Real) -> _float.Real:
    p = _float.ideal()
    p[:3], p[6:9], p[9:12] = line[1], line[0] / line[1], line[2] / line[1]
    return p


OPTIMIZER = Optimizer(
    name="closest-point",
    title="iterated closest points on the unit sphere (van Hees et al. 2014)",
    fit=fit,
    settings={"default": DEFAULT},
    models=MODELS,
)
