"""Still windows without repetitions, and what rest measures of them."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.collect.cells import Histogram
from accelcal_cli.collect.still_windows import LEAST_WINDOWS, SAMPLE_STEP, Repetitions, RestSums
from accelcal_cli.core.clock import UniformClock
from accelcal_cli.core.points import Windows, joined_windows
from accelcal_cli.core.recording import Chunk, Validity
from tests.cli.run import run
from tests.collect.made import windows
from tests.recordings import directions, still_counts, write_raw

Capture = pytest.CaptureFixture[str]


def measured(number: int, seed: int = 1) -> Windows:
    """Windows 500 samples apart, whose sums and spreads are random; every tenth never changes."""
    random = np.random.default_rng(seed)
    spread = random.integers(1, 9, (number, 3))
    spread[::10] = 0
    sums = random.integers(-9999, 9999, (number, 3))
    return Windows(np.full(number, 500), 500 * np.arange(number), sums, spread)


def played(*parts: tuple[Windows, int]) -> Windows:
    """Windows one after another, each part from a first sample on."""
    moved = [
        Windows(one.samples, one.first_sample - one.first_sample[0] + at, one.sums, one.spread)
        for one, at in parts
    ]
    return joined_windows(moved)


def once(windows: Windows, batch: int) -> tuple[list[int], int]:
    """First samples of what is passed on, in batches of so many, and how many are not."""
    filtered = Repetitions()
    batches = [
        windows.select(np.arange(at, min(at + batch, len(windows)))) for at in range(0, len(windows), batch)
    ]
    passed = [part.first_sample.tolist() for part in filtered.once(batches)]
    return [first for part in passed for first in part], filtered.windows


@pytest.mark.parametrize("batch", [1, 7, 50, 4096])
def test_a_stretch_is_passed_on_once_however_the_windows_come(batch: int) -> None:
    one, other = measured(120), measured(50, seed=2)
    stretch = one.select(np.arange(31, 90))
    twice = played((one, 0), (other, 100_000), (stretch, 200_000), (other.select(np.arange(5, 9)), 300_000))
    kept, left_out = once(twice, batch)
    expected = twice.first_sample.tolist()
    assert left_out == len(stretch)
    assert kept == expected[:170] + expected[170 + len(stretch) :]


@pytest.mark.parametrize("batch", [1, 7, 4096])
def test_what_is_played_three_times_is_passed_on_once(batch: int) -> None:
    one = measured(60)
    kept, left_out = once(played((one, 0), (one, 50_000), (one, 90_000)), batch)
    assert left_out == 2 * len(one) - 2, "a first window that never changes is no part of a stretch"
    assert len(kept) == 60 + 2


@pytest.mark.parametrize("batch", [1, 5, 4096])
def test_what_may_be_chance_stays(batch: int) -> None:
    one = measured(100).select(np.flatnonzero(np.arange(100) % 10 > 0))
    short = one.select(np.arange(LEAST_WINDOWS - 1))
    spaced = Windows(one.samples, 2 * one.first_sample, one.sums, one.spread)
    backward = one.select(np.arange(len(one))[::-1])
    for other in (short, spaced):
        assert once(played((one, 0), (other, 90_000)), batch)[1] == 0
    moved = Windows(one.samples, 90_000 + one.first_sample, backward.sums, backward.spread)
    assert once(joined_windows([one, moved]), batch)[1] == 0
    asleep = Windows(one.samples, one.first_sample, 0 * one.sums, 0 * one.spread)
    twice = played((asleep, 0), (asleep, 90_000))
    assert once(twice, batch) == (twice.first_sample.tolist(), 0)


@pytest.mark.parametrize("batch", [1, 7, 4096])
def test_a_window_of_its_own_within_a_copy_makes_two_of_it(batch: int) -> None:
    one, other = measured(60), measured(9, seed=2)
    first, second = one.select(np.arange(1, 20)), one.select(np.arange(21, 41))
    own = other.select(np.array([3]))
    twice = played((one, 0), (first, 90_000), (own, 99_500), (second, 100_500))
    assert once(twice, batch) == (twice.first_sample.tolist(), 0)
    whole = played((one, 0), (first, 90_000), (second, 100_000))
    assert once(whole, batch)[1] == len(first) + len(second) - 1, "one, the last, never changes"


def test_a_recording_played_twice_gives_what_it_gives_once(tmp_path: Path, capsys: Capture) -> None:
    counts = still_counts(directions(60))
    reports = []
    for name, held in (("once", counts), ("twice", np.concatenate([counts, counts]))):
        path = write_raw(tmp_path / f"{name}.raw", held)
        reports.append(json.loads(run(capsys, "calibrate", path, "--json", "-q", "--report-only").out))
    one, two = reports
    for key in ("outcome", "calibration", "calibration_error_mg", "reason", "values", "holdout", "coverage"):
        assert two[key] == one[key], key
    windows = two["fit"]["windows"]
    assert (windows["repeated"], windows["used"]) == (one["fit"]["windows"]["used"],) * 2
    assert one["notes"] == []
    assert two["notes"] == [{"code": "windows_repeated", "values": {"windows": windows["repeated"]}}]
    assert one["fit"]["windows"]["repeated"] == 0


LENGTH = 8
CLOCK = UniformClock(0, 0, Fraction(25))


def of_g(*vectors: tuple[float, float, float]) -> Windows:
    """Windows of these means [g], at 1000 counts per g."""
    return windows(LENGTH, [tuple(round(1000 * LENGTH * value) for value in vector) for vector in vectors])


def test_quantiles_extremes_and_error() -> None:
    sums = RestSums(1000.0)
    sums.add_windows(of_g((0, 0, 1.0), (0, 0.1, -0.9), (2.0, 0.2, 0)))
    rest = sums.result()
    assert (rest.windows, rest.median_g, rest.p5_g) == (3, 1.0, pytest.approx(0.9055, rel=0.005))
    assert rest.p95_g == pytest.approx(2.00998, rel=0.005)
    assert rest.axis_min_g == (0.0, 0.0, -0.9) and rest.axis_max_g == (2.0, 0.2, 1.0)
    assert rest.error_mg == pytest.approx((0 + 1000 - 905.5385) / 2, abs=1e-4)
    assert rest.alike == ()


def test_axes_that_are_alike_in_every_window() -> None:
    sums = RestSums(1000.0)
    sums.add_windows(of_g((0.5, 0.5, 1.0), (0.5, 0.5, 0.5)))
    assert sums.result().alike == ("x", "y")
    sums.add_windows(of_g((0.5, 0.4, 0.5)))
    assert sums.result().alike == ()


@pytest.mark.parametrize("cut", [1, SAMPLE_STEP, 1000])
def test_samples_are_taken_at_the_same_places_in_any_chunks(cut: int) -> None:
    counts = np.zeros((2 * SAMPLE_STEP + 1, 3), np.int16)
    counts[[0, SAMPLE_STEP, 2 * SAMPLE_STEP], 0] = 4000, 3000, 2000  # the first is filled: no median of three
    validity = np.zeros(len(counts), np.uint8)
    validity[0] = Validity.FILLED
    sums = RestSums(1000.0)
    for start in range(0, len(counts), cut):
        part = slice(start, start + cut)
        sums.add_samples(Chunk(start, counts[part], CLOCK, 0, validity=validity[part]))
    assert sums.result().samples_median_g == 2.0


def test_a_quantile_is_the_smallest_value_that_enough_others_do_not_exceed() -> None:
    held = Histogram()
    assert held.quantile(50) is None
    held.add(np.array([1, 2, 3, 200, 100_000]))
    assert [held.quantile(percent) for percent in (0, 20, 50, 80)] == [1, 1, 3, 200]
    assert held.quantile(100) == 100_000 >> 9 << 9
