"""The verdict: outcome, reason, and the calibration where there is one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.judgement import Coverage, Holdout, Judgement, Outcome, Trial
from accelcal_cli.core.names import counted
from accelcal_cli.core.points import MODELS, PointSet
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge.complete import Fitted, complete
from accelcal_cli.judge.holdout import FitFunction, Sample, control
from accelcal_cli.judge.ladder import LADDER, Evidence, choose, one_sided_axes, try_models
from accelcal_cli.judge.postures import postures, temperature_blocks
from accelcal_cli.judge.uncertainty import coverage as coverage_of

FULL_MODELS = ("9", "9T")
DIVERGES = "the fit diverges: the points do not determine the parameters"
FEWEST_CONTROL_POINTS = 2
LONGER = "record longer, with more turns of the wrist"
NO_STILLNESS = f"no still window was found; {LONGER}"


def judge(
    points: PointSet,
    settings: Settings,
    fit: FitFunction,
    models: tuple[str, ...] = LADDER,
    why_none: str = NO_STILLNESS,
    label: NDArray[np.int64] | None = None,
) -> Judgement:
    """Choose a model by posture-blocked held-out error, fit it to all points, and say so.

    Args:
        points: calibration points of one recording.
        fit: (points, model) -> Fit, the optimizer.
        models: names of the models that it can fit.
        why_none: the reason, where there are no points.
        label: (n,) posture numbers, where they are known; else found by direction.
    """
    seen = coverage_of(points)
    if not len(points):
        return Judgement(Outcome.REFUSED, why_none, seen, ())
    label = postures(points, settings.posture_degrees) if label is None else label
    number = len(set(label.tolist()))
    if number < settings.min_postures:
        text = f"stillness in only {counted(number, 'posture')}, at least {settings.min_postures} are needed"
        return Judgement(Outcome.REFUSED, f"{text}; {LONGER}", seen, ())
    sample = Sample(points, label, temperature_blocks(points, label, settings.temperature_block_c))
    trials = try_models(Evidence(sample, seen, models), settings, fit)
    chosen = _chosen(trials, settings)
    outcome, message = _outcome(chosen, trials, seen, settings)
    if outcome is Outcome.REFUSED or chosen.holdout is None:
        return Judgement(outcome, message, seen, trials, holdout=chosen.holdout)
    try:
        found = fit(points, MODELS[chosen.model])
    except DivergedError:
        return Judgement(Outcome.REFUSED, f"{DIVERGES}; {LONGER}", seen, trials)
    verdict = Judgement(outcome, message, seen, trials, holdout=chosen.holdout)
    return complete(verdict, Fitted(chosen.model, points, label, found), settings.gravity)


def judge_paper(
    fit_points: PointSet,
    control_points: PointSet,
    missing: list[str],
    settings: Settings,
    fit: FitFunction,
    models: tuple[str, ...] = LADDER,
) -> Judgement:
    """F's procedure: nine parameters from the full first set, judged on the second (eq. 21).

    An optimizer that cannot fit nine fits six, as the non-iterative method of F's Table 3 does.
    """
    seen = coverage_of(fit_points)
    if missing:
        text = f"subsets without two points: {' '.join(missing)}; profile paper needs all nine"
        return Judgement(Outcome.REFUSED, f"{text}, profile default does not", seen, ())
    if len(control_points) < FEWEST_CONTROL_POINTS:
        left = counted(len(control_points), "control point")
        return Judgement(Outcome.REFUSED, f"only {left} to judge by; {LONGER}", seen, ())
    name = "9" if "9" in models else "6"
    try:
        found = fit(fit_points, MODELS[name])
    except DivergedError:
        return Judgement(Outcome.REFUSED, f"{DIVERGES}; {LONGER}", seen, ())
    trial = Trial(name, control(control_points, found.parameters), None)
    others = (
        () if name == "9" else (Trial("9", None, f"optimizer {settings.optimizer} fits no misalignment"),)
    )
    outcome, text = _outcome(trial, (trial, *others), seen, settings)
    verdict = Judgement(outcome, text, seen, (trial, *others), holdout=trial.holdout)
    if outcome is Outcome.REFUSED:
        return verdict
    label = np.arange(len(fit_points), dtype=np.int64)
    return complete(verdict, Fitted(name, fit_points, label, found), settings.gravity)


def _chosen(trials: tuple[Trial, ...], settings: Settings) -> Trial:
    """The ladder's choice; of the models the user insists on where there is one."""
    if settings.model == "auto":
        return choose(trials)
    named = tuple(trial for trial in trials if trial.model != "0")
    able = tuple(trial for trial in named if trial.holdout is not None)
    return choose(able) if able else named[0]


def _outcome(
    chosen: Trial, trials: tuple[Trial, ...], seen: Coverage, settings: Settings
) -> tuple[Outcome, str]:
    held = chosen.holdout
    if held is None:
        return Outcome.REFUSED, f"model {chosen.model} cannot be fitted: {chosen.reason}"
    if chosen.model == "0":
        return _no_model(held, trials, seen, settings)
    if held.after.mean >= settings.max_error_mg:
        text = f"the best model ({chosen.model}) leaves {held.after.mean:.1f} mg on {_unseen(held)}"
        return (
            Outcome.REFUSED,
            f"{text}, {settings.max_error_mg:g} mg is the limit; {_advice(seen, settings)}",
        )
    insisted = settings.model != "auto"
    if insisted and held.after.mean >= held.before.mean:
        return Outcome.REFUSED, f"model {chosen.model} as asked for does not improve: {_change(held)}"
    text = f"model {chosen.model}{' as asked for' if insisted else ''}: {_change(held)} on {_unseen(held)}"
    if chosen.model in FULL_MODELS:
        return Outcome.CALIBRATED, text
    return Outcome.REDUCED_MODEL, text if insisted else text + _why_reduced(chosen, trials)


def _no_model(
    held: Holdout, trials: tuple[Trial, ...], seen: Coverage, settings: Settings
) -> tuple[Outcome, str]:
    if all(trial.holdout is None for trial in trials if trial.model != "0"):
        why = trials[1].reason if len(trials) > 1 else None
        return Outcome.REFUSED, f"no model could be tried: {why}; {_advice(seen, settings)}"
    text = f"no model improves on the {held.before.mean:.1f} mg of the raw data on postures it did not see"
    if held.before.mean < settings.max_error_mg:
        return Outcome.ALREADY_GOOD, text
    return Outcome.REFUSED, f"{text}; {_advice(seen, settings)}"


def _why_reduced(chosen: Trial, trials: tuple[Trial, ...]) -> str:
    omitted = "scale and misalignment are" if chosen.model.startswith("3") else "misalignment is"
    reason = next((trial.reason for trial in trials if trial.model == "9" and trial.reason), None)
    return f"; {omitted} left out: {reason or 'the held-out error is no lower with it'}"


def _unseen(held: Holdout) -> str:
    return "control points" if held.method.startswith("control") else "postures it did not see"


def _advice(seen: Coverage, settings: Settings) -> str:
    missing = one_sided_axes(seen, settings.coverage_g)
    return f"there is no stillness with {', '.join(missing)}" if missing else LONGER


def _change(held: Holdout) -> str:
    return f"{held.before.mean:.1f} mg before, {held.after.mean:.2f} mg after"
