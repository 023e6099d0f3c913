"""Solves for twelve parameters from the states of a session, by least squares (Bragge et al., eq. 1-5).

z = K a + O is linear in K and O, and each axis of z has the same matrix [a 1]. The normal equations are
solved in exact fractions of the integer means, so that the parameters are the same bits on every machine.
Every orientation weighs the same, however many states it has.

The errors of the states are given for the fit of all, and for fits that have not seen their orientation.
Differences are exact integers before they become lengths, so that the figures, too, are the same bits on
every machine. Standard errors are those of a linear least-squares fit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from math import acos, degrees, fsum, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import LIMIT, ONE, checked, mean, three, to_fixed, to_float
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.declared import as_json
from accelcal_cli.core.errors import DivergedError, Reason, counted
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import WEIGHT_ONE, Fit, Operations, PointSet
from accelcal_cli.core.results import Coverage, FitErrors, Holdout, Judgement, Outcome, Trial
from accelcal_cli.core.settings import PoseSettings
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
from accelcal_cli.six_pose.poses import (
    LENGTH_TOLERANCE,
    LISTED,
    Floats3,
    Integers3,
    Matrix3,
    Origin,
    Pose,
    PoseError,
    Session,
    SixPoseFit,
    StillState,
    Uncertainty,
    VectorErrors,
)

MODEL = "12"
UNKNOWNS = 4
"""Number of unknowns of each axis: a row of K and an entry of O."""

FEWEST = 4
"""Smallest number of poses (N of Bragge et al.); fewer give fewer equations than unknowns."""

FEWEST_CHECKED = 2
"""Smallest number of errors whose mean has a confidence interval."""

_LONGER = "rest the device on every face for 10 s, or list the poses with --poses"
_MORE = "list more poses, in other directions"
_UNCHECKED = "or fit them without any check, with --unchecked"
_LOWER = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
_UPPER = ((0, 1), (0, 2), (1, 2))

Table = list[list[Fraction]]
Real = NDArray[np.float64]


def six_pose_fit(session: Session, settings: PoseSettings) -> SixPoseFit:
    """Solve and measure the errors.

    Raises:
        DivergedError: the poses do not determine the parameters, or leave none to judge them by.
    """
    condition = condition_number(session.poses)
    _require(session, condition, settings)
    solution = solve(session.poses, settings.gravity)
    errors = pose_errors(session.poses, solution.calibration, settings)
    pairs = zip(session.poses, errors, strict=True)
    checked = len({pose.number for pose, error in pairs if error.held_out is not None}) >= FEWEST_CHECKED
    if not checked and not settings.unchecked:
        found = f"only {counted(session.orientations, 'pose')} found{_which(session)}"
        hint = f"{_missing(session)}{_way(session)}, {_UNCHECKED}"
        raise DivergedError(f"{found}: enough for a fit, but not to check it", hint=hint)
    surplus = session.orientations > UNKNOWNS
    return SixPoseFit(
        calibration=solution.calibration,
        k=_matrix3(solution.k),
        o=three(map(float, solution.o)),
        precision=uncertainty(session.poses, solution) if surplus else None,
        condition_number=condition,
        errors=errors,
        between_norm_mg=between_norm_mg(session.between, solution.calibration, settings.gravity),
        checked=checked,
    )


def _require(session: Session, condition: float, settings: PoseSettings) -> None:
    """Raise DivergedError unless the matrix [a 1] of the poses has rank 4, and well so."""
    if not session.poses:
        others = [(len(session.between), "lie between faces"), (session.short, "are too short")]
        elsewhere = " and ".join(f"{number} {what}" for number, what in others if number)
        near = f"no still state lies within {settings.face_degrees:g} degrees of a face"
        raise DivergedError(f"{near}; {elsewhere}" if elsewhere else near, hint=_LONGER)
    number, limit = session.orientations, settings.max_condition
    if number >= FEWEST and condition <= limit:
        return
    text = f"the poses{_which(session)} do not determine twelve parameters: the condition number of [a 1] is "
    text += f"{condition:.3g}, the limit {limit:g}"
    if number < FEWEST:
        text = f"only {counted(number, 'pose')} found{_which(session)}"
        text += f", and at least {FEWEST if settings.unchecked else FEWEST + 1} are needed"
    raise DivergedError(text, hint=f"{_missing(session)}{_way(session)}")


def _way(session: Session) -> str:
    """Return advice on too few poses."""
    return _MORE if any(pose.face == LISTED for pose in session.poses) else _LONGER


def _which(session: Session) -> str:
    return f" ({', '.join(sorted({pose.face for pose in session.poses}))})"


def _missing(session: Session) -> str:
    """Return the missing faces for a hint; they are tolerable while the others determine all parameters."""
    return f"missing: {', '.join(session.missing)}; " if session.missing else ""


@dataclass(frozen=True, slots=True)
class Solution:
    """z = K a + O in exact fractions, and its inverse a = gain (v + offset) in fixed point.

    Attributes:
        k: rows of K, raw g per g.
        o: O, raw g.
    """

    k: tuple[tuple[Fraction, ...], ...]
    o: tuple[Fraction, ...]
    calibration: Calibration


def weights(poses: Sequence[Pose]) -> list[Fraction]:
    """Return the weight of each state; every orientation weighs 1."""
    states = Counter(pose.number for pose in poses)
    return [Fraction(1, states[pose.number]) for pose in poses]


def condition_number(poses: Sequence[Pose]) -> float:
    """Return the condition number of the weighted matrix [a 1], a in g; infinite below rank 4.

    Six faces make it the root of 3.
    """
    if len(poses) < UNKNOWNS:
        return float("inf")
    rows = design(poses) * np.sqrt(np.array(weights(poses), np.float64))[:, np.newaxis]
    singular = np.linalg.svd(rows, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")


def design(poses: Sequence[Pose]) -> NDArray[np.float64]:
    """Return [a 1], (n, 4), in g."""
    references = np.array([pose.reference for pose in poses], np.float64).reshape(-1, 3) / ONE
    return np.hstack([references, np.ones((len(references), 1))])


def solve(poses: Sequence[Pose], gravity: Gravity) -> Solution:
    """Solve for K and O from states, each with its known acceleration.

    Raises:
        DivergedError: the states do not determine them, or K has no inverse.
    """
    normal = [[Fraction(0)] * UNKNOWNS for _ in range(UNKNOWNS)]
    right = [[Fraction(0)] * 3 for _ in range(UNKNOWNS)]
    for pose, weight in zip(poses, weights(poses), strict=True):
        row = (*pose.reference, ONE)
        for i in range(UNKNOWNS):
            for j in range(UNKNOWNS):
                normal[i][j] += weight * row[i] * row[j]
            for axis in range(3):
                right[i][axis] += weight * row[i] * pose.state.raw[axis]
    solution = eliminated(normal, right)
    k = tuple(tuple(solution[column][axis] for column in range(3)) for axis in range(3))
    o = tuple(solution[3])
    return Solution(k, o, _inverse(k, o, gravity))


def eliminated(matrix: Table, right: Table) -> Table:
    """Return X of matrix X = right, exactly, by Gauss-Jordan elimination.

    Raises:
        DivergedError: the matrix is singular.
    """
    size = len(matrix)
    rows = [[*left, *more] for left, more in zip(matrix, right, strict=True)]
    for step in range(size):
        pivot = next((row for row in range(step, size) if rows[row][step]), None)
        if pivot is None:
            raise DivergedError("the poses do not determine the parameters")
        rows[step], rows[pivot] = rows[pivot], rows[step]
        rows[step] = [value / rows[step][step] for value in rows[step]]
        for row in range(size):
            factor = rows[row][step]
            if row != step and factor:
                rows[row] = [a - factor * b for a, b in zip(rows[row], rows[step], strict=True)]
    return [row[size:] for row in rows]


def _inverse(k: Sequence[Sequence[Fraction]], o: Sequence[Fraction], gravity: Gravity) -> Calibration:
    """Return a = K^-1 (z - O) in the form a = gain (v + offset)."""
    unity = [[Fraction(int(row == column)) for column in range(3)] for row in range(3)]
    try:
        gain = eliminated([list(row) for row in k], unity)
    except DivergedError as error:
        text = "K has no inverse: an axis does not follow the orientation"
        raise DivergedError(text, hint="check the sensor and the poses") from error
    lower = tuple(to_fixed(gain[row][column]) for row, column in _LOWER)
    upper = tuple(to_fixed(gain[row][column]) for row, column in _UPPER)
    offset = tuple(to_fixed(-value) for value in o)
    return Calibration(MODEL, (*lower, *offset, 0, 0, 0), None, gravity, (upper[0], upper[1], upper[2]))


def check_range(calibration: Calibration) -> None:
    """Raise FixedPointOverflowError if a parameter lies beyond 4; only a refused fit may exceed that."""
    values = [min(max(value, -LIMIT), LIMIT) for value in calibration.parameters + calibration.upper]
    checked(np.array(values, np.int64), "a parameter")


def calibrated(raw: Integers3, calibration: Calibration) -> Floats3:
    """Return a = K (v + o) of a fixed-point mean [g], exact until the last division."""
    shifted = [value + offset for value, offset in zip(raw, calibration.parameters[6:9], strict=True)]
    rows = fixed_gain(calibration)
    return three(sum(k * v for k, v in zip(row, shifted, strict=True)) / ONE**2 for row in rows)


def fixed_gain(calibration: Calibration) -> tuple[Integers3, Integers3, Integers3]:
    """Return the rows of K in fixed point."""
    p, (yx, zx, zy) = calibration.parameters, calibration.upper
    return (p[0], yx, zx), (p[3], p[1], zy), (p[4], p[5], p[2])


def pose_errors(
    poses: Sequence[Pose], calibration: Calibration, settings: PoseSettings
) -> tuple[PoseError, ...]:
    """Return the errors of each state; `calibration` is the fit of all."""
    unseen = held_out(poses, settings)
    estimates = [calibrated(pose.state.raw, calibration) for pose in poses]
    return tuple(
        _errors(pose, estimate, unseen[pose.number], _centre(poses, estimates, pose.number))
        for pose, estimate in zip(poses, estimates, strict=True)
    )


def held_out(poses: Sequence[Pose], settings: PoseSettings) -> dict[int, Calibration | None]:
    """Return for each orientation the calibration by the others; None if they do not determine one."""
    fits: dict[int, Calibration | None] = {}
    for number in sorted({pose.number for pose in poses}):
        others = [pose for pose in poses if pose.number != number]
        enough = condition_number(others) <= settings.max_condition
        fits[number] = solve(others, settings.gravity).calibration if enough else None
    return fits


def between_norm_mg(states: Sequence[StillState], calibration: Calibration, gravity: Gravity) -> float | None:
    """Return the mean | |a| - local g | of states that were not fitted; None without any."""
    local_g = float(gravity.local_g())
    errors = [abs(_length(calibrated(state.raw, calibration)) - local_g) * 1000 for state in states]
    return fsum(errors) / len(errors) if errors else None


def _errors(pose: Pose, estimate: Floats3, unseen: Calibration | None, centre: Floats3 | None) -> PoseError:
    raw, reference = _in_g(pose.state.raw), _in_g(pose.reference)
    held_out = norm = tilt = None
    if unseen is not None:
        guess = calibrated(pose.state.raw, unseen)
        held_out, norm = _distance(guess, reference), _norm_error(guess, reference)
        dot = fsum(left * right for left, right in zip(guess, reference, strict=True))
        tilt = degrees(acos(max(-1.0, min(1.0, dot / (_length(guess) * _length(reference))))))
    return PoseError(
        raw=_distance(raw, reference),
        raw_norm=_norm_error(raw, reference),
        residual=_distance(estimate, reference),
        norm=_norm_error(estimate, reference),
        held_out=held_out,
        held_out_norm=norm,
        tilt_degrees=tilt,
        repeat=None if centre is None else _distance(estimate, centre),
    )


def _centre(poses: Sequence[Pose], estimates: Sequence[Floats3], number: int) -> Floats3 | None:
    """Return the mean of an orientation's states; None for a single one."""
    own = [estimate for pose, estimate in zip(poses, estimates, strict=True) if pose.number == number]
    if len(own) < 2:
        return None
    return three(fsum(values) / len(own) for values in zip(*own, strict=True))


def _in_g(values: Integers3) -> Floats3:
    return values[0] / ONE, values[1] / ONE, values[2] / ONE


def _length(a: Floats3) -> float:
    return sqrt(fsum(value * value for value in a))


def _distance(a: Floats3, b: Floats3) -> float:
    return 1000 * sqrt(fsum((left - right) ** 2 for left, right in zip(a, b, strict=True)))


def _norm_error(a: Floats3, b: Floats3) -> float:
    return 1000 * abs(_length(a) - _length(b))


def uncertainty(poses: Sequence[Pose], solution: Solution) -> Uncertainty:
    """Return standard errors by the residuals of all axes, with 3 (orientations - 4) degrees of freedom.

    The rows of K have independent errors with the covariance s^2 M, M = ([a 1]' W [a 1])^-1. With
    G = K^-1, an error dK of K is one of -G dK G of G.
    """
    rows, weight = design(poses), np.array(weights(poses), np.float64)
    inverse = np.asarray(np.linalg.inv(rows.T @ (rows * weight[:, np.newaxis])), np.float64)
    raw = np.array([pose.state.raw for pose in poses], np.float64).reshape(-1, 3) / ONE
    # K transposed above O, (4, 3)
    columns = [[float(solution.k[axis][column]) for axis in range(3)] for column in range(3)]
    residual = raw - rows @ np.array([*columns, [float(value) for value in solution.o]])
    freedom = 3 * (weight.sum() - UNKNOWNS)
    variance = float((weight[:, np.newaxis] * residual**2).sum() / freedom)
    gain = solution.calibration.gain()
    scale = np.sqrt(variance * np.diag(inverse))
    k_errors = np.tile(scale[:3], (3, 1))
    lengths = (gain**2).sum(axis=1)[:, np.newaxis]
    across = np.einsum("ij,ik,kj->j", gain, inverse[:3, :3], gain)
    gain_errors = np.sqrt(variance * lengths * across)
    lower, upper = ([gain_errors[place] for place in places] for places in (_LOWER, _UPPER))
    parameters = (*lower, *(scale[3],) * 3, 0.0, 0.0, 0.0, *upper)
    return Uncertainty(
        _matrix3(k_errors),
        (float(scale[3]),) * 3,
        tuple(map(float, parameters)),
        _worst_direction(gain, inverse, variance),
    )


def _matrix3(rows: Iterable[Any]) -> Matrix3:
    return three(three(map(float, row)) for row in rows)


def _worst_direction(gain: Real, inverse: Real, variance: float) -> float:
    """Return the largest standard error of |a| [mg] over the directions of a cube.

    At a, z is known to s^2 [a 1] M [a 1]' on each axis, and |a| to that times |a' G|^2.
    """
    cube = np.array([place for place in product((-1.0, 0.0, 1.0), repeat=3) if any(place)])
    a = cube / np.sqrt((cube**2).sum(axis=1, keepdims=True))
    rows = np.hstack([a, np.ones((len(a), 1))])
    shown = np.einsum("ni,ij,nj->n", rows, inverse, rows)
    along = ((a @ gain) ** 2).sum(axis=1)
    return float(1000 * np.sqrt(variance * (shown * along).max()))


# The verdict on a calibration from known orientations, and its sections of the report.
#
# Orientations that the fit has not seen judge it. The report gives the model in its authors'
# convention.

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
        return Decision(Outcome.REFUSED, why, (_way_on(session, settings),))
    if after >= before:
        return Decision(Outcome.ALREADY_GOOD, Reason.of("poses_no_better", **values))
    # the orientations without which there is no fit, so that nothing checks them
    pairs = zip(session.poses, fit.errors, strict=True)
    faces = sorted({str(pose.face) for pose, error in pairs if error.held_out is None})
    why = Reason.of("poses_calibrated", **values, unchecked=faces, missing=session.missing if faces else ())
    return Decision(Outcome.CALIBRATED, why)


def _way_on(session: Session, settings: PoseSettings) -> Reason:
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
    pairs = tuple(zip(norm_before, norm_after, strict=True))
    raw = of_postures(METHOD, len(known), tuple((one, one) for one in norm_before), tuple(enumerate(before)))
    norms = of_postures(METHOD, len(known), pairs, tuple(enumerate(after)))
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
