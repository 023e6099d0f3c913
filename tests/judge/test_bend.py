"""The bend of a sensor's response: found within its claimed errors, at little cost where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import NO_BEND
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import MODELS, PointSet
from accelcal_cli.core.prior import POPULATION
from accelcal_cli.core.results import SphereError
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.judge.posterior import (
    Circumstances,
    Posterior,
    calibration_of_fit,
    posterior,
    sensor_of,
    sphere_errors,
)
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


def without_bend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("accelcal_cli.judge.posterior.BENT", ())


@pytest.mark.parametrize(("number", "mean", "worst"), [(12, 1.1, 6.0), (18, 1.1, 3.0), (25, 1.06, 1.0)])
def test_where_none_is_it_costs_little(
    monkeypatch: pytest.MonkeyPatch, number: int, mean: float, worst: float
) -> None:
    """On average a few percent, and never many mg, also where a wide bend would fit by chance."""
    sets = [worn(seed, 0.0, number) for seed in range(25)]
    bent = np.array([left_mg(known_of(held)[0], sensor, bend) for held, sensor, bend in sets])
    without_bend(monkeypatch)
    linear = np.array([left_mg(known_of(held)[0], sensor, bend) for held, sensor, bend in sets])
    assert known_of(sets[0][0])[0].found.fit.bend == NO_BEND
    assert bent.mean() <= mean * linear.mean() and (bent - linear).max() < worst


def test_a_bend_of_a_hundredth_is_corrected_for_the_most_part(monkeypatch: pytest.MonkeyPatch) -> None:
    held, sensor, bend = worn(3, 0.01, 70)
    fitted = left_mg(known_of(held)[0], sensor, bend)
    without_bend(monkeypatch)
    assert fitted < 0.6 and fitted < left_mg(known_of(held)[0], sensor, bend) / 3


def test_a_fold_has_a_bend_of_its_own() -> None:
    """What is held out says nothing of the bend that it is judged with."""
    held, _, _ = worn(3, 0.01, 30)
    known, _ = known_of(held)
    assert OPTIMIZER.fit_penalized is not None
    (part,) = known.fitter(OPTIMIZER.fit_penalized)((held.select(np.arange(30) % 5 != 0),), MODELS["9"])
    assert part.bend != known.found.fit.bend


def test_the_covariance_is_in_the_units_of_the_calibration() -> None:
    """Standard errors squared on its diagonal; offsets in standard g, slopes per degree, bends per g."""
    held, _, _ = worn(3, 0.0, 40)
    warm = points(held.xyz_g(), tau=np.linspace(-1, 1, 40), span_c=4.0)
    assert OPTIMIZER.fit_penalized is not None
    known = posterior(warm, 40, MODELS["9T"], POPULATION, OPTIMIZER.fit_penalized)
    place = Gravity(0.0)
    made = calibration_of_fit("9T", known.found.fit, warm, place)
    rows, local_g = np.array(known.covariance_of(made)), float(place.local_g())
    errors = np.array(known.standard_errors())
    expected = np.concatenate([errors[:6], errors[6:9] * local_g, errors[9:] * local_g / 4.0])
    assert np.sqrt(np.diag(rows))[:12] == pytest.approx(expected, rel=1e-9)
    bends = np.sqrt(np.diag(np.array(known.covariance)))[-3:]
    assert np.sqrt(np.diag(rows))[12:] == pytest.approx(bends / local_g, rel=1e-9)


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
