"""Row groups of one Parquet file, encoded apart from each other and put under one footer.

pyarrow encodes a row group after the other. Here each is encoded by itself, as a small file in memory, on
whatever thread is free; columns that are made elsewhere come behind it. The groups are then written one
behind the other, and the places that the footer of each names are moved to where it lies. Without columns
from elsewhere the bytes are those that pyarrow writes by itself.

Source of the fields: parquet-format, parquet.thrift.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from accelcal_cli.output import thrift
from accelcal_cli.output.thrift import I64, STRUCT, Struct, value_of

MAGIC = b"PAR1"
TAIL_BYTES = 8
"""Length of the footer, and the magic number again."""

NUM_ROWS, ROW_GROUPS = 3, 4
"""Fields of FileMetaData."""

COLUMNS, GROUP_UNPACKED, GROUP_ROWS, GROUP_OFFSET, GROUP_PACKED, ORDINAL = 1, 2, 3, 5, 6, 7
CHUNK_OFFSET, META_DATA = 2, 3
UNPACKED, PACKED = 6, 7
PAGE_OFFSETS = (9, 10, 11, 14)
"""Of a RowGroup, a ColumnChunk, its ColumnMetaData: how long it is, and all that says where something is."""


@dataclass(frozen=True, slots=True)
class ColumnChunk:
    """A column of a row group as bytes.

    Attributes:
        meta: its ColumnMetaData, as in a file with nothing else: its parts begin behind MAGIC.
    """

    parts: list[pa.Buffer | bytes]
    meta: Struct


@dataclass(frozen=True, slots=True)
class EncodedGroup:
    """A row group as bytes, and what the footer of a file with nothing else says of it."""

    parts: list[pa.Buffer | bytes]
    rows: int
    fields: Struct


def encoded(
    table: pa.RecordBatch, rows: int, made: Mapping[int, ColumnChunk], **options: Any
) -> EncodedGroup:
    """Encode one row group.

    Args:
        table: its columns but those that are made; perhaps none.
        made: the others, by their place among all.
        options: of `pyarrow.parquet.ParquetWriter`.
    """
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, table.schema, **options) as writer:
        writer.write_batch(table, max(1, table.num_rows))
    whole = sink.getvalue()
    end, footer = _footer(whole)
    (group,) = value_of(footer, ROW_GROUPS)
    fields: Struct = [(n, k, rows if n == GROUP_ROWS else v) for n, k, v in group]
    parts, at = [whole[len(MAGIC) : end]], end
    for place, chunk in sorted(made.items()):
        fields = _with(fields, place, _moved(chunk.meta, PAGE_OFFSETS, at - len(MAGIC)))
        parts += chunk.parts
        at += sum(map(len, chunk.parts))
    return EncodedGroup(parts, rows, fields)


def _footer(whole: pa.Buffer) -> tuple[int, Struct]:
    """Where the footer of a file begins, and what it says."""
    (length,) = struct.unpack("<I", whole[len(whole) - TAIL_BYTES : len(whole) - 4].to_pybytes())
    end = len(whole) - TAIL_BYTES - length
    return end, thrift.read(whole[end : len(whole) - TAIL_BYTES].to_pybytes())


def _with(group: Struct, place: int, meta: Struct) -> Struct:
    """A row group with one more column."""
    columns = list(value_of(group, COLUMNS))
    columns.insert(place, [(CHUNK_OFFSET, I64, 0), (META_DATA, STRUCT, meta)])
    more = {GROUP_UNPACKED: value_of(meta, UNPACKED), GROUP_PACKED: value_of(meta, PACKED)}
    return [(n, k, columns if n == COLUMNS else v + more.get(n, 0)) for n, k, v in group]


class Footer:
    """The footer of a file, group by group.

    Args:
        options: of `pyarrow.parquet.ParquetWriter`.
    """

    def __init__(self, schema: pa.Schema, **options: Any) -> None:
        sink = pa.BufferOutputStream()
        pq.ParquetWriter(sink, schema, **options).close()
        self.rows = 0
        self._file = _footer(sink.getvalue())[1]
        self._groups: list[Struct] = []

    def add(self, group: EncodedGroup, at: int) -> None:
        """Take in the next group, whose first part begins at a byte of the file."""
        self.rows += group.rows
        self._groups.append(shifted(group.fields, at - len(MAGIC), len(self._groups)))

    def tail(self) -> bytes:
        """What ends the file."""
        new = {NUM_ROWS: self.rows, ROW_GROUPS: self._groups}
        data = thrift.written([(number, kind, new.get(number, value)) for number, kind, value in self._file])
        return data + struct.pack("<I", len(data)) + MAGIC


def shifted(group: Struct, by: int, ordinal: int) -> Struct:
    """A row group that lies so many bytes further, and is this one of its file."""

    def chunk(fields: Struct) -> Struct:
        moved = _moved(fields, (CHUNK_OFFSET,), by)
        return [(n, k, _moved(v, PAGE_OFFSETS, by) if n == META_DATA else v) for n, k, v in moved]

    fields = _moved(group, (GROUP_OFFSET,), by)
    fields = [(n, k, [chunk(one) for one in v] if n == COLUMNS else v) for n, k, v in fields]
    return [(n, k, ordinal if n == ORDINAL else v) for n, k, v in fields]


def _moved(fields: Struct, numbers: tuple[int, ...], by: int) -> Struct:
    """Places moved; 0 stands for none."""
    return [(n, k, v + by if n in numbers and v else v) for n, k, v in fields]
