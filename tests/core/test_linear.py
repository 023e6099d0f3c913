"""Small systems against numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.linear import cholesky, inverse


def positive(size: int, seed: int) -> np.ndarray:
    half = np.random.default_rng(seed).standard_normal((size + 2, size))
    return np.asarray(half.T @ half)


@given(st.integers(1, 12), st.integers(0, 1000))
def test_they_are_what_numpy_finds(size: int, seed: int) -> None:
    matrix = positive(size, seed)
    scale = np.linalg.cond(matrix) * 1e-13
    assert np.abs(np.array(cholesky(matrix.tolist())) - np.linalg.cholesky(matrix)).max() < scale
    back = np.array(inverse(matrix.tolist()))
    assert np.abs(back - np.linalg.inv(matrix)).max() < scale * np.abs(back).max()
    assert (back == back.T).all()


def test_by_hand() -> None:
    assert cholesky([[4.0, 2.0], [2.0, 10.0]]) == [[2.0, 0.0], [1.0, 3.0]]
    assert inverse([[4.0, 0.0], [0.0, 0.0625]]) == [[0.25, 0.0], [0.0, 16.0]]


@pytest.mark.parametrize("matrix", [[[0.0]], [[1.0, 1.0], [1.0, 1.0]], [[-1.0]], [[1.0, 2.0], [2.0, 1.0]]])
def test_what_is_not_positive_definite_is_refused(matrix: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="positive definite"):
        inverse(matrix)
