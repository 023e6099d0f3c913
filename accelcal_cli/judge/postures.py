"""Grouping points into postures, and postures into folds, exact in integers."""

from __future__ import annotations

from math import cos, radians

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import FRACTION_BITS, ONE
from accelcal_cli.core.points import PointSet

_COARSE_BITS = 12


def postures(points: PointSet, degrees: float) -> NDArray[np.int64]:
    """Posture number of each point, (n,), numbered from 0 by first point.

    Points are taken by falling number of windows (then in their order); each joins the nearest
    posture within so many degrees of its first point, or begins one.
    """
    limit = round(4096 * cos(radians(degrees)) ** 2)
    coarse = points.xyz >> (FRACTION_BITS - _COARSE_BITS)
    norms = np.maximum(1, (coarse * coarse).sum(axis=1))
    label = np.full(len(points), -1, np.int64)
    leaders: list[int] = []
    for index in np.lexsort((np.arange(len(points)), -points.windows)).tolist():
        label[index] = _nearest(coarse, norms, leaders, index, limit)
        if label[index] < 0:
            label[index] = len(leaders)
            leaders.append(index)
    return label


def _nearest(
    coarse: NDArray[np.int64], norms: NDArray[np.int64], leaders: list[int], index: int, limit: int
) -> int:
    """The leader with the smallest angle to a point if cos^2 reaches the limit / 4096, or -1."""
    if not leaders:
        return -1
    dots = coarse[leaders] @ coarse[index]
    near = (dots > 0) & (dots * dots // norms[leaders] * 4096 >= limit * norms[index])
    if not near.any():
        return -1
    closeness = np.where(near, dots * dots // norms[leaders], -1)
    return int(closeness.argmax())


def temperature_blocks(points: PointSet, label: NDArray[np.int64], width_c: float) -> NDArray[np.int64]:
    """Number of each point's block, (n,): its posture within `width_c` degrees C, posture by posture.

    Without temperatures a block is a posture.
    """
    if points.tau is None or points.temperature is None:
        return label
    scale = points.temperature
    milli = scale.reference_mc * ONE + points.tau * round(1000 * scale.span_c)
    band = milli // (round(1000 * width_c) * ONE)
    return np.unique(np.stack([label, band], axis=1), axis=0, return_inverse=True)[1].reshape(-1)


def folds(label: NDArray[np.int64], number: int) -> NDArray[np.int64]:
    """Fold of each point: postures are dealt out in turn, so that none is split."""
    return label % number
