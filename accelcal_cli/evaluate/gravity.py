"""Table 8 of Grammenos, Mascolo, Crowcroft 2018: what a wrong value of gravity does.

The points rest at local gravity. They are fitted twice: as if rest measured standard gravity, and
knowing the local one, as with `calibrate --latitude`. The paper reports "the calibration residual error
in cost function E" and does not say against which gravity: nine parameters absorb a wrong one in the
scale, so that the residual against the assumed gravity does not show it. Both are reported here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.gravity import STANDARD_GRAVITY
from accelcal_cli.core.points import Calibration, in_standard_g
from accelcal_cli.evaluate.cases import Case, Method, Plan, as_points, make_case, measured
from accelcal_cli.judge.errors import directions

Real = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Residuals:
    """What is left after fits that assume one gravity, means over the cases.

    Attributes:
        assumed_m_s2: gravity that the fit was told.
        against_assumed, against_true: E = mean of (|A|^2 - g^2)^2 over the fitted points [m4/s8].
        norm_error_mg: mean error of |a| over directions of the sphere, without noise [mg].
        fitted: number of cases.
    """

    assumed_m_s2: float
    against_assumed: float
    against_true: float
    norm_error_mg: float
    fitted: int


def run(
    plan: Plan, method: Method, cases: int, seed: int, progress: Callable[[int], None]
) -> tuple[Residuals, ...]:
    """Residuals with standard and with local gravity; `plan.rest_g` is the local one.

    Raises:
        UsageError: nine subsets cannot share the plan's points.
        DivergedError: no case can be fitted.
    """
    plan.check()
    kept: list[tuple[Fraction, list[Real]]] = [(Fraction(1), []), (plan.rest_g, [])]
    for index in range(cases):
        case = make_case(plan, seed, index)
        for assumed_g, rows in kept:
            rows.extend(_left(method, case, assumed_g, float(plan.rest_g)))
        progress(index + 1)
    return tuple(_means(assumed_g, rows) for assumed_g, rows in kept)


def _left(method: Method, case: Case, assumed_g: Fraction, true_g: float) -> list[Real]:
    """One row of figures, none where the fit fails."""
    try:
        found = method.fit(as_points(case.points.xyz_g() / float(assumed_g)))
    except DivergedError:
        return []
    made = Calibration(method.model.name, in_standard_g(found.parameters, assumed_g))
    fitted = _norms(made, case.points.xyz_g())
    exact = _norms(made, measured(case.truth, true_g * directions()))
    mg = 1e3 * float(np.abs(exact - true_g).mean())
    return [np.array([_cost(fitted, float(assumed_g)), _cost(fitted, true_g), mg])]


def _norms(made: Calibration, raw_g: Real) -> Real:
    return np.asarray(np.linalg.norm((raw_g + made.offset_g()) @ made.gain().T, axis=1))


def _cost(norms_g: Real, gravity_g: float) -> float:
    """E of G eq. 5, of norms and gravity in standard g, in m4/s8."""
    return float(((norms_g**2 - gravity_g**2) ** 2).mean()) * STANDARD_GRAVITY**4


def _means(assumed_g: Fraction, rows: list[Real]) -> Residuals:
    if not rows:
        raise DivergedError("no case could be fitted")
    assumed, true, mg = np.mean(rows, axis=0).tolist()
    return Residuals(round(float(assumed_g) * STANDARD_GRAVITY, 6), assumed, true, mg, len(rows))
