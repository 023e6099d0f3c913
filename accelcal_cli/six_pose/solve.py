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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from math import acos, degrees, fsum, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import LIMIT, ONE, checked, three, to_fixed
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.errors import DivergedError, counted
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.six_pose.poses import (
    LISTED,
    Floats3,
    Integers3,
    Matrix3,
    Pose,
    PoseError,
    Session,
    SixPoseFit,
    StillState,
    Uncertainty,
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
