"""Held-out error: what the calibration does to postures that it has not seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.judgement import Holdout
from accelcal_cli.core.points import IDENTITY, Fit, Model, PointSet
from accelcal_cli.judge.errors import deviations_mg, interval95, per_posture, summary
from accelcal_cli.judge.postures import folds

FitFunction = Callable[[PointSet, Model], Fit]


def blocked(
    points: PointSet, label: NDArray[np.int64], model: Model, fit: FitFunction, number: int
) -> Holdout:
    """Folds of whole postures; each is judged by a fit of the others.

    A random hold-out would leave neighbours of every held-out point in the fit and hide failure.
    """
    fold = folds(label, number)
    before: dict[int, float] = {}
    after: dict[int, float] = {}
    for held in np.unique(fold).tolist():
        seen, unseen = points.select(fold != held), points.select(fold == held)
        where, weights = label[fold == held], unseen.weights
        found = fit(seen, model).parameters
        before |= per_posture(deviations_mg(unseen, IDENTITY), weights, where)
        after |= per_posture(deviations_mg(unseen, found), weights, where)
    pairs = tuple((before[key], after[key]) for key in sorted(before))
    method = f"{number} folds of whole postures"
    return _holdout(method, len(points), pairs)


def control(points: PointSet, parameters: tuple[int, ...]) -> Holdout:
    """F's second set of points, none of which was fitted (eq. 21); every point is a posture."""
    before = deviations_mg(points, IDENTITY).tolist()
    after = deviations_mg(points, parameters).tolist()
    return _holdout("control points (second set)", len(points), tuple(zip(before, after, strict=True)))


def _holdout(method: str, number: int, pairs: tuple[tuple[float, float], ...]) -> Holdout:
    before, after = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    return Holdout(method, number, len(pairs), summary(before), summary(after), interval95(after), pairs)
