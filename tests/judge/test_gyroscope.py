"""The verdict on a gyroscope: a known scale is found again, and what cannot be judged is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY, Calibration, Correction, TemperatureScale
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.gyroscope import Bias, Gyroscope, Rest, RestRates, Turn, Turns
from accelcal_cli.judge import gyroscope
from accelcal_cli.judge.gyroscope import judge_gyroscope
from tests.judge.test_turning import by_quaternions

Floats = NDArray[np.float64]
LSB, PER_G, PERIOD_US = 16.0, 4096.0, 10_000.0
DPS = (1 / LSB, 1 / LSB, 1 / LSB)
SCALE = np.array([[1.02, 0.01, -0.015], [-0.008, 0.97, 0.012], [0.005, -0.02, 1.03]])
BIAS = (24, -40, 8)
"""Counts."""
PERFECT = Calibration("9", IDENTITY)


def rest(direction: Floats, sample: int, noise: Floats | None = None) -> Rest:
    measured = direction if noise is None else direction + noise
    sums = np.rint(measured * PER_G * 500).astype(int).tolist()
    return Rest(sample, 500, tuple(sums), tuple(500 * one for one in BIAS), None)


def made(number: int, axes: tuple[int, ...] = (0, 1, 2), noise_g: float = 0.0, seed: int = 1) -> Turns:
    """Random turns about some axes of a gyroscope with a known scale, 0.8 s each."""
    random = np.random.default_rng(seed)
    turns: list[Turn] = []
    while len(turns) < number:
        counts = np.zeros((80, 3))
        shape = np.sin(np.linspace(0, np.pi, 80))[:, np.newaxis]
        counts[:, axes] = random.normal(0, 120, len(axes)) * LSB * shape
        counts = np.rint(counts + random.normal(0, 3, counts.shape) * (len(axes) > 1))
        start = random.normal(size=3)
        start /= np.linalg.norm(start)
        end = by_quaternions(counts.astype(np.int32), start, SCALE / LSB, PERIOD_US / 1e6)
        if start @ end < 0.9:
            errors = random.normal(0, noise_g, (2, 3))
            sample = 1000 * len(turns)
            before, after = rest(start, sample, errors[0]), rest(end, sample + 580, errors[1])
            turns.append(Turn(before, after, (counts + BIAS).astype(np.int32), PERIOD_US))
    rates = RestRates(np.array([1000] * 20), np.tile(np.array(BIAS) * 1000, (20, 1)), None)
    return Turns(tuple(turns), rates, 0, DPS, PER_G, PERIOD_US / 1e6)


def test_without_noise_the_scale_is_found_exactly() -> None:
    found = judge_gyroscope(made(30), PERFECT, None)
    assert found.outcome == "calibrated", found.reason
    np.testing.assert_allclose(found.scale, SCALE, atol=2e-6)
    assert found.bias is not None and found.holdout is not None
    assert found.bias.dps == tuple(one / LSB for one in BIAS)
    assert found.holdout.after < 1e-3
    assert found.holdout.before > 1


def test_with_noise_it_is_within_its_errors() -> None:
    off = []
    for seed in range(4):
        found = judge_gyroscope(made(40, noise_g=0.004, seed=seed), PERFECT, None)
        assert found.outcome == "calibrated", found.reason
        off += ((np.array(found.scale) - SCALE) / np.array(found.standard_errors)).ravel().tolist()
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.4
    assert np.abs(off).max() < 4


def test_the_accelerometers_calibration_comes_first() -> None:
    """Raw values that are off by its inverse, by temperature, and by a course, give the same scale."""
    gain, offset, slope = np.diag([1.1, 0.9, 1.05]), np.array([0.05, -0.04, 0.02]), np.array([0.01, 0, -0.01])
    gain[1, 0] = 0.02
    scale = TemperatureScale(30_000, 1.0)
    numbers = [1.1, 0.9, 1.05, 0.02, 0, 0, *offset, *slope]
    knots = ((round(1.25 * ONE), ONE, ONE),)
    correction = Correction((0,), knots, ((0, 0, round(0.01 * ONE)),), lines=False)
    calibration = Calibration("9T", tuple(round(one * ONE) for one in numbers), scale, correction=correction)
    plain = made(30)

    def worn(one: Rest, celsius: float) -> Rest:
        a = np.array(one.sums) / one.samples / PER_G
        v = np.linalg.solve(gain, a) - offset - slope * (celsius - 30)
        v = (v - [0, 0, 0.01]) / [1.25, 1, 1]
        sums = np.rint(v * PER_G * one.samples).astype(int).tolist()
        return replace(one, sums=tuple(sums), temperature_sum=round(celsius * 1000 * one.samples))

    turns = tuple(
        replace(turn, before=worn(turn.before, 20 + index % 9), after=worn(turn.after, 35 - index % 7))
        for index, turn in enumerate(plain.turns)
    )
    found = judge_gyroscope(replace(plain, turns=turns), calibration, None)
    np.testing.assert_allclose(found.scale, SCALE, atol=3e-6)


def test_held_out_errors_are_those_of_fits_without_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """One step from the fit of all leads as far as fits from the beginning do."""
    turns = made(25, noise_g=0.004)
    found = judge_gyroscope(turns, PERFECT, None)
    monkeypatch.setattr(gyroscope, "HUBER", 1e9)
    plain = judge_gyroscope(turns, PERFECT, None)
    angles: list[float] = []
    for fold in range(5):
        inside = [turn for index, turn in enumerate(turns.turns) if index * 5 // 25 != fold]
        outside = [turn for index, turn in enumerate(turns.turns) if index * 5 // 25 == fold]
        scale = np.array(judge_gyroscope(replace(turns, turns=tuple(inside)), PERFECT, None).scale)
        for turn in outside:
            u, v = (np.array(one.sums) / np.linalg.norm(one.sums) for one in (turn.before, turn.after))
            end = by_quaternions(turn.counts - np.array(BIAS), u, scale / LSB, 0.01)
            angles.append(float(np.degrees(np.arccos(min(1.0, end @ v)))))
    assert plain.holdout is not None and found.holdout is not None
    assert plain.holdout.after == pytest.approx(np.median(angles), rel=2e-3)
    assert plain.holdout.mean_after == pytest.approx(np.mean(angles), rel=2e-3)
    low, high = found.holdout.ci95
    assert low < found.holdout.after < high


@pytest.mark.parametrize(
    ("turns", "reason"),
    [
        (lambda: made(11), Reason.of("too_few_turns", turns=11, least_deg=20.0, needed=12)),
        (lambda: made(40, axes=(2,)), "turns_miss_an_axis"),
        (
            lambda: replace(made(30), rates=RestRates(np.empty(0), np.empty((0, 3)), None)),
            "gyroscope_never_at_rest",
        ),
        (lambda: mixed(made(30)), "gravity_still_off"),
        (lambda: made(12, noise_g=0.03), "too_little_turning"),
    ],
)
def test_refusals(turns: Any, reason: str | Reason) -> None:
    found = judge_gyroscope(turns(), PERFECT, None)
    assert (found.outcome, found.scale) == ("refused", None)
    assert reason in (found.reason, found.reason.code)


def mixed(turns: Turns) -> Turns:
    """Each turn with the end of another."""
    others = turns.turns[1:] + turns.turns[:1]
    pairs = zip(turns.turns, others, strict=True)
    return replace(turns, turns=tuple(replace(turn, after=other.after) for turn, other in pairs))


def test_an_axis_that_is_turned_round_is_found_and_told() -> None:
    found = judge_gyroscope(replace(made(30), dps_per_lsb=(-1 / LSB, 1 / LSB, 1 / LSB)), PERFECT, None)
    np.testing.assert_allclose(found.scale, SCALE * [-1, 1, 1], atol=1e-5)
    assert found.reason.code == "gyroscope_calibrated" and found.reason.values["unusual"] is True


def test_without_a_calibration_of_the_accelerometer_there_is_the_bias_alone() -> None:
    found = judge_gyroscope(made(30), None, None)
    assert (found.outcome, found.reason) == ("refused", Reason("accelerometer_not_calibrated"))
    assert found.bias is not None and found.bias.dps[0] == 1.5


def test_rates_are_calibrated_by_the_equation() -> None:
    """w = S (r - b - c (T - Tref)) by hand: 10 - 1 - 0.5 * 2 = 8 on raw x; y and z are at their bias."""
    bias = Bias((1.0, 2.0, 3.0), None, (0.5, 0.0, 0.0), 30.0, 60.0, 0.0, None, None)
    found = Gyroscope("calibrated", "", 12, scale=((2, 0, 0), (0.5, 1, 0), (0, 0, 1)), bias=bias)
    raw = [np.array([10.0]), np.array([2.0]), np.array([3.0])]
    assert [one.tolist() for one in found.calibrated(raw, np.array([32.0]))] == [[16.0], [4.0], [0.0]]
    assert [one.tolist() for one in found.calibrated(raw, None)] == [[18.0], [4.5], [0.0]]


def test_a_jolt_counts_for_little() -> None:
    turns = made(40, noise_g=0.002)
    jolted = turns.turns[7]
    counts = jolted.counts.copy()
    counts[40] += 8000
    others = (*turns.turns[:7], replace(jolted, counts=counts), *turns.turns[8:])
    found = judge_gyroscope(replace(turns, turns=others), PERFECT, None)
    plain = judge_gyroscope(turns, PERFECT, None)
    apart = np.abs(np.array(found.scale) - np.array(plain.scale)) / np.array(plain.standard_errors)
    assert apart.max() < 1
