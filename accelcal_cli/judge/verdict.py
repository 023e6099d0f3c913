"""The verdict on a recording: outcome, reason, and the calibration if there is one.

`judge` is for the default profile, `judge_paper` for profile `paper`. Coefficients that were found elsewhere
are compared by `better` and `worse`.

A verdict also has what the same points give without misalignment, for tools whose formula has none. Such a
tool cannot be given a calibration whose K is cut down to its diagonal: scales and offsets have to make up for
what is left out. The simpler model is therefore fitted to the same points, with the same prior, and held out
on the same postures, so that its cost is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import interval95, mean
from accelcal_cli.core.calibration import IDENTITY, NO_BEND
from accelcal_cli.core.errors import DivergedError, FixedPointOverflowError, Reason
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import MODELS, Fit, Model, PenalizedFitter, PointSet, Saturated, TimedMeans
from accelcal_cli.core.prior import POPULATION
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Recording
from accelcal_cli.core.results import (
    NEAR_ONE_G,
    Coverage,
    Facts,
    FitErrors,
    Holdout,
    Judgement,
    Outcome,
    Rest,
    SphereError,
    Trial,
    WithoutMisalignment,
    sides_not_up,
    whole_percent,
)
from accelcal_cli.core.settings import DEFAULT, PAPER, Settings
from accelcal_cli.core.vocabulary import PER_G, USUAL_UNITS
from accelcal_cli.judge import model_ladder
from accelcal_cli.judge.change import possible_changes, probable_change
from accelcal_cli.judge.errors import Uncertainty, deviations_mg, per_posture, uncertainty
from accelcal_cli.judge.errors import coverage as coverage_of
from accelcal_cli.judge.misfit import MisfitSearch
from accelcal_cli.judge.model_ladder import FEWEST_POSTURES, Fitting, Sample, blocked, postures
from accelcal_cli.judge.posterior import (
    IDEAL,
    SURE,
    Circumstances,
    DrawnSensors,
    PossibleChange,
    Posterior,
    calibration_of_fit,
    outcome_by_probability,
    posterior,
    speaks_against,
    sphere_errors,
    uncertainty_budget,
)

# Reasons of refusals: damage, no stillness, or rest that a wrong unit, scale, type or column
# explains.
#
# A sensor's own errors leave rest within a few tenths of 1 g, and a wrist turns all three axes.
# `odd_rest` says how a recording differs from that and what would explain it; the advice to record
# longer is left out then.

LONGER = Reason("record_longer")
NOTHING_STILL = Reason("nothing_still")
FAR_FROM_1_G = Reason("still_far_from_1_g")

WIDEST_G = 0.5
"""Range of |a| at rest [g], 5th to 95th percentile, that no sensor's offsets reach."""

STUCK_G, TURNED_G = 0.02, 0.5
"""Range [g] within which an axis is stuck, if another axis turns at rest by more than the second [g]."""

UNITS = {PER_G[unit]: (unit, "g") for unit in USUAL_UNITS if unit != "g"} | {
    1 / PER_G[unit]: ("g", unit) for unit in USUAL_UNITS if unit != "g"
}
"""Unit of the values and the unit that they were read as, by what rest then measures [g]."""

UNIT_TOLERANCE = 0.15
"""Relative distance from an entry of UNITS within which it explains what rest measures."""

NOISE_TIMES = 4
"""Times the limit up to which the quietest window may be rest that a noisy sensor measured."""


def nothing_still(facts: Facts, recording: Recording, settings: Settings) -> tuple[Reason, Reason]:
    """Return the refusal that says what the quietest window measures, and advice."""
    quietest, length_s = facts.quietest, settings.segment_seconds
    if quietest is None and facts.counts.filled_samples > facts.samples / 2:
        share = 100 * facts.counts.filled_samples / facts.samples
        return Reason.of("nothing_but_filled", filled_percent=share), Reason("check_sensor")
    if quietest is None:
        return Reason.of("nothing_measured", seconds=length_s), Reason("shorter_windows_or_longer_gaps")
    spread_g = quietest.spread / recording.lsb_per_g
    deviation_g = quietest.deviation / recording.lsb_per_g
    range_g, limit_g = settings.stillness_threshold_g, settings.stillness_deviation_g
    values: dict[str, Any] = {"windows": facts.windows, "seconds": length_s}
    if range_g is not None and spread_g >= range_g:
        values |= {"quietest": "range", "measured_g": spread_g, "limit_g": range_g}
    else:
        values |= {"quietest": "deviation", "measured_g": deviation_g, "limit_g": limit_g}
    noisy = limit_g is not None and deviation_g < NOISE_TIMES * limit_g
    return Reason.of("nothing_still", **values), Reason("adaptive_rule" if noisy else "shorter_windows")


def refuse_provisional_if_rest_is_odd(settings: Settings, facts: Facts, recording: Recording) -> Settings:
    """Return the settings to judge by: nothing is provisional if rest is odd, whose cause can be removed."""
    return settings if _odd_rest_of(facts, recording) is None else replace(settings, strict=True)


def _odd_rest_of(facts: Facts, recording: Recording) -> Reason | None:
    return odd_rest(facts.rest, recording.lsb_per_g, decimal=recording.lsb_per_g >= FLOAT_LSB_PER_G)


def odd_rest(rest: Rest, lsb_per_g: float, *, decimal: bool) -> Reason | None:
    """Return what is odd about rest and what would explain it, or None.

    Args:
        lsb_per_g: counts per g that were assumed.
        decimal: True if the file has decimal numbers in a unit, not counts.
    """
    if not rest.windows:
        return _wrong_size(rest.samples_median_g, "samples", lsb_per_g, decimal)
    if rest.alike:
        return Reason.of("axes_alike", axes=rest.alike)
    odd = _stuck_axis(rest) or _wrong_size(rest.median_g, "rest", lsb_per_g, decimal)
    if odd is None and rest.p95_g - rest.p5_g >= WIDEST_G:
        return Reason.of("rest_scatters", low_g=rest.p5_g, high_g=rest.p95_g)
    return odd


def _stuck_axis(rest: Rest) -> Reason | None:
    spans = {
        axis: high - low for axis, low, high in zip("xyz", rest.axis_min_g, rest.axis_max_g, strict=True)
    }
    stuck = [axis for axis, span in spans.items() if span < STUCK_G]
    turned = {axis: span for axis, span in spans.items() if span > TURNED_G}
    if not stuck or not turned:
        return None
    at_g = round(rest.axis_min_g["xyz".index(stuck[0])], 2) + 0.0
    return Reason.of("axis_stuck", axis=stuck[0], at_g=at_g, others=list(turned), by_g=list(turned.values()))


def _wrong_size(median_g: float | None, of: str, lsb_per_g: float, decimal: bool) -> Reason | None:
    low, high = NEAR_ONE_G
    if median_g is None or low < median_g < high:
        return None
    if not median_g:
        return Reason.of("gravity_is_zero", of=of)
    unit = next((pair for g, pair in UNITS.items() if abs(median_g / g - 1) < UNIT_TOLERANCE), None)
    if unit is not None:
        return Reason.of("wrong_unit", of=of, median_g=median_g, unit=unit[0], read_as=unit[1])
    if decimal:
        return Reason.of("not_1_g", of=of, median_g=median_g)
    values = {"median_g": median_g, "lsb_per_g": lsb_per_g, "fits": lsb_per_g * median_g}
    return Reason.of("wrong_counts_per_g", of=of, **values)


WRONG_SIZE = ("gravity_is_zero", "wrong_unit", "not_1_g", "wrong_counts_per_g")
"""Codes of rest that is far from 1 g."""


def with_advice(verdict: Judgement, facts: Facts, recording: Recording, settings: Settings) -> Judgement:
    """Return a refusal with numbers, and advice that fits odd rest or a file that was cut short."""
    if verdict.outcome is not Outcome.REFUSED:
        return verdict
    odd = _odd_rest_of(facts, recording)
    if odd is not None and verdict.reason.code == "provisional":
        values = {name: verdict.reason.values[name] for name in ("error_mg", "low_mg", "high_mg", "limit_mg")}
        reason = Reason.of("calibration_error_over_limit", **values)
        if odd.code in WRONG_SIZE:
            reason = Reason.of(FAR_FROM_1_G.code, median_g=facts.rest.median_g)
        verdict = replace(verdict, reason=reason)
    if odd is not None and odd.code in WRONG_SIZE:
        return replace(verdict, notes=(*verdict.notes, odd), advice=())
    if verdict.reason == NOTHING_STILL:
        reason, advice = nothing_still(facts, recording, settings)
        verdict = replace(verdict, reason=reason, advice=(advice, LONGER))
    elif verdict.reason == FAR_FROM_1_G:
        reason = Reason.of(FAR_FROM_1_G.code, median_g=facts.rest.median_g)
        verdict = replace(verdict, reason=reason, advice=(Reason("check_unit"),))
    if odd is not None:
        return replace(verdict, notes=(*verdict.notes, odd), advice=())
    if facts.cut_short:
        return replace(verdict, advice=(Reason("copy_again"), *verdict.advice))
    return verdict


def damage_verdict(facts: Facts, max_percent: float, coverage: Coverage) -> Judgement | None:
    """Return the refusal of a recording that lost more than `max_percent` to damage, or None.

    What is missing does not count: it says nothing against what is there.
    """
    share = facts.damaged_percent()
    if share <= max_percent:
        return None
    why = Reason.of("damaged", lost_percent=share, lost_bytes=facts.damaged_bytes, limit_percent=max_percent)
    advice = (Reason("copy_again"), Reason("allow_damage"))
    return Judgement(Outcome.REFUSED, why, coverage, (), advice=advice)


# The verdict on a recording.

SIMPLER = {"9": "6", "9T": "6T"}
"""Models with misalignment, and what is left of each without it."""

FULL_MODELS = tuple(SIMPLER)
DIVERGES, BEYOND_RANGE = Reason("fit_diverges"), Reason("beyond_range")

ANOTHER_PROFILE = (Reason("use_default_profile"),)
"""Advice where F's procedure does not serve."""

FEWEST_CONTROL_POINTS = 2
"""Points that F's second set needs for an error with an interval."""

ODD_TIMES, ODD_MG = 3.0, 1.0
"""Factor of the pool's median error, and what is added to it [mg], above which an error is unusual."""

SEEN = "own points, which are among those that were fitted"
"""How the points of a recording of a pool were held out, for the report."""


def judge(
    points: PointSet,
    how: Fitting,
    why_none: Reason = NOTHING_STILL,
    label: NDArray[np.int64] | None = None,
    saturated: Saturated = (),
    means: TimedMeans | None = None,
) -> Judgement:
    """Judge a recording by its most probable calibration, or by the model with the best held-out error.

    With a prior, all parameters that the points determine are fitted, and the ladder of models is tried for
    comparison. Without one, or with a model that the user insists on, the ladder decides.

    Args:
        points: calibration points of one recording.
        why_none: the reason if there are no points.
        label: (n,) posture numbers; None: found by direction.
        saturated: axes that measure nothing beyond a value; the verdict cautions of them.
        means: the same rests along time, in standard g; None where time is not known.
    """
    label = postures(points, how.settings.posture_degrees) if label is None else label
    coverage = replace(coverage_of(points, label), saturated=saturated)
    verdict = _too_few(points, how, why_none, coverage)
    if verdict is None:
        blocks = model_ladder.temperature_blocks(points, label, how.settings.temperature_block_c)
        sample, errors_of = Sample(points, label, blocks), None
        trials = model_ladder.try_models(sample, coverage, how)
        if how.penalized is None:
            chosen = _chosen(trials, how.settings)
            verdict = _outcome(chosen, trials, coverage, how.settings).judgement(
                coverage, trials, chosen.holdout
            )
            if verdict.outcome is not Outcome.REFUSED and chosen.fit is not None:
                gravity = how.settings.gravity
                verdict = _complete(verdict, chosen.model, chosen.fit, points, label, gravity)
        else:
            verdict, errors_of = _most_probable(sample, trials, coverage, how, means)
        verdict = add_fit_without_misalignment(verdict, sample, how, errors_of)
    return replace(verdict, cautions=(*verdict.cautions, *_doubts(verdict, how.settings)))


def _doubts(verdict: Judgement, settings: Settings) -> Iterator[Reason]:
    """Yield what the points say against trusting a verdict without a look."""
    scatter_mg = verdict.rest_scatter_mg
    over = scatter_mg is not None and scatter_mg >= settings.max_error_mg and not verdict.probably_changed()
    if over and verdict.calibration is not None:
        yield Reason.of("scatter_over_limit", scatter_mg=scatter_mg)
    for axis, at in verdict.coverage.saturated:
        yield Reason.of("axis_saturates", axis="xyz"[axis], at_g=at)
    for one in verdict.misfits or ():
        if one.found:
            yield Reason.of("misfit", kind=one.kind, size=one.size, unit=one.unit, largest_mg=one.largest_mg)


def _too_few(points: PointSet, how: Fitting, why_none: Reason, coverage: Coverage) -> Judgement | None:
    """Refuse points in too few postures; None if there are enough."""
    if not len(points):
        advice = {NOTHING_STILL.code: (LONGER,), "nothing_near_quietest": (Reason("other_rule"),)}
        return Judgement(Outcome.REFUSED, why_none, coverage, (), advice=advice.get(why_none.code, ()))
    number = coverage.distinct_orientations
    needed = how.settings.min_postures if how.penalized is None else FEWEST_POSTURES
    if number >= needed:
        return None
    few = Reason.of("too_few_orientations", orientations=number, needed=needed)
    return Judgement(Outcome.REFUSED, few, coverage, (), advice=(LONGER,))


ErrorsOf = Callable[[Sequence[Fit]], list[SphereError]]
"""Returns the errors of fits over all directions, given the posterior of a sensor."""


def _most_probable(
    sample: Sample, trials: tuple[Trial, ...], coverage: Coverage, how: Fitting, means: TimedMeans | None
) -> tuple[Judgement, ErrorsOf | None]:
    """Judge the fit with a prior by its error over the whole sphere.

    Returns:
        the verdict, and what gives the errors of other fits; None where the fit diverged.
    """
    points, label, settings, penalized = sample.points, sample.label, how.settings, how.penalized
    assert penalized is not None
    slopes = model_ladder.temperature_range_c(points) >= settings.min_temperature_range_c
    name = "9T" if slopes else "9"
    try:
        known = posterior(points, coverage.distinct_orientations, MODELS[name], how.prior, penalized)
        unlike = how.prior is not POPULATION and _contradicts_prior(known, sample, coverage, how, penalized)
        holdout, _ = blocked(sample, MODELS[name], known.fitter(penalized), settings.folds)
    except FixedPointOverflowError:
        return Judgement(
            Outcome.REFUSED, BEYOND_RANGE, coverage, trials, advice=(Reason("check_unit"),)
        ), None
    except DivergedError:
        return Judgement(Outcome.REFUSED, DIVERGES, coverage, trials, advice=(LONGER,)), None
    fitted = known.found.fit
    misfits = MisfitSearch(points, label, known, settings.folds).misfits()
    gravity, changes = settings.gravity, list[PossibleChange]()
    if means is not None:
        local_g = float(gravity.local_g())
        changes = possible_changes(means, known, points.temperature, local_g, settings.posture_degrees)
    around = Circumstances(settings.max_error_mg, gravity.uncertainty_g(), changes)

    def errors_of(fits: Sequence[Fit]) -> list[SphereError]:
        return sphere_errors(points, label, known, fits, around, coverage.saturated)

    sphere, before = errors_of((fitted, IDEAL))
    far = known.parameters_outside_prior()
    verdict = Judgement(
        Outcome.REFUSED,
        DIVERGES,
        coverage,
        (*trials, Trial(name, holdout, None, fitted, settings.prior)),
        holdout=holdout,
        candidate=calibration_of_fit(name, fitted, points, settings.gravity),
        sphere=sphere,
        sphere_before=before,
        rest_scatter_mg=known.rest_scatter_mg(),
        misfits=misfits,
        changed=None if means is None else probable_change(changes),
        uncertainty=uncertainty_budget(known, around),
        unlike=unlike,
        plausible=DrawnSensors(known, points, settings.gravity, fitted.bend),
        notes=(Reason.of("unlike_most_sensors", parameters=far),) if far else (),
    )
    decided = _outcome_of_sphere(verdict, settings)
    verdict, outcome = decided.applied_to(verdict), decided.outcome
    if outcome is Outcome.ALREADY_GOOD:
        raw = trials[0]
        assert raw.fit is not None
        both = {name: getattr(sphere, name) for name in ("better_everywhere", "better_where_worn")}
        sensors = DrawnSensors(known, points, settings.gravity, NO_BEND)
        kept = replace(verdict, holdout=raw.holdout, sphere=replace(before, **both), plausible=sensors)
        return _complete(kept, raw.model, raw.fit, points, label, settings.gravity), errors_of
    if outcome is Outcome.REFUSED:
        return verdict, errors_of
    completed = _complete(verdict, name, fitted, points, label, settings.gravity)
    return _with_posterior(completed, known, settings.gravity), errors_of


def _contradicts_prior(
    known: Posterior, sample: Sample, coverage: Coverage, how: Fitting, penalized: PenalizedFitter
) -> bool:
    """Return True if the points speak against the prior that was used, and for the one of all sensors."""
    points = sample.points
    usual = posterior(points, coverage.distinct_orientations, known.model, POPULATION, penalized)
    return speaks_against(known, usual, (how.prior, POPULATION), points)


def _with_posterior(verdict: Judgement, known: Posterior, gravity: Gravity) -> Judgement:
    """Replace the errors of least squares by those of the posterior, and add its penalty."""
    assert verdict.calibration is not None
    errors = _in_standard_g(known.standard_errors(), gravity)
    covariance = known.covariance_of(verdict.calibration)
    coverage = replace(verdict.coverage, worst_direction_mg=known.worst_direction_mg())
    return replace(
        verdict, standard_errors=errors, covariance=covariance, coverage=coverage, penalty=known.penalty
    )


def judge_calibrated(points: PointSet, how: Fitting, origin: str) -> Judgement:
    """Judge values that were calibrated before, without fitting anything.

    Args:
        points: of the calibrated values.
        origin: where the values are from, in words.
    """
    label = postures(points, how.settings.posture_degrees)
    coverage = coverage_of(points, label)
    if not len(points):
        why = Reason.of("calibrated_before_unchecked", origin=origin)
        return Judgement(Outcome.REFUSED, why, coverage, ())
    blocks = model_ladder.temperature_blocks(points, label, how.settings.temperature_block_c)
    sample = Sample(points, label, blocks)
    holdout, same = blocked(sample, MODELS["0"], how.fit, how.settings.folds)
    values = {"before_mg": holdout.before.mean, "orientations": coverage.distinct_orientations}
    why = Reason.of("calibrated_before", origin=origin, **values)
    trials = (Trial("0", holdout, None, same),)
    verdict = Judgement(Outcome.ALREADY_GOOD, why, coverage, trials, holdout=holdout)
    return _complete(verdict, "0", same, points, label, how.settings.gravity)


@dataclass(frozen=True, slots=True)
class Decision:
    """An outcome with its reason, and what to do about it."""

    outcome: Outcome
    reason: Reason
    advice: tuple[Reason, ...] = ()

    def judgement(self, coverage: Coverage, trials: tuple[Trial, ...], holdout: Holdout | None) -> Judgement:
        """Return the judgement without its calibration."""
        return Judgement(self.outcome, self.reason, coverage, trials, holdout=holdout, advice=self.advice)

    def applied_to(self, verdict: Judgement) -> Judgement:
        """Return a judgement with this outcome."""
        return replace(verdict, outcome=self.outcome, reason=self.reason, advice=self.advice)


def _outcome_of_sphere(verdict: Judgement, settings: Settings) -> Decision:
    sphere, holdout, before = verdict.sphere, verdict.holdout, verdict.sphere_before
    assert sphere is not None and holdout is not None and before is not None
    fitted, (low, high) = verdict.trials[-1], sphere.ci95
    values: dict[str, Any] = {
        "error_mg": sphere.mean,
        "low_mg": low,
        "high_mg": high,
        "limit_mg": settings.max_error_mg,
        "raw_mg": before.mean,
        **_percents(sphere),
    } | _held_out_values(holdout)
    outcome = outcome_by_probability(sphere, before)
    cut = (Reason("cut_recording"),) if verdict.probably_changed() else ()
    if outcome is Outcome.CALIBRATED:
        return Decision(outcome, Reason.of("calibrated", model=fitted.model, **values), cut)
    missing = cut or _missing(verdict, settings)
    if outcome is Outcome.PROVISIONAL:
        why = Reason.of("provisional", model=fitted.model, **values)
        if settings.strict:
            return Decision(Outcome.REFUSED, why, (Reason("omit_strict"), *missing))
        return Decision(outcome, why, missing)
    why = Reason.of("not_clearly_better", **values)
    return Decision(outcome, why, () if outcome is Outcome.ALREADY_GOOD else missing)


def _percents(sphere: SphereError) -> dict[str, float]:
    return {
        "percent": whole_percent(sphere.probably_better()),
        "percent_below": whole_percent(sphere.below_limit),
    }


def _held_out_values(holdout: Holdout) -> dict[str, Any]:
    """Return the errors on held-out orientations, or control points, for a reason."""
    return {
        "before_mg": holdout.before.mean,
        "after_mg": holdout.after.mean,
        "factor": holdout.improvement_factor(),
        "factor_ci95": holdout.improvement_ci95(),
        "orientations": holdout.postures,
        "held_out": "control points" if holdout.method.startswith("control") else "orientations",
    }


def _missing(verdict: Judgement, settings: Settings) -> tuple[Reason, ...]:
    """Return what a recording lacks whose points leave too much uncertain."""
    # rests disagree about the fit itself: held-out errors of few postures are extrapolated
    coverage, scatter_mg = verdict.coverage, verdict.rest_scatter_mg
    number, sphere = coverage.distinct_orientations, verdict.sphere
    if number < settings.min_postures:
        return (Reason.of("more_orientations", orientations=number),)
    if sphere is not None and sphere.below_limit >= SURE and settings.gravity.uncertainty_g():
        return (Reason("give_latitude"),)
    one_sided = sides_not_up(coverage.axis_min_g, coverage.axis_max_g, settings.coverage_g)
    few = one_sided or number < 2 * settings.min_postures
    if few or scatter_mg is None or scatter_mg < settings.max_error_mg / 2:
        return _advice(coverage, settings)
    return (Reason.of("orientations_disagree", orientations=number, by_mg=scatter_mg),)


def judge_paper(
    fit_points: PointSet, control_points: PointSet, missing: tuple[list[str], list[str]], how: Fitting
) -> Judgement:
    """Judge by F's procedure: nine parameters from the full first set, held out on the second (eq. 21).

    An optimizer that cannot fit nine fits six, as the non-iterative method of F's Table 3 does. A fit that is
    uncertain somewhere on the sphere is refused, however small the error on the second set. A second set that
    is not full says little of orientations that neither set has (measured with 3 to 15 control points: errors
    on the sphere up to 5.7 times that on the set), so the coefficients are also held against the posterior of
    the sensor, given the points of both sets and what sensors are like. The fit itself knows nothing of that.

    Args:
        missing: names of the subsets that are not full, of the first set and of the second.
    """
    settings = how.settings
    coverage = coverage_of(fit_points, postures(fit_points, settings.posture_degrees))
    first, second = missing
    if len(control_points) >= FEWEST_CONTROL_POINTS:
        second = []
    if first or second:
        why = Reason.of(
            "subsets_not_full",
            of="fit" if first else "control",
            subsets=first or second,
            points=settings.min_subset_points,
            apart_g=settings.min_distance_g,
        )
        return Judgement(Outcome.REFUSED, why, coverage, (), advice=(*ANOTHER_PROFILE, LONGER))
    name = "9" if "9" in how.models else "6"
    try:
        (fitted,) = how.fit((fit_points,), MODELS[name])
    except DivergedError:
        return Judgement(Outcome.REFUSED, DIVERGES, coverage, (), advice=ANOTHER_PROFILE)
    known = uncertainty(fit_points, fitted.parameters, MODELS[name])
    unsure = model_ladder.doubt(known, settings.max_error_mg)
    holdout = None if unsure else model_ladder.control(control_points, fitted.parameters)
    trial = Trial(name, holdout, unsure, fitted)
    verdict = _verdict_of_paper(trial, _with_precision(coverage, known), settings)
    verdict = _refuse_if_uncertain_on_sphere(verdict, fit_points.joined(control_points), how)
    if verdict.outcome is Outcome.REFUSED:
        return verdict
    label = np.arange(len(fit_points), dtype=np.int64)
    completed = _complete(verdict, name, fitted, fit_points, label, settings.gravity)
    return with_simpler_of_paper(completed, fit_points, control_points, how)


def _refuse_if_uncertain_on_sphere(verdict: Judgement, points: PointSet, how: Fitting) -> Judgement:
    """Add the error of F's fit over all orientations, and refuse a fit for which it is too large.

    Args:
        points: of both sets.
    """
    assert how.judging is not None
    settings, trial = how.settings, verdict.trials[0]
    assert trial.fit is not None
    label = postures(points, settings.posture_degrees)
    try:
        known = posterior(points, len(set(label.tolist())), MODELS["9"], POPULATION, how.judging)
    except DivergedError:
        return replace(verdict, outcome=Outcome.REFUSED, reason=DIVERGES, advice=ANOTHER_PROFILE)
    around = Circumstances(settings.max_error_mg, settings.gravity.uncertainty_g())
    judged = (trial.fit, known.found.fit, IDEAL)
    sphere, of_best, before = sphere_errors(points, label, known, judged, around)
    sensors = DrawnSensors(known, points, settings.gravity, NO_BEND)
    verdict = replace(verdict, sphere=sphere, sphere_before=before, plausible=sensors)
    values: dict[str, Any] = {"error_mg": sphere.mean, "low_mg": sphere.ci95[0], "high_mg": sphere.ci95[1]}
    values["limit_mg"] = settings.max_error_mg
    sure = outcome_by_probability(sphere, before) is Outcome.CALIBRATED
    if verdict.outcome is not Outcome.REFUSED and not sure:
        over = Reason.of("calibration_error_over_limit", **values)
        verdict = Decision(Outcome.REFUSED, over, ANOTHER_PROFILE).applied_to(verdict)
    if verdict.outcome is Outcome.REFUSED:
        suffice = of_best.below_limit >= SURE and settings.optimizer != DEFAULT.optimizer
        another = (Reason.of("use_optimizer", optimizer=DEFAULT.optimizer),) if suffice else ()
        return replace(verdict, advice=(*another, *verdict.advice))
    if verdict.outcome is Outcome.CALIBRATED and trial.holdout is not None:
        values |= {"model": trial.model, "raw_mg": before.mean, **_percents(sphere)}
        values |= _held_out_values(trial.holdout)
        verdict = replace(verdict, reason=Reason.of("calibrated", **values))
    return verdict


def _verdict_of_paper(trial: Trial, coverage: Coverage, settings: Settings) -> Judgement:
    """Return the verdict on F's single fit, without its calibration."""
    if trial.holdout is None:
        why = Reason.of("model_uncertain", model=trial.model, why=trial.reason)
        advice = _advice(coverage, settings)
        return Judgement(Outcome.REFUSED, why, coverage, (trial,), advice=advice)
    unfit = Trial("9", None, model_ladder.never_fits(settings.optimizer, "misalignment"))
    trials = (trial,) if trial.model == "9" else (trial, unfit)
    return _outcome(trial, trials, coverage, settings).judgement(coverage, trials, trial.holdout)


def _with_precision(coverage: Coverage, known: Uncertainty | None) -> Coverage:
    """Add the fit's conditioning to the coverage."""
    if known is None:
        return coverage
    worst_mg = known.worst_direction_mg
    return replace(coverage, condition_number=known.condition_number, worst_direction_mg=worst_mg)


def _complete(
    verdict: Judgement, model: str, fit: Fit, points: PointSet, label: NDArray[np.int64], gravity: Gravity
) -> Judgement:
    """Add the calibration, in standard g, and its errors to a verdict.

    Args:
        fit: that of the model to the points, whose posture numbers are `label`.
    """
    before, after = (
        mean(list(per_posture(deviations_mg(held, p), points.weights, label).values()))
        for held, p in ((points, IDENTITY), (points.straightened(fit.bend), fit.parameters))
    )
    completed = replace(
        verdict,
        calibration=calibration_of_fit(model, fit, points, gravity),
        fit=fit,
        fit_errors=FitErrors(len(points), len(set(label.tolist())), before, after),
    )
    precision = uncertainty(points.straightened(fit.bend), fit.parameters, MODELS[model])
    if precision is None:
        return completed
    errors = _in_standard_g(precision.standard_errors, gravity)
    return replace(completed, coverage=_with_precision(verdict.coverage, precision), standard_errors=errors)


def _in_standard_g(errors: tuple[float, ...], gravity: Gravity) -> tuple[float, ...]:
    """Convert standard errors of parameters from units of local gravity to standard g."""
    return (*errors[:6], *(value * float(gravity.local_g()) for value in errors[6:]))


def _chosen(trials: tuple[Trial, ...], settings: Settings) -> Trial:
    """Return the ladder's choice, among the models that the user insists on if there are any."""
    if settings.model == "auto":
        return model_ladder.choose(trials)
    named = tuple(trial for trial in trials if trial.model != "0")
    able = tuple(trial for trial in named if trial.holdout is not None)
    return model_ladder.choose(able) if able else named[0]


def _outcome(chosen: Trial, trials: tuple[Trial, ...], coverage: Coverage, settings: Settings) -> Decision:
    holdout, model = chosen.holdout, chosen.model
    if holdout is None:
        return Decision(Outcome.REFUSED, Reason.of("model_not_fitted", model=model, why=chosen.reason))
    if model == "0":
        return _no_model(holdout, trials, coverage, settings)
    insisted = settings.model != "auto"
    values = _held_out_values(holdout) | {"model": model, "asked_for": insisted}
    if holdout.after.mean >= settings.max_error_mg:
        over = Reason.of("held_out_error_over_limit", **values, limit_mg=settings.max_error_mg)
        return Decision(Outcome.REFUSED, over, _advice(coverage, settings))
    if insisted and holdout.after.mean >= holdout.before.mean:
        return Decision(Outcome.REFUSED, Reason.of("not_better", **values))
    if model in FULL_MODELS:
        return Decision(Outcome.CALIBRATED, Reason.of("calibrated_held_out", **values))
    why = next((trial.reason for trial in trials if trial.model == "9" and trial.reason), None)
    if insisted:
        why = None
    else:
        values["left_out"] = "scale and misalignment" if model.startswith("3") else "misalignment"
    return Decision(Outcome.REDUCED_MODEL, Reason.of("calibrated_in_part", **values, why=why))


def _no_model(
    holdout: Holdout, trials: tuple[Trial, ...], coverage: Coverage, settings: Settings
) -> Decision:
    reason = Reason.of("raw_no_worse", **_held_out_values(holdout))
    if all(trial.holdout is None for trial in trials if trial.model != "0"):
        reason = Reason.of("no_model_tried", why=trials[1].reason if len(trials) > 1 else None)
    elif holdout.before.mean < settings.max_error_mg:
        return Decision(Outcome.ALREADY_GOOD, reason)
    return Decision(Outcome.REFUSED, reason, _advice(coverage, settings))


def _advice(coverage: Coverage, settings: Settings) -> tuple[Reason, ...]:
    if settings.profile == PAPER.profile:  # its sets are full: a longer recording has the same points
        return ANOTHER_PROFILE
    missing = sides_not_up(coverage.axis_min_g, coverage.axis_max_g, settings.coverage_g)
    return (Reason.of("rest_on_sides", sides=missing) if missing else LONGER,)


def with_errors_before(followed: Judgement, raw: Judgement) -> Judgement:
    """Give a verdict on corrected points the errors before calibration of the uncorrected ones."""
    holdout, errors, reason = followed.holdout, followed.fit_errors, followed.reason
    before = raw.sphere_before or followed.sphere_before
    if holdout is not None and raw.holdout is not None:
        holdout = replace(holdout, before=raw.holdout.before)
        corrected = _held_out_values(holdout) | ({} if before is None else {"raw_mg": before.mean})
        known = {name: value for name, value in corrected.items() if name in reason.values}
        reason = Reason.of(reason.code, **{**reason.values, **known})
    if errors is not None and raw.fit_errors is not None:
        errors = replace(errors, before_mg=raw.fit_errors.before_mg)
    simpler = followed.without_misalignment
    if simpler is not None and simpler.holdout is not None and raw.holdout is not None:
        simpler = replace(simpler, holdout=replace(simpler.holdout, before=raw.holdout.before))
    followed = replace(followed, reason=reason, holdout=holdout, fit_errors=errors)
    return replace(followed, sphere_before=before, without_misalignment=simpler)


def better(borrowed: Holdout, own: Holdout) -> bool:
    """Return True if held-out errors are clearly lower than others on the same postures.

    The 95 % confidence interval of the mean difference, posture by posture, lies above 0.
    """
    pairs = zip(borrowed.per_posture, own.per_posture, strict=True)
    return interval95([own_after - borrowed_after for (_, borrowed_after), (_, own_after) in pairs])[0] > 0


def reason_pool_does_not_fit(holdout: Holdout, usual_mg: float, limit_mg: float) -> Reason | None:
    """Return why a pool's coefficients do not fit a recording, or None.

    Args:
        holdout: errors on the recording's own windows.
        usual_mg: median of the pool's held-out errors; some recordings' postures are worse than others,
            and where a raw error happens to be small none can be smaller.
    """
    before, after = holdout.before.mean, holdout.after.mean
    values = {"before_mg": before, "after_mg": after, "orientations": holdout.postures}
    if after > before and after > ODD_TIMES * usual_mg + ODD_MG:
        return Reason.of("worse_than_usual", **values, usual_mg=usual_mg)
    return Reason.of("over_limit_here", **values, limit_mg=limit_mg) if after >= limit_mg else None


def add_fit_without_misalignment(
    verdict: Judgement, sample: Sample, how: Fitting, errors_of: ErrorsOf | None = None
) -> Judgement:
    """Add to a verdict what the same points give without misalignment, held out on the same postures.

    Args:
        errors_of: gives the error over the whole sphere.
    """
    calibration, points, gravity = verdict.calibration, sample.points, how.settings.gravity
    name = None if calibration is None else SIMPLER.get(calibration.model)
    if name is None:
        return verdict
    try:
        holdout, fitted = _fitted(MODELS[name], sample, how, verdict)
    except DivergedError:
        return verdict
    sphere = None if errors_of is None else errors_of((fitted,))[0]
    simpler = WithoutMisalignment(calibration_of_fit(name, fitted, points, gravity), holdout, sphere)
    return replace(verdict, without_misalignment=simpler)


def _fitted(model: Model, sample: Sample, how: Fitting, verdict: Judgement) -> tuple[Holdout, Fit]:
    """Return held-out error and fit of a model, with the prior if there is one; raises DivergedError."""
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
    """Add to a verdict of profile `paper` what the first set gives without misalignment, on the second."""
    if verdict.trials[0].model != "9" or "6" not in how.models:
        return verdict
    try:
        (fitted,) = how.fit((fit_points,), MODELS["6"])
    except DivergedError:
        return verdict
    holdout = model_ladder.control(control_points, fitted.parameters)
    calibration = calibration_of_fit("6", fitted, fit_points, how.settings.gravity)
    return replace(verdict, without_misalignment=WithoutMisalignment(calibration, holdout))
