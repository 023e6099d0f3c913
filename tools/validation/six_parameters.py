"""Autocalibration with six parameters, written from van Hees et al. 2014, J Appl Physiol 117, 738-744.

Scale and offset of each axis, and the change of the offset with temperature where there is a thermometer:
windows of 10 s with a standard deviation below 13 mg on all axes; each mean is drawn to the nearest point of
the unit sphere by a weighted linear regression on each axis, again and again, with weights that fall with the
distance from the sphere. It is used if the means reach beyond 0.3 g on both sides of each axis and end
within 10 mg of the sphere on average.
"""

from __future__ import annotations

import numpy as np

from tools.validation.found import Found
from tools.validation.samples import Piece, Real, Rests, rests

REACH_G = 0.3
ACCEPTED_G = 0.010
ROUNDS = 1000
SMALL = 1e-10
NEAR_G = 0.01
"""Means nearer to the sphere than this have the same weight."""


def autocalibrated(piece: Piece) -> Found | None:
    """Return the calibration of a recording, or None if the rule does not accept one."""
    return fitted(rests(piece))


def fitted(still: Rests) -> Found | None:
    """Return the calibration of windows at rest, or None if the rule does not accept one."""
    if len(still.mean) < 10 or not populated(still.mean):
        return None
    found = closest_points(still)
    return found if found.error_g(still) < ACCEPTED_G else None


def populated(mean: Real) -> bool:
    """Return whether the means reach beyond 0.3 g on both sides of each axis."""
    return bool((mean.min(axis=0) < -REACH_G).all() and (mean.max(axis=0) > REACH_G).all())


def closest_points(still: Rests) -> Found:
    """Draw the means to the sphere until the error no longer changes."""
    warmth = np.zeros(len(still.mean)) if still.celsius is None else still.celsius
    middle = float(warmth.mean())
    scale, offset, slope = np.ones(3), np.zeros(3), np.zeros(3)
    weight, last = np.ones(len(still.mean)), np.inf
    for _ in range(ROUNDS):
        here = still.mean * scale + offset + np.outer(warmth - middle, slope)
        target = here / np.sqrt((here**2).sum(axis=1, keepdims=True))
        for axis in range(3):
            shift, stretch, warmer = _line(here[:, axis], warmth - middle, target[:, axis], weight)
            scale[axis] *= stretch
            offset[axis] = offset[axis] * stretch + shift
            slope[axis] = slope[axis] * stretch + warmer
        distance = np.sqrt(((here - target) ** 2).sum(axis=1))
        error = float((weight * distance**2).sum() / weight.sum())
        if abs(error - last) < SMALL:
            break
        weight, last = 1 / np.maximum(distance, NEAR_G), error
    return Found(np.diag(scale), offset - slope * middle, slope)


def _line(here: Real, warmth: Real, target: Real, weight: Real) -> tuple[float, float, float]:
    """Return intercept, slope, and slope with temperature of a weighted regression."""
    columns = [np.ones(len(here)), here, *([warmth] if np.ptp(warmth) > 0 else [])]
    root = np.sqrt(weight)
    solved = np.linalg.lstsq(np.stack(columns, axis=1) * root[:, np.newaxis], target * root, rcond=None)[0]
    return float(solved[0]), float(solved[1]), float(solved[2]) if len(solved) > 2 else 0.0
