"""Error figures against hand numbers."""

from __future__ import annotations

from itertools import pairwise
from math import gamma, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import IDENTITY
from accelcal_cli.judge import errors
from tests.optimize.oracle import calibrated, points


def test_deviations_by_hand() -> None:
    held = points(np.array([[0.6, 0.0, 0.8], [0.0, 1.02, 0.0], [0.3, -0.4, 0.0]]))
    assert errors.deviations_mg(held, IDENTITY) == pytest.approx([0, 20, 500], abs=1e-4)


def test_deviations_with_every_parameter() -> None:
    random = np.random.default_rng(1)
    v, tau = random.uniform(-1, 1, (20, 3)), random.uniform(-1, 1, 20)
    p = np.rint((np.array(IDENTITY) / ONE + random.uniform(-0.1, 0.1, 12)) * ONE)
    a = calibrated(p / ONE, v, tau)
    expected = abs(np.sqrt((a**2).sum(axis=1)) - 1) * 1000
    found = errors.deviations_mg(points(v, tau=tau), tuple(int(value) for value in p))
    assert found == pytest.approx(expected, abs=1e-5)


def test_slopes_are_not_used_without_temperatures() -> None:
    held = points(np.array([[1.0, 0, 0]]))
    assert errors.deviations_mg(held, (*IDENTITY[:9], ONE, ONE, ONE)).tolist() == [0]


def test_each_posture_has_its_weighted_mean() -> None:
    values, weights = np.array([1.0, 4.0, 10.0, 20.0]), np.array([3, 1, 5, 5])
    found = errors.per_posture(values, weights, np.array([7, 7, 2, 2]))
    assert found == {2: 15.0, 7: 1.75}


def test_summary_by_hand() -> None:
    found = errors.summary([5.0, 1.0, 4.0, 2.0, 3.0, 9.0])
    assert (found.mean, found.median) == (4.0, 3.5)
    assert found.p95 == pytest.approx(5 + 0.75 * 4)


@given(st.lists(st.floats(0, 1e6), min_size=1), st.floats(0, 1))
def test_quantiles_are_linear_between_order_statistics(values: list[float], share: float) -> None:
    expected = float(np.quantile(values, share))
    assert errors.quantile(sorted(values), share) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(st.permutations([0.1, 0.2, 0.3, 1e16, -1e16, 7.7]))
def test_means_do_not_depend_on_the_order(values: list[float]) -> None:
    assert errors.mean(values) == pytest.approx(8.3 / 6, rel=1e-12)


def test_standard_error_by_hand() -> None:
    assert errors.standard_error([1.0, 2.0, 3.0]) == pytest.approx(1 / sqrt(3))
    assert errors.standard_error([4.0]) == 0
    assert errors.standard_error([]) == 0


def test_clustered_error_by_hand() -> None:
    # mean 3; deviations -2 -1 | 0 | 3 sum to -3, 0, 3: sqrt(3/2 (9 + 0 + 9)) / 4
    found = errors.clustered_error([1.0, 2.0, 3.0, 6.0], [5, 5, 7, 9])
    assert found == pytest.approx(sqrt(1.5 * 18) / 4)
    assert errors.clustered_error([1.0, 2.0], [3, 3]) == 0
    assert errors.clustered_error([], []) == 0


def test_clusters_of_one_value_give_the_plain_standard_error() -> None:
    values = [0.5, 3.0, -2.0, 7.25, 1.0]
    assert errors.clustered_error(values, [4, 1, 3, 0, 2]) == pytest.approx(errors.standard_error(values))


def test_repeating_every_value_within_its_cluster_says_nothing_new() -> None:
    values = [0.5, 3.0, -2.0, 7.25]
    thrice = [value for value in values for _ in range(3)]
    clusters = [cluster for cluster in range(4) for _ in range(3)]
    assert errors.clustered_error(thrice, clusters) == pytest.approx(errors.standard_error(values))


def test_interval_by_hand() -> None:
    assert errors.interval95([11.0, 12.0, 13.0]) == pytest.approx(
        (12 - 4.303 / sqrt(3), 12 + 4.303 / sqrt(3))
    )
    assert errors.interval95([1.0, 2.0, 3.0]) == pytest.approx((0.0, 2 + 4.303 / sqrt(3)))
    assert errors.interval95([5.0]) == (0.0, float("inf"))


def student(freedom: int, t: float) -> float:
    """P(|T| < t) by Simpson's rule."""
    x = np.linspace(0, t, 20_001)
    density = (
        gamma((freedom + 1) / 2)
        / (sqrt(freedom * pi) * gamma(freedom / 2))
        * (1 + x * x / freedom) ** (-(freedom + 1) / 2)
    )
    weights = np.r_[1, np.tile([4, 2], 9999), 4, 1]
    return float(2 * (density * weights).sum() * t / 20_000 / 3)


@pytest.mark.parametrize("freedom", range(1, 31))
def test_the_table_is_students_t(freedom: int) -> None:
    t = errors.STUDENT_T_975[freedom - 1]
    assert student(freedom, t - 6e-4) < 0.95 < student(freedom, t + 6e-4)


@pytest.mark.parametrize("number", [32, 41, 61, 121, 301])
def test_beyond_the_table_the_interval_still_covers_95_percent(number: int) -> None:
    values = [float(value % 7) + 100 for value in range(number)]
    low, high = errors.interval95(values)
    t = (high - low) / 2 / errors.standard_error(values)
    assert student(number - 1, t) == pytest.approx(0.95, abs=4e-4)


def test_the_factor_falls_without_a_step_at_the_end_of_the_table() -> None:
    factors = []
    for number in range(3, 60):
        values = [100.0 + (value % 2) for value in range(number)]
        low, high = errors.interval95(values)
        factors.append((high - low) / errors.standard_error(values))
    assert all(a > b for a, b in pairwise(factors))
