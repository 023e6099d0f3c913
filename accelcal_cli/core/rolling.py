"""G's noise filter: a rolling mean, as wide as the sampling rate asks (Grammenos, Mascolo, Crowcroft 2018,
section 4.6 and Table 2).

It is for values that are written. Nothing that is calibrated or judged is filtered: a filter that came before
the test of stillness would make movement look still.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WIDTHS = (3, 5, 10, 20)
"""Samples, as in Table 2."""

UP_TO_HZ = (20.0, 80.0, 120.0)
"""Rates up to which each width but the last is meant; the table has 80 Hz twice."""

MOST = 1000
"""The widest filter."""

STEPS = float(1 << 32)
"""In one unit: values are summed as whole numbers of these, so that a sum does not depend on its order."""


def width_for(rate_hz: float) -> int:
    """The width of the filter for a sampling rate, by Table 2."""
    return next((width for width, most in zip(WIDTHS, UP_TO_HZ, strict=False) if rate_hz <= most), WIDTHS[-1])


def reach(width: int) -> tuple[int, int]:
    """How many samples before and after its own a mean has; of an even width, one more before."""
    return width // 2, (width - 1) // 2


def rolling_means(values: NDArray[np.float32], width: int, start: int, stop: int) -> NDArray[np.float32]:
    """Means (m, k) of the samples around rows start..stop-1 of an unbroken stretch (n, k).

    Where the stretch begins or ends within reach, the mean is of the samples that are there. It is that of
    values to the nearest 2^-32 (|value| < 2^21, width up to 1000), whatever else is in memory.
    """
    before, after = reach(width)
    low, high = max(0, start - before), min(len(values), stop + after)
    whole = np.rint(values[low:high].astype(np.float64) * STEPS).astype(np.int64)
    # what a sum loses beyond 64 bits does not show in a difference that fits them
    sums = np.concatenate([np.zeros((1, values.shape[1]), np.int64), np.cumsum(whole, axis=0)])
    rows = np.arange(start, stop)
    first, last = np.maximum(rows - before, 0), np.minimum(rows + after + 1, len(values))
    total = sums[last - low] - sums[first - low]
    return np.asarray(total / ((last - first) * STEPS)[:, np.newaxis], np.float32)
