"""Structures of Thrift's compact protocol, which the heads of Parquet's pages and its footer are.

Source: Apache Thrift, thrift-compact-protocol.md. What the fields mean is in parquet-format, parquet.thrift.
"""

from __future__ import annotations

from typing import Any

TRUE, FALSE, I8, I16, I32, I64, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12
WHOLE = (I16, I32, I64)

Struct = list[tuple[int, int, Any]]
"""Fields: identifier, type, value. A list is a pair of type and values, or just structures."""


def read(data: bytes) -> Struct:
    """The structure that begins a text of bytes."""
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
        return self._data[self._at - count : self._at]

    def _varint(self) -> int:
        value = shift = 0
        while (byte := self._byte()) & 128:
            value, shift = value | (byte & 127) << shift, shift + 7
        return value | byte << shift

    def _whole(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)


def written(fields: Struct) -> bytes:
    """The bytes of a structure."""
    data, last = bytearray(), 0
    for number, kind, value in fields:
        step = number - last
        data += bytes([step << 4 | kind]) if 0 < step < 16 else bytes([kind]) + zigzag(number)
        data += _value_written(kind, value)
        last = number
    return bytes(data) + b"\0"


def _value_written(kind: int, value: Any) -> bytes:
    if kind in (TRUE, FALSE):
        return b""
    if kind in WHOLE:
        return zigzag(value)
    if kind in (LIST, SET):
        return _list_written(value)
    if kind == STRUCT:
        return written(value)
    data: bytes = value
    return data if kind in (I8, DOUBLE) else varint(len(data)) + data


def _list_written(value: Any) -> bytes:
    kind, values = (STRUCT, value) if isinstance(value, list) else value
    head = (
        bytes([len(values) << 4 | kind])
        if len(values) < 15
        else bytes([15 << 4 | kind]) + varint(len(values))
    )
    if kind in (TRUE, FALSE):
        return head + bytes(values)
    return head + b"".join(_value_written(kind, one) for one in values)


def varint(value: int) -> bytes:
    """A whole number that is not negative, seven bits a byte (ULEB128)."""
    data = bytearray()
    while value > 127:
        data.append(value & 127 | 128)
        value >>= 7
    return bytes([*data, value])


def zigzag(value: int) -> bytes:
    """A whole number of 64 bits, those near zero in few bytes."""
    return varint(value << 1 ^ value >> 63)
