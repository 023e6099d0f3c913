"""The first record of an Avro object container file, by the schema that the file carries.

As in the Apache Avro specification 1.11: a header with schema, codec and marker; blocks of records, each
followed by the marker; numbers as zigzag varints. Arrays of numbers become numpy arrays, all else plain
Python. Nothing that a file claims makes more memory than a few times LARGEST_BYTES.
"""

from __future__ import annotations

import bz2
import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.formats._bytes import ByteSource

LARGEST_BYTES = 1 << 26
"""Of a file, and of a block when it is unpacked: half an hour of all sensors has 5 MB."""

DEEPEST = 32
MOST_ITEMS = 100_000
"""Of arrays and maps of anything but numbers: events, a few a second."""

MOST_VALUES = 1_000_000
"""Decoded one by one: a schema may claim many that take no bytes."""

VARINT_BYTES = 10
PIECE = 1 << 16
MARKER_BYTES = 16
MAGIC_BYTES = 4
AGAIN = "download it again"
NUMBERS = {"float": "<f4", "double": "<f8"}
WHOLE = ("int", "long")
HEADER = {"type": "map", "values": "bytes"}
PRIMITIVES = ("null", "boolean", "bytes", "string", *WHOLE, *NUMBERS)


class DamageError(Exception):
    """What cannot be decoded, in plain words."""


@dataclass(frozen=True, slots=True)
class FirstRecord:
    """The first record of a file.

    Attributes:
        fields: what it holds.
        begin, end: where its block lies in the (uncompressed) file.
        marked: whether the marker behind its block is right.
        more: records beyond the first, or bytes behind its block.
    """

    fields: dict[str, Any]
    begin: int
    end: int
    marked: bool
    more: int


class Data:
    """Bytes that are decoded from their beginning."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.place = 0

    def take(self, size: int) -> bytes:
        """The next bytes; DamageError if there are not so many."""
        if not 0 <= size <= len(self.data) - self.place:
            raise DamageError(f"it ends early, after {len(self.data)} bytes")
        self.place += size
        return self.data[self.place - size : self.place]

    def long(self) -> int:
        """A whole number."""
        value = 0
        for shift in range(0, 7 * VARINT_BYTES, 7):
            byte = self.take(1)[0]
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return (value >> 1) ^ -(value & 1)
        raise DamageError(f"a number at byte {self.place} has no end")

    def longs(self, count: int) -> NDArray[np.int64]:
        """So many whole numbers (n,)."""
        parts, left = [np.empty(0, np.int64)], count
        while left:
            number = min(left, PIECE)
            view = np.frombuffer(self.data, np.uint8, offset=self.place)[: VARINT_BYTES * number]
            ends = np.flatnonzero(view < 0x80)[:number] + 1
            if len(ends) < number:
                raise DamageError(f"it ends early, after {len(self.data)} bytes")
            starts = np.concatenate(([0], ends[:-1]))
            sizes = ends - starts
            if sizes.max() > VARINT_BYTES:
                raise DamageError(f"a number after byte {self.place} has no end")
            shift = np.arange(ends[-1]) - np.repeat(starts, sizes)
            bits = (view[: ends[-1]] & 0x7F).astype(np.uint64) << (7 * shift).astype(np.uint64)
            value = np.bitwise_or.reduceat(bits, starts)
            parts.append((value >> np.uint64(1)).astype(np.int64) ^ -(value & np.uint64(1)).astype(np.int64))
            self.place += int(ends[-1])
            left -= number
        return np.concatenate(parts)

    def counts(self) -> Iterator[int]:
        """The numbers of items in the blocks of an array or a map."""
        while number := self.long():
            if number < 0:
                self.long()
            yield abs(number)


class Decoder:
    """Decodes values of a schema.

    Args:
        schema: as JSON.
    """

    def __init__(self, schema: Any) -> None:
        self._schema = schema
        self._named: dict[str, Any] = {}
        self._values = 0

    def record(self, data: Data) -> dict[str, Any]:
        """The record, or map, that the data begin with."""
        value = self._value(self._schema, data, 0)
        if not isinstance(value, dict):
            raise DamageError("its schema is not that of a record")
        return value

    def _value(self, schema: Any, data: Data, depth: int) -> Any:
        self._values += 1
        if depth > DEEPEST or self._values > MOST_VALUES:
            raise DamageError("its schema is nested too deep")
        if isinstance(schema, list):
            branch = data.long()
            if not 0 <= branch < len(schema):
                raise DamageError(f"a value before byte {data.place} is of no known type")
            return self._value(schema[branch], data, depth + 1)
        if isinstance(schema, str):
            if schema in PRIMITIVES:
                return _primitive(schema, data)
            if schema.rpartition(".")[2] not in self._named:
                raise DamageError(f"its schema does not say what {schema[:40]!r} is")
            return self._value(self._named[schema.rpartition(".")[2]], data, depth + 1)
        if not isinstance(schema, Mapping):
            raise DamageError("its schema is damaged")
        return self._complex(schema, data, depth)

    def _complex(self, schema: Mapping[str, Any], data: Data, depth: int) -> Any:
        kind = schema.get("type")
        if isinstance(name := schema.get("name"), str):
            self._named[name.rpartition(".")[2]] = schema
        if kind == "record":
            return {key: self._value(item, data, depth + 1) for key, item in _fields(schema)}
        if kind == "array":
            return self._array(schema.get("items"), data, depth)
        if kind == "map":
            return self._map(schema.get("values"), data, depth)
        if kind == "enum":
            return data.long()
        if kind == "fixed":
            size = schema.get("size")
            return data.take(size if isinstance(size, int) else -1)
        return self._value(kind, data, depth + 1)

    def _array(self, items: Any, data: Data, depth: int) -> Any:
        plain = items.get("type") if isinstance(items, Mapping) else items
        if plain in WHOLE:
            parts = [data.longs(_fitting(count, data, 1)) for count in data.counts()]
            return np.concatenate([np.empty(0, np.int64), *parts])
        if isinstance(plain, str) and plain in NUMBERS:
            kind = np.dtype(NUMBERS[plain])
            raw = [data.take(_fitting(count, data, kind.itemsize) * kind.itemsize) for count in data.counts()]
            return np.frombuffer(b"".join(raw), kind)
        values: list[Any] = []
        for count in data.counts():
            if len(values) + count > MOST_ITEMS:
                raise DamageError(f"a list claims {count} items")
            values += [self._value(items, data, depth + 1) for _ in range(count)]
        return values

    def _map(self, values: Any, data: Data, depth: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for count in data.counts():
            if len(found) + count > MOST_ITEMS:
                raise DamageError(f"a map claims {count} items")
            for _ in range(count):
                key = _primitive("string", data)
                found[str(key)] = self._value(values, data, depth + 1)
        return found


def _fitting(count: int, data: Data, least: int) -> int:
    """A number of items that each take so many bytes or more; DamageError if they cannot be there."""
    if count * least > len(data.data) - data.place:
        raise DamageError(f"an array claims {count} numbers, more than there are bytes")
    return count


def _primitive(kind: str, data: Data) -> Any:
    if kind == "null":
        return None
    if kind == "boolean":
        return data.take(1) != b"\0"
    if kind in WHOLE:
        return data.long()
    if kind in NUMBERS:
        size = np.dtype(NUMBERS[kind]).itemsize
        return float(struct.unpack("<f" if kind == "float" else "<d", data.take(size))[0])
    raw = data.take(data.long())
    return raw.decode("utf-8", "replace") if kind == "string" else raw


def _fields(schema: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    fields = schema.get("fields")
    for field in fields if isinstance(fields, list) else []:
        if not isinstance(field, Mapping) or not isinstance(field.get("name"), str) or "type" not in field:
            raise DamageError("its schema is damaged")
        yield field["name"], field["type"]


def read_first(path: Path) -> FirstRecord:
    """Decode the first record.

    Raises:
        UnreadableError: the file is cut off, damaged, too large, or packed in a way that is not known.
    """
    with ByteSource(path) as source:
        data = Data(source.read_exact(LARGEST_BYTES + 1))
        source.refuse_damaged()
    if len(data.data) > LARGEST_BYTES:
        what = f"has more than {LARGEST_BYTES >> 20} MB, which no half hour of an EmbracePlus takes"
        raise UnreadableError(
            what, path=path, hint="give it as the files of half an hour that Empatica writes"
        )
    try:
        return _first(data)
    except DamageError as error:
        raise UnreadableError(
            f"cannot be decoded: {error}", path=path, byte_offset=data.place, hint=AGAIN
        ) from error


def _first(data: Data) -> FirstRecord:
    data.take(MAGIC_BYTES)
    about: dict[str, bytes] = Decoder(HEADER).record(data)
    marker = data.take(MARKER_BYTES)
    try:
        schema = json.loads(about.get("avro.schema", b""))
    except (ValueError, RecursionError) as error:
        raise DamageError("its schema is damaged") from error
    records, begin = data.long(), data.place
    if records < 1:
        raise DamageError("it holds no record")
    block = data.take(data.long())
    marked = data.take(min(MARKER_BYTES, len(data.data) - data.place)) == marker
    unpacked = Data(_unpacked(block, about.get("avro.codec", b"null")))
    fields = Decoder(schema).record(unpacked)
    more = records - 1 or len(unpacked.data) - unpacked.place or len(data.data) - data.place
    return FirstRecord(fields, begin, data.place, marked, more)


def _unpacked(block: bytes, codec: bytes) -> bytes:
    try:
        if codec == b"null":
            return block
        if codec == b"deflate":
            whole = zlib.decompressobj(-15).decompress(block, LARGEST_BYTES + 1)
        elif codec == b"bzip2":
            whole = bz2.BZ2Decompressor().decompress(block, LARGEST_BYTES + 1)
        else:
            raise DamageError(
                f"it is packed with {codec[:20].decode('ascii', 'replace')}, which is not known"
            )
    except (zlib.error, OSError, EOFError) as error:
        raise DamageError(f"its packed data are damaged ({error})") from error
    if len(whole) > LARGEST_BYTES:
        raise DamageError(f"it unpacks to more than {LARGEST_BYTES >> 20} MB")
    return whole
