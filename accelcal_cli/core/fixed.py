"""Fixed-point integers: 32-bit values with 29 fraction bits, 64-bit products, no wrapping.

Values lie in -4..4 (F's implementation note: 32-bit fixed point; Farago, Maczak, Gingl 2024).
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import FixedPointOverflowError

FRACTION_BITS = 29
ONE = 1 << FRACTION_BITS
LIMIT = 1 << 31

Fixed = NDArray[np.int64]
"""Values that fit 32 bits, held in 64 so that their products are exact."""


def checked(values: Fixed, what: str, limit: int = LIMIT) -> Fixed:
    """Pass values through if all lie within +-limit.

    Raises:
        FixedPointOverflowError: one does not.
    """
    if (
        values.size
        and not -limit < np.minimum.reduce(values, None) <= np.maximum.reduce(values, None) < limit
    ):
        raise FixedPointOverflowError(
            f"{what} leaves the 32-bit fixed-point range of +-{LIMIT // ONE} g",
            hint="check the unit and --lsb-per-g",
        )
    return values


def narrow(values: Fixed, bits: int = FRACTION_BITS) -> Fixed:
    """Drop `bits` fraction bits of the values in their place, rounding half up."""
    values += 1 << (bits - 1)
    values >>= bits
    return values


def to_fixed(value: Fraction | float) -> int:
    """The nearest fixed-point integer of a number, ties to even."""
    return round(Fraction(value) * ONE)


def to_float(value: int) -> float:
    """The number a fixed-point integer stands for (exact: 29 bits fit a double)."""
    return value / ONE


def rounded_quotient(value: int, divisor: int) -> int:
    """value / divisor rounded to the nearest integer, halves up; the divisor is positive."""
    return (2 * value + divisor) // (2 * divisor)
