"""F's gradient descent in 32-bit fixed point: integers from the points to the coefficients.

From the ideal sensor, or a large offset (`start_of`), down the objective of `_objective32` (Farago, Maczak,
Gingl 2024, section II.C). Where points hardly determine a parameter, as those near a plane, steps fall below
one bit, or the iterations are used up, short of the minimum: such a descent is finished by Gauss-Newton steps
on the same integers. F's own, of 50 iterations, is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE, rounded_quotient
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, Penalty, PointSet
from accelcal_cli.optimize._objective32 import (
    LEAST_SCALE,
    RISE_TOLERANCE_BITS,
    Stack,
    cost,
    evaluate,
    gradients,
    operations_of,
    stacked,
)
from accelcal_cli.optimize._penalized32 import fit_penalized, start_of

RATE_BITS = 24
"""Fraction bits of a learning rate."""

SMALL_STEP = 1
"""Largest step [least significant bits] that is taken without momentum."""

FINISHED = "Gauss-Newton steps after the descent"
"""Why a fit ended whose descent was finished."""

AT_THE_MINIMUM = ONE // 10_000
"""Distance from the minimum, on the parameter where it is largest, within which a descent has converged."""

NO_PENALTY = Penalty(IDENTITY, (0,) * len(IDENTITY))

RATES_OF_F = {"scale": 0.3, "misalignment": 0.8, "offset": 0.2, "slope": 0.2}
"""Learning rates of F section II.C; the slopes act on the offsets through scaled temperatures of order 1."""


@dataclass(frozen=True, slots=True)
class DescentSettings:
    """Numbers of the descent.

    Attributes:
        max_iterations: largest number of iterations.
        converge: stop when every step is below one least significant bit, halve the rates
            when the cost rises, and finish by Gauss-Newton steps; otherwise run all iterations.
        forward_step: h of F eq. 13 in fixed point; 0 for the exact gradient.
        keep_history: return the parameters after every iteration.
    """

    max_iterations: int
    converge: bool
    forward_step: int
    rates: dict[str, float] = field(default_factory=lambda: dict(RATES_OF_F))
    keep_history: bool = False


PAPER = DescentSettings(max_iterations=50, converge=False, forward_step=round(1e-5 * ONE))
DEFAULT = DescentSettings(max_iterations=20_000, converge=True, forward_step=0)


def fit(points: PointSet, model: Model, settings: DescentSettings = DEFAULT) -> Fit:
    """Fit the free parameters of a model.

    Raises:
        FixedPointOverflowError: the descent leaves the fixed-point range, or there are more than
            MAX_POINTS points.
        DivergedError: no point has any weight, or an axis collapsed.
    """
    return fit_each((points,), model, settings)[0]


def fit_each(sets: Sequence[PointSet], model: Model, settings: DescentSettings = DEFAULT) -> list[Fit]:
    """Fit several sets of points, all with temperatures or none, with the same bits as one by one.

    The sets descend together: each step is a few operations on arrays, whose cost hardly depends on the
    number of sets.

    Raises:
        FixedPointOverflowError, DivergedError: one of the sets raises it, see `fit`.
    """
    filled = [points for points in sets if model.free and len(points)]
    if not all(points.weights.any() for points in filled):
        raise DivergedError("no point has any weight")
    if settings.forward_step:
        found = [_forward(stacked((points,)), model, settings) for points in filled]
    else:
        found = _accelerated(filled, model, settings)
    if any(min(one.parameters[:3]) < LEAST_SCALE for one in found):
        raise DivergedError("an axis collapsed: the points do not determine its scale")
    fits, nothing = iter(found), Fit(IDENTITY, 0, "nothing to fit", Operations())
    return [next(fits) if model.free and len(points) else nothing for points in sets]


def _rates(settings: DescentSettings) -> list[int]:
    groups = ("scale", "misalignment", "offset", "slope")
    return [round(settings.rates[name] * (1 << RATE_BITS)) for name in groups for _ in range(3)]


def _forward(stack: Stack, model: Model, settings: DescentSettings) -> Fit:
    """Fit one set by F's iteration to the letter: forward differences, fixed rates and iterations.

    The update is counted as F does, an addition and a multiplication for each group of three
    parameters with one learning rate: M (100 N + 3) in all for nine parameters.
    """
    rates, number = _rates(settings), settings.max_iterations
    history: list[tuple[int, ...]] = []
    p = np.array(IDENTITY, np.int64)
    probes = np.zeros((len(model.free) + 1, 12), np.int64)
    probes[range(1, len(model.free) + 1), model.free] = settings.forward_step
    unit = settings.forward_step * stack.weight[0] << (FRACTION_BITS + RATE_BITS)
    for _ in range(number):
        base, *probed = cost(stack, evaluate(stack, p + probes))
        for index, value in zip(model.free, probed, strict=True):
            p[index] -= rounded_quotient((value - base) * rates[index] << FRACTION_BITS, unit)
        if settings.keep_history:
            history.append(tuple(p.tolist()))
    costs, updates = number * len(probes), number * (len(model.free) // 3)
    operations = operations_of(stack.number[0], costs, others=updates)
    return Fit(tuple(p.tolist()), number, "iterations", operations, tuple(history), converged=False)


@dataclass(slots=True, eq=False)
class _Descent:
    """One set of points on its way down the exact gradient, with momentum.

    Momentum age / (age + 3) (Nesterov 1983) is dropped where it points uphill (O'Donoghue,
    Candes 2015) and where the cost rises; a rise after a plain step halves the rates.

    Attributes:
        points: number of points.
        free: indices of the parameters that may change.
        rates: twelve learning rates.
        keep_history: see `DescentSettings`.
        here, before: parameters now and a step ago.
        best, lowest: parameters of the lowest cost so far, and that cost.
        age: steps since the momentum was dropped.
        quiet: steps without momentum since the last one that had it or found a lower cost.
        mark: parameters where a quiet step began, the 1st, 2nd, 4th, 8th ... of them (Brent 1980).
        stop: why the descent ended.
        costs, gradients: numbers of their evaluations.
        fit: the result, once the descent has ended.
    """

    points: int
    free: tuple[int, ...]
    rates: list[int]
    keep_history: bool
    here: list[int]
    before: list[int] = field(default_factory=list)
    best: list[int] = field(default_factory=list)
    lowest: int | None = None
    age: int = 0
    quiet: int = 0
    mark: list[int] = field(default_factory=list)
    stop: str = "iterations"
    costs: int = 0
    gradients: int = 0
    history: list[tuple[int, ...]] = field(default_factory=list)
    fit: Fit | None = None

    def ahead(self) -> list[int]:
        """Return the parameters to which momentum leads, where cost and gradient are evaluated next."""
        if not self.age:
            return self.here
        age, pairs = self.age, zip(self.here, self.before, strict=True)
        return [here + (here - before) * age // (age + 3) for here, before in pairs]

    def advance(self, ahead: list[int], cost: int, slope: list[int]) -> list[int] | None:
        """Take a step from `ahead`, or go back to the best parameters; return the result if this ends it.

        It ends where the step vanishes; or at the best parameters if rounding leads it round in a circle,
        which it would never leave: quiet steps depend on the parameters alone.
        """
        self.costs += 1
        if self.lowest is not None and cost > self.lowest + (self.lowest >> RISE_TOLERANCE_BITS):
            self.rates = [rate >> 1 for rate in self.rates]
            self.here, self.before, self.age, self.quiet = self.best, self.best, 0, 0
            return None
        self.gradients += 1
        self.quiet = 0 if self.age else self.quiet + 1
        if self.lowest is None or cost < self.lowest:
            self.lowest, self.best, self.quiet = cost, ahead, 0
        after = list(ahead)
        for index in self.free:
            after[index] -= rounded_quotient(slope[index] * self.rates[index], 1 << RATE_BITS)
        if self.keep_history:
            self.history.append(tuple(after))
        if after == ahead and not self.age:
            self.stop = "step below one bit"
            return ahead
        self.before, self.here = self.here, after
        far = any(abs(after[index] - ahead[index]) > SMALL_STEP for index in self.free)
        downhill = sum(slope[index] * (after[index] - self.before[index]) for index in self.free) < 0
        self.age = self.age + 1 if far and downhill else 0
        return self._circling(ahead)

    def _circling(self, ahead: list[int]) -> list[int] | None:
        """Return the best parameters if quiet steps have come back to where one of them began."""
        if not self.quiet or self.age:
            return None
        if self.quiet & (self.quiet - 1) == 0:
            self.mark = ahead
        if self.here != self.mark:
            return None
        self.stop = "steps of one bit in a circle"
        return self.best

    def result(self, parameters: list[int], iterations: int) -> Fit:
        """Return the fit with these parameters."""
        operations = operations_of(self.points, self.costs, self.gradients)
        ended = self.stop != "iterations"
        return Fit(tuple(parameters), iterations, self.stop, operations, tuple(self.history), ended)


def _accelerated(sets: Sequence[PointSet], model: Model, settings: DescentSettings) -> list[Fit]:
    """Fit all sets together, each until its step vanishes."""
    if not sets:
        return []
    rates, keep, last = _rates(settings), settings.keep_history, settings.max_iterations
    descents = [_Descent(len(points), model.free, rates, keep, list(start_of(points))) for points in sets]
    stack, left = stacked(sets), descents
    for iteration in range(1, last + 1):
        aheads = [descent.ahead() for descent in left]
        state = evaluate(stack, np.array(aheads, np.int64))
        slopes = gradients(stack, state, aheads, model.free)
        for descent, ahead, c, slope in zip(left, aheads, cost(stack, state), slopes, strict=True):
            if (end := descent.advance(ahead, c, slope)) is not None:
                descent.fit = descent.result(end, iteration)
        going = [row for row, descent in enumerate(left) if descent.fit is None]
        if not going:
            break
        if len(going) < len(left):
            stack, left = stack.select(going), [left[row] for row in going]
    ends = [descent.fit or descent.result(descent.best, last) for descent in descents]
    return [_finished(points, model, end) for points, end in zip(sets, ends, strict=True)]


def _finished(points: PointSet, model: Model, end: Fit) -> Fit:
    """Continue from the end of a descent by Gauss-Newton steps; return it as it is at the minimum.

    So it is where they lead nowhere, as with points that do not determine the parameters.
    """
    try:
        after = fit_penalized(points, model, NO_PENALTY, end.parameters).fit
    except DivergedError:
        return end
    away = max(abs(one - other) for one, other in zip(after.parameters, end.parameters, strict=True))
    if not after.converged or (end.converged and away <= AT_THE_MINIMUM):
        return end
    iterations = end.iterations + after.iterations
    history = end.history and end.history + after.history[1:]
    return replace(after, iterations=iterations, stop=FINISHED, operations=end.operations, history=history)


OPTIMIZER = Optimizer(
    name="fixed32",
    title="gradient descent in 32-bit fixed point (Farago, Maczak, Gingl 2024)",
    fit=fit,
    fit_each=fit_each,
    fit_penalized=fit_penalized,
    settings={"default": DEFAULT, "paper": PAPER},
    arithmetic="integer",
)
