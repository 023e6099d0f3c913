"""Exact integer sums at floating-point speed.

A float holds every integer up to 2**24 (single) or 2**53 (double); a sum of integers whose
absolute values add up to less than that is exact in any order, so that the fast matrix product
gives the same integers as a slow integer loop.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_EXACT: tuple[tuple[int, DTypeLike], ...] = ((1 << 24, np.float32), (1 << 53, np.float64))


def exact_type(bound: int) -> DTypeLike:
    """The fastest type in which integers that add up to `bound` stay exact."""
    for limit, kind in _EXACT:
        if bound <= limit:
            return kind
    return np.int64


def sums(blocks: NDArray[Any], bound: int) -> NDArray[np.int64]:
    """Sums over the last axis of integers whose absolute values add up to at most `bound`."""
    kind = exact_type(bound)
    if kind is np.int64:
        return np.asarray(blocks.sum(axis=-1, dtype=np.int64))
    return np.asarray(blocks.astype(kind) @ np.ones(blocks.shape[-1], kind)).astype(np.int64)


def sums_of_squares(blocks: NDArray[Any], bound: int) -> NDArray[np.int64]:
    """Sums over the last axis of squares that add up to at most `bound`; blocks is (m, n)."""
    values = blocks.astype(exact_type(bound), copy=False)
    return np.asarray(np.einsum("mn,mn->m", values, values)).astype(np.int64)


def centred_squares(
    blocks: NDArray[Any], spread: NDArray[np.int64], sums: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(c, r), both (m,), with n^2 times the variance of a window of n counts = n c - r^2, r < n.

    With d = counts - first count and sum(d) = q n + r, c is sum(d^2) - n q^2 - 2 q r; all terms
    stay small.

    Args:
        blocks: (m, n) counts, m > 0.
        spread: (m,) max - min.
        sums: (m,) sums of counts.
    """
    length = blocks.shape[1]
    largest = int(spread.max())
    squares = sums_of_squares(_from_first(blocks), largest * largest * length)
    q, r = np.divmod(sums - length * blocks[:, 0].astype(np.int64), length)
    return squares - length * q * q - 2 * q * r, r


def _from_first(blocks: NDArray[Any]) -> NDArray[Any]:
    """Counts of each window less its first one, in a type that holds every difference."""
    values = blocks.astype(exact_type(1 << 8 * blocks.itemsize))
    values -= blocks[:, :1]
    return values
