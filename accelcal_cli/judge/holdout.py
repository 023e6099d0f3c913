"""Held-out error: what the calibration does to postures that it has not seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.judgement import Holdout
from accelcal_cli.core.points import IDENTITY, Fit, Model, PointSet
from accelcal_cli.judge.errors import deviations_mg, interval95, per_posture, summary
from accelcal_cli.judge.postures import folds

FitFunction = Callable[[PointSet, Model], Fit]


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


def blocked(sample: Sample, model: Model, fit: FitFunction, number: int) -> Holdout:
    """Folds of whole postures; each is judged by a fit of the others.

    A random hold-out would leave neighbours of every held-out point in the fit and hide failure.
    """
    points, label = sample.points, sample.label
    fold = folds(label, number)
    blocks: dict[int, float] = {}
    before: dict[int, float] = {}
    after: dict[int, float] = {}
    for held in sorted(set(fold.tolist())):
        seen, unseen = points.select(fold != held), points.select(fold == held)
        where, weights, block = label[fold == held], unseen.weights, sample.block[fold == held]
        found = fit(seen, model).parameters
        before |= per_posture(deviations_mg(unseen, IDENTITY), weights, where)
        left = deviations_mg(unseen, found)
        after |= per_posture(left, weights, where)
        blocks |= per_posture(left, weights, block)
    pairs = tuple((before[key], after[key]) for key in sorted(before))
    method = f"{number} folds of whole postures"
    posture = dict(zip(sample.block.tolist(), label.tolist(), strict=True))
    compared = tuple((posture[key], blocks[key]) for key in sorted(blocks))
    return of_postures(method, len(points), pairs, compared)


def control(points: PointSet, parameters: tuple[int, ...]) -> Holdout:
    """F's second set of points, none of which was fitted (eq. 21); every point is a posture."""
    before = deviations_mg(points, IDENTITY).tolist()
    after = deviations_mg(points, parameters).tolist()
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
    errors = (summary(before), summary(after), interval95(after))
    return Holdout(method, number, len(pairs), *errors, pairs, blocks)
