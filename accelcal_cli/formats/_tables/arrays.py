"""Arrays whose numbers lie one behind the other in a file, packed or not, as tracks of a table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from posixpath import basename, dirname
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Chunk, Problem, Reader
from accelcal_cli.core.vocabulary import normalized
from accelcal_cli.formats._bytes import PackedStream, PlainStream
from accelcal_cli.formats._tables.reader import ReadingPlan, TableReader
from accelcal_cli.formats._tables.table import (
    TEXT,
    Attributes,
    RowSource,
    SensorTable,
    Track,
    track_of_shape,
)
from accelcal_cli.formats._tables.texts import TextRows, WrittenRows

Stream = PackedStream | PlainStream
HIGHEST_RATIO = 1100
"""Deflate makes at most 1032 bytes of one."""

UNIT_ENDINGS = ("unit", "units")


@dataclass(frozen=True, slots=True)
class Array:
    """An array in a file.

    Attributes:
        stored: the type of its numbers in the file; `track.dtype` is what they are read as.
        by_row: a row's numbers lie side by side; else all of one axis, then all of the next.
        stream: opens its bytes at the first one.
        offset: byte in the file at which its bytes begin, None if they are packed.
        is_true: tells whether a checksum says that they are what was written.
    """

    track: Track
    stored: np.dtype[Any]
    by_row: bool
    stream: Callable[[], Stream]
    offset: int | None
    is_true: Callable[[], bool] = lambda: True


def array_of(
    path: str,
    shape: tuple[int, ...],
    types: tuple[np.dtype[Any], np.dtype[Any]],
    column_major: bool,
    stream: Callable[[], Stream],
    offset: int | None,
) -> Array | None:
    """Return an array of some shape as a track; None if it is no such array.

    Args:
        types: as it is stored, and as it is read.
        column_major: the first axis runs fastest.
    """
    track = track_of_shape(path, shape, types[1])
    if track is None or not track.rows:
        return None
    by_row = track.width == 1 or (track.axis == 0) != column_major
    return Array(track, types[0], by_row, stream, offset)


def text_array_of(
    path: str, shape: tuple[int, ...], dtype: np.dtype[Any], stream: Callable[[], Stream], offset: int | None
) -> Array | None:
    """Return an array of one text a row as a track; None if it is no such array."""
    if len(shape) != 1 or dtype.kind not in "US" or not dtype.itemsize:
        return None
    return Array(Track(path, shape[0], 1, 0, TEXT), dtype, True, stream, offset)


class ArrayRows:
    """Rows of an array, in order; those behind damage, or behind the end of the file, are lost."""

    kept_bytes = 0

    def __init__(self, array: Array) -> None:
        self._array = array
        self._planes = 1 if array.by_row else array.track.width
        self._plane_row_bytes = array.stored.itemsize * array.track.width // self._planes
        self._streams: list[Stream] = []
        self._row = 0

    @property
    def path(self) -> str:
        """The track's path."""
        return self._array.track.path

    @property
    def row_bytes(self) -> int:
        """Bytes of one row in the file."""
        return self._array.stored.itemsize * self._array.track.width

    def chunk_offset(self, row: int) -> int | None:
        """Return the byte in the file of a row's first number; None if the array is packed."""
        offset = self._array.offset
        return None if offset is None else offset + row * self._plane_row_bytes

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows start..stop-1, shape (stop - start, width), and flags of those that are not lost."""
        if not self._streams or start < self._row:
            self._enter()
        for stream in self._streams:
            stream.skip((start - self._row) * self._plane_row_bytes)
        count = (stop - start) * self._plane_row_bytes
        parts = [b"".join(stream.pieces(count)) for stream in self._streams]
        self._row = stop
        rows = min(map(len, parts)) // self._plane_row_bytes
        good = np.arange(stop - start) < rows
        track = self._array.track
        values = np.zeros(
            (stop - start, track.width), self._array.stored if track.dtype == TEXT else track.dtype
        )
        across = self._array.track.width // self._planes
        for plane, part in enumerate(parts):
            numbers = np.frombuffer(part, self._array.stored, rows * across).reshape(rows, across)
            values[:rows, plane * across : (plane + 1) * across] = numbers
        return values, good

    def _enter(self) -> None:
        """Place one stream at the beginning of each plane."""
        stream, self._row = self._array.stream(), 0
        self._streams = []
        for plane in range(self._planes):
            if plane:
                stream.skip(self._array.track.rows * self._plane_row_bytes)
            self._streams.append(stream.copy())


@dataclass
class ArrayTable(SensorTable):
    """Arrays of a file by their paths, and its single numbers and texts.

    Attributes:
        missing: bytes that a file that was cut short lacks, -1 if that is not known.
        damaged: number of entries that cannot be read.
        objects: names of entries of kinds that cannot be read.
        numbers: of the texts of tracks of texts, as far as they were read.
    """

    path: Path
    arrays: dict[str, Array] = field(default_factory=dict)
    scalars: dict[str, object] = field(default_factory=dict)
    missing: int = 0
    damaged: int = 0
    objects: list[str] = field(default_factory=list)
    numbers: dict[str, dict[str, int]] = field(default_factory=dict)
    word = "array"

    @property
    def tracks(self) -> tuple[Track, ...]:
        """All tracks of numbers, by path."""
        return tuple(track for track in self._tracks if track.dtype != TEXT)

    @property
    def text_tracks(self) -> tuple[Track, ...]:  # type: ignore[override]
        """All tracks of texts, by path."""
        return tuple(track for track in self._tracks if track.dtype == TEXT)

    @property
    def _tracks(self) -> list[Track]:
        return [self.arrays[path].track for path in sorted(self.arrays)]

    def texts_of(self, track: Track) -> list[str] | None:
        """See `SensorTable`."""
        return list(self.numbers.get(track.path, {})) if track.dtype == TEXT else None

    def add(self, array: Array, size: int) -> None:
        """Take an array in; raise UnreadableError if the file, of `size` bytes, cannot hold it."""
        if array.track.rows * array.track.width * array.stored.itemsize > size * HIGHEST_RATIO:
            raise UnreadableError(
                f"array {array.track.path} claims {array.track.rows} rows, more than the file can hold",
                path=self.path,
                hint="copy it again from its source",
            )
        self.arrays.setdefault(array.track.path, array)

    def missing_bytes(self) -> int:
        """Return the number of bytes that the file lacks at its end."""
        return self.missing

    def own(self, path: str) -> Attributes:
        """Return what is stated of an array: `unit` and `units` with its name before or behind."""
        return Attributes([self._own(path)])

    def stated(self, path: str) -> Attributes:
        """Return what is stated of an array, next to it and around it."""
        layers: list[Mapping[str, object]] = [self._own(path)]
        while True:
            path = dirname(path)
            layers.append(
                {basename(name): value for name, value in self.scalars.items() if dirname(name) == path}
            )
            if path in ("", "/"):
                return Attributes(layers)

    def _own(self, path: str) -> dict[str, object]:
        name = normalized(basename(path))
        known = {name + ending for ending in UNIT_ENDINGS} | {ending + name for ending in UNIT_ENDINGS}
        siblings = [one for one in self.scalars if dirname(one) == dirname(path)]
        unit = next((one for one in siblings if normalized(basename(one)) in known), None)
        return {} if unit is None else {"unit": self.scalars[unit]}

    def rows(self, track: Track) -> RowSource:
        """Return the rows of an array."""
        rows = ArrayRows(self.arrays[track.path])
        if track.written is not None:
            return WrittenRows(rows, track.written)
        return TextRows(rows, self.numbers.setdefault(track.path, {})) if track.dtype == TEXT else rows


class ArrayReader(TableReader):
    """Streams the rows of a plan from arrays.

    Raises:
        UnreadableError: what is packed is damaged, so that values behind that are not what was packed.
    """

    def __init__(self, plan: ReadingPlan, table: ArrayTable) -> None:
        self._table = table
        used = [table.arrays[path] for path in sorted({track.path for track in plan.tracks})]
        self._packed = any(array.offset is None for array in used)
        wrong = [array for array in used if not array.is_true()]
        for array in wrong:
            if array.offset is None:
                raise UnreadableError(
                    f"array {array.track.path} is damaged: some values are not what was packed",
                    path=table.path,
                    hint="copy it again from its source",
                )
        text = "array {}: its checksum is wrong; some of its values are not what was written"
        problems = [Problem("checksum", text.format(one.track.path), one.offset, 0) for one in wrong]
        super().__init__(replace(plan, problems=(*plan.problems, *problems)))

    @contextmanager
    def table(self) -> Iterator[ArrayTable]:
        """Return the arrays, which stay known."""
        yield self._table

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Yield up to `pieces` chunks; only the first ones if an array is packed."""
        if self._packed:
            yield from Reader.preview(self, chunk_samples, pieces)
        else:
            yield from super().preview(chunk_samples, pieces)
