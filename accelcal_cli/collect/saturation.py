"""An axis that measures nothing beyond some value, although its range goes further: seen in still windows.

There it never changes, while another axis moves with the wearer. Elsewhere an axis that never changes
belongs to a device on a table, or to a coarse sensor, whose other axes hardly change either.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from accelcal_cli.core.points import Saturated, Windows

LEAST_MOVED = 3
"""Counts that another axis moves while this one stands."""

LEAST_G = 0.5
"""A wrist takes an axis further than this."""

LEAST_WINDOWS = 12
"""One minute in windows of 5 s."""

MOST_ELSEWHERE = 10
"""An axis that stands at other values in more than a tenth as many windows does so for another reason."""


class Saturation:
    """Takes the still windows of a recording, in any order."""

    def __init__(self) -> None:
        self._standing: list[Counter[int]] = [Counter() for _ in range(3)]
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, windows: Windows) -> None:
        """Take windows in."""
        if not len(windows):
            return
        means = windows.sums / windows.samples[:, np.newaxis]
        self._low = np.minimum(self._low, means.min(axis=0))
        self._high = np.maximum(self._high, means.max(axis=0))
        moved = windows.spread.max(axis=1) >= LEAST_MOVED
        for axis, standing in enumerate(self._standing):
            which = np.flatnonzero(moved & (windows.spread[:, axis] == 0))
            values, numbers = np.unique(
                windows.sums[which, axis] // windows.samples[which], return_counts=True
            )
            standing.update(dict(zip(values.tolist(), numbers.tolist(), strict=True)))

    def merge(self, other: Saturation) -> None:
        """Take in what another one holds."""
        self._low, self._high = np.minimum(self._low, other._low), np.maximum(self._high, other._high)
        for standing, more in zip(self._standing, other._standing, strict=True):
            standing.update(more)

    def found(self, lsb_per_g: float) -> Saturated:
        """The axes that saturate, and at what."""
        return tuple(
            (axis, value / lsb_per_g)
            for axis, standing in enumerate(self._standing)
            for value in _ends(standing, self._low[axis], self._high[axis])
            if abs(value) >= LEAST_G * lsb_per_g
        )


def _ends(standing: Counter[int], low: float, high: float) -> list[int]:
    """Where an axis stands at the most extreme value that it has, and hardly anywhere else."""
    ends = {int(value): standing[int(value)] for value in (low, high) if float(value).is_integer()}
    often = {value: number for value, number in ends.items() if number >= LEAST_WINDOWS}
    elsewhere = standing.total() - sum(often.values())
    return [value for value, number in often.items() if elsewhere * MOST_ELSEWHERE <= number]
