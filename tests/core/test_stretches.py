"""Stretches of a clock: their sum, whatever the clock does, and which jumps are resets."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.clock import RESET_US, StampClock, Stretches

PERIOD_US = 20_000
DAY_US = 86_400_000_000
YEAR_2000, YEAR_2024, YEAR_2079 = 946_684_800_000_000, 1_709_548_900_000_000, 3_439_756_800_000_000


def follow(times: np.ndarray, cuts: list[int]) -> Stretches:
    """Show times in pieces, with a break wherever they are not even."""
    found = Stretches(PERIOD_US)
    for start, stop in pairwise(sorted({0, len(times), *(min(cut, len(times)) for cut in cuts)})):
        steps = np.diff(times[start:stop], prepend=times[max(start - 1, 0)])
        breaks = np.flatnonzero((steps < 0) | (steps > 3 * PERIOD_US))
        found.add(StampClock(times[start:stop]), stop - start, breaks)
    return found


def even(start_us: int, rows: int) -> np.ndarray:
    return start_us + PERIOD_US * np.arange(rows, dtype=np.int64)


@given(
    st.lists(
        st.tuples(
            st.sampled_from([-30 * DAY_US, -DAY_US, -3_600_000_000, -5_000_000, 1, 2]), st.integers(17, 60)
        ),
        max_size=8,
    ),
    st.lists(st.integers(1, 400), max_size=4),
)
def test_t3_the_length_is_the_sum_of_the_stretches(jumps: list[tuple[int, int]], cuts: list[int]) -> None:
    """A clock goes back, or is reset to the future (1) or to long ago (2), in any order."""
    parts = [even(YEAR_2024, 40)]
    for by_us, rows in jumps:
        far = {1: parts[-1][-1] + 2 * RESET_US, 2: parts[-1][-1] - 3 * RESET_US}
        start = far.get(by_us, parts[-1][0] + by_us)
        parts.append(even(int(start), rows))
    times = np.concatenate(parts)
    found = follow(times, cuts)
    assert found.span_us == PERIOD_US * (len(times) - 1)
    assert (found.first_us, found.last_us, found.samples) == (YEAR_2024, times[-1], len(times))
    large = [jump for jump, _ in jumps if jump in (1, 2) or jump <= -DAY_US]
    assert len(found.resets) == len(large)


@pytest.mark.parametrize("cuts", [[], [100], [101, 102, 103], list(range(1, 300))])
@pytest.mark.parametrize(
    ("change", "resets"),
    [
        ("reset to 2000", [(100, YEAR_2000)]),
        ("reset to 2079", [(100, YEAR_2079)]),
        ("set while it runs", [(100, YEAR_2024)]),
        ("an hour back", []),
    ],
)
def test_t3_a_reset_is_told_with_its_place(
    change: str, resets: list[tuple[int, int]], cuts: list[int]
) -> None:
    start = {"reset to 2000": YEAR_2000, "reset to 2079": YEAR_2079}.get(change, YEAR_2024)
    before = YEAR_2000 if change == "set while it runs" else YEAR_2024 + 3_600_000_000
    found = follow(np.concatenate([even(before, 100), even(start, 200)]), cuts)
    assert [(one.sample, one.after_us) for one in found.resets] == resets
    assert found.span_us == 299 * PERIOD_US


def test_t3_late_stamps_and_jitter_do_not_make_a_recording_longer() -> None:
    """Stamps that come late by 3 s, and then go on where they were; stamps that jitter by two periods."""
    times = even(YEAR_2024, 1000)
    late = times.copy()
    late[[100, 500, 501]] += 3_000_000
    noise = np.random.RandomState(2).randint(-2 * PERIOD_US, 2 * PERIOD_US, 1000)
    noise[[0, -1]] = 0
    for stamps in (late, times + noise):
        for cuts in ([], [100, 101, 502], list(range(1, 1000))):
            assert follow(stamps, cuts).span_us == 999 * PERIOD_US


def test_t3_a_gap_counts_and_a_clock_that_runs_backwards_is_never_negative() -> None:
    with_gap = np.concatenate([even(YEAR_2024, 50), even(YEAR_2024 + 30 * DAY_US, 50)])
    assert follow(with_gap, []).span_us == with_gap[-1] - with_gap[0]
    assert follow(even(YEAR_2024, 100)[::-1].copy(), [7]).span_us == 99 * PERIOD_US
    assert Stretches(PERIOD_US).span_us == 0


@given(
    st.lists(st.integers(-(1 << 60), 1 << 60), min_size=1, max_size=60),
    st.lists(st.integers(1, 60), max_size=3),
)
def test_t3_no_times_give_a_negative_length_or_depend_on_pieces(times: list[int], cuts: list[int]) -> None:
    stamps = np.array(times, np.int64)
    whole, parts = follow(stamps, []), follow(stamps, cuts)
    assert whole.span_us >= 0
    assert (whole.span_us, whole.resets) == (parts.span_us, parts.resets)
