"""The factory's gain and offset of each axis, on one grid of whole counts for all three.

The device's documentation gives g = (raw * 100 - offset) / gain (Activinsights, GENEActiv
instructions, "Understanding .bin files"). Counts are slope * raw - shift with one number of counts
per g. They are exact where that takes no more than 2**24 counts per g, as with equal gains; else
the values are rounded to a grid of 1 / 2**24 g, 0.03 micro-g at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import gcd, lcm

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Counts

RAW_VALUES = 1 << 12
RAW_LIMIT = RAW_VALUES // 2
"""Raw values are two's complement of 12 bits: -2048 to 2047."""

GAINS = (6_400, 102_400)
"""Hundredths of a count per g that are possible: ranges of 32 g down to 2 g over 12 bits."""


@dataclass(frozen=True, slots=True)
class Factory:
    """The header's calibration block, x y z: g = (raw * 100 - offset) / gain."""

    gain: tuple[int, int, int]
    offset: tuple[int, int, int]

    @property
    def possible(self) -> bool:
        """Whether gains are those of a wrist-worn sensor and offsets below 1 g."""
        return all(
            GAINS[0] <= gain <= GAINS[1] and abs(offset) <= gain
            for gain, offset in zip(self.gain, self.offset, strict=True)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """From raw values to counts.

    Attributes:
        lsb_per_g: counts in one g, of every axis.
        table: (3, 4096) counts of x, y, z by the raw value's 12 bits; int16 where they fit, else int32.
        exact: whether counts / lsb_per_g is what the factory's formula gives, without rounding.
        plain: whether counts are the raw values themselves.
    """

    lsb_per_g: float
    table: Counts
    exact: bool
    plain: bool

    @property
    def clipped(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Counts of each axis, (3,), at the low and at the high end of what the sensor can tell."""
        return self.table[:, RAW_LIMIT].astype(np.int64), self.table[:, RAW_LIMIT - 1].astype(np.int64)


def raw_scale(lsb_per_g: float) -> Scale:
    """Raw values as they are, for a scale that the user gives."""
    return _scale(lsb_per_g, _linear((1, 1, 1), (0, 0, 0)), exact=True)


def factory_scale(factory: Factory) -> Scale:
    """The factory's formula on the coarsest grid that holds it exactly, or on 2**24 counts per g."""
    slopes = [Fraction(100, gain) for gain in factory.gain]
    shifts = [Fraction(offset, gain) for offset, gain in zip(factory.offset, factory.gain, strict=True)]
    grid = lcm(*(number.denominator for number in slopes + shifts))
    whole = [int(number * grid) for number in slopes + shifts]
    common = gcd(*whole)
    lsb_per_g = Fraction(grid, common)
    if lsb_per_g > FLOAT_LSB_PER_G:
        return _scale(FLOAT_LSB_PER_G, _rounded(factory), exact=False)
    reduced = [number // common for number in whole]
    return _scale(float(lsb_per_g), _linear(reduced[:3], reduced[3:]), exact=True)


def _raw_values() -> NDArray[np.int64]:
    """The raw value of each pattern of 12 bits, (4096,)."""
    bits = np.arange(RAW_VALUES, dtype=np.int64)
    return np.where(bits < RAW_LIMIT, bits, bits - RAW_VALUES)


def _linear(slope: Sequence[int], shift: Sequence[int]) -> NDArray[np.int64]:
    """slope * raw - shift of each axis, (3, 4096)."""
    return _raw_values() * np.array(slope, np.int64)[:, None] - np.array(shift, np.int64)[:, None]


def _rounded(factory: Factory) -> NDArray[np.int64]:
    """Counts of 1 / 2**24 g, (3, 4096), rounded to the nearest; gains below 2**24 leave no halves."""
    gain = np.array(factory.gain, np.int64)[:, None]
    counts = _linear((100, 100, 100), factory.offset) * int(FLOAT_LSB_PER_G)
    return np.asarray((2 * counts + gain) // (2 * gain))


def _scale(lsb_per_g: float, table: NDArray[np.int64], *, exact: bool) -> Scale:
    narrow = np.abs(table).max() <= np.iinfo(np.int16).max
    stored: Counts = table.astype(np.int16) if narrow else table.astype(np.int32)
    return Scale(lsb_per_g, stored, exact, plain=bool((table == _raw_values()).all()))
