"""Damped Gauss-Newton (Grammenos, Mascolo, Crowcroft 2018, section 4.2, eq. 3-8).

Cost: the weighted mean of (|A|^2 - g^2)^2 with g = 1, A = S (v + o), o = -B. Three forms of S can
be asked for; the result is always F's lower-triangular K with the same metric, K^T K = S^T S, so
that |A| is the same. A full S is free up to a rotation (|R A| = |A|): its twelve parameters are not
determined by gravity alone, so each step is the shortest of those that fit, and K fixes the gauge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.optimize import _float

SMALLEST_CHANGE = 1 / ONE
"""A change below the result's last bit counts as none; guards the division of eq. 8 by zero."""

SINGULAR = 1e-9
"""Singular values below this part of the largest one are taken for zero."""

Form = Literal["lower", "symmetric", "full"]


@dataclass(frozen=True, slots=True)
class Settings:
    """Numbers of the iteration.

    Attributes:
        form: `lower` (F's K), `symmetric` (nine parameters of G) or `full` (twelve).
        damping: delta of eq. 6, at most 1.
        tolerance: epsilon of eq. 8.
        max_iterations: bound on the iterations.
    """

    form: Form = "lower"
    damping: float = 0.9
    tolerance: float = 1e-6
    max_iterations: int = 100


DEFAULT = Settings()


def fit(points: PointSet, model: Model, settings: Settings = DEFAULT) -> Fit:
    """Fit the free parameters of a model.

    Raises:
        DivergedError: the points do not determine the parameters, or the iteration overflows or
            does not converge.
    """
    if not model.free or not len(points):
        return _float.nothing_to_fit()
    with _float.no_overflow():
        return _iterate(_float.as_floats(points), model, settings)


def _basis(model: Model, form: Form) -> _float.Real:
    """Directions in which S (nine entries by rows), o and s may move, (15, number)."""
    columns = [_entries(form, index) for index in model.free if index < 6]
    if form == "full" and 3 in model.free:
        columns += [_unit(3 * column + row) for row, column in _float.ENTRIES[3:]]
    columns += [_unit(index + 3) for index in model.free if index >= 6]
    return np.stack(columns, axis=1)


def _entries(form: Form, index: int) -> _float.Real:
    row, column = _float.ENTRIES[index]
    unit = _unit(3 * row + column)
    return np.maximum(unit, _unit(3 * column + row)) if form == "symmetric" else unit


def _unit(index: int) -> _float.Real:
    return np.asarray(np.eye(15)[index])


def _iterate(points: _float.FloatPoints, model: Model, settings: Settings) -> Fit:
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
            return Fit(_float.as_integers(_lower(now)), iteration, "small change", Operations())
    raise DivergedError(f"the fit has not converged after {settings.max_iterations} iterations")


def _step(points: _float.FloatPoints, basis: _float.Real, now: _float.Real) -> tuple[_float.Real, int]:
    """H^-1 J of eq. 6 in the directions of the basis, with the Gauss-Newton H, and H's rank."""
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


def _lower(now: _float.Real) -> _float.Real:
    """The twelve parameters with the lower-triangular K of the same metric."""
    s = now[:9].reshape(3, 3)
    upper = np.linalg.cholesky((s.T @ s)[::-1, ::-1])
    k = upper.T[::-1, ::-1]
    return np.concatenate([[k[row, column] for row, column in _float.ENTRIES], now[9:]])


OPTIMIZER = Optimizer(
    name="gauss-newton",
    title="damped Gauss-Newton (Grammenos, Mascolo, Crowcroft 2018)",
    fit=fit,
    settings={"default": DEFAULT, "symmetric": Settings(form="symmetric")},
)
