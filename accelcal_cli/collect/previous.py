"""The posture before: what each still window is preceded by, for sensors that remember where they were."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.points import Windows

COS_SQUARED = (956, 1024)
"""Of 15 degrees: windows within them are of one posture."""

Vector = tuple[int, int, int]


class PreviousPosture:
    """Takes the still windows of a recording in the order of time.

    A posture lasts while windows lie within 15 degrees of its first one.
    """

    def __init__(self) -> None:
        self._leader: Vector | None = None
        self._cell: tuple[int, ...] | None = None
        """Of the last window."""
        self._last: Vector = (0, 0, 0)
        self._before: Vector | None = None

    def of(self, windows: Windows, cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """Mean counts of the last window of the posture before each window, (m, 3).

        Windows of the first posture, which has none before it, are given their own.

        Args:
            cell: (m, c) small whole numbers; windows with the same ones measure the same direction.
        """
        means = windows.sums // windows.samples[:, np.newaxis]
        held = cell[:1] - 1 if self._cell is None else [self._cell]
        fresh = (np.diff(cell, axis=0, prepend=held) != 0).any(axis=1)
        starts = np.flatnonzero(np.append(True, fresh[1:]))
        ends = np.append(starts[1:], len(windows))
        self._cell = tuple(cell[-1].tolist())
        before = means.copy()
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
            first, last = means[start].tolist(), means[end - 1].tolist()
            if self._leader is None or (fresh[start] and not _alike(self._leader, first)):
                self._before = None if self._leader is None else self._last
                self._leader = first
            self._last = last
            if self._before is not None:
                before[start:end] = self._before
        return before


def _alike(one: Vector, other: Vector) -> bool:
    """Whether two vectors are less than 15 degrees apart."""
    share, whole = COS_SQUARED
    dot = sum(a * b for a, b in zip(one, other, strict=True))
    norms = sum(a * a for a in one) * sum(b * b for b in other)
    return dot > 0 and dot * dot * whole >= share * norms
