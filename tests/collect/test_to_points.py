"""Sums to fixed-point means against Fractions."""

from __future__ import annotations

from fractions import Fraction
from math import floor

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.collect.cell_points import Sums, to_points
from accelcal_cli.core.calibration import TemperatureScale
from accelcal_cli.core.fixed import ONE, rounded_quotient

HALF = Fraction(1, 2)


def rounded(value: Fraction) -> int:
    return floor(value + HALF)


@given(st.integers(-(10**30), 10**30), st.integers(1, 10**15))
def test_quotients_are_rounded_halves_up(value: int, divisor: int) -> None:
    assert rounded_quotient(value, divisor) == rounded(Fraction(value, divisor))


@given(
    st.lists(st.tuples(*[st.integers(-(2**40), 2**40)] * 3, st.integers(1, 4000)), max_size=6),
    st.sampled_from([256.0, 4096.0, float(1 << 24), 341.3333333333333, 83.3, 1 / 0.0039]),
)
def test_means_are_the_nearest_fixed_point_numbers(
    items: list[tuple[int, int, int, int]], lsb_per_g: float
) -> None:
    sums = [Sums(1, item[3], item[:3]) for item in items]
    points = to_points(sums, [7] * len(sums), lsb_per_g, temperature=False)
    scale = Fraction(lsb_per_g)
    expected = [[rounded(Fraction(axis * ONE) / (n * scale)) for axis in xyz] for *xyz, n in items]
    assert points.xyz.tolist() == expected
    assert points.weights.tolist() == [7] * len(items)
    assert points.xyz.dtype == np.int64 and points.xyz.shape == (len(items), 3)
    assert points.tau is None and points.temperature is None


@given(
    st.lists(
        st.tuples(st.integers(-60_000, 90_000), st.integers(1, 500), st.integers(1, 2**15)),
        min_size=1,
        max_size=8,
    )
)
def test_temperatures_are_scaled_about_their_weighted_mean_to_within_two(
    items: list[tuple[int, int, int]],
) -> None:
    sums = [Sums(1, n, (0, 0, 0), mean * n + n // 3) for mean, n, _ in items]
    weights = [weight for *_, weight in items]
    points = to_points(sums, weights, 256.0, temperature=True)
    means = [rounded(Fraction(item.temperature_mc, item.samples)) for item in sums]
    reference = rounded(Fraction(sum(w * m for w, m in zip(weights, means, strict=True)), sum(weights)))
    scale = points.temperature
    assert scale is not None and scale.reference_mc == reference
    assert (
        scale.span_c >= 1
        and scale.span_c.is_integer()
        and scale.span_c.hex().startswith("0x1.0000000000000p")
    )
    assert points.tau is not None
    assert points.tau.tolist() == [
        rounded((Fraction(s.temperature_mc, s.samples) - reference) / 1000 / Fraction(scale.span_c) * ONE)
        for s in sums
    ]
    widest = max(abs(mean - reference) for mean in means)
    assert widest < 2000 * scale.span_c
    assert scale.span_c == 1 or widest >= 1000 * scale.span_c
    assert abs(points.tau).max() < 2 * ONE


def test_no_points_have_no_temperature() -> None:
    points = to_points([], [], 256.0, temperature=True)
    assert len(points) == 0 and points.xyz.shape == (0, 3)
    assert points.tau is None and points.temperature is None


def test_the_scale_by_hand() -> None:
    sums = [Sums(1, 10, (0, 0, 0), 10 * mean) for mean in (27_000, 33_000)]
    points = to_points(sums, [1, 1], 256.0, temperature=True)
    assert points.temperature == TemperatureScale(30_000, 2.0)
    assert points.tau is not None and points.tau.tolist() == [-3 * ONE // 2, 3 * ONE // 2]
