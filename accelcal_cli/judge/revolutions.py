"""The scale of a gyroscope from whole revolutions about the vertical, in a session of known orientations.

Ferraris, Grimaldi and Parvis (1995) turn a sensor by whole revolutions about each of its axes, which
stays upright: the integral of the rate is then a multiple of 360 degrees along gravity, whatever the
speed. Gravity, which does not move, says nothing of these turns, so they are apart from those that
`judge/gyroscope.py` fits. The turns from one face to another, which this fit does not use, judge it.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, degrees, fsum, radians, sqrt

import numpy as np

from accelcal_cli.core.arithmetic import inverse
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.gyroscope import Floats, Gyroscope, Turns
from accelcal_cli.core.reasons import Reason
from accelcal_cli.judge.gyroscope import (
    GRID,
    LEAST_SHARE,
    bias_on_grid,
    gravity_around,
    refused,
    rows_of,
    turn_errors,
    wide_turns,
)
from accelcal_cli.judge.turning import TurningGravity, raw_steps

WHOLE_DEG = 360.0
OFF_SHARE = 0.1
"""Share of a revolution by which the raw integral may be off: sensors are off by a few percent."""

SAME_DEG = 8.0
"""Largest angle [degrees] between gravity before and after a revolution."""

UPRIGHT_DEG = 15.0
"""Largest angle [degrees] between the axis of a revolution and gravity."""

LEAST_TURNS = 3
"""Fewest turns from face to face that judge the scale."""


def judge_revolutions(
    found: Turns, calibration: Calibration | None, least_range_c: float | None
) -> Gyroscope | None:
    """Return the verdict by whole revolutions; None if there are none about each axis.

    Args:
        calibration, least_range_c: see `judge_gyroscope`.
    """
    bias = bias_on_grid(found, least_range_c)
    if bias is None or calibration is None:
        return None
    integrals, wanted = _revolutions(found, calibration)
    if not len(integrals):
        return None
    unit = integrals / np.sqrt((integrals * integrals).sum(axis=1, keepdims=True))
    moments = sum(np.multiply.outer(one, one) for one in unit) / len(unit)
    if np.linalg.eigvalsh(moments)[0] < LEAST_SHARE:
        return None
    scale = _fitted(integrals, wanted)
    pairs = wide_turns(found, calibration)
    holdout = None
    if len(pairs.turns) >= LEAST_TURNS:
        gravity = TurningGravity(pairs.turns, pairs.before, found.dps_per_lsb)
        holdout = turn_errors(gravity.turned(np.eye(3)), gravity.turned(scale), pairs.after)
    values = {
        "revolutions": len(integrals),
        "turns": len(pairs.turns),
        "before_deg": None if holdout is None else holdout.before,
        "after_deg": None if holdout is None else holdout.after,
    }
    reason = Reason.of("gyroscope_by_revolutions", **values)
    known = replace(refused(reason, len(integrals), found, bias), holdout=holdout)
    if holdout is not None and holdout.mean_after > holdout.mean_before:
        return replace(known, reason=Reason.of("scale_no_better", before_deg=holdout.mean_before))
    return replace(known, outcome="calibrated", scale=rows_of(np.rint(scale * GRID) / GRID))


def _revolutions(found: Turns, calibration: Calibration) -> tuple[Floats, Floats]:
    """Return the integrals (n, 3) [degrees] of whole revolutions by the raw rate, and the true ones."""
    before, after = gravity_around(found, calibration)
    integrals, wanted = [], []
    for turn, start, end in zip(found.turns, before, after, strict=True):
        steps = raw_steps(turn, found.dps_per_lsb)
        integral = np.array([degrees(fsum(steps[:, axis].tolist())) for axis in range(3)])
        length, along = sqrt(float((integral * integral).sum())), float((integral * start).sum())
        whole = WHOLE_DEG * round(length / WHOLE_DEG)
        same = float((start * end).sum()) >= cos(radians(SAME_DEG))
        upright = abs(along) >= cos(radians(UPRIGHT_DEG)) * length
        if whole and same and upright and abs(length - whole) <= OFF_SHARE * whole:
            middle = start + end
            integrals.append(integral)
            upward = middle / sqrt(float((middle * middle).sum()))
            wanted.append((whole if along > 0 else -whole) * upward)
    return np.array(integrals).reshape(-1, 3), np.array(wanted).reshape(-1, 3)


def _fitted(integrals: Floats, wanted: Floats) -> Floats:
    """Return S of least squares: S times the integrals is what they should be."""
    both = sum(np.multiply.outer(one, other) for one, other in zip(wanted, integrals, strict=True))
    own = sum(np.multiply.outer(one, one) for one in integrals)
    inverted = inverse(np.asarray(own).tolist())
    return np.array(
        [
            [fsum(row[k] * inverted[k][column] for k in range(3)) for column in range(3)]
            for row in np.asarray(both).tolist()
        ]
    )
