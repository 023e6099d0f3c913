"""Errors in mg of calibrated points. Elementwise arithmetic and exact sums only, so that the
figures are the same bits on every machine."""

from __future__ import annotations

from math import fsum, sqrt

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.judgement import ErrorSummary
from accelcal_cli.core.points import PointSet

STUDENT_T_975 = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
    2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
)  # fmt: skip
"""97.5 % quantile of Student's t for 1 to 30 degrees of freedom; 1.96 + 2.4 / df beyond."""


def deviations_mg(points: PointSet, parameters: tuple[int, ...]) -> NDArray[np.float64]:
    """| |a| - 1 g | of each point after calibration [mg], (n,)."""
    p = [value / ONE for value in parameters]
    u = [points.xyz[:, axis] / ONE + p[6 + axis] for axis in range(3)]
    if points.tau is not None:
        u = [value + p[9 + axis] * (points.tau / ONE) for axis, value in enumerate(u)]
    ax = p[0] * u[0]
    ay = p[3] * u[0] + p[1] * u[1]
    az = p[4] * u[0] + p[5] * u[1] + p[2] * u[2]
    return np.asarray(np.abs(np.sqrt(ax * ax + ay * ay + az * az) - 1.0) * 1000.0)


def per_posture(
    errors: NDArray[np.float64], weights: NDArray[np.int64], label: NDArray[np.int64]
) -> dict[int, float]:
    """Weighted mean error of each posture."""
    means = {}
    for posture in sorted(set(label.tolist())):
        at = label == posture
        held = [float(w) for w in weights[at]]
        means[posture] = fsum(w * float(e) for w, e in zip(held, errors[at], strict=True)) / fsum(held)
    return means


def mean(values: list[float]) -> float:
    """Exactly rounded sum over number."""
    return fsum(values) / len(values)


def summary(values: list[float]) -> ErrorSummary:
    """Mean, median and 95th percentile (linear interpolation between order statistics)."""
    ordered = sorted(values)
    return ErrorSummary(mean(ordered), quantile(ordered, 0.5), quantile(ordered, 0.95))


def quantile(ordered: list[float], share: float) -> float:
    """Quantile of sorted values by linear interpolation."""
    place = share * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (place - low)


def standard_error(values: list[float]) -> float:
    """Standard error of the mean; 0 for fewer than two values."""
    if len(values) < 2:
        return 0.0
    centre = mean(values)
    spread = fsum((value - centre) ** 2 for value in values) / (len(values) - 1)
    return sqrt(spread / len(values))


def clustered_error(values: list[float], clusters: list[int]) -> float:
    """Standard error of the mean of values that are alike within clusters; 0 for one cluster.

    sqrt(G / (G - 1) sum over the G clusters of (sum of deviations)^2) / n, which is
    `standard_error` where every value is a cluster (Liang, Zeger 1986; Cameron, Miller 2015).
    """
    number = len(set(clusters))
    if number < 2:
        return 0.0
    centre = mean(values)
    held: dict[int, list[float]] = {}
    for value, cluster in zip(values, clusters, strict=True):
        held.setdefault(cluster, []).append(value - centre)
    spread = fsum(fsum(part) ** 2 for part in held.values())
    return sqrt(spread * number / (number - 1)) / len(values)


def interval95(values: list[float]) -> tuple[float, float]:
    """95 % confidence interval of the mean, Student's t, not below 0."""
    centre, freedom = mean(values), len(values) - 1
    if freedom < 1:
        return (0.0, float("inf"))
    t = STUDENT_T_975[freedom - 1] if freedom <= len(STUDENT_T_975) else 1.96 + 2.4 / freedom
    half = t * standard_error(values)
    return (max(0.0, centre - half), centre + half)
