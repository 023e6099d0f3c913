"""T3: counters that wrap, dates that stay, hours without AM or PM: times run on."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.formats._stamps import DAY_US, HOUR_US, LOST, NO_TIME, RunningOn, Wraps, find_wraps
from tests.formats.make_csv import read, written

MIDNIGHT_US = 1_709_510_400_000_000
ROWS = 9000
COUNTERS = [(1.0, 16), (1.0, 24), (1.0, 32), (1000.0, 16), (1000.0, 24), (100.0, 16), (1e6 / 32768, 16)]


def run_on(times: np.ndarray, wraps: Wraps, cuts: list[int]) -> tuple[np.ndarray, list[int]]:
    clock, parts = RunningOn(wraps), []
    for start, stop in pairwise(sorted({0, len(times), *(cut for cut in cuts if cut < len(times))})):
        parts.append(clock.running_on(times[start:stop]))
    return np.concatenate(parts), [row for row, _ in clock.taken(len(times))]


@given(
    st.sampled_from(COUNTERS),
    st.sampled_from([10_000, 20_000, 40_000]),
    st.floats(0, 1),
    st.booleans(),
    st.lists(st.integers(1, 5000), max_size=4),
)
def test_t3_counters_of_any_width_run_on(
    counter: tuple[float, int], period_us: int, begun: float, signed: bool, cuts: list[int]
) -> None:
    tick_us, bits = counter
    ticks = round(begun * (1 << bits)) + np.arange(5000, dtype=np.int64) * max(1, round(period_us / tick_us))
    shown = ticks % (1 << bits)
    shown = np.where(shown >= 1 << (bits - 1), shown - (1 << bits), shown) if signed else shown
    raw = np.rint(shown * tick_us).astype(np.int64)
    wraps = find_wraps(raw, tick_us)
    assert all(np.ptp(raw) < cycle for cycle, _ in wraps.cycles)
    running, rows = run_on(raw, wraps, cuts)
    assert np.abs(np.diff(running) - period_us).max() <= tick_us + 1
    assert len(rows) == int((np.diff(shown) < 0).sum())


def test_t3_rows_without_a_time_and_gaps_at_the_end_of_a_cycle() -> None:
    ticks = np.arange(9000, dtype=np.int64) * 40
    raw = ticks % (1 << 16) * 1000
    kept = np.ones(len(ticks), np.bool_)
    kept[1630:1650] = False  # a second is missing where the counter wraps
    wraps = find_wraps(raw[kept], 1000.0)
    running, _ = run_on(raw[kept], wraps, [7, 1000])
    assert (running == ticks[kept] * 1000).all()
    raw[[100, 1638, 1639]] = NO_TIME
    running, rows = run_on(raw, wraps, [1639])
    assert (running[raw > LOST] == ticks[raw > LOST] * 1000).all() and (
        running[[100, 1638, 1639]] == NO_TIME
    ).all()
    assert len(rows) == 5


@pytest.mark.parametrize("jump_us", [-1_000, -40_000, -60_000_000, -HOUR_US, -DAY_US, 2 * DAY_US])
def test_t3_other_jumps_of_a_clock_stay(jump_us: int) -> None:
    """A counter that begins anew somewhere, jitter, a clock put back by a day at noon."""
    times = MIDNIGHT_US + 10 * HOUR_US + 20_000 * np.arange(20_000, dtype=np.int64)
    times[10_000:] += jump_us
    assert (run_on(times, find_wraps(times, None, "dates"), [])[0] == times).all()
    since = times - times[0]
    assert (run_on(since, find_wraps(since, 1.0), [])[0] == since).all()


@pytest.mark.parametrize("cuts", [[], [4000, 4001], list(range(0, 500_000, 9973))])
@pytest.mark.parametrize("start_h", [10.0, 12.5, 23.99])
def test_t3_a_date_that_stays_and_hours_without_am_or_pm(start_h: float, cuts: list[int]) -> None:
    """Stamps a second apart through three days; some loggers know only the date of the start."""
    true = MIDNIGHT_US + round(start_h * HOUR_US) + 1_000_000 * np.arange(260_000, dtype=np.int64)
    day, of_day = np.divmod(true, DAY_US)
    staying = true[0] // DAY_US * DAY_US + of_day
    assert (run_on(staying, find_wraps(staying[:5000], None, "dates"), cuts)[0] == true).all()
    assert (
        run_on(of_day, find_wraps(of_day[:5000], None, "times of day"), cuts)[0] == true - true[0] + of_day[0]
    ).all()
    twelve = day * DAY_US + (of_day - HOUR_US) % (12 * HOUR_US) + HOUR_US
    running, _ = run_on(twelve, find_wraps(twelve[:5000], None, "dates"), cuts)
    assert (running - running[0] == true - true[0]).all()


def rows_of(times: list[str]) -> str:
    lines = (
        f"{time},{0.1 * (row % 3):.2f},0.05,{0.9 + 0.01 * (row % 5):.2f}" for row, time in enumerate(times)
    )
    return "\n".join(["time_ms,x,y,z", *lines, ""])


def test_t3_a_csv_counter_of_16_bits_is_no_gap(tmp_path: Path) -> None:
    path = written(tmp_path, rows_of([str(40 * row % 65_536) for row in range(ROWS)]))
    for samples in (100, 1_000_000):
        found = read(path, samples)
        assert (found.times == 40_000 * np.arange(ROWS)).all()
        assert found.breaks == [] and found.codes.count("clock_wrapped") == 5
    assert next(one.place for one in found.problems if one.code == "clock_wrapped") == "before line 1641"
    assert found.recording.duration_s is None or abs(found.recording.duration_s - 360) < 1
