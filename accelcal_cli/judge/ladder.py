"""The model ladder: which model do the held-out postures support?"""

from __future__ import annotations

from dataclasses import dataclass

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.judgement import Coverage, Trial
from accelcal_cli.core.points import MODELS, Model, PointSet
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge.errors import clustered_error, mean
from accelcal_cli.judge.holdout import FitFunction, Sample, blocked
from accelcal_cli.judge.uncertainty import uncertainty

LADDER = ("0", "3", "6", "3T", "9", "6T", "9T")
"""By number of parameters; the simpler model comes first."""

KINDS = ("scale", "misalignment", "offset", "temperature slopes")
"""The twelve parameters, by threes."""


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
    names = _wanted(settings, warm=evidence.sample.points.tau is not None)
    return tuple(_trial(evidence, settings, fit, MODELS[name]) for name in names)


def _wanted(settings: Settings, *, warm: bool) -> list[str]:
    """Identity, and the models that the user allows; slopes only where there is temperature."""
    names = [name for name in LADDER if settings.model in ("auto", name.removesuffix("T"))]
    names = names if "0" in names else ["0", *names]
    return names if warm else [name for name in names if not name.endswith("T")]


def _trial(evidence: Evidence, settings: Settings, fit: FitFunction, model: Model) -> Trial:
    reason = not_eligible(evidence, settings, model)
    if reason is not None:
        return Trial(model.name, None, reason)
    try:
        held = blocked(evidence.sample, model, fit, settings.folds)
        doubt = _doubt(evidence.sample.points, model, fit, settings)
    except DivergedError:
        return Trial(model.name, None, "the fit diverges: the points do not determine it")
    return Trial(model.name, held if doubt is None else None, doubt)


def _doubt(points: PointSet, model: Model, fit: FitFunction, settings: Settings) -> str | None:
    """Why a model that fits the held-out postures may still be wrong elsewhere on the sphere."""
    if not model.free:
        return None
    known = uncertainty(points, fit(points, model).parameters, model)
    if known is None:
        return "the points do not determine it"
    if settings.model == "auto" and known.worst_direction_mg >= settings.max_error_mg:
        return f"in some directions it would be uncertain by {known.worst_direction_mg:.0f} mg"
    return None


def not_eligible(evidence: Evidence, settings: Settings, model: Model) -> str | None:
    """Why a model cannot be fitted, or None if it can (or the user insists on it)."""
    if model.name not in evidence.models:
        return f"optimizer {settings.optimizer} fits no {_beyond(evidence.models, model)}"
    range_c = temperature_range_c(evidence.sample.points)
    if model.has_temperature and range_c < settings.min_temperature_range_c:
        return f"temperature varies by less than {settings.min_temperature_range_c:g} C"
    if settings.model == "auto" and model.free:
        missing = _uncovered(evidence.coverage, settings.coverage_g, model)
        if missing:
            return f"no stillness with {', '.join(missing)}"
    return None


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
