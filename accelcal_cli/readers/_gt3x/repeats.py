"""Idle sleep in recordings that do not mark it: the device writes its last sample over and over.

"While in sleep mode, the last sampled accelerometer value is written into memory at the device's preset
sample rate" (ActiGraph, "Idle Sleep Mode Explained"). No measured sample repeats itself for a second: the
longest such run among 980 000 measured samples of seven devices at 30 and 100 Hz is 8 samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Repeats:
    """Marks the repetitions in runs of equal samples.

    Args:
        least: how many equal samples in a row are sleep; the first of them was measured.
    """

    def __init__(self, least: int) -> None:
        self._least = least
        self._held = np.empty((0, 3), np.int16)
        self._given = 0
        self._value = np.zeros(3, np.int16)

    def feed(self, counts: NDArray[np.int16], *, last: bool) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
        """Rows (n, 3) that are settled now, and which of them the device filled, (n,).

        A last run that may still become long enough is held back.
        """
        rows = np.concatenate((self._held, counts))
        if not len(rows):
            return rows, np.empty(0, np.bool_)
        begins = np.append(True, (rows[1:] != rows[:-1]).any(axis=1))
        goes_on = self._given > 0 and bool((rows[0] == self._value).all())
        start = np.flatnonzero(begins)
        length = np.diff(np.append(start, len(rows)))
        length[0] += self._given if goes_on else 0
        filled = np.repeat(length >= self._least, np.diff(np.append(start, len(rows))))
        filled[start[int(goes_on) :]] = False
        return self._settled(rows, filled, int(start[-1]), int(length[-1]), last=last)

    def _settled(
        self, rows: NDArray[np.int16], filled: NDArray[np.bool_], begin: int, length: int, *, last: bool
    ) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
        """All rows, without the run that begins at `begin` if it is open and still short."""
        ready = len(rows) if last or length >= self._least else begin
        self._held, self._value = rows[ready:].copy(), rows[-1].copy()
        self._given = length if ready == len(rows) else 0
        return rows[:ready], filled[:ready]
