"""Reads MATLAB files of versions 5 to 7 as tables: variables and fields of structures by their names.

`MatElements` finds numeric arrays, texts and structures without reading their numbers.

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

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.formats._bytes import PIECE_BYTES, ByteSource, PackedStream, PlainStream
from accelcal_cli.formats._tables.arrays import ArrayReader, ArrayTable, Stream, array_of
from accelcal_cli.formats._tables.reader import plan_of, source_of
from accelcal_cli.formats.mat import BIG, HEAD_BYTES, LITTLE, VERSION

STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of numbers as they are stored, by the data type of their element."""

CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""Types of numbers as MATLAB has them, by the class of their array."""

ENCODINGS = {1: "latin-1", 2: "utf-8", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
MATRIX, COMPRESSED, LENGTHS, STRUCTURE, LETTERS, OPAQUE = 14, 15, 5, 2, 4, 17
"""Data types of elements, and classes of arrays. An opaque array, such as a timetable, has no lengths."""

COMPLEX, LOGICAL = 0x08, 0x02
TAG_BYTES = 8
DEEPEST, MOST_ELEMENTS, MOST_FIELDS, LONGEST_TEXT = 8, 10_000, 1024, 1 << 16


class DamagedError(Exception):
    """An element is damaged."""


@dataclass(frozen=True, slots=True)
class Tag:
    """The tag of an element.

    Attributes:
        kind: data type.
        size: bytes of its data; `whole`: bytes up to the next element.
        data: set if it is so short that it stands in the tag.
    """

    kind: int
    size: int
    whole: int
    data: bytes | None = None


class Cursor:
    """A place in the bytes of a file, or in the bytes that an element unpacks to.

    Args:
        begin: opens the bytes at their beginning.
        base: the byte of the file at which they begin, None if they are packed.
    """

    def __init__(self, begin: Callable[[], Stream], order: str, base: int | None) -> None:
        self.begin, self.order, self.base = begin, order, base
        self._stream = begin()
        self.place = 0

    def take(self, count: int) -> bytes:
        """Return the next bytes; raise DamagedError if there are fewer."""
        data = b"".join(self._stream.pieces(count))
        if len(data) < count:
            raise DamagedError("ends early")
        self.place += count
        return data

    def skip_to(self, place: int) -> None:
        """Go forward to a place."""
        self._stream.skip(place - self.place)
        self.place = place

    def from_here(self) -> Callable[[], Stream]:
        """Return a function that opens the bytes at this place; it unpacks all before them each time."""
        begin, place = self.begin, self.place

        def opened() -> Stream:
            stream = begin()
            stream.skip(place)
            return stream

        return opened

    def tag(self) -> Tag:
        """Return the next tag; raise DamagedError if there is no valid one."""
        first, second = struct.unpack(f"{self.order}II", head := self.take(TAG_BYTES))
        if first >> 16:
            size = first >> 16
            if size > 4:
                raise DamagedError("a short element that is long")
            return Tag(first & 0xFFFF, size, 0, head[4 : 4 + size])
        return Tag(first, second, -(-second // 8) * 8)

    def data(self, most: int = LONGEST_TEXT) -> tuple[int, bytes]:
        """Return data type and data of a small element, and go behind its padding."""
        tag = self.tag()
        if tag.data is not None:
            return tag.kind, tag.data
        if tag.size > most:
            raise DamagedError("longer than it can be")
        return tag.kind, self.take(tag.whole)[: tag.size]


class MatElements:
    """Goes through a file and takes its arrays, numbers and texts into a table."""

    def __init__(self, table: ArrayTable, order: str) -> None:
        self._table, self._order, self._left = table, order, MOST_ELEMENTS
        self._size = table.path.stat().st_size

    def all(self) -> None:
        """Read from the first element to the last; a damaged one is counted, and the rest is read."""
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
        begin = partial(PackedStream, self._table.path, place + TAG_BYTES, tag.size)
        inside = Cursor(begin, self._order, None)
        self._element(inside, inside.tag(), "", 0)

    def _element(self, cursor: Cursor, tag: Tag, name: str, depth: int) -> None:
        """Read an array of any class; the cursor is behind it afterwards."""
        end, self._left = cursor.place + tag.whole, self._left - 1
        if tag.kind != MATRIX or not self._left or depth > DEEPEST:
            raise DamagedError("no array, too many, or too deep")
        if not tag.size:
            return
        flags = struct.unpack(f"{self._order}I", cursor.data()[1][:4])[0]
        kind, about = flags & 0xFF, flags >> 8 & 0xFF
        first, lengths = cursor.data()
        named = kind == OPAQUE and first != LENGTHS
        count = 0 if named else len(lengths) // 4
        shape = struct.unpack(f"{self._order}{count}i", lengths[: 4 * count])
        own = (lengths if named else cursor.data()[1]).decode("latin-1")
        name = f"{name}/{own}" if own else name
        if named or kind not in (STRUCTURE, LETTERS, *CLASSES):
            self._table.objects += [name] * bool(name)
        elif kind == STRUCTURE:
            self._structure(cursor, shape, name, depth)
        elif kind == LETTERS:
            self._letters(cursor, name)
        elif not about & (COMPLEX | LOGICAL) and min(shape, default=0) > 0:
            self._numbers(cursor, kind, shape, name)
        cursor.skip_to(end)

    def _structure(self, cursor: Cursor, shape: tuple[int, ...], name: str, depth: int) -> None:
        """Read the fields of a structure; an array of structures counts as an object."""
        (length,) = struct.unpack(f"{self._order}i", cursor.data()[1])
        names = cursor.data()[1]
        if not 0 < length <= 1024 or len(names) // length > MOST_FIELDS:
            raise DamagedError("names of no length")
        if set(shape) != {1}:
            self._table.objects += [name] * (min(shape, default=0) > 0)
            return
        for start in range(0, len(names) // length * length, length):
            own = names[start : start + length].split(b"\0")[0].decode("latin-1")
            self._element(cursor, cursor.tag(), f"{name}/{own}", depth + 1)

    def _letters(self, cursor: Cursor, name: str) -> None:
        tag = cursor.tag()
        if tag.kind not in ENCODINGS or tag.size > LONGEST_TEXT:
            return
        data = cursor.take(tag.whole)[: tag.size] if tag.data is None else tag.data
        encoding = ENCODINGS[tag.kind]
        if tag.kind in (4, 17, 18):
            encoding += "-le" if self._order == "<" else "-be"
        self._table.scalars[name] = data.decode(encoding, "replace")

    def _numbers(self, cursor: Cursor, kind: int, shape: tuple[int, ...], name: str) -> None:
        """Read a number, or an array that can be a track."""
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
    """Return True if the checksum of an element is right, or lies beyond the end of the file."""
    stream = begin()
    if isinstance(stream, PlainStream):
        return True
    while any(stream.pieces(PIECE_BYTES)):
        pass
    return not stream.damaged


def open_recording(path: Path, options: ReadOptions) -> ArrayReader:
    """Open a MATLAB file whose acceleration is an (n, 3) array or three of length n.

    Raises:
        UnreadableError: damaged, or nothing in it is known as acceleration.
        UsageError: an option names no array.
    """
    table = _opened(path)
    with table.explaining(table.damaged):
        return ArrayReader(plan_of(source_of(table, table.tracks, options, table.damaged), "mat"), table)


def _opened(path: Path) -> ArrayTable:
    with ByteSource(path) as source:
        if source.compressed:
            raise UnreadableError(
                "is a MATLAB file inside gzip", path=path, hint="unpack it first with gunzip"
            )
        version = source.read_exact(HEAD_BYTES)[VERSION]
    if version not in (LITTLE, BIG):
        what, hint = "is not a MATLAB file of version 5 to 7", "save it again with -v7, or try --format hdf5"
        raise UnreadableError(what, path=path, byte_offset=VERSION.start, hint=hint)
    table = ArrayTable(path)
    MatElements(table, "<" if version == LITTLE else ">").all()
    return table
