"""Judging coefficients that were not found from the points at hand."""

from __future__ import annotations

from math import fsum

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.judgement import Holdout
from accelcal_cli.core.points import Calibration, PointSet
from accelcal_cli.judge.errors import interval95, per_posture
from accelcal_cli.judge.holdout import of_postures
from accelcal_cli.judge.postures import postures

FEWEST_POSTURES = 2


def held_out(
    points: PointSet, calibration: Calibration, rest: Gravity, degrees: float, method: str
) -> Holdout | None:
    """Errors before and after on all points, none of which was fitted; whole postures count alike.

    Args:
        points: in units of local gravity, with temperatures where the calibration has slopes.
        rest: what rest measures where the points were recorded.
        degrees: width of a posture.
        method: how it was held out, for the report.

    Returns:
        None for fewer than two postures.
    """
    label = postures(points, degrees)
    if not len(points) or label.max() + 1 < FEWEST_POSTURES:
        return None
    raw = [points.xyz[:, axis] / ONE for axis in range(3)]
    before = per_posture(_deviations_mg(raw), points.weights, label)
    after = per_posture(_deviations_mg(applied(points, calibration, rest)), points.weights, label)
    pairs = tuple((before[key], after[key]) for key in sorted(before))
    return of_postures(method, len(points), pairs)


def better(lent: Holdout, own: Holdout) -> bool:
    """Whether held-out errors are lower than others on the same postures, by more than the uncertainty.

    The 95 % confidence interval of the mean difference, posture by posture, lies above 0.
    """
    pairs = zip(lent.per_posture, own.per_posture, strict=True)
    return interval95([found - less for (_, less), (_, found) in pairs])[0] > 0


def applied(points: PointSet, calibration: Calibration, rest: Gravity) -> list[NDArray[np.float64]]:
    """Calibrated x, y, z of points, in and out in units of local gravity, each (n,).

    Elementwise, so that the figures are the same bits on every machine.
    """
    local_g = float(rest.local_g())
    offset, slope, gain = calibration.offset_g(), calibration.slope_g_per_c(), calibration.gain()
    u = [points.xyz[:, axis] / ONE * local_g + offset[axis] for axis in range(3)]
    if calibration.temperature is not None:
        warmth = temperatures_c(points) - calibration.reference_c()
        u = [value + slope[axis] * warmth for axis, value in enumerate(u)]
    return [(gain[row, 0] * u[0] + gain[row, 1] * u[1] + gain[row, 2] * u[2]) / local_g for row in range(3)]


def temperatures_c(points: PointSet) -> NDArray[np.float64]:
    """Temperatures of points that have them [degrees C], (n,)."""
    assert points.tau is not None and points.temperature is not None
    scale = points.temperature
    return np.asarray(scale.reference_mc / 1000 + points.tau / ONE * scale.span_c, np.float64)


def _deviations_mg(a: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.asarray(np.abs(np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) - 1.0) * 1000.0)


def difference_mg(one: Calibration, other: Calibration, raw_g: NDArray[np.float64]) -> tuple[float, float]:
    """Largest and mean length of the difference of two calibrations' results [mg].

    Args:
        raw_g: raw vectors, (n, 3), at the first one's reference temperature (the other's where it has none).
    """
    at_c = (one if one.temperature is not None else other).reference_c()
    apart = _at(one, raw_g, at_c) - _at(other, raw_g, at_c)
    lengths = (1000 * np.sqrt((apart * apart).sum(axis=1))).tolist()
    return max(lengths), fsum(lengths) / len(lengths)


def _at(calibration: Calibration, raw_g: NDArray[np.float64], at_c: float) -> NDArray[np.float64]:
    shift = calibration.offset_g()
    if calibration.temperature is not None:
        shift = shift + calibration.slope_g_per_c() * (at_c - calibration.reference_c())
    return np.asarray((raw_g + shift) @ calibration.gain().T)
