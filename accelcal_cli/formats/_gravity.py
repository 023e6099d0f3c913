"""Guesses the unit of accelerations by their usual length, which gravity makes unmistakable in most files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.vocabulary import ACCELERATION_UNITS, GIVE_UNIT

USUAL_LSB_PER_G = tuple(1 << bits for bits in range(4, 15))
"""Counts per g of most sensors."""

SURE_SHARE = 0.15
"""Share by which the usual length may differ from one of these."""


def guess_unit(values: NDArray[np.float64], path: Path) -> str:
    """Return the unit of values (n, 3), by their usual length; raises UnreadableError if that fits no unit.

    Rows of zeros, which devices write while idle, do not count.
    """
    median = usual_length(values)
    for name, unit in ACCELERATION_UNITS.items():
        if unit.rest is not None and unit.rest[0] <= median <= unit.rest[1]:
            return name
    fits = [likely for likely in USUAL_LSB_PER_G if abs(median - likely) < SURE_SHARE * likely]
    more = f" ({fits[0]} would fit)" if fits else ""
    if not (values < 0).any():
        more = " and -R zero, the count of 0 g, since none of its numbers is negative"
    what = f"cannot tell the unit: the median length of the acceleration is {median:.4g}"
    raise UnreadableError(what, path=path, hint=GIVE_UNIT + more)


def usual_length(values: NDArray[np.float64]) -> float:
    """Return the median length of vectors (n, 3) without zeros and missing ones; 0 if there are no others."""
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.sqrt((values * values).sum(axis=1))
    norm = norm[np.isfinite(norm) & (norm > 0)]
    return float(np.median(norm)) if len(norm) else 0.0
