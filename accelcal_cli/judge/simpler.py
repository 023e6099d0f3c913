"""What the points of a calibration give without misalignment, for tools whose formula has none.

Such a tool cannot be given a calibration whose K is cut down to its diagonal: scales and offsets have to make
up for what is left out. The simpler model is therefore fitted to the same points, with the same prior, and
held out on the same postures, so that what it costs is known.
"""

from __future__ import annotations

from dataclasses import replace

from accelcal_cli.core.calibration import Calibration, in_standard_g
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import MODELS, Fit, Model, PointSet
from accelcal_cli.core.results import Holdout, Judgement, WithoutMisalignment
from accelcal_cli.judge import model_ladder
from accelcal_cli.judge.model_ladder import Fitting, Sample, blocked
from accelcal_cli.judge.posterior import Posterior, posterior, sphere_errors

SIMPLER = {"9": "6", "9T": "6T"}
"""Models with misalignment, and those that are left of them without it."""


def calibration_of_fit(model: str, fit: Fit, points: PointSet, gravity: Gravity) -> Calibration:
    """What a fit to points makes of raw values, in standard g."""
    scale = points.temperature if MODELS[model].has_temperature else None
    return Calibration(model, in_standard_g(fit.parameters, gravity.local_g()), scale, gravity)


def with_simpler(
    verdict: Judgement, sample: Sample, how: Fitting, truth: Posterior | None = None
) -> Judgement:
    """A verdict with what the same points give without misalignment, held out on the same postures.

    Args:
        truth: what is known of the sensor, for the error over the whole sphere.
    """
    calibration, points, gravity = verdict.calibration, sample.points, how.settings.gravity
    name = None if calibration is None else SIMPLER.get(calibration.model)
    if name is None:
        return verdict
    try:
        holdout, fitted = _fitted(MODELS[name], sample, how, verdict)
    except DivergedError:
        return verdict
    sphere = None
    if truth is not None:
        (sphere,) = sphere_errors(
            points, sample.label, truth, (fitted.parameters,), verdict.coverage.saturated
        )
    simpler = WithoutMisalignment(calibration_of_fit(name, fitted, points, gravity), holdout, sphere)
    return replace(verdict, without_misalignment=simpler)


def _fitted(model: Model, sample: Sample, how: Fitting, verdict: Judgement) -> tuple[Holdout, Fit]:
    """Held-out error and fit of a model, with the prior where there is one; raises DivergedError."""
    folds, penalized = how.settings.folds, how.penalized
    if penalized is not None:
        number = verdict.coverage.distinct_orientations
        known = posterior(sample.points, number, model, how.prior, penalized)
        return blocked(sample, model, known.fitter(penalized), folds)[0], known.found.fit
    tried = next((trial for trial in verdict.trials if trial.model == model.name), None)
    if tried is not None and tried.holdout is not None and tried.fit is not None:
        return tried.holdout, tried.fit
    if model.name not in how.models:
        raise DivergedError(f"optimizer {how.settings.optimizer} does not fit model {model.name}")
    return blocked(sample, model, how.fit, folds)


def with_simpler_of_paper(
    verdict: Judgement, fit_points: PointSet, control_points: PointSet, how: Fitting
) -> Judgement:
    """A verdict of profile `paper` with what its first set gives without misalignment, on its second."""
    if verdict.trials[0].model != "9" or "6" not in how.models:
        return verdict
    try:
        (fitted,) = how.fit((fit_points,), MODELS["6"])
    except DivergedError:
        return verdict
    holdout = model_ladder.control(control_points, fitted.parameters)
    calibration = calibration_of_fit("6", fitted, fit_points, how.settings.gravity)
    return replace(verdict, without_misalignment=WithoutMisalignment(calibration, holdout))
