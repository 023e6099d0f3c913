"""The still rule against Fractions, exactly at its borders."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from accelcal_cli.segment import StillRule, still_rule
from tests.segment.streams import Stream, naive_still, segmented, variance

LEAST = Fraction(1, 10**15)


def still(block: np.ndarray, rule: StillRule) -> bool:
    found, counts = segmented(Stream(block), len(block), rule)
    assert counts.complete == 1 and counts.still + counts.moving == 1
    return bool(found)


@pytest.mark.parametrize(
    ("lsb_per_g", "threshold_g", "limit"),
    [
        (256, 0.12, 31),
        (250, 0.12, 30),
        (1 << 24, 0.12, 2_013_266),
        (341, 0.1, 35),
        (1000, 0.001, 1),
        (83.3, 0.12, 10),
    ],
)
def test_a_threshold_in_g_becomes_the_exact_limit_in_counts(
    lsb_per_g: float, threshold_g: float, limit: int
) -> None:
    rule = still_rule((0,), threshold_g, None, lsb_per_g)
    assert rule == StillRule((0,), limit, None)


@pytest.mark.parametrize(("kind", "lsb_per_g"), [(np.int16, 250), (np.int16, 256), (np.int32, 1 << 24)])
def test_a_window_whose_spread_reaches_the_threshold_is_moving(kind: type, lsb_per_g: int) -> None:
    rule = still_rule((0, 1, 2), 0.12, None, lsb_per_g)
    threshold = Fraction(12, 100) * lsb_per_g
    for spread in range(int(threshold) - 1, int(threshold) + 3):
        for axis in range(3):
            block = np.full((8, 3), -lsb_per_g, kind)
            block[5, axis] += spread
            assert still(block, rule) == (spread < threshold)


def test_an_axis_that_the_rule_does_not_look_at_may_move() -> None:
    block = np.zeros((6, 3), np.int16)
    block[3, 1:] = 1000
    assert still(block, StillRule((0,), 10, None))
    assert not still(block, StillRule((1,), 10, None))
    assert not still(block, StillRule((0, 1, 2), 10, None))
    assert not still(block, StillRule((0,), 10, Fraction(9)))


def test_the_deviation_is_squared_exactly() -> None:
    assert still_rule((0,), 0.12, 0.013, 256).variance_limit == Fraction(3328, 1000) ** 2


BLOCKS16 = hnp.arrays(np.int16, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(-60, 60))


@given(BLOCKS16, st.integers(-32_000, 32_000), st.integers(0, 2))
def test_a_variance_exactly_at_the_limit_is_moving(block: np.ndarray, origin: int, axis: int) -> None:
    block = block + np.int16(origin)
    border = max(variance(block[:, column]) for column in range(3))
    assert not still(block, StillRule((axis,), 1000, border))
    assert still(block, StillRule((axis,), 1000, border + LEAST))


@given(
    hnp.arrays(np.int32, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(-(10**6), 10**6)),
    st.integers(-(2**31) + 10**6, 2**31 - 1 - 10**6),
)
def test_a_variance_exactly_at_the_limit_is_moving_in_32_bits(block: np.ndarray, origin: int) -> None:
    block = (block.astype(np.int64) + origin).astype(np.int32)
    border = max(variance(block[:, column]) for column in range(3))
    assert not still(block, StillRule((0, 1, 2), 1 << 22, border))
    assert still(block, StillRule((0, 1, 2), 1 << 22, border + LEAST))


@pytest.mark.parametrize(
    ("kind", "origin", "size"),
    [
        (np.int16, 32_700, 9),
        (np.int16, -32_000, 700),
        (np.int32, 1 << 24, 200_000),
        (np.int32, -(1 << 30), 3),
    ],
)
def test_the_border_is_exact_in_windows_of_4000_samples(kind: type, origin: int, size: int) -> None:
    draw = np.random.default_rng(size)
    block = (origin + draw.integers(-size, size + 1, (4000, 3))).astype(kind)
    border = max(variance(block[:, column]) for column in range(3))
    assert not still(block, StillRule((0, 1, 2), 1 << 40, border))
    assert still(block, StillRule((0, 1, 2), 1 << 40, border + LEAST))


@given(
    BLOCKS16,
    st.integers(1, 130),
    st.none() | st.fractions(0, 3000, max_denominator=10**6),
    st.sampled_from([(0,), (2,), (0, 1), (0, 1, 2)]),
)
def test_the_rule_equals_fractions(
    block: np.ndarray, limit: int, border: Fraction | None, axes: tuple[int, ...]
) -> None:
    rule = StillRule(axes, limit, border)
    assert still(block, rule) == naive_still(block.tolist(), rule)


def test_a_huge_spread_on_an_axis_beside_the_rule_is_never_still() -> None:
    block = np.zeros((400, 3), np.int32)
    block[::2, 1], block[1::2, 1] = -(1 << 31), (1 << 31) - 1
    assert not still(block, StillRule((0,), 10, Fraction(9)))


def test_a_deviation_beyond_64_bits_leaves_every_window_still() -> None:
    rule = still_rule((), None, 0.013, 1e200)
    columns = np.array([[[-(1 << 31), (1 << 31) - 1] * 2]] * 3)
    assert rule.still(columns, np.full((3, 1), (1 << 32) - 1), columns.sum(axis=2)).tolist() == [True]
