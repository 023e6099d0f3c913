"""The model ladder: which model is supported by postures that its fit has not seen?

Points are grouped into postures, and postures into folds, exactly in integers; the held-out error is what a
calibration does to the postures of the fold that it has not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, inf, radians

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError, counted
from accelcal_cli.core.points import MODELS, Fit, Model, PenalizedFitter, PointSet
from accelcal_cli.core.prior import POPULATION, Prior
from accelcal_cli.core.results import Coverage, Holdout, Trial
from accelcal_cli.core.settings import Settings
from accelcal_cli.core.statistics import clustered_error, interval95, mean
from accelcal_cli.judge import errors

FitFunction = Callable[[Sequence[PointSet], Model], list[Fit]]
"""The optimizer: a fit of a model to each of some sets of points."""

LADDER = ("0", "3", "6", "3T", "9", "6T", "9T")
"""By number of parameters; the simpler model comes first."""

KINDS = ("scale", "misalignment", "offset", "temperature slopes")
"""The twelve parameters, by threes."""

LEAST_INFORMATION = 2.0**-14
"""What the points of a fit have to say of the slopes (`errors.slope_information`). Sound recordings have
2**-12.7 and more, those where only one posture is hot 2**-46 and less: there the descent has a floor so flat
that it walks on for thousands of steps, to slopes that mean nothing."""

_COARSE_BITS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Fitting:
    """How points are fitted and judged.

    Attributes:
        fit: the optimizer with its numbers for the settings' profile.
        models: names of the models that it can fit.
        penalized: the optimizer with a prior; None where the settings have none.
        prior: what it is told of sensors.
    """

    settings: Settings
    fit: FitFunction
    models: tuple[str, ...] = LADDER
    penalized: PenalizedFitter | None = None
    prior: Prior = POPULATION


def postures(points: PointSet, degrees: float) -> NDArray[np.int64]:
    """Posture number of each point, (n,), numbered from 0 by first point.

    Points are taken by falling number of windows (then in their order); each joins the nearest
    posture within so many degrees of its first point, or begins one.
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
    """Number of each point's block, (n,): its posture within `width_c` degrees C, posture by posture.

    Without temperatures a block is a posture.
    """
    if points.tau is None or points.temperature is None:
        return label
    scale = points.temperature
    milli = scale.reference_mc * ONE + points.tau * round(1000 * scale.span_c)
    band = milli // (round(1000 * width_c) * ONE)
    return np.unique(np.stack([label, band], axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def folds(label: NDArray[np.int64], number: int) -> NDArray[np.int64]:
    """Fold of each point: postures are dealt out in turn, so that none is split."""
    return label % number


def _left_out(label: NDArray[np.int64], number: int) -> list[NDArray[np.bool_]]:
    """The points of each fold, which its fit does not see, (n,) each."""
    fold = folds(label, number)
    return [fold == one for one in sorted(set(fold.tolist()))]


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Points that belong together.

    Attributes:
        label: (n,) posture number of each point.
        block: (n,) number of its block, within one posture.
    """

    points: PointSet
    label: NDArray[np.int64]
    block: NDArray[np.int64]


def blocked(sample: Sample, model: Model, fit: FitFunction, number: int) -> tuple[Holdout, Fit]:
    """Folds of whole postures, each judged by a fit of the others; and the fit to all points.

    A random hold-out would leave neighbours of every held-out point in the fit and hide failure.
    """
    points, label = sample.points, sample.label
    left_out = _left_out(label, number)
    *fits, whole = fit([*(points.select(~out) for out in left_out), points], model)
    deviations = np.empty(len(points))
    for out, fitted in zip(left_out, fits, strict=True):
        deviations[out] = errors.deviations_mg(points.select(out), fitted.parameters)
    before = errors.per_posture(errors.deviations_mg(points, IDENTITY), points.weights, label)
    after = errors.per_posture(deviations, points.weights, label)
    blocks = errors.per_posture(deviations, points.weights, sample.block)
    pairs = tuple((before[key], after[key]) for key in sorted(before))
    method = f"{number} folds of whole postures"
    posture = dict(zip(sample.block.tolist(), label.tolist(), strict=True))
    compared = tuple((posture[key], blocks[key]) for key in sorted(blocks))
    return of_postures(method, len(points), pairs, compared), whole


def control(points: PointSet, parameters: tuple[int, ...]) -> Holdout:
    """F's second set of points, none of which was fitted (eq. 21); every point is a posture."""
    before = errors.deviations_mg(points, IDENTITY).tolist()
    after = errors.deviations_mg(points, parameters).tolist()
    pairs = tuple(zip(before, after, strict=True))
    return of_postures("control points (second set)", len(points), pairs, tuple(enumerate(after)))


def of_postures(
    method: str,
    number: int,
    pairs: tuple[tuple[float, float], ...],
    blocks: tuple[tuple[int, float], ...] = (),
) -> Holdout:
    """The summary of (before, after) [mg] of each posture, of so many points."""
    before, after = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    summaries = errors.summary(before), errors.summary(after)
    low, high = interval95(after)
    return Holdout(method, number, len(pairs), *summaries, (max(0.0, low), high), pairs, blocks)


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What the ladder has to go by.

    Attributes:
        sample: the recording's points, their postures and blocks.
        coverage: where they lie.
        models: names of the models that the optimizer can fit.
    """

    sample: Sample
    coverage: Coverage
    models: tuple[str, ...] = LADDER


def try_models(evidence: Evidence, settings: Settings, fit: FitFunction) -> tuple[Trial, ...]:
    """Held-out error of every model that the points can hold, and why the others cannot."""
    names = _wanted(settings, temperature=evidence.sample.points.tau is not None)
    trials = []
    for name in names:
        trials.append(_trial(evidence, settings, fit, MODELS[name]))
    return tuple(trials)


def _wanted(settings: Settings, *, temperature: bool) -> list[str]:
    """Identity, and the models that the user allows; slopes only where there is temperature."""
    names = [name for name in LADDER if settings.model in ("auto", name.removesuffix("T"))]
    names = names if "0" in names else ["0", *names]
    return names if temperature else [name for name in names if not name.endswith("T")]


def _trial(evidence: Evidence, settings: Settings, fit: FitFunction, model: Model) -> Trial:
    reason = not_eligible(evidence, settings, model)
    if reason is not None:
        return Trial(model.name, None, reason)
    try:
        holdout, whole = blocked(evidence.sample, model, fit, settings.folds)
    except DivergedError:
        return Trial(model.name, None, "the fit diverges: the points do not determine it")
    if not model.free:
        return Trial(model.name, holdout, None, whole)
    known = errors.uncertainty(evidence.sample.points, whole.parameters, model)
    unsure = doubt(known, settings.max_error_mg if settings.model == "auto" else inf)
    return Trial(model.name, holdout if unsure is None else None, unsure, whole)


def doubt(known: errors.Uncertainty | None, limit_mg: float) -> str | None:
    """Why a model that fits points which it did not see may still be wrong elsewhere on the sphere."""
    if known is None:
        return "the points do not determine it"
    if known.worst_direction_mg >= limit_mg:
        return f"in some directions it would be uncertain by {known.worst_direction_mg:.0f} mg"
    return None


def not_eligible(evidence: Evidence, settings: Settings, model: Model) -> str | None:
    """Why a model cannot be fitted, or None if it can (or the user insists on it)."""
    if model.name not in evidence.models:
        return f"optimizer {settings.optimizer} fits no {_beyond(evidence.models, model)}"
    number = evidence.coverage.distinct_orientations
    if model.free and number < settings.min_postures:
        return f"stillness in only {counted(number, 'posture')}, at least {settings.min_postures} are needed"
    range_c = temperature_range_c(evidence.sample.points)
    if model.has_temperature and range_c < settings.min_temperature_range_c:
        return f"temperature varies by less than {settings.min_temperature_range_c:g} C"
    if model.has_temperature and not _slopes_known(evidence.sample, settings.folds):
        return "too few postures differ in temperature"
    if settings.model == "auto" and model.free:
        missing = _uncovered(evidence.coverage, settings.coverage_g, model)
        if missing:
            return f"no stillness with {', '.join(missing)}"
    return None


def _slopes_known(sample: Sample, number: int) -> bool:
    """Whether the points of every fit, with any fold left out, tell slopes from offsets on all axes."""
    parts = (sample.points.select(~out) for out in _left_out(sample.label, number))
    return all(errors.slope_information(part) >= LEAST_INFORMATION for part in parts)


def _uncovered(coverage: Coverage, reach_g: float, model: Model) -> list[str]:
    """What a model needs and the points lack: scale both sides of every axis, an offset one of them."""
    if any(index < 6 for index in model.free):
        return one_sided_axes(coverage, reach_g)
    sides = zip("xyz", coverage.axis_min_g, coverage.axis_max_g, strict=True)
    return [f"{axis} beyond +-{reach_g:g} g" for axis, low, high in sides if max(-low, high) < reach_g]


def _beyond(models: tuple[str, ...], model: Model) -> str:
    """The first kind of parameter that a model has and the optimizer never fits."""
    fitted = {index for name in models for index in MODELS[name].free}
    new = [KINDS[index // 3] for index in model.free if index not in fitted]
    return new[0] if new else f"model {model.name}"


def one_sided_axes(coverage: Coverage, reach_g: float) -> list[str]:
    """Sides of axes without points, such as `x below -0.3 g`."""
    missing = []
    for axis, low, high in zip("xyz", coverage.axis_min_g, coverage.axis_max_g, strict=True):
        if low > -reach_g:
            missing.append(f"{axis} below -{reach_g:g} g")
        if high < reach_g:
            missing.append(f"{axis} above {reach_g:g} g")
    return missing


def temperature_range_c(points: PointSet) -> float:
    """Range of the points' temperatures [degrees C]; 0 without temperatures."""
    if points.tau is None or points.temperature is None or not len(points):
        return 0.0
    return float(points.tau.max() - points.tau.min()) / ONE * points.temperature.span_c


def choose(trials: tuple[Trial, ...]) -> Trial:
    """The simplest model whose error is within one standard error of the best one's.

    The errors are those of the blocks; the standard error is that of their differences, which
    are alike within a posture.
    """
    scored = [trial for trial in trials if trial.holdout is not None]
    best = min(scored, key=lambda trial: trial.holdout.compared_mg() if trial.holdout else float("inf"))
    return next(trial for trial in scored if _ties(trial, best))


def _ties(trial: Trial, best: Trial) -> bool:
    assert trial.holdout is not None and best.holdout is not None
    simple, full = trial.holdout.blocks, best.holdout.blocks
    differences = [a - b for (_, a), (_, b) in zip(simple, full, strict=True)]
    return mean(differences) <= clustered_error(differences, [posture for posture, _ in full])
