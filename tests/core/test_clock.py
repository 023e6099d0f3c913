"""Clocks against exact rational rounding."""

from __future__ import annotations

import re
from fractions import Fraction
from itertools import pairwise
from math import floor
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.clock import (
    ABBREVIATIONS,
    CACHED,
    FIRST_US,
    LAST_US,
    WIDEST,
    Clock,
    JoinedClock,
    PageClock,
    StampClock,
    TimeSteps,
    UniformClock,
    iso_time,
    joined_steps,
    quotients,
    rate_fraction,
    steps_of,
    utc_offset_s,
)
from accelcal_cli.core.errors import UsageError

HALF = Fraction(1, 2)
RATES = st.builds(Fraction, st.integers(1, 10_000_000), st.integers(1, 10_000))
STARTS = st.integers(-(2**52), 2**52)


def exact_time(start_us: int, sample: int, rate: Fraction) -> int:
    return start_us + floor(Fraction(sample) * 1_000_000 / rate + HALF)


@given(STARTS, st.integers(0, 10**8), RATES, st.integers(0, 1000), st.integers(0, 20))
def test_uniform_times_are_the_nearest_microsecond(
    start_us: int, first: int, rate: Fraction, start: int, number: int
) -> None:
    times = UniformClock(start_us, first, rate).times(start, start + number)
    assert times.dtype == np.int64
    assert times.tolist() == [exact_time(start_us, first + start + k, rate) for k in range(number)]


def test_a_month_at_an_awkward_rate_stays_exact_in_the_last_row_of_a_large_chunk() -> None:
    rate = Fraction(999_983, 10_000)
    first, rows = 30 * 86_400 * 100, 500_000
    times = UniformClock(1_709_510_400_000_000, first, rate).times(0, rows)
    assert times[-1] == exact_time(1_709_510_400_000_000, first + rows - 1, rate)
    assert (np.diff(times) > 0).all()


@pytest.mark.parametrize(
    ("rate_hz", "expected"),
    [
        (100.0, Fraction(100)),
        (12.5, Fraction(25, 2)),
        (85.7, Fraction(857, 10)),
        (99.97, Fraction(9997, 100)),
        (100 / 3, Fraction(100, 3)),
        (0.1, Fraction(1, 10)),
    ],
)
def test_a_rate_becomes_the_fraction_that_was_meant(rate_hz: float, expected: Fraction) -> None:
    assert rate_fraction(rate_hz) == expected


def test_stamps_are_passed_on() -> None:
    stamps = np.array([5, 7, 7, 20, 19], np.int64)
    assert StampClock(stamps).times(1, 4).tolist() == [7, 7, 20]
    assert StampClock(stamps).times(2, 2).tolist() == []


PAGES = st.lists(
    st.tuples(st.integers(1, 30), st.integers(-(2**50), 2**50), st.integers(1, 400), st.integers(0, 10**9)),
    min_size=1,
    max_size=6,
)


@given(PAGES, st.integers(0, 10), st.integers(0, 60))
def test_page_times_are_spread_evenly_from_each_pages_stamp(
    pages: list[tuple[int, int, int, int]], before: int, row: int
) -> None:
    lengths = [page[0] for page in pages]
    first = np.concatenate([[0], np.cumsum(lengths[:-1])]).astype(np.int64) - before
    times, rows, spans = (np.array([page[i] for page in pages], np.int64) for i in (1, 2, 3))
    page = max(index for index, value in enumerate(first) if value <= row)
    into = Fraction((row - int(first[page])) * int(spans[page]), int(rows[page]))
    clock = PageClock(first, times, rows, spans)
    assert clock.times(row, row + 1).tolist() == [int(times[page]) + floor(into + HALF)]


@given(PAGES, st.integers(0, 80), st.integers(0, 80))
def test_page_times_do_not_depend_on_where_they_are_asked_from(
    pages: list[tuple[int, int, int, int]], one: int, other: int
) -> None:
    lengths = [page[0] for page in pages]
    first = np.concatenate([[0], np.cumsum(lengths[:-1])]).astype(np.int64)
    clock = PageClock(first, *(np.array([page[i] for page in pages], np.int64) for i in (1, 2, 3)))
    cut, end = sorted((one, other))
    parts = np.concatenate([clock.times(0, cut), clock.times(cut, end)])
    assert parts.tolist() == clock.times(0, end).tolist()


def test_two_pages_by_hand() -> None:
    clock = PageClock(
        np.array([-2, 2], np.int64),
        np.array([1000, 9000], np.int64),
        np.array([4, 3], np.int64),
        np.array([6, 10], np.int64),
    )
    # page 0: 1.5 us a row, row 0 is its third; page 1: 3.333 us a row
    assert clock.times(0, 5).tolist() == [1003, 1005, 9000, 9003, 9007]


@given(
    st.integers(1, 30),
    st.lists(st.tuples(st.integers(-(2**50), 2**50), st.integers(0, 10**9)), min_size=1, max_size=6),
    st.integers(0, 180),
    st.integers(0, 180),
    st.integers(0, 10),
)
def test_full_pages_are_spread_like_any_others(
    rows: int, pages: list[tuple[int, int]], one: int, other: int, before: int
) -> None:
    start, stop = sorted((one, other))
    columns = [np.array([page[i] for page in pages], np.int64) for i in (0, 1)]
    first = rows * np.arange(len(pages), dtype=np.int64) - min(before, rows - 1)
    clock = PageClock(first, columns[0], np.full(len(pages), rows, np.int64), columns[1])
    expected = []
    for row in range(start, stop):
        page = min((row - int(first[0])) // rows, len(pages) - 1)
        into = Fraction((row - int(first[page])) * pages[page][1], rows)
        expected.append(pages[page][0] + floor(into + HALF))
    assert clock.times(start, stop).tolist() == expected


@pytest.mark.parametrize(
    ("time_us", "shown"),
    [
        (FIRST_US, "0001-01-01T00:00:00.000000"),
        (LAST_US, "9999-12-31T23:59:59.999999"),
        (LAST_US + 1, "+10000-01-01T00:00:00.000000"),
        (LAST_US + 1 + 366 * 86_400_000_000, "+10001-01-01T00:00:00.000000"),
        (FIRST_US - 1, "+00000-12-31T23:59:59.999999"),
        (1 << 62, "+148108-07-06T14:00:27.387904"),
    ],
)
def test_times_beyond_the_calendar_are_written_in_the_expanded_form(time_us: int, shown: str) -> None:
    """The last one by hand: 2**62 us are 53 375 995 days and 50 427.387904 s, 146 097 days in 400 years."""
    assert iso_time(time_us, None) == shown
    assert iso_time(time_us, 3600) == f"{shown}+01:00"


@given(
    st.integers(-(1 << 50), 1 << 50),
    st.integers(-(1 << 31), 1 << 31),
    st.one_of(st.integers(1, 2000), st.integers(1, 1 << 31)),
    st.integers(0, 5000),
)
def test_quotients_are_those_of_python(first: int, step: int, divisor: int, number: int) -> None:
    expected = [(first + place * step) // divisor for place in range(number)]
    assert quotients(first, step, divisor, number).tolist() == expected


@given(st.integers(-50, 0), st.integers(1, 200), st.integers(0, 3_000_000), st.data())
def test_times_of_one_page_are_those_of_several(first: int, rows: int, span_us: int, data: Any) -> None:
    number = data.draw(st.integers(1, 5000))
    start = data.draw(st.integers(0, number - 1))
    clock = PageClock(*(np.array([value]) for value in (first, 7_000_000, rows, span_us)))
    expected = [
        7_000_000 + (2 * (row - first) * span_us + rows) // (2 * rows) for row in range(start, number)
    ]
    assert clock.times(start, number).tolist() == expected


EVEN = st.lists(st.integers(-100, 150), min_size=1, max_size=60).map(lambda steps: np.cumsum(steps).tolist())
NEAR = st.lists(st.integers(0, 300), min_size=1, max_size=60)
FAR = st.lists(st.integers(-(1 << 62), 1 << 62), min_size=1, max_size=20)


def same(steps: TimeSteps, times: np.ndarray[Any, Any]) -> None:
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


STEP_PAGES = st.lists(
    st.tuples(st.integers(1, 6), st.integers(0, 1200), st.integers(1, 6), st.integers(0, 600)),
    min_size=1,
    max_size=6,
)


def asked(clock: Clock, one: int, other: int) -> None:
    """Assert that a clock's steps are those of its times, from the smaller row on, of one row at least."""
    start, stop = min(one, other), max(one, other) + 1
    same(clock.steps(start, stop), clock.times(start, stop))


@given(STEP_PAGES, st.integers(0, 3), st.integers(0, 40), st.integers(0, 40))
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


@pytest.mark.parametrize(
    ("zone", "place", "offset"),
    [
        ("CET", "Europe/Berlin", "+01:00"),
        ("est", "America/New_York", "-05:00"),
        ("AEST", "Australia/Sydney", "+10:00"),
    ],
)
def test_d13_an_abbreviation_is_answered_with_a_place_and_an_offset_that_work(
    zone: str, place: str, offset: str
) -> None:
    with pytest.raises(UsageError) as caught:
        utc_offset_s(zone, 0)
    assert str(caught.value) == (
        f"time zone {zone!r} does not say whether its clocks change in summer; give {place} if they do, or "
        f"{offset} if not"
    )
    assert utc_offset_s(offset, 0) in {
        utc_offset_s(place, month * 31 * 86_400 * 10**6) for month in range(12)
    }


@pytest.mark.parametrize("zone", list(ABBREVIATIONS))
def test_d13_each_abbreviation_stands_for_what_its_place_has_at_some_time_of_the_year(zone: str) -> None:
    place, offset = ABBREVIATIONS[zone]
    there = {utc_offset_s(place, month * 31 * 86_400 * 10**6) for month in range(600)}
    assert utc_offset_s(offset, 0) in there


@pytest.mark.parametrize(
    ("zone", "hint"), [("Europe/Berln", "did you mean 'Europe/Berlin'?"), ("IST", "give a name")]
)
def test_d13_what_is_suggested_is_not_what_was_refused(zone: str, hint: str) -> None:
    with pytest.raises(UsageError, match=f"unknown time zone '{zone}'; {re.escape(hint)}"):
        utc_offset_s(zone, 0)
