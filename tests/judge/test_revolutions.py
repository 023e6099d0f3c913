"""Whole revolutions by `judge/gyroscope.py`: a known scale is found, and what is none is left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from accelcal_cli.core.gyroscope import Turn, Turns
from accelcal_cli.judge.gyroscope import judge_revolutions
from tests.judge.test_gyroscope import BIAS, LSB, PERFECT, PERIOD_US, SCALE, made, rest


def revolution(axis: int, degrees: float, sample: int) -> Turn:
    """A turn about one axis that is upright, at an uneven speed, as a gyroscope of SCALE measures it."""
    up = np.eye(3)[axis] * (-1 if axis == 1 else 1)
    shape = np.sin(np.linspace(0, np.pi, 402))[1:-1]
    true_dps = np.multiply.outer(shape / shape.sum() * degrees / (PERIOD_US / 1e6), up)
    counts = np.rint(np.linalg.solve(SCALE, true_dps.T).T * LSB).astype(np.int32) + np.array(BIAS, np.int32)
    return Turn(rest(up, sample), rest(up, sample + 900), counts, PERIOD_US)


def session(*angles: float) -> Turns:
    """Revolutions about x, y and z, and twelve turns from one orientation to another."""
    turns = tuple(revolution(number % 3, angle, 10_000 * number) for number, angle in enumerate(angles))
    return replace(made(12), turns=(*turns, *made(12).turns))


def test_three_revolutions_give_scale_and_misalignment() -> None:
    found = judge_revolutions(session(360, -360, 720), PERFECT, None)
    assert found is not None and found.outcome == "calibrated"
    np.testing.assert_allclose(found.scale, SCALE, atol=1e-4)
    assert found.pairs == 3 and found.reason.values["turns"] == 12
    assert found.holdout is not None
    assert found.holdout.after < 0.02
    assert found.holdout.before > 1
    assert found.bias is not None and found.bias.dps == tuple(one / LSB for one in BIAS)


def test_turns_that_are_no_revolutions_about_three_axes_say_nothing() -> None:
    assert judge_revolutions(session(360, -360), PERFECT, None) is None
    assert judge_revolutions(session(360, -360, 270), PERFECT, None) is None
    assert judge_revolutions(session(360, -360, 360), None, None) is None
    assert judge_revolutions(made(12), PERFECT, None) is None
