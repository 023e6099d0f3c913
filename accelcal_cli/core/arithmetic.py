"""Arithmetic that gives the same bits on every machine: fixed-point integers, and small linear systems.

Fixed-point values have 29 fraction bits in 32 and lie in -4..4 (F's implementation note: 32-bit fixed point;
Farago, Maczak, Gingl 2024); products have 64 bits, and nothing wraps. Linear systems are solved in double
precision step by step: libraries sum in an order that depends on the machine, and for twelve parameters this
is fast enough.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from math import sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import FixedPointOverflowError

FRACTION_BITS = 29
ONE = 1 << FRACTION_BITS
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
