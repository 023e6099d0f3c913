"""Postures by angles in float64; folds that split none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import TemperatureScale
from accelcal_cli.core.points import PointSet
from accelcal_cli.judge.model_ladder import folds, postures, temperature_blocks
from tests.optimize.oracle import directions, points, random_directions

COARSE = 0.15
"""Degrees that the rounding to 12 bits may cost."""


@st.composite
def worn(draw: st.DrawFn) -> PointSet:
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    number = draw(st.integers(1, 60))
    centres = random_directions(random, draw(st.integers(1, 10)))
    g = centres[random.integers(len(centres), size=number)] + draw(st.sampled_from([0.02, 0.15, 1.0])) * (
        random.standard_normal((number, 3))
    )
    g *= random.uniform(0.8, 1.2, (number, 1)) / np.sqrt((g**2).sum(axis=1))[:, None]
    return points(g, windows=random.permutation(number) + 1)


def degrees_between(one: np.ndarray, other: np.ndarray) -> float:
    cosine = one @ other / np.sqrt((one @ one) * (other @ other))
    return float(np.degrees(np.arccos(min(1.0, cosine))))


def leaders(held: PointSet, label: np.ndarray) -> list[int]:
    order = np.lexsort((np.arange(len(held)), -held.windows))
    return [int(next(i for i in order if label[i] == k)) for k in range(label.max() + 1)]


@given(worn(), st.sampled_from([5.0, 15.0, 30.0]))
def test_every_point_is_near_the_first_of_its_posture(held: PointSet, degrees: float) -> None:
    label, g = postures(held, degrees), held.xyz_g()
    first = leaders(held, label)
    for index in range(len(held)):
        assert degrees_between(g[index], g[first[label[index]]]) < degrees + COARSE


@given(worn(), st.sampled_from([5.0, 15.0, 30.0]))
def test_the_firsts_of_postures_lie_apart(held: PointSet, degrees: float) -> None:
    label, g = postures(held, degrees), held.xyz_g()
    first = leaders(held, label)
    for k, one in enumerate(first):
        for other in first[:k]:
            assert degrees_between(g[one], g[other]) > degrees - COARSE


@given(worn())
def test_a_point_joins_the_nearest_posture_that_was_there(held: PointSet) -> None:
    label, g = postures(held, 15.0), held.xyz_g()
    first = leaders(held, label)
    for index in range(len(held)):
        there = [one for one in first if held.windows[one] >= held.windows[index]]
        nearest = min(degrees_between(g[index], g[one]) for one in there)
        assert degrees_between(g[index], g[first[label[index]]]) < nearest + 2 * COARSE


@given(worn())
def test_numbers_run_from_zero_by_falling_windows(held: PointSet) -> None:
    label = postures(held, 15.0)
    assert set(label.tolist()) == set(range(label.max() + 1))
    assert [held.windows[one] for one in leaders(held, label)] == sorted(
        (held.windows[one] for one in leaders(held, label)), reverse=True
    )


@given(worn(), st.randoms())
def test_postures_do_not_depend_on_the_order_of_the_points(held: PointSet, random: object) -> None:
    order = list(range(len(held)))
    random.shuffle(order)
    shuffled = postures(held.select(np.array(order)), 15.0)
    assert shuffled.tolist() == postures(held, 15.0)[order].tolist()


def test_opposite_directions_are_two_postures() -> None:
    held = points(np.array([[0, 0, 1.0], [0, 0, -1.0], [0.1, 0, -1.0]]))
    assert postures(held, 15.0).tolist() == [0, 1, 1]


@pytest.mark.parametrize(("degrees", "number"), [(14.0, 1), (16.0, 2)])
def test_the_limit_is_in_degrees(degrees: float, number: int) -> None:
    angle = np.radians(degrees)
    held = points(np.array([[1.0, 0, 0], [np.cos(angle), np.sin(angle), 0]]))
    assert postures(held, 15.0).max() + 1 == number


def test_the_posture_with_most_windows_is_first() -> None:
    held = points(np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]), windows=np.array([3, 9, 3]))
    assert postures(held, 15.0).tolist() == [1, 0, 2]


@pytest.mark.parametrize("norm", [0.01, 0.5, 1.5])
def test_the_length_of_a_vector_does_not_matter(norm: float) -> None:
    held = points(np.concatenate([directions(20), directions(20) * norm]))
    label = postures(held, 8.0)
    assert label[:20].tolist() == label[20:].tolist() == list(range(20))


@given(st.lists(st.integers(0, 40), min_size=1), st.integers(2, 7))
def test_no_posture_is_split_between_folds(label: list[int], number: int) -> None:
    fold = folds(np.array(label), number)
    assert len(set(zip(label, fold.tolist(), strict=True))) == len(set(label))
    assert set(fold.tolist()) <= set(range(number))


def test_folds_share_the_postures_evenly() -> None:
    fold = folds(np.arange(23), 5)
    assert sorted(np.bincount(fold).tolist()) == [4, 4, 5, 5, 5]


def test_positions_at_the_ends_of_the_range_do_not_overflow() -> None:
    xyz = np.array([[4 * ONE - 1] * 3, [-4 * ONE] * 3, [4 * ONE - 1, 4 * ONE - 1, 4 * ONE - 2]])
    held = PointSet(xyz, np.ones(3, np.int64), np.ones(3, np.int64))
    assert postures(held, 15.0).tolist() == [0, 1, 0]


def heated(temperatures_c: list[float], reference_mc: int = 30_000, span_c: float = 8.0) -> PointSet:
    number = len(temperatures_c)
    tau = [round((t - reference_mc / 1000) / span_c * ONE) for t in temperatures_c]
    scale = TemperatureScale(reference_mc, span_c)
    xyz = np.tile(np.array([[ONE, 0, 0]]), (number, 1))
    ones = np.ones(number, np.int64)
    return PointSet(xyz, ones, ones, np.array(tau, np.int64), scale)


def test_blocks_are_postures_within_a_band_of_temperature() -> None:
    held = heated([29.9, 30.1, 31.9, 32.0, 30.0, 26.5])
    label = np.array([1, 1, 1, 1, 0, 0])
    # bands of 2 C: 28..30, 30..32, 30..32, 32..34 | 30..32, 26..28; posture 0 comes first
    assert temperature_blocks(held, label, 2.0).tolist() == [2, 3, 3, 4, 1, 0]


def test_blocks_are_postures_where_there_is_no_temperature() -> None:
    held = replace(heated([20.0, 30.0]), tau=None, temperature=None)
    assert temperature_blocks(held, np.array([3, 4]), 2.0).tolist() == [3, 4]
