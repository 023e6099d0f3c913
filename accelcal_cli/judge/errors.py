"""How good a fit is: errors of calibrated points in mg, coverage, standard errors and conditioning.

The errors in mg are made by elementwise arithmetic and exact sums only, so that the figures are the same
bits on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import fsum

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE, mean, quantile
from accelcal_cli.core.calibration import Calibration, calibrated
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import WEIGHT_ONE, Model, PointSet
from accelcal_cli.core.results import Coverage, ErrorSummary

Floats = NDArray[np.float64]

INTERVALS_G = ((-1.25, -0.75), (-0.25, 0.25), (0.75, 1.25))
"""F's intervals of an axis [g], by which coverage counts points."""

_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
"""Row and column of each entry of K, in the order of the parameters."""


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """How well a fit is determined.

    Attributes:
        standard_errors: those of the twelve parameters (0 where not free), slopes per scaled degree.
        condition_number: that of the weighted Jacobian, columns scaled to unit length.
        worst_direction_mg: largest standard error of |a| over directions of the sphere.
    """

    standard_errors: tuple[float, ...]
    condition_number: float
    worst_direction_mg: float


def coverage(points: PointSet, label: NDArray[np.int64]) -> Coverage:
    """Return where points lie, before any fit; `label` (n,) is the posture number of each."""
    if not len(points):
        return Coverage(((0, 0, 0),) * 3, (0.0,) * 3, (0.0,) * 3, 0, 0)
    g = points.xyz_g()
    subsets = tuple(
        (int(inside[0]), int(inside[1]), int(inside[2]))
        for inside in (((g >= low) & (g <= high)).sum(axis=0) for low, high in INTERVALS_G)
    )
    distinct = len(set(label.tolist()))
    low, high = g.min(axis=0).tolist(), g.max(axis=0).tolist()
    return Coverage(subsets, (low[0], low[1], low[2]), (high[0], high[1], high[2]), len(points), distinct)


def jacobian(g: Floats, tau: Floats | None, parameters: tuple[int, ...]) -> Floats:
    """Return d(|a|^2 - 1)/dp of raw points g (n, 3) and scaled temperatures (n,): (n, 12)."""
    u, a = _shifted_and_calibrated(g, tau, parameters)
    p = [value / ONE for value in parameters]
    back = [p[0] * a[0] + p[3] * a[1] + p[4] * a[2], p[1] * a[1] + p[5] * a[2], p[2] * a[2]]
    warm = [np.zeros(len(g)) if tau is None else one * tau for one in back]
    return np.asarray(2 * np.stack([*(a[i] * u[j] for i, j in _PAIRS), *back, *warm], axis=1))


def residuals(g: Floats, tau: Floats | None, parameters: tuple[int, ...]) -> Floats:
    """Return |a|^2 - 1 of raw points g (n, 3) and scaled temperatures (n,): (n,)."""
    _, (x, y, z) = _shifted_and_calibrated(g, tau, parameters)
    return np.asarray(x * x + y * y + z * z - 1)


def slope_information(points: PointSet) -> float:
    """Return the least information that points hold on a slope, apart from the offsets; 0 for none.

    With A, B, C the weighted means of g g^T, tau g g^T and tau^2 g g^T (g the raw points), the columns of
    the slopes less what those of the offsets explain have the squares C - B A^-1 B: its smallest eigenvalue.
    """
    if points.tau is None or not points.weights.any():
        return 0.0
    weights, tau, g = points.weights / points.weights.sum(), points.tau / ONE, points.xyz_g()
    a, b, c = ((g * (weights * tau**power)[:, None]).T @ g for power in range(3))
    return float(np.linalg.eigvalsh(c - b @ np.linalg.pinv(a) @ b)[0])


def _shifted_and_calibrated(
    g: Floats, tau: Floats | None, parameters: tuple[int, ...]
) -> tuple[list[Floats], list[Floats]]:
    """Return x, y, z of v + o + s (T - Tref), and of a, elementwise: the same bits on every machine."""
    p = [value / ONE for value in parameters]
    u = [g[:, axis] + p[6 + axis] for axis in range(3)]
    if tau is not None:
        u = [value + p[9 + axis] * tau for axis, value in enumerate(u)]
    x, y, z = u
    return u, [p[0] * x, p[3] * x + p[1] * y, p[4] * x + p[5] * y + p[2] * z]


def uncertainty(points: PointSet, parameters: tuple[int, ...], model: Model) -> Uncertainty | None:
    """Return least-squares standard errors; None if the points do not determine the parameters."""
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
    residual = residuals(points.xyz_g(), tau, parameters)
    variance = float((weights * residual**2).sum()) / surplus
    covariance = np.asarray(variance * np.linalg.inv(weighted.T @ weighted), np.float64)
    errors = np.zeros(12)
    errors[free] = np.sqrt(np.diag(covariance))
    worst = worst_direction_mg(jacobian(directions(), None, parameters)[:, free], covariance)
    return Uncertainty(tuple(errors.tolist()), float(singular[0] / singular[-1]), worst)


def worst_direction_mg(rows: Floats, covariance: Floats) -> float:
    """Return the largest standard error of |a| over directions of the sphere [mg].

    Args:
        rows: (n, k) d(|a|^2 - 1)/dp in each direction; covariance: (k, k) of p.
    """
    variances = np.einsum("ni,ij,nj->n", rows, covariance, rows)
    return float(500 * np.sqrt(variances.max()))  # a standard error of |a|^2 is twice that of |a|


@cache
def directions(number: int = 162) -> Floats:
    """Return directions evenly spread over the sphere (a golden spiral), (number, 3)."""
    index = np.arange(number) + 0.5
    z = 1 - 2 * index / number
    turn = np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def deviations_mg(points: PointSet, parameters: tuple[int, ...]) -> Floats:
    """Return | |a| - 1 g | of each point after calibration [mg], (n,)."""
    p = np.array(parameters) / ONE
    gain = np.array([[p[0], 0, 0], [p[3], p[1], 0], [p[4], p[5], p[2]]])
    heat = None if points.tau is None else (p[9:], points.tau / ONE)
    return lengths_off_mg(calibrated([axis / ONE for axis in points.xyz.T], gain, p[6:9], heat))


def lengths_off_mg(xyz: Sequence[Floats]) -> Floats:
    """Return | |a| - 1 g | of vectors, given as x, y, z, each (n,) [mg], (n,)."""
    x, y, z = xyz
    return np.asarray(np.abs(np.sqrt(x * x + y * y + z * z) - 1.0) * 1000.0)


def per_posture(errors: Floats, weights: NDArray[np.int64], label: NDArray[np.int64]) -> dict[int, float]:
    """Return the weighted mean error of each posture."""
    order = np.argsort(label, kind="stable")
    postures, first = np.unique(label[order], return_index=True)
    shares, weight = (weights * errors)[order].tolist(), weights[order].tolist()
    ends = [*first[1:].tolist(), len(order)]
    return {
        posture: fsum(shares[start:end]) / fsum(weight[start:end])
        for posture, start, end in zip(postures.tolist(), first.tolist(), ends, strict=True)
    }


def summary(values: list[float]) -> ErrorSummary:
    """Return mean, median and 95th percentile (linear interpolation between order statistics)."""
    ordered = sorted(values)
    return ErrorSummary(mean(ordered), quantile(ordered, 0.5), quantile(ordered, 0.95))


def applied(points: PointSet, calibration: Calibration, rest: Gravity) -> list[Floats]:
    """Return calibrated x, y, z of points, each (n,); in and out in units of local gravity."""
    local_g = float(rest.local_g())
    raw = [points.xyz[:, axis] / ONE * local_g for axis in range(3)]
    celsius = None if calibration.temperature is None else temperatures_c(points)
    return [value / local_g for value in calibration.applied(raw, celsius)]


def temperatures_c(points: PointSet) -> Floats:
    """Return the temperatures [degrees C] of points that have them, (n,)."""
    assert points.tau is not None and points.temperature is not None
    scale = points.temperature
    return np.asarray(scale.reference_mc / 1000 + points.tau / ONE * scale.span_c, np.float64)


def apart_mg(one: Calibration, other: Calibration) -> float:
    """Return the mean | |a| - 1 g | over all directions by one calibration, if the other one is true [mg].

    Offsets are those at the other's reference temperature.
    """
    celsius = other.reference_c() or one.reference_c()
    raw = other.bent(np.linalg.solve(other.gain(), directions().T).T - other.offset_at(celsius))
    return 1000 * float(np.abs(np.sqrt((_at(one, raw, celsius) ** 2).sum(axis=1)) - 1).mean())


def difference_mg(one: Calibration, other: Calibration, raw_g: Floats) -> tuple[float, float]:
    """Return the largest and mean length of the difference between two calibrations' results [mg].

    Args:
        raw_g: raw vectors (n, 3), at the reference temperature of `one`, or of `other` if it has none.
    """
    at_c = (one if one.temperature is not None else other).reference_c()
    difference = _at(one, raw_g, at_c) - _at(other, raw_g, at_c)
    lengths = (1000 * np.sqrt((difference * difference).sum(axis=1))).tolist()
    return max(lengths), fsum(lengths) / len(lengths)


def _at(calibration: Calibration, raw_g: Floats, at_c: float) -> Floats:
    return np.asarray((calibration.straight(raw_g) + calibration.offset_at(at_c)) @ calibration.gain().T)
