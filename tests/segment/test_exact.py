"""Fast sums at the limits of what a float holds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from accelcal_cli.segment.segmenter import exact_sums, exact_type, sums_of_squares


@pytest.mark.parametrize(
    ("bound", "kind"),
    [
        (0, np.float32),
        (2**24, np.float32),
        (2**24 + 1, np.float64),
        (2**53, np.float64),
        (2**53 + 1, np.int64),
        (2**63, np.int64),
    ],
)
def test_the_type_holds_every_integer_up_to_the_bound(bound: int, kind: type) -> None:
    assert exact_type(bound) is kind


@pytest.mark.parametrize("number", [511, 512, 513])
@pytest.mark.parametrize("value", [-32_768, 32_767, -32_767])
def test_sums_of_16_bits_about_two_to_the_24(number: int, value: int) -> None:
    blocks = np.full((3, 2, number), value, np.int16)
    assert exact_sums(blocks, number << 15).tolist() == [[value * number] * 2] * 3


def test_an_odd_sum_just_above_two_to_the_24_is_not_rounded() -> None:
    block = np.full((1, 513), 32_767, np.int16)
    block[0, 0] = 32_766
    assert exact_sums(block, 513 << 15).tolist() == [32_767 * 513 - 1]


@pytest.mark.parametrize("kind", [np.int32, pytest.param(np.int64, marks=pytest.mark.nightly)])
def test_an_odd_sum_just_above_two_to_the_53_is_not_rounded(kind: type) -> None:
    block = np.array([[1] + [2**30] * 2**23], kind)
    assert exact_sums(block, (2**23 + 1) << 30).tolist() == [2**53 + 1]


@pytest.mark.parametrize(
    "values",
    [[4096, 1], [4096], [94_906_265, 1], [94_906_267, 1], [2**26, 2**26], [2**26, 2**26, 1], [2**31 - 1, 1]],
)
def test_squares_about_two_to_the_24_and_the_53_are_not_rounded(values: list[int]) -> None:
    block = np.array([values, values[::-1]], np.int64)
    bound = len(values) * max(values) ** 2
    assert sums_of_squares(block, bound).tolist() == [sum(value * value for value in values)] * 2


@given(
    hnp.arrays(
        np.int32, st.tuples(st.integers(1, 4), st.integers(1, 50)), elements=st.integers(-(2**31), 2**31 - 1)
    )
)
def test_any_sums_and_squares_equal_pythons(blocks: np.ndarray) -> None:
    rows = blocks.tolist()
    largest = max(abs(value) for row in rows for value in row)
    number = blocks.shape[1]
    assert exact_sums(blocks, largest * number).tolist() == [sum(row) for row in rows]
    small = blocks.astype(np.int64) >> 4
    squares = [sum((value >> 4) ** 2 for value in row) for row in rows]
    assert sums_of_squares(small, ((largest >> 4) + 1) ** 2 * number).tolist() == squares
