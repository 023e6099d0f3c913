"""Sensors' parameters and points as floating-point numbers, for the optimizers that compute with them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import LIMIT, ONE
from accelcal_cli.core.points import Fit, Operations, PointSet

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
