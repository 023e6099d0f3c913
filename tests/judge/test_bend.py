"""The bend of a sensor's response: found within its claimed errors, at little cost where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import NO_BEND, Calibration
from accelcal_cli.core.points import MODELS, PointSet
from accelcal_cli.core.prior import POPULATION
from accelcal_cli.core.results import SphereError
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.judge.posterior import IDEAL, Circumstances, Posterior, posterior, sensor_of, sphere_errors
from accelcal_cli.optimize.fixed32 import OPTIMIZER
from tests.judge.made import NINE
from tests.optimize.oracle import directions, drawn_errors, measured, points, random_directions


def known_of(held: PointSet) -> tuple[Posterior, np.ndarray]:
    assert OPTIMIZER.fit_penalized is not None
    label = postures(held, 15.0)
    return posterior(held, int(label.max()) + 1, MODELS["9"], POPULATION, OPTIMIZER.fit_penalized), label


def bent(straight: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """What a sensor measures that v + bend v^2 straightens."""
    raw = straight
    for _ in range(8):
        raw = straight - bend * raw**2
    return raw


def left_mg(known: Posterior, sensor: np.ndarray, bend: np.ndarray) -> float:
    """Mean | |a| - 1 g | over 2000 directions that the fit leaves."""
    found, raw = sensor_of(known.found.fit), bent(measured(sensor, directions(2000)), bend)
    a = (found.straight(raw) + found.offset_g()) @ found.gain().T
    return float(1000 * np.abs(np.linalg.norm(a, axis=1) - 1).mean())


def worn(
    seed: int, size: float, number: int, noise_g: float = 0.0015
) -> tuple[PointSet, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    poses = random_directions(random, number) * (1 + noise_g * random.standard_normal((number, 1)))
    sensor, bend = drawn_errors(random), size * random.choice((-1, 1), 3)
    return points(bent(measured(sensor, poses), bend)), sensor, bend


@pytest.mark.parametrize("size", [0.005, 0.01, 0.02])
def test_bends_lie_within_their_claimed_errors(size: float) -> None:
    away = []
    for seed in range(20):
        held, _, bend = worn(seed, size, 70)
        known, _ = known_of(held)
        found = np.array(known.found.fit.bend) / ONE
        errors = np.sqrt(np.diag(np.array(known.covariance))[-3:])
        away += (np.abs(found - bend) / errors).tolist()
    assert np.mean(np.array(away) < 2) >= 0.9 and max(away) < 5


def test_where_none_is_it_costs_next_to_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with_bend, without = [], []
    for seed in range(30):
        held, sensor, bend = worn(seed, 0.0, 25)
        with_bend.append(left_mg(known_of(held)[0], sensor, bend))
    monkeypatch.setattr("accelcal_cli.judge.posterior.BENT", ())
    for seed in range(30):
        held, sensor, bend = worn(seed, 0.0, 25)
        known, _ = known_of(held)
        without.append(left_mg(known, sensor, bend))
        assert known.found.fit.bend == NO_BEND
    assert np.mean(with_bend) <= 1.02 * np.mean(without)


def test_a_bend_of_a_hundredth_is_corrected_for_the_most_part() -> None:
    held, sensor, bend = worn(3, 0.01, 70)
    fitted, linear = known_of(held)[0], Calibration("9", IDEAL.parameters)
    assert left_mg(fitted, sensor, bend) < 0.5
    assert linear.bend == NO_BEND


def claimed(held: PointSet, known: Posterior, label: np.ndarray) -> SphereError:
    (found,) = sphere_errors(held, label, known, (known.found.fit,), Circumstances(10.0))
    return found


def test_the_claim_counts_a_bend_where_the_wrist_has_not_been() -> None:
    """Postures on nine tenths of the sphere: what is left out is where the bend shows most."""
    poses, bend = directions(70), np.array([0.02, -0.015, 0.01])
    lengths = 1 + 0.0015 * np.random.RandomState(1).standard_normal((len(poses), 1))
    held = points(bent(measured(NINE, poses * lengths), bend)[poses[:, 0] < 0.8])
    known, label = known_of(held)
    low, high = claimed(held, known, label).ci95
    assert low <= left_mg(known, NINE, bend) <= high


@pytest.mark.parametrize("signs", [(-1, 1, 1), (1, -1, 1), (-1, -1, -1)])
def test_a_mirrored_axis_has_the_mirrored_bend(signs: tuple[int, int, int]) -> None:
    held, _, _ = worn(5, 0.01, 40)
    one, _ = known_of(held)
    other, _ = known_of(points(held.xyz_g() * np.array(signs)))
    assert np.abs(np.array(other.found.fit.bend) * signs - one.found.fit.bend).max() <= ONE >> 17
