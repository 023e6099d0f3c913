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

import os
import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from accelcal_cli.core.clock import TimeSteps

# Structures in Thrift's compact protocol, such as the heads of Parquet's pages and its footer.
#
# Sources: Apache Thrift, thrift-compact-protocol.md; parquet-format, parquet.thrift, for what the
# fields mean.

TRUE, FALSE, I8, I16, I32, I64, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12
WHOLE = (I16, I32, I64)
ONE_BYTE = [bytes([value]) for value in range(128)]
WIDEST = 64
"""Most bits of a whole number."""

Struct = list[tuple[int, int, Any]]
"""Fields: identifier, type, value. A list is a pair of type and values, or a list of structures.

A structure that is to be written may also be given as its bytes.
"""


def read(data: bytes) -> Struct:
    """Read the structure at the beginning of `data`.

    Raises:
        IndexError: the structure goes beyond the end of the data.
        ValueError: a whole number has more than 64 bits.
    """
    structure: Struct = _Reader(data).value(STRUCT)
    return structure


def value_of(fields: Struct, number: int) -> Any:
    """Return the value of a field; None if it is missing."""
    return next((value for one, _, value in fields if one == number), None)


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def value(self, kind: int) -> Any:
        """Read a value with all that is in it."""
        if kind == STRUCT:
            fields, number = [], 0
            while head := self._byte():
                step, inner = head >> 4, head & 15
                number = number + step if step else self._integer()
                fields.append((number, inner, self.value(inner)))
            return fields
        if kind in (LIST, SET):
            head = self._byte()
            size, inner = head >> 4, head & 15
            values = []
            for _ in range(self._varint() if size == 15 else size):
                values.append(self._byte() if inner in (TRUE, FALSE) else self.value(inner))
            return values if inner == STRUCT else (inner, values)
        if kind in WHOLE:
            return self._integer()
        if kind in (TRUE, FALSE):
            return None
        count = {I8: 1, DOUBLE: 8}.get(kind)
        count = self._varint() if count is None else count
        self._at += count
        if self._at > len(self._data):
            raise IndexError
        return self._data[self._at - count : self._at]

    def _integer(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)

    def _varint(self) -> int:
        value = shift = 0
        while (byte := self._byte()) & 128:
            value, shift = value | (byte & 127) << shift, shift + 7
            if shift >= WIDEST:
                raise ValueError
        return value | byte << shift

    def _byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]


def written(fields: Struct) -> bytes:
    """Return the bytes of a structure."""
    data = bytearray()
    _write(data, STRUCT, fields)
    return bytes(data)


def _write(data: bytearray, kind: int, value: Any) -> None:
    """Append a value with all that is in it."""
    if kind == STRUCT and not isinstance(value, bytes):
        last = 0
        for number, inner, part in value:
            step = number - last
            data += bytes([step << 4 | inner]) if 0 < step < 16 else bytes([inner]) + zigzag(number)
            _write(data, inner, part)
            last = number
        data.append(0)
    elif kind in (LIST, SET):
        inner, values = (STRUCT, value) if isinstance(value, list) else value
        size = len(values)
        data += bytes([size << 4 | inner]) if size < 15 else bytes([15 << 4 | inner]) + varint(size)
        if inner in (TRUE, FALSE):
            data += bytes(values)
        else:
            for one in values:
                _write(data, inner, one)
    elif kind in WHOLE:
        data += zigzag(value)
    elif kind == BINARY:
        data += varint(len(value)) + value
    elif kind not in (TRUE, FALSE):
        data += value


def varint(value: int) -> bytes:
    """Encode a whole number that is not negative, seven bits a byte (ULEB128)."""
    if value < 128:
        return ONE_BYTE[value]
    data = bytearray()
    while value > 127:
        data.append(value & 127 | 128)
        value >>= 7
    data.append(value)
    return bytes(data)


def zigzag(value: int) -> bytes:
    """Encode a 64-bit whole number so that numbers near zero take few bytes."""
    return varint(value << 1 ^ value >> 63)


# The columns of a row group as Parquet pages, packed with zstd, and what the footer says of them.

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
        head = written([*fields, (PAGE_DETAILS[kind], STRUCT, details)])
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
    meta.append((13, LIST, [*map(written, stats)]))
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
    changes = numbers[1:] != numbers[:-1]
    if np.count_nonzero(changes) * LEAST_RUN < len(numbers):
        edges = np.concatenate([[0], np.flatnonzero(changes) + 1, [len(numbers)]])
        present, at = np.unique(numbers[edges[:-1]], return_inverse=True)
        if len(present) > MOST_VALUES:
            return None
        return Places((present,), np.repeat(_narrow(at, len(present)), np.diff(edges)))
    low, high = numbers.min(), numbers.max()
    span = float(high) - float(low) + 1
    if not span <= MOST_SPAN:
        return _places_of_multiples(numbers)
    if span <= MOST_UNUSED:
        present = np.asarray(low + np.arange(int(span), dtype=low.dtype))
        return Places((present,), _above(low, numbers, np.uint8 if span <= 256 else np.uint16))
    return _without_unused(low, _above(low, numbers, np.intp), int(span))


def _places_of_multiples(numbers: NDArray[Any]) -> Places | None:
    """Return the places of numbers that all have zeros in their last bits, as those of short floats have."""
    bits = int(np.bitwise_or.reduce(numbers)) if numbers.dtype.kind == "u" else 1
    zeros = (bits & -bits).bit_length() - 1
    found = places(numbers >> zeros) if zeros else None
    return found and Places((found.present[0] << zeros,), found.of_rows)


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
    head = bytes([8 * width]) + varint(groups << 1 | 1)
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
    head = varint(DELTA_BLOCK) + varint(1) + varint(len(steps))
    head += zigzag(steps.first_us)
    block = zigzag(steps.least_us) + bytes([width])
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


# Row groups of a Parquet file that are encoded apart from each other, and the footer that joins them.
#
# pyarrow encodes one row group after the other. Here any thread puts one together from its columns:
# those of `pages`, and those that pyarrow encodes as a small file in memory (`encode_by_pyarrow`).
# The groups are then written one behind the other, and the offsets in the footer are moved to where
# each lies. If pyarrow encodes all columns, the bytes are those that it writes by itself.
#
# Source of the fields: parquet-format, parquet.thrift.

TAIL_BYTES = 8
"""Length of what ends a Parquet file: the length of its footer in four bytes, and MAGIC."""

NUM_ROWS, ROW_GROUPS = 3, 4
"""Fields of FileMetaData."""

COLUMNS, GROUP_UNPACKED, GROUP_ROWS, GROUP_OFFSET, GROUP_PACKED = 1, 2, 3, 5, 6
"""Fields of RowGroup."""

CHUNK_OFFSET, META_DATA = 2, 3
"""Fields of ColumnChunk."""

PAGE_OFFSETS = (DATA_OFFSET, 10, DICTIONARY_OFFSET, 14)
"""Fields of ColumnMetaData that are offsets within the file."""


@dataclass(frozen=True, slots=True, eq=False)
class RowGroup:
    """Encoded rows: their columns in order, and their number."""

    chunks: Sequence[ColumnChunk]
    rows: int

    @property
    def parts(self) -> list[pa.Buffer | bytes]:
        """The bytes of the group."""
        return [part for chunk in self.chunks for part in chunk.parts]


class Footer:
    """The footer of a file, to which row groups are added.

    Args:
        options: those of `pyarrow.parquet.ParquetWriter`.
    """

    def __init__(self, schema: pa.Schema, **options: Any) -> None:
        sink = pa.BufferOutputStream()
        pq.ParquetWriter(sink, schema, **options).close()
        self._rows = 0
        self._file = _read_footer(sink.getvalue())
        self._groups: list[bytes] = []

    def add(self, group: RowGroup, offset: int) -> None:
        """Describe the next group, which begins at this byte of the file."""
        self._rows += group.rows
        columns, start = [], offset
        for chunk in group.chunks:
            meta = _moved(chunk.meta, start - len(MAGIC))
            columns.append([(CHUNK_OFFSET, I64, 0), (META_DATA, STRUCT, meta)])
            start += value_of(meta, PACKED)
        fields: Struct = [
            (COLUMNS, LIST, columns),
            (GROUP_UNPACKED, I64, sum(value_of(chunk.meta, UNPACKED) for chunk in group.chunks)),
            (GROUP_ROWS, I64, group.rows),
            (GROUP_OFFSET, I64, offset),
            (GROUP_PACKED, I64, start - offset),
        ]
        self._groups.append(written(fields))

    def tail(self) -> bytes:
        """Return the bytes that end the file."""
        new = {NUM_ROWS: self._rows, ROW_GROUPS: self._groups}
        data = written([(number, kind, new.get(number, value)) for number, kind, value in self._file])
        return data + struct.pack("<I", len(data)) + MAGIC


def encode_by_pyarrow(table: pa.RecordBatch, **options: Any) -> list[ColumnChunk]:
    """Return the columns of a table as pyarrow encodes them in one row group.

    Args:
        options: those of `pyarrow.parquet.ParquetWriter`.
    """
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, table.schema, **options) as writer:
        writer.write_batch(table, max(1, table.num_rows))
    file, chunks = sink.getvalue(), []
    (group,) = value_of(_read_footer(file), ROW_GROUPS)
    for column in value_of(group, COLUMNS):
        meta = value_of(column, META_DATA)
        offsets = (value_of(meta, DICTIONARY_OFFSET), value_of(meta, DATA_OFFSET))
        start = min(filter(None, offsets), default=len(MAGIC))  # without rows there are no pages
        data = file[start : start + value_of(meta, PACKED)]
        chunks.append(ColumnChunk([data], _moved(meta, len(MAGIC) - start)))
    return chunks


def row_group_offsets(path: Path, longest_footer: int) -> list[int | None]:
    """Return the bytes at which row groups begin, as far as the footer tells; pyarrow may abort if asked.

    Args:
        longest_footer: length [bytes] beyond which a footer is not read.
    """
    try:
        with path.open("rb") as file:
            file.seek(-TAIL_BYTES, os.SEEK_END)
            length = int.from_bytes(file.read(4), "little")
            if length > longest_footer:
                return []
            file.seek(-TAIL_BYTES - length, os.SEEK_END)
            footer = read(file.read(length))
        columns = [value_of(group, COLUMNS)[0] for group in value_of(footer, ROW_GROUPS)]
        metas = [value_of(column, META_DATA) for column in columns]
        offsets = [value_of(meta, DICTIONARY_OFFSET) or value_of(meta, DATA_OFFSET) for meta in metas]
    except (OSError, LookupError, TypeError, ValueError, RecursionError):
        return []
    return [offset if isinstance(offset, int) else None for offset in offsets]


def _read_footer(file: pa.Buffer) -> Struct:
    (length,) = struct.unpack("<I", file[len(file) - TAIL_BYTES : len(file) - 4].to_pybytes())
    return read(file[len(file) - TAIL_BYTES - length : len(file) - TAIL_BYTES].to_pybytes())


def _moved(meta: Struct, by: int) -> Struct:
    """Return the description of a column that lies `by` bytes further; 0 stands for no offset."""
    return [(n, k, v + by if n in PAGE_OFFSETS and v else v) for n, k, v in meta]
