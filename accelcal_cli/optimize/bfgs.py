"""BFGS, a general quasi-Newton solver, as MATLAB's fminunc in F's Table 3. Needs SciPy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.optimize import _float


@dataclass(frozen=True, slots=True)
class Settings:
    """Numbers of the solver.

    Attributes:
        gradient_tolerance: the solver aims at a gradient below this.
        accepted_gradient: what is accepted where rounding stops the line search earlier.
        max_iterations: bound on the iterations.
    """

    gradient_tolerance: float = 1e-10
    accepted_gradient: float = 1e-7
    max_iterations: int = 1000


DEFAULT = Settings()


def fit(points: PointSet, model: Model, settings: Settings = DEFAULT) -> Fit:
    """Fit the free parameters of a model.

    Raises:
        DivergedError: the solver overflows or does not converge.
        UsageError: SciPy is not installed.
    """
    if not model.free or not len(points):
        return _float.nothing_to_fit()
    minimize, free = _float.scipy_optimize("bfgs").minimize, list(model.free)
    options = {"gtol": settings.gradient_tolerance, "maxiter": settings.max_iterations}
    with _float.no_overflow():
        target = partial(_cost_and_gradient, _float.as_floats(points), free)
        found = minimize(target, _float.ideal()[free], jac=True, method="BFGS", options=options)
    if not float(np.abs(found.jac).max()) < settings.accepted_gradient:
        raise DivergedError(f"the fit has not converged after {int(found.nit)} iterations")
    return Fit(_float.as_integers(_all(found.x, free)), int(found.nit), "small gradient", Operations())


def _all(x: _float.Real, free: list[int]) -> _float.Real:
    p = _float.ideal()
    p[free] = x
    return p


def _cost_and_gradient(
    points: _float.FloatPoints, free: list[int], x: _float.Real
) -> tuple[float, _float.Real]:
    p = _all(x, free)
    state = _float.evaluate(points, p)
    return float(_float.cost(points, state)), _float.gradient(points, state, p)[free]


OPTIMIZER = Optimizer(
    name="bfgs",
    title="BFGS of SciPy, a general quasi-Newton solver",
    fit=fit,
    settings={"default": DEFAULT},
    needs="scipy",
)
