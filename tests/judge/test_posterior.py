"""The posterior where its answer is known: good coverage, none at all, and sensors that are far off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.points import MODELS, Fit, PointSet
from accelcal_cli.core.prior import POPULATION, Prior
from accelcal_cli.judge.errors import uncertainty
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.judge.posterior import IDEAL as IDEAL_FIT
from accelcal_cli.judge.posterior import Circumstances, Posterior, posterior, speaks_against, sphere_errors
from accelcal_cli.optimize.fixed32 import OPTIMIZER
from tests.optimize.oracle import IDEAL, directions, measured, points

KNOWN_PLACE = Circumstances(limit_mg=10.0)
SENSOR = IDEAL + np.array([0.01, -0.02, 0.015, 0.01, -0.005, 0.008, 0.03, -0.02, 0.04, 0, 0, 0])[: len(IDEAL)]


def of(held: PointSet, prior: Prior = POPULATION) -> Posterior:
    assert OPTIMIZER.fit_penalized is not None
    number = len(set(postures(held, 15.0).tolist()))
    return posterior(held, number, MODELS["9"], prior, OPTIMIZER.fit_penalized)


def rest(sensor: np.ndarray, poses: np.ndarray, noise_g: float, seed: int = 1) -> PointSet:
    """Postures whose |a| scatters by so much."""
    scatter = 1 + noise_g * np.random.default_rng(seed).standard_normal((len(poses), 1))
    return points(measured(sensor, poses * scatter))


def values(known: Posterior) -> np.ndarray:
    return np.array(known.found.fit.parameters) / ONE


def test_with_good_coverage_the_points_decide() -> None:
    known = of(rest(SENSOR, directions(60), 0.0))
    assert np.abs(values(known)[:9] - SENSOR[:9]).max() < 2e-5
    far = SENSOR + np.eye(len(SENSOR))[4] * 0.05
    assert np.abs(values(of(rest(far, directions(60), 0.0)))[:9] - far[:9]).max() < 2e-5, "tails are heavy"


@pytest.mark.parametrize("noise_mg", [0.2, 2.0, 6.0])
def test_the_noise_is_that_of_the_postures(noise_mg: float) -> None:
    """Mean of ten: 51 left-over postures know it to a tenth each."""
    found = [of(rest(SENSOR, directions(60), noise_mg / 1000, seed)).noise_g for seed in range(10)]
    assert 1000 * np.mean(found) == pytest.approx(noise_mg, rel=0.12)


def test_standard_errors_are_those_of_least_squares_where_the_prior_is_wide(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """sigma^2 (J^T J)^-1 of |a| by differences, at the fitted parameters."""
    monkeypatch.setattr("accelcal_cli.judge.posterior.BENT", ())
    held = rest(SENSOR, directions(60), 0.002)
    known = of(held, replace(POPULATION, width=(10.0,) * 12))
    p, g, step = values(known)[:9], held.xyz / ONE, 1e-6

    def length(q: np.ndarray) -> np.ndarray:
        k = np.array([[q[0], 0, 0], [q[3], q[1], 0], [q[4], q[5], q[2]]])
        return np.asarray(np.sqrt((((g + q[6:9]) @ k.T) ** 2).sum(axis=1)))

    slopes = np.stack([(length(p + step * e) - length(p - step * e)) / (2 * step) for e in np.eye(9)], axis=1)
    number = len(set(postures(held, 15.0).tolist()))
    share = number / len(g)
    expected = known.noise_g * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes * share)))
    assert np.array(known.standard_errors()[:9]) == pytest.approx(expected, rel=0.01)
    assert known.standard_errors()[9:] == (0, 0, 0)
    plain = uncertainty(held, known.found.fit.parameters, MODELS["9"])
    assert plain is not None, "by the scatter of points, where the other is by that of postures"
    ratio = np.array(known.standard_errors()[:9]) / plain.standard_errors[:9]
    assert known.worst_direction_mg() == pytest.approx(plain.worst_direction_mg * ratio.mean(), rel=0.02)


def test_what_the_points_do_not_speak_of_stays_near_the_ideal_and_uncertain() -> None:
    """Postures about +x say one combination of its scale and its offset, and nothing of what is across."""
    turn = np.linspace(0, 6, 12)
    near = np.stack([np.ones(12), 0.3 * np.cos(turn), 0.3 * np.sin(turn)], axis=1)
    known = of(rest(IDEAL, near / np.sqrt((near**2).sum(axis=1))[:, None], 0.001))
    errors = known.standard_errors()
    scale, wide = POPULATION.width[0], POPULATION.width[6]
    assert 0.3 * scale < errors[0] < scale * 1.1
    assert 0.3 * wide < errors[6] < wide * 1.1
    assert np.abs(values(known) - np.array(IDENTITY) / ONE).max() < 0.01


def test_a_part_of_the_points_is_fitted_with_the_same_prior() -> None:
    held = rest(SENSOR, directions(60), 0.001)
    known = of(held)
    assert OPTIMIZER.fit_penalized is not None
    fits = known.fitter(OPTIMIZER.fit_penalized)
    whole, part = fits((held, held.select(np.arange(60) % 2 == 0)), MODELS["9"])
    found = known.found.fit
    assert (whole.parameters, whole.bend) == (found.parameters, found.bend)
    assert part.parameters != whole.parameters
    assert np.abs(np.array(part.parameters) - whole.parameters).max() / ONE < 5e-3


def test_the_order_of_the_points_makes_no_difference() -> None:
    held = rest(SENSOR, directions(30), 0.002)
    mixed = held.select(np.random.default_rng(2).permutation(30))
    assert of(held) == of(mixed)


def sphere(known: Posterior, held: PointSet, judged: Fit | None = None) -> tuple[float, tuple[float, float]]:
    (found,) = sphere_errors(held, postures(held, 15.0), known, [judged or known.found.fit], KNOWN_PLACE)
    return found.mean, found.ci95


def test_over_the_sphere_an_offset_leaves_half_of_it() -> None:
    """The mean of |cos| over the sphere is 1/2: an offset of 20 mg that is not corrected leaves 10 mg."""
    moved = IDEAL + np.eye(len(IDEAL))[6] * 0.02
    held = rest(moved, directions(200), 0.0)
    known = of(held)
    mean, (low, high) = sphere(known, held, IDEAL_FIT)
    assert mean == pytest.approx(10.0, rel=0.02)
    assert low < mean < high and high - low < 0.3
    (found,) = sphere_errors(held, postures(held, 15.0), known, [IDEAL_FIT], KNOWN_PLACE)
    assert found.worst_direction == pytest.approx(20.0, rel=0.02)
    assert abs(found.worst_direction_at[0]) > 0.99


def test_verdicts_6_the_scatter_of_rests_is_no_error_of_the_calibration() -> None:
    """The mean of |n| is sqrt(2 / pi) sigma; what the coefficients are off is a tenth of it here."""
    held = rest(SENSOR, directions(200), 0.003)
    known = of(held)
    assert known.rest_scatter_mg() == pytest.approx(3 * np.sqrt(2 / np.pi), rel=0.15)
    mean, (low, high) = sphere(known, held)
    error = true_error_mg(SENSOR, known)
    assert low < error < high < 0.5 * known.rest_scatter_mg()
    assert mean < 0.3 * known.rest_scatter_mg()


NEAR = replace(
    POPULATION, centre=(*SENSOR[:9], 0.0, 0.0, 0.0), width=(0.002,) * 6 + (0.004,) * 3 + (0.001,) * 3
)
"""What others of its model say of SENSOR."""


def few(sensor: np.ndarray) -> PointSet:
    """Six postures on one side of the sphere."""
    poses = directions(40)
    return rest(sensor, poses[poses[:, 2] > 0.1][::3][:6], 0.001)


def test_what_is_left_open_is_near_the_centre_of_a_learnt_prior() -> None:
    known, usual = (of(few(SENSOR), prior) for prior in (NEAR, POPULATION))
    away, before = (np.abs(values(one)[:9] - SENSOR[:9]).max() for one in (known, usual))
    assert away < 0.002 < before / 3
    assert known.penalty.centre[6] == round(SENSOR[6] * ONE)


def test_points_speak_against_a_prior_that_is_of_other_sensors() -> None:
    far = SENSOR + np.eye(len(SENSOR))[6:9].sum(axis=0) * 0.2
    for sensor, against in ((SENSOR, False), (far, True)):
        held = few(sensor)
        pair = of(held, NEAR), of(held, POPULATION)
        assert speaks_against(*pair, (NEAR, POPULATION), held) is against


def test_offsets_at_the_centre_follow_the_temperature() -> None:
    """20 mg at 25 degrees and 1 mg per degree: 25 mg at the points' 30, if the prior decides."""
    narrow = replace(NEAR, centre=(1.0,) * 3 + (0.0,) * 3 + (0.02,) * 3 + (0.001,) * 3, width=(1e-6,) * 12)
    held = points(measured(IDEAL, directions(20)), tau=np.linspace(-1, 1, 20), span_c=4.0)
    assert OPTIMIZER.fit_penalized is not None
    known = posterior(held, 20, MODELS["9T"], replace(narrow, reference_c=25.0), OPTIMIZER.fit_penalized)
    assert known.penalty.centre[6:] == (round(0.025 * ONE),) * 3 + (round(0.004 * ONE),) * 3


def true_error_mg(sensor: np.ndarray, known: Posterior) -> float:
    """Mean | |a| - 1 g | over 400 directions that the fit leaves, without any scatter."""
    p = values(known)
    k = np.array([[p[0], 0, 0], [p[3], p[1], 0], [p[4], p[5], p[2]]])
    calibrated = (measured(sensor, directions(400)) + p[6:9]) @ k.T
    return float(1000 * np.abs(np.sqrt((calibrated**2).sum(axis=1)) - 1).mean())


def half(random: np.random.Generator) -> np.ndarray:
    """Twelve directions on one side of the sphere and a little beyond."""
    lean = random.standard_normal(3)
    poses = directions(60)[directions(60) @ lean > -0.3 * np.sqrt(lean @ lean)]
    return np.asarray(poses[random.permutation(len(poses))[:12]])


def test_verdicts_5_a_sensor_that_is_far_off_is_less_certain_where_nothing_was_seen() -> None:
    """The same postures on one side: of a sensor like most, and of one that is 5 % and 100 mg off."""
    far = IDEAL.copy()
    far[[0, 1, 2, 6, 7, 8]] += (0.05, -0.05, 0.05, 0.1, 0.1, -0.1)
    found = []
    for sensor in (SENSOR, far):
        held = rest(sensor, half(np.random.default_rng(2))[:8], 0.001)
        known = of(held)
        found.append((known, *sphere(known, held)))
    (usual, mean, _), (odd, wider, (low, high)) = found
    assert not usual.parameters_outside_prior() and {"ox", "oy", "oz"} & set(odd.parameters_outside_prior())
    assert wider > 1.5 * mean
    assert low < true_error_mg(far, odd) < high


def test_the_probability_to_be_better_than_raw_values() -> None:
    """Certain for a sensor that is far off, nothing for one that was ideal and whose rests scatter."""
    for sensor, noise_g, certain in ((SENSOR, 0.001, True), (IDEAL, 0.006, False)):
        held = rest(sensor, half(np.random.default_rng(3)), noise_g)
        known, label = of(held), postures(held, 15.0)
        fitted, raw = sphere_errors(held, label, known, (known.found.fit, IDEAL_FIT), KNOWN_PLACE)
        assert (fitted.probably_better() > 0.99) is certain
        assert fitted.probably_better() == min(fitted.better_everywhere, fitted.better_where_worn)
        assert raw.probably_better() == 0, "no better than it is itself"


@pytest.mark.nightly
def test_the_interval_holds_the_error_over_the_sphere() -> None:
    """Sensors drawn from the prior, in few postures: in 90 % and more, and it is seldom too low."""
    random, holds, above = np.random.default_rng(7), 0, 0
    for seed in range(200):
        size = np.array([0.018] * 3 + [0.013] * 3 + [0.035] * 3) * random.standard_t(4, 9)
        sensor = IDEAL.copy()
        sensor[:9] += size
        held = rest(sensor, half(random), 0.002, seed)
        known = of(held)
        _, (low, high) = sphere(known, held)
        error = true_error_mg(sensor, known)
        holds, above = holds + (low <= error <= high), above + (error > high)
    assert holds >= 180 and above <= 10
