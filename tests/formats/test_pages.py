"""Channels of page dumps: values that were not measured."""

from __future__ import annotations

import numpy as np

from accelcal_cli.formats._pages.pages import MISSING, HeldChannels, first_values
from accelcal_cli.formats._pages.reader import missing_kind


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


def test_values_that_stay_the_same_are_looked_at_where_they_begin() -> None:
    held, starts = HeldChannels({"temperature_mc": 5}), np.array([0, 2, 5])
    channels = {"temperature_mc": values(6, 6, None, None, None, 7)}
    assert held.fill(channels, starts)["temperature_mc"].tolist() == [6, 6, 6, 6, 6, 7]
    whole = {"temperature_mc": values(8, 8, 8, 8, 8, 9)}
    assert held.fill(whole, starts)["temperature_mc"] is whole["temperature_mc"]
    unlike = {"temperature_mc": values(9, None)}  # not as promised
    assert held.fill(unlike, starts[:1])["temperature_mc"] is unlike["temperature_mc"]
    held = HeldChannels({"temperature_mc": 9})
    assert held.fill({"temperature_mc": values(None)}, starts[:1])["temperature_mc"].tolist() == [9]


def test_a_channel_that_was_not_measured_at_first_is_left_out_throughout() -> None:
    first = first_values({"temperature_mc": values(None, None), "other": values(1, None)})
    assert first == {"temperature_mc": None, "other": 1}
    assert list(HeldChannels(first).fill({"temperature_mc": values(3), "other": values(2)})) == ["other"]


def test_a_problem_names_the_channel_whose_values_are_missing() -> None:
    assert missing_kind("temperature_mc")[1].startswith("samples without a temperature, ")
    assert missing_kind("light_lux")[1].startswith("samples without light_lux, ")
