"""Row groups of a Parquet file that are encoded apart from each other, and the footer that joins them.

pyarrow encodes one row group after the other. Here any thread puts one together from its columns: those of
`pages`, and those that pyarrow encodes as a small file in memory (`encode_by_pyarrow`). The groups are then
written one behind the other, and the offsets in the footer are moved to where each lies. If pyarrow encodes
all columns, the bytes are those that it writes by itself.

Source of the fields: parquet-format, parquet.thrift.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli.parquet import thrift
from accelcal_cli.parquet.pages import DATA_OFFSET, DICTIONARY_OFFSET, MAGIC, PACKED, UNPACKED, ColumnChunk
from accelcal_cli.parquet.thrift import I64, LIST, STRUCT, Struct, value_of

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
        self._groups.append(thrift.written(fields))

    def tail(self) -> bytes:
        """Return the bytes that end the file."""
        new = {NUM_ROWS: self._rows, ROW_GROUPS: self._groups}
        data = thrift.written([(number, kind, new.get(number, value)) for number, kind, value in self._file])
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
            footer = thrift.read(file.read(length))
        columns = [value_of(group, COLUMNS)[0] for group in value_of(footer, ROW_GROUPS)]
        metas = [value_of(column, META_DATA) for column in columns]
        offsets = [value_of(meta, DICTIONARY_OFFSET) or value_of(meta, DATA_OFFSET) for meta in metas]
    except (OSError, LookupError, TypeError, ValueError, RecursionError):
        return []
    return [offset if isinstance(offset, int) else None for offset in offsets]


def _read_footer(file: pa.Buffer) -> Struct:
    (length,) = struct.unpack("<I", file[len(file) - TAIL_BYTES : len(file) - 4].to_pybytes())
    return thrift.read(file[len(file) - TAIL_BYTES - length : len(file) - TAIL_BYTES].to_pybytes())


def _moved(meta: Struct, by: int) -> Struct:
    """Return the description of a column that lies `by` bytes further; 0 stands for no offset."""
    return [(n, k, v + by if n in PAGE_OFFSETS and v else v) for n, k, v in meta]
