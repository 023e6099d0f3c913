"""Arrays whose numbers lie one behind the other in a file, packed or not, as tracks of a table."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from posixpath import basename, dirname
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Problem
from accelcal_cli.core.vocabulary import normalized
from accelcal_cli.formats._bytes import ByteSource, refuse_packed
from accelcal_cli.formats.tables.header import As, Attributes, readable
from accelcal_cli.formats.tables.tracks import AGAIN, HIGHEST_RATIO, TEXT, OpenRows, Track, TrackSource

HEAD_BYTES, LONGEST_NAME = 128, 1024
PIECE_BYTES = 1 << 16
"""Most bytes that are unpacked at once, and kept of each array: there may be a thousand."""

UNPACK_ERRORS = (zipfile.BadZipFile, zlib.error, EOFError)

Read = Callable[[int, int], bytes]
"""Returns bytes from a place on, as many as are wanted; fewer where they end, or cannot be unpacked."""

Pieces = Callable[[], Iterator[bytes]]
"""Unpacks bytes from their beginning in pieces; may raise UNPACK_ERRORS."""


def head_of(path: Path, kind: str) -> bytes:
    """Return the first bytes of a file of some kind; raise UnreadableError if it is packed."""
    refuse_packed(path, kind)
    with ByteSource(path) as source:
        return source.read_exact(HEAD_BYTES)


def array_path(name: str, group: str = "") -> str:
    """Return the path `group/name` of an array; raise ValueError for what cannot be the name of one."""
    parts = readable(name).strip("/").split("/")
    if len(name) > LONGEST_NAME or not {"", ".", ".."}.isdisjoint(parts):
        raise ValueError("no name of an array")
    return "/".join((group, *parts))


def is_sound(pieces: Pieces) -> bool:
    """Return True if all can be unpacked, and has the right checksum."""
    try:
        return all(pieces())
    except UNPACK_ERRORS:
        return False


class Unpacking:
    """Unpacks bytes in order; for what lies before the last piece, from the beginning once more."""

    def __init__(self, pieces: Pieces) -> None:
        self._begin = pieces
        self._pieces, self._piece, self._place = pieces(), b"", 0

    def read(self, place: int, count: int) -> bytes:
        """See `Read`."""
        if place < self._place:
            self._pieces, self._piece, self._place = self._begin(), b"", 0
        stop = place + count
        parts = [self._piece[place - self._place : stop - self._place]]
        with suppress(StopIteration, *UNPACK_ERRORS):
            while stop > self._place + len(self._piece):
                self._place, self._piece = self._place + len(self._piece), b""
                self._piece = next(self._pieces)
                parts.append(self._piece[max(0, place - self._place) : stop - self._place])
        return b"".join(parts)


@dataclass(frozen=True)
class StoredBytes:
    """The bytes of a file up to byte `end`, or what some of them unpack to.

    Attributes:
        pieces: unpacks them.
        is_true: tells whether a checksum says that they are what was written.
    """

    path: Path
    end: int
    pieces: Pieces | None = None
    is_true: Callable[[], bool] = lambda: True

    def reader(self) -> Read:
        """Return what reads the bytes: packed ones in order, small pieces out of a kept larger one."""
        if self.pieces is not None:
            return Unpacking(self.pieces).read
        kept_at, kept = 0, b""

        def read(place: int, count: int) -> bytes:
            nonlocal kept_at, kept
            if count >= PIECE_BYTES:
                return self.stored(place, count)
            if not kept_at <= place <= place + count <= kept_at + len(kept):
                kept_at, kept = place, self.stored(place, PIECE_BYTES)
            return kept[place - kept_at : place - kept_at + count]

        return read

    def stored(self, place: int, count: int) -> bytes:
        """Return bytes of the file; see `Read`."""
        with self.path.open("rb") as file:
            file.seek(place)
            return file.read(max(0, min(count, self.end - place)))


@dataclass(frozen=True, slots=True)
class Array:
    """An array in a file.

    Attributes:
        stored: the type of its numbers in the file; `track.dtype` is what they are read as.
        column_major: the first axis runs fastest.
        source, place: the bytes that hold it, and the place of its first number in these.
    """

    track: Track
    stored: np.dtype[Any]
    column_major: bool
    source: StoredBytes
    place: int


class ArrayRows:
    """Rows of an array, in order; those behind damage, or behind the end of the file, are lost."""

    kept_bytes = 0

    def __init__(self, array: Array) -> None:
        self._array, width = array, array.track.width
        side_by_side = width == 1 or (array.track.axis == 0) != array.column_major
        self._across = width if side_by_side else 1
        self._planes = [array.source.reader() for _ in range(width // self._across)]
        self._step = array.stored.itemsize * self._across
        self.row_bytes = array.stored.itemsize * width

    def chunk_offset(self, row: int) -> int | None:
        """Return the byte in the file of a row's first number; None if the array is packed."""
        return None if self._array.source.pieces else self._array.place + row * self._step

    def read(self, start: int, stop: int) -> tuple[Any, NDArray[np.bool_]]:
        """See `RowSource`."""
        track, stored, across = self._array.track, self._array.stored, self._across
        place, count = self._array.place + start * self._step, (stop - start) * self._step
        plane = track.rows * self._step
        parts = [read(place + number * plane, count) for number, read in enumerate(self._planes)]
        rows = min(map(len, parts)) // self._step
        dtype = stored.newbyteorder("=") if track.dtype == TEXT else track.dtype
        values = np.zeros((stop - start, track.width), dtype)
        good = np.arange(stop - start) < rows
        for first, part in zip(range(0, track.width, across), parts, strict=True):
            numbers = np.frombuffer(part, stored, rows * across).reshape(rows, across)
            if stored.kind == "f" and dtype.kind in "iu":  # no whole number stands for NaN
                known = np.abs(numbers) < np.iinfo(dtype).max
                numbers, good[:rows] = np.where(known, numbers, 0), good[:rows] & known.all(axis=1)
            values[:rows, first : first + across] = numbers
        if dtype.kind == "U":
            replace_no_letters(values)
        if track.dtype != TEXT:
            return values, good
        import pyarrow as pa  # only where texts are parsed

        cells = values[:, 0].tolist()
        texts = (str(one, "utf-8", "replace") if isinstance(one, bytes) else one for one in cells)
        return pa.array([text.strip("\0 ") or None for text in texts], pa.string()), good


def replace_no_letters(texts: NDArray[np.str_]) -> bool:
    """Replace in place what Unicode does not know; return True if there was any."""
    letters = texts.view(np.uint32)
    wrong = (letters > 0x10FFFF) | (letters >> 11 == 0xD800 >> 11)
    letters[wrong] = 0xFFFD
    return bool(wrong.any())


@dataclass
class Arrays:
    """Arrays of a file by their paths, in its order, and its single numbers and texts.

    Attributes:
        scalars: by group, then by name.
        missing: bytes that a file that was cut short lacks, -1 if that is not known.
        damaged: number of entries that cannot be read.
        objects: names of entries of kinds that cannot be read.
    """

    path: Path
    arrays: dict[str, Array] = field(default_factory=dict)
    scalars: dict[str, dict[str, object]] = field(default_factory=dict)
    missing: int = 0
    damaged: int = 0
    objects: list[str] = field(default_factory=list)

    def add(self, array: Array, size: int) -> None:
        """Take an array in; raise UnreadableError if the `size` bytes that hold it, packed or not, cannot."""
        track = array.track
        if track.rows * track.width * array.stored.itemsize > size * HIGHEST_RATIO:
            what = f"column {track.path} claims {track.rows} rows, more than the file can hold"
            raise UnreadableError(what, path=self.path, hint=AGAIN)
        if track.rows > 0:
            self.arrays.setdefault(track.path, array)

    def beside(self, path: str) -> dict[str, object]:
        """Return the single numbers and texts next to a path, by name."""
        return self.scalars.setdefault(dirname(path), {})


class ArraySource(TrackSource):
    """The arrays of a file as a source of named columns."""

    def __init__(self, format_name: str, found: Arrays) -> None:
        self.format, self._found, self.missing_bytes = format_name, found, found.missing
        tracks = [array.track for array in found.arrays.values()]
        super().__init__(found.path, tracks, objects=found.objects, damaged=found.damaged)

    @contextmanager
    def opened(self) -> Iterator[OpenRows]:
        """See `TrackSource`; each array opens its own bytes."""
        yield lambda track: ArrayRows(self._found.arrays[track.path])

    def own(self, path: str) -> Attributes:
        """Return what is stated of an array: `unit` and `units` with its name before or behind."""
        return Attributes(self._units(path))

    def around(self, path: str) -> Attributes:
        """Return what is stated of an array, next to it and around it."""
        groups = map(str, PurePosixPath(path).parents)
        return Attributes([*self._units(path), *(self._found.scalars.get(group, {}) for group in groups)])

    def _units(self, path: str) -> list[dict[str, object]]:
        name, beside = normalized(basename(path)), self._found.scalars.get(dirname(path), {})
        known = {name + "unit", name + "units", "unit" + name, "units" + name}
        return [{"unit": value} for one, value in beside.items() if normalized(one) in known][:1]

    def check(self, wanted: Mapping[int, As]) -> None:
        """See `Source`; what is packed can be read from its beginning alone.

        Raises:
            UnreadableError: what is packed is damaged, so that values behind that are not what was packed.
        """
        used = [self._found.arrays[self.tracks[number].path] for number in wanted]
        self.can_be_entered = not any(array.source.pieces for array in used)
        for array in (one for one in used if not one.source.is_true()):
            name = f"column {array.track.path}"
            if array.source.pieces:
                what = f"{name} is damaged: some values are not what was packed"
                raise UnreadableError(what, path=self.path, hint=AGAIN)
            what = f"{name}: its checksum is wrong; some of its values are not what was written"
            self.problems = (*self.problems, Problem("checksum", what, array.place, 0))
