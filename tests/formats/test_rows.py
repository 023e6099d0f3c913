"""Rows across block borders: values that were not measured, and long runs of equal samples."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.formats._rows import MISSING, HeldChannels, RepeatedSamples, first_values, missing_kind


def samples(*runs: tuple[int, int]) -> np.ndarray:
    values = np.repeat([value for value, _ in runs], [size for _, size in runs])
    return np.stack((np.zeros_like(values), values, np.ones_like(values)), axis=1).astype(np.int16)


def marked(counts: np.ndarray, least: int, block: int, usable: np.ndarray | None = None) -> list[bool]:
    finder, start, marks = RepeatedSamples(least), 0, []
    for stop in range(block, len(counts) + block, block):
        part = None if usable is None else usable[start:stop]
        given = finder.mark(counts[start:stop], part, last=stop >= len(counts))
        start += len(given)
        marks += given.tolist()
    return marks


RUNS = samples((5, 3), (6, 4), (5, 1), (6, 9), (7, 2), (8, 4))
MARKS = [False] * 4 + [True] * 3 + [False] * 2 + [True] * 8 + [False] * 3 + [True] * 3


@pytest.mark.parametrize("block", [1, 2, 3, 5, 8, 100])
def test_all_but_the_first_sample_of_a_long_run_are_marked(block: int) -> None:
    assert marked(RUNS, 4, block) == MARKS


@pytest.mark.parametrize("block", [1, 2, 3, 5, 8, 100])
def test_a_sample_that_cannot_be_used_repeats_nothing(block: int) -> None:
    usable = np.ones(10, np.bool_)
    usable[4] = False
    assert marked(samples((3, 10)), 4, block, usable) == [False] + [True] * 3 + [False] + [True] * 5


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_samples_are_equal_only_on_all_axes(axis: int) -> None:
    counts = samples((3, 6))
    counts[3, axis] += 1
    assert not any(marked(counts, 4, 100))


def test_no_run_of_a_single_sample_is_sleep() -> None:
    assert marked(samples((1, 1), (2, 2), (3, 1)), 1, 100) == [False, False, True, False]


def test_only_a_run_that_may_become_long_is_left_over() -> None:
    finder = RepeatedSamples(4)
    assert len(finder.mark(samples((1, 1), (2, 3)), last=False)) == 1
    assert finder.mark(samples((2, 4)), last=False).tolist() == [False, True, True, True]
    assert finder.mark(samples((2, 1), (3, 2)), last=True).tolist() == [True, False, False]
    assert finder.mark(samples(), last=True).tolist() == []


def test_sleep_goes_on_over_any_number_of_blocks_without_being_kept() -> None:
    finder = RepeatedSamples(50)
    finder.mark(samples((7, 50)), last=False)
    for _ in range(5):
        assert finder.mark(samples((7, 10)), last=False).all()


def values(*numbers: int | None) -> np.ndarray:
    return np.array([MISSING if number is None else number for number in numbers], np.int32)


def test_every_channel_of_single_values_repeats_its_last_one() -> None:
    gyro = np.full((3, 3), MISSING, np.int32)
    block = {"temperature_mc": values(None, 5, None), "other": values(None, None, 8), "gyro_counts": gyro}
    first = first_values(block)
    assert first == {"temperature_mc": 5, "other": 8}
    held = HeldChannels(first)
    filled = held.fill(block)
    assert filled["temperature_mc"].tolist() == [5, 5, 5] and filled["other"].tolist() == [8, 8, 8]
    assert filled["gyro_counts"] is gyro
    filled = held.fill({"temperature_mc": values(None, 6), "other": values(), "gyro_counts": gyro})
    assert filled["temperature_mc"].tolist() == [5, 6] and filled["temperature_mc"].dtype == np.int32
    assert held.fill({"temperature_mc": values(None), "other": values(None)})["other"].tolist() == [8]


def test_a_channel_without_gaps_is_not_copied() -> None:
    held = HeldChannels({"temperature_mc": 5})
    whole = {"temperature_mc": values(8, 8, 8, 8, 8, 9)}
    assert held.fill(whole)["temperature_mc"] is whole["temperature_mc"]
    assert held.fill({"temperature_mc": values(None)})["temperature_mc"].tolist() == [9]


def test_a_channel_that_was_not_measured_at_first_is_left_out_throughout() -> None:
    first = first_values({"temperature_mc": values(None, None), "other": values(1, None)})
    assert first == {"temperature_mc": None, "other": 1}
    assert list(HeldChannels(first).fill({"temperature_mc": values(3), "other": values(2)})) == ["other"]


def test_a_problem_names_the_channel_whose_values_are_missing() -> None:
    assert missing_kind("temperature_mc")[1].startswith("samples without a temperature, ")
    assert missing_kind("light_lux")[1].startswith("samples without light_lux, ")
