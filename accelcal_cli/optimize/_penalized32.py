"""The minimum of the objective in fixed point with a penalty (a prior), by Gauss-Newton steps.

Objective, gradient and parameters are integers. Floating point only determines how far a step goes, by
operations in a fixed order (`core.arithmetic`), and no step is taken that raises the exact sum. Apart from
`fixed32`, in which no number is floating.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE, inverse, narrow, rounded_quotient
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError, FixedPointOverflowError
from accelcal_cli.core.points import (
    PENALTY_BITS,
    WEIGHT_ONE,
    Fit,
    Model,
    Operations,
    PenalizedFit,
    Penalty,
    PointSet,
)
from accelcal_cli.optimize._objective32 import (
    COLUMNS,
    ENTRIES,
    LEAST_SCALE,
    RESIDUAL_LIMIT,
    RISE_TOLERANCE_BITS,
    ROWS,
    VALUE_LIMIT,
    WEIGHT_BITS,
    Stack,
    State,
    cost,
    evaluate,
    gradients,
    stacked,
)

JACOBIAN_BITS = 14
"""Fraction bits of the entries of J in `curvature`, so that sums of their products hold MAX_POINTS points."""

STEP_BITS = 40
"""Fraction bits of the inverse curvature that a Gauss-Newton step is multiplied by."""

MAX_NEWTON_STEPS = 100

COARSE_BITS = 12
"""Fraction bits of points by which `start_of` finds a centre, so that sums of their cubes are exact."""

FARTHEST_FROM_SPHERE_G = 0.2
"""Distance [g] from a sphere that scales and misalignment explain; beyond it an offset explains nothing."""


def start_of(points: PointSet) -> tuple[int, ...]:
    """Return the parameters from which a fit sets out: an ideal sensor's, unless points are out of its range.

    These may have an offset of half a g. All of them then lie near a sphere, whose centre is that of the
    linear least squares of |v|^2 = 2 c v + d; the fit sets out from the offset -c.
    """
    if not len(points) or np.abs(points.xyz).max() >= VALUE_LIMIT:
        return IDENTITY
    of_ideal = narrow((points.xyz**2).sum(axis=1) - (ONE << FRACTION_BITS))
    if of_ideal.max() < RESIDUAL_LIMIT:
        return IDENTITY
    coarse = points.xyz >> (FRACTION_BITS - COARSE_BITS)
    squares = (coarse**2).sum(axis=1)
    rows = np.column_stack([2 * coarse, np.full_like(squares, 1 << COARSE_BITS)])
    try:
        back = inverse([[float(value) for value in row] for row in (rows.T @ rows).tolist()])
    except ValueError:
        return IDENTITY
    right = [float(value) for value in (rows.T @ squares).tolist()]
    centre = [sum(value * one for value, one in zip(row, right, strict=True)) for row in back[:3]]
    offset = [round(-value * (1 << (FRACTION_BITS - COARSE_BITS))) for value in centre]
    x, y, z = (points.xyz + np.array(offset)).T.astype(np.float64) / ONE
    explained = float(np.ptp(np.sqrt(x * x + y * y + z * z))) < 2 * FARTHEST_FROM_SPHERE_G
    return (*IDENTITY[:ENTRIES], *offset, 0, 0, 0) if explained else IDENTITY


def curvature(stack: Stack, state: State, parameters: tuple[int, ...], model: Model) -> list[list[float]]:
    """Return the weighted mean of J^T J of one set of points, J = d(|a|^2 - 1)/dp of the free parameters.

    The sums are of integers, so the order of the points does not matter.

    Args:
        model: one with offsets, as all but "0" have.
    """
    a, u, k = state.calibrated[:, 0], state.shifted[:, 0], np.array(parameters, np.int64)
    entries = [index for index in model.free if index < ENTRIES]
    products = k[0] * a[0] + k[3] * a[1] + k[4] * a[2], k[1] * a[1] + k[5] * a[2], k[2] * a[2]
    back = narrow(np.stack(products))
    rows = [narrow(a[[ROWS[entry] for entry in entries]] * u[[COLUMNS[entry] for entry in entries]]), back]
    if stack.tau is not None and model.has_temperature:
        rows.append(narrow(back * stack.tau[0]))
    free = narrow(np.concatenate(rows), FRACTION_BITS - JACOBIAN_BITS - 1)
    sums = ((free * stack.weights[0]) @ free.T).tolist()
    unit = stack.weight[0] << 2 * JACOBIAN_BITS
    return [[value / unit for value in row] for row in sums]


def fit_penalized(points: PointSet, model: Model, penalty: Penalty, start: tuple[int, ...]) -> PenalizedFit:
    """Find the minimum of the objective with a penalty by Gauss-Newton steps on integers.

    A step that raises the exact sum by more than rounding can is halved. The descent ends where the step is
    within the rounding of the gradient, or where it returns to parameters that it had before. Where an ideal
    sensor is to be the start, `start_of` says what else may be.

    Raises:
        FixedPointOverflowError: a value leaves its range, or there are more than MAX_POINTS points.
        DivergedError: no point has any weight, or an axis collapsed.
    """
    if not points.weights.any():
        raise DivergedError("no point has any weight")
    stack = stacked((points,))
    start = start_of(points) if start == IDENTITY else start
    here, stop = _at(stack, start, penalty), "iterations"
    seen, places, around = set[tuple[int, ...]](), [start], curvature(stack, here.state, start, model)
    while len(seen) < MAX_NEWTON_STEPS and stop == "iterations":
        seen.add(here.parameters)
        step = _newton_step(stack, here, around, model, penalty)
        there = _lower(stack, here, step, penalty)
        if there is None:
            stop = "step within rounding"
        else:
            here, stop = there, "a circle within rounding" if there.parameters in seen else stop
            places.append(here.parameters)
            around = curvature(stack, here.state, here.parameters, model)
    if min(here.parameters[:3]) < LEAST_SCALE:
        raise DivergedError("an axis collapsed: the points do not determine its scale")
    mean_square = cost(stack, here.state)[0] / (stack.weight[0] << 2 * FRACTION_BITS)
    ended = stop != "iterations"
    found = Fit(here.parameters, len(seen), stop, Operations(), tuple(places), ended)
    return PenalizedFit(model, found, mean_square, tuple(tuple(row) for row in around))


@dataclass(frozen=True, slots=True)
class _Place:
    """Parameters that the descent has reached.

    Attributes:
        total: the exact objective in units of 2**-(58 + weight bits + PENALTY_BITS).
    """

    parameters: tuple[int, ...]
    state: State
    total: int


def _at(stack: Stack, parameters: tuple[int, ...], penalty: Penalty) -> _Place:
    """Evaluate parameters; raises FixedPointOverflowError beyond the range."""
    state = evaluate(stack, np.array([parameters], np.int64))
    away = zip(parameters, penalty.centre, penalty.strength, strict=True)
    added = sum(strength * (value - centre) ** 2 for value, centre, strength in away)
    return _Place(parameters, state, (cost(stack, state)[0] << PENALTY_BITS) + (added << WEIGHT_BITS))


def _lower(stack: Stack, here: _Place, step: list[int], penalty: Penalty) -> _Place | None:
    """Take a step, halved until the sum rises by no more than rounding can; None if no part of it does."""
    while any(step):
        parameters = tuple(value - change for value, change in zip(here.parameters, step, strict=True))
        with suppress(FixedPointOverflowError):
            there = _at(stack, parameters, penalty)
            if there.total <= here.total + (here.total >> RISE_TOLERANCE_BITS):
                return there
        step = [change // 2 if change > 0 else -(-change // 2) for change in step]  # towards zero
    return None


def _newton_step(
    stack: Stack, here: _Place, around: list[list[float]], model: Model, penalty: Penalty
) -> list[int]:
    """Return what a Gauss-Newton step takes off the parameters; zeros if it is within rounding.

    Args:
        around: the curvature at `here`.
    """
    parameters, weight = here.parameters, stack.weight[0]
    (slope,) = gradients(stack, here.state, [list(parameters)], model.free)
    away = zip(parameters, penalty.centre, penalty.strength, strict=True)
    pull = [2 * strength * (value - centre) for value, centre, strength in away]
    around = [list(row) for row in around]
    for place, index in enumerate(model.free):
        around[place][place] += penalty.strength[index] * WEIGHT_ONE / (weight << PENALTY_BITS)
    try:
        back = inverse(around)
    except ValueError as error:
        raise DivergedError("the points do not determine the parameters") from error
    step, rounding = [0] * len(parameters), True
    force = [slope[index] * weight * (1 << PENALTY_BITS) + pull[index] * WEIGHT_ONE for index in model.free]
    for place, index in enumerate(model.free):
        row = [round(value * (1 << STEP_BITS)) for value in back[place]]
        moved = sum(value * one for value, one in zip(row, force, strict=True))
        step[index] = rounded_quotient(moved, (weight << PENALTY_BITS) << (STEP_BITS + 1))
        rounding &= abs(step[index]) <= sum(map(abs, row)) >> (STEP_BITS + 1)
    return [0] * len(parameters) if rounding else step
