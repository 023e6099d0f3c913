"""The Cramer-Rao bound: how well nine parameters can be known at best.

The true orientation of each point is unknown too. Eliminating it leaves one equation for a point,
|K (v + o)|^2 - 1 = 0, whose left side has variance |2 K^T a|^2 sigma^2 under noise sigma on each axis
of v. Its derivatives, divided by that standard deviation, give the Fisher information.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.judge.uncertainty import jacobian

MEAN_OF_ABSOLUTE = float(np.sqrt(2 / np.pi))
"""Mean |x| of a normal distribution with standard deviation 1."""

Real = NDArray[np.float64]


def fisher_information(still_g: Real, truth: tuple[int, ...], noise_g: float) -> Real:
    """Information (9, 9) that points at (n, 3) carry on a sensor's nine parameters."""
    rows = jacobian(still_g, None, truth)[:, :9]
    spread = noise_g * np.linalg.norm(rows[:, 6:], axis=1, keepdims=True)
    return np.asarray((rows / spread).T @ (rows / spread))


def expected_errors(still_g: Real, truth: tuple[int, ...], noise_g: float) -> Real:
    """Least mean |error| (9,) of an unbiased estimate, were its errors normal."""
    covariance = np.linalg.inv(fisher_information(still_g, truth, noise_g))
    return np.asarray(MEAN_OF_ABSOLUTE * np.sqrt(np.diag(covariance)))
