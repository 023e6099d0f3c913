"""Standard errors against the scatter of simulated fits; coverage by hand."""

from __future__ import annotations

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.points import MODELS, PointSet
from accelcal_cli.judge.errors import coverage, directions, jacobian, uncertainty
from tests.judge.made import NINE, WARM
from tests.optimize import oracle

NOISE = 0.003


def simulated(seed: int, model: str) -> PointSet:
    random = np.random.default_rng(seed)
    warm = model.endswith("T")
    tau = np.linspace(-1.5, 1.5, 60)[np.random.default_rng(0).permutation(60)] if warm else None
    v = oracle.measured(WARM if warm else NINE, oracle.directions(60), tau)
    return oracle.points(v + NOISE * random.standard_normal((60, 3)), tau=tau)


@pytest.mark.parametrize("model", [pytest.param("9", marks=pytest.mark.nightly), "9T"])
def test_standard_errors_are_the_scatter_of_200_fits(model: str) -> None:
    free = list(MODELS[model].free)
    fits, claimed, worst = [], [], []
    for seed in range(200):
        held = simulated(seed, model)
        p = oracle.least_squares(held, MODELS[model].free).p
        fits.append(p)
        if seed % 10 == 0:
            known = uncertainty(held, tuple(round(float(value) * ONE) for value in p), MODELS[model])
            assert known is not None
            claimed.append(known.standard_errors)
            worst.append(known.worst_direction_mg)
    scatter = np.std(fits, axis=0, ddof=1)
    ratio = np.mean(claimed, axis=0)[free] / scatter[free]
    assert (abs(ratio - 1) < 0.25).all(), ratio
    fixed = [index for index in range(12) if index not in free]
    assert not np.array(claimed)[:, fixed].any()
    norms = [np.sqrt((oracle.calibrated(p, directions()) ** 2).sum(axis=1)) for p in fits]
    seen = float(1000 * np.std(norms, axis=0, ddof=1).max())
    assert np.mean(worst) == pytest.approx(seen, rel=0.25)


@pytest.mark.nightly
def test_standard_errors_from_few_points_are_the_scatter_too() -> None:
    """14 points leave 5 degrees of freedom for the noise."""
    v = oracle.measured(NINE, oracle.directions(14))
    fits, claimed = [], []
    for seed in range(200):
        held = oracle.points(v + NOISE * np.random.default_rng(seed).standard_normal(v.shape))
        p = oracle.least_squares(held, MODELS["9"].free).p
        known = uncertainty(held, tuple(round(float(value) * ONE) for value in p), MODELS["9"])
        assert known is not None
        fits.append(p)
        claimed.append(known.standard_errors)
    ratio = np.sqrt(np.mean(np.square(claimed), axis=0)[:9]) / np.std(fits, axis=0, ddof=1)[:9]
    assert (abs(ratio - 1) < 0.25).all(), ratio


def test_noise_of_twice_the_size_gives_errors_of_twice_the_size() -> None:
    v = oracle.measured(NINE, oracle.directions(60))
    noise = np.random.default_rng(1).standard_normal((60, 3))
    errors = []
    for size in (0.001, 0.002):
        held = oracle.points(v + size * noise)
        p = oracle.fast_fit(held, MODELS["9"]).parameters
        known = uncertainty(held, p, MODELS["9"])
        assert known is not None
        errors.append(np.array(known.standard_errors)[:9])
    assert errors[1] / errors[0] == pytest.approx(2, rel=0.05)


def test_the_condition_number_is_that_of_unit_columns() -> None:
    held = simulated(0, "9")
    p = oracle.least_squares(held, MODELS["9"].free).p
    known = uncertainty(held, tuple(round(float(value) * ONE) for value in p), MODELS["9"])
    matrix = oracle.jacobian(p, held.xyz_g(), None)[:, :9]
    assert known is not None
    assert known.condition_number == pytest.approx(
        np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0)), rel=1e-6
    )


def test_the_jacobian_is_the_derivative() -> None:
    random = np.random.default_rng(2)
    v, tau = random.uniform(-1, 1, (30, 3)), random.uniform(-1, 1, 30)
    p = np.rint((oracle.IDEAL + random.uniform(-0.1, 0.1, 12)) * ONE)
    found = jacobian(v, tau, tuple(int(value) for value in p))
    assert np.abs(found - oracle.jacobian(p / ONE, v, tau)).max() < 1e-7
    cold = jacobian(v, None, tuple(int(value) for value in p))
    assert not cold[:, 9:].any()


@pytest.mark.parametrize(
    "v",
    [
        np.tile(oracle.directions(5), (12, 1)),
        oracle.directions(60) * [1, 1, 0],
        np.tile([[0.0, 0.0, 1.0]], (60, 1)),
    ],
    ids=["five places", "no z", "one place"],
)
def test_points_that_do_not_determine_the_parameters_have_no_errors(v: np.ndarray) -> None:
    assert uncertainty(oracle.points(v), IDENTITY, MODELS["9"]) is None


def test_too_few_points_have_no_errors() -> None:
    v = oracle.directions(9)
    assert uncertainty(oracle.points(v), IDENTITY, MODELS["9"]) is None
    assert uncertainty(oracle.points(v), IDENTITY, MODELS["6"]) is not None
    light = oracle.points(oracle.directions(60), weights=np.full(60, 0.09))
    assert uncertainty(light, IDENTITY, MODELS["6"]) is None, "60 light points weigh less than six whole ones"


def test_a_model_without_parameters_has_no_errors() -> None:
    assert uncertainty(oracle.points(oracle.directions(60)), IDENTITY, MODELS["0"]) is None
    assert uncertainty(oracle.points(np.empty((0, 3))), IDENTITY, MODELS["9"]) is None


def test_slopes_without_temperatures_are_not_determined() -> None:
    assert uncertainty(oracle.points(oracle.directions(60)), IDENTITY, MODELS["9T"]) is None


def test_162_directions_cover_the_sphere() -> None:
    d = directions()
    assert d.shape == (162, 3)
    assert (d**2).sum(axis=1) == pytest.approx(1)
    probe = oracle.random_directions(np.random.default_rng(0), 2000)
    assert (probe @ d.T).max(axis=1).min() > np.cos(np.radians(13))


def test_coverage_by_hand() -> None:
    held = oracle.points(np.array([[-1.25, 0.25, 0.5], [0.75, -0.25, -1.0], [0.3, 1.25, -1.251]]))
    found = coverage(held, np.array([1, 0, 1]))
    assert found.subsets == ((1, 0, 1), (0, 2, 0), (1, 1, 0)), "rows n, 0, p; columns x, y, z"
    assert found.axis_min_g == pytest.approx((-1.25, -0.25, -1.251))
    assert found.axis_max_g == pytest.approx((0.75, 1.25, 0.5))
    assert (found.cells, found.distinct_orientations) == (3, 2)
    assert found.condition_number is None and found.worst_direction_mg is None


def test_no_points_cover_nothing() -> None:
    found = coverage(oracle.points(np.empty((0, 3))), np.empty(0, np.int64))
    assert (found.subsets, found.cells, found.distinct_orientations) == (((0, 0, 0),) * 3, 0, 0)
