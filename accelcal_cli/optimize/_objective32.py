"""The objective in 32-bit fixed point: the weighted mean of (|a|^2 - 1)^2, its gradient and its range.

F eq. 12 without the square root; the mean, not the printed sum, for which the published learning rates
diverge with 18 points. Values have 29 fraction bits in 32 (core.arithmetic); products have 58 in 64. Sums of
products are kept exact or are given head room for 8192 points. Every narrowing is checked, nothing wraps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE, Fixed, checked, narrow, rounded_quotient
from accelcal_cli.core.errors import FixedPointOverflowError
from accelcal_cli.core.points import WEIGHT_ONE, Operations, PointSet

VALUE_LIMIT = 2 * ONE
"""Parameters and points, shifted and calibrated, lie below this."""

RESIDUAL_LIMIT = ONE
MAX_POINTS = 8192
WEIGHT_BITS = WEIGHT_ONE.bit_length() - 1
_LOW_HALF = (1 << FRACTION_BITS) - 1
_HEAD_ROOM_BITS = 10

PARAMETERS = 12
ENTRIES = 6
"""Number of entries of K, the first parameters; three offsets and three slopes follow."""

ROWS = [0, 1, 2, 1, 2, 2]
COLUMNS = [0, 1, 2, 0, 0, 1]
"""Row and column of each entry of K, in the order of the parameters."""

RISE_TOLERANCE_BITS = 12
"""Bits of the cost above which a rise is not rounding: one part in 4096."""

LEAST_SCALE = ONE // 4
"""Smallest scale of any accelerometer: below it, the points do not determine the scale."""


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """k sets of points side by side, n columns for the largest set.

    A smaller set is filled up with its first point at weight zero, which adds nothing to any sum.

    Attributes:
        xyz: (3, k, n), the points of a set contiguous: otherwise fits take 1.7 times as long.
        weights: (k, n).
        tau: (k, n), or None without temperatures.
        number: (k,) number of points of each set.
        weight: (k,) sum of the weights of each set.
    """

    xyz: Fixed
    weights: NDArray[np.int64]
    tau: Fixed | None
    number: list[int]
    weight: list[int]

    def select(self, rows: list[int]) -> Stack:
        """Return some of the sets."""
        tau = None if self.tau is None else self.tau[rows]
        number, weight = [self.number[row] for row in rows], [self.weight[row] for row in rows]
        return Stack(self.xyz[:, rows], self.weights[rows], tau, number, weight)


def stacked(sets: Sequence[PointSet]) -> Stack:
    """Put sets of points side by side, none of them empty, all with temperatures or none.

    Raises:
        FixedPointOverflowError: a set has more than MAX_POINTS points.
    """
    number = [len(points) for points in sets]
    width = max(number)
    if width > MAX_POINTS:
        raise FixedPointOverflowError(f"{width} points are more than the {MAX_POINTS} that sums hold")
    place = np.arange(width)
    real = place < np.array(number)[:, np.newaxis]
    filled = [(points, np.where(own, place, 0)) for points, own in zip(sets, real, strict=True)]
    xyz = np.stack([points.xyz[rows].T for points, rows in filled], axis=1)
    weights = np.stack([points.weights[rows] for points, rows in filled]) * real
    taus = [points.tau[rows] for points, rows in filled if points.tau is not None]
    tau = np.stack(taus) if taus else None
    weight = [int(total) for total in weights.sum(axis=1)]
    return Stack(np.ascontiguousarray(xyz), weights, tau, number, weight)


@dataclass(frozen=True, slots=True)
class State:
    """The model at one vector of parameters for each set: u = v + o + s tau, a = K u, r = |a|^2 - 1.

    Attributes:
        shifted, calibrated: u and a, (3, k, n).
        residual: (k, n).
    """

    shifted: Fixed
    calibrated: Fixed
    residual: Fixed


def evaluate(stack: Stack, parameters: Fixed) -> State:
    """Apply (k, 12) parameters to k sets of points, or to the only set (F eq. 7-9).

    It takes 9 additions and 9 multiplications per point.

    Raises:
        FixedPointOverflowError: a parameter, a point or a residual leaves its range.
    """
    p = checked(parameters, "a parameter", VALUE_LIMIT).T[..., np.newaxis]
    shifted = stack.xyz + p[6:9]
    if stack.tau is not None and p[9:].any():
        shifted += narrow(p[9:] * stack.tau)
    checked(shifted, "a shifted point", VALUE_LIMIT)
    products = p[:3] * shifted
    if p[3:6].any():
        products[1] += p[3] * shifted[0]
        products[2] += p[4] * shifted[0] + p[5] * shifted[1]
    calibrated = checked(narrow(products), "a calibrated point", VALUE_LIMIT)
    squared = calibrated[0] ** 2 + calibrated[1] ** 2 + calibrated[2] ** 2
    residual = checked(narrow(squared - (ONE << FRACTION_BITS)), "a residual", RESIDUAL_LIMIT)
    return State(shifted, calibrated, residual)


def cost(stack: Stack, state: State) -> list[int]:
    """Return exact weighted sums of squared residuals, one for each vector of parameters.

    The unit is 2**-(58 + weight bits); squares are summed in two halves so that nothing is lost.
    It takes one addition and one multiplication per point.
    """
    squares = state.residual**2
    high = ((squares >> FRACTION_BITS) * stack.weights).sum(axis=1)
    low = ((squares & _LOW_HALF) * stack.weights).sum(axis=1)
    return [(top << FRACTION_BITS) + rest for top, rest in zip(high.tolist(), low.tolist(), strict=True)]


def gradients(
    stack: Stack, state: State, parameters: list[list[int]], free: Sequence[int] = range(PARAMETERS)
) -> list[list[int]]:
    """Return the gradient of the weighted mean of r^2 of each set, twelve fixed-point integers.

    Chain rule on F eq. 7-9: d/dk_ij = 4 mean(r a_i u_j); d/do = 4 K^T mean(r a); d/ds the same
    with r a tau. It takes 9 additions and 10 multiplications per point.

    Args:
        free: indices of the parameters for which it is needed, in order; entries of K and slopes that are
            not among them get 0.
    """
    weighted = narrow(state.residual * stack.weights, WEIGHT_BITS)
    force = narrow(weighted * state.calibrated)
    scale = _of_entries(force, state.shifted, [index for index in free if index < ENTRIES])
    plain = force.sum(axis=2).T.tolist()
    heated = [[0, 0, 0]] * len(plain)
    if stack.tau is not None and any(index >= PARAMETERS - 3 for index in free):
        heated = _sums(force * stack.tau)
    found = []
    for entries, force_sum, heated_sum, k, weight in zip(
        scale, plain, heated, parameters, stack.weight, strict=True
    ):
        sums = entries + _turned_back(k, force_sum) + _turned_back(k, heated_sum)
        found.append([rounded_quotient(4 * total * WEIGHT_ONE, weight) for total in sums])
    return found


def _of_entries(force: Fixed, shifted: Fixed, wanted: list[int]) -> list[list[int]]:
    """Return sums of r a_i u_j of each set for some entries of K; 0 for the others."""
    found = np.zeros((force.shape[1], ENTRIES), force.dtype)
    if wanted:
        products = np.empty((len(wanted), *force.shape[1:]), force.dtype)
        for product, entry in zip(products, wanted, strict=True):
            np.multiply(force[ROWS[entry]], shifted[COLUMNS[entry]], out=product)
        found[:, wanted] = _sums(products)
    sums: list[list[int]] = found.tolist()
    return sums


def _sums(products: Fixed) -> list[list[int]]:
    """Return sums of products over the points of each set, in units of 2**-29."""
    totals = narrow(products, _HEAD_ROOM_BITS).sum(axis=2)
    found: list[list[int]] = (totals.T >> (FRACTION_BITS - _HEAD_ROOM_BITS)).tolist()
    return found


def _turned_back(k: list[int], force: list[int]) -> list[int]:
    """Return K^T times a vector."""
    x, y, z = force
    return [
        (k[0] * x + k[3] * y + k[4] * z) >> FRACTION_BITS,
        (k[1] * y + k[5] * z) >> FRACTION_BITS,
        (k[2] * z) >> FRACTION_BITS,
    ]


def operations_of(points: int, costs: int, gradients: int = 0, others: int = 0) -> Operations:
    """Return the operations of evaluations on `points` points, and `others` of each kind besides."""
    return Operations(
        (10 * costs + 9 * gradients) * points + others, (10 * costs + 10 * gradients) * points + others
    )
