"""Differential evolution, a global search, as LabVIEW's in F's Table 3. Needs SciPy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.optimize import _float


@dataclass(frozen=True, slots=True)
class Settings:
    """Numbers of the search.

    Attributes:
        reach: how far scale, misalignment, offset [g] and slope [g per span] may lie from ideal.
        seed: of the random numbers; the same seed gives the same result.
        population: members for each free parameter.
        tolerance: converged when the costs' standard deviation is below this part of their mean.
        smallest_spread: or below this [g^4].
        max_generations: bound on the generations.
    """

    reach: tuple[float, float, float, float] = (0.2, 0.2, 0.3, 0.1)
    seed: int = 1
    population: int = 8
    tolerance: float = 1e-8
    smallest_spread: float = 1e-16
    max_generations: int = 3000


DEFAULT = Settings()


def fit(points: PointSet, model: Model, settings: Settings = DEFAULT) -> Fit:
    """Fit the free parameters of a model.

    Raises:
        DivergedError: the search ends at the edge of its box, or does not converge.
        UsageError: SciPy is not installed.
    """
    if not model.free or not len(points):
        return _float.nothing_to_fit()
    search, free = _float.scipy_optimize("differential-evolution").differential_evolution, list(model.free)
    reach = np.repeat(settings.reach, 3)[free]
    with _float.no_overflow():
        found = search(
            partial(_costs, _float.as_floats(points), free),
            list(zip(_float.ideal()[free] - reach, _float.ideal()[free] + reach, strict=True)),
            seed=settings.seed,
            popsize=settings.population,
            tol=settings.tolerance,
            atol=settings.smallest_spread,
            maxiter=settings.max_generations,
            polish=False,
            updating="deferred",
            vectorized=True,
        )
    if not found.success:
        raise DivergedError(f"the fit has not converged after {int(found.nit)} generations")
    p = _float.ideal()
    p[free] = found.x
    if (np.abs(p - _float.ideal())[free] > 0.999 * reach).any():
        raise DivergedError("the search ends at the edge of its box")
    return Fit(_float.as_integers(p), int(found.nit), "equal costs", Operations())


def _costs(points: _float.FloatPoints, free: list[int], x: _float.Real) -> _float.Real:
    """Costs of (number of parameters, k) candidates, (k,)."""
    p = np.tile(_float.ideal(), (x.shape[1], 1))
    p[:, free] = x.T
    return _float.cost(points, _float.evaluate(points, p))


OPTIMIZER = Optimizer(
    name="differential-evolution",
    title="differential evolution of SciPy, a global search",
    fit=fit,
    settings={"default": DEFAULT},
    needs="scipy",
)
