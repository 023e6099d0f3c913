"""The verdict on a calibration from known orientations, by orientations that the fit has not seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.errors import counted
from accelcal_cli.core.points import WEIGHT_ONE, Fit, Operations, PointSet
from accelcal_cli.core.results import Coverage, FitErrors, Holdout, Judgement, Outcome, Trial
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.core.statistics import mean
from accelcal_cli.judge.errors import coverage, summary
from accelcal_cli.judge.model_ladder import of_postures
from accelcal_cli.six_pose.listing import LENGTH_TOLERANCE
from accelcal_cli.six_pose.poses import PoseError, Session, SixPoseFit, VectorErrors

METHOD = "one orientation left out at a time"
NOTHING_HELD_OUT = "nothing was held out, so that the error is not known"
DEGREE_MG = 17.5
"""What a tilt of one degree makes of 1 g across it."""


@dataclass(frozen=True, slots=True)
class SessionHoldout:
    """Errors of the orientations that could be left out.

    Attributes:
        raw, norms: of the length, without a calibration and with the twelve parameters.
        vectors: of the vector, by which the two are compared.
    """

    raw: Holdout
    norms: Holdout
    vectors: VectorErrors


def judge_six_pose(
    session: Session, fit: SixPoseFit, settings: PoseSettings
) -> tuple[Judgement, VectorErrors | None]:
    """Accept, refuse, or find that the raw data are no worse than the poses; without a check, accept.

    Returns:
        the judgement, and the errors of vectors; None where nothing was held out.
    """
    if not fit.checked:
        return _unjudged(session, fit), None
    holdout = _holdout(session, fit)
    outcome, message = _outcome(session, fit, settings, holdout)
    verdict = Judgement(
        outcome=outcome,
        message=message,
        coverage=_coverage(session, fit),
        trials=(Trial("0", holdout.raw, None), Trial("12", holdout.norms, None)),
        holdout=holdout.raw if outcome is Outcome.ALREADY_GOOD else holdout.norms,
        fit_errors=_fit_errors(session, fit),
    )
    return _with_calibration(verdict, fit), holdout.vectors


def _unjudged(session: Session, fit: SixPoseFit) -> Judgement:
    """The calibration of poses that leave none to judge it by: no error is claimed."""
    before = mean(_by_orientation(session, fit, lambda error: error.raw, every=True))
    verdict = Judgement(
        outcome=Outcome.CALIBRATED,
        message=f"model 12 of {counted(session.orientations, 'pose')}, unchecked: {NOTHING_HELD_OUT}; "
        f"the raw data are {before:.1f} mg off, as vectors",
        coverage=_coverage(session, fit),
        trials=(Trial("0", None, NOTHING_HELD_OUT), Trial("12", None, NOTHING_HELD_OUT)),
        fit_errors=None if fit.precision is None else _fit_errors(session, fit),
    )
    return _with_calibration(verdict, fit)


def _with_calibration(verdict: Judgement, fit: SixPoseFit) -> Judgement:
    if verdict.outcome is Outcome.REFUSED:
        return verdict
    if verdict.outcome is Outcome.ALREADY_GOOD:
        same = Calibration("0", IDENTITY, None, fit.calibration.gravity)
        return replace(verdict, calibration=same, fit=Fit(IDENTITY, 0, "nothing to fit", Operations()))
    return replace(
        verdict,
        calibration=fit.calibration,
        fit=Fit(fit.calibration.parameters, 1, "solved", Operations()),
        standard_errors=None if fit.precision is None else fit.precision.parameters,
    )


def _outcome(
    session: Session, fit: SixPoseFit, settings: PoseSettings, holdout: SessionHoldout
) -> tuple[Outcome, str]:
    before, after = holdout.vectors.before.mean, holdout.vectors.after.mean
    norm_before, norm_after = holdout.norms.before.mean, holdout.norms.after.mean
    if after >= settings.max_vector_error_mg or norm_after >= settings.max_error_mg:
        return Outcome.REFUSED, (
            f"the poses disagree: {after:.1f} mg on orientations left out, {norm_after:.1f} mg in length "
            f"(the limits are {settings.max_vector_error_mg:g} and {settings.max_error_mg:g}); "
            f"{_worst(session, fit)}; {_way(session, settings)}"
        )
    if after >= before:
        return Outcome.ALREADY_GOOD, (
            f"the raw data are {before:.1f} mg off, no more than twelve parameters: {after:.1f} mg on "
            "orientations left out"
        )
    return Outcome.CALIBRATED, (
        f"model 12: {norm_before:.1f} mg before, {norm_after:.2f} mg after on orientations left out; "
        f"as vectors {before:.1f} and {after:.2f} mg{_unchecked(session, fit)}"
    )


def _way(session: Session, settings: PoseSettings) -> str:
    """What may be done about poses that disagree."""
    local_g = float(settings.gravity.local_g())
    lengths = [sqrt(sum(value**2 for value in pose.reference)) / ONE for pose in session.poses]
    if any(abs(length - local_g) > 2 * LENGTH_TOLERANCE for length in lengths):
        return "check the references and their times"
    return "rest the device exactly on its faces, on a level surface"


def _worst(session: Session, fit: SixPoseFit) -> str:
    """The state farthest from what the other orientations say of it."""
    error, pose = max(
        ((error, pose) for pose, error in zip(session.poses, fit.errors, strict=True)),
        key=lambda pair: pair[0].held_out or 0.0,
    )
    start_s = session.seconds(pose.state.start_us, pose.state.file)
    file = session.name(pose.state.file)
    where = pose.face if file is None else f"{pose.face} in {file}"
    return (
        f"worst is {where} at {start_s:.0f} s with {error.held_out or 0.0:.0f} mg (or its opposite is "
        f"the cause; a tilt of 1 degree makes {DEGREE_MG:g} mg)"
    )


def _unchecked(session: Session, fit: SixPoseFit) -> str:
    """Orientations without which there is no fit, so that nothing says whether they are right."""
    pairs = zip(session.poses, fit.errors, strict=True)
    names = sorted({pose.face for pose, error in pairs if error.held_out is None})
    if not names:
        return ""
    missing = f" ({', '.join(session.missing)} missing)" if session.missing else ""
    return f"; nothing checks {', '.join(names)}, without which there is no fit{missing}"


def _holdout(session: Session, fit: SixPoseFit) -> SessionHoldout:
    """Each orientation counts the same, with the mean of its states."""
    known = [error for error in fit.errors if error.held_out is not None]
    norm_before = _by_orientation(session, fit, lambda error: error.raw_norm)
    norm_after = _by_orientation(session, fit, lambda error: error.held_out_norm or 0.0)
    before = _by_orientation(session, fit, lambda error: error.raw)
    after = _by_orientation(session, fit, lambda error: error.held_out or 0.0)
    raw, norms = (
        of_postures(
            METHOD, len(known), tuple(zip(norm_before, shown, strict=True)), tuple(enumerate(compared))
        )
        for shown, compared in ((norm_before, before), (norm_after, after))
    )
    return SessionHoldout(raw, norms, VectorErrors(summary(before), summary(after)))


def _by_orientation(
    session: Session, fit: SixPoseFit, value: Callable[[PoseError], float], *, every: bool = False
) -> list[float]:
    """Mean of each orientation's states; of those that could be left out, or of `every` one."""
    groups: dict[int, list[float]] = {}
    for pose, error in zip(session.poses, fit.errors, strict=True):
        if every or error.held_out is not None:
            groups.setdefault(pose.number, []).append(value(error))
    return [mean(groups[number]) for number in sorted(groups)]


def _fit_errors(session: Session, fit: SixPoseFit) -> FitErrors:
    before = _by_orientation(session, fit, lambda error: error.raw_norm, every=True)
    after = _by_orientation(session, fit, lambda error: error.norm, every=True)
    return FitErrors(len(session.poses), len(after), mean(before), mean(after))


def _coverage(session: Session, fit: SixPoseFit) -> Coverage:
    states = [pose.state for pose in session.poses]
    points = PointSet(
        np.array([state.raw for state in states], np.int64).reshape(-1, 3),
        np.full(len(states), WEIGHT_ONE, np.int64),
        np.array([state.windows for state in states], np.int64),
    )
    return replace(
        coverage(points, np.array([pose.number for pose in session.poses], np.int64)),
        condition_number=fit.condition_number,
        worst_direction_mg=None if fit.precision is None else fit.precision.worst_direction_mg,
    )
