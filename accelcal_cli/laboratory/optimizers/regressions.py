"""Two published methods that solve linear regressions: iterated closest points and the ellipsoid.

Iterated closest points on the unit sphere (van Hees et al. 2014, J. Appl. Physiol. 117, 738-744) is the
method of GGIR and others. Each calibrated point is drawn to the nearest point of the sphere by a weighted
straight-line regression on each axis, with temperature as a second regressor where the model has slopes.
After each round a point weighs the inverse of its distance, bounded so that points within 10 mg weigh the
same: far points lose influence.

The axis-aligned ellipsoid (Gietzelt et al. 2013) needs no iteration. A measured v lies on
sum k_i^2 (v_i + o_i)^2 = 1. Written out, that is linear in the coefficients of v_i^2 and v_i; scale and
offset follow from them. Misalignment would need the mixed products and temperature has no place in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.optimize.gauss_newton import (
    FloatPoints,
    Real,
    as_floats,
    as_integers,
    ideal,
    no_overflow,
    nothing_to_fit,
)


def _least_squares(columns: Real, values: Real, weights: Real, singular: float) -> Real:
    """Solve the weighted least squares of (n,) values on (n, m) columns, (m,).

    Args:
        singular: singular values below this part of the largest one are treated as zero.

    Raises:
        DivergedError: the points do not determine the parameters.
    """
    root = np.sqrt(weights)
    solution, _, rank, _ = np.linalg.lstsq(columns * root[:, np.newaxis], values * root, rcond=singular)
    if rank < columns.shape[1]:
        raise DivergedError("the points do not determine the parameters")
    return np.asarray(solution)


CLOSEST_POINT_MODELS = ("0", "6", "6T")


@dataclass(frozen=True, slots=True)
class ClosestPointSettings:
    """Numbers of the iteration.

    Attributes:
        nearest_g: points within this distance of the sphere weigh the same [g].
        tolerance: converged when the weighted mean squared distance changes by less [g^2].
        max_iterations: bound on the iterations.
        singular: singular values below this part of the largest one are treated as zero.
    """

    nearest_g: float = 0.01
    tolerance: float = 1e-10
    max_iterations: int = 1000
    singular: float = 1e-9


CLOSEST_POINT_DEFAULT = ClosestPointSettings()


def fit_closest_point(
    points: PointSet, model: Model, settings: ClosestPointSettings = CLOSEST_POINT_DEFAULT
) -> Fit:
    """Fit scale and offset, and slopes where the model has them.

    Raises:
        DivergedError: the points do not determine the parameters, the iteration overflows or does
            not converge, or the model is not one of CLOSEST_POINT_MODELS.
    """
    if model.name not in CLOSEST_POINT_MODELS:
        raise DivergedError(f"optimizer closest-point does not fit model {model.name}")
    if not model.free or not len(points):
        return nothing_to_fit()
    with no_overflow():
        return _iterate_closest_points(as_floats(points), model.has_temperature, settings)


def _iterate_closest_points(
    points: FloatPoints, has_temperature: bool, settings: ClosestPointSettings
) -> Fit:
    """Refine a = line[0] + line[1] v + line[2] tau on each axis, round by round."""
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
            p = ideal()
            p[:3], p[6:9], p[9:12] = line[1], line[0] / line[1], line[2] / line[1]
            return Fit(as_integers(p), iteration, "small change", Operations())
        weights = points.weights / np.maximum(np.sqrt(squared), settings.nearest_g)
    raise DivergedError(f"the fit has not converged after {settings.max_iterations} iterations")


def _regression(regressors: list[Real], target: Real, weights: Real, singular: float) -> Real:
    """Return intercept, slope and temperature coefficient of one axis; the last is 0 unless asked for."""
    solution = _least_squares(np.stack(regressors, axis=1), target, weights, singular)
    return np.append(solution, np.zeros(3 - len(solution)))


CLOSEST_POINT = Optimizer(
    name="closest-point",
    title="iterated closest points on the unit sphere (van Hees et al. 2014)",
    fit=fit_closest_point,
    settings={"default": CLOSEST_POINT_DEFAULT},
    models=CLOSEST_POINT_MODELS,
)


ELLIPSOID_MODELS = ("0", "3", "6")


@dataclass(frozen=True, slots=True)
class EllipsoidSettings:
    """Numbers of the fit.

    Attributes:
        singular: singular values below this part of the largest one are treated as zero.
    """

    singular: float = 1e-9


ELLIPSOID_DEFAULT = EllipsoidSettings()


def fit_ellipsoid(points: PointSet, model: Model, settings: EllipsoidSettings = ELLIPSOID_DEFAULT) -> Fit:
    """Fit scale and offset, or the offset alone.

    Raises:
        DivergedError: the points determine no ellipsoid, or the model is not one of ELLIPSOID_MODELS.
    """
    if model.name not in ELLIPSOID_MODELS:
        raise DivergedError(f"optimizer ellipsoid does not fit model {model.name}")
    if not model.free or not len(points):
        return nothing_to_fit()
    solve = _ellipsoid if 0 in model.free else _sphere
    with no_overflow():
        return Fit(as_integers(solve(as_floats(points), settings)), 1, "solved", Operations())


def _ellipsoid(points: FloatPoints, settings: EllipsoidSettings) -> Real:
    """Solve sum (q_i v_i^2 + l_i v_i) = 1: o_i = l_i / 2 q_i, and k_i^2 = q_i / (1 + sum q_i o_i^2)."""
    columns = np.hstack([points.v**2, points.v])
    found = _least_squares(columns, np.ones(len(points.v)), points.weights, settings.singular)
    square, linear = found[:3], found[3:]
    if float(square.min()) <= 0:
        raise DivergedError("the points lie on no ellipsoid")
    p = ideal()
    p[6:9] = linear / (2 * square)
    p[:3] = np.sqrt(square / (1 + float(square @ p[6:9] ** 2)))
    return p


def _sphere(points: FloatPoints, settings: EllipsoidSettings) -> Real:
    """Solve |v|^2 + sum l_i v_i = c: o_i = l_i / 2; the radius follows from c and is not used."""
    columns = np.hstack([points.v, -np.ones((len(points.v), 1))])
    found = _least_squares(columns, -(points.v**2).sum(axis=1), points.weights, settings.singular)
    p = ideal()
    p[6:9] = found[:3] / 2
    return p


ELLIPSOID = Optimizer(
    name="ellipsoid",
    title="linear least squares for an axis-aligned ellipsoid (Gietzelt et al. 2013)",
    fit=fit_ellipsoid,
    settings={"default": ELLIPSOID_DEFAULT},
    models=ELLIPSOID_MODELS,
)


OPTIMIZER = (CLOSEST_POINT, ELLIPSOID)
