"""Samples at a fixed rate: scipy's filter, times, gaps, and independence of how rows were cut."""

from __future__ import annotations

from math import gcd

import numpy as np
import pytest
import scipy  # its parts are loaded when they are used
from hypothesis import given, settings
from hypothesis import strategies as st

from accelcal_cli.exports.rows import SampleRows, resampled

START_US = 1_700_000_000_000_000


def of(values: np.ndarray, rate_hz: float, start_us: int = START_US, celsius: bool = False) -> SampleRows:
    """Rows at even times; the same values on x, negative on y, and 1 on z."""
    times = start_us + np.rint(np.arange(len(values)) * 1e6 / rate_hz).astype(np.int64)
    xyz = np.stack([values, -values, np.ones_like(values)], axis=1).astype(np.float32)
    return SampleRows(times, xyz, np.arange(len(values), dtype=np.float32) if celsius else None)


def joined(portions: list[SampleRows]) -> SampleRows:
    celsius = [part.celsius for part in portions if part.celsius is not None]
    return SampleRows(
        np.concatenate([part.time_us for part in portions]),
        np.concatenate([part.xyz for part in portions]),
        np.concatenate(celsius) if celsius else None,
    )


def at(rows: SampleRows, rate_hz: float, wanted_hz: float) -> SampleRows:
    return joined(list(resampled([rows], rate_hz, wanted_hz)))


def wave(rate_hz: float, number: int) -> np.ndarray:
    t = np.arange(number) / rate_hz
    return 0.7 * np.sin(2 * np.pi * 1.3 * t) + 0.2 * np.cos(2 * np.pi * 4.1 * t)


@pytest.mark.parametrize(("rate", "wanted"), [(100, 30), (100, 50), (25, 80), (50, 100), (64, 30)])
def test_it_is_what_scipy_gives_away_from_the_ends(rate: int, wanted: int) -> None:
    values = wave(rate, 20 * rate)
    found = at(of(values, rate), rate, wanted)
    shared = gcd(rate, wanted)
    expected = scipy.signal.resample_poly(values, wanted // shared, rate // shared)[: len(found)]
    inner = slice(2 * wanted, -2 * wanted)
    assert np.abs(found.xyz[inner, 0] - expected[inner]).max() < 1e-3
    assert np.abs(found.xyz[inner, 0] + found.xyz[inner, 1]).max() == 0.0


@pytest.mark.parametrize(("rate", "wanted"), [(100.0, 30.0), (30.0, 100.0), (85.7, 40.0), (100.0, 1.0)])
def test_rest_stays_rest_up_to_the_ends(rate: float, wanted: float) -> None:
    found = at(of(np.full(3000, 0.37), rate), rate, wanted)
    assert np.abs(found.xyz - np.float32([0.37, -0.37, 1.0])).max() < 1e-6


def test_the_same_rate_gives_the_same_values() -> None:
    rows = of(wave(50, 400), 50)
    found = at(rows, 50, 50)
    assert np.array_equal(found.time_us, rows.time_us)
    assert np.abs(found.xyz - rows.xyz).max() < 1e-6


def test_what_the_new_rate_cannot_hold_is_taken_out() -> None:
    t = np.arange(4000) / 100
    found = at(of(np.sin(2 * np.pi * 30 * t), 100), 100, 30)
    assert np.abs(found.xyz[40:-40, 0]).max() < 5e-3


def test_times_are_multiples_of_the_period_from_the_first_sample_to_the_last() -> None:
    rows = of(wave(100, 1001), 100)
    found = at(rows, 100, 30)
    assert len(found) == 301
    assert found.time_us.tolist() == [START_US + (2_000_000 * k + 30) // 60 for k in range(301)]
    assert at(of(wave(100, 1000), 100), 100, 30).time_us[-1] == START_US + 9_966_667


def test_a_clock_that_is_off_its_nominal_rate_is_followed() -> None:
    true = 100.4
    values = np.sin(2 * np.pi * np.arange(40_000) / true)
    found = at(of(values, true), 100.0, 25.0)
    expected = np.sin(2 * np.pi * np.arange(len(found)) / 25)
    assert np.abs(found.xyz[30:-30, 0] - expected[30:-30]).max() < 3e-3  # ripple of the filter


def test_temperature_is_linear_between_samples() -> None:
    found = at(of(np.zeros(101), 10, celsius=True), 10, 40)
    assert found.celsius is not None
    assert np.abs(found.celsius - np.arange(401) / 4).max() < 1e-4


def gapped() -> list[SampleRows]:
    """Stretches of 3 s, 1 sample and 2 s: a gap of 10 s, one of two periods, and times that go back."""
    second = START_US + 13_000_000
    return [
        of(wave(50, 150), 50),
        of(wave(50, 1), 50, second),
        of(wave(50, 100), 50, second + 40_000),
        of(wave(50, 100), 50, second),
    ]


def test_gaps_stay_gaps_and_each_stretch_is_as_if_alone() -> None:
    parts = gapped()
    found = at(joined(parts), 50, 20)
    alone = joined([at(part, 50, 20) for part in parts])
    assert np.array_equal(found.time_us, alone.time_us)
    assert np.array_equal(found.xyz, alone.xyz)
    assert len(at(parts[1], 50, 20)) == 1


CUTS = st.lists(st.integers(1, 260), min_size=1, max_size=40)


@settings(max_examples=10)
@given(CUTS, st.sampled_from([20.0, 33.3, 100.0]))
def test_how_the_rows_are_cut_makes_no_difference(lengths: list[int], wanted: float) -> None:
    rows = joined([*gapped(), of(wave(50, 700), 50, START_US + 60_000_000)])
    ends = np.minimum(np.cumsum([*lengths, len(rows)]), len(rows))
    cut = [rows.part(int(a), int(b)) for a, b in zip([0, *ends[:-1]], ends, strict=True) if b > a]
    found, whole = joined(list(resampled(cut, 50, wanted))), at(rows, 50, wanted)
    assert np.array_equal(found.time_us, whole.time_us)
    assert found.xyz.tobytes() == whole.xyz.tobytes()
