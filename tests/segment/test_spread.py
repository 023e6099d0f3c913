"""How much a window varies, and the least of it, against Fractions and the formula of rounding."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from accelcal_cli.segment.adaptive import MOVING, NEVER, LeastSpread, norm_bits, norms, squares, steps
from tests.segment.streams import variance

NO_WINDOW = np.empty(0, np.int64)


@pytest.mark.parametrize("lsb_per_g", [1.0, 83.3, 256.0, 341.0, 16_384.0, 65_536.0, 2.0**24, 3e8])
def test_one_g_has_between_2_to_the_16_and_17_units(lsb_per_g: float) -> None:
    assert 2**16 <= lsb_per_g * 2.0 ** norm_bits(lsb_per_g) < 2**17


@given(
    hnp.arrays(np.int32, (3, 1, 7), elements=st.integers(-(2**31), 2**31 - 1)), st.sampled_from([-8, 0, 9])
)
def test_norms_are_correctly_rounded_roots(columns: np.ndarray, bits: int) -> None:
    rows = columns[:, 0].T.tolist()
    expected = [
        round(math.ldexp(math.sqrt(float(x) * x + float(y) * y + float(z) * z), bits)) for x, y, z in rows
    ]
    assert norms(columns, bits)[0].tolist() == expected


@given(hnp.arrays(np.int64, (3, 9), elements=st.integers(-(2**40), 2**40)), st.integers(1, 10**6))
def test_squares_are_n_times_the_variance_rounded_up(blocks: np.ndarray, size: int) -> None:
    blocks = blocks // (2**40 // size)
    for block, found in zip(blocks, squares(blocks, 1 << 16).tolist(), strict=True):
        wide = int(np.ptp(block)) >= 1 << 16
        assert found == (MOVING if wide else math.ceil(9 * variance(block.tolist())))


def test_steps_are_the_smallest_differences_that_are_not_zero() -> None:
    columns = np.array([[[0, 0, 7], [5, 5, 5]], [[4, 1, 1], [9, 9, 9]], [[0, 50, 0], [0, 0, 0]]], np.int16)
    assert steps(columns, 1000).tolist() == [3, 1000]
    assert steps(columns, 2).tolist() == [2, 2]


def follow(least: LeastSpread, found: list[int], columns: np.ndarray) -> list[int]:
    at = np.arange(len(found))
    return least.follow(np.array(found), columns, at).tolist()


@pytest.mark.parametrize(
    ("axes", "bits", "step", "floor"),
    [
        (1, 0, 6, 300),
        (3, 0, 2, 100),
        (1, 4, 1, 2133),
        (1, -1, 8, 133),
        (1, -8, 1, 1),
        (3, 8, 10, 163_840_000),
    ],
)
def test_the_minimum_never_falls_below_the_rounding_to_the_steps(
    axes: int, bits: int, step: int, floor: int
) -> None:
    """100 samples: 100 axes step^2 4^bits / 12."""
    least = LeastSpread(100, axes, 1000, bits)
    columns = np.tile(np.arange(100) * step, (axes, 1, 1))
    assert follow(least, [1], columns) == [floor]
    assert follow(least, [floor + 5], columns) == [floor]


def test_the_minimum_follows_from_window_to_window() -> None:
    least = LeastSpread(3, 1, 4, 0)
    assert least.now() == NEVER
    columns = np.array([[[0, 4, 0]] * 5])
    assert follow(least, [90, MOVING, 0, 50, 70], columns) == [90, 90, 90, 50, 50]
    assert follow(least, [60, 20], columns[:, :2]) == [50, 20]
    assert least.now() == 20


def test_windows_that_were_not_measured_have_no_part() -> None:
    least = LeastSpread(3, 1, 4, 0)
    columns = np.array([[[0, 4, 0], [0, 4, 0]]])
    found = least.follow(np.array([90, 5, 50]), columns, np.array([0, 2]))
    assert found.tolist() == [90, 90, 50]
    assert least.follow(np.array([7]), columns[:, :0], NO_WINDOW).tolist() == [50]
