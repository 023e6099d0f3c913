"""A column of times as a page of Parquet's differences, where these are nearly all the same.

pyarrow packs the differences of 32 rows at a time into as few bits as they need. Those of a steady clock
take a byte each at most: here they are left as bytes, in which the codec finds what repeats.

Source: parquet-format, Encodings.md (DELTA_BINARY_PACKED: a head, then blocks of the smallest difference,
a width in bits, and how far each difference lies above the smallest; the lengths of blocks and of the
miniblocks in them are the writer's choice) and parquet.thrift (Statistics, ColumnMetaData).
"""

from __future__ import annotations

import struct

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.output import thrift
from accelcal_cli.output.dictionary_pages import DATA_PAGE, RLE, ZSTD, page, page_counts
from accelcal_cli.output.row_groups import MAGIC, PACKED, UNPACKED, ColumnChunk
from accelcal_cli.output.thrift import BINARY, I32, I64, LIST, STRUCT, Struct

DELTA_BINARY_PACKED = 5
INT64 = 2

BLOCK = 1 << 13
"""Differences in a block, which is one miniblock; a multiple of 128."""

CACHED = 1 << 14
"""Differences are looked at so many at a time, which the processor's cache holds."""


def delta_chunk(name: str, values: NDArray[np.int64], level: int) -> ColumnChunk | None:
    """A column of (n,) values, of which none is missing, packed with zstd.

    Args:
        level: of zstd.

    Returns:
        None where there is nothing, or differences differ by more than a byte holds.
    """
    found = _differences(values)
    if found is None:
        return None
    least, above = found
    low, high = (values[0], values[-1]) if least >= 0 else (values.min(), values.max())
    codec = pa.Codec("zstd", compression_level=level)
    about: Struct = [(1, I32, len(values)), (2, I32, DELTA_BINARY_PACKED), (3, I32, RLE), (4, I32, RLE)]
    parts, unpacked = page(codec, _packed(values, least, above), DATA_PAGE, 5, about)
    least_value, most = (struct.pack("<q", int(value)) for value in (low, high))
    meta: Struct = [
        (1, I32, INT64),
        (2, LIST, (I32, [RLE, DELTA_BINARY_PACKED])),
        (3, LIST, (BINARY, [name.encode()])),
        (4, I32, ZSTD),
        (5, I64, len(values)),
        (UNPACKED, I64, unpacked),
        (PACKED, I64, sum(map(len, parts))),
        (9, I64, len(MAGIC)),
        (12, STRUCT, [(3, I64, 0), (5, BINARY, most), (6, BINARY, least_value)]),
        (13, LIST, [page_counts(DATA_PAGE, DELTA_BINARY_PACKED)]),
    ]
    return ColumnChunk(parts, meta)


def _differences(values: NDArray[np.int64]) -> tuple[int, NDArray[np.uint8] | None] | None:
    """The smallest difference, and how far each one lies above it; None where that is nothing."""
    if not len(values):
        return None
    ends = [(start, min(start + CACHED, len(values) - 1)) for start in range(0, len(values) - 1, CACHED)]
    bounds = [_bounds(np.diff(values[start : stop + 1])) for start, stop in ends]
    least, most = min((low for low, _ in bounds), default=0), max((high for _, high in bounds), default=0)
    if most == least:
        return least, None
    if most - least > np.iinfo(np.uint8).max:
        return None
    above = np.empty(len(values) - 1, np.uint8)
    for start, stop in ends:
        np.subtract(np.diff(values[start : stop + 1]), least, out=above[start:stop], casting="unsafe")
    return least, above


def _bounds(differences: NDArray[np.int64]) -> tuple[int, int]:
    return int(differences.min()), int(differences.max())


def _packed(values: NDArray[np.int64], least: int, above: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    """The head, and blocks of one width."""
    blocks, width = -(-(len(values) - 1) // BLOCK), 0 if above is None else 8
    head = thrift.varint(BLOCK) + thrift.varint(1) + thrift.varint(len(values))
    head += thrift.zigzag(int(values[0]))
    block = thrift.zigzag(least) + bytes([width])
    packed = np.zeros((blocks, len(block) + BLOCK * width // 8), np.uint8)
    packed[:, : len(block)] = list(block)
    if above is not None:
        whole = len(above) // BLOCK
        packed[:whole, len(block) :] = above[: whole * BLOCK].reshape(whole, BLOCK)
        packed[whole:, len(block) : len(block) + len(above) - whole * BLOCK] = above[whole * BLOCK :]
    return np.concatenate([np.frombuffer(head, np.uint8), packed.reshape(-1)])
