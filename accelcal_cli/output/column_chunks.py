"""A column of a row group as bytes: pages packed with zstd, and what the footer says of them.

Source: parquet-format, parquet.thrift (PageHeader, ColumnMetaData, PageEncodingStats, Statistics).
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from accelcal_cli.core import thrift
from accelcal_cli.core.thrift import (
    BINARY,
    DATA_OFFSET,
    DICTIONARY_OFFSET,
    I32,
    I64,
    LIST,
    STRUCT,
    Struct,
)

MAGIC = b"PAR1"

DATA_PAGE, DICTIONARY_PAGE = 0, 2
ABOUT_PAGE = {DATA_PAGE: 5, DICTIONARY_PAGE: 7}
"""Field of PageHeader that says more about pages of a kind."""

INT32, INT64, FLOAT = 1, 2, 4
PLAIN, RLE, DELTA_BINARY_PACKED, RLE_DICTIONARY, BYTE_STREAM_SPLIT = 0, 3, 5, 8, 9
ZSTD = 6

UNPACKED, PACKED = 6, 7
"""Of ColumnMetaData: how long a column is."""


@dataclass(frozen=True, slots=True, eq=False)
class ColumnChunk:
    """A column of a row group.

    Attributes:
        meta: its ColumnMetaData, as in a file with nothing else: its parts begin behind MAGIC.
    """

    parts: list[pa.Buffer | bytes]
    meta: Struct


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """A page, packed.

    Attributes:
        unpacked: how long it is with its head, before it is packed.
    """

    kind: int
    encoding: int
    head: bytes
    packed: bytes
    unpacked: int

    def __len__(self) -> int:
        return len(self.head) + len(self.packed)


def pages_of(kind: int, encoding: int, data: Sequence[tuple[Any, int]], level: int) -> list[Page]:
    """Pages of a kind, of bytes and the number of values that they hold.

    Args:
        level: of zstd.
    """
    codec = pa.Codec("zstd", compression_level=level)
    levels = [(3, I32, RLE), (4, I32, RLE)] if kind == DATA_PAGE else []
    pages = []
    for held, values in data:
        packed = codec.compress(held, asbytes=True)  # a buffer of Arrow keeps the memory of the longest
        about = [(1, I32, values), (2, I32, encoding), *levels]
        fields: Struct = [(1, I32, kind), (2, I32, len(held)), (3, I32, len(packed))]
        head = thrift.written([*fields, (ABOUT_PAGE[kind], STRUCT, about)])
        pages.append(Page(kind, encoding, head, packed, len(head) + len(held)))
    return pages


def chunk_of(
    name: str, physical: int, pages: Sequence[Page], rows: int, extremes: tuple[int, int] | None = None
) -> ColumnChunk:
    """The column that pages make, without missing values.

    Args:
        physical: Parquet's type of the values.
        pages: that of a dictionary first, if there is one.
        extremes: the smallest and the largest value of 64 bits, for readers that leave row groups out.
    """
    begins = len(MAGIC) + sum(len(page) for page in pages if page.kind == DICTIONARY_PAGE)
    counts = Counter((page.kind, page.encoding) for page in pages)
    meta: Struct = [
        (1, I32, physical),
        (2, LIST, (I32, sorted({RLE, *(page.encoding for page in pages)}))),
        (3, LIST, (BINARY, [name.encode()])),
        (4, I32, ZSTD),
        (5, I64, rows),
        (UNPACKED, I64, sum(page.unpacked for page in pages)),
        (PACKED, I64, sum(map(len, pages))),
        (DATA_OFFSET, I64, begins),
    ]
    if begins > len(MAGIC):
        meta.append((DICTIONARY_OFFSET, I64, len(MAGIC)))
    if extremes is not None:
        least, most = (struct.pack("<q", value) for value in extremes)
        meta.append((12, STRUCT, [(3, I64, 0), (5, BINARY, most), (6, BINARY, least)]))
    of_kinds = [[(1, I32, kind), (2, I32, code), (3, I32, n)] for (kind, code), n in counts.items()]
    meta.append((13, LIST, of_kinds))
    return ColumnChunk([part for page in pages for part in (page.head, page.packed)], meta)
