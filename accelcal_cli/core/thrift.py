"""Structures of Thrift's compact protocol, which the heads of Parquet's pages and its footer are.

Sources: Apache Thrift, thrift-compact-protocol.md; parquet-format, parquet.thrift, for what the fields mean.
"""

from __future__ import annotations

from typing import Any

TRUE, FALSE, I8, I16, I32, I64, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12
WHOLE = (I16, I32, I64)
ONE_BYTE = [bytes([value]) for value in range(128)]
WIDEST = 64
"""Bits of a whole number."""

TAIL_BYTES = 8
"""What ends a Parquet file: the length of its footer in four bytes, and the magic number again."""

ROW_GROUPS, COLUMNS, META_DATA, DATA_OFFSET, DICTIONARY_OFFSET = 4, 1, 3, 9, 11
"""Fields of the footer, of a row group, of a column and, twice, of its ColumnMetaData."""

Struct = list[tuple[int, int, Any]]
"""Fields: identifier, type, value. A list is a pair of type and values, or just structures.

To be written, a structure may be its bytes.
"""


def read(data: bytes) -> Struct:
    """The structure that begins a text of bytes.

    Raises:
        IndexError: it does not end before they do.
        ValueError: a whole number has more than 64 bits.
    """
    return _Reader(data).struct()


def value_of(fields: Struct, number: int) -> Any:
    """The value of a field; None where it is not there."""
    return next((value for one, _, value in fields if one == number), None)


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
        if self._at > len(self._data):
            raise IndexError
        return self._data[self._at - count : self._at]

    def _varint(self) -> int:
        value = shift = 0
        while (byte := self._byte()) & 128:
            value, shift = value | (byte & 127) << shift, shift + 7
            if shift >= WIDEST:
                raise ValueError
        return value | byte << shift

    def _whole(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)


def written(fields: Struct) -> bytes:
    """The bytes of a structure."""
    data = bytearray()
    _write_struct(data, fields)
    return bytes(data)


def _write_struct(data: bytearray, fields: Struct | bytes) -> None:
    if isinstance(fields, bytes):
        data += fields
        return
    last = 0
    for number, kind, value in fields:
        step = number - last
        if 0 < step < 16:
            data.append(step << 4 | kind)
        else:
            data.append(kind)
            data += zigzag(number)
        _write_value(data, kind, value)
        last = number
    data.append(0)


def _write_value(data: bytearray, kind: int, value: Any) -> None:
    if kind in WHOLE:
        data += zigzag(value)
    elif kind == STRUCT:
        _write_struct(data, value)
    elif kind in (LIST, SET):
        _write_list(data, value)
    elif kind == BINARY:
        data += varint(len(value)) + value
    elif kind not in (TRUE, FALSE):
        data += value


def _write_list(data: bytearray, value: Any) -> None:
    kind, values = (STRUCT, value) if isinstance(value, list) else value
    if len(values) < 15:
        data.append(len(values) << 4 | kind)
    else:
        data.append(15 << 4 | kind)
        data += varint(len(values))
    if kind in (TRUE, FALSE):
        data += bytes(values)
        return
    for one in values:
        _write_value(data, kind, one)


def varint(value: int) -> bytes:
    """A whole number that is not negative, seven bits a byte (ULEB128)."""
    if value < 128:
        return ONE_BYTE[value]
    data = bytearray()
    while value > 127:
        data.append(value & 127 | 128)
        value >>= 7
    data.append(value)
    return bytes(data)


def zigzag(value: int) -> bytes:
    """A whole number of 64 bits, those near zero in few bytes."""
    return varint(value << 1 ^ value >> 63)
