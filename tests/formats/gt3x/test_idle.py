"""Idle sleep of ActiGraph devices: which seconds are filled, with what, and which stay gaps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.recording import Validity
from tests.cli.run import run
from tests.formats.gt3x.reading import Whole, random_counts, whole
from tests.formats.make_gt3x import (
    ASLEEP,
    AWAKE,
    START_S,
    START_US,
    activity,
    battery,
    event,
    info,
    seconds,
    written,
)

RATE = 50
VALUES = random_counts(10 * RATE)


def awake(first: int, stop: int, at: int | None = None) -> list[bytes]:
    """Records of seconds first..stop-1 of the values, from second `at` on."""
    start = START_S + (first if at is None else at)
    return seconds(VALUES[first * RATE : stop * RATE], RATE, start_s=start)


def asleep(second: int) -> bytes:
    return event(START_S + second, ASLEEP)


def wakes(second: int) -> bytes:
    return event(START_S + second, AWAKE)


def read(folder: Path, log: list[bytes], chunk_samples: int = 170) -> Whole:
    return whole(written(folder / "a.gt3x", log, info(RATE)), chunk_samples)


def filled_seconds(found: Whole) -> list[int]:
    """Seconds since the start of the rows that the device filled; each must be complete."""
    rows = found.times[found.validity == Validity.FILLED]
    second, count = np.unique((rows - START_US) // 1_000_000, return_counts=True)
    assert (count == RATE).all()
    return second.tolist()


@pytest.mark.parametrize("late", [0, 1])
def test_sleep_repeats_the_last_sample(tmp_path: Path, late: int) -> None:
    """The second in which the device falls asleep may not be written."""
    log = [*awake(0, 4), asleep(4 + late), battery(START_S + 5), wakes(9), *awake(4, 10, 9)]
    found = read(tmp_path, log)
    assert filled_seconds(found) == [4, 5, 6, 7, 8]
    assert (found.counts[found.validity == Validity.FILLED] == VALUES[4 * RATE - 1]).all()
    assert (found.measured == VALUES).all()
    assert (found.breaks, found.found) == ([], [])
    assert (np.diff(found.times) == 20_000).all()


def test_a_longer_silence_before_falling_asleep_is_a_gap(tmp_path: Path) -> None:
    log = [*awake(0, 4), asleep(7), wakes(9), *awake(4, 10, 9)]
    found = read(tmp_path, log)
    assert filled_seconds(found) == [6, 7, 8]
    assert (found.breaks, found.found) == ([200], [("clock_gap", 4 * 309 + 10, 200, 1)])


def test_silence_without_falling_asleep_is_a_gap(tmp_path: Path) -> None:
    for log in ([*awake(0, 4), *awake(4, 10, 9)], [*awake(0, 4), wakes(9), *awake(4, 10, 9)]):
        found = read(tmp_path, log)
        assert (found.counts == VALUES).all()
        assert filled_seconds(found) == []
        assert [code for code, *_ in found.found] == ["clock_gap"]


def test_sleep_before_any_sample_is_nothing(tmp_path: Path) -> None:
    found = read(tmp_path, [asleep(-9), wakes(0), *awake(0, 10)])
    assert (found.counts == VALUES).all()
    assert (found.breaks, found.found) == ([], [])


def test_sleep_after_sleep(tmp_path: Path) -> None:
    log = [*awake(0, 4), asleep(4), wakes(7), asleep(8), wakes(12), *awake(4, 10, 12)]
    found = read(tmp_path, log)
    assert filled_seconds(found) == list(range(4, 12))
    assert (found.breaks, found.found) == ([], [])


def test_sleep_at_the_end_lasts_until_the_last_record(tmp_path: Path) -> None:
    found = read(tmp_path, [*awake(0, 10), asleep(10), *(battery(START_S + k) for k in (15, 75))])
    assert filled_seconds(found) == list(range(10, 75))
    assert (found.breaks, found.found) == ([], [])
    assert filled_seconds(read(tmp_path, [*awake(0, 10), asleep(10)])) == []


def test_samples_go_before_filled_ones(tmp_path: Path) -> None:
    """A record of samples earlier than the wake event shortens the sleep."""
    found = read(tmp_path, [*awake(0, 4), asleep(4), wakes(9), *awake(4, 10, 7)])
    assert filled_seconds(found) == [4, 5, 6]
    assert (found.measured == VALUES).all()
    assert (found.breaks, found.found) == ([], [])


def test_sleep_whose_end_is_not_recorded_is_a_gap(tmp_path: Path) -> None:
    found = read(tmp_path, [*awake(0, 4), asleep(4), battery(START_S + 5), *awake(4, 10, 9)])
    assert (found.counts == VALUES).all()
    assert filled_seconds(found) == []
    assert [code for code, *_ in found.found] == ["idle_unfinished", "clock_gap"]


def test_damage_while_asleep_leaves_a_gap(tmp_path: Path) -> None:
    """What was lost may have been samples."""
    bad = battery(START_S + 6)[:-1] + b"\0"
    found = read(tmp_path, [*awake(0, 4), asleep(4), bad, wakes(9), *awake(4, 10, 9)])
    assert (found.counts == VALUES).all()
    assert found.breaks == [200]
    assert [code for code, *_ in found.found] == ["idle_unfinished", "checksum"]


@pytest.mark.parametrize("second", [-100, 200_000, 400_000_000])
def test_a_clock_that_jumps_while_asleep_leaves_a_gap(tmp_path: Path, second: int) -> None:
    log = [*awake(0, 4), asleep(4), battery(START_S + second), wakes(second), *awake(4, 10, second)]
    found = read(tmp_path, log)
    assert (found.counts == VALUES).all()
    assert found.breaks == [200]
    assert [code for code, *_ in found.found] == ["clock_gap" if second > 0 else "clock_back"]


def test_long_sleep_comes_in_parts_of_bounded_size(tmp_path: Path) -> None:
    night = 8 * 3600
    hourly = [battery(START_S + k) for k in range(60, night, 60)]
    log = [*awake(0, 4), asleep(4), *hourly, wakes(night), *awake(4, 10, night)]
    found = read(tmp_path, log, 10**9)
    assert filled_seconds(found) == list(range(4, night))
    assert max(map(len, found.chunks)) <= 1 << 20
    assert (np.diff(found.times) == 20_000).all()
    assert found.same_as(read(tmp_path, log, 20_011))


def poses(rate: int, held_s: int) -> np.ndarray:
    """Still samples of a sensor with errors in 40 poses."""
    turns = np.random.default_rng(3).normal(size=(40, 3))
    gravity = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    raw = np.repeat(gravity * [0.98, 1.02, 0.99] + [0.02, -0.03, 0.01], rate * held_s, axis=0)
    noise = np.random.default_rng(4).normal(0, 0.003, raw.shape)
    return np.rint(256 * (raw + noise)).astype(np.int16)


def test_filled_windows_never_enter_the_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every pose is held for 10 s; the device sleeps through 64 s more after a wrong last sample."""
    values = poses(RATE, 10)
    log, second = [], START_S
    for k in range(40):
        log += [*seconds(values[500 * k : 500 * k + 500], RATE, start_s=second)]
        log += [activity(second + 10, np.full((RATE, 3), 150, np.int16)), event(second + 11, ASLEEP)]
        second += 75
        log += [event(second, AWAKE)]
    path = written(tmp_path / "a.gt3x", log, info(RATE))
    report = json.loads(run(capsys, "calibrate", path, "-q", "--json", "--report-only").out)
    assert report["file_health"]["filled_samples"] == 40 * 64 * RATE
    assert report["fit"]["windows"]["filled"] == 40 * 13
    assert report["holdout"]["after_mg"]["mean"] < 0.5


def test_a_few_records_do_not_fill_a_year(tmp_path: Path) -> None:
    """A day in all, and 300 s for each record before the end of the sleep: 7 of them here."""
    day = 86_400
    for end, filled in ((4 + day + 7 * 300, True), (5 + day + 7 * 300, False)):
        log = [*awake(0, 4), asleep(4), battery(START_S + day), battery(START_S + day + 9), wakes(end)]
        found = read(tmp_path, [*log, *awake(4, 5, end)], 1 << 18)
        assert (len(found.counts) > 5 * RATE) == filled
        assert [problem.code for problem in found.problems] == ([] if filled else ["idle_unheard"])
        assert found.breaks == ([] if filled else [4 * RATE])


def test_a_clock_that_steps_back_does_not_fill_a_day_each_time(tmp_path: Path) -> None:
    log = [*awake(0, 2)]
    for _ in range(20):
        log += [asleep(2), wakes(80_000), asleep(80_001), *awake(0, 2)]
    found = read(tmp_path, log, 1 << 18)
    assert len(filled_seconds_in(found)) <= 86_400 + 300 * len(log)
    assert [problem.code for problem in found.problems].count("idle_unheard") >= 18


def filled_seconds_in(found: Whole) -> np.ndarray:
    return np.flatnonzero(found.validity == Validity.FILLED)[::RATE]
