"""Integer sums to fixed-point means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from accelcal_cli.core.fixed import ONE, rounded_quotient
from accelcal_cli.core.points import PointSet, TemperatureScale


@dataclass(frozen=True, slots=True)
class Sums:
    """One point before its division: sums over `samples` samples of `windows` windows."""

    windows: int
    samples: int
    xyz: tuple[int, int, int]
    temperature_mc: int = 0


def to_points(
    sums: Sequence[Sums], weights: Sequence[int], lsb_per_g: float, *, temperature: bool
) -> PointSet:
    """Means in fixed-point g; temperatures scaled to a power-of-two span about their mean."""
    scale = Fraction(lsb_per_g)
    xyz = [
        [
            rounded_quotient(axis * ONE * scale.denominator, item.samples * scale.numerator)
            for axis in item.xyz
        ]
        for item in sums
    ]
    windows = np.array([item.windows for item in sums], np.int64)
    held = np.array(weights, np.int64)
    places = np.array(xyz, np.int64).reshape(-1, 3)
    if not temperature or not sums:
        return PointSet(places, held, windows)
    means = [rounded_quotient(item.temperature_mc, item.samples) for item in sums]
    reference = rounded_quotient(sum(w * t for w, t in zip(weights, means, strict=True)), sum(weights))
    span = _span_c(max(abs(mean - reference) for mean in means))
    tau = [
        rounded_quotient((item.temperature_mc - reference * item.samples) * ONE, item.samples * 1000 * span)
        for item in sums
    ]
    return PointSet(places, held, windows, np.array(tau, np.int64), TemperatureScale(reference, float(span)))


def _span_c(largest_mc: int) -> int:
    span = 1
    while largest_mc >= 2000 * span:
        span *= 2
    return span
