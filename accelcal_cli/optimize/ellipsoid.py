"""Linear least squares for an axis-aligned ellipsoid, without iteration (Gietzelt et al. 2013).

A measured v lies on the ellipsoid sum k_i^2 (v_i + o_i)^2 = 1. Written out, that is linear in the
coefficients of v_i^2 and v_i; scale and offset follow from them. Misalignment would need the mixed
products and temperature has no place in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.optimize import _float

MODELS = ("0", "3", "6")


@dataclass(frozen=True, slots=True)
class Settings:
    """Numbers of the fit.

    Attributes:
        singular: singular values below this part of the largest one are taken for zero.
    """

    singular: float = 1e-9


DEFAULT = Settings()


def fit(points: PointSet, model: Model, settings: Settings = DEFAULT) -> Fit:
    """Fit scale and offset, or the offset alone.

    Raises:
        DivergedError: the points determine no ellipsoid, or the model is not one of MODELS.
    """
    if model.name not in MODELS:
        raise DivergedError(f"optimizer ellipsoid does not fit model {model.name}")
    if not model.free or not len(points):
        return _float.nothing_to_fit()
    solve = _ellipsoid if 0 in model.free else _sphere
    with _float.no_overflow():
        return Fit(_float.as_integers(solve(_float.as_floats(points), settings)), 1, "solved", Operations())


def _ellipsoid(points: _float.FloatPoints, settings: Settings) -> _float.Real:
    """From sum (q_i v_i^2 + l_i v_i) = 1: o_i = l_i / 2 q_i, and k_i^2 = q_i / (1 + sum q_i o_i^2)."""
    columns = np.hstack([points.v**2, points.v])
    found = _float.least_squares(columns, np.ones(len(points.v)), points.weights, settings.singular)
    square, linear = found[:3], found[3:]
    if float(square.min()) <= 0:
        raise DivergedError("the points lie on no ellipsoid")
    p = _float.ideal()
    p[6:9] = linear / (2 * square)
    p[:3] = np.sqrt(square / (1 + float(square @ p[6:9] ** 2)))
    return p


def _sphere(points: _float.FloatPoints, settings: Settings) -> _float.Real:
    """From |v|^2 + sum l_i v_i = c: o_i = l_i / 2. The radius that c stands for is left aside."""
    columns = np.hstack([points.v, -np.ones((len(points.v), 1))])
    found = _float.least_squares(columns, -(points.v**2).sum(axis=1), points.weights, settings.singular)
    p = _float.ideal()
    p[6:9] = found[:3] / 2
    return p


OPTIMIZER = Optimizer(
    name="ellipsoid",
    title="linear least squares for an axis-aligned ellipsoid (Gietzelt et al. 2013)",
    fit=fit,
    settings={"default": DEFAULT},
    models=MODELS,
)
