"""Statistics of `core/arithmetic.py` by hand, and against numpy and scipy."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from math import inf, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from accelcal_cli.core.arithmetic import (
    STUDENT_T_975,
    clustered_error,
    interval95,
    mean,
    normal_probability,
    quantile,
    standard_error,
    student_t_probability,
    weighted_percentile,
)


@given(st.lists(st.floats(0, 1e6), min_size=1), st.floats(0, 1))
def test_quantiles_are_linear_between_order_statistics(values: list[float], share: float) -> None:
    expected = float(np.quantile(values, share))
    assert quantile(sorted(values), share) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(1, 5)), min_size=1), st.sampled_from([0.5, 5, 50, 95])
)
def test_weighted_percentiles_are_those_of_repeated_values(
    pairs: list[tuple[int, int]], percent: float
) -> None:
    repeated = [value for value, number in sorted(pairs) for _ in range(number)]
    enough = -(-Fraction(percent) * len(repeated) // 100)
    assert weighted_percentile(sorted(pairs), percent) == repeated[enough - 1]


@given(st.permutations([0.1, 0.2, 0.3, 1e16, -1e16, 7.7]))
def test_means_do_not_depend_on_the_order(values: list[float]) -> None:
    assert mean(values) == pytest.approx(8.3 / 6, rel=1e-12)


def test_standard_error_by_hand() -> None:
    assert standard_error([1.0, 2.0, 3.0]) == pytest.approx(1 / sqrt(3))
    assert standard_error([4.0]) == 0
    assert standard_error([]) == 0


def test_clustered_error_by_hand() -> None:
    # mean 3; deviations -2 -1 | 0 | 3 sum to -3, 0, 3: sqrt(3/2 (9 + 0 + 9)) / 4
    found = clustered_error([1.0, 2.0, 3.0, 6.0], [5, 5, 7, 9])
    assert found == pytest.approx(sqrt(1.5 * 18) / 4)
    assert clustered_error([1.0, 2.0], [3, 3]) == 0
    assert clustered_error([], []) == 0


def test_clusters_of_one_value_give_the_plain_standard_error() -> None:
    values = [0.5, 3.0, -2.0, 7.25, 1.0]
    assert clustered_error(values, [4, 1, 3, 0, 2]) == pytest.approx(standard_error(values))


def test_repeating_every_value_within_its_cluster_says_nothing_new() -> None:
    values = [0.5, 3.0, -2.0, 7.25]
    thrice = [value for value in values for _ in range(3)]
    clusters = [cluster for cluster in range(4) for _ in range(3)]
    assert clustered_error(thrice, clusters) == pytest.approx(standard_error(values))


def test_interval_by_hand() -> None:
    assert interval95([1.0, 2.0, 3.0]) == pytest.approx((2 - 4.303 / sqrt(3), 2 + 4.303 / sqrt(3)))
    assert interval95([5.0]) == (-inf, inf)


@pytest.mark.parametrize("freedom", range(1, 31))
def test_the_table_is_students_t(freedom: int) -> None:
    t = STUDENT_T_975[freedom - 1]
    assert student_t_probability(t - 6e-4, freedom) > 0.05 > student_t_probability(t + 6e-4, freedom)


@pytest.mark.parametrize("number", [32, 41, 61, 121, 301])
def test_beyond_the_table_the_interval_still_covers_95_percent(number: int) -> None:
    values = [float(value % 7) + 100 for value in range(number)]
    low, high = interval95(values)
    t = (high - low) / 2 / standard_error(values)
    assert student_t_probability(t, number - 1) == pytest.approx(0.05, abs=4e-4)


def test_the_factor_falls_without_a_step_at_the_end_of_the_table() -> None:
    factors = []
    for number in range(3, 60):
        values = [100.0 + (value % 2) for value in range(number)]
        low, high = interval95(values)
        factors.append((high - low) / standard_error(values))
    assert all(a > b for a, b in pairwise(factors))


@given(st.floats(-60, 60), st.integers(1, 400))
def test_students_t_is_scipys(t: float, freedom: int) -> None:
    expected = 2 * special.stdtr(freedom, -abs(t))
    assert student_t_probability(t, freedom) == pytest.approx(expected, rel=1e-6, abs=1e-13)
    assert (student_t_probability(0, 1), student_t_probability(0, 2)) == (1, 1)


def test_the_normal_distribution_is_that_of_books() -> None:
    assert normal_probability(3) == pytest.approx(0.0026998, rel=1e-5)
    assert normal_probability(-1.959964) == pytest.approx(0.05, rel=1e-6)
