"""The sensor is the inverse of the calibration."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import RandomState

from accelcal_cli.simulate import SimulatedSensor, draw_gain_and_offset
from tests.optimize.oracle import measured, random_directions

GAIN = np.array([[1.04, 0, 0], [0.02, 0.95, 0], [-0.03, 0.015, 1.01]])
SENSOR = SimulatedSensor(
    GAIN, np.array([0.03, -0.05, 0.02]), np.array([0.001, -0.002, 0.0015]), 0.0, 256.0, 8.0
)


@pytest.mark.parametrize("lsb_per_g", [64.0, 256.0, 4096.0])
def test_the_calibration_gives_the_acceleration_back_to_half_a_count(lsb_per_g: float) -> None:
    random = np.random.default_rng(1)
    sensor = replace(SENSOR, lsb_per_g=lsb_per_g, range_g=4.0)
    a = 1.5 * random_directions(random, 500)
    warm = random.uniform(20, 40, 500)
    v = sensor.counts(a, warm, RandomState(0)) / lsb_per_g
    back = (v + sensor.offset_g + np.outer(warm - 30.0, sensor.slope_g_per_c)) @ GAIN.T
    half = 0.5 / lsb_per_g
    assert (abs(back - a) <= half * abs(GAIN).sum(axis=1) + 1e-12).all()
    p = np.array([1.04, 0.95, 1.01, 0.02, -0.03, 0.015, 0.03, -0.05, 0.02, 0.001, -0.002, 0.0015])
    assert (abs(v - measured(p, a, warm - 30.0)) <= half + 1e-12).all(), "F's eq. 19, mended"


def test_counts_are_clipped_at_the_range() -> None:
    a = np.array([[20.0, -20.0, 0.0]])
    ideal = replace(SENSOR, gain=np.eye(3), offset_g=np.zeros(3), slope_g_per_c=np.zeros(3))
    counts = ideal.counts(a, np.array([30.0]), RandomState(0))
    assert counts.tolist() == [[2047, -2048, 0]] and counts.dtype == np.int16
    widest = replace(ideal, lsb_per_g=4096.0).counts(a, np.array([30.0]), RandomState(0))
    assert widest.tolist() == [[32_767, -32_768, 0]]


def test_noise_has_its_size_and_its_seed() -> None:
    noisy = replace(SENSOR, noise_g=0.01, lsb_per_g=4096.0, range_g=8.0)
    a, warm = np.tile([0.0, 0.0, 1.0], (20_000, 1)), np.full(20_000, 30.0)
    counts = noisy.counts(a, warm, RandomState(5))
    assert counts.std(axis=0) / 4096 == pytest.approx([0.01] * 3, rel=0.03)
    assert (counts == noisy.counts(a, warm, RandomState(5))).all()
    assert (counts != noisy.counts(a, warm, RandomState(6))).any()


def test_drawn_errors_are_half_of_the_papers_ranges() -> None:
    drawn = [draw_gain_and_offset(seed, 1.0, 1.0) for seed in range(300)]
    scale = np.array([np.diag(gain) for gain, _ in drawn])
    tilt = np.array([[g[1, 0] / g[1, 1], g[2, 0] / g[2, 2], g[2, 1] / g[2, 2]] for g, _ in drawn])
    offset = np.array([item for _, item in drawn])
    for values, centre, limit in ((scale, 1, 0.05), (tilt, 0, 0.025), (offset, 0, 0.05)):
        assert abs(values - centre).max() <= limit
        assert (abs(values - centre).max(axis=0) > 0.95 * limit).all()
    assert all((np.triu(gain, 1) == 0).all() for gain, _ in drawn)


def test_errors_can_be_switched_off_and_repeated() -> None:
    gain, offset = draw_gain_and_offset(3, 0.0, 1.0)
    assert gain.tolist() == np.eye(3).tolist() and not offset.any()
    straight, _ = draw_gain_and_offset(3, 1.0, 0.0)
    assert straight.tolist() == np.diag(np.diag(straight)).tolist()
    again, first = draw_gain_and_offset(3, 1.0, 1.0), draw_gain_and_offset(3, 1.0, 1.0)
    assert (again[0] == first[0]).all() and (again[1] == first[1]).all()


def test_the_truth_of_a_sensor_goes_into_json() -> None:
    text = json.loads(json.dumps(SENSOR.as_json()))
    assert text["gain"] == GAIN.tolist() and text["offset_g"] == [0.03, -0.05, 0.02]
    assert (text["reference_c"], text["lsb_per_g"], text["range_g"]) == (30.0, 256.0, 8.0)
