"""Steps between times, against numpy's differences; whoever tells them tells the same."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.clock import Clock, JoinedClock, PageClock, StampClock, UniformClock
from accelcal_cli.core.steps import CACHED, WIDEST, Steps, joined_steps, steps_of

EVEN = st.lists(st.integers(-100, 150), min_size=1, max_size=60).map(lambda steps: np.cumsum(steps).tolist())
NEAR = st.lists(st.integers(0, 300), min_size=1, max_size=60)
FAR = st.lists(st.integers(-(1 << 62), 1 << 62), min_size=1, max_size=20)


def same(steps: Steps, times: np.ndarray[Any, Any]) -> None:
    """Assert that steps are those of times, in the one form that there is for them."""
    between = np.diff(times)
    least, most = (int(between.min()), int(between.max())) if len(between) else (0, 0)
    assert (steps.first_us, steps.last_us, steps.least_us) == (times[0], times[-1], least)
    assert steps.above.dtype == (np.uint8 if most - least <= 255 else np.int64)
    assert (steps.above.astype(np.int64) == between - least).all()
    assert len(steps) == len(times) and (steps.times() == times).all()


@given(st.one_of(EVEN, NEAR, FAR))
def test_steps_are_differences_and_give_the_times_back(times: list[int]) -> None:
    same(steps_of(np.array(times, np.int64)), np.array(times, np.int64))


@pytest.mark.parametrize("rows", [1, 2, CACHED, CACHED + 1, CACHED + 2, 2 * CACHED + 1])
@pytest.mark.parametrize("wide", [0, 1])
def test_so_they_are_of_long_stretches(rows: int, wide: int) -> None:
    between = np.random.default_rng(rows).integers(9_900, 9_900 + WIDEST + 1, rows - 1)
    between[-1:], between[:1] = 9_900 + WIDEST + wide, 9_900
    same(
        steps_of(1_700_000_000_000_000 + np.append(0, np.cumsum(between))),
        1_700_000_000_000_000 + np.append(0, np.cumsum(between)),
    )


@given(st.one_of(EVEN, NEAR, FAR), st.lists(st.integers(0, 60)))
def test_steps_of_parts_are_those_of_the_whole(times: list[int], cuts: list[int]) -> None:
    whole = np.array(times, np.int64)
    edges = sorted({0, len(times), *(cut for cut in cuts if cut < len(times))})
    same(joined_steps([steps_of(whole[low:high]) for low, high in pairwise(edges)]), whole)


def test_parts_by_hand() -> None:
    parts = [steps_of(np.array(times, np.int64)) for times in ([3, 8, 17], [37, 41], [45, 52], [50])]
    steps = joined_steps(parts)
    assert (steps.first_us, steps.last_us, steps.least_us) == (3, 50, -2)
    assert steps.above.dtype == np.uint8 and steps.above.tolist() == [7, 11, 22, 6, 6, 9, 0]


PAGES = st.lists(
    st.tuples(st.integers(1, 6), st.integers(0, 1200), st.integers(1, 6), st.integers(0, 600)),
    min_size=1,
    max_size=6,
)


def asked(clock: Clock, one: int, other: int) -> None:
    """Assert that a clock's steps are those of its times, from the smaller row on, of one row at least."""
    start, stop = min(one, other), max(one, other) + 1
    same(clock.steps(start, stop), clock.times(start, stop))


@given(PAGES, st.integers(0, 3), st.integers(0, 40), st.integers(0, 40))
def test_those_of_pages(pages: list[tuple[int, ...]], before: int, one: int, other: int) -> None:
    lengths, *columns = (np.array([page[i] for page in pages], np.int64) for i in range(4))
    asked(PageClock(np.append(0, np.cumsum(lengths[:-1])) - before, *columns), one, other)


@given(
    st.integers(1, 8),
    st.lists(st.tuples(st.integers(-40, 40), st.sampled_from([640, 648, 700, 3000])), min_size=2, max_size=9),
    st.integers(0, 7),
    st.integers(0, 71),
    st.integers(0, 71),
)
def test_those_of_pages_that_are_full(
    rows: int, pages: list[tuple[int, int]], before: int, one: int, other: int
) -> None:
    """Where a page that is left out, or cut off, has the shortest step, it is that of the others."""
    offs, spans = (np.array([page[i] for page in pages], np.int64) for i in (0, 1))
    first, last = -min(before, rows - 1), rows * len(pages) - 1
    begins = 1_700_000_000_000_000 + 648 * np.arange(len(pages)) + offs
    clock = PageClock(
        first + rows * np.arange(len(pages), dtype=np.int64),
        begins,
        np.full(len(pages), rows, np.int64),
        spans,
    )
    asked(clock, min(one, first + last), min(other, first + last))


def test_those_of_pages_of_damaged_times() -> None:
    """Steps that differ by more than 64 bits hold: 2**62 forward and back again."""
    times = np.array([0, 1 << 62, 0, 100], np.int64)
    clock = PageClock(np.arange(0, 8, 2), times, np.full(4, 2), np.full(4, 20))
    asked(clock, 0, 7)


@given(
    st.sampled_from([Fraction(100), Fraction(857, 10), Fraction(7), Fraction(1, 3)]),
    st.lists(st.integers(0, 30_000), min_size=1, max_size=9),
    st.integers(0, 40),
    st.integers(0, 40),
)
def test_those_of_the_other_clocks(rate: Fraction, stamps: list[int], one: int, other: int) -> None:
    uniform, later = UniformClock(17, 3, rate), StampClock(np.array(stamps * 40, np.int64))
    for clock in (uniform, later, JoinedClock(uniform, 12, later), JoinedClock(later, 12, uniform)):
        asked(clock, one, other)
