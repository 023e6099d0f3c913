"""The model ladder: the model that is supported by postures which its fit has not seen.

Points are grouped into postures, and postures into folds, exactly in integers; the held-out error is that of
the postures of a fold under a calibration that was fitted without them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, inf, radians

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE, clustered_error, interval95, mean
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.errors import DivergedError, Reason
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import MODELS, Fit, Model, PenalizedFitter, PointSet
from accelcal_cli.core.prior import POPULATION, Prior
from accelcal_cli.core.results import Coverage, Holdout, Trial, sides_not_up
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge import errors

FitFunction = Callable[[Sequence[PointSet], Model], list[Fit]]
"""The optimizer: fits a model to each of several sets of points."""

LADDER = ("0", "3", "6", "3T", "9", "6T", "9T")
"""Names of the models by number of parameters; the simpler model comes first."""

KINDS = ("scale", "misalignment", "offset", "temperature slopes")
"""Names of the parameters in groups of three."""

LEAST_INFORMATION = 2.0**-14
"""Least information on the slopes (`errors.slope_information`) that a fit needs. Sound recordings have at
least 2**-12.7, those where only one posture is hot at most 2**-46: there the objective is so flat that a
descent continues for thousands of steps, to slopes that mean nothing."""

FEWEST_POSTURES = 2
"""Postures that errors can be compared on."""

_COARSE_BITS = 12
"""Fraction bits of the coordinates that separate postures."""


@dataclass(frozen=True, slots=True, eq=False)
class Fitting:
    """How points are fitted and judged.

    Attributes:
        fit: the optimizer with its numbers for the settings' profile.
        models: names of the models that it can fit.
        penalized: the optimizer with a prior; None if the settings have none.
        prior: what is known of sensors beforehand.
        judging: an optimizer with a prior, by which profile `paper` judges a fit that had none.
    """

    settings: Settings
    fit: FitFunction
    models: tuple[str, ...] = LADDER
    penalized: PenalizedFitter | None = None
    prior: Prior = POPULATION
    judging: PenalizedFitter | None = None


def postures(points: PointSet, degrees: float) -> NDArray[np.int64]:
    """Return the posture number of each point, (n,), from 0.

    Points are taken by falling number of windows (then in their order); each joins the nearest
    posture whose first point is within `degrees`, or begins one.
    """
    limit = round(4096 * cos(radians(degrees)) ** 2)
    order = np.lexsort((np.arange(len(points)), -points.windows))
    coarse = points.xyz[order] >> (FRACTION_BITS - _COARSE_BITS)
    norms = np.maximum(1, (coarse * coarse).sum(axis=1))
    label, closest = np.full(len(points), -1, np.int64), np.full(len(points), -1, np.int64)
    leaders = 0
    while (label < 0).any():
        first = int((label < 0).argmax())
        label[first] = leaders
        dots = coarse[first + 1 :] @ coarse[first]
        closeness = dots * dots // norms[first]
        near = (dots > 0) & (closeness * 4096 >= limit * norms[first + 1 :])
        nearer = first + 1 + np.flatnonzero(near & (closeness > closest[first + 1 :]))
        label[nearer], closest[nearer] = leaders, closeness[nearer - first - 1]
        leaders += 1
    in_order = np.empty_like(label)
    in_order[order] = label
    return in_order


def temperature_blocks(points: PointSet, label: NDArray[np.int64], width_c: float) -> NDArray[np.int64]:
    """Return the block number of each point, (n,): a block is a posture within `width_c` degrees C.

    Without temperatures a block is a posture.
    """
    if points.tau is None or points.temperature is None:
        return label
    scale = points.temperature
    milli = scale.reference_mc * ONE + points.tau * round(1000 * scale.span_c)
    band = milli // (round(1000 * width_c) * ONE)
    return np.unique(np.stack([label, band], axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def folds(label: NDArray[np.int64], number: int) -> NDArray[np.int64]:
    """Return the fold of each point: postures are dealt out in turn, so that none is split."""
    return label % number


def _left_out(label: NDArray[np.int64], number: int) -> list[NDArray[np.bool_]]:
    """Return masks (n,) of the points of each fold, which its fit does not see."""
    fold = folds(label, number)
    return [fold == one for one in sorted(set(fold.tolist()))]


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """The points of a recording.

    Attributes:
        label: (n,) posture number of each point.
        block: (n,) block number of each point; a block lies within one posture.
    """

    points: PointSet
    label: NDArray[np.int64]
    block: NDArray[np.int64]


def blocked(sample: Sample, model: Model, fit: FitFunction, number: int) -> tuple[Holdout, Fit]:
    """Judge each fold of whole postures by a fit to the others; also return the fit to all points.

    A random hold-out would leave neighbours of every held-out point in the fit and hide failure.
    """
    points, label = sample.points, sample.label
    left_out = _left_out(label, number)
    *fits, whole = fit([*(points.select(~out) for out in left_out), points], model)
    deviations = np.empty(len(points))
    for out, fitted in zip(left_out, fits, strict=True):
        deviations[out] = errors.deviations_mg(
            points.select(out).straightened(fitted.bend), fitted.parameters
        )
    before = errors.per_posture(errors.deviations_mg(points, IDENTITY), points.weights, label)
    after = errors.per_posture(deviations, points.weights, label)
    blocks = errors.per_posture(deviations, points.weights, sample.block)
    pairs = tuple((before[key], after[key]) for key in sorted(before))
    method = f"{number} folds of whole postures"
    posture = dict(zip(sample.block.tolist(), label.tolist(), strict=True))
    compared = tuple((posture[key], blocks[key]) for key in sorted(blocks))
    return of_postures(method, len(points), pairs, compared), whole


def control(points: PointSet, parameters: tuple[int, ...]) -> Holdout:
    """Judge a fit by F's second set of points (eq. 21); every point counts as a posture."""
    before = errors.deviations_mg(points, IDENTITY).tolist()
    after = errors.deviations_mg(points, parameters).tolist()
    pairs = tuple(zip(before, after, strict=True))
    return of_postures("control points (second set)", len(points), pairs, tuple(enumerate(after)))


def held_out(
    points: PointSet, calibration: Calibration, rest: Gravity, degrees: float, method: str
) -> Holdout | None:
    """Judge a calibration by points that it was not fitted to; postures count alike.

    Args:
        points: in units of local gravity, with temperatures if the calibration has slopes.
        rest: what rest measures where the points were recorded.
        degrees: width of a posture.
        method: how they were held out, for the report.

    Returns:
        None for fewer than FEWEST_POSTURES.
    """
    label = postures(points, degrees)
    if not len(points) or label.max() + 1 < FEWEST_POSTURES:
        return None
    raw = [points.xyz[:, axis] / ONE for axis in range(3)]
    before, after = (
        errors.per_posture(errors.lengths_off_mg(xyz), points.weights, label)
        for xyz in (raw, errors.applied(points, calibration, rest))
    )
    return of_postures(method, len(points), tuple((before[key], after[key]) for key in sorted(before)))


def of_postures(
    method: str,
    number: int,
    pairs: tuple[tuple[float, float], ...],
    blocks: tuple[tuple[int, float], ...] = (),
) -> Holdout:
    """Summarise the errors of `number` points by pairs of (before, after) [mg] of each posture."""
    before, after = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    summaries = errors.summary(before), errors.summary(after)
    low, high = interval95(after)
    return Holdout(method, number, len(pairs), *summaries, (max(0.0, low), high), pairs, blocks)


def try_models(sample: Sample, coverage: Coverage, how: Fitting) -> tuple[Trial, ...]:
    """Try every model that the settings allow; slopes only if there are temperatures."""
    warm, asked = sample.points.tau is not None, how.settings.model
    allowed = ("0", *LADDER) if asked == "auto" else ("0", asked, f"{asked}T")
    names = (name for name in LADDER if name in allowed and (warm or not name.endswith("T")))
    return tuple(_trial(sample, coverage, how, MODELS[name]) for name in names)


def _trial(sample: Sample, coverage: Coverage, how: Fitting, model: Model) -> Trial:
    reason = not_eligible(sample, coverage, how, model)
    if reason is not None:
        return Trial(model.name, None, reason)
    try:
        holdout, whole = blocked(sample, model, how.fit, how.settings.folds)
    except DivergedError:
        return Trial(model.name, None, Reason("fit_diverges"))
    if not model.free:
        return Trial(model.name, holdout, None, whole)
    known = errors.uncertainty(sample.points, whole.parameters, model)
    unsure = doubt(known, how.settings.max_error_mg if how.settings.model == "auto" else inf)
    return Trial(model.name, holdout if unsure is None else None, unsure, whole)


def doubt(known: errors.Uncertainty | None, limit_mg: float) -> Reason | None:
    """Return why a model may be wrong where there are no points, or None."""
    if known is None:
        return Reason("not_determined")
    if known.worst_direction_mg >= limit_mg:
        return Reason.of("uncertain_somewhere", by_mg=known.worst_direction_mg)
    return None


def not_eligible(sample: Sample, coverage: Coverage, how: Fitting, model: Model) -> Reason | None:
    """Return why a model cannot be fitted, or None if it can be (or the user insists on it)."""
    settings, number = how.settings, coverage.distinct_orientations
    if model.name not in how.models:
        return never_fits(settings.optimizer, _never_fitted(how.models, model))
    if model.free and number < settings.min_postures:
        return Reason.of("too_few_orientations", orientations=number, needed=settings.min_postures)
    range_c, least_c = temperature_range_c(sample.points), settings.min_temperature_range_c
    if model.has_temperature and range_c < least_c:
        return Reason.of("temperature_too_even", range_c=range_c, least_c=least_c)
    if model.has_temperature:
        left_out = _left_out(sample.label, settings.folds)
        parts = (sample.points.select(~out) for out in left_out)
        # every fit, with any fold left out, has to tell slopes from offsets on all axes
        if any(errors.slope_information(part) < LEAST_INFORMATION for part in parts):
            return Reason("few_orientations_differ_in_temperature")
    if settings.model == "auto" and model.free:
        return _uncovered(coverage, settings.coverage_g, model)
    return None


def never_fits(optimizer: str, what: str) -> Reason:
    """Return the reason that an optimizer has no such parameters."""
    return Reason.of("optimizer_never_fits", optimizer=optimizer, what=what)


def _uncovered(coverage: Coverage, reach_g: float, model: Model) -> Reason | None:
    """Return on which sides a model lacks points: it needs both of an axis for a scale, one for an offset."""
    if any(index < 6 for index in model.free):
        sides = sides_not_up(coverage.axis_min_g, coverage.axis_max_g, reach_g)
        return Reason.of("no_stillness_on_sides", sides=sides, reach_g=reach_g) if sides else None
    ends = zip("xyz", coverage.axis_min_g, coverage.axis_max_g, strict=True)
    axes = [axis for axis, low, high in ends if max(-low, high) < reach_g]
    return Reason.of("no_stillness_along", axes=axes, reach_g=reach_g) if axes else None


def _never_fitted(models: tuple[str, ...], model: Model) -> str:
    """Return the first kind of parameter that a model has and the optimizer never fits."""
    fitted = {index for name in models for index in MODELS[name].free}
    new = [KINDS[index // 3] for index in model.free if index not in fitted]
    return new[0] if new else f"model {model.name}"


def temperature_range_c(points: PointSet) -> float:
    """Return the range of the points' temperatures [degrees C]; 0 without temperatures."""
    if points.tau is None or points.temperature is None or not len(points):
        return 0.0
    return float(points.tau.max() - points.tau.min()) / ONE * points.temperature.span_c


def choose(trials: tuple[Trial, ...]) -> Trial:
    """Return the simplest model whose error is within one standard error of the best one's.

    The errors are those of the blocks; the standard error is that of their differences, clustered by posture.
    """
    scored = [(trial, trial.holdout) for trial in trials if trial.holdout is not None]
    _, best = min(scored, key=lambda one: one[1].compared_mg())
    return next(trial for trial, holdout in scored if _ties(holdout, best))


def _ties(simple: Holdout, best: Holdout) -> bool:
    differences = [a - b for (_, a), (_, b) in zip(simple.blocks, best.blocks, strict=True)]
    return mean(differences) <= clustered_error(differences, [posture for posture, _ in best.blocks])
