"""Calibrated rows: the bits of their values, axes that are left out, and bounds of what they reach."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from accelcal_cli.core.calibration import Transform
from accelcal_cli.core.clock import StampClock
from accelcal_cli.core.recording import Chunk

ROWS = 20_000
COUNTS = np.random.default_rng(1).integers(-300, 300, (ROWS, 3)).astype(np.int16)
WARM = np.repeat(np.arange(100), ROWS // 100).astype(np.int32) * 37 + 20_000
LOWER = np.array([[1.02, 0, 0], [0.01, 0.98, 0], [0.02, -0.01, 1.01]])
NEARLY_DIAGONAL = np.array([[1.02, 0, 1e-5], [0, 0.98, 0], [0, 0, 1.01]])
OFFSET, SLOPE = np.array([0.01, -0.02, 0.03]), np.array([1e-3, 0, -2e-3])


def transform(gain: Any, slope: Any = (0, 0, 0), steps: float | None = None) -> Transform:
    return Transform(np.array(gain, float), OFFSET, np.array(slope, float), 24.5, 256.0, steps)


def fixed(gain: Any) -> Any:
    """A gain of 29 fraction bits, as fits have it."""
    return np.rint(np.array(gain) * 2**29) / 2**29


def with_rest(products: Any, gain: Any, warm: Any) -> Any:
    """(n,) K v of each axis in double, with what K makes of offsets and temperature, rounded once."""
    per_mc, constant = gain @ SLOPE / 1000, gain @ (OFFSET - SLOPE * 24.5)
    cold = gain @ OFFSET
    rest = [warm * per_mc[i] + constant[i] if warm is not None else cold[i] for i in range(3)]
    return [(row + rest[i]).astype(np.float32) for i, row in enumerate(products)]


@pytest.mark.parametrize("lsb_per_g", [256, 2048])
@pytest.mark.parametrize("gain", [LOWER, NEARLY_DIAGONAL])
@pytest.mark.parametrize("warm", [None, WARM])
@pytest.mark.parametrize("kind", ["<i2", "<i4", "<f8"])
@pytest.mark.parametrize("layout", ["C", "F"])
def test_products_of_whole_counts_and_a_gain_in_fixed_point_are_exact(
    lsb_per_g: int, gain: Any, warm: Any, kind: str, layout: Any
) -> None:
    gain = fixed(gain)
    applied = Transform(gain, OFFSET, SLOPE, 24.5, float(lsb_per_g))
    counts = np.array(np.random.default_rng(2).integers(-(2**15), 2**15, (ROWS, 3)), kind, order=layout)
    xyz = applied.apply(Chunk(0, counts, StampClock(np.arange(ROWS)), 0, temperature_mc=warm))
    sums = (gain * 2**29).astype(np.int64) @ counts.T.astype(np.int64)  # whole numbers, exact
    expected = with_rest(sums / (2**29 * lsb_per_g), gain, warm)
    assert all((a.view(np.uint32) == b.view(np.uint32)).all() for a, b in zip(xyz, expected, strict=True))


@pytest.mark.parametrize("lsb_per_g", [256.0, 300.0])
@pytest.mark.parametrize("gain", [LOWER, NEARLY_DIAGONAL])
@pytest.mark.parametrize("warm", [None, WARM])
def test_other_products_are_taken_in_an_order_that_never_changes(
    lsb_per_g: float, gain: Any, warm: Any
) -> None:
    applied = Transform(gain, OFFSET, SLOPE, 24.5, lsb_per_g)
    xyz = applied.apply(Chunk(0, COUNTS, StampClock(np.arange(ROWS)), 0, temperature_mc=warm))
    v = COUNTS.T / lsb_per_g
    products = []
    for row in range(3):
        product = gain[row, row] * v[row]
        for column in range(3):
            if column != row:
                product = product + gain[row, column] * v[column]
        products.append(product)
    expected = with_rest(products, gain, warm)
    assert all((a == b).all() for a, b in zip(xyz, expected, strict=True))


def test_values_are_those_of_the_formula() -> None:
    applied = Transform(LOWER, OFFSET, SLOPE, 24.5, 256.0)
    xyz = applied.apply(Chunk(0, COUNTS, StampClock(np.arange(ROWS)), 0, temperature_mc=WARM))
    warmth = WARM[:, np.newaxis].astype(np.longdouble) / 1000 - 24.5
    formula = (COUNTS / np.longdouble(256) + OFFSET + SLOPE * warmth) @ LOWER.T.astype(np.longdouble)
    for axis, values in enumerate(xyz):
        half = np.spacing(np.abs(values)) / 2
        assert (np.abs(values - formula[:, axis]) <= half * (1 + 1e-6)).all()


def test_axes_that_are_not_wanted_are_left_out() -> None:
    chunk = Chunk(0, COUNTS, StampClock(np.arange(ROWS)), 0, temperature_mc=WARM)
    applied = transform(LOWER, SLOPE)
    memory = [np.empty(0, np.float32), np.full(ROWS, np.nan, np.float32), np.empty(0, np.float32)]
    applied.apply_into(chunk, memory)
    assert (memory[1] == applied.apply(chunk)[1]).all()


@pytest.mark.parametrize("warm", [None, WARM])
@pytest.mark.parametrize("gain", [LOWER, NEARLY_DIAGONAL, -LOWER])
def test_no_value_goes_beyond_the_reach(gain: Any, warm: Any) -> None:
    applied = transform(gain, SLOPE)
    chunk = Chunk(0, COUNTS, StampClock(np.arange(ROWS)), 0, temperature_mc=warm)
    largest = np.array([np.abs(values).max() for values in applied.apply(chunk)])
    reach = applied.reach_g(chunk)
    assert (largest <= reach).all() and (reach < largest + 0.2).all()
