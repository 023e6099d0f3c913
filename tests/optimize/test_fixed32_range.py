"""Nothing wraps: a fit is an error, or what integers without any limit would give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from accelcal_cli.core.arithmetic import LIMIT, ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError, FixedPointOverflowError
from accelcal_cli.core.points import MODELS, WEIGHT_ONE, Fit, PointSet
from accelcal_cli.optimize import fixed32
from accelcal_cli.optimize._objective32 import MAX_POINTS, cost, evaluate, gradients, stacked
from accelcal_cli.optimize._penalized32 import start_of
from tests.optimize.oracle import directions, measured, points, random_directions

SHORT = replace(fixed32.DEFAULT, max_iterations=60, keep_history=True)
PAPER = replace(fixed32.PAPER, max_iterations=12, keep_history=True)


def unbounded(held: PointSet) -> PointSet:
    """The same points as Python integers, whose products and sums have no limit."""
    tau = None if held.tau is None else held.tau.astype(object)
    return PointSet(held.xyz.astype(object), held.weights.astype(object), held.windows, tau, held.temperature)


def outcome(run: Callable[[], Fit | list[Fit]]) -> Fit | list[Fit] | str:
    try:
        return run()
    except DivergedError as error:
        return str(error)


PLACES = st.integers(-3 * ONE, 3 * ONE) | st.sampled_from(
    [2 * ONE - 1, 2 * ONE, -2 * ONE, 1 - 2 * ONE, ONE, -ONE, LIMIT - 1, -LIMIT, 2**40]
)
NEAR_ONE = st.integers(-ONE * 17 // 20, ONE * 17 // 20)


@st.composite
def any_points(draw: st.DrawFn) -> PointSet:
    place = draw(st.sampled_from([PLACES, NEAR_ONE, NEAR_ONE, NEAR_ONE]))
    xyz = np.array(draw(st.lists(st.tuples(place, place, place), min_size=1, max_size=12)), np.int64)
    number = len(xyz)
    weights = draw(st.lists(st.integers(1, WEIGHT_ONE), min_size=number, max_size=number))
    tau = draw(st.none() | st.lists(st.integers(1 - 2 * ONE, 2 * ONE - 1), min_size=number, max_size=number))
    scaled = None if tau is None else np.array(tau, np.int64)
    return PointSet(xyz, np.array(weights, np.int64), np.ones(number, np.int64), scaled)


@given(any_points(), st.sampled_from(["3", "6", "9", "9T"]), st.sampled_from([SHORT, PAPER]))
def test_a_fit_is_an_error_or_what_unlimited_integers_give(
    held: PointSet, model: str, numbers: fixed32.DescentSettings
) -> None:
    found = outcome(lambda: fixed32.fit(held, MODELS[model], numbers))
    assert found == outcome(lambda: fixed32.fit(unbounded(held), MODELS[model], numbers))
    if isinstance(found, Fit):
        rows = np.array([*found.history, found.parameters])
        assert (np.abs(rows) < LIMIT).all()


@pytest.mark.parametrize("place", [1.5, 1.99, 2.0, 3.0, 100.0, 4000.0])
@pytest.mark.parametrize("numbers", [SHORT, PAPER], ids=["default", "paper"])
def test_points_far_from_one_g_are_refused(place: float, numbers: fixed32.DescentSettings) -> None:
    v = directions(20)
    v[7] *= place
    with pytest.raises(FixedPointOverflowError, match="32-bit fixed-point range"):
        fixed32.fit(points(v), MODELS["9"], numbers)


@pytest.mark.parametrize("offset", [0.5, 0.9, 1.5, -3.9])
def test_huge_offsets_are_an_error_or_are_found(offset: float) -> None:
    p = np.array([1.0, 1, 1, 0, 0, 0, offset, 0, 0, 0, 0, 0])
    held = points(measured(p, directions(40)))
    found = outcome(lambda: fixed32.fit(held, MODELS["9"]))
    assert found == outcome(lambda: fixed32.fit(unbounded(held), MODELS["9"]))
    assert isinstance(found, str) or abs(found.parameters[6] / ONE - offset) < 1e-6


def test_a_unit_that_is_wrong_by_a_factor_is_an_error_with_a_hint() -> None:
    with pytest.raises(FixedPointOverflowError, match="check the unit"):
        fixed32.fit(points(directions(40) * 9.80665), MODELS["9"])


@pytest.mark.parametrize(
    ("place", "gain", "what"),
    [
        (1.2, 1.9, "a calibrated point"),
        (1.9, 2.0, "a parameter"),
        (2.0, 1.0, "a shifted point"),
        (0.9, 1.0, "a residual"),
    ],
)
def test_the_error_names_the_first_value_that_leaves_its_range(place: float, gain: float, what: str) -> None:
    parameters = np.array([round(gain * ONE)] * 3 + [0] * 9, np.int64)
    held = stacked([points(np.full((1, 3), place))])
    with pytest.raises(FixedPointOverflowError, match=f"^{what} leaves"):
        evaluate(held, parameters[np.newaxis])


def extreme(number: int, g: float) -> PointSet:
    """Points on one axis, all as long as the range of the residual allows."""
    return points(np.tile([g, 0.0, 0.0], (number, 1)))


def sums(held: PointSet) -> tuple[list[int], list[list[int]]]:
    """Cost and gradient of the ideal sensor."""
    stack, ideal = stacked([held]), [list(IDENTITY)]
    state = evaluate(stack, np.array(ideal, np.int64))
    return cost(stack, state), gradients(stack, state, ideal)


@pytest.mark.parametrize("number", [1, MAX_POINTS])
def test_the_largest_sums_of_the_allowed_number_of_points_are_exact(number: int) -> None:
    held = extreme(number, 1.41421)
    assert sums(held) == sums(unbounded(held))


def test_more_points_than_there_is_head_room_for_are_refused() -> None:
    with pytest.raises(FixedPointOverflowError, match=f"^{MAX_POINTS + 1} points are more than the"):
        fixed32.fit(extreme(MAX_POINTS + 1, 1.0), MODELS["9"])


@given(
    st.lists(any_points(), min_size=1, max_size=4),
    st.booleans(),
    st.sampled_from(["3", "6", "9", "9T"]),
    st.sampled_from([SHORT, PAPER]),
)
def test_sets_side_by_side_are_fitted_as_each_alone(
    sets: list[PointSet], warm: bool, model: str, numbers: fixed32.DescentSettings
) -> None:
    taus = [np.full(len(held), ONE // 3) if held.tau is None else held.tau for held in sets]
    alike = [replace(held, tau=tau if warm else None) for held, tau in zip(sets, taus, strict=True)]
    alone = [outcome(lambda held=held: fixed32.fit(held, MODELS[model], numbers)) for held in alike]
    together = outcome(lambda: fixed32.fit_each(alike, MODELS[model], numbers))
    assert together == alone if all(isinstance(found, Fit) for found in alone) else together in alone


@pytest.mark.parametrize("seed", range(20))
def test_cost_and_gradient_are_those_of_float64(seed: int) -> None:
    random = np.random.default_rng(seed)
    number = 1 + seed % 12
    held = points(
        random_directions(random, number) * random.uniform(0.7, 1.15, (number, 1)),
        weights=random.uniform(0.01, 1, number),
        tau=random.uniform(-1.5, 1.5, number),
    )
    change = random.integers(-ONE // 20, ONE // 20, 12)
    p, stack = np.array(IDENTITY, np.int64) + change, stacked([held])
    state = evaluate(stack, p[np.newaxis])
    (slope,) = np.array(gradients(stack, state, [p.tolist()])) / ONE
    (total,) = cost(stack, state)
    weights = held.weights / held.weights.sum()
    expected = float(weights @ residuals(held, p / ONE) ** 2)
    assert abs(total / 2**58 / int(held.weights.sum()) - expected) < 1e-7
    for index in range(12):
        h = np.eye(12)[index] * 1e-4
        rise = weights @ (residuals(held, p / ONE + h) ** 2 - residuals(held, p / ONE - h) ** 2)
        assert abs(slope[index] - rise / 2e-4) < 1e-5


def residuals(held: PointSet, p: np.ndarray) -> np.ndarray:
    u = held.xyz / ONE + p[6:9] + np.outer(held.tau / ONE, p[9:12])
    a = (p[0] * u[:, 0], p[3] * u[:, 0] + p[1] * u[:, 1], p[4] * u[:, 0] + p[5] * u[:, 1] + p[2] * u[:, 2])
    return a[0] ** 2 + a[1] ** 2 + a[2] ** 2 - 1


@pytest.mark.parametrize("offset", [(0.475, 0, 0), (0, 0, -0.475), (0.3, -0.5, 0), (0.55, 0.55, 0.55)])
@pytest.mark.parametrize("fit", ["descent", "prior"])
def test_t10_an_offset_of_half_a_g_is_an_offset(offset: tuple[float, float, float], fit: str) -> None:
    p = np.array([0.97, 1.02, 0.985, -0.008, 0.005, -0.004, *offset, 0, 0, 0])
    held = points(measured(p, directions(60)))
    with pytest.raises(FixedPointOverflowError):
        evaluate(stacked([held]), np.array([IDENTITY], np.int64))
    if fit == "descent":
        found = fixed32.fit(held, MODELS["9"])
        assert found == fixed32.fit(unbounded(held), MODELS["9"])
    else:
        found = fixed32.OPTIMIZER.fit_penalized(held, MODELS["9"], fixed32.NO_PENALTY, IDENTITY).fit
    assert np.abs(np.array(found.parameters) / ONE - p).max() < 1e-6


def test_t10_points_in_the_range_of_an_ideal_sensor_are_fitted_from_it() -> None:
    near, far = (points(directions(40) + np.array([offset, 0, 0])) for offset in (0.3, 0.6))
    assert start_of(near) == IDENTITY
    found = start_of(far)
    assert (found[:6], found[9:]) == (IDENTITY[:6], IDENTITY[9:])
    assert found[6] / ONE == pytest.approx(-0.6, abs=1e-3)
    assert found[7:9] == pytest.approx((0, 0), abs=1e-3 * ONE)
