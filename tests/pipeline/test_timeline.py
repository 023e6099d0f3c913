"""What is counted along time, against counts of the whole arrays, however the rows come."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.collect.cells import MAX_BLOCKS
from accelcal_cli.core.clock import RESET_US, StampClock
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, Problem, Recording
from accelcal_cli.core.results import TimeRows
from accelcal_cli.pipeline.facts import Timeline

RATE_HZ, HOUR, WINDOW = 0.2, 720, 10
RECORDING = Recording(Path("a"), "test", rate_hz=RATE_HZ, lsb_per_g=256.0, total_bytes=0)
ROWS = 4 * HOUR + 100
RANDOM = np.random.RandomState(7)
COUNTS = RANDOM.randint(-300, 300, (ROWS, 3)).astype(np.int16)
COUNTS[HOUR : 2 * HOUR, :2] = RANDOM.randint(100, 112, (HOUR, 2))  # two axes within 43 mg
HEAT_MC = RANDOM.randint(20_000, 30_000, ROWS).astype(np.int32)
VALIDITY = np.zeros(ROWS, np.uint8)
VALIDITY[10:30], VALIDITY[700:730], VALIDITY[2000:2005] = 1, 2, 3
VALIDITY[3 * HOUR : 4 * HOUR] = 1
TIMES = np.arange(ROWS, dtype=np.int64) * 5_000_000
TIMES[HOUR - 1 :] += 90_250_000
TIMES[900:] -= 30_000_000
TIMES[1000:] += 7_000_000
BREAKS = [HOUR - 1, 900, 1000, 1010]
PROBLEMS = {HOUR: 512, 2 * HOUR + 5: 3, ROWS: 7}
"""Bytes that were lost before these samples."""
STILL = np.array([0, 15, 710, 1500])
"""First samples of still windows; one ends in the hour after."""


def seen(cuts: list[int], hour: int = HOUR) -> Timeline:
    timeline = Timeline(RECORDING, hour, WINDOW)
    edges = [0, *cuts, ROWS]
    for start, stop in itertools.pairwise(edges):
        inner = np.array([row - start for row in BREAKS if start <= row < stop], np.int64)
        damage = tuple(
            Problem("damaged", "", None, sample, lost_bytes=lost)
            for sample, lost in PROBLEMS.items()
            if start <= sample < stop or start < stop == sample == ROWS
        )
        part = slice(start, stop)
        columns = {"temperature_mc": HEAT_MC[part], "validity": VALIDITY[part], "problems": damage}
        timeline.see(Chunk(start, COUNTS[part], StampClock(TIMES[part]), 0, inner, **columns))
    length = np.full(len(STILL), WINDOW)
    timeline.see_still(Windows(length, STILL, np.zeros((4, 3), np.int64), np.zeros((4, 3), np.int64)))
    return timeline


@pytest.mark.parametrize("cuts", [[], [720], [1, 1, 719, 2881], list(range(1, ROWS, 5)), [ROWS]])
def test_counts_are_those_of_the_whole(cuts: list[int]) -> None:
    rows = seen(cuts).result()
    hours = [slice(start, min(start + HOUR, ROWS)) for start in range(0, ROWS, HOUR)]
    assert rows.samples == (720, 720, 720, 720, 100)
    assert rows.still == (3, 0, 1, 0, 0)
    for name, flag in (("filled", 1), ("clipped", 2), ("recovered", 3)):
        assert getattr(rows, name) == tuple(int((VALIDITY[hour] == flag).sum()) for hour in hours), name
    assert rows.moving == ((720 - 20 - 20 - 30) // 10, (720 - 10) // 10, (720 - 10 - 5) // 10, 0, 10)
    assert rows.lost_bytes == (0, 512, 3, 0, 7)
    assert rows.gap_us == (95_250_000, 12_000_000, 0, 0, 0)
    assert rows.temperature_mc == tuple(float(HEAT_MC[hour].mean()) for hour in hours)
    assert rows.worn == (True, False, True, False, None)
    assert len(rows) == 5 and rows.block_samples == HOUR


@pytest.mark.parametrize("cuts", [[], [3, 14, 1001], list(range(1, ROWS, 7))])
def test_one_sample_in_five_seconds_is_looked_at(cuts: list[int]) -> None:
    """Of the recording, wherever its chunks begin: at 2 Hz every tenth."""
    timeline = Timeline(replace(RECORDING, rate_hz=2.0), ROWS, WINDOW)
    for start, stop in itertools.pairwise([0, *cuts, ROWS]):
        heat, clock = HEAT_MC[start:stop], StampClock(TIMES[start:stop])
        timeline.see(Chunk(start, COUNTS[start:stop], clock, 0, temperature_mc=heat))
    assert timeline.result().temperature_mc == (float(HEAT_MC[::10].mean()),)


def test_longer_blocks_are_sums_of_shorter_ones() -> None:
    rows = seen([500]).rows(2 * HOUR)
    assert (rows.block_samples, rows.samples) == (2 * HOUR, (1440, 1440, 100))
    assert rows.still == (3, 1, 0) and rows.lost_bytes == (512, 3, 7)
    assert rows.gap_us == (107_250_000, 0, 0)
    assert rows.temperature_mc[0] == float(HEAT_MC[: 2 * HOUR].mean())
    assert rows.worn == (True, True, None)


@pytest.mark.parametrize("cuts", [[], [7, 1000], list(range(1, ROWS, 13))])
def test_the_number_of_blocks_is_bounded(cuts: list[int]) -> None:
    """Hours of two samples: there would be 1490."""
    rows = seen(cuts, hour=2).result()
    assert rows.block_samples == 8 and len(rows) == -(-ROWS // 8) <= MAX_BLOCKS
    assert (sum(rows.samples), sum(rows.lost_bytes), sum(rows.gap_us)) == (ROWS, 522, 107_250_000)
    assert rows == seen([], hour=8).result()


def test_times_that_leap_far_do_not_overflow() -> None:
    """A damaged file: ahead by a year and back at every other row; to the year 9999 it is no gap."""
    rows = 600_000
    for leap, gap in ((RESET_US, RESET_US), (250_000_000_000_000_000, 0)):
        times = np.zeros(rows, np.int64)
        times[1::2] = leap
        timeline = Timeline(RECORDING, rows, WINDOW)
        timeline.see(Chunk(0, np.zeros((rows, 3), np.int16), StampClock(times), 0, np.arange(1, rows)))
        assert timeline.result().gap_us == (rows // 2 * gap,)


def test_rows_that_never_were_make_no_blocks() -> None:
    timeline = Timeline(RECORDING, HOUR, WINDOW)
    lost = (Problem("damaged", "", None, 0, lost_bytes=9),)
    timeline.see(Chunk(0, np.zeros((0, 3), np.int16), StampClock(np.zeros(0, np.int64)), 0, problems=lost))
    assert timeline.result() == TimeRows(HOUR, *[()] * 10)
