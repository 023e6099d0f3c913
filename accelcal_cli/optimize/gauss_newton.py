"""Damped Gauss-Newton (Grammenos, Mascolo, Crowcroft 2018, section 4.2, eq. 3-8).

Cost: the weighted mean of (|A|^2 - g^2)^2 with g = 1, A = S (v + o), o = -B. Three forms of S can
be asked for; the result is always F's lower-triangular K with the same metric, K^T K = S^T S, so
that |A| is the same. A full S is free up to a rotation (|R A| = |A|): its twelve parameters are not
determined by gravity alone, so each step is the shortest of those that fit, and K fixes the gauge.
The laboratory's optimizers share how points and results become floating-point numbers and back.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import LIMIT, ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, PointSet

SMALLEST_CHANGE = 1 / ONE
"""Change below the result's last bit, which counts as none; guards eq. 8 against division by zero."""

SINGULAR = 1e-9
"""Share of the largest singular value below which others count as zero."""

Form = Literal["lower", "symmetric", "full"]

Real = NDArray[np.floating[Any]]

ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
"""Row and column in K of the first six parameters."""


@dataclass(frozen=True, slots=True)
class GaussNewtonSettings:
    """Numbers of the iteration.

    Attributes:
        form: `lower` (F's K), `symmetric` (nine parameters of G) or `full` (twelve).
        damping: delta of eq. 6, at most 1.
        tolerance: epsilon of eq. 8.
        max_iterations: largest number of iterations.
    """

    form: Form = "lower"
    damping: float = 0.9
    tolerance: float = 1e-6
    max_iterations: int = 100


DEFAULT = GaussNewtonSettings()


@dataclass(frozen=True, slots=True, eq=False)
class FloatPoints:
    """Points as floating-point numbers of one type.

    Attributes:
        v: (n, 3) raw positions [g].
        tau: (n,) scaled temperatures, zeros without temperature.
        weights: (n,), with sum 1.
    """

    v: Real
    tau: Real
    weights: Real


def nothing_to_fit() -> Fit:
    """Return the ideal sensor, for a model without free parameters or for no points."""
    return Fit(IDENTITY, 0, "nothing to fit", Operations())


def ideal(kind: type[np.floating[Any]] = np.float64) -> Real:
    """Return the twelve parameters of an ideal sensor."""
    return np.asarray(np.array(IDENTITY, kind) / kind(ONE))


def as_floats(points: PointSet, kind: type[np.floating[Any]] = np.float64) -> FloatPoints:
    """Convert points to a floating-point type; raises DivergedError if no point has weight."""
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
    """Convert parameters to twelve fixed-point integers.

    Raises:
        DivergedError: a parameter is not finite or beyond the fixed-point range, or an axis has
            collapsed or turned round.
    """
    if not np.isfinite(p).all() or float(np.abs(p).max()) * ONE > LIMIT - 1:
        raise DivergedError("a parameter leaves the fixed-point range")
    if float(p[:3].min()) <= 0:
        raise DivergedError("the fit turns an axis round")
    return tuple(round(float(value) * ONE) for value in p)


def fit(points: PointSet, model: Model, settings: GaussNewtonSettings = DEFAULT) -> Fit:
    """Fit the free parameters of a model.

    Raises:
        DivergedError: the points do not determine the parameters, or the iteration overflows or
            does not converge.
    """
    if not model.free or not len(points):
        return nothing_to_fit()
    with no_overflow():
        return _iterate(as_floats(points), model, settings)


def _basis(model: Model, form: Form) -> Real:
    """Return the directions in which S (nine entries by rows), o and s may move, (15, number)."""
    columns = []
    for row, column in (ENTRIES[index] for index in model.free if index < 6):
        unit = _unit(3 * row + column)
        columns.append(np.maximum(unit, _unit(3 * column + row)) if form == "symmetric" else unit)
    if form == "full" and 3 in model.free:
        columns += [_unit(3 * column + row) for row, column in ENTRIES[3:]]
    columns += [_unit(index + 3) for index in model.free if index >= 6]
    return np.stack(columns, axis=1)


def _unit(index: int) -> Real:
    return np.asarray(np.eye(15)[index])


def _iterate(points: FloatPoints, model: Model, settings: GaussNewtonSettings) -> Fit:
    basis = _basis(model, settings.form)
    now = np.concatenate([np.eye(3).ravel(), np.zeros(6)])
    for iteration in range(1, settings.max_iterations + 1):
        step, rank = _step(points, basis, now)
        if rank < len(model.free):
            raise DivergedError("the points do not determine the parameters")
        change = settings.damping * (basis @ step)
        before, now = now, now - change
        small = np.maximum(settings.tolerance * np.abs((now + before) / 2), SMALLEST_CHANGE)
        if (np.abs(change) <= small).all():
            return Fit(as_integers(_lower(now)), iteration, "small change", Operations())
    raise DivergedError(f"the fit has not converged after {settings.max_iterations} iterations")


def _step(points: FloatPoints, basis: Real, now: Real) -> tuple[Real, int]:
    """Return H^-1 J of eq. 6 in the directions of the basis, with the Gauss-Newton H, and H's rank."""
    s, offset, slope = now[:9].reshape(3, 3), now[9:12], now[12:]
    shifted = points.v + offset + points.tau[:, np.newaxis] * slope
    calibrated = shifted @ s.T
    residual = (calibrated**2).sum(axis=1) - 1
    back = calibrated @ s
    products = (calibrated[:, :, np.newaxis] * shifted[:, np.newaxis, :]).reshape(-1, 9)
    slopes = 2 * np.hstack([products, back, back * points.tau[:, np.newaxis]]) @ basis
    root = np.sqrt(points.weights)
    step, _, rank, _ = np.linalg.lstsq(slopes * root[:, np.newaxis], residual * root, rcond=SINGULAR)
    return np.asarray(step), int(rank)


def _lower(now: Real) -> Real:
    """Return the twelve parameters with the lower-triangular K of the same metric."""
    s = now[:9].reshape(3, 3)
    upper = np.linalg.cholesky((s.T @ s)[::-1, ::-1])
    k = upper.T[::-1, ::-1]
    return np.concatenate([[k[row, column] for row, column in ENTRIES], now[9:]])


OPTIMIZER = Optimizer(
    name="gauss-newton",
    title="damped Gauss-Newton (Grammenos, Mascolo, Crowcroft 2018)",
    fit=fit,
    settings={"default": DEFAULT, "symmetric": GaussNewtonSettings(form="symmetric")},
)
