"""How well twelve parameters are known: standard errors of a linear least-squares fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.poses import Floats3, Matrix3, Pose
from accelcal_cli.poses.solve import UNKNOWNS, Solution, design, weights

Real = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard errors.

    Attributes:
        k, o: of K and O in z = K a + O.
        parameters: of kxx .. oz, three slopes (0) and kyx, kzx, kzy.
        worst_direction_mg: of |a|, in the worst of 26 directions (faces, edges, corners of a cube).
    """

    k: Matrix3
    o: Floats3
    parameters: tuple[float, ...]
    worst_direction_mg: float


def uncertainty(poses: Sequence[Pose], solution: Solution) -> Uncertainty:
    """From the residuals of all axes together, with 3 (orientations - 4) degrees of freedom.

    The rows of K have independent errors with the covariance s^2 M, M = ([a 1]' W [a 1])^-1. With
    G = K^-1, an error dK of K is one of -G dK G of G.
    """
    rows, weight = design(poses), np.array(weights(poses), np.float64)
    inverse = np.asarray(np.linalg.inv(rows.T @ (rows * weight[:, np.newaxis])), np.float64)
    residual = raw_g(poses) - rows @ _parameters(solution)
    freedom = 3 * (weight.sum() - UNKNOWNS)
    variance = float((weight[:, np.newaxis] * residual**2).sum() / freedom)
    gain = solution.calibration.gain()
    scale = np.sqrt(variance * np.diag(inverse))
    k_errors = np.tile(scale[:3], (3, 1))
    lengths = (gain**2).sum(axis=1)[:, np.newaxis]
    across = np.einsum("ij,ik,kj->j", gain, inverse[:3, :3], gain)
    gain_errors = np.sqrt(variance * lengths * across)
    return Uncertainty(
        _matrix3(k_errors),
        (float(scale[3]),) * 3,
        _named(gain_errors, float(scale[3])),
        _worst_direction(gain, inverse, variance),
    )


def raw_g(poses: Sequence[Pose]) -> Real:
    """Raw means, (n, 3) in g."""
    return np.array([pose.state.raw for pose in poses], np.float64).reshape(-1, 3) / ONE


def _parameters(solution: Solution) -> Real:
    """K transposed above O, (4, 3)."""
    columns = [[float(solution.k[axis][column]) for axis in range(3)] for column in range(3)]
    return np.array([*columns, [float(value) for value in solution.o]])


def _matrix3(values: Real) -> Matrix3:
    first, second, third = ((float(row[0]), float(row[1]), float(row[2])) for row in values)
    return first, second, third


def _named(gain: Real, offset: float) -> tuple[float, ...]:
    lower = [gain[place] for place in ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))]
    upper = [gain[place] for place in ((0, 1), (0, 2), (1, 2))]
    return tuple(map(float, (*lower, *(offset,) * 3, 0.0, 0.0, 0.0, *upper)))


def _worst_direction(gain: Real, inverse: Real, variance: float) -> float:
    """At a, z is known to s^2 [a 1] M [a 1]' on each axis, and |a| to that times |a' G|^2."""
    cube = np.array([place for place in product((-1.0, 0.0, 1.0), repeat=3) if any(place)])
    a = cube / np.sqrt((cube**2).sum(axis=1, keepdims=True))
    rows = np.hstack([a, np.ones((len(a), 1))])
    shown = np.einsum("ni,ij,nj->n", rows, inverse, rows)
    along = ((a @ gain) ** 2).sum(axis=1)
    return float(1000 * np.sqrt(variance * (shown * along).max()))
