"""A column of times as a page of Parquet's differences, where these are nearly all the same.

pyarrow packs the differences of 32 rows at a time into as few bits as they need. Those of a steady clock
take a byte each at most: here they are left as bytes, in which the codec finds what repeats.

Source: parquet-format, Encodings.md (DELTA_BINARY_PACKED: a head, then blocks of the smallest difference,
a width in bits, and how far each difference lies above the smallest; the lengths of blocks and of the
miniblocks in them are the writer's choice).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core import thrift
from accelcal_cli.core.clock import Steps
from accelcal_cli.output.column_chunks import (
    DATA_PAGE,
    DELTA_BINARY_PACKED,
    INT64,
    ColumnChunk,
    chunk_of,
    pages_of,
)

BLOCK = 1 << 13
"""Differences in a block, which is one miniblock; a multiple of 128."""


def delta_chunk(name: str, steps: Steps, level: int) -> ColumnChunk | None:
    """A column of times, of which none is missing, packed with zstd.

    Args:
        level: of zstd.

    Returns:
        None where steps differ by more than a byte holds.
    """
    if steps.above.dtype != np.uint8:
        return None
    extremes = steps.first_us, steps.last_us
    if steps.least_us < 0:
        times = steps.times()
        extremes = int(times.min()), int(times.max())
    pages = pages_of(DATA_PAGE, DELTA_BINARY_PACKED, [(_packed(steps), len(steps))], level)
    return chunk_of(name, INT64, pages, len(steps), extremes)


def _packed(steps: Steps) -> NDArray[np.uint8]:
    """The head, and blocks of one width; none where all steps are alike."""
    above, width = steps.above, 8 if steps.above.any() else 0
    blocks = -(-len(above) // BLOCK)
    head = thrift.varint(BLOCK) + thrift.varint(1) + thrift.varint(len(steps))
    head += thrift.zigzag(steps.first_us)
    block = thrift.zigzag(steps.least_us) + bytes([width])
    packed = np.zeros((blocks, len(block) + BLOCK * width // 8), np.uint8)
    packed[:, : len(block)] = list(block)
    if width:
        whole = len(above) // BLOCK
        packed[:whole, len(block) :] = above[: whole * BLOCK].reshape(whole, BLOCK)
        packed[whole:, len(block) : len(block) + len(above) - whole * BLOCK] = above[whole * BLOCK :]
    return np.concatenate([np.frombuffer(head, np.uint8), packed.reshape(-1)])
