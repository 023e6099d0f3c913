"""Files whose stamps are whole seconds: times to a part of a second, and no gaps but real ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Chunk
from accelcal_cli.formats.cwa import FORMAT
from tests.cli.run import run
from tests.formats.make_cwa import FULL, START_US, Sector, written

ROWS, CODES = 80, {25: 0x48, 50: 0x49, 100: 0x4A}
BEGIN_US = START_US + 370_000

Clock = Callable[[np.ndarray], np.ndarray]
"""Gives the times [s] of samples, by their numbers."""


def steady(rate_hz: float) -> Clock:
    return lambda row: row / rate_hz


def drifting(rate_hz: float) -> Clock:
    """A sensor that is 2.3 % fast, and one part in a thousand less so within each hour."""
    return lambda row: row / (1.023 * rate_hz) * (1 + row / rate_hz / 3600 * 1e-3)


def interrupted(rate_hz: float) -> Clock:
    """Nothing is sampled for 30 s after a third of the sectors."""
    return lambda row: row / rate_hz + 30 * (row >= 200 * ROWS)


def made(path: Path, rate_hz: int, clock: Clock, number: int = 600, **how: int) -> np.ndarray:
    times = BEGIN_US + np.rint(clock(np.arange(number * ROWS)) * 1e6).astype(np.int64)
    data = np.zeros((ROWS, 3), "<i2").tobytes()
    pages = [
        Sector(data, ROWS, k, int(times[k * ROWS]) // 1_000_000 * 1_000_000, rate_code=CODES[rate_hz], **how)
        for k in range(number)
    ]
    written(path, [replace(page, fractional=False) if not how else page for page in pages])
    return times


def read(path: Path, chunk_samples: int = 5000) -> tuple[np.ndarray, list[int], list[str], list[Chunk]]:
    with FORMAT.open(path, ReadOptions()) as reader:
        chunks = list(reader.chunks(chunk_samples))
    breaks = [chunk.first_sample + row for chunk in chunks for row in chunk.breaks.tolist()]
    codes = [problem.code for chunk in chunks for problem in chunk.problems]
    times = np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks])
    return times, breaks, codes, chunks


@pytest.mark.parametrize("rate_hz", CODES)
@pytest.mark.parametrize("clock", [steady, drifting])
def test_t11_stamps_of_whole_seconds_are_no_gaps(
    tmp_path: Path, rate_hz: int, clock: Callable[[float], Clock]
) -> None:
    path = tmp_path / "a.cwa"
    true = made(path, rate_hz, clock(rate_hz))
    times, breaks, codes, _ = read(path)
    assert (breaks, codes) == ([], [])
    off = times - true
    # the phases of an exact rate repeat every four or five sectors, and leave a fifth of a second open
    assert np.abs(off).max() <= (110_000 if clock is steady else 60_000)
    assert np.abs(np.diff(off)).max() <= 0.01 * 1e6 / rate_hz
    assert (np.diff(times) > 0).all()


@pytest.mark.parametrize("rate_hz", CODES)
def test_t11_a_real_gap_among_whole_seconds_stays_one(tmp_path: Path, rate_hz: int) -> None:
    path = tmp_path / "a.cwa"
    true = made(path, rate_hz, interrupted(rate_hz))
    times, breaks, codes, _ = read(path)
    assert (breaks, codes) == ([200 * ROWS], ["clock_gap"])
    assert np.abs(times - true).max() <= 110_000


@pytest.mark.parametrize("number", [4, 5, 64, 127, 128, 129, 192, 193, 257])
def test_t11_few_sectors_and_any_size_of_chunks(tmp_path: Path, number: int) -> None:
    path = tmp_path / "a.cwa"
    true = made(path, 100, steady(100), number)
    times, breaks, codes, _ = read(path)
    assert (breaks, codes) == ([], [])
    assert np.abs(times - true).max() <= 500_000
    for chunk_samples in (80, 160, 10_240):
        assert (read(path, chunk_samples)[0] == times).all()


def test_t11_breaks_are_where_they_are_in_any_size_of_chunks(tmp_path: Path) -> None:
    path = tmp_path / "a.cwa"
    at = ROWS * np.array([64, 128, 200, 328, 329, 400])
    clock = lambda row: row / 100 + 30 * np.searchsorted(at, row, side="right")  # noqa: E731
    true = made(path, 100, clock)
    times, breaks, _, _ = read(path)
    assert breaks == at.tolist()
    assert np.abs(times - true).max() <= 500_000
    for chunk_samples in (80, 160, 10_240):
        assert (read(path, chunk_samples)[0] == times).all()


def test_t11_a_fraction_that_is_always_zero_is_one_that_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "a.cwa"
    true = made(path, 50, drifting(50), session=7)
    times, breaks, codes, _ = read(path)
    assert (breaks, codes) == ([], [])
    assert np.abs(times - true).max() <= 60_000


def test_t11_exact_whole_seconds_keep_their_anchors(tmp_path: Path) -> None:
    """Firmware that knows the fraction moves the number of the sample instead."""
    data = np.zeros((ROWS, 3), "<i2").tobytes()
    begun = [k * 0.8 / 1.02 for k in range(300)]
    pages = []
    for k, second in enumerate(begun):
        offset = -round(second % 1 * 102)
        pages.append(
            replace(
                Sector(data, ROWS, k, START_US + int(second) * 1_000_000, offset), fractional=False, session=1
            )
        )
    times, breaks, codes, _ = read(written(tmp_path / "a.cwa", pages))
    true = START_US + np.arange(300 * ROWS) / 102 * 1e6
    assert (breaks, codes) == ([], [])
    assert np.abs(times - true).max() <= 11_000


def test_t11_the_command_says_so_and_calibrates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made(tmp_path / "a.cwa", 100, drifting(100))
    ran = run(capsys, "inspect", tmp_path / "a.cwa")
    assert "its stamps are whole seconds" in ran.out


@pytest.mark.parametrize(
    ("axes", "rate_hz", "lost"),
    [(0x30, 25, ()), (0x62, 100, ()), (0x32, 100, (5, 60, 61, 400)), (0x32, 100, range(100, 190))],
)
def test_t11_other_layouts_and_lost_sectors(tmp_path: Path, axes: int, rate_hz: int, lost: range) -> None:
    rows, number, path = FULL[axes], 600, tmp_path / "a.cwa"
    true = BEGIN_US + np.rint(drifting(rate_hz)(np.arange(number * rows)) * 1e6).astype(np.int64)
    whole = Sector(bytes(480), rows, 0, rate_code=CODES[rate_hz], axes=axes, fractional=False)
    stamps = {k: int(true[k * rows]) // 1_000_000 * 1_000_000 for k in range(number) if k not in lost}
    written(path, [replace(whole, sequence=k, time_us=stamp) for k, stamp in stamps.items()])
    times, breaks, codes, _ = read(path)
    kept = true.reshape(number, rows)[list(stamps)].reshape(-1)
    assert np.abs(times - kept).max() <= 80_000
    assert (len(breaks), set(codes)) == (len(codes), {"sequence_gap"} if lost else set())
