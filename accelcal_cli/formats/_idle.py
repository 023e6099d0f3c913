"""Idle sleep that a recording does not mark: the device writes its last sample over and over.

"While in sleep mode, the last sampled accelerometer value is written into memory at the device's preset
sample rate" (ActiGraph, "Idle Sleep Mode Explained"). No measured sample repeats itself for a second: the
longest such run among 980 000 measured samples of seven devices at 30 and 100 Hz is 8 samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class RepeatedSamples:
    """Marks the repetitions in long runs of equal samples, wherever the blocks of a file end.

    Args:
        least: how many equal samples in a row are sleep; the first of them was measured.
    """

    def __init__(self, least: int) -> None:
        self._least = max(least, 2)
        self._asleep: NDArray[Any] | None = None

    def mark(
        self, counts: NDArray[Any], usable: NDArray[np.bool_] | None = None, *, last: bool
    ) -> NDArray[np.bool_]:
        """Which samples only repeat the one before, (m,).

        Args:
            counts: (n, 3) the next samples.
            usable: (n,) others repeat nothing.
            last: no samples follow.

        Returns:
            Of the first m samples. A run at the end that may become long enough is left over: those n - m
            samples belong at the beginning of the next call.
        """
        if not len(counts):
            return np.empty(0, np.bool_)
        repeats = self._repeats(counts, usable)
        begins = ~repeats
        begins[0] = True
        starts = np.flatnonzero(begins)
        sizes = np.diff(starts, append=len(counts))
        long = sizes >= self._least
        long[0] |= repeats[0]
        self._asleep = counts[-1].copy() if long[-1] else None
        settled = len(counts) if last or long[-1] else int(starts[-1])
        return np.asarray(np.repeat(long, sizes) & repeats)[:settled]

    def _repeats(self, counts: NDArray[Any], usable: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
        """Samples that equal the one before, (n,)."""
        same = np.ones(len(counts), np.bool_) if usable is None else usable.copy()
        same[0] &= self._asleep is not None and np.array_equal(counts[0], self._asleep)
        for axis in counts.T:
            same[1:] &= axis[1:] == axis[:-1]
        return same
