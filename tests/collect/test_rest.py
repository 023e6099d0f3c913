"""What rest measures: quantiles, extremes, axes that are alike, whatever the batches."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from accelcal_cli.collect.cells import Histogram
from accelcal_cli.collect.rest import SAMPLE_STEP, RestSums
from accelcal_cli.core.clock import UniformClock
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, Validity
from tests.collect.made import windows

LENGTH = 8
CLOCK = UniformClock(0, 0, Fraction(25))


def of_g(*vectors: tuple[float, float, float]) -> Windows:
    """Windows of these means [g], at 1000 counts per g."""
    return windows(LENGTH, [tuple(round(1000 * LENGTH * value) for value in vector) for vector in vectors])


def test_quantiles_extremes_and_error() -> None:
    sums = RestSums(1000.0)
    sums.add_windows(of_g((0, 0, 1.0), (0, 0.1, -0.9), (2.0, 0.2, 0)))
    rest = sums.result()
    assert (rest.windows, rest.median_g, rest.p5_g) == (3, 1.0, pytest.approx(0.9055, rel=0.005))
    assert rest.p95_g == pytest.approx(2.00998, rel=0.005)
    assert rest.axis_min_g == (0.0, 0.0, -0.9) and rest.axis_max_g == (2.0, 0.2, 1.0)
    assert rest.error_mg == pytest.approx((0 + 1000 - 905.5385) / 2, abs=1e-4)
    assert rest.alike == ()


def test_axes_that_are_alike_in_every_window() -> None:
    sums = RestSums(1000.0)
    sums.add_windows(of_g((0.5, 0.5, 1.0), (0.5, 0.5, 0.5)))
    assert sums.result().alike == ("x", "y")
    sums.add_windows(of_g((0.5, 0.4, 0.5)))
    assert sums.result().alike == ()


@pytest.mark.parametrize("cut", [1, SAMPLE_STEP, 1000])
def test_samples_are_taken_at_the_same_places_in_any_chunks(cut: int) -> None:
    counts = np.zeros((2 * SAMPLE_STEP + 1, 3), np.int16)
    counts[[0, SAMPLE_STEP, 2 * SAMPLE_STEP], 0] = 100, 3000, 2000
    validity = np.zeros(len(counts), np.uint8)
    validity[0] = Validity.FILLED
    sums = RestSums(1000.0)
    for start in range(0, len(counts), cut):
        part = slice(start, start + cut)
        sums.add_samples(Chunk(start, counts[part], CLOCK, 0, validity=validity[part]))
    assert sums.result().samples_median_g == 2.0


def test_a_quantile_is_the_smallest_value_that_enough_others_do_not_exceed() -> None:
    held = Histogram()
    assert held.quantile(50) is None
    held.add(np.array([1, 2, 3, 200, 100_000]))
    assert [held.quantile(percent) for percent in (0, 20, 50, 80)] == [1, 1, 3, 200]
    assert held.quantile(100) == 100_000 >> 9 << 9
