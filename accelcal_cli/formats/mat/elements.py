"""The elements of a MATLAB file: numeric arrays, texts and structures, found without reading their numbers.

Source: MathWorks, "MAT-File Format", chapter 1 (MAT-File Level 5): "Data Elements", "MAT-File Data Types"
(table 1-1), "MATLAB Array Types" (table 1-3), "Data Element Formats".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.formats._bytes import PIECE_BYTES, PackedStream, PlainStream
from accelcal_cli.formats._tables.arrays import ArrayTable, Stream, array_of
from accelcal_cli.formats.mat import HEAD_BYTES

STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of numbers as they are stored, by the data type of their element."""

CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""Types of numbers as MATLAB has them, by the class of their array."""

ENCODINGS = {1: "latin-1", 2: "utf-8", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
MATRIX, COMPRESSED, STRUCTURE, LETTERS = 14, 15, 2, 4
COMPLEX, LOGICAL = 0x08, 0x02
TAG_BYTES = 8
DEEPEST, MOST_ELEMENTS, MOST_FIELDS, LONGEST_TEXT = 8, 10_000, 1024, 1 << 16


class DamagedError(Exception):
    """An element that cannot be one."""


@dataclass(frozen=True, slots=True)
class Tag:
    """What an element says of itself: its data type, the bytes of its data, and those up to the next one.

    `data` is there where it is so short that it stands in the tag.
    """

    kind: int
    size: int
    whole: int
    data: bytes | None = None


class Cursor:
    """A place in the bytes of a file, or in those that an element unpacks to.

    Args:
        begin: gives the bytes from the beginning.
        base: the byte of the file at which they begin, None if they are packed.
    """

    def __init__(self, begin: Callable[[], Stream], order: str, base: int | None) -> None:
        self.begin, self.order, self.base = begin, order, base
        self._stream = begin()
        self.place = 0

    def take(self, count: int) -> bytes:
        """The next bytes. Raises DamagedError where there are fewer."""
        data = b"".join(self._stream.pieces(count))
        if len(data) < count:
            raise DamagedError("ends early")
        self.place += count
        return data

    def skip_to(self, place: int) -> None:
        """Go forward."""
        self._stream.skip(place - self.place)
        self.place = place

    def from_here(self) -> Callable[[], Stream]:
        """Gives the bytes from this place on; unpacks all before them each time."""
        return partial(_placed, self.begin, self.place)

    def tag(self) -> Tag:
        """The next tag. Raises DamagedError."""
        first, second = struct.unpack(f"{self.order}II", head := self.take(TAG_BYTES))
        if first >> 16:
            size = first >> 16
            if size > 4:
                raise DamagedError("a short element that is long")
            return Tag(first & 0xFFFF, size, 0, head[4 : 4 + size])
        return Tag(first, second, -(-second // 8) * 8)

    def data(self, most: int = LONGEST_TEXT) -> tuple[int, bytes]:
        """Data type and data of a small element, with what fills it up left behind."""
        tag = self.tag()
        if tag.data is not None:
            return tag.kind, tag.data
        if tag.size > most:
            raise DamagedError("longer than it can be")
        return tag.kind, self.take(tag.whole)[: tag.size]


def _placed(begin: Callable[[], Stream], place: int) -> Stream:
    stream = begin()
    stream.skip(place)
    return stream


class Elements:
    """Goes through a file and takes what it holds into a table."""

    def __init__(self, table: ArrayTable, order: str) -> None:
        self._table, self._order, self._left = table, order, MOST_ELEMENTS
        self._size = table.path.stat().st_size

    def all(self) -> None:
        """From the first element to the last; one that is damaged is counted, and the rest is read."""
        path, place = self._table.path, HEAD_BYTES
        while place + TAG_BYTES <= self._size:
            whole = Cursor(partial(PlainStream, path, place, self._size - place), self._order, place)
            try:
                tag = whole.tag()
            except DamagedError:
                self._table.damaged += 1
                return
            end = place + TAG_BYTES + (tag.size if tag.kind == COMPRESSED else tag.whole)
            self._table.missing = max(0, end - self._size)
            try:
                self._top(whole, tag, place)
            except (DamagedError, struct.error, ValueError, zlib.error):
                self._table.damaged += 1
            place = end
        if place < self._size:
            self._table.missing = self._table.missing or -1

    def _top(self, whole: Cursor, tag: Tag, place: int) -> None:
        if tag.kind != COMPRESSED:
            self._element(whole, tag, "", 0)
            return
        begin = partial(_unpacked, self._table.path, place + TAG_BYTES, tag.size)
        inside = Cursor(begin, self._order, None)
        self._element(inside, inside.tag(), "", 0)

    def _element(self, cursor: Cursor, tag: Tag, name: str, depth: int) -> None:
        """An array, whatever its class; the cursor is behind it afterwards."""
        end, self._left = cursor.place + tag.whole, self._left - 1
        if tag.kind != MATRIX or not self._left or depth > DEEPEST:
            raise DamagedError("no array, too many, or too deep")
        if not tag.size:
            return
        flags = struct.unpack(f"{self._order}I", cursor.data()[1][:4])[0]
        kind, about = flags & 0xFF, flags >> 8 & 0xFF
        if kind not in (STRUCTURE, LETTERS, *CLASSES):
            self._table.unknown.append(name or "a variable")
            cursor.skip_to(end)
            return
        lengths = cursor.data()[1]
        shape = struct.unpack(f"{self._order}{len(lengths) // 4}i", lengths[: len(lengths) // 4 * 4])
        own = cursor.data()[1].decode("latin-1")
        name = f"{name}/{own}" if own else name
        if kind == STRUCTURE:
            self._structure(cursor, shape, name, depth)
        elif kind == LETTERS:
            self._letters(cursor, name)
        elif not about & (COMPLEX | LOGICAL) and min(shape, default=0) > 0:
            self._numbers(cursor, kind, shape, name)
        cursor.skip_to(end)

    def _structure(self, cursor: Cursor, shape: tuple[int, ...], name: str, depth: int) -> None:
        """The fields of a structure; of an array of structures none."""
        (length,) = struct.unpack(f"{self._order}i", cursor.data()[1])
        names = cursor.data()[1]
        if not 0 < length <= 1024 or len(names) // length > MOST_FIELDS:
            raise DamagedError("names of no length")
        if set(shape) != {1}:
            return
        for start in range(0, len(names) // length * length, length):
            own = names[start : start + length].split(b"\0")[0].decode("latin-1")
            self._element(cursor, cursor.tag(), f"{name}/{own}", depth + 1)

    def _letters(self, cursor: Cursor, name: str) -> None:
        """A text of one line."""
        tag = cursor.tag()
        if tag.kind not in ENCODINGS or tag.size > LONGEST_TEXT:
            return
        data = cursor.take(tag.whole)[: tag.size] if tag.data is None else tag.data
        encoding = ENCODINGS[tag.kind]
        if tag.kind in (4, 17, 18):
            encoding += "-le" if self._order == "<" else "-be"
        self._table.scalars[name] = data.decode(encoding, "replace")

    def _numbers(self, cursor: Cursor, kind: int, shape: tuple[int, ...], name: str) -> None:
        """A number, or an array that can be a track."""
        tag = cursor.tag()
        if tag.kind not in STORED:
            raise DamagedError("numbers of no type")
        stored = np.dtype(self._order + STORED[tag.kind])
        number = float(np.prod(shape, dtype=np.float64))
        if number * stored.itemsize != tag.size:
            raise DamagedError("more or fewer numbers than its shape has")
        if number == 1:
            data = tag.data if tag.data is not None else cursor.take(stored.itemsize)
            self._table.scalars[name] = np.frombuffer(data, stored)[0]
        elif tag.data is None:
            types: tuple[np.dtype[Any], np.dtype[Any]] = (stored, np.dtype(CLASSES[kind]))
            offset = None if cursor.base is None else cursor.base + cursor.place
            array = array_of(name, shape, types, True, cursor.from_here(), offset)
            if array is not None:
                self._table.add(replace(array, is_true=partial(_is_true, cursor.begin)), self._size)


def _is_true(begin: Callable[[], Stream]) -> bool:
    """Whether an element unpacks to what its checksum is of, as far as the file has it."""
    stream = begin()
    if isinstance(stream, PlainStream):
        return True
    while any(stream.pieces(PIECE_BYTES)):
        pass
    return not stream.damaged


def _unpacked(path: Path, offset: int, size: int) -> PackedStream:
    return PackedStream(path, offset, size)
