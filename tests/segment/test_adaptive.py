"""The adaptive rule on hand-made streams: minimum, constant stretches, gyroscope, merging."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from accelcal_cli.core.points import WindowCounts
from accelcal_cli.core.recording import Validity
from accelcal_cli.core.settings import Adaptive
from accelcal_cli.segment.adaptive import AdaptiveRule, States
from accelcal_cli.segment.segmenter import Segmenter
from tests.segment.streams import Stream, batched

LSB_PER_G = 256.0
N = 50
NUMBERS = Adaptive(held_windows=1000)
Z = (0.0, 0.0, 1.0)


def rest(windows: int, noise_mg: float, direction: tuple[float, ...] = Z, seed: int = 1) -> np.ndarray:
    """Counts of a sensor at rest, with its noise."""
    g = np.array(direction) / np.linalg.norm(direction)
    noise = noise_mg / 1000 * np.random.default_rng(seed).standard_normal((windows * N, 3))
    return np.rint((g + noise) * LSB_PER_G).astype(np.int16)


def turning(windows: int, degrees_a_window: float, noise_mg: float) -> np.ndarray:
    """|a| stays 1 g while the direction turns about y."""
    angle = np.radians(degrees_a_window) * np.arange(windows * N) / N
    g = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    noise = noise_mg / 1000 * np.random.default_rng(2).standard_normal(g.shape)
    return np.rint((g + noise) * LSB_PER_G).astype(np.int16)


def states(
    stream: Stream, numbers: Adaptive = NUMBERS, length: int = N
) -> tuple[list[tuple[int, int]], WindowCounts]:
    """First window and number of windows of each state."""
    found, counts = batched(stream, length, AdaptiveRule(length, LSB_PER_G, numbers))
    pairs = [zip(item.first_sample.tolist(), item.samples.tolist(), strict=True) for item in found]
    return [(first // length, samples // length) for item in pairs for first, samples in item], counts


def covered(pairs: list[tuple[int, int]], low: int, high: int) -> int:
    """Windows of low..high-1 that lie in a state."""
    return sum(max(0, min(high, first + number) - max(low, first)) for first, number in pairs)


def test_more_than_twice_the_least_spread_is_moving() -> None:
    found, counts = states(Stream(np.concatenate([rest(40, 3), rest(40, 10), rest(40, 3, seed=3)])))
    assert covered(found, 0, 40) == covered(found, 80, 120) == 40
    assert covered(found, 40, 80) == 0
    assert counts == WindowCounts(complete=120, moving=40, still=len(found), joined=80 - len(found))


@pytest.mark.parametrize(("held", "passed"), [(1000, 0), (1, 30)])
def test_early_windows_wait_for_the_minimum_to_settle(held: int, passed: int) -> None:
    stream = Stream(np.concatenate([rest(30, 12), rest(60, 3)]))
    found, _ = states(stream, replace(NUMBERS, held_windows=held))
    assert covered(found, 0, 30) == pytest.approx(passed, abs=2)
    assert covered(found, 30, 90) == 60


@pytest.mark.parametrize("value", [(0, 0, 0), (0, 0, 256), (37, -12, 250)])
@pytest.mark.parametrize("marked", [True, False])
def test_a_constant_stretch_does_not_lower_the_minimum(value: tuple[int, ...], marked: bool) -> None:
    fill = np.tile(np.array(value, np.int16), (20 * N, 1))
    before = rest(40, 3)
    stream = Stream(
        np.concatenate([before, fill, rest(40, 3, seed=3)]),
        validity=np.repeat(np.array([0, Validity.FILLED if marked else 0, 0], np.uint8), [2000, 1000, 2000]),
    )
    found, counts = states(stream)
    assert covered(found, 0, 40) == covered(found, 60, 100) == 40
    assert counts.filled == (20 if marked else 0)
    constants = [pair for pair in found if 40 <= pair[0] < 60]
    assert constants == ([] if marked else [(place, 1) for place in range(40, 60)])


def test_one_flicker_between_two_steps_is_no_minimum() -> None:
    """Counts of 4 are the sensor's step; its rounding alone makes 4 / sqrt(12) counts."""
    coarse = rest(60, 6) // 4 * 4
    quiet = np.tile(np.array([0, 0, 256], np.int16), (4 * N, 1))
    quiet[::N] += np.array([0, 0, 4], np.int16)
    found, _ = states(Stream(np.concatenate([coarse, quiet, coarse])))
    assert covered(found, 0, 60) == covered(found, 64, 124) > 50
    finer = np.concatenate([coarse, quiet, coarse, [[0, 0, 256], [0, 0, 257]] * N]).astype(np.int16)
    assert covered(states(Stream(finer))[0], 0, 60) == 0


def test_a_slow_turn_is_no_state_though_its_length_is_constant() -> None:
    stream = Stream(np.concatenate([rest(20, 3), turning(20, 3, 3), rest(20, 3)]))
    found, _ = states(stream)
    assert covered(found, 20, 40) <= 1
    single, _ = states(stream, replace(NUMBERS, min_windows=1))
    assert covered(single, 20, 40) == 20


def test_a_gyroscope_sees_what_the_norm_does_not() -> None:
    counts = rest(60, 3)
    gyro = np.random.default_rng(4).integers(-3, 4, (60 * N, 3)).astype(np.int16)
    shaking = gyro.copy()
    shaking[20 * N : 40 * N] *= 4
    assert covered(states(Stream(counts, gyro=gyro))[0], 0, 60) == 60
    found, _ = states(Stream(counts, gyro=shaking))
    assert (covered(found, 0, 20), covered(found, 20, 40), covered(found, 40, 60)) == (20, 0, 20)
    shaking[20 * N : 40 * N] = 2 * gyro[20 * N : 40 * N]
    assert covered(states(Stream(counts, gyro=shaking))[0], 0, 60) == 60


def test_a_gyroscope_that_is_switched_off_says_nothing() -> None:
    found, _ = states(Stream(rest(20, 3), gyro=np.zeros((20 * N, 3), np.int16)))
    assert covered(found, 0, 20) == 20


def test_states_end_at_breaks_unmeasured_rows_and_their_cap() -> None:
    validity = np.zeros(40 * N, np.uint8)
    validity[30 * N + 7] = Validity.CLIPPED
    found, counts = states(
        Stream(rest(40, 3), breaks=(12 * N,), validity=validity), replace(NUMBERS, max_windows=8)
    )
    assert found == [(0, 8), (8, 4), (12, 8), (20, 8), (28, 2), (31, 8)]
    assert (counts.clipped, counts.moving) == (1, 1)


def test_what_is_left_of_a_window_before_a_break_is_not_used() -> None:
    found, counts = batched(Stream(rest(10, 3), breaks=(5 * N + 20,)), N, AdaptiveRule(N, LSB_PER_G, NUMBERS))
    firsts = [first for windows in found for first in windows.first_sample.tolist()]
    assert firsts == [0, 5 * N + 20]
    assert counts.complete == 9


def test_a_state_ends_where_the_posture_changes() -> None:
    stream = Stream(np.concatenate([rest(10, 3), rest(10, 3, (0.05, 0, 1))]))
    assert states(stream)[0] == [(0, 10), (10, 10)]


@pytest.mark.parametrize("bits", [-7, -1, 0, 1, 9])
def test_means_agree_within_twice_the_least_deviation(bits: int) -> None:
    """(difference of sums / n)^2 < 2^2 var, where n var = least / 4^bits."""
    for least in (1, 7, 64, 4**9 * 64, 4**9 * 64 + 1, 10**9):
        limit = States(16, bits, NUMBERS).tolerance(least)
        variance = Fraction(least, 16) / Fraction(4) ** bits
        assert Fraction(limit, 16) ** 2 < 4 * variance <= Fraction(limit + 1, 16) ** 2


def test_a_still_window_between_movements_is_none() -> None:
    shaken = rest(5, 60)
    found, counts = states(Stream(np.concatenate([rest(10, 3), shaken, rest(1, 3), shaken, rest(10, 3)])))
    assert found == [(0, 10), (16 + 5, 10)]
    assert counts.moving == 11


def test_a_state_holds_all_its_samples() -> None:
    counts, warm = rest(7, 3), np.arange(7 * N, dtype=np.int32)
    ((windows,), _) = batched(Stream(counts, temperature_mc=warm), N, AdaptiveRule(N, LSB_PER_G, NUMBERS))
    assert windows.samples.tolist() == [7 * N]
    assert windows.sums.tolist() == [counts.sum(axis=0, dtype=np.int64).tolist()]
    assert windows.spread.tolist() == [np.ptp(counts, axis=0).tolist()]
    assert windows.temperature_sums is not None
    assert windows.temperature_sums.tolist() == [int(warm.sum())]


def test_temperatures_that_begin_late_begin_a_state() -> None:
    with_none = list(Stream(rest(10, 3)).chunks((5 * N,)))
    warm = np.full(5 * N, 30_000, np.int32)
    chunks = [with_none[0], replace(with_none[1], temperature_mc=warm)]
    segmenter = Segmenter(N, AdaptiveRule(N, LSB_PER_G, NUMBERS))
    found = [windows for chunk in chunks for windows in segmenter.feed(chunk)] + list(segmenter.finish())
    assert [windows.samples.tolist() for windows in found if len(windows)] == [[5 * N], [5 * N]]
    sums = [windows.temperature_sums for windows in found if len(windows)]
    assert sums[0] is None
    assert sums[1] is not None and sums[1].tolist() == [5 * N * 30_000]


def test_what_waits_is_bounded() -> None:
    """All windows are still: those that were not given wait, or are in the last state, of eight at most."""
    rule = AdaptiveRule(N, LSB_PER_G, replace(NUMBERS, held_windows=64, max_windows=8))
    segmenter = Segmenter(N, rule)
    given = 0
    for fed, chunk in enumerate(Stream(rest(1000, 3)).chunks(range(10 * N, 1000 * N, 10 * N)), 1):
        given += sum(int(windows.samples.sum()) for windows in segmenter.feed(chunk))
        assert 10 * fed - given // N <= 64 + 16 + 10 + 8
    assert given > 0
