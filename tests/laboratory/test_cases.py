"""Artificial points: eq. 17-20 of Farago, Maczak, Gingl 2024, and the collector of its section II.B."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.points import WEIGHT_ONE
from accelcal_cli.laboratory.cases import Case, CasePlan, Selection, make_case
from tests.optimize.oracle import calibrated

BANDS = ((-1.25, -0.75), (-0.25, 0.25), (0.75, 1.25))


@pytest.fixture(scope="module")
def many() -> list[Case]:
    return [make_case(CasePlan(18, 0.001), 1, index) for index in range(300)]


@pytest.fixture(scope="module")
def truths(many: list[Case]) -> np.ndarray:
    return np.array([case.truth for case in many]) / ONE


def uniform(values: np.ndarray, low: float, reach: float) -> bool:
    """Kolmogorov and Smirnov's test; imported here, since it takes a second."""
    from scipy import stats

    return bool(stats.kstest(values, "uniform", (low, reach)).pvalue > 0.01)


def test_errors_are_uniform_in_the_ranges_of_eq_17(truths: np.ndarray) -> None:
    scale, offset = truths[:, :3], truths[:, 6:9]
    turn = truths[:, 3:6] / truths[:, [1, 2, 2]]  # eq. 18: kxy = Sy Txy, kxz = Sz Txz, kyz = Sz Tyz
    for values, low, reach in ((scale, 0.9, 0.2), (turn, -0.05, 0.1), (offset, -0.1, 0.2)):
        assert uniform(values.ravel(), low, reach)
    assert (truths[:, 9:] == 0).all()


@pytest.mark.parametrize("index", range(3))
def test_parameters_are_products_of_eq_18(truths: np.ndarray, index: int) -> None:
    a, b, c, xy, xz, yz, *offset = np.random.RandomState([1, index]).uniform(-1, 1, 9)
    sx, sy, sz = 1 + 0.1 * a, 1 + 0.1 * b, 1 + 0.1 * c
    expected = [sx, sy, sz, sy * 0.05 * xy, sz * 0.05 * xz, sz * 0.05 * yz, *(0.1 * o for o in offset)]
    assert truths[index, :9] == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("selection", ["subsets", "random"])
def test_calibrating_with_the_truth_gives_unit_vectors(selection: Selection) -> None:
    case = make_case(CasePlan(90, 0.005, selection), 3, 0)
    norms = np.linalg.norm(calibrated(np.array(case.truth) / ONE, case.still_g), axis=1)
    assert np.abs(norms - 1).max() < 1e-12


def test_points_may_rest_at_another_gravity() -> None:
    case = make_case(CasePlan(18, 0.001, rest_g=Fraction(1001, 1000)), 3, 0)
    norms = np.linalg.norm(calibrated(np.array(case.truth) / ONE, case.still_g), axis=1)
    assert np.abs(norms - 1.001).max() < 1e-12


def test_random_points_are_uniform_on_the_sphere() -> None:
    case = make_case(CasePlan(4000, 0.001, "random"), 5, 0)
    a = calibrated(np.array(case.truth) / ONE, case.still_g)
    for axis in a.T:  # Archimedes: each coordinate of a uniform direction is uniform
        assert uniform(axis, -1, 2)


@pytest.mark.parametrize("noise_g", [0.001, 0.005])
def test_noise_is_gaussian_on_each_axis(noise_g: float) -> None:
    from scipy import stats

    case = make_case(CasePlan(4000, noise_g, "random"), 5, 0)
    for axis in (case.points.xyz_g() - case.still_g).T:
        assert stats.kstest(axis, "norm", (0, noise_g)).pvalue > 0.01


@pytest.mark.parametrize("number", [18, 144])
def test_the_collector_fills_nine_subsets_evenly(number: int) -> None:
    """A point belongs to one subset: the first axis whose interval has it and is not full (F fig. 6)."""
    case = make_case(CasePlan(number, 0.005), 2, 7)
    held = {(axis, band): 0 for axis in range(3) for band in range(3)}
    for point in case.points.xyz_g():
        free = [
            (axis, band)
            for axis, value in enumerate(point)
            for band, (low, high) in enumerate(BANDS)
            if low <= value <= high and held[axis, band] < number // 9
        ]
        held[free[0]] += 1
    assert set(held.values()) == {number // 9}


def test_all_points_weigh_the_same(many: list[Case]) -> None:
    points = many[0].points
    assert (points.weights == WEIGHT_ONE).all() and (points.windows == 1).all() and points.tau is None


def test_a_case_depends_on_its_seed_and_index_alone(many: list[Case]) -> None:
    again = make_case(CasePlan(18, 0.001), 1, 4)
    assert again.truth == many[4].truth and (again.points.xyz == many[4].points.xyz).all()
    others = [make_case(CasePlan(18, 0.001), 2, 4), make_case(CasePlan(18, 0.001), 1, 5)]
    assert all(other.truth != again.truth for other in others)


def test_the_sensor_is_the_same_for_any_points_noise_and_selection(many: list[Case]) -> None:
    plans = [CasePlan(144, 0.001), CasePlan(18, 0.005), CasePlan(18, 0.001, "random")]
    assert {make_case(plan, 1, 4).truth for plan in plans} == {many[4].truth}


def test_more_noise_is_the_same_noise_in_proportion() -> None:
    small, large = (make_case(CasePlan(40, noise, "random"), 1, 0) for noise in (0.001, 0.005))
    ratio = (large.points.xyz_g() - large.still_g) / (small.points.xyz_g() - small.still_g)
    assert np.abs(ratio - 5).max() < 1e-2  # of the smallest noise, a last bit is one part in some hundreds


def test_nine_subsets_cannot_share_twenty_points() -> None:
    CasePlan(20, 0.001, "random").check()
    with pytest.raises(UsageError, match=r"20 points .*multiple of 9"):
        CasePlan(20, 0.001).check()
