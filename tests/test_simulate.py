"""The simulated stream and the truth about it."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.recording import Chunk
from accelcal_cli.simulate import (
    START_US,
    SimulatedSensor,
    SimulationPlan,
    Truth,
    Wearer,
    describe,
    draw_gain_and_offset,
    stream,
    temperature_c,
)

GAIN, OFFSET = draw_gain_and_offset(11, 1.0, 1.0)
SENSOR = SimulatedSensor(GAIN, OFFSET, np.array([0.0009, -0.0006, 0.0012]), 0.003, 1024.0, 8.0)
PLAN = SimulationPlan(0.1, 25.0, 4, SENSOR)


def made(plan: SimulationPlan) -> tuple[list[Chunk], Truth]:
    truth, chunks, samples = Truth(), [], 0
    for chunk in stream(plan, truth):
        chunks.append(chunk)
        samples += len(chunk)
        assert samples <= plan.samples, "the stream does not end"
    return chunks, truth


def counts(plan: SimulationPlan) -> np.ndarray:
    return np.concatenate([chunk.counts for chunk in made(plan)[0]])


@pytest.mark.parametrize(("days", "rate_hz", "samples"), [
    (0.01, 100.0, 86_400), (0.0123, 33.3, 35_389), (0.02, 12.5, 21_600), (1e-5, 85.7, 74),
    (0.03, 100 / 3, 86_400),
])  # fmt: skip
def test_the_stream_has_the_planned_samples_without_a_gap(days: float, rate_hz: float, samples: int) -> None:
    plan = SimulationPlan(days, rate_hz, 1, SENSOR)
    chunks, _ = made(plan)
    assert plan.samples == samples == sum(len(chunk) for chunk in chunks)
    edges = np.cumsum([0, *(len(chunk) for chunk in chunks)])
    assert [chunk.first_sample for chunk in chunks] == edges[:-1].tolist()
    assert all(len(chunk.breaks) == 0 and chunk.validity is None and chunk.problems == () for chunk in chunks)
    times = np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks])
    whole = UniformClock(START_US, 0, rate_fraction(rate_hz)).times(0, samples)
    assert (times == whole).all() and times[0] == START_US


def test_the_same_seed_gives_the_same_counts() -> None:
    plan = replace(PLAN, days=0.01)
    assert (counts(plan) == counts(plan)).all()
    assert (counts(plan) != counts(replace(plan, seed=5))).any()


def test_a_longer_recording_begins_like_a_shorter_one() -> None:
    short, long = counts(replace(PLAN, days=0.01)), counts(replace(PLAN, days=0.013))
    assert (long[: len(short)] == short)[:-1].all()


def test_the_known_truth_brings_still_stretches_to_one_g() -> None:
    _, truth = made(PLAN)
    assert truth.stretches == len(truth.before) == len(truth.after) > 300
    assert np.mean(truth.before) > 5
    assert np.mean(truth.after) < 0.3 and max(truth.after) < 1.5


def test_stillness_that_an_outsider_finds_has_one_g_with_the_true_parameters() -> None:
    chunks, _ = made(PLAN)
    raw = np.concatenate([chunk.counts for chunk in chunks]) / 1024.0
    warm = np.concatenate([chunk.temperature_mc for chunk in chunks]) / 1000 - SENSOR.reference_c
    length = 250
    windows = raw[: len(raw) // length * length].reshape(-1, length, 3)
    heat = warm[: len(raw) // length * length].reshape(-1, length).mean(axis=1)
    quiet = (windows.std(axis=1) < 0.004).all(axis=1)
    v = windows[quiet].mean(axis=1)
    a = (v + OFFSET + np.outer(heat[quiet], SENSOR.slope_g_per_c)) @ GAIN.T
    assert quiet.sum() > 300
    assert np.median(abs(np.sqrt((a**2).sum(axis=1)) - 1)) < 0.3e-3
    assert np.mean(abs(np.sqrt((v**2).sum(axis=1)) - 1)) > 5e-3


def test_temperature_is_there_where_planned() -> None:
    warm, _ = made(replace(PLAN, days=0.01))
    cold, _ = made(replace(PLAN, days=0.01, temperature=False))
    for chunk, bare in zip(warm, cold, strict=True):
        assert chunk.temperature_mc is not None and chunk.temperature_mc.dtype == np.int32
        assert chunk.temperature_mc.shape == (len(chunk),)
        assert bare.temperature_mc is None and (bare.counts == chunk.counts).all()


def test_temperature_does_not_jump_between_chunks_and_falls_off_the_wrist() -> None:
    parts = [temperature_c(0, 600, 10.0, worn=True), temperature_c(600, 600, 10.0, worn=True)]
    assert (np.concatenate(parts) == temperature_c(0, 1200, 10.0, worn=True)).all()
    assert temperature_c(0, 5, 10.0, worn=False) == pytest.approx(parts[0][:5] - 5)
    day = temperature_c(0, 86_400, 1.0, worn=True)
    assert 20 < day.min() < day.max() < 40


def test_the_description_is_the_plans() -> None:
    found = describe(PLAN, Path("a.bin"), "flash")
    assert (found.samples, found.rate_hz, found.lsb_per_g, found.range_g) == (PLAN.samples, 25.0, 1024.0, 8.0)
    assert (found.start_us, found.has_temperature, found.format) == (START_US, True, "flash")
    assert not describe(replace(PLAN, temperature=False), Path("a.bin"), "flash").has_temperature


def test_the_truth_goes_into_json() -> None:
    _, truth = made(PLAN)
    text = json.loads(json.dumps(truth.as_json()))
    assert text["stretches"] == truth.stretches and text["seconds"] == 10
    assert text["before_mg"] == pytest.approx(np.mean(truth.before))
    assert text["with_true_parameters_mg"] == pytest.approx(np.mean(truth.after))
    assert Truth().as_json()["before_mg"] is None


def test_a_motionless_bout_holds_one_direction_of_length_one() -> None:
    for bout in islice(Wearer(10.0, 7).bouts(), 400):
        assert bout.acceleration.shape == (len(bout.still), 3) and len(bout.still) > 0
        held = bout.acceleration[bout.still]
        if len(held):
            assert abs((held**2).sum(axis=1) - 1).max() < 1e-12
            assert (held == held[0]).all()
            assert bout.still[np.argmax(bout.still) :].all(), "stillness lasts to the end of its bout"


def test_a_bout_begins_where_the_last_rest_ended() -> None:
    joined = 0
    for one, other in pairwise(islice(Wearer(50.0, 7).bouts(), 400)):
        if one.still.any() and other.still.any():
            assert abs(one.acceleration[-1] - other.acceleration[0]).max() < 0.05
            joined += 1
    assert joined > 20


def test_the_watch_lies_on_the_table_in_the_evening_alone() -> None:
    rate, seconds, off = 1.0, 0.0, 0
    for bout in Wearer(rate, 3).bouts():
        hour = seconds / 3600 % 24
        assert bout.worn or 20.5 <= hour < 21
        off += not bout.worn
        seconds += len(bout.still) / rate
        if seconds > 7 * 86_400:
            break
    assert off > 0
