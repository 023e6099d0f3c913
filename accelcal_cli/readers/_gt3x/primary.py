"""The main accelerometer: records of one second of samples, packed or of 16 bits.

Source: github.com/actigraph/GT3X-File-Format, LogRecords/Activity.md and Activity2.md. Kind 27 is
packed in the order x, y, z (the vendor's pygt3x).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._gt3x.layout import ACTIVITY, ACTIVITY2, ACTIVITY3, Records
from accelcal_cli.readers._gt3x.packed import XYZ, YXZ, packed_bytes, packed_samples, unpacked
from accelcal_cli.readers._gt3x.sensor import Samples, first_rows, payloads_of

KINDS = (ACTIVITY, ACTIVITY2, ACTIVITY3)
SAMPLE_BYTES = 6
KIND_BITS = 8
DOCKED_BYTES = 1
"""A record with so short a payload says that the device was connected to a computer."""


@dataclass(frozen=True, slots=True)
class Primary:
    """The main accelerometer.

    Attributes:
        turned: the firmware exchanged the axes of packed samples (version 1.6.0 of the wGT3X-BT:
            the vendor's document says x = y of the file, y = -x of the file).
    """

    rate: int
    turned: bool = False
    fills: bool = True

    def holds(self, buffer: NDArray[np.uint8], records: Records) -> NDArray[np.bool_]:
        """Which records hold samples, (m,)."""
        return np.isin(records.kind, KINDS) & (records.size > DOCKED_BYTES)

    def decode(self, buffer: NDArray[np.uint8], records: Records) -> Samples:
        """Samples of records, those of one kind and size at once."""
        rows = samples_in(records)
        like = records.size << KIND_BITS | records.kind
        groups = [divmod(value, 1 << KIND_BITS) for value in set(like.tolist())]
        if len(groups) == 1:
            return Samples(rows, self._group(buffer, records, *groups[0]).reshape(-1, 3))
        counts, first = np.empty((int(rows.sum()), 3), np.int16), first_rows(rows)
        for size, kind in groups:
            chosen = like == (size << KIND_BITS | kind)
            values = self._group(buffer, records.select(chosen), size, kind)
            counts[first[chosen, None] + np.arange(values.shape[1])] = values
        return Samples(rows, counts)

    def whole(self, records: Records) -> NDArray[np.bool_]:
        """Which records hold as many samples as the rate says, without further bytes, (k,)."""
        rows = samples_in(records)
        bytes_of = np.where(records.kind == ACTIVITY2, SAMPLE_BYTES * rows, packed_bytes(rows))
        return np.asarray((rows == self.rate) & (records.size == bytes_of))

    def _group(self, buffer: NDArray[np.uint8], records: Records, size: int, kind: int) -> NDArray[np.int16]:
        """Samples of records of one kind and size, (k, rows, 3)."""
        data = payloads_of(buffer, records.start, size)
        if kind == ACTIVITY2:
            whole = data[:, : size // SAMPLE_BYTES * SAMPLE_BYTES]
            values = np.ascontiguousarray(whole).view("<i2").astype(np.int16, copy=False)
            return values.reshape(len(data), -1, 3)
        samples = int(packed_samples(np.array(size)))
        values = unpacked(data, samples, YXZ if kind == ACTIVITY else XYZ)
        return upright(values) if self.turned and kind == ACTIVITY else values


def samples_in(records: Records) -> NDArray[np.int64]:
    """How many samples activity records hold, (k,)."""
    return np.where(records.kind == ACTIVITY2, records.size // SAMPLE_BYTES, packed_samples(records.size))


def upright(values: NDArray[np.int16]) -> NDArray[np.int16]:
    """Samples (k, rows, 3) of 12 bits with the exchange of the axes undone."""
    return np.stack((values[:, :, 1], -values[:, :, 0], values[:, :, 2]), axis=2)
