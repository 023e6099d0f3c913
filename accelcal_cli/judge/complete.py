"""From a fit to all that is said of it: calibration, standard errors, errors on the fitted points."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.judgement import FitErrors, Judgement
from accelcal_cli.core.points import IDENTITY, MODELS, Calibration, Fit, PointSet, in_standard_g
from accelcal_cli.judge.errors import deviations_mg, mean, per_posture
from accelcal_cli.judge.uncertainty import uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A model fitted to points.

    Attributes:
        label: (n,) posture numbers of the points.
    """

    model: str
    points: PointSet
    label: NDArray[np.int64]
    found: Fit


def complete(verdict: Judgement, fitted: Fitted, gravity: Gravity) -> Judgement:
    """A verdict with its calibration, in standard g, and what is known of it."""
    model, parameters = MODELS[fitted.model], fitted.found.parameters
    scale = fitted.points.temperature if model.has_temperature else None
    local_g = gravity.local_g()
    found = replace(
        verdict,
        calibration=Calibration(fitted.model, in_standard_g(parameters, local_g), scale, gravity),
        fit=fitted.found,
        fit_errors=_errors(fitted),
    )
    known = uncertainty(fitted.points, parameters, model)
    if known is None:
        return found
    seen = replace(
        verdict.coverage,
        condition_number=known.condition_number,
        worst_direction_mg=known.worst_direction_mg,
    )
    errors = [*known.standard_errors[:6], *(value * float(local_g) for value in known.standard_errors[6:])]
    return replace(found, coverage=seen, standard_errors=tuple(errors))


def _errors(fitted: Fitted) -> FitErrors:
    before, after = (
        mean(list(per_posture(deviations_mg(fitted.points, p), fitted.points.weights, fitted.label).values()))
        for p in (IDENTITY, fitted.found.parameters)
    )
    return FitErrors(len(fitted.points), len(set(fitted.label.tolist())), before, after)
