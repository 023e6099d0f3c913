"""Measures of activity by epoch, against plain loops over rows and values found by hand."""

from __future__ import annotations

from itertools import pairwise
from math import atan2, degrees, hypot, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.pipeline.activity import MG, Activity, ActivityMeter, Affine, EpochCutter

SECOND = 1_000_000


def measured(times_us, *versions, rate_hz=10.0, epoch_s=5, step=10**9) -> ActivityMeter:
    """Versions (n, 3) of rows, fed so many at a time."""
    measuring = ActivityMeter(len(versions), epoch_s, rate_hz)
    for first in range(0, len(times_us), step):
        part = slice(first, first + step)
        xyz = [[axis.astype(np.float32) for axis in one[part].T] for one in versions]
        measuring.feed(times_us[part], xyz)
    measuring.finish()
    return measuring


def of_one(times_us, xyz, **how) -> Activity:
    return measured(times_us, xyz, **how).result()[0]


def times(number: int, rate_hz: float = 10.0) -> np.ndarray:
    return (np.arange(number) * SECOND / rate_hz).astype(np.int64)


def wrist(number: int, seed: int = 3) -> np.ndarray:
    random = np.random.RandomState(seed)
    slow = np.cumsum(random.randn(number, 3) * 0.05, axis=0)
    return (slow / np.linalg.norm(slow, axis=1, keepdims=True) + 0.1 * random.randn(number, 3)).astype("f4")


def by_loops(times_us, xyz, epoch_s: int, rate_hz: float) -> dict[str, float]:
    """ENMO, MAD, MVPA, PIM and ZCM as their papers say it, row by row in double precision."""
    rows: dict[int, list[float]] = {}
    for time, row in zip(times_us.tolist(), xyz.tolist(), strict=True):
        rows.setdefault(time // (epoch_s * SECOND), []).append(sqrt(sum(v * v for v in row)))
    whole = [one for one in rows.values() if len(one) >= 0.8 * epoch_s * rate_hz]
    enmo = [sum(max(r - 1, 0) for r in one) / len(one) for one in whole]
    mad = [sum(abs(r - sum(one) / len(one)) for r in one) / len(one) for one in whole]
    off = [[abs(r - 1) for r in one] for one in whole]
    crossed = sum((a > 0.1) != (b > 0.1) for one in off for a, b in pairwise(one))
    return {
        "enmo_mg": 1000 * sum(enmo) / len(enmo),
        "mad_mg": 1000 * sum(mad) / len(mad),
        "mvpa_min": sum(one >= 0.1 for one in enmo) * epoch_s / 60,
        "pim_mg_s": 1000 * 60 * sum(sum(one) / len(one) for one in off) / len(off),
        "zcm": 60 * rate_hz * crossed / sum(map(len, whole)),
    }


@pytest.mark.parametrize("epoch_s", [1, 5, 60])
def test_they_are_what_their_papers_say(epoch_s: int) -> None:
    xyz, at = wrist(3011), times(3011)
    found = of_one(at, xyz, epoch_s=epoch_s)
    for name, value in by_loops(at, xyz, epoch_s, 10.0).items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-8), name


def test_a_constant_length_is_its_own_enmo() -> None:
    xyz = np.tile([0.0, 0.0, 1.25], (200, 1))
    found = of_one(times(200), xyz)
    assert found == Activity(250.0, 0.0, 20 / 60, 15_000.0, 0.0, 90.0, 0.0, 0.0)


def test_crossings_are_counted_within_epochs() -> None:
    """Rows that go over 1.1 g and back every second: two crossings in each 2 s, none where epochs meet."""
    length = np.where(np.arange(100) // 10 % 2, 1.25, 1.0)
    found = of_one(times(100), np.stack([length * 0, length * 0, length], axis=1), epoch_s=2)
    assert found.zcm == 60 * 10.0 * 5 / 100


@given(step=st.integers(1, 400), seed=st.integers(0, 5))
def test_any_length_of_the_chunks_gives_the_same(step: int, seed: int) -> None:
    xyz, at = wrist(900, seed), times(900) + 1_234_567
    at[500:] += 17 * SECOND
    whole, other = measured(at, xyz, 1.01 * xyz), measured(at, xyz, 1.01 * xyz, step=step)
    assert whole.result() == other.result()
    assert (whole.epochs, whole.short, whole.rows) == (other.epochs, other.short, other.rows)


def test_drawn_vectors_of_one_row_are_those_of_many() -> None:
    random = np.random.default_rng(1)
    affine = Affine(np.tril(random.normal(size=(3, 3))), random.normal(size=3), random.normal(size=3))
    xyz, celsius = random.normal(size=(500, 3)), random.normal(size=500)
    alone = [affine.vectors(xyz[row : row + 1], celsius[row : row + 1]) for row in range(500)]
    whole = np.stack(affine.vectors(xyz, celsius))
    assert (whole == np.stack(alone)[:, :, 0].T).all()
    heat = affine.shift + np.multiply.outer(celsius, affine.per_c)
    assert np.allclose(whole.T, xyz @ affine.mix.T + heat, rtol=0, atol=1e-14)


def test_epochs_that_lack_samples_have_no_value() -> None:
    at = np.delete(times(200), slice(50, 61))  # the second epoch has 39 of 50 rows, the others all
    measuring = measured(at, np.tile([0, 0, 1.0], (len(at), 1)))
    assert (measuring.epochs, measuring.short, measuring.rows) == (3, 1, 150)


def test_what_differs_is_told_against_the_last_version() -> None:
    still = np.tile([0, 0, 1.0], (200, 1))
    measuring = measured(times(200), 1.25 * still, still)
    assert [one.enmo_differs_mg for one in measuring.result()] == [250.0, 0.0]


def turned(angles: list[float], rate_hz: float = 10.0) -> np.ndarray:
    """5 s at each angle of the arm [degrees]."""
    each = np.repeat(np.radians(angles), round(5 * rate_hz))
    return np.stack([np.cos(each), 0 * each, np.sin(each)], axis=1)


@pytest.mark.parametrize(
    ("angles", "minutes"),
    [
        ([0] * 60, 5.0),
        ([0] * 59, 0.0),
        ([0] * 60 + [10] * 30, 5.0),
        ([0] * 60 + [4] * 30, 7.5),
        ([0] * 40 + [6] * 40, 0.0),
        ([0, 4.9] * 40, 80 * 5 / 60),
        ([0, 5.1] * 40, 0.0),
    ],
)
def test_inactivity_is_five_minutes_without_a_turn(angles: list[float], minutes: float) -> None:
    xyz = turned(angles)
    assert of_one(times(len(xyz)), xyz).inactive_min == pytest.approx(minutes)


def test_inactivity_does_not_go_on_over_a_gap() -> None:
    xyz = turned([0] * 80)
    at = times(len(xyz))
    at[len(at) // 2 :] += 60 * SECOND
    assert of_one(at, xyz).inactive_min == 0
    assert of_one(times(len(xyz)), xyz, epoch_s=60).inactive_min == pytest.approx(80 / 12)


def test_the_angle_is_that_of_the_mean_of_five_seconds() -> None:
    """Every turn by loops, from means of 5 s."""
    xyz, at = wrist(6000, 1) * [1, 1, 0.3] + [2.0, 0, 0], times(6000)
    means = xyz.astype("f4").astype("f8").reshape(-1, 50, 3).mean(axis=1)
    angle = [degrees(atan2(z, hypot(x, y))) for x, y, z in means]
    run, total = 1, 0
    for before, after in zip(angle, [*angle[1:], 1e9], strict=True):
        if abs(after - before) > 5:
            total, run = total + (run if run >= 60 else 0), 0
        run += 1
    assert of_one(at, xyz).inactive_min == pytest.approx(total / 12)


def test_a_clock_that_stands_does_not_fill_the_memory() -> None:
    cutter, seen = EpochCutter(5 * SECOND, 100), []
    for _ in range(50):
        seen += [part.rows.tolist() for part in cutter.feed(np.zeros(30, np.int64), np.zeros(30, np.int64))]
    seen += [part.rows.tolist() for part in cutter.finish()]
    assert sum(map(sum, seen)) == 1500 and max(map(max, seen)) == 100


def test_nothing_measured_has_no_figures() -> None:
    measuring = measured(np.empty(0, np.int64), np.empty((0, 3)))
    assert measuring.result()[0] == Activity(None, None, 0.0, None, None, None, 0.0, None)
    assert MG * 2**32 == 1000
