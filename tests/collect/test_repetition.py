"""What a recording holds twice is used once, and told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.collect.repetition import LEAST_WINDOWS, Repetitions
from accelcal_cli.core.points import Windows, joined_windows
from tests.cli.run import run
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
    for key in ("outcome", "calibration", "sphere_mg", "holdout", "coverage"):
        assert two[key] == one[key], key
    windows = two["fit"]["windows"]
    assert (windows["repeated"], windows["used"]) == (one["fit"]["windows"]["used"],) * 2
    assert two["message"] == (
        f"{one['message']}; {windows['repeated']} still windows repeat earlier ones exactly and were left out"
    )
    assert one["fit"]["windows"]["repeated"] == 0
