"""Samples of three values of twelve bits, two samples in nine bytes.

Source: github.com/actigraph/GT3X-File-Format, LogRecords/Activity.md; the same in NHANES-GT3X-File-
Format, fileformats/activity.bin.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PAIR_BYTES = 9
YXZ, XYZ = (1, 0, 2), (0, 1, 2)
"""Columns of the result in which the values of a sample are, in the order of the file."""


def packed_samples(size: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many whole samples so many bytes hold, (k,)."""
    return 2 * size // PAIR_BYTES


def packed_bytes(samples: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many bytes so many samples take, the last half byte unused where they are odd, (k,)."""
    return (samples * PAIR_BYTES + 1) // 2


def unpacked(payload: NDArray[np.uint8], samples: int, order: tuple[int, int, int]) -> NDArray[np.int16]:
    """Samples of k payloads, (k, samples, 3).

    Args:
        payload: (k, bytes), rows contiguous.
    """
    pairs = -(-samples // 2)
    missing = pairs * PAIR_BYTES - payload.shape[1]
    padded = np.pad(payload, ((0, 0), (0, missing))) if missing > 0 else payload[:, : pairs * PAIR_BYTES]
    triples = padded.reshape(len(payload), pairs, 3, 3).astype(np.int16)
    values = np.empty((len(payload), pairs, 2, 3), np.int16)
    first, second, third = (triples[:, :, :, column] for column in range(3))
    even, odd = (first << 8 | second) >> 4, (second << 12 | third << 4) >> 4
    for place, value in enumerate(_in_turn(even, odd)):
        values[:, :, place // 3, order[place % 3]] = value
    return values.reshape(len(payload), 2 * pairs, 3)[:, :samples]


def _in_turn(even: NDArray[np.int16], odd: NDArray[np.int16]) -> list[NDArray[np.int16]]:
    """The six values of each pair of samples: each three bytes hold an even one and an odd one."""
    return [column for triple in range(3) for column in (even[:, :, triple], odd[:, :, triple])]
