"""Means of windows as states, in fixed-point g."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import ONE, checked, rounded_quotient
from accelcal_cli.core.poses import Integers3, State, TimedWindows


def state(still: TimedWindows, at: list[int], lsb_per_g: float) -> State:
    """The state of the windows with these indices, which ascend.

    Raises:
        FixedPointOverflowError: its mean lies beyond 4 g.
    """
    samples = int(still.windows.samples[at].sum())
    sums = still.windows.sums[at].sum(axis=0).tolist()
    raw = _mean(sums, samples, Fraction(lsb_per_g))
    checked(np.array(raw, np.int64), "the mean of a still state")
    return State(int(still.start_us[at[0]]), int(still.end_us[at[-1]]), len(at), raw)


def _mean(sums: list[int], samples: int, lsb_per_g: Fraction) -> Integers3:
    x, y, z = (
        rounded_quotient(axis * ONE * lsb_per_g.denominator, samples * lsb_per_g.numerator) for axis in sums
    )
    return x, y, z


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (m, 3) at unit length; zeros stay zeros."""
    lengths = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    return np.asarray(vectors / np.where(lengths == 0, 1, lengths))
