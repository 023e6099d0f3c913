"""Facts of a recording: gaps, measured rate, clipping, bounded lists."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from accelcal_cli.core.clock import RESET_US, StampClock
from accelcal_cli.core.recording import Chunk, Problem, Recording, Validity
from accelcal_cli.core.results import Facts, Jumps
from accelcal_cli.pipeline import facts as module
from accelcal_cli.pipeline.facts import FactsObserver
from accelcal_cli.pipeline.survey import with_clipping

RECORDING = Recording(Path("a"), "test", rate_hz=10.0, lsb_per_g=256.0, total_bytes=0, range_g=8.0)


def observed(times: np.ndarray, breaks: list[int], cuts: list[int]) -> Facts:
    observer = FactsObserver(RECORDING, RECORDING.lsb_per_g)
    edges = [0, *cuts, len(times)]
    for start, stop in itertools.pairwise(edges):
        inner = np.array([row - start for row in breaks if start <= row < stop], np.int64)
        counts = np.zeros((stop - start, 3), np.int16)
        observer.see(Chunk(start, counts, StampClock(times[start:stop]), 0, inner))
    return observer.result()


@pytest.mark.parametrize("cuts", [[], [1], [50], [49, 51], [50, 50, 60], list(range(1, 100))])
def test_gaps_and_rate_do_not_depend_on_chunks(cuts: list[int]) -> None:
    times = np.arange(100, dtype=np.int64) * 100_000
    times[50:] += 7_000_000
    facts = observed(times, [50], cuts)
    assert facts.samples == 100
    assert (facts.first_us, facts.last_us) == (0, 16_900_000)
    assert facts.rate_hz == 10.0
    (gap,) = facts.gaps
    assert (gap.sample, gap.start_us, gap.seconds) == (50, 4_900_000, 7.1)


def test_a_step_back_of_the_clock_is_a_gap_too() -> None:
    times = np.arange(100, dtype=np.int64) * 100_000
    times[50:] -= 3_000_000
    (gap,) = observed(times, [50], []).gaps
    assert gap.seconds == pytest.approx(-2.9)


@pytest.mark.parametrize("cuts", [[], [40], list(range(1, 100))])
def test_gaps_and_steps_back_are_counted_apart(cuts: list[int]) -> None:
    times = np.arange(100, dtype=np.int64) * 100_000
    times[30:] += 5_000_000
    times[60:] -= 2_000_000
    times[80:] = np.arange(20) * 100_000 + times[79]
    jumps = observed(times, [30, 60, 80, 90], cuts).jumps
    assert (jumps.gaps, jumps.gap_us, jumps.back) == (1, 5_100_000, 2)


def test_lost_and_used_bytes_add_up_to_a_share() -> None:
    observer = FactsObserver(RECORDING, RECORDING.lsb_per_g)
    assert observer.result().lost_percent() == 0
    nothing = np.zeros((0, 3), np.int16)
    many = tuple(Problem("checksum", "x", index, 0, lost_bytes=30) for index in range(2000))
    observer.see(Chunk(0, nothing, StampClock(nothing[:, 0]), 0, problems=many, used_bytes=40_000))
    facts = observer.result()
    assert (facts.lost_bytes, facts.used_bytes, facts.lost_percent()) == (60_000, 40_000, 60.0)


def test_a_break_without_lost_time_is_no_gap() -> None:
    assert observed(np.arange(100, dtype=np.int64) * 100_000, [50], []).gaps == ()


def test_an_empty_recording_has_no_times() -> None:
    facts = FactsObserver(RECORDING, RECORDING.lsb_per_g).result()
    assert (facts.samples, facts.first_us, facts.rate_hz) == (0, None, None)


STEPS = [100_000, 100_000, 150_000, 150_001, 900_000, 0, -70_000, -(1 << 58), 1 << 58]


@given(
    st.lists(st.tuples(st.sampled_from(STEPS), st.booleans()), min_size=1, max_size=40),
    st.lists(st.integers(0, 40), max_size=5),
)
def test_breaks_of_any_number_are_as_defined(rows: list[tuple[int, bool]], cuts: list[int]) -> None:
    times = np.array([step for step, _ in rows], object).cumsum()
    assume(max(map(abs, times)) < 1 << 62)
    breaks = [row for row, (_, broken) in enumerate(rows) if broken]
    edges = [0, *(row for row in breaks if row), len(rows)]
    facts = observed(times.astype(np.int64), breaks, sorted(min(cut, len(rows)) for cut in cuts))
    span = sum(times[stop - 1] - times[start] for start, stop in itertools.pairwise(edges))
    steps = sum(stop - start - 1 for start, stop in itertools.pairwise(edges))
    assert facts.rate_hz == (steps * 1e6 / span if span > 0 and steps else None)
    found = [(row, times[row - 1], times[row] - times[row - 1]) for row in edges[1:-1]]
    jumps = [item for item in found if not 0 < item[2] / 1e6 * 10 <= 1.5]
    assert [(gap.sample, gap.start_us, gap.seconds) for gap in facts.gaps] == [
        (row, before, step / 1e6) for row, before, step in jumps
    ]
    ahead = [step for *_, step in jumps if 0 < step <= RESET_US]  # a reset is no gap
    assert facts.jumps == Jumps(len(ahead), sum(ahead), sum(step <= 0 for *_, step in jumps))


def test_times_are_asked_for_once_however_many_breaks_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """28. of the hostile run: a break before every row cost 48 times the normal."""
    asked: list[int] = []
    times = StampClock.times

    def counted(clock: StampClock, start: int, stop: int) -> np.ndarray:
        asked.append(stop - start)
        return times(clock, start, stop)

    monkeypatch.setattr(StampClock, "times", counted)
    facts = observed(np.arange(3000, dtype=np.int64) * 500_000, list(range(1, 3000)), [1000, 2000])
    assert (facts.jumps.gaps, facts.jumps.gap_us) == (2999, 2999 * 500_000)
    assert len(asked) < 10


def test_lists_stay_bounded_and_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_GAPS", 5)
    monkeypatch.setattr(module, "MAX_PROBLEMS", 5)
    times = np.arange(100, dtype=np.int64) * 1_000_000
    facts = observed(times, list(range(1, 100)), [])
    assert (len(facts.gaps), facts.gaps_omitted) == (5, 94)
    observer = FactsObserver(RECORDING, RECORDING.lsb_per_g)
    many = tuple(Problem("checksum", "x", index, 0) for index in range(12))
    observer.see(Chunk(0, np.zeros((0, 3), np.int16), StampClock(times[:0]), 0, problems=many))
    problems = observer.result().problems
    assert len(problems) == 6
    assert (problems[-1].code, problems[-1].count) == ("more_problems", 7)


def test_rows_at_the_range_are_clipped_and_other_marks_stay() -> None:
    counts = np.zeros((6, 3), np.int16)
    counts[1, 0], counts[2, 1], counts[3, 2], counts[4, 0] = 2047, -2048, 2046, -2048
    validity = np.array([0, 0, 0, 0, Validity.FILLED, 0], np.uint8)
    chunk = Chunk(0, counts, StampClock(np.arange(6)), 0, validity=validity)
    marked = with_clipping(chunk, RECORDING)
    assert marked.validity is not None
    assert marked.validity.tolist() == [0, 2, 2, 0, 1, 0]
    assert validity.tolist() == [0, 0, 0, 0, 1, 0]


def test_without_a_range_nothing_is_clipped() -> None:
    chunk = Chunk(0, np.full((2, 3), 32_767, np.int16), StampClock(np.arange(2)), 0)
    assert with_clipping(chunk, Recording(Path("a"), "t", 10.0, 256.0, 0)).validity is None
