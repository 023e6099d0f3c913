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
