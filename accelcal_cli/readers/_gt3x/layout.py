"""What a record of log.bin looks like.

Eight bytes of header (separator 0x1E, kind, seconds since 1970, size of the payload, little-endian),
the payload, and one byte that makes the exclusive or over the whole record 0xFF. Source:
github.com/actigraph/GT3X-File-Format, README.md, "Log Record Format"; kinds 27 to 30 are named in
the vendor's pygt3x.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SEPARATOR = 0x1E
HEADER_BYTES = 8
FRAME_BYTES = HEADER_BYTES + 1
"""Header and checksum: the shortest record."""

LONGEST_BYTES = FRAME_BYTES + 0xFFFF
SOUND = 0xFF

ACTIVITY, BATTERY, EVENT, METADATA = 0, 2, 3, 6
PARAMETERS, SENSOR_SCHEMA, SENSOR_DATA = 21, 24, 25
ACTIVITY2, ACTIVITY3 = 26, 27

_FIXED = {
    ACTIVITY: (1, 1152),
    BATTERY: (2, 2),
    EVENT: (1, 16),
    4: (1, 1),
    5: (2, 2),
    7: (15, 15),
    13: (6, 6),
    ACTIVITY2: (1, 1536),
    ACTIVITY3: (1, 1152),
}
"""Sizes of payloads that tell a record from other bytes: samples up to 256 Hz, and fixed ones."""

_LOOSE = {METADATA: 4096, 17: 4096, 18: 4096, 20: 4096, PARAMETERS: 4096, 22: 4096, 23: 4096} | {
    SENSOR_SCHEMA: 4096,
    SENSOR_DATA: 4096,
}
_KINDS = 31
_SHORT = 255
LONGEST_BELIEVED = FRAME_BYTES + 4096


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """Records of a buffer in file order, (k,) each.

    Attributes:
        start: int64, where each begins in the buffer.
        kind: uint8.
        second: int64, seconds since 1970 on the device's clock.
        size: int64, bytes of payload.
    """

    start: NDArray[np.int64]
    kind: NDArray[np.uint8]
    second: NDArray[np.int64]
    size: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.start)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Records:
        """Some of them, by a mask or by numbers."""
        return Records(self.start[which], self.kind[which], self.second[which], self.size[which])

    def framed_bytes(self) -> int:
        """Bytes of all of them."""
        return int(self.size.sum()) + FRAME_BYTES * len(self)


def records_at(buffer: NDArray[np.uint8], start: NDArray[np.int64]) -> Records:
    """Headers of records that begin at `start` (k,); their eight bytes must lie in the buffer."""
    header = buffer[start[:, None] + np.arange(HEADER_BYTES)]
    second = np.ascontiguousarray(header[:, 2:6]).view("<u4")[:, 0].astype(np.int64)
    size = np.ascontiguousarray(header[:, 6:8]).view("<u2")[:, 0].astype(np.int64)
    return Records(start, header[:, 1], second, size)


def _limits() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    low, high = np.zeros(256, np.int64), np.full(256, -1, np.int64)
    high[:_KINDS] = _SHORT
    fixed = np.zeros(256, np.bool_)
    for kind, longest in _LOOSE.items():
        high[kind] = longest
    for kind, (shortest, longest) in _FIXED.items():
        low[kind], high[kind], fixed[kind] = shortest, longest, True
    return low, high, fixed


_LOW, _HIGH, _IS_FIXED = _limits()


def fits(records: Records) -> NDArray[np.bool_]:
    """Whether kind and size go together, (k,)."""
    return np.asarray((records.size >= _LOW[records.kind]) & (records.size <= _HIGH[records.kind]))


def telling(records: Records) -> NDArray[np.bool_]:
    """Whether the kind is one whose size tells it from other bytes, (k,)."""
    return _IS_FIXED[records.kind]
