"""F's gradient descent in 16-bit fixed point, its smallest implementation (section II.C).

Parameters, points and residuals are 16-bit integers with 13 fraction bits; products and sums are
32-bit integers. The forward difference of h = 0.01 is biased by h / 2 times the curvature, so scale
and offset end about 0.01 off and misalignment 0.015; more than 50 iterations make that worse, not
better. A method for a small microcontroller, here for comparison.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import FRACTION_BITS
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError, FixedPointOverflowError
from accelcal_cli.core.points import WEIGHT_ONE, Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.optimize.fixed32 import RATES_OF_F

BITS = 13
SINGLE = 1 << BITS
WEIGHT_BITS = WEIGHT_ONE.bit_length() - 1
SHORT, LONG = 1 << 15, 1 << 31
Short = NDArray[np.int64]
"""Values that fit 16 bits, or products that fit 32; each is checked."""


@dataclass(frozen=True, slots=True)
class Fixed16Settings:
    """Numbers of the descent.

    Attributes:
        max_iterations: number of iterations.
        forward_step: h of F eq. 13 in 13 fraction bits.
        keep_history: whether to return the parameters after every iteration.
    """

    max_iterations: int
    forward_step: int = round(0.01 * SINGLE)
    rates: dict[str, float] = field(default_factory=lambda: dict(RATES_OF_F))
    keep_history: bool = False


PAPER = Fixed16Settings(max_iterations=50)


def fit(points: PointSet, model: Model, settings: Fixed16Settings = PAPER) -> Fit:
    """Fit the free parameters of a model.

    Raises:
        FixedPointOverflowError: a value leaves its 16 or a sum its 32 bits.
        DivergedError: no point has any weight.
    """
    if not model.free or not len(points):
        return Fit(IDENTITY, 0, "nothing to fit", Operations())
    if int(points.weights.sum()) <= 0:
        raise DivergedError("no point has any weight")
    tau, drop = np.zeros(len(points), np.int64) if points.tau is None else points.tau, FRACTION_BITS - BITS
    v, tau = _short(_narrow(points.xyz, drop), "a point"), _short(_narrow(tau, drop), "a temperature")
    return _descent(_Points(v, tau, points.weights), model, settings)


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Points in 13 fraction bits, weights in 15; `tau` is zero without temperature."""

    v: Short
    tau: Short
    weights: Short


def _descent(points: _Points, model: Model, settings: Fixed16Settings) -> Fit:
    free, rates = list(model.free), _rates(settings)
    p = np.array(IDENTITY, np.int64) >> (FRACTION_BITS - BITS)
    probes = np.zeros((len(free) + 1, 12), np.int64)
    probes[range(1, len(free) + 1), free] = settings.forward_step
    history: list[tuple[int, ...]] = []
    for _ in range(settings.max_iterations):
        base, *probed = _cost(points, p + probes)
        step = [_step(points, value - base, rates[i]) for i, value in zip(free, probed, strict=True)]
        p[free] -= step
        if settings.keep_history:
            history.append(_wide(p))
    each = settings.max_iterations * (len(probes) * 10 * len(points.v) + len(free) // 3)
    counted = Operations(each, each)
    return Fit(_wide(p), settings.max_iterations, "iterations", counted, tuple(history), converged=False)


def _rates(settings: Fixed16Settings) -> list[int]:
    """Return learning rates over h, as whole numbers: 30, 80 and 20 with F's."""
    groups = ("scale", "misalignment", "offset", "slope")
    over_h = [round(settings.rates[name] * SINGLE / settings.forward_step) for name in groups]
    return [value for value in over_h for _ in range(3)]


def _cost(points: _Points, parameters: Short) -> list[int]:
    """Return sums of weighted squared residuals at (k, 12) parameters, in 26 fraction bits."""
    p = np.moveaxis(_short(parameters, "a parameter"), -1, 0)[..., np.newaxis]
    slopes = (_narrow(_long(slope * points.tau, "a slope"), BITS) for slope in p[9:12])
    shifted = (points.v[:, axis] + p[6 + axis] + slope for axis, slope in enumerate(slopes))
    x, y, z = (_short(one, "a shifted point") for one in shifted)
    a = (_calibrated(p[0] * x), _calibrated(p[3] * x + p[1] * y), _calibrated(p[4] * x + p[5] * y + p[2] * z))
    squared = _long(a[0] ** 2 + a[1] ** 2 + a[2] ** 2, "a square")
    residual = _short(_narrow(squared - (SINGLE << BITS), BITS), "a residual")
    weighted = _narrow(_long(residual * points.weights, "a weighted residual"), WEIGHT_BITS)
    total = _long((weighted * residual).sum(axis=1), "the cost")
    return [int(value) for value in total]


def _calibrated(products: Short) -> Short:
    return _short(_narrow(_long(products, "a sum of products"), BITS), "a calibrated point")


def _step(points: _Points, rise: int, rate: int) -> int:
    """Return rate times rise over h of the weighted mean, in 13 fraction bits; the one wide division."""
    total = int(points.weights.sum()) << BITS
    return (2 * rise * rate * WEIGHT_ONE + total) // (2 * total)


def _narrow(values: Short, bits: int) -> Short:
    return (values + (1 << (bits - 1))) >> bits


def _short(values: Short, what: str) -> Short:
    return _within(values, SHORT, f"{what} leaves 16 bits (+-{SHORT // SINGLE} g)")


def _long(values: Short, what: str) -> Short:
    return _within(values, LONG, f"{what} leaves 32 bits")


def _within(values: Short, limit: int, message: str) -> Short:
    if int(values.max()) >= limit or int(values.min()) < -limit:
        raise FixedPointOverflowError(message, hint="use --optimizer fixed32")
    return values


def _wide(p: Short) -> tuple[int, ...]:
    return tuple(int(value) << (FRACTION_BITS - BITS) for value in _short(p, "a parameter"))


OPTIMIZER = Optimizer(
    name="fixed16",
    title="gradient descent in 16-bit fixed point (Farago, Maczak, Gingl 2024)",
    fit=fit,
    settings={"default": PAPER, "paper": PAPER},
    arithmetic="integer",
)
