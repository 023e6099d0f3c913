"""Small symmetric systems, solved in double precision step by step.

Libraries for linear algebra sum in an order that depends on the machine; here it is always the same, so
that the same numbers give the same bits everywhere. For twelve parameters that is fast enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

Matrix = Sequence[Sequence[float]]


def cholesky(matrix: Matrix) -> list[list[float]]:
    """The lower triangular L of a symmetric matrix L L^T.

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
    """The inverse of a symmetric matrix.

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
    found = [[0.0] * size for _ in range(size)]
    for row in range(size):
        for column in range(row + 1):
            total = 0.0
            for index in range(row, size):
                total += back[index][row] * back[index][column]
            found[row][column] = found[column][row] = total
    return found
