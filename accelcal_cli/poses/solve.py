"""Twelve parameters by linear least squares from known accelerations (Bragge et al., eq. 1-5).

z = K a + O is linear in K and O, and each axis of z has the same matrix [a 1]. The normal equations
are solved in exact fractions of the integer means, so that the parameters are the same bits on every
machine. Every orientation weighs the same, however many states it has.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import LIMIT, ONE, checked, to_fixed
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import Calibration
from accelcal_cli.core.poses import Pose

MODEL = "12"
UNKNOWNS = 4
"""For each axis: a row of K and an entry of O."""

_LOWER = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
_UPPER = ((0, 1), (0, 2), (1, 2))

Table = list[list[Fraction]]


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
    """Of each state, so that every orientation weighs 1."""
    states = Counter(pose.number for pose in poses)
    return [Fraction(1, states[pose.number]) for pose in poses]


def condition_number(poses: Sequence[Pose]) -> float:
    """Of the weighted matrix [a 1], a in g; infinite below rank 4. Six faces make it the root of 3."""
    if len(poses) < UNKNOWNS:
        return float("inf")
    rows = design(poses) * np.sqrt(np.array(weights(poses), np.float64))[:, np.newaxis]
    singular = np.linalg.svd(rows, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")


def design(poses: Sequence[Pose]) -> NDArray[np.float64]:
    """[a 1], (n, 4), in g."""
    references = np.array([pose.reference for pose in poses], np.float64).reshape(-1, 3) / ONE
    return np.hstack([references, np.ones((len(references), 1))])


def solve(poses: Sequence[Pose], gravity: Gravity) -> Solution:
    """K and O of the states, each with its known acceleration.

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
    found = eliminated(normal, right)
    k = tuple(tuple(found[column][axis] for column in range(3)) for axis in range(3))
    o = tuple(found[3])
    return Solution(k, o, _inverse(k, o, gravity))


def eliminated(matrix: Table, right: Table) -> Table:
    """X of matrix X = right by Gauss-Jordan elimination, exact.

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
    """a = K^-1 (z - O) as a = gain (v + offset)."""
    unity = [[Fraction(int(row == column)) for column in range(3)] for row in range(3)]
    try:
        gain = eliminated([list(row) for row in k], unity)
    except DivergedError as error:
        raise DivergedError(
            "K has no inverse: an axis does not follow the orientation",
            hint="check the sensor and the poses",
        ) from error
    lower = tuple(to_fixed(gain[row][column]) for row, column in _LOWER)
    upper = tuple(to_fixed(gain[row][column]) for row, column in _UPPER)
    offset = tuple(to_fixed(-value) for value in o)
    return Calibration(MODEL, (*lower, *offset, 0, 0, 0), None, gravity, (upper[0], upper[1], upper[2]))


def check_range(calibration: Calibration) -> None:
    """Raise FixedPointOverflowError where a parameter lies beyond 4; a fit that is refused may do so."""
    values = [min(max(value, -LIMIT), LIMIT) for value in calibration.parameters + calibration.upper]
    checked(np.array(values, np.int64), "a parameter")
