"""Fixed-point integers, and small symmetric systems against numpy."""

from __future__ import annotations

from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.arithmetic import (
    FRACTION_BITS,
    LIMIT,
    ONE,
    checked,
    cholesky,
    inverse,
    narrow,
    quotient,
    to_fixed,
    to_float,
)
from accelcal_cli.core.errors import FixedPointOverflowError


def test_the_format_is_32_bits_with_29_of_fraction() -> None:
    assert (FRACTION_BITS, ONE, LIMIT) == (29, 536_870_912, 2_147_483_648)


@given(st.lists(st.integers(-(2**62), 2**62 - 1)), st.integers(1, 40))
def test_narrowing_rounds_to_nearest_halves_up(values: list[int], bits: int) -> None:
    expected = [floor(Fraction(value, 2**bits) + Fraction(1, 2)) for value in values]
    assert narrow(np.array(values, np.int64), bits).tolist() == expected


@given(st.integers(-LIMIT, LIMIT))
def test_to_float_is_exact_and_to_fixed_takes_it_back(value: int) -> None:
    assert Fraction(to_float(value)) == Fraction(value, ONE)
    assert to_fixed(to_float(value)) == value


@given(st.fractions(-4, 4))
def test_to_fixed_is_the_nearest_integer_ties_to_even(value: Fraction) -> None:
    fixed = to_fixed(value)
    distance = abs(value * ONE - fixed)
    assert distance < Fraction(1, 2) or (distance == Fraction(1, 2) and fixed % 2 == 0)


@pytest.mark.parametrize(("value", "expected"), [(1, 0), (3, 2), (-1, 0), (-3, -2)])
def test_ties_by_hand(value: int, expected: int) -> None:
    assert to_fixed(Fraction(value, 2 * ONE)) == expected


@pytest.mark.parametrize("value", [LIMIT - 1, 1 - LIMIT, 0])
def test_values_within_the_range_pass(value: int) -> None:
    values = np.array([0, value], np.int64)
    assert checked(values, "a value") is values


@pytest.mark.parametrize("value", [LIMIT, -LIMIT, 2**62, -(2**62), -(2**63)])
def test_values_beyond_the_range_raise_with_their_name(value: int) -> None:
    with pytest.raises(FixedPointOverflowError, match="a value leaves the 32-bit"):
        checked(np.array([0, value], np.int64), "a value")


@pytest.mark.parametrize("value", [10, -10])
def test_a_narrower_limit_can_be_asked_for(value: int) -> None:
    checked(np.array([value]), "it", 11)
    with pytest.raises(FixedPointOverflowError):
        checked(np.array([value]), "it", 10)


def test_nothing_is_within_every_range() -> None:
    assert checked(np.empty(0, np.int64), "nothing").size == 0


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


def test_a_quotient_by_a_lower_triangular_matrix_is_exact_step_by_step() -> None:
    matrix, lower = np.tril(np.arange(1.0, 10).reshape(3, 3)), np.array([[2, 0, 0], [1, 4, 0], [-3, 5, 8.0]])
    found = np.array(quotient((matrix @ lower).tolist(), lower.tolist()))
    assert (found == matrix).all()
