"""Rotation rates from a file of their own, next to the accelerations of a phone or a chest strap.

The two sensors have their own times: a row gets the rates that were measured nearest to it. Where none was
measured nearby, the row is a break, so that nothing is concluded from a turn that was not seen whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import pi

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Chunk, Counts, Reader

READ_AS = {"rad/s": ("g", 180 / pi / FLOAT_LSB_PER_G), "deg/s": ("mg", 1000 / FLOAT_LSB_PER_G)}
"""Unit of acceleration as which rates of each unit are read, and deg/s in one count then."""

NEAR_PERIODS = 2.5
"""Farthest distance of a row from its rates, in periods of the slower sensor."""

LONGEST_DELAY_S = 5.0
"""Longest time that one sensor begins after the other."""


class WithGyroscope(Reader):
    """Reads accelerations, and the rates that were measured nearest to each row.

    Args:
        unit: of the rates, as in `-R gyro_unit`.
    """

    def __init__(self, reader: Reader, gyro: Reader, name: str, unit: str) -> None:
        self._reader, self._gyro = reader, gyro
        self._near_us = NEAR_PERIODS * MICROSECONDS / min(reader.recording.rate_hz, gyro.recording.rate_hz)
        scale = READ_AS[unit][1]
        notes = (*reader.recording.notes, f"gyroscope: {name}")
        self.recording = replace(reader.recording, gyro_dps_per_lsb=(scale,) * 3, notes=notes)

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """See `Reader`."""
        rates = _Rates(self._gyro.chunks(chunk_samples))
        far_before = False
        for chunk in self._reader.chunks(chunk_samples):
            times = chunk.clock.times(0, len(chunk))
            counts, far = rates.nearest(times, self._near_us)
            changes = np.flatnonzero(np.diff(far, prepend=far_before)) if len(far) else np.empty(0, np.int64)
            far_before = bool(far[-1]) if len(far) else far_before
            changes = changes[chunk.first_sample + changes > 0]
            breaks = np.union1d(chunk.breaks, changes).astype(np.int64, copy=False)
            yield replace(chunk, gyro_counts=counts, breaks=breaks)


class _Rates:
    """Rates in the order of their times, as far as they have been needed."""

    def __init__(self, chunks: Iterator[Chunk]) -> None:
        self._chunks = chunks
        self._times: NDArray[np.int64] = np.empty(0, np.int64)
        self._counts = np.empty((0, 3), np.int32)

    def nearest(self, times: NDArray[np.int64], near_us: float) -> tuple[Counts, NDArray[np.bool_]]:
        """Return the rates (n, 3) nearest to times (n,) [us], zeros where none are near; and where so."""
        if not len(times):
            return np.empty((0, 3), np.int32), np.empty(0, np.bool_)
        self._read_to(int(times.max()) + round(near_us), int(times.min()) - round(near_us))
        if not len(self._times):
            return np.zeros((len(times), 3), np.int32), np.ones(len(times), np.bool_)
        after = np.searchsorted(self._times, times).clip(1, max(1, len(self._times) - 1))
        before = after - 1
        after = np.minimum(after, len(self._times) - 1)
        later = np.abs(self._times[after] - times) < np.abs(self._times[before] - times)
        place = np.where(later, after, before)
        far = np.abs(self._times[place] - times) > near_us
        counts = self._counts[place]
        counts[far] = 0
        return counts, far

    def _read_to(self, last_us: int, first_us: int) -> None:
        """Read rates up to a time, and forget those before another but the last."""
        keep = max(0, int(np.searchsorted(self._times, first_us)) - 1)
        times, counts = [self._times[keep:]], [self._counts[keep:]]
        newest = int(self._times[-1]) if len(self._times) else first_us - 1
        while newest <= last_us and (chunk := next(self._chunks, None)) is not None:
            if len(chunk):
                times.append(np.maximum.accumulate(np.maximum(chunk.clock.times(0, len(chunk)), newest)))
                counts.append(chunk.counts.astype(np.int32, copy=False))
                newest = int(times[-1][-1])
        self._times = np.concatenate(times)
        self._counts = np.concatenate(counts)
