"""Arithmetic that gives the same bits on every machine: fixed-point integers, and small linear systems.

Fixed-point values have 29 fraction bits in 32 and lie in -4..4 (F's implementation note: 32-bit fixed point;
Farago, Maczak, Gingl 2024); products have 64 bits, and nothing wraps. Linear systems are solved in double
precision step by step: libraries sum in an order that depends on the machine, and for twelve parameters this
is fast enough.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from math import atan, erfc, exp, fsum, inf, pi, sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import FixedPointOverflowError

FRACTION_BITS = 29
ONE: int = 1 << FRACTION_BITS
"""The fixed-point integer of 1."""

LIMIT = 1 << 31
"""Fixed-point integers lie below this."""

Fixed = NDArray[np.int64]
"""Values that fit 32 bits, kept in 64 so that their products are exact."""

Matrix = Sequence[Sequence[float]]
T = TypeVar("T")


def three(values: Iterable[T]) -> tuple[T, T, T]:
    """Return the values of the three axes."""
    x, y, z = values
    return x, y, z


def checked(values: Fixed, what: str, limit: int = LIMIT) -> Fixed:
    """Return the values if all lie within +-limit.

    Raises:
        FixedPointOverflowError: a value does not.
    """
    if (
        values.size
        and not -limit < np.minimum.reduce(values, None) <= np.maximum.reduce(values, None) < limit
    ):
        raise FixedPointOverflowError(
            f"{what} leaves the 32-bit fixed-point range of +-{LIMIT // ONE} g",
            hint="check the unit and --lsb-per-g",
        )
    return values


def narrow(values: Fixed, bits: int = FRACTION_BITS) -> Fixed:
    """Drop `bits` fraction bits of the values in place, rounding half up."""
    values += 1 << (bits - 1)
    values >>= bits
    return values


def to_fixed(value: Fraction | float) -> int:
    """Return the nearest fixed-point integer of a number, ties to even."""
    return round(Fraction(value) * ONE)


def to_float(value: int) -> float:
    """Return the number that a fixed-point integer stands for (exact: 32 bits fit a double)."""
    return value / ONE


def rounded_quotient(value: int, divisor: int) -> int:
    """Return value / divisor rounded to the nearest integer, halves up; the divisor is positive."""
    return (2 * value + divisor) // (2 * divisor)


def cholesky(matrix: Matrix) -> list[list[float]]:
    """Return the lower triangular L of a symmetric matrix L L^T.

    Raises:
        ValueError: the matrix is not positive definite.
    """
    size = len(matrix)
    lower = [[0.0] * size for _ in range(size)]
    for row in range(size):
        for column in range(row + 1):
            rest = matrix[row][column]
            for index in range(column):
                rest -= lower[row][index] * lower[column][index]
            if row > column:
                lower[row][column] = rest / lower[column][column]
            elif rest > 0:
                lower[row][row] = sqrt(rest)
            else:
                raise ValueError("the matrix is not positive definite")
    return lower


def inverse(matrix: Matrix) -> list[list[float]]:
    """Return the inverse of a symmetric matrix.

    Raises:
        ValueError: the matrix is not positive definite.
    """
    lower = cholesky(matrix)
    size = len(lower)
    back = [[0.0] * size for _ in range(size)]
    for column in range(size):
        back[column][column] = 1 / lower[column][column]
        for row in range(column + 1, size):
            total = 0.0
            for index in range(column, row):
                total -= lower[row][index] * back[index][column]
            back[row][column] = total / lower[row][row]
    inverted = [[0.0] * size for _ in range(size)]
    for row in range(size):
        for column in range(row + 1):
            total = 0.0
            for index in range(row, size):
                total += back[index][row] * back[index][column]
            inverted[row][column] = inverted[column][row] = total
    return inverted


def quotient(matrix: Matrix, lower: Matrix) -> list[list[float]]:
    """Return M with M L = matrix, for a lower triangular L."""
    size = len(lower)
    found = [[0.0] * size for _ in matrix]
    for row, values in zip(found, matrix, strict=True):
        for column in reversed(range(size)):
            rest = values[column]
            for index in range(column + 1, size):
                rest -= row[index] * lower[index][column]
            row[column] = rest / lower[column][column]
    return found


# Statistics of small samples, with exactly rounded sums: the same bits on every machine.

Number = TypeVar("Number", int, float)

STUDENT_T_975 = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
    2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
)  # fmt: skip
"""97.5 % quantiles of Student's t for 1 to 30 degrees of freedom."""


def mean(values: Sequence[float]) -> float:
    """Return the exactly rounded sum over the number of values."""
    return fsum(values) / len(values)


def quantile(ordered: Sequence[float], share: float) -> float:
    """Return the quantile of sorted values by linear interpolation."""
    place = share * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (place - low)


def weighted_percentile(ordered: Sequence[tuple[Number, float]], percent: float) -> Number:
    """Return the smallest of sorted (value, weight) pairs that reaches `percent` of the weight."""
    seen, total = 0.0, sum(weight for _, weight in ordered)
    for value, weight in ordered:
        seen += weight
        if 100 * seen >= percent * total:
            return value
    raise ValueError("no values")


def standard_error(values: Sequence[float]) -> float:
    """Return the standard error of the mean; 0 for fewer than two values."""
    if len(values) < 2:
        return 0.0
    centre = mean(values)
    spread = fsum((value - centre) ** 2 for value in values) / (len(values) - 1)
    return sqrt(spread / len(values))


def clustered_error(values: Sequence[float], clusters: Sequence[int]) -> float:
    """Return the standard error of the mean of values that are alike within clusters; 0 for one cluster.

    sqrt(G / (G - 1) sum over the G clusters of (sum of deviations)^2) / n, which is
    `standard_error` where every value is a cluster (Liang, Zeger 1986; Cameron, Miller 2015).
    """
    number = len(set(clusters))
    if number < 2:
        return 0.0
    centre = mean(values)
    deviations: dict[int, list[float]] = {}
    for value, cluster in zip(values, clusters, strict=True):
        deviations.setdefault(cluster, []).append(value - centre)
    spread = fsum(fsum(part) ** 2 for part in deviations.values())
    return sqrt(spread * number / (number - 1)) / len(values)


def student_t_975(freedom: int) -> float:
    """Return the 97.5 % quantile of Student's t for one degree of freedom or more."""
    return STUDENT_T_975[freedom - 1] if freedom <= len(STUDENT_T_975) else 1.96 + 2.4 / freedom


def interval95(values: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % confidence interval of the mean by Student's t; unbounded for fewer than two values."""
    if len(values) < 2:
        return -inf, inf
    centre, half = mean(values), student_t_975(len(values) - 1) * standard_error(values)
    return centre - half, centre + half


def ratio_uncertainty95(pairs: Sequence[tuple[float, float]]) -> float | None:
    """Return the factor by which the ratio of the means of pairs may be too large or too small (95 %).

    The delta method for the logarithm of the ratio, with Student's t over the pairs. It held in 93 to 95 % of
    simulated sets of 4 to 40 pairs, in 90 % where the denominators are lognormal with a sigma of 1; Fieller's
    interval is as good, but unbounded for 2 to 60 % of the sets of 4 to 8.

    Returns:
        None for fewer than two pairs, or a mean that is not above 0.
    """
    if len(pairs) < 2:
        return None
    one, other = (mean(column) for column in zip(*pairs, strict=True))
    if one <= 0 or other <= 0:
        return None
    error = standard_error([value / one - divisor / other for value, divisor in pairs])
    return exp(student_t_975(len(pairs) - 1) * error)


def normal_probability(deviation: float) -> float:
    """Return the probability that a normal variable is at least `deviation` standard deviations from 0."""
    return erfc(abs(deviation) / sqrt(2))


def student_t_probability(t: float, freedom: int) -> float:
    """Return the probability that Student's t, of 1 or more degrees of freedom, is at least `t` from 0.

    The finite sums of Abramowitz, Stegun, Handbook of Mathematical Functions (1964), 26.7.3 and 26.7.4.
    """
    angle = atan(abs(t) / sqrt(freedom))
    cosine2 = freedom / (freedom + t * t)
    sine = abs(t) / sqrt(freedom + t * t)
    if freedom % 2:
        inside = 2 / pi * (angle + sine * _nested_sum(sqrt(cosine2), cosine2, range(3, freedom, 2)))
        return max(0.0, 1 - (2 / pi * angle if freedom == 1 else inside))
    return max(0.0, 1 - sine * _nested_sum(1.0, cosine2, range(2, freedom, 2)))


def _nested_sum(first: float, factor: float, numbers: range) -> float:
    """first (1 + factor (n0 - 1) / n0 (1 + factor (n1 - 1) / n1 (...)))."""
    total = term = first
    for number in numbers:
        term *= factor * (number - 1) / number
        total += term
    return total
