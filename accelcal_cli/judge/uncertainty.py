"""Coverage, standard errors and conditioning of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.judgement import Coverage
from accelcal_cli.core.points import WEIGHT_ONE, Model, PointSet

INTERVALS_G = ((-1.25, -0.75), (-0.25, 0.25), (0.75, 1.25))
_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """How well a fit is determined.

    Attributes:
        standard_errors: of the twelve parameters (0 where not free), slopes per scaled degree.
        condition_number: of the weighted Jacobian, columns scaled to unit length.
        worst_direction_mg: largest standard error of |a| over directions of the sphere.
    """

    standard_errors: tuple[float, ...]
    condition_number: float
    worst_direction_mg: float


def coverage(points: PointSet) -> Coverage:
    """Where the points lie, before any fit."""
    if not len(points):
        return Coverage(((0, 0, 0),) * 3, (0.0,) * 3, (0.0,) * 3, 0)
    g = points.xyz_g()
    subsets = tuple(
        (int(inside[0]), int(inside[1]), int(inside[2]))
        for inside in (((g >= low) & (g <= high)).sum(axis=0) for low, high in INTERVALS_G)
    )
    low, high = g.min(axis=0).tolist(), g.max(axis=0).tolist()
    return Coverage(subsets, (low[0], low[1], low[2]), (high[0], high[1], high[2]), len(points))


def jacobian(
    g: NDArray[np.float64], tau: NDArray[np.float64] | None, parameters: tuple[int, ...]
) -> NDArray[np.float64]:
    """d(|a|^2 - 1)/dp for raw points g (n, 3) and scaled temperatures (n,): (n, 12)."""
    p = np.array(parameters) / ONE
    k = np.array([[p[0], 0, 0], [p[3], p[1], 0], [p[4], p[5], p[2]]])
    warm = np.zeros(len(g)) if tau is None else tau
    u = g + p[6:9] + warm[:, None] * p[9:12]
    a = u @ k.T
    back = a @ k
    columns = [a[:, i] * u[:, j] for i, j in _PAIRS] + list(back.T) + list((back * warm[:, None]).T)
    return np.asarray(2 * np.stack(columns, axis=1))


def uncertainty(points: PointSet, parameters: tuple[int, ...], model: Model) -> Uncertainty | None:
    """Least-squares standard errors; None where the points do not determine the parameters."""
    free = list(model.free)
    weights = points.weights / WEIGHT_ONE
    surplus = float(weights.sum()) - len(free)
    if not free or surplus <= 0:
        return None
    tau = None if points.tau is None else points.tau / ONE
    full = jacobian(points.xyz_g(), tau, parameters)[:, free]
    weighted = full * np.sqrt(weights)[:, None]
    lengths = np.sqrt((weighted**2).sum(axis=0))
    if not lengths.all():
        return None
    singular = np.linalg.svd(weighted / lengths, compute_uv=False)
    if singular[-1] < 1e-6 * singular[0]:
        return None
    residual = _residual(points, tau, parameters)
    variance = float((weights * residual**2).sum()) / surplus
    covariance = np.asarray(variance * np.linalg.inv(weighted.T @ weighted), np.float64)
    errors = np.zeros(12)
    errors[free] = np.sqrt(np.diag(covariance))
    worst = _worst_direction(parameters, free, covariance)
    return Uncertainty(tuple(errors.tolist()), float(singular[0] / singular[-1]), worst)


def _residual(
    points: PointSet, tau: NDArray[np.float64] | None, parameters: tuple[int, ...]
) -> NDArray[np.float64]:
    p = np.array(parameters) / ONE
    k = np.array([[p[0], 0, 0], [p[3], p[1], 0], [p[4], p[5], p[2]]])
    warm = np.zeros(len(points)) if tau is None else tau
    a = (points.xyz_g() + p[6:9] + warm[:, None] * p[9:12]) @ k.T
    return np.asarray((a**2).sum(axis=1) - 1)


def _worst_direction(parameters: tuple[int, ...], free: list[int], covariance: NDArray[np.float64]) -> float:
    """A standard error of |a|^2 is twice that of |a|."""
    rows = jacobian(directions(), None, parameters)[:, free]
    variances = np.einsum("ni,ij,nj->n", rows, covariance, rows)
    return float(500 * np.sqrt(variances.max()))


@cache
def directions() -> NDArray[np.float64]:
    """162 directions evenly spread over the sphere (a golden spiral), (162, 3)."""
    index = np.arange(162) + 0.5
    z = 1 - 2 * index / 162
    turn = np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
