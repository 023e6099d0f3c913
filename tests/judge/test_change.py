"""Sensors that change while they record, and sensors that do not: observations made here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import Calibration, TemperatureScale
from accelcal_cli.core.errors import significant
from accelcal_cli.core.points import MODELS, TimedMeans
from accelcal_cli.core.prior import POPULATION
from accelcal_cli.core.results import Change
from accelcal_cli.judge.change import ChangeSearch, change_reason, possible_changes, probable_change
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.judge.posterior import posterior
from accelcal_cli.optimize.fixed32 import OPTIMIZER
from accelcal_cli.output.sentences import sentence
from tests.optimize.oracle import points

GAIN = np.array([[1.02, 0.0, 0.0], [0.012, 0.985, 0.0], [-0.008, 0.006, 1.01]])
OFFSET_G = np.array([0.03, -0.02, 0.045])
SLOPE_G_PER_C = np.array([0.001, -0.0005, 0.0008])
HOURS, HOUR_SAMPLES = 60, 3600
Course = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Of raw means (n, 3) of a sensor that stays as it is, and their blocks: what it measures."""


def calibration(*, slopes: float = 0) -> Calibration:
    """The true one of the sensor that stays as it is; its slopes are so many times those of SLOPE_G_PER_C."""
    parameters = (1.02, 0.985, 1.01, 0.012, -0.008, 0.006, *OFFSET_G, *(SLOPE_G_PER_C * slopes))
    scale = TemperatureScale(30_000, 1.0) if slopes else None
    return Calibration("9", tuple(round(value * ONE) for value in parameters), scale)


def means(
    course: Course, *, seed: int = 1, hours: int = HOURS, noise_g: float = 0.0018, warm: bool = False
) -> TimedMeans:
    """Eight postures an hour, of forty, whose |a| scatters as that of real bouts does."""
    random = np.random.RandomState(seed)
    postures = random.standard_normal((40, 3))
    postures /= np.linalg.norm(postures, axis=1)[:, None]
    block = np.repeat(np.arange(hours), 8)
    true = postures[random.randint(40, size=len(block))]
    true = true * (1 + noise_g * random.standard_normal(len(block)))[:, None]
    celsius = 30 + 4 * np.sin(block / 4) + random.standard_normal(len(block)) if warm else None
    raw = true @ np.linalg.inv(GAIN).T - OFFSET_G
    if celsius is not None:
        raw = raw - np.outer(celsius - 30, SLOPE_G_PER_C)
    return TimedMeans(block, course(raw, block), celsius, HOUR_SAMPLES, 1.0)


def find_change(observed: TimedMeans, found: Calibration) -> Change:
    return ChangeSearch(observed).find(found)


def constant(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
    return raw


def step(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
    return raw + np.outer(block >= 23, [0.012, -0.010, 0.012])


def gain(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
    return raw * (1 + 0.03 * (block >= 31))[:, None]


def drift(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
    return raw + np.outer(block / HOURS, [0.010, -0.010, 0.010])


def wander(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
    return raw + np.outer(np.sin(2 * np.pi * block / 48), [0.010, -0.010, 0.010])


def device(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
    other = (raw + OFFSET_G) @ GAIN.T @ np.linalg.inv(np.diag([0.97, 1.02, 0.98])).T - [0.0, 0.05, -0.03]
    return np.where((block >= 40)[:, None], other, raw)


@pytest.mark.parametrize("warm", [False, True])
@pytest.mark.parametrize("seed", range(1, 11))
def test_a_sensor_that_stays_as_it_is_gives_no_alarm(seed: int, warm: bool) -> None:
    found = find_change(means(constant, seed=seed, warm=warm), calibration(slopes=warm))
    assert (found.kind, found.unchecked, found.size_mg) == ("none", None, None)
    assert found.holdout is not None
    assert found.holdout.stretches == 20  # of three hours
    assert found.holdout.constant_mg == pytest.approx(0.0018 * 0.798 * 1000, rel=0.15)  # mean of |normal|


@pytest.mark.parametrize(
    ("course", "kind", "block", "offset_mg", "scale_percent"),
    [
        (step, "step", 23, (12, -10, 12), (0, 0, 0)),
        (gain, "gain", 31, (0, 0, 0), (3, 3, 3)),
        (drift, "drift", None, (10, -10, 10), (0, 0, 0)),
    ],
)
def test_a_change_is_found_with_its_kind_place_and_size(
    course: Course,
    kind: str,
    block: int | None,
    offset_mg: tuple[float, ...],
    scale_percent: tuple[float, ...],
) -> None:
    found = find_change(means(course), calibration())
    assert (found.kind, found.at_block) == (kind, block)
    assert found.offset_mg == pytest.approx(offset_mg, abs=1.5)
    assert found.scale_percent == pytest.approx(scale_percent, abs=0.15)
    assert found.holdout is not None and found.holdout.changing_mg is not None
    assert found.holdout.changing_mg < 2 < found.holdout.constant_mg
    largest = 1000 * np.linalg.norm(np.array([0.012, -0.010, 0.012]) @ GAIN.T)
    if kind == "step":
        assert found.size_mg == pytest.approx(largest, rel=0.1)


def test_another_device_and_wandering_offsets_are_told_apart() -> None:
    found = find_change(means(device), calibration())
    assert (found.kind, found.at_block) == ("device", 40)
    assert find_change(means(wander), calibration()).kind == "walk"


def test_what_temperature_explains_is_no_change() -> None:
    """Offsets that follow a temperature that rises throughout."""
    cold = means(constant, hours=48)
    celsius = 20 + cold.block / 4.0 + np.random.RandomState(3).standard_normal(len(cold.block))
    raw = cold.mean_g - np.outer(celsius - 30, 3 * SLOPE_G_PER_C)
    warm = replace(cold, mean_g=raw, celsius=celsius)
    assert find_change(warm, calibration(slopes=3)).kind == "none"
    assert find_change(replace(warm, celsius=None), calibration()).kind == "drift"


@pytest.mark.parametrize("hours", [1, 7])
def test_what_is_too_short_is_said(hours: int) -> None:
    found = find_change(means(step, hours=hours), calibration())
    assert (found.kind, found.holdout) == ("none", None)
    assert found.unchecked == "too_short"


def test_a_long_recording_in_one_block_is_not_called_short() -> None:
    """As where there are too many orientations and temperatures to be kept apart along time."""
    long = means(step, hours=48)
    joined = TimedMeans(0 * long.block, long.mean_g, None, 1 << 40, float(1 << 40) / HOUR_SAMPLES)
    found = find_change(joined, calibration())
    assert (found.kind, found.holdout) == ("none", None)
    assert found.unchecked == "too_many_cells"


def test_nothing_at_all_is_too_short() -> None:
    empty = TimedMeans(np.zeros(0, np.int64), np.zeros((0, 3)), None, HOUR_SAMPLES, 1.0)
    assert find_change(empty, calibration()).unchecked is not None


def test_blocks_without_stillness_are_passed_over() -> None:
    """As where the device was not worn; the numbers of blocks go on."""
    worn = means(step)
    away = np.where(worn.block >= 23, worn.block + 10, worn.block)
    found = find_change(TimedMeans(away, worn.mean_g, None, HOUR_SAMPLES, 1.0), calibration())
    assert (found.kind, found.at_block) == ("step", 33)


def test_a_change_is_a_caution_with_its_size_and_what_it_leaves() -> None:
    found = find_change(means(step), calibration())
    assert change_reason(Change("none"), None, followed=False) is None
    caution = change_reason(found, None, followed=False)
    assert caution is not None and caution.code == "sensor_changed"
    assert caution.values["kind"] == "step" and caution.values["size_mg"] == significant(found.size_mg or 0)
    text = sentence(caution)
    assert "its offsets jump at" in text and f"up to {found.size_mg:.1f} mg. In the recorded" in text
    followed = change_reason(found, None, followed=True)
    assert followed is not None and sentence(followed).endswith(" The calibration follows it.")


@pytest.mark.parametrize(
    ("course", "samples", "lines"),
    [
        (step, (0, 23 * HOUR_SAMPLES), False),
        (gain, (0, 31 * HOUR_SAMPLES), False),
        (drift, (0, HOURS * HOUR_SAMPLES), True),
        (wander, tuple(HOUR_SAMPLES * hour for hour in range(0, HOURS + 1, 6)), True),
    ],
)
def test_what_puts_a_sensor_right_gives_that_of_one_that_stays(
    course: Course, samples: tuple[int, ...], lines: bool
) -> None:
    observed, quiet = means(course, noise_g=0.0002), means(constant, noise_g=0.0002)
    search = ChangeSearch(observed)
    found = search.find(calibration())
    assert found.correction is not None
    assert (found.correction.samples, found.correction.lines) == (samples, lines)
    found = search.refined(calibration(), search.refined(calibration(), found))
    assert found.correction is not None
    put_right = observed.corrected(found.correction).mean_g
    constant_shift = (put_right - quiet.mean_g).mean(axis=0)
    limit = 0.003 if course is wander else 0.0003
    assert np.abs(put_right - quiet.mean_g - constant_shift).max() < limit


def test_another_device_is_not_followed() -> None:
    assert find_change(means(device), calibration()).correction is None


def small(part: float, raw: np.ndarray, block: np.ndarray) -> np.ndarray:
    """A part of the step, half-way through 300 hours."""
    return raw + part * np.outer(block >= 150, [0.012, -0.010, 0.012])


@pytest.mark.parametrize(("part", "kind"), [(0.15, "none"), (0.2, "drift")])
def test_what_hardly_changes_the_error_is_no_alarm_however_clear_it_is(part: float, kind: str) -> None:
    """4 % less is clear by six standard errors, and nobody's concern; 7 % less is told."""
    assert find_change(means(partial(small, part), hours=300, noise_g=0.0025), calibration()).kind == kind


def probability(course: Course, seed: int = 1, noise_g: float = 0.0018) -> tuple[float, float]:
    """Probability of a change, and the share of the time before it, by the posterior of the same rests."""
    seen = means(course, seed=seed, hours=32, noise_g=noise_g)
    held = points(seen.mean_g)
    assert OPTIMIZER.fit_penalized is not None
    number = int(postures(held, 15.0).max()) + 1
    known = posterior(held, number, MODELS["9"], POPULATION, OPTIMIZER.fit_penalized)
    return probable_change(possible_changes(seen, known, None, 1.0, 15.0))


def half_way(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
    return raw + np.outer(block >= 16, [0.025, -0.020, 0.025])


def late(raw: np.ndarray, block: np.ndarray) -> np.ndarray:
    other = (raw + OFFSET_G) @ GAIN.T @ np.linalg.inv(np.diag([0.97, 1.02, 0.98])).T - [0.0, 0.05, -0.03]
    return np.where((block >= 24)[:, None], other, raw)


@pytest.mark.parametrize(("course", "before"), [(half_way, 0.5), (late, 0.75)])
def test_a_change_has_its_probability_and_its_eighth_of_the_time(course: Course, before: float) -> None:
    found, share = probability(course)
    assert found > 0.95 and share == before


def test_a_sensor_that_stays_as_it_is_has_probably_not_changed() -> None:
    assert max(probability(constant, seed)[0] for seed in range(12)) < 0.3


def test_an_hour_leaves_no_moment_for_a_change() -> None:
    seen = means(constant, hours=1)
    held = points(seen.mean_g)
    assert OPTIMIZER.fit_penalized is not None
    known = posterior(held, 8, MODELS["9"], POPULATION, OPTIMIZER.fit_penalized)
    assert possible_changes(seen, known, None, 1.0, 15.0) == [] and probable_change([]) == (0.0, 0.0)
