"""The verdict on a calibration from known orientations, and its sections of the report.

Orientations that the fit has not seen judge it. The report gives the model in its authors' convention.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np

from accelcal_cli.core.arithmetic import ONE, to_float
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.declared import as_json
from accelcal_cli.core.points import WEIGHT_ONE, Fit, Operations, PointSet
from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.results import Coverage, FitErrors, Holdout, Judgement, Outcome, Trial
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.core.statistics import mean
from accelcal_cli.judge.errors import coverage, summary
from accelcal_cli.judge.model_ladder import of_postures
from accelcal_cli.judge.verdict import Decision
from accelcal_cli.output.sections import (
    ErrorPair,
    KnownOrientations,
    LeftOutPoses,
    OrientationErrors,
    PoseSection,
    Roll,
    SessionFile,
    matrix,
    vector,
)
from accelcal_cli.six_pose.listing import LENGTH_TOLERANCE, Origin
from accelcal_cli.six_pose.poses import PoseError, Session, SixPoseFit, VectorErrors

METHOD = "one orientation left out at a time"
UNKNOWN = Reason("nothing_held_out")
EQUATION = "z = K a + O"


def judge_six_pose(
    session: Session, fit: SixPoseFit, settings: PoseSettings
) -> tuple[Judgement, VectorErrors | None]:
    """Accept, refuse, or find that the raw data are no worse than the poses; without a check, accept.

    Returns:
        the judgement, and the errors of vectors; None if nothing was held out.
    """
    if not fit.checked:
        return _unjudged(session, fit), None
    raw, norms, vectors = _holdout(session, fit)
    decided = _outcome(session, fit, settings, norms, vectors)
    outcome = decided.outcome
    verdict = Judgement(
        outcome=outcome,
        reason=decided.reason,
        advice=decided.advice,
        coverage=_coverage(session, fit),
        trials=(Trial("0", raw, None), Trial("12", norms, None)),
        holdout=raw if outcome is Outcome.ALREADY_GOOD else norms,
        fit_errors=_fit_errors(session, fit),
    )
    return _with_calibration(verdict, fit), vectors


def _unjudged(session: Session, fit: SixPoseFit) -> Judgement:
    """Accept the calibration of poses that leave none to judge it by; no error is claimed."""
    before = mean(_by_orientation(session, fit, lambda error: error.raw, every=True))
    verdict = Judgement(
        outcome=Outcome.CALIBRATED,
        reason=Reason.of("poses_unchecked", orientations=session.orientations, before_mg=before),
        coverage=_coverage(session, fit),
        trials=(Trial("0", None, UNKNOWN), Trial("12", None, UNKNOWN)),
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
    session: Session, fit: SixPoseFit, settings: PoseSettings, norms: Holdout, vectors: VectorErrors
) -> Decision:
    before, after = vectors.before.mean, vectors.after.mean
    norm_before, norm_after = norms.before.mean, norms.after.mean
    values = {"before_mg": before, "after_mg": after}
    values |= {"norm_before_mg": norm_before, "norm_after_mg": norm_after}
    if after >= settings.max_vector_error_mg or norm_after >= settings.max_error_mg:
        limits = {"vector_limit_mg": settings.max_vector_error_mg, "limit_mg": settings.max_error_mg}
        why = Reason.of("poses_disagree", **values, **limits, **_worst(session, fit))
        return Decision(Outcome.REFUSED, why, (_way(session, settings),))
    if after >= before:
        return Decision(Outcome.ALREADY_GOOD, Reason.of("poses_no_better", **values))
    # the orientations without which there is no fit, so that nothing checks them
    pairs = zip(session.poses, fit.errors, strict=True)
    faces = sorted({str(pose.face) for pose, error in pairs if error.held_out is None})
    why = Reason.of("poses_calibrated", **values, unchecked=faces, missing=session.missing if faces else ())
    return Decision(Outcome.CALIBRATED, why)


def _way(session: Session, settings: PoseSettings) -> Reason:
    """Return advice on poses that disagree."""
    local_g = float(settings.gravity.local_g())
    lengths = [sqrt(sum(value**2 for value in pose.reference)) / ONE for pose in session.poses]
    wrong = any(abs(length - local_g) > 2 * LENGTH_TOLERANCE for length in lengths)
    return Reason("check_references" if wrong else "rest_on_faces")


def _worst(session: Session, fit: SixPoseFit) -> dict[str, Any]:
    """Return the state farthest from where the other orientations expect it."""
    error, pose = max(
        ((error, pose) for pose, error in zip(session.poses, fit.errors, strict=True)),
        key=lambda pair: pair[0].held_out or 0.0,
    )
    file = session.name(pose.state.file)
    return {
        "worst": pose.face if file is None else f"{pose.face} in {file}",
        "start_s": session.seconds(pose.state.start_us, pose.state.file),
        "worst_mg": error.held_out or 0.0,
    }


def _holdout(session: Session, fit: SixPoseFit) -> tuple[Holdout, Holdout, VectorErrors]:
    """Return the errors of held-out orientations; each counts the same, with the mean of its states.

    Returns:
        those of the length, without a calibration and with the twelve parameters, and those of the vector, by
        which the two are compared.
    """
    known = [error for error in fit.errors if error.held_out is not None]
    norm_before = _by_orientation(session, fit, lambda error: error.raw_norm)
    norm_after = _by_orientation(session, fit, lambda error: error.held_out_norm or 0.0)
    before = _by_orientation(session, fit, lambda error: error.raw)
    after = _by_orientation(session, fit, lambda error: error.held_out or 0.0)
    raw, norms = (
        of_postures(METHOD, len(known), (*zip(norm_before, shown, strict=True),), (*enumerate(compared),))
        for shown, compared in ((norm_before, before), (norm_after, after))
    )
    return raw, norms, VectorErrors(summary(before), summary(after))


def _by_orientation(
    session: Session, fit: SixPoseFit, value: Callable[[PoseError], float], *, every: bool = False
) -> list[float]:
    """Return the mean of each orientation's states; of `every` one, or those that could be left out."""
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


def poses_json(session: Session, fit: SixPoseFit) -> list[dict[str, Any]]:
    """Return the `poses` list, in the order of time."""
    found = []
    for pose, error in zip(session.poses, fit.errors, strict=True):
        state = pose.state
        section = PoseSection(
            face=pose.face,
            **session.place_json(state.file, state.start_us, state.end_us),
            windows=state.windows,
            mean_raw_g=vector(map(to_float, state.raw)),
            reference_g=vector(map(to_float, pose.reference)),
            raw_mg=error.raw,
            residual_mg=None if fit.precision is None else error.residual,
            held_out_mg=error.held_out,
            held_out_norm_mg=error.held_out_norm,
            held_out_tilt_degrees=error.tilt_degrees,
            repeat_mg=error.repeat,
        )
        found.append(as_json(section))
    return found


def known_json(
    session: Session,
    fit: SixPoseFit,
    outcome: Outcome,
    vectors: VectorErrors | None,
    rolls: Sequence[Roll] = (),
) -> dict[str, Any]:
    """Return the `known_orientations` object; K and O are null if they were refused.

    Args:
        vectors: None if nothing was held out.
    """
    refused, known = outcome is Outcome.REFUSED, fit.precision
    repeats = [error.repeat for error in fit.errors if error.repeat is not None]
    section = KnownOrientations(
        equation=EQUATION,
        K=None if refused else matrix(fit.k),
        O=None if refused else vector(fit.o),
        standard_errors=None
        if refused or known is None
        else OrientationErrors(matrix(known.k), vector(known.o)),
        holdout_vector_mg=None if vectors is None else ErrorPair(vectors.before, vectors.after),
        repeat_spread_mg=max(repeats, default=None),
        orientations=session.orientations,
        missing_faces=session.missing,
        left_out=LeftOutPoses(len(session.between), fit.between_norm_mg, session.short),
        unchecked=UNKNOWN.code if vectors is None else None,
        rolls=tuple(rolls) or None,
        files=tuple(map(_file, session.files)) or None,
    )
    return as_json(section)


def _file(origin: Origin) -> SessionFile:
    own_us = origin.first_us - origin.moved_us
    return SessionFile(
        name=origin.name or "",
        start_time=iso_time(own_us, origin.offset_s) if origin.dated else None,
        samples=(origin.end_sample or 0) - origin.first_sample,
        problems=origin.problems,
        lost_bytes=origin.lost_bytes,
    )
