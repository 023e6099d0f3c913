"""Windows that go on over short gaps of a clock that jitters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.points import WindowCounts
from accelcal_cli.core.settings import DEFAULT, PAPER, POSES, PoseSettings, Settings
from accelcal_cli.segment import StillRule, short_gaps
from accelcal_cli.segment.adaptive import AdaptiveRule
from accelcal_cli.segment.segmenter import NO_GAPS, Segmenter, ShortGaps, TimedSegmenter
from tests.segment.streams import Stream, batched, naive, segmented
from tests.segment.test_adaptive import LSB_PER_G, NUMBERS, N, rest
from tests.segment.test_segmenter import ANYTHING, CUTS, RULES, streams, within

PERIOD_US = 10
GAPS = ShortGaps(longest_us=100, together_us=150)


def jumping(number: int, jumps: dict[int, int], breaks: tuple[int, ...] = ()) -> Stream:
    """Rows 10 us apart, with other steps before some of them, which the reader calls jumps of the clock."""
    steps = np.full(number, PERIOD_US)
    for row, step_us in jumps.items():
        steps[row] = step_us
    counts = np.zeros((number, 3), np.int16)
    return Stream(counts, breaks, jumps=tuple(jumps), times_us=1_000_000 + np.cumsum(steps))


@st.composite
def jittery(draw: st.DrawFn) -> Stream:
    """Any stream, and steps of every size before some of its rows; damage may be at the same place."""
    stream = draw(streams())
    number = len(stream.counts)
    steps = draw(st.lists(st.sampled_from([PERIOD_US] * 3 + [-101, -100, -1, 1, 99, 100, 101]),
                          min_size=number, max_size=number))  # fmt: skip
    jumps = [row for row, step in enumerate(steps) if row and step != PERIOD_US]
    return replace(stream, jumps=tuple(jumps), times_us=np.cumsum(np.array(steps, np.int64)))


@given(jittery(), st.integers(1, 9), RULES, CUTS, st.sampled_from([NO_GAPS, GAPS, ShortGaps(100, 10_000)]))
def test_any_chunking_gives_the_windows_of_the_definition(
    stream: Stream, length: int, rule: StillRule, cuts: list[int], gaps: ShortGaps
) -> None:
    expected = naive(stream, length, rule, gaps)
    assert segmented(stream, length, rule, (), gaps) == expected
    assert segmented(stream, length, rule, within(cuts, stream), gaps) == expected
    assert segmented(stream, length, rule, range(len(stream.counts)), gaps) == expected


def starts(stream: Stream, gaps: ShortGaps = GAPS) -> list[int]:
    """First samples of the windows of five, whichever way the stream is cut."""
    ways = [(), range(len(stream.counts)), (4, 5, 6)]
    (found,) = {tuple(row[0] for row in segmented(stream, 5, ANYTHING, cuts, gaps)[0]) for cuts in ways}
    return list(found)


@pytest.mark.parametrize(("step_us", "expected"), [(100, [0, 5]), (-100, [0, 5]), (101, [0]), (-101, [0])])
def test_a_window_goes_on_over_a_short_step(step_us: int, expected: list[int]) -> None:
    assert starts(jumping(10, {7: step_us})) == expected
    assert starts(jumping(10, {7: step_us}), NO_GAPS) == [0]


def test_a_window_ends_where_its_gaps_are_too_long_together() -> None:
    assert starts(jumping(15, {6: 70, 8: -80})) == [0, 5, 10]
    assert starts(jumping(15, {6: 70, 8: -81})) == [0, 8]


def test_gaps_of_different_windows_and_between_them_are_not_added() -> None:
    assert starts(jumping(20, {4: 100, 5: 100, 6: 100, 10: 100, 15: 100})) == [0, 5, 10, 15]


def test_a_break_for_another_reason_ends_the_window_however_short() -> None:
    assert starts(jumping(10, {3: 50, 7: 50}, breaks=(7,))) == [0]
    assert starts(replace(jumping(10, {7: 50}), jumps=(), breaks=(7,))) == [0]


def test_windows_are_counted_from_the_last_break_though_their_chunks_have_no_jump() -> None:
    stream = jumping(22, {12: 100, 13: 100}, breaks=(7,))
    for cuts in ((), (10,), (7, 10)):
        found, _ = segmented(stream, 5, ANYTHING, cuts, GAPS)
        assert [row[0] for row in found] == [0, 7, 12, 17], "the jump before 12 lies between two windows"


def test_the_jumps_within_windows_are_counted() -> None:
    stream = jumping(20, {3: 100, 5: 100, 8: -10, 12: 101, 14: 20})
    for cuts in ((), range(20)):
        segmenter = Segmenter(5, ANYTHING, GAPS)
        for chunk in stream.chunks(cuts):
            list(segmenter.feed(chunk))
        assert segmenter.gone_over == 3
        assert segmenter.counts == WindowCounts(complete=3, still=3)


def test_times_of_windows_are_those_of_their_rows() -> None:
    segmenter = TimedSegmenter(5, ANYTHING, 1e6 / PERIOD_US, ShortGaps(100, 200))
    stream = jumping(10, {3: 100, 7: -90, 8: -90})
    (found,) = [windows for chunk in stream.chunks() for windows in segmenter.feed(chunk)]
    assert found.start_us is not None
    assert found.end_us is not None
    first_us = 1_000_010
    assert found.start_us.tolist() == [first_us, first_us + 140]
    assert found.end_us.tolist() == [first_us + 140, first_us + 150]


def test_states_of_rule_adaptive_go_on_too() -> None:
    stream = replace(jumping(8 * N, {3 * N: 90, 4 * N + 10: 90}), counts=rest(8, 3))
    for gaps, expected in ((GAPS, [8]), (NO_GAPS, [3, 3])):
        found, _ = batched(stream, N, AdaptiveRule(N, LSB_PER_G, NUMBERS), (70, 300), gaps)
        assert [samples // N for windows in found for samples in windows.samples.tolist()] == expected


def test_what_the_settings_allow() -> None:
    assert short_gaps(DEFAULT, 500, 100.0) == ShortGaps(500_000, 5_000_000)
    assert short_gaps(POSES, 100, 100.0) == ShortGaps(500_000, 1_000_000)
    for older in (Settings(), PoseSettings(), PAPER):
        assert short_gaps(older, 500, 100.0).longest_us == 0
    assert POSES.stillness.longest_gap_s == 0.5
