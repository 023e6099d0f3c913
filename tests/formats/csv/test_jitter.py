"""Stamps that jitter: where only the clock jumps, and the rate that they mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats._stamps import jittered_step
from accelcal_cli.formats.tables import CSV as FORMAT
from tests.formats.make_csv import written

PERIOD_US = 10_000


def jumps(path: Path, chunk_samples: int = 1000) -> tuple[list[int], list[int]]:
    """Return rows with a break before them, and those where only the clock jumps."""
    with FORMAT.open(path, ReadOptions()) as reader:
        chunks = list(reader.chunks(chunk_samples))
    return (
        [chunk.first_sample + row for chunk in chunks for row in chunk.breaks.tolist()],
        [chunk.first_sample + row for chunk in chunks for row in chunk.clock_jumps.tolist()],
    )


def table(steps_ms: list[int], bad: int | None = None) -> str:
    """Write rows with these steps between them, one of them without a value."""
    times = np.cumsum([0, *steps_ms])
    rows = [f"{1_709_510_400_000 + time},0,{'' if row == bad else 0},1" for row, time in enumerate(times)]
    return "time,x,y,z\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize("chunk_samples", [1, 7, 1000])
def test_a_jump_of_the_clock_is_told_from_lost_rows(tmp_path: Path, chunk_samples: int) -> None:
    steps = [10] * 40
    steps[9], steps[19], steps[31] = 31, -3, 200  # before rows 10, 20, 32
    path = written(tmp_path, table(steps))
    assert jumps(path, chunk_samples) == ([10, 20, 32], [10, 20, 32])
    path = written(tmp_path, table(steps, bad=31))  # row 31 is left out: 32 becomes 31
    assert jumps(path, chunk_samples) == ([10, 20, 31], [10, 20])


def stamps(seed: int, deviation_us: float = 0, lost_a_second: float = 0, stalls: bool = False) -> np.ndarray:
    """Return times of three minutes at 100 Hz as a phone may stamp them."""
    draw = np.random.default_rng(seed)
    number = 18_000
    times = np.arange(number) * float(PERIOD_US) + deviation_us * draw.standard_normal(number)
    if stalls:  # ten rows come together, one millisecond apart
        late = np.arange(number) % 200 < 10
        times[late] = (np.arange(number) // 200 * 200 * PERIOD_US + 90_000 + np.arange(number) % 200 * 1000)[
            late
        ]
    lost = np.zeros(number, np.bool_)
    for start in np.flatnonzero(draw.random(number) < lost_a_second / 100).tolist():
        lost[start : start + int(draw.integers(1, 21))] = True
    return np.rint(times[~lost]).astype(np.int64)


@pytest.mark.parametrize(
    ("deviation_us", "lost_a_second", "stalls"),
    [(0, 0, False), (2000, 0, False), (5000, 0, False), (2000, 0.3, False), (2000, 3, False),
     (5000, 0.3, False), (2000, 0, True)],
)  # fmt: skip
def test_the_rate_of_jittery_stamps(
    tmp_path: Path, deviation_us: float, lost_a_second: float, stalls: bool
) -> None:
    times = stamps(1, deviation_us, lost_a_second, stalls)
    text = "".join(f"{1_709_510_400_000_000 + time},0,0,1\n" for time in times.tolist())
    with FORMAT.open(written(tmp_path, f"time,x,y,z\n{text}"), ReadOptions()) as reader:
        assert reader.recording.rate_hz == 100.0


def test_stamps_that_go_forward_do_not_count_as_jittery() -> None:
    assert jittered_step(stamps(1, 1500)) is None
    assert jittered_step(np.full(1000, 5)) is None
    assert jittered_step(np.arange(63) % 2) is None
    assert jittered_step(np.arange(1000)[::-1]) is None
