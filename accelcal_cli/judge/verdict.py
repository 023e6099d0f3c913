"""The verdict on a recording: outcome, reason, and the calibration where there is one.

`judge` is for the default profile, `judge_paper` for profile `paper`; `damage_verdict` refuses a recording
that has lost too much to damage. Coefficients that were not found from the points at hand are judged by
`held_out`, and compared by `better` and `worse`.
"""

from __future__ import annotations

from dataclasses import replace
from math import fsum

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.errors import DivergedError, counted
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import MODELS, Fit, PenalizedFitter, PointSet, Saturated
from accelcal_cli.core.prior import POPULATION, Prior
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Recording
from accelcal_cli.core.results import (
    Coverage,
    Facts,
    FitErrors,
    Holdout,
    Judgement,
    Outcome,
    Trial,
)
from accelcal_cli.core.settings import PAPER, Settings
from accelcal_cli.core.statistics import interval95, mean
from accelcal_cli.judge import model_ladder
from accelcal_cli.judge.errors import Uncertainty, deviations_mg, lengths_off_mg, per_posture, uncertainty
from accelcal_cli.judge.errors import coverage as coverage_of
from accelcal_cli.judge.misfit import MisfitSearch, told
from accelcal_cli.judge.model_ladder import Evidence, Fitting, Sample, blocked, postures
from accelcal_cli.judge.posterior import Posterior, posterior, speaks_against, sphere_errors
from accelcal_cli.judge.rest import ONE_G, picture, why_nothing_still
from accelcal_cli.judge.simpler import SIMPLER, calibration_of_fit, with_simpler, with_simpler_of_paper

FULL_MODELS = tuple(SIMPLER)
DIVERGES = "the fit diverges: the points do not determine the parameters"
FEWEST_CONTROL_POINTS = 2
"""Of profile `paper` where any distance will do; else all 18 are needed."""

LONGER = "record longer, with more turns of the wrist"
DISAGREE = "check that the device is sound, and that what is taken for rest is rest (--stillness)"
NOTHING_STILL = "no still window was found"
NO_STILLNESS = f"{NOTHING_STILL}; {LONGER}"
FAR_OFF = "still windows measure far from 1 g"
FAR_FROM_1_G = f"{FAR_OFF}; check the unit with --unit and --lsb-per-g"

CUT_SHORT = "truncated"
"""Code of the problem that all readers report for a file that breaks off."""

COPY_AGAIN = "the file is cut short: copy it again from the device"
FEWEST_POSTURES = 2

ODD_TIMES, ODD_MG = 3.0, 1.0
"""Errors on a recording's own windows that speak against it are larger than before, and larger than so many
times the pool's median and so many mg more."""

SEEN = "own points, which are among those that were fitted"


def judge(
    points: PointSet,
    how: Fitting,
    why_none: str = NO_STILLNESS,
    label: NDArray[np.int64] | None = None,
    saturated: Saturated = (),
) -> Judgement:
    """The most probable calibration, or the model that posture-blocked held-out error chooses.

    With a prior all parameters that the points speak of are fitted, and the ladder of models is tried for
    comparison; without one, or with a model that the user insists on, the ladder decides.

    Args:
        points: calibration points of one recording.
        why_none: the reason, where there are no points.
        label: (n,) posture numbers, where they are known; else found by direction.
        saturated: axes that measure nothing beyond a value; the verdict names them.
    """
    label = postures(points, how.settings.posture_degrees) if label is None else label
    verdict = _judged(points, how, why_none, label, replace(coverage_of(points, label), saturated=saturated))
    beyond = [f"{'xyz'[axis]} measures nothing beyond {at:.2f} g" for axis, at in saturated]
    found = [told(one) for one in verdict.misfits or () if one.found]
    return replace(verdict, message="; ".join([verdict.message, *beyond, *found]))


def _judged(
    points: PointSet, how: Fitting, why_none: str, label: NDArray[np.int64], coverage: Coverage
) -> Judgement:
    settings = how.settings
    if not len(points):
        return Judgement(Outcome.REFUSED, why_none, coverage, ())
    number = coverage.distinct_orientations
    needed = settings.min_postures if how.penalized is None else FEWEST_POSTURES
    if number < needed:
        text = f"stillness in only {counted(number, 'posture')}, at least {needed} are needed"
        return Judgement(Outcome.REFUSED, f"{text}; {LONGER}", coverage, ())
    blocks = model_ladder.temperature_blocks(points, label, settings.temperature_block_c)
    sample = Sample(points, label, blocks)
    trials = model_ladder.try_models(Evidence(sample, coverage, how.models), settings, how.fit)
    if how.penalized is not None:
        return _most_probable(sample, trials, coverage, how, how.penalized)
    chosen = _chosen(trials, settings)
    outcome, message = _outcome(chosen, trials, coverage, settings)
    verdict = Judgement(outcome, message, coverage, trials, holdout=chosen.holdout)
    if outcome is Outcome.REFUSED or chosen.fit is None:
        return verdict
    completed = _complete(verdict, chosen.model, chosen.fit, points, label, settings.gravity)
    return with_simpler(completed, sample, how)


def _most_probable(
    sample: Sample,
    trials: tuple[Trial, ...],
    coverage: Coverage,
    how: Fitting,
    penalized: PenalizedFitter,
) -> Judgement:
    """The verdict on the fit with a prior, by its error over the whole sphere."""
    points, label, settings = sample.points, sample.label, how.settings
    name = "9T" if _warm_and_cool(points, settings) else "9"
    try:
        known = posterior(points, coverage.distinct_orientations, MODELS[name], how.prior, penalized)
        unlike = how.prior is not POPULATION and _is_unlike(known, sample, coverage, how.prior, penalized)
        holdout, _ = blocked(sample, MODELS[name], known.fitter(penalized), settings.folds)
    except DivergedError:
        return Judgement(Outcome.REFUSED, f"{DIVERGES}; {LONGER}", coverage, trials)
    fitted = known.found.fit
    search = MisfitSearch(points, label, known, settings.folds)
    misfits = search.misfits()
    judged, truth = (fitted.parameters, IDENTITY), search.truth(misfits)
    sphere, before = sphere_errors(points, label, truth, judged, coverage.saturated)
    verdict = Judgement(
        Outcome.REFUSED,
        "",
        coverage,
        (*trials, Trial(name, holdout, None, fitted, settings.prior)),
        holdout=holdout,
        candidate=calibration_of_fit(name, fitted, points, settings.gravity),
        sphere=sphere,
        sphere_before=before,
        misfits=misfits,
        unlike=unlike,
    )
    outcome, text = _outcome_of_sphere(verdict, settings)
    verdict = replace(verdict, outcome=outcome, message=text)
    if outcome is Outcome.ALREADY_GOOD:
        raw = trials[0]
        assert raw.fit is not None
        kept = replace(verdict, holdout=raw.holdout, sphere=before)
        return _complete(kept, raw.model, raw.fit, points, label, settings.gravity)
    if outcome is Outcome.REFUSED:
        return verdict
    completed = _complete(verdict, name, fitted, points, label, settings.gravity)
    errors = _in_standard_g(known.standard_errors(), settings.gravity)
    worst = replace(completed.coverage, worst_direction_mg=known.worst_direction_mg())
    completed = replace(completed, standard_errors=errors, coverage=worst, penalty=known.penalty)
    return with_simpler(completed, sample, how, truth)


def as_it_is(points: PointSet, how: Fitting, told: str) -> Judgement:
    """The verdict on values that were calibrated before: nothing is fitted.

    Args:
        points: of the calibrated values; they tell how well these hold.
        told: where the values are from.
    """
    label = postures(points, how.settings.posture_degrees)
    coverage = coverage_of(points, label)
    if not len(points):
        return Judgement(Outcome.REFUSED, f"{told}; there is no stillness to check that", coverage, ())
    number = counted(coverage.distinct_orientations, "posture")
    sample = Sample(
        points, label, model_ladder.temperature_blocks(points, label, how.settings.temperature_block_c)
    )
    holdout, same = blocked(sample, MODELS["0"], how.fit, how.settings.folds)
    text = f"{told}; not fitted again: {holdout.before.mean:.1f} mg on {number} of its own stillness"
    verdict = Judgement(
        Outcome.ALREADY_GOOD, text, coverage, (Trial("0", holdout, None, same),), holdout=holdout
    )
    return _complete(verdict, "0", same, points, label, how.settings.gravity)


def _is_unlike(
    known: Posterior, sample: Sample, coverage: Coverage, prior: Prior, penalized: PenalizedFitter
) -> bool:
    """Whether the points speak against the prior with which they were fitted, and for that of all sensors."""
    points = sample.points
    usual = posterior(points, coverage.distinct_orientations, known.model, POPULATION, penalized)
    return speaks_against(known, usual, (prior, POPULATION), points)


def _outcome_of_sphere(verdict: Judgement, settings: Settings) -> tuple[Outcome, str]:
    """The outcome of the fit with a prior, and why."""
    sphere, holdout = verdict.sphere, verdict.holdout
    assert sphere is not None and holdout is not None and verdict.sphere_before is not None
    raw, *_, fitted = verdict.trials
    if model_ladder.choose((raw, fitted)) is raw:
        text = _no_better(holdout)
        if verdict.sphere_before.mean < settings.max_error_mg:
            return Outcome.ALREADY_GOOD, text
        return Outcome.REFUSED, f"{text}; {_missing(verdict, settings)}"
    low, high = sphere.ci95
    everywhere = f"{sphere.mean:.1f} mg over the whole sphere (95 %: {low:.1f} to {high:.1f})"
    if sphere.mean >= settings.max_error_mg:
        text = (
            f"what the points leave open is too much: {everywhere}, {settings.max_error_mg:g} mg is the limit"
        )
        return Outcome.REFUSED, f"{text}; {_missing(verdict, settings)}"
    return Outcome.CALIBRATED, f"model {fitted.model}: {_change(holdout)} on {_unseen(holdout)}; {everywhere}"


def _missing(verdict: Judgement, settings: Settings) -> str:
    """What a recording lacks whose points leave too much open."""
    coverage, holdout = verdict.coverage, verdict.holdout
    number = coverage.distinct_orientations
    if number < settings.min_postures:
        return f"there is stillness in only {counted(number, 'posture')}; {LONGER}"
    one_sided = model_ladder.one_sided_axes(coverage, settings.coverage_g)
    if one_sided or holdout is None or holdout.after.mean < settings.max_error_mg / 2:
        return _advice(coverage, settings)
    return f"{number} postures disagree by {holdout.after.mean:.1f} mg: {DISAGREE}"


def _warm_and_cool(points: PointSet, settings: Settings) -> bool:
    """Whether the points have temperatures from which slopes can be told."""
    return model_ladder.temperature_range_c(points) >= settings.min_temperature_range_c


def judge_paper(
    fit_points: PointSet,
    control_points: PointSet,
    missing: tuple[list[str], list[str]],
    how: Fitting,
) -> Judgement:
    """F's procedure: nine parameters from the full first set, judged on the second (eq. 21).

    An optimizer that cannot fit nine fits six, as the non-iterative method of F's Table 3 does. What
    the points leave uncertain somewhere on the sphere is refused, however small the error is on the
    second set, and so, with a least distance, is a second set that is not full (measured with 3 to 15
    control points: errors on the sphere of up to 5.7 times the reported one; with 18, 1.24 times).

    Args:
        missing: names of the subsets that are not full, of the first set and of the second.
    """
    settings = how.settings
    coverage = coverage_of(fit_points, postures(fit_points, settings.posture_degrees))
    first, second = missing
    if len(control_points) >= FEWEST_CONTROL_POINTS and not settings.min_distance_g:
        second = []
    if first or second:
        text = f"{_wanting(first, second, settings)}; profile paper needs all nine, profile default does not"
        return Judgement(Outcome.REFUSED, text, coverage, ())
    name = "9" if "9" in how.models else "6"
    try:
        (fitted,) = how.fit((fit_points,), MODELS[name])
    except DivergedError:
        return Judgement(Outcome.REFUSED, f"{DIVERGES}; {LONGER}", coverage, ())
    known = uncertainty(fit_points, fitted.parameters, MODELS[name])
    unsure = model_ladder.doubt(known, settings.max_error_mg)
    held = None if unsure else model_ladder.control(control_points, fitted.parameters)
    trial = Trial(name, held, unsure, fitted)
    verdict = _verdict_of_paper(trial, _with(coverage, known), settings)
    if verdict.outcome is Outcome.REFUSED:
        return verdict
    label = np.arange(len(fit_points), dtype=np.int64)
    completed = _complete(verdict, name, fitted, fit_points, label, settings.gravity)
    return with_simpler_of_paper(completed, fit_points, control_points, how)


def _verdict_of_paper(trial: Trial, coverage: Coverage, settings: Settings) -> Judgement:
    """The outcome of F's one fit, without a calibration."""
    if trial.holdout is None:
        text = f"model {trial.model} cannot be trusted: {trial.reason}; {_advice(coverage, settings)}"
        return Judgement(Outcome.REFUSED, text, coverage, (trial,))
    unfit = Trial("9", None, f"optimizer {settings.optimizer} fits no misalignment")
    trials = (trial,) if trial.model == "9" else (trial, unfit)
    outcome, text = _outcome(trial, trials, coverage, settings)
    return Judgement(outcome, text, coverage, trials, holdout=trial.holdout)


def _wanting(first: list[str], second: list[str], settings: Settings) -> str:
    """What is said of subsets that are not full: those of the first set, or else of the second."""
    least_g = settings.min_distance_g
    apart = f" that are at least {least_g:g} g from all others" if least_g else ""
    least = settings.min_subset_points
    few = {1: "a point", 2: "two points"}.get(least, f"{least} points")
    apart = apart.replace("are", "is") if least == 1 else apart
    return f"{'' if first else 'control '}subsets without {few}{apart}: {' '.join(first or second)}"


def _with(coverage: Coverage, known: Uncertainty | None) -> Coverage:
    """The coverage with what the fit says of it."""
    if known is None:
        return coverage
    worst_mg = known.worst_direction_mg
    return replace(coverage, condition_number=known.condition_number, worst_direction_mg=worst_mg)


def _complete(
    verdict: Judgement, model: str, fit: Fit, points: PointSet, label: NDArray[np.int64], gravity: Gravity
) -> Judgement:
    """A verdict with its calibration, in standard g, and what is known of it.

    Args:
        fit: of the model to the points, whose posture numbers are `label`.
    """
    before, after = (
        mean(list(per_posture(deviations_mg(points, p), points.weights, label).values()))
        for p in (IDENTITY, fit.parameters)
    )
    completed = replace(
        verdict,
        calibration=calibration_of_fit(model, fit, points, gravity),
        fit=fit,
        fit_errors=FitErrors(len(points), len(set(label.tolist())), before, after),
    )
    precision = uncertainty(points, fit.parameters, MODELS[model])
    if precision is None:
        return completed
    errors = _in_standard_g(precision.standard_errors, gravity)
    return replace(completed, coverage=_with(verdict.coverage, precision), standard_errors=errors)


def _in_standard_g(errors: tuple[float, ...], gravity: Gravity) -> tuple[float, ...]:
    """Standard errors of parameters whose offsets and slopes were in units of local gravity."""
    return (*errors[:6], *(value * float(gravity.local_g()) for value in errors[6:]))


def _chosen(trials: tuple[Trial, ...], settings: Settings) -> Trial:
    """The ladder's choice; of the models the user insists on where there is one."""
    if settings.model == "auto":
        return model_ladder.choose(trials)
    named = tuple(trial for trial in trials if trial.model != "0")
    able = tuple(trial for trial in named if trial.holdout is not None)
    return model_ladder.choose(able) if able else named[0]


def _outcome(
    chosen: Trial, trials: tuple[Trial, ...], coverage: Coverage, settings: Settings
) -> tuple[Outcome, str]:
    holdout = chosen.holdout
    if holdout is None:
        return Outcome.REFUSED, f"model {chosen.model} cannot be fitted: {chosen.reason}"
    if chosen.model == "0":
        return _no_model(holdout, trials, coverage, settings)
    if holdout.after.mean >= settings.max_error_mg:
        text = f"the best model ({chosen.model}) leaves {holdout.after.mean:.1f} mg on {_unseen(holdout)}"
        limit = f"{settings.max_error_mg:g} mg is the limit"
        return Outcome.REFUSED, f"{text}, {limit}; {_advice(coverage, settings)}"
    insisted = settings.model != "auto"
    model = f"model {chosen.model}{' as asked for' if insisted else ''}"
    if insisted and holdout.after.mean >= holdout.before.mean:
        return Outcome.REFUSED, f"{model} does not improve: {_change(holdout)}"
    text = f"{model}: {_change(holdout)} on {_unseen(holdout)}"
    if chosen.model in FULL_MODELS:
        return Outcome.CALIBRATED, text
    return Outcome.REDUCED_MODEL, text if insisted else text + _why_reduced(chosen, trials)


def _no_model(
    holdout: Holdout, trials: tuple[Trial, ...], coverage: Coverage, settings: Settings
) -> tuple[Outcome, str]:
    if all(trial.holdout is None for trial in trials if trial.model != "0"):
        why = trials[1].reason if len(trials) > 1 else None
        return Outcome.REFUSED, f"no model could be tried: {why}; {_advice(coverage, settings)}"
    text = _no_better(holdout)
    if holdout.before.mean < settings.max_error_mg:
        return Outcome.ALREADY_GOOD, text
    return Outcome.REFUSED, f"{text}; {_advice(coverage, settings)}"


def _no_better(holdout: Holdout) -> str:
    return f"no model improves on the {holdout.before.mean:.1f} mg of the raw data on postures it did not see"


def _why_reduced(chosen: Trial, trials: tuple[Trial, ...]) -> str:
    omitted = "scale and misalignment are" if chosen.model.startswith("3") else "misalignment is"
    reason = next((trial.reason for trial in trials if trial.model == "9" and trial.reason), None)
    return f"; {omitted} left out: {reason or 'the held-out error is no lower with it'}"


def _unseen(holdout: Holdout) -> str:
    return "control points" if holdout.method.startswith("control") else "postures it did not see"


def _advice(coverage: Coverage, settings: Settings) -> str:
    missing = model_ladder.one_sided_axes(coverage, settings.coverage_g)
    if missing:
        return f"there is no stillness with {', '.join(missing)}"
    if settings.profile != PAPER.profile:
        return LONGER
    other = ", use --stillness both" if settings.stillness == PAPER.stillness else ""
    return f"{LONGER}{other}, or use profile default"


def _change(holdout: Holdout) -> str:
    return f"{holdout.before.mean:.1f} mg before, {holdout.after.mean:.2f} mg after"


def damage_verdict(facts: Facts, max_percent: float, coverage: Coverage) -> Judgement | None:
    """The refusal of a recording of which damage has taken more than `max_percent`; None for any other."""
    share = facts.lost_percent()
    if share <= max_percent:
        return None
    text = (
        f"{share:.1f} % of the recording is lost to damage ({facts.lost_bytes} bytes), "
        f"{max_percent:g} % is the limit; copy it again from the device, or allow more with --max-damage"
    )
    return Judgement(Outcome.REFUSED, text, coverage, ())


def advised(verdict: Judgement, facts: Facts, recording: Recording, settings: Settings) -> Judgement:
    """A refusal with its numbers and advice that fits: rest that is none, or a file that was cut short."""
    if verdict.outcome is not Outcome.REFUSED:
        return verdict
    odd = picture(facts.rest, recording.lsb_per_g, decimal=recording.lsb_per_g >= FLOAT_LSB_PER_G)
    if odd is None or ONE_G not in odd:
        verdict = replace(verdict, message=_with_numbers(verdict.message, facts, recording, settings))
    if odd is not None:
        return replace(verdict, message=f"{verdict.message.split('; ')[0]}; {odd}")
    if all(problem.code != CUT_SHORT for problem in facts.problems):
        return verdict
    return replace(verdict, message=verdict.message.replace(LONGER, f"{COPY_AGAIN}, or {LONGER}"))


def _with_numbers(message: str, facts: Facts, recording: Recording, settings: Settings) -> str:
    """A refusal for want of stillness near 1 g with what was measured instead, and its limit."""
    if message == NO_STILLNESS:
        found, advice = why_nothing_still(facts, recording, settings)
        return f"{NOTHING_STILL}: {found}; {advice}{LONGER}"
    if message == FAR_FROM_1_G:
        return message.replace(FAR_OFF, f"{FAR_OFF} (typically {facts.rest.median_g:.3g} g)")
    return message


def with_errors_before(followed: Judgement, raw: Judgement) -> Judgement:
    """A verdict on points that were put right, with the errors before calibration of those that were not."""
    holdout, errors, message = followed.holdout, followed.fit_errors, followed.message
    if holdout is not None and raw.holdout is not None:
        message = message.replace(_change(holdout), _change(replace(holdout, before=raw.holdout.before)))
        holdout = replace(holdout, before=raw.holdout.before)
    if errors is not None and raw.fit_errors is not None:
        errors = replace(errors, before_mg=raw.fit_errors.before_mg)
    before, simpler = raw.sphere_before or followed.sphere_before, followed.without_misalignment
    if simpler is not None and simpler.holdout is not None and raw.holdout is not None:
        simpler = replace(simpler, holdout=replace(simpler.holdout, before=raw.holdout.before))
    return replace(
        followed,
        message=message,
        holdout=holdout,
        fit_errors=errors,
        sphere_before=before,
        without_misalignment=simpler,
    )


def held_out(
    points: PointSet, calibration: Calibration, rest: Gravity, degrees: float, method: str
) -> Holdout | None:
    """Errors before and after on all points, none of which was fitted; whole postures count alike.

    Args:
        points: in units of local gravity, with temperatures where the calibration has slopes.
        rest: what rest measures where the points were recorded.
        degrees: width of a posture.
        method: how it was held out, for the report.

    Returns:
        None for fewer than two postures.
    """
    label = postures(points, degrees)
    if not len(points) or label.max() + 1 < FEWEST_POSTURES:
        return None
    raw = [points.xyz[:, axis] / ONE for axis in range(3)]
    before = per_posture(lengths_off_mg(raw), points.weights, label)
    after = per_posture(lengths_off_mg(applied(points, calibration, rest)), points.weights, label)
    pairs = tuple((before[key], after[key]) for key in sorted(before))
    return model_ladder.of_postures(method, len(points), pairs)


def better(borrowed: Holdout, own: Holdout) -> bool:
    """Whether held-out errors are lower than others on the same postures, by more than the uncertainty.

    The 95 % confidence interval of the mean difference, posture by posture, lies above 0.
    """
    pairs = zip(borrowed.per_posture, own.per_posture, strict=True)
    return interval95([own_after - borrowed_after for (_, borrowed_after), (_, own_after) in pairs])[0] > 0


def applied(points: PointSet, calibration: Calibration, rest: Gravity) -> list[NDArray[np.float64]]:
    """Calibrated x, y, z of points, in and out in units of local gravity, each (n,).

    Elementwise, so that the figures are the same bits on every machine.
    """
    local_g = float(rest.local_g())
    raw = [points.xyz[:, axis] / ONE * local_g for axis in range(3)]
    celsius = None if calibration.temperature is None else temperatures_c(points)
    return [value / local_g for value in calibration.applied(raw, celsius)]


def temperatures_c(points: PointSet) -> NDArray[np.float64]:
    """Temperatures of points that have them [degrees C], (n,)."""
    assert points.tau is not None and points.temperature is not None
    scale = points.temperature
    return np.asarray(scale.reference_mc / 1000 + points.tau / ONE * scale.span_c, np.float64)


def difference_mg(one: Calibration, other: Calibration, raw_g: NDArray[np.float64]) -> tuple[float, float]:
    """Largest and mean length of the difference of two calibrations' results [mg].

    Args:
        raw_g: raw vectors, (n, 3), at the first one's reference temperature (the other's where it has none).
    """
    at_c = (one if one.temperature is not None else other).reference_c()
    difference = _at(one, raw_g, at_c) - _at(other, raw_g, at_c)
    lengths = (1000 * np.sqrt((difference * difference).sum(axis=1))).tolist()
    return max(lengths), fsum(lengths) / len(lengths)


def _at(calibration: Calibration, raw_g: NDArray[np.float64], at_c: float) -> NDArray[np.float64]:
    shift = calibration.offset_g()
    if calibration.temperature is not None:
        shift = shift + calibration.slope_g_per_c() * (at_c - calibration.reference_c())
    return np.asarray((raw_g + shift) @ calibration.gain().T)


def worse(holdout: Holdout, usual_mg: float, limit_mg: float) -> str | None:
    """Why a pool's coefficients are not for a recording, or None.

    Args:
        held: errors on the recording's own windows.
        usual_mg: median of the pool's held-out errors; some recordings' postures are worse than others,
            and where a raw error happens to be small none can be smaller.
    """
    before, after = holdout.before.mean, holdout.after.mean
    changed = f"{before:.1f} mg become {after:.2f} mg on {holdout.postures} postures of its own"
    if after > before and after > ODD_TIMES * usual_mg + ODD_MG:
        return f"{changed}, {usual_mg:.2f} mg are usual in the pool"
    return f"{changed}, {limit_mg:g} mg is the limit" if after >= limit_mg else None
