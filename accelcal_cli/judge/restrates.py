"""The bias of a gyroscope: what it says at rest, block of time by block of time."""

from __future__ import annotations

from collections.abc import Callable
from math import fsum, sqrt

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.rotations import Bias, RestRates, Triple
from accelcal_cli.core.statistics import interval95, mean, quantile

STRETCHES = 10
"""Of time, held out one after the other to see whether a slope with temperature pays."""

ROUNDS = 20
HUBER = 1.5
"""Blocks further off than so many standard deviations count less: a turn that is slow is no rest."""

Floats = NDArray[np.float64]
Line = tuple[float, float]
"""Rate at the reference temperature, and its slope."""


def bias_at_rest(
    rates: RestRates, dps_per_lsb: Triple, period_s: float, least_range_c: float | None
) -> Bias | None:
    """The bias, with a slope where it pays on stretches of time that took no part; None without rest.

    Args:
        period_s: from one sample to the next.
        least_range_c: temperatures that a slope needs; None: none is wanted.
    """
    if not len(rates):
        return None
    dps = rates.gyro_sums / rates.samples[:, np.newaxis] * np.array(dps_per_lsb)
    weights = rates.samples / rates.samples.max()
    stretch = np.arange(len(rates)) * STRETCHES // len(rates)
    constant = _held_out(dps, weights, stretch, None)
    warmth, reference, with_slope = None, None, None
    if rates.temperature_sums is not None and least_range_c is not None and constant is not None:
        celsius = rates.temperature_sums / (1000 * rates.samples)
        if float(celsius.max() - celsius.min()) >= least_range_c:
            reference = round(float(quantile(sorted(celsius.tolist()), 0.5)), 3)
            with_slope = _held_out(dps, weights, stretch, celsius - reference)
            warmth = celsius - reference if _pays(constant, with_slope) else None
    lines = [_line(dps[:, axis], weights, warmth) for axis in range(3)]
    here = np.zeros(len(dps)) if warmth is None else warmth

    def off_line(axis: int) -> float:
        return _error(dps[:, axis] - _along(lines[axis], here), weights)

    off = [_lengths(dps), constant, with_slope]
    raw, fixed, sloped = (None if one is None else mean(one) for one in off)
    assert raw is not None
    return Bias(
        dps=_of_axes(lambda axis: lines[axis][0]),
        standard_errors=None if len(rates) < 2 else _of_axes(off_line),
        slope_dps_per_c=_of_axes(lambda axis: lines[axis][1]),
        reference_c=None if warmth is None else reference,
        rest_s=float(rates.samples.sum()) * period_s,
        raw_dps=raw,
        constant_dps=fixed,
        slope_dps=sloped,
    )


def _of_axes(value: Callable[[int], float]) -> Triple:
    return value(0), value(1), value(2)


def _held_out(
    dps: Floats, weights: Floats, stretch: NDArray[np.int64], warmth: Floats | None
) -> list[float] | None:
    """Mean error of each stretch by a line through the others [deg/s]; None if there are too few blocks."""
    if len(dps) < STRETCHES:
        return None
    found = []
    for one in range(STRETCHES):
        out = stretch == one
        part = None if warmth is None else warmth[~out]
        lines = [_line(dps[~out, axis], weights[~out], part) for axis in range(3)]
        there = np.zeros(int(out.sum())) if warmth is None else warmth[out]
        off = np.stack([dps[out, axis] - _along(lines[axis], there) for axis in range(3)], axis=1)
        found.append(mean(_lengths(off)))
    return found


def _pays(constant: list[float], with_slope: list[float] | None) -> bool:
    """Whether a slope makes the error fall clearly."""
    if with_slope is None:
        return False
    falls = [one - other for one, other in zip(constant, with_slope, strict=True)]
    return interval95(falls)[0] > 0


def _lengths(dps: Floats) -> list[float]:
    found: list[float] = np.sqrt(dps[:, 0] ** 2 + dps[:, 1] ** 2 + dps[:, 2] ** 2).tolist()
    return found


def _along(line: Line, warmth: Floats) -> Floats:
    return np.asarray(line[0] + line[1] * warmth)


def _line(dps: Floats, weights: Floats, warmth: Floats | None) -> Line:
    """A line that blocks far off pull less at (Huber 1964), level without temperatures."""
    line, robust = (0.0, 0.0), weights
    for _ in range(ROUNDS):
        line = _least_squares(dps, robust, warmth)
        off = np.abs(dps - _along(line, np.zeros(len(dps)) if warmth is None else warmth))
        limit = HUBER * quantile(sorted(off.tolist()), 0.5) / 0.6745
        if not limit:
            break
        robust = weights * np.minimum(1.0, limit / np.maximum(off, 1e-12))
    return line


def _least_squares(dps: Floats, weights: Floats, warmth: Floats | None) -> Line:
    total = fsum(weights.tolist())
    level = fsum((weights * dps).tolist()) / total
    if warmth is None:
        return level, 0.0
    centre = fsum((weights * warmth).tolist()) / total
    apart = warmth - centre
    square = fsum((weights * apart * apart).tolist())
    slope = fsum((weights * apart * dps).tolist()) / square if square else 0.0
    return level - slope * centre, slope


def _error(off: Floats, weights: Floats) -> float:
    """Standard error of a weighted mean by how two or more blocks scatter."""
    total = fsum(weights.tolist())
    square = fsum((weights * weights * off * off).tolist())
    number = len(off)
    return sqrt(square * number / (number - 1)) / total
