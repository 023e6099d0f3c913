"""F's gradient descent in 32-bit fixed point: integers from the points to the coefficients.

Objective: the weighted mean of (|a|^2 - 1)^2 (F eq. 12 without the square root; the mean, not the
printed sum, for which the published learning rates diverge with 18 points). Start at the ideal sensor.
Farago, Maczak, Gingl 2024, section II.C.

Values have 29 fraction bits in 32 (core.fixed); products have 58 in 64. Sums of products are kept exact
or are given head room for 8192 points. Every narrowing is checked, nothing wraps.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from accelcal_cli.core.errors import DivergedError, FixedPointOverflowError
from accelcal_cli.core.fixed import FRACTION_BITS, ONE, Fixed, checked, narrow, rounded_quotient
from accelcal_cli.core.points import IDENTITY, WEIGHT_ONE, Fit, Model, Operations, Optimizer, PointSet

VALUE_LIMIT = 2 * ONE
RESIDUAL_LIMIT = ONE
MAX_POINTS = 8192
_LOW_HALF = (1 << FRACTION_BITS) - 1
_WEIGHT_BITS = WEIGHT_ONE.bit_length() - 1
_HEAD_ROOM_BITS = 10
_ROWS = [0, 1, 2, 1, 2, 2]
_COLUMNS = [0, 1, 2, 0, 0, 1]
"""Of the entries of K, in the order of the parameters."""

RATE_BITS = 24
RISE_TOLERANCE_BITS = 12
"""A rise of the cost counts from one part in 4096: below that it can be rounding."""

SMALL_STEP = 1
"""Steps of at most so many least significant bits are taken without momentum."""

LEAST_SCALE = ONE // 4
"""No accelerometer is so far off: a smaller scale means that the points do not determine it."""

RATES_OF_F = {"scale": 0.3, "misalignment": 0.8, "offset": 0.2, "slope": 0.2}
"""F section II.C; the slopes act on the offsets through scaled temperatures of order 1."""


class Tally:
    """Counts the additions and multiplications of scalars that the arithmetic performs."""

    def __init__(self) -> None:
        self.additions = 0
        self.multiplications = 0

    def count(self, additions: int, multiplications: int, times: int = 1) -> None:
        """Add `times` repetitions of so many operations."""
        self.additions += additions * times
        self.multiplications += multiplications * times

    def total(self) -> Operations:
        """What was counted so far."""
        return Operations(self.additions, self.multiplications)


@dataclass(frozen=True, slots=True)
class State:
    """The model at one set of parameters: u = v + o + s tau, a = K u, r = |a|^2 - 1.

    Attributes:
        shifted, calibrated: u and a, (3, n) or (3, k, n).
        residual: (n,) or (k, n).
    """

    shifted: Fixed
    calibrated: Fixed
    residual: Fixed


def evaluate(points: PointSet, parameters: Fixed, tally: Tally) -> State:
    """Apply (12,) or (k, 12) parameters to n points (F eq. 7-9).

    Raises:
        FixedPointOverflowError: a parameter, a point or a residual leaves its range, or there are
            more than MAX_POINTS points.
    """
    if len(points) > MAX_POINTS:
        raise FixedPointOverflowError(f"{len(points)} points are more than the {MAX_POINTS} that sums hold")
    p = checked(parameters, "a parameter", VALUE_LIMIT).T[..., np.newaxis]
    shifted = _shifted(points, p)
    products = p[:3] * shifted
    products[1] += p[3] * shifted[0]
    products[2] += p[4] * shifted[0] + p[5] * shifted[1]
    calibrated = checked(narrow(products), "a calibrated point", VALUE_LIMIT)
    squared = calibrated[0] ** 2 + calibrated[1] ** 2 + calibrated[2] ** 2
    residual = checked(narrow(squared - (ONE << FRACTION_BITS)), "a residual", RESIDUAL_LIMIT)
    tally.count(9, 9, residual.size)
    return State(shifted, calibrated, residual)


def _shifted(points: PointSet, p: Fixed) -> Fixed:
    shifted = points.xyz.T.reshape(3, *(1,) * (p.ndim - 2), -1) + p[6:9]
    if points.tau is not None:
        shifted += narrow(p[9:] * points.tau)
    return checked(shifted, "a shifted point", VALUE_LIMIT)


def cost(points: PointSet, state: State, tally: Tally) -> list[int]:
    """Exact weighted sums of squared residuals, one for each set of parameters.

    The unit is 2**-(58 + weight bits); squares are summed in two halves so that nothing is lost.
    """
    squares = state.residual.reshape(-1, len(points)) ** 2
    high = (squares >> FRACTION_BITS) @ points.weights
    low = (squares & _LOW_HALF) @ points.weights
    tally.count(1, 1, squares.size)
    return [(top << FRACTION_BITS) + rest for top, rest in zip(high.tolist(), low.tolist(), strict=True)]


def gradient(points: PointSet, state: State, parameters: Fixed, tally: Tally) -> list[int]:
    """Gradient of the weighted mean of r^2, twelve fixed-point integers (29 fraction bits).

    Chain rule on F eq. 7-9: d/dk_ij = 4 mean(r a_i u_j); d/do = 4 K^T mean(r a); d/ds the same
    with r a tau.
    """
    weighted = narrow(state.residual * points.weights, _WEIGHT_BITS)
    force = narrow(weighted * state.calibrated)
    scale = _sums_of_products(force.take(_ROWS, 0), state.shifted.take(_COLUMNS, 0))
    plain = force.sum(axis=1).tolist()
    heated = [0, 0, 0] if points.tau is None else _sums_of_products(force, points.tau)
    tally.count(9, 10, len(points))
    k = [int(value) for value in parameters[:6]]
    sums = scale + _turned_back(k, plain) + _turned_back(k, heated)
    weight = int(points.weights.sum())
    return [rounded_quotient(4 * total * WEIGHT_ONE, weight) for total in sums]


def _sums_of_products(left: Fixed, right: Fixed) -> list[int]:
    """Sums over the points of left * right in units of 2**-29, with head room for MAX_POINTS."""
    totals = narrow(left * right, _HEAD_ROOM_BITS).sum(axis=1)
    found: list[int] = (totals >> (FRACTION_BITS - _HEAD_ROOM_BITS)).tolist()
    return found


def _turned_back(k: list[int], force: list[int]) -> list[int]:
    """K^T times a vector."""
    x, y, z = force
    return [
        (k[0] * x + k[3] * y + k[4] * z) >> FRACTION_BITS,
        (k[1] * y + k[5] * z) >> FRACTION_BITS,
        (k[2] * z) >> FRACTION_BITS,
    ]


@dataclass(frozen=True, slots=True)
class Settings:
    """Numbers of the descent.

    Attributes:
        max_iterations: bound on the iterations.
        converge: stop when every step is below one least significant bit, and halve the rates
            when the cost rises; otherwise run all iterations.
        forward_step: h of F eq. 13 in fixed point; 0: the exact gradient instead.
        keep_history: return the parameters after every iteration.
    """

    max_iterations: int
    converge: bool
    forward_step: int
    rates: dict[str, float] = field(default_factory=lambda: dict(RATES_OF_F))
    keep_history: bool = False


PAPER = Settings(max_iterations=50, converge=False, forward_step=round(1e-5 * ONE))
DEFAULT = Settings(max_iterations=20_000, converge=True, forward_step=0)


def fit(points: PointSet, model: Model, settings: Settings = DEFAULT) -> Fit:
    """Fit the free parameters of a model.

    Raises:
        FixedPointOverflowError: the descent leaves the fixed-point range, or there are more than
            MAX_POINTS points.
        DivergedError: no point has any weight, or an axis collapsed.
    """
    if not model.free or not len(points):
        return Fit(IDENTITY, 0, "nothing to fit", Tally().total())
    if not points.weights.any():
        raise DivergedError("no point has any weight")
    descent = _forward if settings.forward_step else _accelerated
    found = descent(points, model, settings)
    if min(found.parameters[:3]) < LEAST_SCALE:
        raise DivergedError("an axis collapsed: the points do not determine its scale")
    return found


def _rates(settings: Settings) -> list[int]:
    groups = ("scale", "misalignment", "offset", "slope")
    return [round(settings.rates[name] * (1 << RATE_BITS)) for name in groups for _ in range(3)]


def _ints(parameters: Fixed) -> tuple[int, ...]:
    return tuple(int(value) for value in parameters)


def _forward(points: PointSet, model: Model, settings: Settings) -> Fit:
    """F's iteration to the letter: forward differences, fixed rates, so many iterations.

    The update is counted as F does, an addition and a multiplication for each group of three
    parameters with one learning rate: M (100 N + 3) in all for nine parameters.
    """
    tally, rates = Tally(), _rates(settings)
    history: list[tuple[int, ...]] = []
    p = np.array(IDENTITY, np.int64)
    probes = np.zeros((len(model.free) + 1, 12), np.int64)
    probes[range(1, len(model.free) + 1), model.free] = settings.forward_step
    unit = settings.forward_step * int(points.weights.sum()) << (FRACTION_BITS + RATE_BITS)
    for _ in range(settings.max_iterations):
        base, *probed = cost(points, evaluate(points, p + probes, tally), tally)
        for index, value in zip(model.free, probed, strict=True):
            p[index] -= rounded_quotient((value - base) * rates[index] << FRACTION_BITS, unit)
        tally.count(len(model.free) // 3, len(model.free) // 3)
        if settings.keep_history:
            history.append(_ints(p))
    return Fit(_ints(p), settings.max_iterations, "iterations", tally.total(), tuple(history))


def _accelerated(points: PointSet, model: Model, settings: Settings) -> Fit:
    """Descent with momentum along the exact gradient until a step vanishes.

    Momentum age / (age + 3) (Nesterov 1983) is dropped where it points uphill (O'Donoghue,
    Candes 2015) and where the cost rises; a rise after a plain step halves the rates.
    """
    tally, rates = Tally(), _rates(settings)
    history: list[tuple[int, ...]] = []
    here = before = best = np.array(IDENTITY, np.int64)
    lowest: int | None = None
    age = 0
    for iteration in range(1, settings.max_iterations + 1):
        ahead = here + (here - before) * age // (age + 3)
        state = evaluate(points, ahead, tally)
        (reached,) = cost(points, state, tally)
        if lowest is not None and reached > lowest + (lowest >> RISE_TOLERANCE_BITS):
            rates = [rate >> 1 for rate in rates]
            here = before = best
            age = 0
            continue
        if lowest is None or reached < lowest:
            lowest, best = reached, ahead
        slope = gradient(points, state, ahead, tally)
        step = _step(slope, rates, model)
        if settings.keep_history:
            history.append(_ints(ahead - step))
        if not step.any() and age == 0:
            return Fit(_ints(ahead), iteration, "step below one bit", tally.total(), tuple(history))
        before, here = here, ahead - step
        age = age + 1 if np.abs(step).max() > SMALL_STEP and _downhill(slope, here - before) else 0
    return Fit(_ints(best), settings.max_iterations, "iterations", tally.total(), tuple(history))


def _downhill(slope: list[int], move: Fixed) -> bool:
    return sum(a * int(b) for a, b in zip(slope, move, strict=True)) < 0


def _step(slope: list[int], rates: list[int], model: Model) -> Fixed:
    step = np.zeros(12, np.int64)
    for index in model.free:
        step[index] = rounded_quotient(slope[index] * rates[index], 1 << RATE_BITS)
    return step


OPTIMIZER = Optimizer(
    name="fixed32",
    title="gradient descent in 32-bit fixed point (Farago, Maczak, Gingl 2024)",
    fit=fit,
    settings={"default": DEFAULT, "paper": PAPER},
    arithmetic="integer",
)
