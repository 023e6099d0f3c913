"""Errors of the states: by the fit of all, and by fits that have not seen their orientation.

Differences are exact integers before they become lengths, so that the figures are the same bits on
every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import acos, degrees, fsum, sqrt

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import Calibration
from accelcal_cli.core.poses import Floats3, Integers3, Pose, PoseError, State
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.poses.solve import condition_number, solve


def calibrated(raw: Integers3, calibration: Calibration) -> Floats3:
    """a = K (v + o) of a fixed-point mean [g]: exact until the last division."""
    p = calibration.parameters
    yx, zx, zy = calibration.upper
    rows = ((p[0], yx, zx), (p[3], p[1], zy), (p[4], p[5], p[2]))
    shifted = [value + offset for value, offset in zip(raw, p[6:9], strict=True)]
    x, y, z = (sum(k * v for k, v in zip(row, shifted, strict=True)) / ONE**2 for row in rows)
    return x, y, z


def pose_errors(
    poses: Sequence[Pose], calibration: Calibration, settings: PoseSettings
) -> tuple[PoseError, ...]:
    """Errors of each state; `calibration` is the fit of all."""
    unseen = held_out(poses, settings)
    estimates = [calibrated(pose.state.raw, calibration) for pose in poses]
    return tuple(
        _errors(pose, estimate, unseen[pose.number], _centre(poses, estimates, pose.number))
        for pose, estimate in zip(poses, estimates, strict=True)
    )


def held_out(poses: Sequence[Pose], settings: PoseSettings) -> dict[int, Calibration | None]:
    """For each orientation the calibration by the others; None where they do not determine one."""
    found: dict[int, Calibration | None] = {}
    for number in sorted({pose.number for pose in poses}):
        others = [pose for pose in poses if pose.number != number]
        enough = condition_number(others) <= settings.max_condition
        found[number] = solve(others, settings.gravity).calibration if enough else None
    return found


def between_norm_mg(states: Sequence[State], calibration: Calibration, gravity: Gravity) -> float | None:
    """Mean | |a| - local g | of states that were not fitted, None without any."""
    local_g = float(gravity.local_g())
    errors = [abs(_length(calibrated(state.raw, calibration)) - local_g) * 1000 for state in states]
    return fsum(errors) / len(errors) if errors else None


def _errors(pose: Pose, estimate: Floats3, unseen: Calibration | None, centre: Floats3 | None) -> PoseError:
    raw, reference = _in_g(pose.state.raw), _in_g(pose.reference)
    guess = None if unseen is None else calibrated(pose.state.raw, unseen)
    return PoseError(
        raw=_distance(raw, reference),
        raw_norm=_norm_error(raw, reference),
        residual=_distance(estimate, reference),
        norm=_norm_error(estimate, reference),
        held_out=None if guess is None else _distance(guess, reference),
        held_out_norm=None if guess is None else _norm_error(guess, reference),
        tilt_degrees=None if guess is None else _angle(guess, reference),
        repeat=None if centre is None else _distance(estimate, centre),
    )


def _centre(poses: Sequence[Pose], estimates: Sequence[Floats3], number: int) -> Floats3 | None:
    """Mean of an orientation's states, None for a single one."""
    own = [estimate for pose, estimate in zip(poses, estimates, strict=True) if pose.number == number]
    if len(own) < 2:
        return None
    x, y, z = (fsum(values) / len(own) for values in zip(*own, strict=True))
    return x, y, z


def _in_g(values: Integers3) -> Floats3:
    return values[0] / ONE, values[1] / ONE, values[2] / ONE


def _length(a: Floats3) -> float:
    return sqrt(fsum(value * value for value in a))


def _distance(a: Floats3, b: Floats3) -> float:
    return 1000 * sqrt(fsum((left - right) ** 2 for left, right in zip(a, b, strict=True)))


def _norm_error(a: Floats3, b: Floats3) -> float:
    return 1000 * abs(_length(a) - _length(b))


def _angle(a: Floats3, b: Floats3) -> float:
    cosine = fsum(left * right for left, right in zip(a, b, strict=True)) / (_length(a) * _length(b))
    return degrees(acos(max(-1.0, min(1.0, cosine))))
