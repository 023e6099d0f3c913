"""Row groups of one Parquet file, encoded apart from each other and put under one footer.

pyarrow encodes a row group after the other. Here each is encoded by itself, as a small file in memory, on
whatever thread is free; the groups are then written one behind the other, and the places that the footer of
each names are moved to where it lies. The bytes are those that pyarrow writes by itself.

The footer is a Thrift structure in the compact protocol (Apache Thrift, thrift-compact-protocol.md;
parquet-format, parquet.thrift): `_Reader` and `_written` know the protocol, and only `shifted` what it means.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

MAGIC = b"PAR1"
TAIL_BYTES = 8
"""Length of the footer, and the magic number again."""

TRUE, FALSE, I8, I16, I32, I64, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12
WHOLE = (I16, I32, I64)

Struct = list[tuple[int, int, Any]]
"""Fields: identifier, type, value."""

NUM_ROWS, ROW_GROUPS = 3, 4
"""Fields of FileMetaData."""

COLUMNS, GROUP_OFFSET, ORDINAL = 1, 5, 7
CHUNK_OFFSET, META_DATA = 2, 3
PAGE_OFFSETS = (9, 10, 11, 14)
"""Of a RowGroup, a ColumnChunk, and its ColumnMetaData: all that says where something lies."""


@dataclass(frozen=True, slots=True)
class EncodedGroup:
    """A row group as bytes, and what the footer of a file with nothing else says."""

    body: pa.Buffer
    rows: int
    footer: Struct


def encoded(table: pa.RecordBatch, **options: Any) -> EncodedGroup:
    """Encode one row group.

    Args:
        options: of `pyarrow.parquet.ParquetWriter`.
    """
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, table.schema, **options) as writer:
        writer.write_batch(table, max(1, table.num_rows))
    whole = sink.getvalue()
    (length,) = struct.unpack("<I", whole[len(whole) - TAIL_BYTES : len(whole) - 4].to_pybytes())
    end = len(whole) - TAIL_BYTES - length
    footer = _Reader(whole[end : len(whole) - TAIL_BYTES].to_pybytes()).struct()
    return EncodedGroup(whole[len(MAGIC) : end], table.num_rows, footer)


class Footer:
    """The footer of a file, group by group."""

    def __init__(self) -> None:
        self.rows = 0
        self._first: Struct | None = None
        self._groups: list[Struct] = []

    def add(self, group: EncodedGroup, at: int) -> None:
        """Take in the next group, whose body begins at a byte of the file."""
        self._first = self._first or group.footer
        self.rows += group.rows
        for one in value_of(group.footer, ROW_GROUPS):
            self._groups.append(shifted(one, at - len(MAGIC), len(self._groups)))

    def tail(self) -> bytes:
        """What ends the file."""
        assert self._first is not None
        new = {NUM_ROWS: self.rows, ROW_GROUPS: self._groups}
        data = _written([(number, kind, new.get(number, value)) for number, kind, value in self._first])
        return data + struct.pack("<I", len(data)) + MAGIC


def value_of(fields: Struct, number: int) -> Any:
    """The value of a field; None where it is not there."""
    return next((value for one, _, value in fields if one == number), None)


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


class _Reader:
    """Reads a structure from its bytes."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def struct(self) -> Struct:
        """The fields up to the end of a structure."""
        fields, number = [], 0
        while head := self._byte():
            step, kind = head >> 4, head & 15
            number = number + step if step else self._whole()
            fields.append((number, kind, self._value(kind)))
        return fields

    def _value(self, kind: int) -> Any:
        if kind in (TRUE, FALSE):
            return None
        if kind in WHOLE:
            return self._whole()
        if kind in (LIST, SET):
            return self._list()
        if kind == STRUCT:
            return self.struct()
        size = {I8: 1, DOUBLE: 8}.get(kind)
        return self._bytes(self._varint() if size is None else size)

    def _list(self) -> Any:
        head = self._byte()
        size, kind = head >> 4, head & 15
        size = self._varint() if size == 15 else size
        if kind == STRUCT:
            return [self.struct() for _ in range(size)]
        values = [self._byte() if kind in (TRUE, FALSE) else self._value(kind) for _ in range(size)]
        return (kind, values)

    def _byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]

    def _bytes(self, count: int) -> bytes:
        self._at += count
        return self._data[self._at - count : self._at]

    def _varint(self) -> int:
        value = shift = 0
        while (byte := self._byte()) & 128:
            value, shift = value | (byte & 127) << shift, shift + 7
        return value | byte << shift

    def _whole(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)


def _written(fields: Struct) -> bytes:
    """The bytes of a structure."""
    data, last = bytearray(), 0
    for number, kind, value in fields:
        step = number - last
        data += bytes([step << 4 | kind]) if 0 < step < 16 else bytes([kind]) + _zigzag(number)
        data += _value_written(kind, value)
        last = number
    return bytes(data) + b"\0"


def _value_written(kind: int, value: Any) -> bytes:
    if kind in (TRUE, FALSE):
        return b""
    if kind in WHOLE:
        return _zigzag(value)
    if kind in (LIST, SET):
        return _list_written(value)
    if kind == STRUCT:
        return _written(value)
    data: bytes = value
    return data if kind in (I8, DOUBLE) else _varint(len(data)) + data


def _list_written(value: Any) -> bytes:
    kind, values = (STRUCT, value) if isinstance(value, list) else value
    head = (
        bytes([len(values) << 4 | kind])
        if len(values) < 15
        else bytes([15 << 4 | kind]) + _varint(len(values))
    )
    if kind in (TRUE, FALSE):
        return head + bytes(values)
    return head + b"".join(_value_written(kind, one) for one in values)


def _varint(value: int) -> bytes:
    data = bytearray()
    while value > 127:
        data.append(value & 127 | 128)
        value >>= 7
    return bytes([*data, value])


def _zigzag(value: int) -> bytes:
    return _varint(value << 1 ^ value >> 63)
