"""Structures in Thrift's compact protocol, such as the heads of Parquet's pages and its footer.

Sources: Apache Thrift, thrift-compact-protocol.md; parquet-format, parquet.thrift, for what the fields mean.
"""

from __future__ import annotations

from typing import Any

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
    return _Reader(data).struct()


def value_of(fields: Struct, number: int) -> Any:
    """Return the value of a field; None if it is missing."""
    return next((value for one, _, value in fields if one == number), None)


class _Reader:
    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def struct(self) -> Struct:
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
    """Return the bytes of a structure."""
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
