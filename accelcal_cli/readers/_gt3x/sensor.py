"""What a sensor of the device is to the rest of the reader: which records hold its samples, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._gt3x.layout import HEADER_BYTES, Records


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of k records, n in all, in file order.

    Attributes:
        rows: (k,) int64, samples of each record.
        counts: (n, 3) int16.
        temperature_mc: (n,) int32, thousandths of a degree C, or None.
        gyro: (n, 3) int16, or None.
    """

    rows: NDArray[np.int64]
    counts: NDArray[np.int16]
    temperature_mc: NDArray[np.int32] | None = None
    gyro: NDArray[np.int16] | None = None


class Sensor(Protocol):
    """One of the device's sensors."""

    @property
    def rate(self) -> int:
        """Samples in a second."""
        ...

    @property
    def fills(self) -> bool:
        """Whether the device repeats its last sample while it sleeps."""
        ...

    def holds(self, buffer: NDArray[np.uint8], records: Records) -> NDArray[np.bool_]:
        """Which records hold its samples, (m,)."""
        ...

    def decode(self, buffer: NDArray[np.uint8], records: Records) -> Samples:
        """Samples of records that `holds` named."""
        ...

    def whole(self, records: Records) -> NDArray[np.bool_]:
        """Which of these records are one second of samples and nothing else, (k,)."""
        ...


def payloads_of(buffer: NDArray[np.uint8], start: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
    """Payloads of records of one size that begin at `start` (k,), (k, size)."""
    if not size:
        return np.empty((len(start), 0), np.uint8)
    every = np.lib.stride_tricks.sliding_window_view(buffer, size)
    return np.ascontiguousarray(every[start + HEADER_BYTES])


def first_rows(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where each record's samples begin, (k,)."""
    return np.cumsum(rows) - rows
