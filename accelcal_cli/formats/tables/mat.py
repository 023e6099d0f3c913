"""Reads MATLAB files of versions 5 to 7 as tables: variables and fields of structures by their names.

Source: MathWorks, "MAT-File Format", chapter 1 (MAT-File Level 5): "Data Elements", "MAT-File Data Types"
(table 1-1), "MATLAB Array Types" (table 1-3), "Data Element Formats".
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from posixpath import basename

import numpy as np

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats.tables import arrays
from accelcal_cli.formats.tables.arrays import Array, Arrays, ArraySource, StoredBytes, array_path
from accelcal_cli.formats.tables.reader import TableReader, open_table
from accelcal_cli.formats.tables.signatures import MAT_BIG, MAT_HEAD_BYTES, MAT_LITTLE, MAT_VERSION
from accelcal_cli.formats.tables.tracks import track_of_shape

STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of numbers as they are stored, by the data type of their element."""

CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""Types of numbers as MATLAB has them, by the class of their array."""

ENCODINGS = {1: "latin-1", 2: "utf-8", 4: "utf-16-{}e", 16: "utf-8", 17: "utf-16-{}e", 18: "utf-32-{}e"}
MATRIX, COMPRESSED, LENGTHS, STRUCTURE, LETTERS, OPAQUE = 14, 15, 5, 2, 4, 17
"""Data types of elements, and classes of arrays. An opaque array, such as a timetable, has no lengths."""

COMPLEX_OR_LOGICAL = 0x0A00
TAG_BYTES = 8
FIRST_BYTES = 256
"""Bytes that are unpacked first, doubled each time: of a piece with damage, nothing is read."""

DEEPEST, MOST_ELEMENTS, LONGEST_TEXT = 8, 10_000, 1 << 16


class Cursor:
    """A place in the bytes of a file, or in those that an element unpacks to; `order` is < or >."""

    def __init__(self, source: StoredBytes, order: str, place: int = 0) -> None:
        self.source, self.order, self.place = source, order, place
        self._read = source.reader()

    def at(self, place: int, count: int) -> bytes:
        """Return the bytes at a place; raise ValueError if there are fewer."""
        if len(data := self._read(place, count)) < count:
            raise ValueError("ends early")
        return data

    def numbers(self, data: bytes) -> tuple[int, ...]:
        """Return data as natural numbers of 32 bits."""
        count = len(data) // 4
        return struct.unpack(f"{self.order}{count}I", data[: 4 * count])

    def next(self) -> tuple[int, int, int]:
        """Return data type, size and place of the next element's data, and go behind it."""
        kind, size = self.numbers(self.at(self.place, TAG_BYTES))
        start, whole = self.place + TAG_BYTES, -(-size // 8) * 8
        if kind >> 16:  # the data stand in the tag itself
            kind, size, start, whole = kind & 0xFFFF, kind >> 16, start - 4, 4
            if size > 4:
                raise ValueError("a short element that is long")
        self.place = start + whole
        return kind, size, start

    def data(self) -> tuple[int, bytes]:
        """Return data type and data of the next element, which is small."""
        kind, size, start = self.next()
        if size > LONGEST_TEXT:
            raise ValueError("longer than it can be")
        return kind, self.at(start, size)


class MatElements:
    """Goes through a file and takes its arrays, numbers and texts into a table; it reads no array."""

    def __init__(self, table: Arrays, order: str) -> None:
        self._table, self._order, self._left = table, order, MOST_ELEMENTS
        self._size = table.path.stat().st_size

    def all(self) -> None:
        """Read from the first element to the last; a damaged one is counted, and the rest is read."""
        table, end = self._table, MAT_HEAD_BYTES
        while self._left > 0 and end + TAG_BYTES <= self._size:
            cursor = Cursor(StoredBytes(table.path, self._size), self._order, end)
            self._left, begin, end = self._left - 1, end, self._size  # if there is no tag
            try:
                kind, size, start = cursor.next()
                end = start + size if kind == COMPRESSED else cursor.place
                table.missing = max(0, end - self._size)
                cursor.place = begin
                if kind == COMPRESSED:
                    pieces = partial(inflated, table.path, start, size)
                    is_true = cache(partial(arrays.is_sound, pieces))
                    cursor = Cursor(StoredBytes(table.path, 0, pieces, is_true), self._order)
                self._array(cursor)
            except ValueError:
                table.damaged += 1
        if end + TAG_BYTES <= self._size:
            table.damaged += 1
        elif end < self._size:
            table.missing = table.missing or -1

    def _array(self, cursor: Cursor, name: str = "", depth: int = 0) -> None:
        """Take the next element in, an array of any class, and go behind it."""
        element, size, start = cursor.next()
        end, cursor.place = cursor.place, start
        if element != MATRIX or depth > DEEPEST:
            raise ValueError("no array, or too deep")
        if size:
            self._parts(cursor, name, depth)
        cursor.place = end

    def _parts(self, cursor: Cursor, name: str, depth: int) -> None:
        flags, *_ = cursor.numbers(cursor.data()[1])
        kind, (first, own) = flags & 0xFF, cursor.data()
        shape: tuple[int, ...] = (1,)
        if kind != OPAQUE or first == LENGTHS:
            shape, (_, own) = cursor.numbers(own), cursor.data()
        name = array_path(own.decode("latin-1"), name) if own else name
        if not name or not all(shape):
            return
        if kind == STRUCTURE and set(shape) == {1}:
            self._fields(cursor, name, depth)
        elif kind not in (LETTERS, *CLASSES):
            self._table.objects.append(name)
        elif not flags & COMPLEX_OR_LOGICAL:
            self._values(cursor, kind, shape, name)

    def _fields(self, cursor: Cursor, name: str, depth: int) -> None:
        """Take the fields of a structure in."""
        length, *_ = cursor.numbers(cursor.data()[1])
        names = cursor.data()[1]
        for start in range(0, len(names) - length + 1, length):
            self._left -= 1
            if self._left < 0:
                raise ValueError("too many")
            own = names[start : start + length].split(b"\0")[0].decode("latin-1")
            self._array(cursor, array_path(own, name), depth + 1)

    def _values(self, cursor: Cursor, kind: int, shape: tuple[int, ...], name: str) -> None:
        """Take in a text, a number, or an array that can be a track."""
        element, size, start = cursor.next()
        number, beside = math.prod(shape), self._table.beside(name)
        if kind == LETTERS:
            if element in ENCODINGS and size <= LONGEST_TEXT:
                encoding = ENCODINGS[element].format("l" if self._order == "<" else "b")
                beside[basename(name)] = cursor.at(start, size).decode(encoding, "replace")
            return
        stored = np.dtype(self._order + STORED.get(element, "V"))
        if not size or number * stored.itemsize != size:
            raise ValueError("numbers of no type, or more or fewer than its shape has")
        if number == 1:
            beside[basename(name)] = np.frombuffer(cursor.at(start, size), stored)[0]
        elif (track := track_of_shape(name, shape, np.dtype(CLASSES[kind]))) is not None:
            self._table.add(Array(track, stored, True, cursor.source, start), self._size)


def inflated(path: Path, offset: int, size: int) -> Iterator[bytes]:
    """Yield what zlib packed into a stretch of a file, in pieces; raise zlib.error where it is damaged."""
    unpacker, source, most = zlib.decompressobj(), StoredBytes(path, offset + size), FIRST_BYTES
    while not unpacker.eof and (packed := source.stored(offset, arrays.PIECE_BYTES)):
        offset += len(packed)
        while piece := unpacker.decompress(packed, most):
            yield piece
            packed, most = unpacker.unconsumed_tail, min(2 * most, arrays.PIECE_BYTES)


def open_recording(path: Path, options: ReadOptions) -> TableReader:
    """Open a MATLAB file whose acceleration is an (n, 3) array or three of length n.

    Raises:
        UnreadableError: damaged, or nothing in it is known as acceleration.
        UsageError: an option names no array.
    """
    version = arrays.head_of(path, "a MATLAB file")[MAT_VERSION]
    if version not in (MAT_LITTLE, MAT_BIG):
        what, hint = "is not a MATLAB file of version 5 to 7", "save it again with -v7, or try --format hdf5"
        raise UnreadableError(what, path=path, byte_offset=MAT_VERSION.start, hint=hint)
    table = Arrays(path)
    MatElements(table, "<" if version == MAT_LITTLE else ">").all()
    return open_table(ArraySource("mat", table), options)
