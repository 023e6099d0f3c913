"""Row groups of one Parquet file, encoded apart from each other and put under one footer.

pyarrow encodes a row group after the other. Here each is put together from its columns on whatever thread is
free: those that other modules make, and those that pyarrow encodes, as a small file in memory. The groups
are then written one behind the other, and the places that the footer of each names are moved to where it
lies. Where pyarrow encodes all columns the bytes are those that it writes by itself.

Source of the fields: parquet-format, parquet.thrift.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli.core import thrift
from accelcal_cli.core.thrift import (
    COLUMNS,
    DATA_OFFSET,
    DICTIONARY_OFFSET,
    I64,
    LIST,
    META_DATA,
    ROW_GROUPS,
    STRUCT,
    TAIL_BYTES,
    Struct,
    value_of,
)
from accelcal_cli.output.column_chunks import MAGIC, PACKED, UNPACKED, ColumnChunk

NUM_ROWS = 3
"""Of FileMetaData."""

GROUP_UNPACKED, GROUP_ROWS, GROUP_OFFSET, GROUP_PACKED = 2, 3, 5, 6
CHUNK_OFFSET = 2
PAGE_OFFSETS = (DATA_OFFSET, 10, DICTIONARY_OFFSET, 14)
"""Of a RowGroup, a ColumnChunk, its ColumnMetaData: what is there, and all that says where something is."""


@dataclass(frozen=True, slots=True, eq=False)
class RowGroup:
    """So many rows, as the columns that hold them, in order."""

    chunks: Sequence[ColumnChunk]
    rows: int

    @property
    def parts(self) -> list[pa.Buffer | bytes]:
        """Its bytes."""
        return [part for chunk in self.chunks for part in chunk.parts]

    def fields(self, at: int) -> Struct:
        """What the footer says of it where it begins at a byte of the file."""
        columns, start = [], at
        for chunk in self.chunks:
            meta = _moved(chunk.meta, start - len(MAGIC))
            columns.append([(CHUNK_OFFSET, I64, 0), (META_DATA, STRUCT, meta)])
            start += value_of(meta, PACKED)
        return [
            (COLUMNS, LIST, columns),
            (GROUP_UNPACKED, I64, sum(value_of(chunk.meta, UNPACKED) for chunk in self.chunks)),
            (GROUP_ROWS, I64, self.rows),
            (GROUP_OFFSET, I64, at),
            (GROUP_PACKED, I64, start - at),
        ]


def by_pyarrow(table: pa.RecordBatch, **options: Any) -> list[ColumnChunk]:
    """The columns of a table as pyarrow encodes them in one row group.

    Args:
        options: of `pyarrow.parquet.ParquetWriter`.
    """
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, table.schema, **options) as writer:
        writer.write_batch(table, max(1, table.num_rows))
    whole = sink.getvalue()
    (group,) = value_of(_footer(whole), ROW_GROUPS)
    return [_lifted(whole, value_of(column, META_DATA)) for column in value_of(group, COLUMNS)]


def _lifted(whole: pa.Buffer, meta: Struct) -> ColumnChunk:
    """A column out of a file."""
    places = (value_of(meta, DICTIONARY_OFFSET), value_of(meta, DATA_OFFSET))
    start = min((place for place in places if place), default=len(MAGIC))  # without rows there are no pages
    bytes_of_it = whole[start : start + value_of(meta, PACKED)]
    return ColumnChunk([bytes_of_it], _moved(meta, len(MAGIC) - start))


def _footer(whole: pa.Buffer) -> Struct:
    """What the footer of a file says."""
    (length,) = struct.unpack("<I", whole[len(whole) - TAIL_BYTES : len(whole) - 4].to_pybytes())
    return thrift.read(whole[len(whole) - TAIL_BYTES - length : len(whole) - TAIL_BYTES].to_pybytes())


class Footer:
    """The footer of a file, group by group.

    Args:
        options: of `pyarrow.parquet.ParquetWriter`.
    """

    def __init__(self, schema: pa.Schema, **options: Any) -> None:
        sink = pa.BufferOutputStream()
        pq.ParquetWriter(sink, schema, **options).close()
        self.rows = 0
        self._file = _footer(sink.getvalue())
        self._groups: list[bytes] = []

    def add(self, group: RowGroup, at: int) -> None:
        """Take in the next group, which begins at a byte of the file."""
        self.rows += group.rows
        self._groups.append(thrift.written(group.fields(at)))

    def tail(self) -> bytes:
        """What ends the file."""
        new = {NUM_ROWS: self.rows, ROW_GROUPS: self._groups}
        data = thrift.written([(number, kind, new.get(number, value)) for number, kind, value in self._file])
        return data + struct.pack("<I", len(data)) + MAGIC


def _moved(meta: Struct, by: int) -> Struct:
    """A column that lies so many bytes further; 0 stands for no place."""
    return [(n, k, v + by if n in PAGE_OFFSETS and v else v) for n, k, v in meta]
