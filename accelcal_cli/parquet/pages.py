"""The columns of a row group as Parquet pages, packed with zstd, and what the footer says of them.

pyarrow would write the same values, but slower or larger:

- `dictionary_chunk` stores whole numbers that the values follow from, such as raw counts, one or two bytes
  each, with a table of the values. pyarrow hashes every row to find the values, and packs their places into
  few bits, across the limits of bytes, in which zstd finds nothing.
- `delta_chunk` stores the differences between times as bytes, in which zstd finds what repeats. pyarrow packs
  the differences of 32 rows at a time into as few bits as they need.
- `float_chunk` stores values in single precision as they are, or their bytes side by side. pyarrow copies
  them several times on the way.

Sources: parquet-format, parquet.thrift (PageHeader, ColumnMetaData, PageEncodingStats, Statistics) and
Encodings.md (PLAIN, BYTE_STREAM_SPLIT; RLE_DICTIONARY, whose places may have any width that holds them;
DELTA_BINARY_PACKED, where the writer chooses the lengths of blocks and miniblocks).
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.clock import TimeSteps
from accelcal_cli.parquet import thrift
from accelcal_cli.parquet.thrift import BINARY, I32, I64, LIST, STRUCT, Struct

MAGIC = b"PAR1"

DATA_PAGE, DICTIONARY_PAGE = 0, 2
PAGE_DETAILS = {DATA_PAGE: 5, DICTIONARY_PAGE: 7}
"""Field of PageHeader that describes pages of each kind further."""

INT32, INT64, FLOAT = 1, 2, 4
PLAIN, RLE, DELTA_BINARY_PACKED, RLE_DICTIONARY, BYTE_STREAM_SPLIT = 0, 3, 5, 8, 9
ZSTD = 6

UNPACKED, PACKED, DATA_OFFSET, DICTIONARY_OFFSET = 6, 7, 9, 11
"""Fields of ColumnMetaData: lengths before and after compression [bytes], and where pages begin."""

LEVEL = 1
"""Compression level of zstd for all pages but those of bytes side by side."""

SPLIT_LEVEL = -1
"""Compression level of zstd for bytes side by side: it gives up sooner on those that do not compress."""

PAGE_ROWS = 1 << 16
"""Rows of a page in single precision: in up to 256 kB zstd looks for shorter repetitions (clevels.h)."""

SAMPLED, MOST_DIFFERENT = 64, 0.7
"""One row in SAMPLED is looked at; values repeat if at most this share of those is different."""

DELTA_BLOCK = 1 << 13
"""Differences in a block, which is one miniblock; a multiple of 128."""

MOST_VALUES = 1 << 16
"""Most values of a dictionary: places take two bytes."""

MOST_UNUSED = 1 << 11
"""A dictionary up to this length may hold numbers that no row has; in a longer one they are left out."""

MOST_SPAN = 1 << 20
"""Most numbers from the smallest to the largest: each is looked at."""

LEAST_RUN = 8
"""Mean length [rows] of runs of equal numbers from which runs are looked at instead of rows."""

PHYSICAL = {"float32": (FLOAT, "<f4"), "uint8": (INT32, "<i4")}
"""Parquet's type for each type of numpy, and how PLAIN stores its values."""


@dataclass(frozen=True, slots=True, eq=False)
class ColumnChunk:
    """A column of a row group.

    Attributes:
        meta: its ColumnMetaData, with offsets as in a file that holds nothing else behind MAGIC.
    """

    parts: list[pa.Buffer | bytes]
    meta: Struct


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """A compressed page.

    Attributes:
        unpacked: length with its head before compression [bytes].
    """

    kind: int
    encoding: int
    head: bytes
    packed: bytes
    unpacked: int

    def __len__(self) -> int:
        return len(self.head) + len(self.packed)


def compress_pages(
    kind: int, encoding: int, contents: Sequence[tuple[Any, int]], level: int = LEVEL
) -> list[Page]:
    """Compress pages of one kind, each given as its bytes and the number of values in them."""
    codec = pa.Codec("zstd", compression_level=level)
    levels = [(3, I32, RLE), (4, I32, RLE)] if kind == DATA_PAGE else []
    pages = []
    for data, values in contents:
        packed = codec.compress(data, asbytes=True)  # a buffer of Arrow keeps the memory of the longest
        details = [(1, I32, values), (2, I32, encoding), *levels]
        fields: Struct = [(1, I32, kind), (2, I32, len(data)), (3, I32, len(packed))]
        head = thrift.written([*fields, (PAGE_DETAILS[kind], STRUCT, details)])
        pages.append(Page(kind, encoding, head, packed, len(head) + len(data)))
    return pages


def chunk_of(
    name: str, physical: int, pages: Sequence[Page], rows: int, extremes: tuple[int, int] | None = None
) -> ColumnChunk:
    """Join pages to a column without missing values.

    Args:
        physical: Parquet's type of the values.
        pages: that of a dictionary first, if there is one.
        extremes: smallest and largest 64-bit value, by which readers skip row groups.
    """
    first_data = len(MAGIC) + sum(len(page) for page in pages if page.kind == DICTIONARY_PAGE)
    counts = Counter((page.kind, page.encoding) for page in pages)
    meta: Struct = [
        (1, I32, physical),
        (2, LIST, (I32, sorted({RLE, *(page.encoding for page in pages)}))),
        (3, LIST, (BINARY, [name.encode()])),
        (4, I32, ZSTD),
        (5, I64, rows),
        (UNPACKED, I64, sum(page.unpacked for page in pages)),
        (PACKED, I64, sum(map(len, pages))),
        (DATA_OFFSET, I64, first_data),
    ]
    if first_data > len(MAGIC):
        meta.append((DICTIONARY_OFFSET, I64, len(MAGIC)))
    if extremes is not None:
        least, most = (struct.pack("<q", value) for value in extremes)
        meta.append((12, STRUCT, [(3, I64, 0), (5, BINARY, most), (6, BINARY, least)]))
    stats = ([(1, I32, kind), (2, I32, code), (3, I32, n)] for (kind, code), n in counts.items())
    meta.append((13, LIST, [*map(thrift.written, stats)]))
    return ColumnChunk([part for page in pages for part in (page.head, page.packed)], meta)


@dataclass(frozen=True, slots=True)
class Places:
    """The places of a column's rows in a dictionary of whole numbers.

    Attributes:
        present: whole numbers that rows may have, and no others; two arrays where a row has a pair of them.
        of_rows: (n,) place of each row's number among them, in one or two bytes.
    """

    present: tuple[NDArray[Any], ...]
    of_rows: NDArray[Any]


def places(numbers: NDArray[Any]) -> Places | None:
    """Return the places of (n,) whole numbers, integers or floats; None if there are too many, or no rows."""
    if not len(numbers):
        return None
    starts = np.flatnonzero(numbers[1:] != numbers[:-1]) + 1
    if len(starts) * LEAST_RUN < len(numbers):
        edges = np.concatenate([[0], starts, [len(numbers)]])
        present, at = np.unique(numbers[edges[:-1]], return_inverse=True)
        if len(present) > MOST_VALUES:
            return None
        return Places((present,), np.repeat(_narrow(at, len(present)), np.diff(edges)))
    low, high = numbers.min(), numbers.max()
    span = float(high) - float(low) + 1
    if not span <= MOST_SPAN:
        return None
    if span <= MOST_UNUSED:
        present = np.asarray(low + np.arange(int(span), dtype=low.dtype))
        return Places((present,), _above(low, numbers, np.uint8 if span <= 256 else np.uint16))
    return _without_unused(low, _above(low, numbers, np.intp), int(span))


def paired(numbers: NDArray[Any], slow: Places) -> Places | None:
    """Return the places of pairs of each row's number and the one that it has in another column, of few.

    Returns:
        None if there would be too many.
    """
    low, high = numbers.min(), numbers.max()
    (others,) = slow.present
    span = float(high) - float(low) + 1
    if not span * len(others) <= MOST_SPAN:
        return None
    width = int(span)
    if width * len(others) < MOST_VALUES:
        of_rows = _above(low, numbers, np.uint16)
        of_rows += np.multiply(slow.of_rows, width, dtype=np.uint16)
        fast = np.asarray(low + np.arange(width, dtype=low.dtype))
        return Places((np.tile(fast, len(others)), np.repeat(others, width)), of_rows)
    above = _above(low, numbers, np.intp)
    above += np.multiply(slow.of_rows, width, dtype=np.intp)
    pairs = _without_unused(np.intp(0), above, width * len(others))
    if pairs is None:
        return None
    row, column = np.divmod(pairs.present[0], width)
    return Places((low + column.astype(low.dtype), others[row]), pairs.of_rows)


def _without_unused(low: Any, above: NDArray[np.intp], span: int) -> Places | None:
    """Return the places of numbers `low + above`, without those in between that no row has."""
    used = np.zeros(span, bool)
    used[above] = True
    present = np.flatnonzero(used)
    if len(present) > MOST_VALUES:
        return None
    rank = np.zeros(span, np.uint16)
    rank[present] = np.arange(len(present))
    return Places((low + present.astype(low.dtype),), _narrow(rank, len(present))[above])


def _narrow(of_rows: NDArray[Any], number: int) -> NDArray[Any]:
    return of_rows.astype(np.uint8 if number <= 256 else np.uint16)


def _above(low: Any, numbers: NDArray[Any], kind: type) -> NDArray[Any]:
    """Return `numbers - low` without a copy of all numbers in their own type."""
    above: NDArray[Any] = np.empty(len(numbers), kind)
    np.subtract(numbers, low, out=above, casting="unsafe")
    return above


def dictionary_chunk(name: str, of_rows: NDArray[Any], values: NDArray[Any]) -> ColumnChunk:
    """Encode a column without missing values as a dictionary and the places of its rows.

    Args:
        of_rows: (n,) place of each row's value, in one or two bytes.
        values: the dictionary, in single precision or as bytes.
    """
    physical, stored = PHYSICAL[values.dtype.name]
    table = values.astype(stored).tobytes(), len(values)
    # the width of a place in bits, and all places in one run; a run has a multiple of 8
    groups, width = -(-len(of_rows) // 8), of_rows.itemsize
    head = bytes([8 * width]) + thrift.varint(groups << 1 | 1)
    page = np.zeros(len(head) + 8 * groups * width, np.uint8)
    page[: len(head)] = list(head)
    rows = page[len(head) : len(head) + len(of_rows) * width]
    rows[:] = of_rows.astype(of_rows.dtype.newbyteorder("<"), copy=False).view(np.uint8)
    first = compress_pages(DICTIONARY_PAGE, PLAIN, [table])
    second = compress_pages(DATA_PAGE, RLE_DICTIONARY, [(page, len(of_rows))])
    return chunk_of(name, physical, first + second, len(of_rows))


def delta_chunk(name: str, steps: TimeSteps) -> ColumnChunk | None:
    """Encode a column of times without missing ones; None where steps differ by more than a byte holds."""
    if steps.above.dtype != np.uint8:
        return None
    extremes = steps.first_us, steps.last_us
    if steps.least_us < 0:
        times = steps.times()
        extremes = int(times.min()), int(times.max())
    pages = compress_pages(DATA_PAGE, DELTA_BINARY_PACKED, [(_delta_page(steps), len(steps))])
    return chunk_of(name, INT64, pages, len(steps), extremes)


def _delta_page(steps: TimeSteps) -> NDArray[np.uint8]:
    """Return the head, and blocks of one width, which is 0 where all steps are alike."""
    above, width = steps.above, 8 if steps.above.any() else 0
    blocks = -(-len(above) // DELTA_BLOCK)
    head = thrift.varint(DELTA_BLOCK) + thrift.varint(1) + thrift.varint(len(steps))
    head += thrift.zigzag(steps.first_us)
    block = thrift.zigzag(steps.least_us) + bytes([width])
    packed = np.zeros((blocks, len(block) + DELTA_BLOCK * width // 8), np.uint8)
    packed[:, : len(block)] = list(block)
    if width:
        whole = len(above) // DELTA_BLOCK
        rest = above[whole * DELTA_BLOCK :]
        packed[:whole, len(block) :] = above[: whole * DELTA_BLOCK].reshape(whole, DELTA_BLOCK)
        packed[whole:, len(block) : len(block) + len(rest)] = rest
    return np.concatenate([np.frombuffer(head, np.uint8), packed.reshape(-1)])


def float_chunk(name: str, values: NDArray[np.float32]) -> ColumnChunk:
    """Encode a column of (n,) values without missing ones: as they are if they repeat, else byte by byte."""
    # zstd finds values that repeat; of others, only the high bytes are alike
    sample = np.sort(values.view(np.uint32)[::SAMPLED])  # several times faster than np.unique
    different = 1 + np.count_nonzero(sample[1:] != sample[:-1])
    repeat = different <= MOST_DIFFERENT * len(sample)
    parts = [values[start : start + PAGE_ROWS] for start in range(0, max(1, len(values)), PAGE_ROWS)]
    contents = [(part.view(np.uint8) if repeat else _split(part), len(part)) for part in parts]
    encoding, level = (PLAIN, LEVEL) if repeat else (BYTE_STREAM_SPLIT, SPLIT_LEVEL)
    return chunk_of(name, FLOAT, compress_pages(DATA_PAGE, encoding, contents, level), len(values))


def _split(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the first bytes of all values, then the second ones, and so on."""
    bits, split = values.view(np.uint32), np.empty((4, len(values)), np.uint8)
    for place, row in enumerate(split):
        np.right_shift(bits, 8 * place, out=row, casting="unsafe")
    return split.reshape(-1)
