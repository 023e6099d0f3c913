"""The bias of a gyroscope at rest, and when it goes with temperature."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.gyroscope import Bias, RestRates
from accelcal_cli.judge.gyroscope import bias_at_rest

DPS = (0.1, 0.1, 0.2)


def bias(
    counts: np.ndarray, celsius: np.ndarray | None = None, least_range_c: float | None = 3.0
) -> Bias | None:
    """Of blocks of 1000 samples with these mean counts (b, 3)."""
    samples = np.full(len(counts), 1000)
    heat = None if celsius is None else np.rint(celsius * 1e6).astype(np.int64)
    rates = RestRates(samples, np.rint(counts * 1000).astype(np.int64), heat)
    return bias_at_rest(rates, DPS, 0.01, least_range_c)


def test_a_constant_by_hand() -> None:
    found = bias(np.tile([5.0, -10.0, 1.5], (12, 1)))
    assert found is not None
    assert found.dps == pytest.approx((0.5, -1.0, 0.3))
    assert found.reference_c is None and found.slope_dps_per_c == (0, 0, 0)
    assert found.rest_s == 120
    assert found.raw_dps == pytest.approx(np.sqrt(0.25 + 1 + 0.09))
    assert found.constant_dps == pytest.approx(0, abs=1e-12)
    assert found.slope_dps is None


def test_no_rest_no_bias_and_few_blocks_no_held_out_error() -> None:
    assert bias(np.empty((0, 3))) is None
    found = bias(np.ones((3, 3)))
    assert found is not None and found.constant_dps is None
    assert found.dps == pytest.approx((0.1, 0.1, 0.2))
    alone = bias(np.ones((1, 3)))
    assert alone is not None and alone.standard_errors is None


def test_its_error_is_that_of_the_mean() -> None:
    counts = np.random.default_rng(2).normal(4, 1, (400, 3))
    found = bias(counts)
    assert found is not None
    assert np.abs(np.array(found.dps) - 4 * np.array(DPS)).max() < 4 * 0.2 / 20
    assert found.standard_errors == pytest.approx(np.array(DPS) / 20, rel=0.15)


def test_slow_turns_among_the_rests_hardly_move_it() -> None:
    counts = np.random.default_rng(2).normal(4, 0.1, (60, 3))
    counts[20:26] += 30
    found = bias(counts)
    assert found is not None
    assert np.abs(np.array(found.dps) / DPS - 4).max() < 0.05


def test_a_slope_where_it_pays() -> None:
    random = np.random.default_rng(4)
    celsius = 30 + 5 * np.sin(np.linspace(0, 12, 300))
    slope = np.array([0.8, 0.0, -0.4])
    counts = 4 + np.multiply.outer(celsius - 30, slope) + random.normal(0, 0.3, (300, 3))
    found = bias(counts, celsius)
    assert found is not None and found.reference_c is not None
    np.testing.assert_allclose(np.array(found.slope_dps_per_c) / DPS, slope, atol=0.02)
    at_30 = np.array(found.dps) + np.array(found.slope_dps_per_c) * (30 - found.reference_c)
    np.testing.assert_allclose(at_30 / DPS, 4, atol=0.1)
    assert found.slope_dps is not None and found.constant_dps is not None
    assert found.slope_dps < 0.3 * found.constant_dps
    for without in (bias(counts, None), bias(counts, celsius, None), bias(counts, celsius, 30.0)):
        assert without is not None and without.reference_c is None


def test_no_slope_where_temperature_says_nothing() -> None:
    random = np.random.default_rng(4)
    celsius = 30 + 5 * np.sin(np.linspace(0, 12, 300))
    better = 0
    for _ in range(12):
        found = bias(random.normal(4, 0.3, (300, 3)), celsius)
        assert found is not None and found.reference_c is None
        assert found.slope_dps is not None and found.constant_dps is not None
        better += found.slope_dps < found.constant_dps
    assert better, "by chance a slope is a little better now and then"
