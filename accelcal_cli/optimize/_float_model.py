"""The calibration model, its cost and its derivatives in floating point, over all points at once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import LIMIT, ONE
from accelcal_cli.core.points import IDENTITY, Fit, Operations, PointSet

Real = NDArray[np.floating[Any]]
ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
"""Where the first six parameters stand in K."""


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
    """Points of one floating-point type; raises DivergedError where no point has weight."""
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
