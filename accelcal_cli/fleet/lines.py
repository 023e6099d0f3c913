"""Weighted least squares of all parameters of all devices at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.fleet.records import Floats, Indices

FEWEST = 3
"""Recordings of which a drift is told: two give a line, but nothing that says how good it is."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Values of p parameters in n recordings, by device; NaN for none.

    Attributes:
        values, errors: (n, p).
        days: (n,).
        first: (d + 1,) where each device's recordings begin.
    """

    values: Floats
    errors: Floats
    days: Floats
    first: Indices

    def where(self, kept: NDArray[np.bool_]) -> Measured:
        """Without the values of other recordings."""
        held = np.where(kept[:, np.newaxis], self.values, nan)
        return Measured(held, self.errors, self.days, self.first)

    def weights(self) -> Floats:
        """1 / SE^2, 0 where there is no value."""
        there = np.isfinite(self.values) & np.isfinite(self.errors)
        return np.divide(1.0, self.errors**2, out=np.zeros_like(self.errors), where=there)

    def total(self, held: Floats) -> Floats:
        """Sums over each device's recordings, (d, p)."""
        return np.asarray(np.add.reduceat(held, self.first[:-1], axis=0) if len(held) else held[:0])

    def spread(self, held: Floats) -> Floats:
        """Values of the devices for each of their recordings, (n, p)."""
        return np.repeat(held, np.diff(self.first), axis=0)


class Mean(NamedTuple):
    """The weighted mean of a parameter of a device; NaN without values.

    Attributes:
        number: how many values.
        scatter: chi^2 over freedom, NaN for a single one.
    """

    number: int
    value: float
    error: float
    scatter: float


class Line(NamedTuple):
    """A parameter of a device as a straight line over time; NaN where there are not enough recordings.

    Attributes:
        number: recordings with a value and a date.
        slope, slope_error: a day.
        value, error: of the line at the last of them.
        scatter: chi^2 over freedom.
    """

    number: int
    slope: float
    slope_error: float
    value: float
    error: float
    scatter: float


def means(held: Measured) -> list[list[Mean]]:
    """Weighted means, p of each device; errors f / sqrt(sum w), f^2 = chi^2 / (n - 1) if above 1, else 1."""
    weights = held.weights()
    number, total = held.total((weights > 0).astype(float)), held.total(weights)
    values = np.where(weights > 0, held.values, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = held.total(weights * values) / total
        freedom = _where(number - 1, number > 1)
        scatter = held.total(weights * (values - held.spread(value)) ** 2) / freedom
        error = _inflation(scatter) / np.sqrt(total)
    columns = (value, _where(error, number > 0), scatter)
    return [[Mean(*cell) for cell in device] for device in _cells(number.astype(np.int64), *columns)]


def lines(held: Measured, least_days: float) -> list[list[Line]]:
    """y = a + b (t - t0) with weights w = 1 / SE^2, t0 the weighted mean of the times; p of each device.

    b = sum w (t - t0) y / S, S = sum w (t - t0)^2; SE(b) = f / sqrt(S); at a time t the line's error is
    f sqrt(1 / sum w + (t - t0)^2 / S); f^2 = chi^2 / (n - 2) where that is above 1, else 1 (Birge, Physical
    Review 40, 207, 1932; the scale factor of the Particle Data Group).
    """
    held = held.where(np.isfinite(held.days))
    there = held.weights() > 0
    number = held.total(there.astype(float))
    begin, end = _extremes(held, there)
    enough = (number >= FEWEST) & (end - begin >= least_days)
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = [_where(one, enough) for one in _fitted(held, there, number, end)]
    return [[Line(*cell) for cell in device] for device in _cells(number.astype(np.int64), *columns)]


def _cells(*columns: NDArray[Any]) -> Iterator[Iterator[tuple[Any, ...]]]:
    """From columns (d, p) each to the tuples of each device's parameters, as plain numbers."""
    for device in zip(*(column.tolist() for column in columns), strict=True):
        yield zip(*device, strict=True)


def _fitted(held: Measured, there: NDArray[np.bool_], number: Floats, at: Floats) -> tuple[Floats, ...]:
    """Slope, its error, value and error at a day (d, p), scatter; see `lines`."""
    weights, days = held.weights(), held.days[:, np.newaxis]
    total = held.total(weights)
    centre, middle = (
        held.total(weights * np.where(there, column, 0.0)) / total for column in (days, held.values)
    )
    away = np.where(there, days - held.spread(centre), 0.0)
    off = np.where(there, held.values - held.spread(middle), 0.0)
    square = held.total(weights * away**2)
    slope = held.total(weights * away * off) / square
    left = np.where(there, off - held.spread(slope) * away, 0.0)
    scatter = held.total(weights * left**2) / (number - 2)
    grown, late = _inflation(scatter), at - centre
    error = grown * np.sqrt(1 / total + late**2 / square)
    return slope, grown / np.sqrt(square), middle + slope * late, error, scatter


def _inflation(scatter: Floats) -> Floats:
    return np.sqrt(np.where(scatter > 1, scatter, 1.0))


def _where(held: Floats, kept: NDArray[np.bool_]) -> Floats:
    return np.asarray(np.where(kept, held, nan), np.float64)


def _extremes(held: Measured, there: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """First and last day of each device's values, (d, p); NaN where there are none."""
    if not len(there):
        return held.values[:0], held.values[:0]
    days = held.days[:, np.newaxis]
    first = np.minimum.reduceat(np.where(there, days, np.inf), held.first[:-1], axis=0)
    last = np.maximum.reduceat(np.where(there, days, -np.inf), held.first[:-1], axis=0)
    return _where(first, np.isfinite(first)), _where(last, np.isfinite(last))
