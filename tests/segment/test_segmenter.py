"""The segmenter against its definition in plain Python, however the rows are chunked."""

from __future__ import annotations

import sys
import weakref
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from types import FrameType
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from accelcal_cli.core.points import WindowCounts
from accelcal_cli.core.recording import Validity
from accelcal_cli.segment import StillRule, still_rule
from accelcal_cli.segment.segmenter import Segmenter
from tests.segment.streams import Stream, naive, rows, segmented

TraceFunction = Callable[[FrameType, str, Any], Any]
ANYTHING = StillRule((0, 1, 2), 1 << 40, None)
RULES = st.builds(
    StillRule,
    st.sampled_from([(0,), (1,), (0, 2), (0, 1, 2)]),
    st.integers(1, 8),
    st.none() | st.fractions(0, 8, max_denominator=50),
)


@st.composite
def streams(draw: st.DrawFn, kind: type = np.int16) -> Stream:
    number = draw(st.integers(0, 50))
    places = st.integers(0, max(0, number - 1))
    counts = draw(hnp.arrays(kind, (number, 3), elements=st.integers(-4, 4)))
    validity = draw(st.none() | hnp.arrays(np.uint8, number, elements=st.sampled_from([0] * 9 + [1, 2, 3])))
    warm = draw(st.none() | hnp.arrays(np.int32, number, elements=st.integers(-40_000, 60_000)))
    breaks = draw(st.lists(places, max_size=4)) if number else []
    return Stream(counts, tuple(breaks), warm, validity)


CUTS = st.lists(st.integers(0, 50), max_size=12)


def within(cuts: list[int], stream: Stream) -> list[int]:
    return [min(cut, len(stream.counts)) for cut in cuts]


@given(streams(), st.integers(1, 9), RULES, CUTS)
def test_any_chunking_gives_the_windows_of_the_definition(
    stream: Stream, length: int, rule: StillRule, cuts: list[int]
) -> None:
    expected = naive(stream, length, rule)
    assert segmented(stream, length, rule) == expected
    assert segmented(stream, length, rule, within(cuts, stream)) == expected
    assert segmented(stream, length, rule, range(len(stream.counts))) == expected


@given(streams(np.int32), st.integers(1, 9), RULES, CUTS)
def test_32_bit_counts_are_treated_alike(
    stream: Stream, length: int, rule: StillRule, cuts: list[int]
) -> None:
    far = replace(stream, counts=stream.counts + np.int32(2_130_000_000))
    assert segmented(far, length, rule, within(cuts, far)) == naive(far, length, rule)


def test_what_is_left_before_a_break_is_not_used() -> None:
    stream = Stream(np.zeros((20, 3), np.int16), breaks=(7,))
    found, counts = segmented(stream, 5, ANYTHING)
    assert [row[0] for row in found] == [0, 7, 12]
    assert counts == WindowCounts(complete=3, still=3)


@pytest.mark.parametrize("flag", [Validity.FILLED, Validity.CLIPPED, Validity.RECOVERED])
def test_one_row_that_was_not_measured_spoils_its_window_alone(flag: Validity) -> None:
    validity = np.zeros(15, np.uint8)
    validity[9] = flag
    stream = Stream(np.zeros((15, 3), np.int16), validity=validity)
    found, counts = segmented(stream, 5, ANYTHING)
    assert [row[0] for row in found] == [0, 10]
    assert counts == WindowCounts(complete=3, still=2, **{flag.name.lower(): 1})


def test_a_window_is_counted_once_by_its_worst_row() -> None:
    validity = np.array([3, 2, 1, 3, 2, 0, 3, 0, 0], np.uint8)
    stream = Stream(np.zeros((9, 3), np.int16), validity=validity)
    _, counts = segmented(stream, 3, ANYTHING)
    assert counts == WindowCounts(complete=3, filled=1, clipped=1, recovered=1)


@given(CUTS)
@example([1])
def test_chunks_that_know_no_validity_join_chunks_that_do(cuts: list[int]) -> None:
    validity = np.zeros(12, np.uint8)
    validity[[2, 11]] = Validity.FILLED
    stream = Stream(np.zeros((12, 3), np.int16), validity=validity)
    found, counts = segmented(stream, 4, ANYTHING, [min(cut, 12) for cut in cuts])
    assert [row[0] for row in found] == [4]
    assert counts == WindowCounts(complete=3, still=1, filled=2)


def test_a_pending_stretch_does_not_keep_its_chunk_alive() -> None:
    segmenter = Segmenter(10, ANYTHING)
    counts, warm = np.zeros((15, 3), np.int16), np.zeros(15, np.int32)
    first, second = Stream(np.concatenate([counts, counts]), temperature_mc=np.tile(warm, 2)).chunks([15])
    alive = [weakref.ref(counts), weakref.ref(warm)]
    first = replace(first, counts=counts[:], temperature_mc=warm[:])
    list(segmenter.feed(first))
    del first, counts, warm
    assert [kept() for kept in alive] == [None, None]
    assert [first for windows in segmenter.feed(second) for first in windows.first_sample] == [10, 20]


@pytest.mark.parametrize(
    ("kind", "lsb_per_g"),
    [
        (np.int16, 256),
        *(
            pytest.param(*finer, marks=pytest.mark.nightly)
            for finer in ((np.int16, 2048), (np.int32, 1 << 24))
        ),
    ],
)
def test_long_windows_of_real_size_equal_the_definition(kind: type, lsb_per_g: int) -> None:
    draw = np.random.default_rng(lsb_per_g)
    noise_g = np.repeat([0.012, 0.0129, 0.01305, 0.02, 0.04, 0.012], 4000)[:, None]
    g = np.array([0.2, -0.7, 0.68]) + noise_g * draw.standard_normal((24_000, 3))
    stream = Stream(np.rint(g * lsb_per_g).astype(kind), breaks=(20_001,))
    for rule in (
        still_rule((0, 1, 2), 0.12, 0.013, lsb_per_g),
        still_rule((0,), 0.09, None, lsb_per_g),
        StillRule((0, 1, 2), 1 << 33, (Fraction(13, 1000) * lsb_per_g) ** 2),
    ):
        expected = naive(stream, 4000, rule)
        assert segmented(stream, 4000, rule) == expected
        assert segmented(stream, 4000, rule, (1, 3999, 8000, 19_999)) == expected


def test_sums_are_exact_at_the_ends_of_each_type() -> None:
    for kind, number in ((np.int16, 513), (np.int32, 4000)):
        low, high = np.iinfo(kind).min, np.iinfo(kind).max
        counts = np.tile(np.array([low, high, high - 1], kind), (number, 1))
        ((_, sums, spread, _),), _ = segmented(Stream(counts), number, ANYTHING)
        assert sums == (low * number, high * number, (high - 1) * number)
        assert spread == (0, 0, 0)


def test_a_spread_over_the_whole_type_does_not_wrap() -> None:
    for kind in (np.int16, np.int32):
        low, high = np.iinfo(kind).min, np.iinfo(kind).max
        counts = np.array([[low, 0, high], [high, 0, low]], kind)
        ((_, _, spread, _),), _ = segmented(Stream(counts), 2, ANYTHING)
        assert spread == (high - low, 0, high - low)


def test_feeding_nothing_gives_nothing() -> None:
    segmenter = Segmenter(3, ANYTHING)
    (chunk,) = Stream(np.zeros((0, 3), np.int16)).chunks()
    assert [row for windows in segmenter.feed(chunk) for row in rows(windows)] == []
    assert segmenter.counts == WindowCounts()


def lines_run(stream: Stream) -> int:
    """How many lines of the segmenter a stream takes."""
    lines = 0

    def count(frame: FrameType, event: str, _: object) -> TraceFunction | None:
        nonlocal lines
        lines += event == "line"
        return count if frame.f_code.co_filename == Segmenter.feed.__code__.co_filename else None

    before = sys.gettrace()
    sys.settrace(count)
    try:
        segmented(stream, 100, ANYTHING, [1000, 2000])
    finally:
        sys.settrace(before)
    return lines


def test_runs_too_short_for_a_window_cost_nothing() -> None:
    few, many = (Stream(np.zeros((4000, 3), np.int16), tuple(range(1500, 3000, step))) for step in (90, 1))
    assert segmented(many, 100, ANYTHING, [1000, 2000]) == naive(many, 100, ANYTHING)
    assert 50 < lines_run(many) < 2 * lines_run(few) < 1000
