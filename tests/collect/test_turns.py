"""Turns between rests: what counts as one, the same however the windows come, and a bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.collect import turns
from accelcal_cli.collect.turns import GyroWindows, TurnCollector
from accelcal_cli.core.gyroscope import Turns

LENGTH, RATE = 10, 10.0
UP, ASIDE = (0, 0, 256), (256, 0, 0)


def windows(
    plan: str, first: int = 0, turning: int = 40, *, fresh: bool = True, warm: bool = False
) -> GyroWindows:
    """A letter a window of a second: u rest with z up, a rest with x up, m movement, d damage."""
    counts = np.zeros((len(plan) * LENGTH, 3), np.int16)
    moving = np.repeat([letter == "m" for letter in plan], LENGTH)
    counts[moving, 1] = turning + np.arange(moving.sum()) % 5
    counts[~moving] = (3, -2, 1)
    sums = np.array([ASIDE if letter == "a" else UP for letter in plan], np.int64) * LENGTH
    return GyroWindows(
        fresh=fresh,
        first_sample=first,
        time_us=(first + LENGTH * np.arange(len(plan))) * 100_000,
        resting=np.array([letter in "ua" for letter in plan]),
        usable=np.array([letter != "d" for letter in plan]),
        sums=sums,
        gyro_sums=counts.reshape(len(plan), LENGTH, 3).sum(axis=1, dtype=np.int64),
        counts=counts,
        temperature_sums=np.full(len(plan), 30_000 * LENGTH) if warm else None,
    )


def collected(*parts: GyroWindows) -> Turns:
    collector = TurnCollector(LENGTH, RATE, (0.1, 0.1, 0.1), 256.0)
    for part in parts:
        collector.add(part)
    return collector.result()


def test_a_turn_by_hand() -> None:
    found = collected(windows("uuummaa", warm=True))
    (turn,) = found.turns
    assert (turn.before.sample, turn.before.samples) == (0, 30)
    assert (turn.after.sample, turn.after.samples) == (50, 20)
    assert turn.before.sums == (0, 0, 256 * 30) and turn.after.sums == (256 * 20, 0, 0)
    assert turn.before.gyro_sums == (90, -60, 30) and turn.after.gyro_sums == (60, -40, 20)
    assert turn.before.temperature_sum == 900_000
    np.testing.assert_array_equal(turn.counts[:, 1], 40 + np.arange(20) % 5)
    assert turn.period_us == 100_000
    assert found.rates.samples.tolist() == [50]
    assert found.rates.gyro_sums.tolist() == [[150, -100, 50]]
    assert found.rates.temperature_sums is not None
    assert found.rates.temperature_sums.tolist() == [1_500_000]


@pytest.mark.parametrize(
    ("plan", "number"),
    [
        ("uummaa", 1),
        ("uumm", 0),
        ("mmaa", 0),
        ("uummuu", 0),  # gravity is where it was
        ("ummaa", 0),  # too short a rest
        ("uummammaa", 1),  # a moment of quiet is part of the turn
        ("uumdmaa", 0),  # what damage took is not known
        ("uummaammuu", 2),
        ("uu" + 30 * "m" + "aa", 1),
        ("uu" + 31 * "m" + "aa", 0),
        ("uuaa", 0),  # a rest goes on, as long as nothing moves
    ],
)
def test_what_is_a_turn(plan: str, number: int) -> None:
    assert len(collected(windows(plan)).turns) == number


def test_a_moment_of_quiet_is_gone_over() -> None:
    (turn,) = collected(windows("uummammaa")).turns
    assert len(turn) == 50
    np.testing.assert_array_equal(turn.counts[20:30], np.tile((3, -2, 1), (10, 1)))


def test_only_the_ends_of_long_rests_count() -> None:
    (turn,) = collected(windows(20 * "u" + "m" + 9 * "a")).turns
    assert (turn.before.sample, turn.before.samples) == (150, 50)
    assert (turn.after.sample, turn.after.samples) == (210, 50)


def test_a_break_ends_everything() -> None:
    assert not collected(windows("uum"), windows("maa", 30)).turns
    assert collected(windows("uum"), windows("maa", 30, fresh=False)).turns


def pieces(whole: GyroWindows, size: int) -> Iterator[GyroWindows]:
    for start in range(0, len(whole.resting), size):
        part, rows = slice(start, start + size), slice(start * LENGTH, (start + size) * LENGTH)
        yield replace(
            whole,
            fresh=start == 0,
            first_sample=start * LENGTH,
            counts=whole.counts[rows],
            **{
                name: getattr(whole, name)[part]
                for name in ("time_us", "resting", "usable", "sums", "gyro_sums")
            },
        )


def same(one: Turns, other: Turns) -> bool:
    assert len(one.turns) == len(other.turns) > 0
    for left, right in zip(one.turns, other.turns, strict=True):
        assert repr((left.before, left.after, left.period_us)) == repr(
            (right.before, right.after, right.period_us)
        )
        np.testing.assert_array_equal(left.counts, right.counts)
    np.testing.assert_array_equal(one.rates.gyro_sums, other.rates.gyro_sums)
    np.testing.assert_array_equal(one.rates.samples, other.rates.samples)
    return one.left_out == other.left_out


@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
def test_the_same_however_the_windows_come(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, "MAX_ROWS", 400)
    random = np.random.default_rng(1)
    plan = "".join(
        letter * int(times)
        for letter, times in zip("umaumaudmumamaum" * 20, random.integers(1, 9, 320), strict=True)
    )
    whole = windows(plan)
    counts = whole.counts + random.integers(-3, 4, whole.counts.shape).astype(np.int16)
    whole = replace(whole, counts=counts, gyro_sums=counts.reshape(-1, LENGTH, 3).sum(axis=1, dtype=np.int64))
    found = collected(whole)
    assert found.left_out > 0
    assert same(found, collected(*pieces(whole, size)))


def test_the_longest_turns_of_the_fullest_kind_give_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, "MAX_ROWS", 100)
    one_way = windows("uummaammmuummmmmaa", turning=40)
    other_way = windows("uummmmaa", 300, turning=-40)
    found = collected(one_way, other_way)
    assert [len(turn) for turn in found.turns] == [20, 30, 40]
    assert found.left_out == 1


def test_a_turn_that_the_recording_holds_twice_counts_once() -> None:
    one = windows("uummaa")
    assert len(collected(one, replace(one, first_sample=90, time_us=one.time_us + 9_000_000)).turns) == 1


def test_a_rate_at_the_end_of_16_bits_is_none() -> None:
    one = windows("uummaa")
    one.counts[25, 0] = -32_768
    assert not collected(one).turns


def test_what_no_sample_can_follow_is_none() -> None:
    """0.1 deg/s in a count at 10 Hz: 18 000 counts are half a turn in a sample."""
    for count, number in ((17_999, 1), (18_000, 0)):
        one = windows("uummaa")
        one.counts[25, 0] = count
        assert len(collected(one).turns) == number


def test_blocks_of_rest_become_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, "MAX_BLOCKS", 4)
    found = collected(windows("u" * 600))
    assert found.rates.samples.tolist() == [2400, 2400, 1200]
    np.testing.assert_array_equal(
        found.rates.gyro_sums, found.rates.samples[:, np.newaxis] * np.array([3, -2, 1])
    )
