"""What happens to single rows of a chunk: unusable ones go, unmeasured temperatures repeat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import StampClock
from accelcal_cli.core.recording import Chunk
from accelcal_cli.readers._pages.pages import NO_TEMPERATURE


class TemperatureHold:
    """Repeats the last measured temperature where there is none.

    Args:
        first_mc: for samples before the first measured one; NO_TEMPERATURE if there never is any.
    """

    def __init__(self, first_mc: int) -> None:
        self._last_mc = first_mc

    def fill(self, measured: NDArray[np.int32] | None) -> NDArray[np.int32] | None:
        """Temperatures of the next rows [thousandths of a degree C], (n,), or None without any."""
        if measured is None or self._last_mc == NO_TEMPERATURE or not len(measured):
            return None if self._last_mc == NO_TEMPERATURE else measured
        known = measured != NO_TEMPERATURE
        if not known.all():
            source = np.maximum.accumulate(np.where(known, np.arange(len(measured)), -1))
            measured = np.where(source < 0, np.int32(self._last_mc), measured[source])
        self._last_mc = int(measured[-1])
        return measured


class RowFilter:
    """Takes faulty rows out of chunks; the row after them does not continue the one before."""

    def __init__(self) -> None:
        self._pending = False
        self._started = False

    def apply(self, chunk: Chunk, faulty: NDArray[np.bool_] | None) -> Chunk:
        """The chunk without the rows marked in `faulty` (n,)."""
        if faulty is not None and (self._pending or faulty.any()):
            chunk = self._without(chunk, faulty)
        self._started |= len(chunk) > 0
        return chunk

    def _without(self, chunk: Chunk, faulty: NDArray[np.bool_]) -> Chunk:
        keep = ~faulty
        return replace(
            chunk,
            counts=chunk.counts[keep],
            clock=StampClock(chunk.clock.times(0, len(keep))[keep]),
            breaks=self._breaks(chunk.breaks, faulty),
            temperature_mc=None if chunk.temperature_mc is None else chunk.temperature_mc[keep],
            gyro_counts=None if chunk.gyro_counts is None else chunk.gyro_counts[keep],
        )

    def _breaks(self, breaks: NDArray[np.int64], faulty: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Rows, counted without the faulty ones, that follow a break or a faulty row."""
        broken = faulty.copy()
        broken[breaks] = True
        marks = np.concatenate(([-int(self._pending)], np.cumsum(broken)[~faulty]))
        self._pending = int(broken.sum()) > int(marks[-1])
        found = np.flatnonzero(np.diff(marks) > 0)
        return found if self._started else found[found > 0]
