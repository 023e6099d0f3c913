"""The calibration model and its cost in 32-bit fixed point, over all points at once.

Values have 29 fraction bits in 32 (core.fixed); products have 58 in 64. Sums of products are
kept exact or are given head room for 8192 points. Every narrowing is checked, nothing wraps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from accelcal_cli.core.errors import FixedPointOverflowError
from accelcal_cli.core.fixed import FRACTION_BITS, ONE, Fixed, checked, narrow, rounded_quotient
from accelcal_cli.core.points import WEIGHT_ONE, Operations, PointSet

VALUE_LIMIT = 2 * ONE
RESIDUAL_LIMIT = ONE
MAX_POINTS = 8192
_LOW_HALF = (1 << FRACTION_BITS) - 1
_WEIGHT_BITS = WEIGHT_ONE.bit_length() - 1
_HEAD_ROOM_BITS = 10
_ROWS = [0, 1, 2, 1, 2, 2]
_COLUMNS = [0, 1, 2, 0, 0, 1]
"""Of the entries of K, in the order of the parameters."""


class Tally:
    """Counts the additions and multiplications of scalars that the arithmetic performs."""

    def __init__(self) -> None:
        self.additions = 0
        self.multiplications = 0

    def count(self, additions: int, multiplications: int, times: int = 1) -> None:
        """Add `times` repetitions of so many operations."""
        self.additions += additions * times
        self.multiplications += multiplications * times

    def total(self) -> Operations:
        """What was counted so far."""
        return Operations(self.additions, self.multiplications)


@dataclass(frozen=True, slots=True)
class State:
    """The model at one set of parameters: u = v + o + s tau, a = K u, r = |a|^2 - 1.

    Attributes:
        shifted, calibrated: u and a, (3, n) or (3, k, n).
        residual: (n,) or (k, n).
    """

    shifted: Fixed
    calibrated: Fixed
    residual: Fixed


def evaluate(points: PointSet, parameters: Fixed, tally: Tally) -> State:
    """Apply (12,) or (k, 12) parameters to n points (F eq. 7-9).

    Raises:
        FixedPointOverflowError: a parameter, a point or a residual leaves its range, or there are
            more than MAX_POINTS points.
    """
    if len(points) > MAX_POINTS:
        raise FixedPointOverflowError(f"{len(points)} points are more than the {MAX_POINTS} that sums hold")
    p = np.moveaxis(checked(parameters, "a parameter", VALUE_LIMIT), -1, 0)[..., np.newaxis]
    shifted = _shifted(points, p)
    products = p[:3] * shifted
    products[1] += p[3] * shifted[0]
    products[2] += p[4] * shifted[0] + p[5] * shifted[1]
    calibrated = checked(narrow(products), "a calibrated point", VALUE_LIMIT)
    squared = calibrated[0] ** 2 + calibrated[1] ** 2 + calibrated[2] ** 2
    residual = checked(narrow(squared - (ONE << FRACTION_BITS)), "a residual", RESIDUAL_LIMIT)
    tally.count(9, 9, residual.size)
    return State(shifted, calibrated, residual)


def _shifted(points: PointSet, p: Fixed) -> Fixed:
    shifted = points.xyz.T.reshape(3, *(1,) * (p.ndim - 2), -1) + p[6:9]
    if points.tau is not None:
        shifted += narrow(p[9:] * points.tau)
    return checked(shifted, "a shifted point", VALUE_LIMIT)


def cost(points: PointSet, state: State, tally: Tally) -> list[int]:
    """Exact weighted sums of squared residuals, one for each set of parameters.

    The unit is 2**-(58 + weight bits); squares are summed in two halves so that nothing is lost.
    """
    squares = np.atleast_2d(state.residual) ** 2
    high = (squares >> FRACTION_BITS) * points.weights
    low = (squares & _LOW_HALF) * points.weights
    tally.count(1, 1, squares.size)
    halves = zip(high.sum(axis=1), low.sum(axis=1), strict=True)
    return [(int(top) << FRACTION_BITS) + int(rest) for top, rest in halves]


def gradient(points: PointSet, state: State, parameters: Fixed, tally: Tally) -> list[int]:
    """Gradient of the weighted mean of r^2, twelve fixed-point integers (29 fraction bits).

    Chain rule on F eq. 7-9: d/dk_ij = 4 mean(r a_i u_j); d/do = 4 K^T mean(r a); d/ds the same
    with r a tau.
    """
    weighted = narrow(state.residual * points.weights, _WEIGHT_BITS)
    force = narrow(weighted * state.calibrated)
    scale = _sums_of_products(force[_ROWS], state.shifted[_COLUMNS])
    plain = force.sum(axis=1).tolist()
    warm = [0, 0, 0] if points.tau is None else _sums_of_products(force, points.tau)
    tally.count(9, 10, len(points))
    k = [int(value) for value in parameters[:6]]
    sums = scale + _turned_back(k, plain) + _turned_back(k, warm)
    weight = int(points.weights.sum())
    return [_mean_of_four(value, weight) for value in sums]


def _sums_of_products(left: Fixed, right: Fixed) -> list[int]:
    """Sums over the points of left * right in units of 2**-29, with head room for MAX_POINTS."""
    totals = narrow(left * right, _HEAD_ROOM_BITS).sum(axis=1)
    found: list[int] = (totals >> (FRACTION_BITS - _HEAD_ROOM_BITS)).tolist()
    return found


def _turned_back(k: list[int], force: list[int]) -> list[int]:
    """K^T times a vector."""
    x, y, z = force
    return [
        (k[0] * x + k[3] * y + k[4] * z) >> FRACTION_BITS,
        (k[1] * y + k[5] * z) >> FRACTION_BITS,
        (k[2] * z) >> FRACTION_BITS,
    ]


def _mean_of_four(total: int, weight: int) -> int:
    return rounded_quotient(4 * total * WEIGHT_ONE, weight)
