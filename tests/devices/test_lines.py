"""Weighted lines and means against numpy's polynomial fit, and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.devices.trends import Measured, lines, means


def one(values: object, errors: object, days: object) -> Measured:
    """One parameter of one device."""
    columns = [np.array(column, float)[:, np.newaxis] for column in (values, errors)]
    return Measured(*columns, np.array(days, float), np.array([0, len(columns[0])]))


def made(number: int, seed: int, scatter: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.RandomState(seed)
    days, errors = np.sort(19_000 + 400 * random.rand(number)), 0.5 + random.rand(number)
    return 3 + 0.02 * days + scatter * errors * random.randn(number), errors, days


@pytest.mark.parametrize(("scatter", "inflated"), [(0.2, False), (8.0, True)])
@pytest.mark.parametrize("number", [3, 4, 9, 40])
def test_a_line_is_that_of_polyfit(number: int, scatter: float, inflated: bool) -> None:
    values, errors, days = made(number, number, scatter)
    ((line,),) = lines(one(values, errors, days), 14)
    last = days - days[-1]
    (slope, value), cov = np.polyfit(last, values, 1, w=1 / errors, cov=True if inflated else "unscaled")
    chi2 = (((values - value - slope * last) / errors) ** 2).sum() / (number - 2)
    assert line.scatter == pytest.approx(chi2)
    assert (chi2 > 1) == inflated
    assert line.number == number
    assert (line.slope, line.value) == pytest.approx((slope, value), rel=1e-9)
    assert (line.slope_error, line.error) == pytest.approx(tuple(np.sqrt(np.diag(cov))), rel=1e-7)


def test_a_line_by_hand() -> None:
    """Weights 4: S = 4 (100 + 100) = 800, b = 4 (10 x 4) / 800."""
    ((line,),) = lines(one([0, 3, 4], [0.5, 0.5, 0.5], [0, 10, 20]), 14)
    assert line.slope == pytest.approx(0.2)
    left = np.array([0, 3, 4]) - (7 / 3 + 0.2 * np.array([-10, 0, 10]))
    chi2 = 4 * (left**2).sum()
    assert line.scatter == pytest.approx(chi2)
    assert chi2 > 1
    assert line.slope_error == pytest.approx(np.sqrt(chi2) / np.sqrt(800))
    assert line.value == pytest.approx(7 / 3 + 2)
    assert line.error == pytest.approx(np.sqrt(chi2) * np.sqrt(1 / 12 + 100 / 800))


def test_a_scatter_below_the_errors_does_not_make_them_smaller() -> None:
    ((line,),) = lines(one([0, 1, 2], [0.5] * 3, [0, 10, 20]), 14)
    assert line.scatter == pytest.approx(0, abs=1e-20)
    assert line.slope_error == pytest.approx(1 / np.sqrt(800))


@pytest.mark.parametrize("days", [[0, 100], [0, 5, 13.9], [0, 100, np.nan], [7, 7, 7]])
def test_too_few_or_too_close_are_not_enough(days: list[float]) -> None:
    ((line,),) = lines(one(np.arange(len(days)), np.ones(len(days)), days), 14)
    assert np.isnan([line.slope, line.slope_error, line.value, line.error, line.scatter]).all()
    assert line.number == np.isfinite(days).sum()


def test_values_without_error_or_date_take_no_part() -> None:
    values, errors, days = made(6, 3, 1)
    ((plain,),) = lines(one(values, errors, days), 14)
    more = one(
        [99, *values, np.nan, 98], [np.nan, *errors, 1, 1], [days[0] - 50, *days, days[-1] + 50, np.nan]
    )
    ((line,),) = lines(more, 14)
    assert line == pytest.approx(plain)


@given(st.lists(st.integers(1, 7), min_size=1, max_size=6))
def test_devices_together_are_each_alone(sizes: list[int]) -> None:
    parts = [made(size, seed, 1) for seed, size in enumerate(sizes)]
    values, errors, days = (np.concatenate(column) for column in zip(*parts, strict=True))
    held = one(values, errors, days)
    together = Measured(held.values, held.errors, held.days, np.concatenate([[0], np.cumsum(sizes)]))
    alone = [lines(one(*part), 14)[0] for part in parts]
    assert np.array(lines(together, 14)) == pytest.approx(np.array(alone), nan_ok=True)
    assert np.array(means(together)) == pytest.approx(
        np.array([means(one(*part))[0] for part in parts]), nan_ok=True
    )


def test_no_device_at_all() -> None:
    empty = Measured(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.array([0]))
    assert lines(empty, 14) == means(empty) == []


@given(st.floats(-10, 10), st.floats(1e-6, 1))
def test_a_single_value_has_its_own_error(value: float, error: float) -> None:
    """The mean of one may differ from it by a rounding, which is no scatter."""
    ((single,),) = means(one([value], [error], [0]))
    assert single[:3] == pytest.approx((1, value, error))
    assert np.isnan(single.scatter)


def test_means_by_hand() -> None:
    ((mean,),) = means(one([1, 3], [1, 0.5], [0, 1]))
    assert mean.value == pytest.approx((1 + 4 * 3) / 5)
    chi2 = (1 - 2.6) ** 2 + 4 * (3 - 2.6) ** 2
    assert (mean.scatter, mean.error) == pytest.approx((chi2, np.sqrt(chi2 / 5)))
    ((single,),) = means(one([2], [0.5], [0]))
    assert single[:3] == pytest.approx((1, 2, 0.5))
    ((none,),) = means(one([np.nan], [0.5], [0]))
    assert none.number == 0 and np.isnan(none.value) and np.isnan(none.error)
