"""Reads rows of an HDF5 dataset in bounded memory, whole HDF5 chunks at a time, without damaged ones.

`ChunkIndex` says which chunks the HDF5 library has stored, and which of them it cannot be trusted with.

Chunks that are packed with gzip are taken as they are stored (`StoredChunks`) and unpacked on several
threads: h5py lets nothing else run while it unpacks; zlib and numpy do. A chunk that is missing, damaged or
packed in another way than its dataset says is left to h5py.

Chunks that are too large to unpack at once are unpacked bit by bit (`DeflatedChunks`). The bytes of an
unpacked chunk fall into planes, one behind the other: one for each byte of a number where the shuffle filter
was used (all first bytes, then all second bytes, ...), and one for each axis where the rows run along the
second dimension. One pass through the packed bytes keeps a copy of the unpacker at the beginning of each
plane; then all planes advance together.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.formats._bytes import PackedStream, unpacked
from accelcal_cli.formats._tables.table import BLOCK_ROWS, REFUSE_ABOVE_BYTES, Track
from accelcal_cli.formats.hdf5.file import H5PY_ERRORS

STORED_ROWS, STORED_BYTES = 1 << 20, 6 << 20
"""Rows and bytes that are unpacked together, about what is asked for; one chunk if that has more rows."""

LEAST_BYTES, MOST_BYTES = 1 << 14, 1 << 22
"""Sizes of chunks [bytes] that are unpacked here: h5py is faster with smaller ones; few larger ones fit."""

MOST_CHUNKS = 4096
"""Chunks that are read at a time: the HDF5 library keeps a kilobyte and more of notes on each."""

STREAM_ABOVE_BYTES = 16 << 20
"""Larger chunks are unpacked bit by bit."""

SMALLEST_LOSS_ROWS = 16
"""Rows around damage that are lost together where chunks are smaller."""

LARGEST_NUMBER = 8
"""Largest number [bytes] that is put together in halves; long doubles are larger."""

MOST_CLAIMED = 200
"""Most rows that a dataset may claim for each one that was written, lest going through it takes too long."""

HIGHEST_RATIO = 1100
"""No filter in use packs rows more densely than deflate's 1032 bytes in one."""

CACHE_SLOTS = 521
SPARE_BYTES = 1 << 20
"""Room in the library's cache for other chunks than the one that is kept."""

KNOWN_SIZES = 4096
CHECKSUM_BYTES = 4
SAME_SIZE = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
"""Filters that do not change the size of a chunk, except for a checksum behind it."""


@dataclass(frozen=True, slots=True, eq=False)
class ChunkIndex:
    """Numbers of chunks along the rows, ascending.

    Attributes:
        written: chunks of which all columns were written.
        impossible: chunks of which a column has a size that its filters cannot have left.
    """

    written: NDArray[np.int64]
    impossible: NDArray[np.int64]


class ChunkSizes:
    """The sizes that the chunks of a dataset can have in the file.

    The HDF5 library (1.14 and 2.0) believes the sizes in the index of chunks. One too short for its checksum
    ends the process; one that no filter made shorter is filled up with what lies in memory.
    """

    def __init__(self, dataset: Any) -> None:
        settings = dataset.id.get_create_plist()
        self._filters = [settings.get_filter(index)[0] for index in range(settings.get_nfilters())]
        self._whole = prod(dataset.chunks) * int(dataset.id.get_type().get_size())

    def possible(self, size: int, left_out: int) -> bool:
        """Return True if a chunk can have this size; `left_out` has a bit for each unused filter."""
        used = {kind for index, kind in enumerate(self._filters) if not left_out >> index & 1}
        checksum = CHECKSUM_BYTES if h5py.h5z.FILTER_FLETCHER32 in used else 0
        if used - SAME_SIZE:
            return size > checksum
        return size in (self._whole, self._whole + checksum)


def stored_chunks(dataset: Any, axis: int, columns: range) -> ChunkIndex | None:
    """Read the index of chunks in one pass; None if it is damaged.

    Asked for one by one, the chunks of a dataset of 200 000 small ones take half a minute.

    Args:
        columns: first columns of the chunks that lie side by side, all of which must be there.
    """
    number, column, flat = array("q"), array("q"), dataset.ndim == 1
    impossible, possible = set(), lru_cache(KNOWN_SIZES)(ChunkSizes(dataset).possible)

    def see(chunk: Any) -> None:
        number.append(chunk.chunk_offset[axis])
        column.append(0 if flat else chunk.chunk_offset[1 - axis])
        if not possible(chunk.size, chunk.filter_mask):
            impossible.add(number[-1])

    try:
        dataset.id.chunk_iter(see)
    except H5PY_ERRORS:
        return None
    rows, first = np.frombuffer(number, np.int64), np.frombuffer(column, np.int64)
    found, times = np.unique(rows[first < columns.stop], return_counts=True)
    length = dataset.chunks[axis]
    odd = np.array(sorted(impossible), np.int64)
    return ChunkIndex(found[times == len(columns)] // length, odd // length)


def refuse_impossible(dataset: Any, axis: int, columns: range, rows: range, index: ChunkIndex | None) -> None:
    """Raise OSError, as h5py does elsewhere, if the library cannot be trusted with the chunks of some rows.

    Args:
        index: of all chunks; None: each is asked for.
    """
    length = dataset.chunks[axis]
    chunks = range(rows.start // length, -(-rows.stop // length))
    if index is not None:
        first, last = np.searchsorted(index.impossible, (chunks.start, chunks.stop))
        sound = first == last
    else:
        sizes = ChunkSizes(dataset)
        found = (chunk_info(dataset, axis, chunk * length, column) for chunk in chunks for column in columns)
        sound = all(i.byte_offset is None or sizes.possible(i.size, i.filter_mask) for i in found)
    if not sound:
        raise OSError("a chunk has a size that its filters cannot have left")


def chunk_info(dataset: Any, axis: int, row: int, column: int) -> Any:
    """Return the library's entry for the chunk that begins at a row and column. Raises as h5py does."""
    place = [column] * dataset.ndim
    place[axis] = row
    return dataset.id.get_chunk_info_by_coord(tuple(place))


def keeping_chunks(file: Any, path: str, size: int) -> Any:
    """Open a dataset so that chunks of `size` bytes stay unpacked until others take their place.

    Rows can then be read a few at a time, without unpacking their chunk for each of them, or holding all of
    it a second time. A dataset that is open already stays as it was opened.
    """
    access = h5py.h5p.create(h5py.h5p.DATASET_ACCESS)
    access.set_chunk_cache(CACHE_SLOTS, size + SPARE_BYTES, 1.0)
    return h5py.Dataset(h5py.h5d.open(file.id, path.encode(), access))


def gzip_shuffled(dataset: Any, axis: int, width: int) -> bool | None:
    """Return whether chunks that are nothing but gzip of all `width` columns of some rows are shuffled.

    None for any other dataset, and for numbers that are not stored as numpy knows them.
    """
    try:
        settings = dataset.id.get_create_plist()
        filters = [settings.get_filter(index) for index in range(settings.get_nfilters())]
        plain = dataset.id.get_type().equal(h5py.h5t.py_create(dataset.dtype))
        whole = dataset.ndim == 1 or dataset.chunks[1 - axis] == width
    except H5PY_ERRORS:
        return None
    kinds = [item[0] for item in filters]
    shuffled = kinds == [h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE]
    if shuffled and filters[0][2] != (dataset.dtype.itemsize,):
        return None
    known = shuffled or kinds == [h5py.h5z.FILTER_DEFLATE]
    return shuffled if known and plain and whole else None


class StoredChunks:
    """Unpacks rows of a dataset, along its axis `axis`, whose chunks `gzip_shuffled` knows.

    Args:
        pool: unpacks several chunks at a time, and the next ones ahead; None: one by one.
    """

    def __init__(self, dataset: Any, axis: int, width: int, shuffled: bool, pool: Executor | None) -> None:
        self._id = dataset.id
        self._dtype = dataset.dtype
        self._ndim = dataset.ndim
        self._axis = axis
        self._width = width
        self._rows = int(dataset.chunks[axis])
        self._bytes = self._rows * width * self._dtype.itemsize
        self._bytes_apart = self._dtype.itemsize if shuffled else 1
        self._pool = pool
        self._begun: tuple[range, NDArray[Any], Iterator[bool]] | None = None

    def begin(self, start: int, stop: int) -> None:
        """Have the pool unpack rows that will be read next."""
        if self._pool is not None:
            self._begun = self._unpacking(range(start, stop))

    def read(self, rows: range) -> NDArray[Any] | None:
        """Return rows (n, width), from the first one of a chunk; None if h5py has to read them.

        Raises:
            OSError: a chunk holds too little; h5py would make it up from what lies in memory.
        """
        begun, self._begun = self._begun, None
        _, values, done = begun if begun is not None and begun[0] == rows else self._unpacking(rows)
        return values if all(list(done)) else None

    def _unpacking(self, rows: range) -> tuple[range, NDArray[Any], Iterator[bool]]:
        """Return the rows, their values to be, and an iterator that fills these in, chunk by chunk."""
        values = np.empty((len(rows), self._width), self._dtype)
        places = range(0, len(rows), self._rows)
        parts = [values[place : place + self._rows] for place in places]
        each = map if self._pool is None else self._pool.map
        return rows, values, each(self._unpack, rows[:: self._rows], parts)

    def _unpack(self, row: int, into: NDArray[Any]) -> bool:
        """Put the chunk that begins with a row in its place, cut at the dataset's end."""
        raw = self._raw(row)
        if raw is None or len(raw) > self._bytes:
            return False
        if len(raw) < self._bytes:
            raise OSError("a chunk holds too little")
        values = unshuffled(raw, self._bytes_apart).view(self._dtype)
        rows = values.reshape(self._width, -1).T if self._axis else values.reshape(-1, self._width)
        into[:] = rows[: len(into)]
        return True

    def _raw(self, row: int) -> bytes | None:
        """Return a chunk by its first row, unpacked; None if it is absent, damaged or packed otherwise."""
        place = [0] * self._ndim
        place[self._axis] = row
        try:
            filters_left_out, packed = self._id.read_direct_chunk(tuple(place))
            return None if filters_left_out else unpacked(packed, self._bytes)
        except H5PY_ERRORS:
            return None


def unshuffled(raw: bytes, size: int) -> NDArray[Any]:
    """Undo the shuffle filter: all first bytes of numbers of `size`, then all second ones, ...

    Neighbours are put together two by two, so that each step works on whole numbers.
    """
    parts: NDArray[Any] = np.frombuffer(raw, np.uint8).reshape(size, -1)
    if size > LARGEST_NUMBER:
        return np.ascontiguousarray(parts.T).reshape(-1)
    while len(parts) > 1:
        wide = parts[1::2].astype(f"<u{2 * parts.itemsize}")
        wide <<= 8 * parts.itemsize
        wide |= parts[::2]
        parts = wide
    return parts.reshape(-1)


class DeflatedChunks:
    """Rows of a dataset whose chunks are packed with gzip, in order."""

    def __init__(self, dataset: Any, path: Path, axis: int, width: int, shuffled: bool) -> None:
        self.dataset = dataset
        self._path = path
        self._axis = axis
        self._width = width
        self._chunk_rows = int(dataset.chunks[axis])
        self._bytes = dataset.dtype.itemsize if shuffled else 1
        self._axes = width if axis == 1 else 1
        self._row_bytes = dataset.dtype.itemsize * width // (self._bytes * self._axes)
        self._chunk = self._row = -1
        self._planes: list[PackedStream] = []

    def read(self, start: int, stop: int) -> NDArray[Any]:
        """Return rows start..stop-1 of one chunk, shape (n, width); fewer if it is damaged.

        Raises:
            OSError: the chunk is not there or cannot be read.
        """
        chunk = start // self._chunk_rows
        if chunk != self._chunk or start < self._row:
            self._enter(chunk)
        for plane in self._planes:
            plane.skip((start - self._row) * self._row_bytes)
        rows = self._take(stop - start)
        self._row = stop
        return rows

    def _enter(self, chunk: int) -> None:
        """Place one stream at the beginning of each plane of a chunk."""
        self._chunk = self._row = -1
        place = [0] * self.dataset.ndim
        place[self._axis] = chunk * self._chunk_rows
        info = self.dataset.id.get_chunk_info_by_coord(tuple(place))
        if info.byte_offset is None or info.filter_mask:
            raise OSError("the chunk is absent or packed in another way")
        stream = PackedStream(self._path, info.byte_offset, info.size)
        self._planes = []
        for plane in range(self._bytes * self._axes):
            if plane:
                stream.skip(self._chunk_rows * self._row_bytes)
            self._planes.append(stream.copy())
        self._chunk, self._row = chunk, chunk * self._chunk_rows

    def _take(self, rows: int) -> NDArray[Any]:
        """Return the next rows of all planes put together, as many as every plane still gives."""
        parts = [b"".join(plane.pieces(rows * self._row_bytes)) for plane in self._planes]
        rows = min(len(part) for part in parts) // self._row_bytes
        raw = np.frombuffer(b"".join(part[: rows * self._row_bytes] for part in parts), np.uint8)
        numbers = (self._axes, rows, self._width // self._axes)
        if self._bytes > 1:
            raw = np.moveaxis(raw.reshape(self._bytes, *numbers), 0, -1)
        values = np.frombuffer(raw.tobytes(), self.dataset.dtype).reshape(numbers)
        return values.transpose(1, 0, 2).reshape(rows, self._width)


class TrackRows:
    """Reads rows of a track in order; each HDF5 chunk is decompressed once.

    A block that cannot be read is narrowed down to the HDF5 chunks concerned; their rows, and the rows of
    chunks that were never written, are marked as lost.

    Args:
        pool: unpacks ahead where it can; None if one thread does all.
        indexes: indexes of chunks by the paths of datasets, kept for the next time that they are opened.

    Raises:
        UnreadableError: the dataset's storage is of a kind that cannot be read in parts.
    """

    def __init__(
        self,
        file: Any,
        track: Track,
        path: Path,
        pool: Executor | None = None,
        indexes: dict[str, ChunkIndex | None] | None = None,
    ) -> None:
        self.dataset = file[track.path]
        self._track = track
        self._path = path
        self._pool = pool
        self._start = self._stop = 0
        self._values = np.empty((0, track.width), track.dtype)
        self._good = np.empty(0, np.bool_)
        self._chunk_rows, self._chunk_bytes = self._chunking()
        self._refuse_unreadable()
        self._shuffled = gzip_shuffled(self.dataset, track.axis, track.width)
        streamed = self._has_filters() and self._chunk_bytes > STREAM_ABOVE_BYTES
        self._stream = self._open_stream() if streamed else None
        self._stored = None if self._stream else self._open_stored()
        self._broken = -1
        self.kept_bytes = self._chunk_bytes if streamed and self._stream is None else 0
        if self.kept_bytes:
            self.dataset = None
            self.dataset = keeping_chunks(file, track.path, self.kept_bytes)
        self._has_holes = self._find_holes()
        self._indexes = {} if indexes is None else indexes
        index = self._index() if self._has_holes else None
        self._written_chunks = None if index is None else index.written
        self._refuse_hardly_written()

    def _chunking(self) -> tuple[int, int]:
        """Return the rows of one HDF5 chunk, and the bytes of all chunks side by side that hold them."""
        chunks = self.dataset.chunks
        if chunks is None:
            return 1, 0
        rows = int(chunks[self._track.axis])
        wide = max(self._track.width, int(np.prod(chunks)) // max(rows, 1))
        return rows, rows * wide * self._track.dtype.itemsize

    def _has_filters(self) -> bool:
        return bool(self.dataset.id.get_create_plist().get_nfilters())

    def _open_stored(self) -> StoredChunks | None:
        track = self._track
        if self._shuffled is None or not LEAST_BYTES <= self._chunk_bytes <= MOST_BYTES:
            return None
        return StoredChunks(self.dataset, track.axis, track.width, self._shuffled, self._pool)

    def _open_stream(self) -> DeflatedChunks | None:
        dataset, track, shuffled = self.dataset, self._track, self._shuffled
        if shuffled is not None and dataset.file.userblock_size == 0:
            return DeflatedChunks(dataset, self._path, track.axis, track.width, shuffled)
        if self._chunk_bytes > REFUSE_ABOVE_BYTES:
            raise self._refusal(
                f"is packed in chunks of {self._chunk_bytes >> 20} MB, too large to unpack at once",
                "repack it with `h5repack -l CHUNK=65536x3` (`CHUNK=65536` for one axis)",
            )
        return None

    def _refuse_unreadable(self) -> None:
        dataset, track = self.dataset, self._track
        if dataset.external or dataset.is_virtual:
            raise self._refusal("keeps its values in other files", "copy it into one file with h5repack")
        if track.rows == 0 or self._is_unwritten():
            raise self._refusal("is empty: its values were never written", "copy it again from its source")
        size = self._path.stat().st_size
        if track.rows > size * HIGHEST_RATIO:
            raise self._refusal(
                f"claims {track.rows} rows, more than the file can hold", "copy it again from its source"
            )

    def _refuse_hardly_written(self) -> None:
        if not self._has_holes or self._written_chunks is None:
            return
        written = len(self._written_chunks) * self._chunk_rows
        if written * MOST_CLAIMED < self._track.rows:
            raise self._refusal(
                f"claims {self._track.rows} rows, of which only {written} were ever written",
                "copy it again from its source",
            )

    def _is_unwritten(self) -> bool:
        """Return True if no value was ever written; a damaged index of chunks does not tell."""
        try:
            return bool(self.dataset.id.get_storage_size() == 0)
        except H5PY_ERRORS:
            return False

    def _refusal(self, what: str, hint: str) -> UnreadableError:
        return UnreadableError(f"dataset {self._track.path} {what}", path=self._path, hint=hint)

    def _find_holes(self) -> bool:
        chunks = self.dataset.chunks
        if chunks is None:
            return False
        expected = prod(-(-length // step) for length, step in zip(self.dataset.shape, chunks, strict=True))
        try:
            return bool(self.dataset.id.get_num_chunks() != expected)
        except H5PY_ERRORS:
            return True

    def _index(self) -> ChunkIndex | None:
        """Return the index of all chunks; None if each has to be asked for."""
        if self.path not in self._indexes:
            self._indexes[self.path] = stored_chunks(self.dataset, self._track.axis, self._columns())
        return self._indexes[self.path]

    @property
    def path(self) -> str:
        """The dataset's path in the file."""
        return self._track.path

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self._track.width * self._track.dtype.itemsize

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows start..stop-1, shape (stop - start, width), and flags of those that are not lost."""
        values, good = [], []
        row = start
        while row < stop:
            if not self._start <= row < self._stop:
                self._start, self._stop = self.block(row)
                self._values, self._good = self._read(self._start, self._stop)
                if self._stored is not None and self._stop < self._track.rows:
                    self._stored.begin(*self.block(self._stop))
            here = slice(row - self._start, min(stop, self._stop) - self._start)
            values.append(self._values[here])
            good.append(self._good[here])
            row = min(stop, self._stop)
        if len(values) == 1:
            return values[0], good[0]
        return np.concatenate(values), np.concatenate(good)

    def block(self, row: int) -> tuple[int, int]:
        """Return the rows to read together with this one: a multiple of the HDF5 chunk, or a part of it."""
        size = self._chunk_rows
        most = BLOCK_ROWS if self._stored is None else min(STORED_ROWS, STORED_BYTES // self.row_bytes)
        if size <= most:
            side_by_side = 1 if self.dataset.chunks is None else len(self._columns())
            chunks = most if self.dataset.chunks is None else max(1, MOST_CHUNKS // side_by_side)
            step = size * min(most // size, chunks)
            start = row // step * step
            return start, min(start + step, self._track.rows)
        chunk = row // size * size
        in_parts = self._stream is not None or self.kept_bytes or not self._has_filters()
        step = BLOCK_ROWS if in_parts else size
        start = chunk + (row - chunk) // step * step
        return start, min(start + step, chunk + size, self._track.rows)

    def _read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows, zero and marked where lost; unwritten ends are not read, which would be slow."""
        written = np.flatnonzero(self._written(start, stop)) if self._has_holes else range(stop - start)
        if not len(written):
            return np.zeros((stop - start, self._track.width), self._track.dtype), np.zeros(
                stop - start, bool
            )
        before, end = int(written[0]), int(written[-1]) + 1
        values, good = self._read_between(start + before, start + end)
        behind = stop - start - end
        if before or behind:
            values, good = np.pad(values, ((before, behind), (0, 0))), np.pad(good, (before, behind))
        return values, good

    def _read_between(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return rows as `_read` does; rows that cannot be read are halved along chunk borders."""
        try:
            values = self.fetch(start, stop)
            good = self._written(start, start + len(values))
        except H5PY_ERRORS:
            middle = self._middle(start, stop)
            if middle is not None:
                (values, good), (more, sound) = self._read(start, middle), self._read(middle, stop)
                return np.concatenate((values, more)), np.concatenate((good, sound))
            values, good = np.empty((0, self._track.width), self._track.dtype), np.empty(0, np.bool_)
            self._broken = start // self._chunk_rows
        lost = stop - start - len(values)
        if lost:
            values, good = np.pad(values, ((0, lost), (0, 0))), np.pad(good, (0, lost))
        return values, good

    def _middle(self, start: int, stop: int) -> int | None:
        """Return a chunk border near the middle; None if the rows are lost together."""
        step = self._chunk_rows * max(1, SMALLEST_LOSS_ROWS // self._chunk_rows)
        half = start + max(1, (stop - start) // 2 // step) * step
        return half if half < stop and self._stream is None else None

    def fetch(self, start: int, stop: int) -> NDArray[Any]:
        """Return rows start..stop-1, (n, width); fewer if a stream breaks off. Raises as h5py does."""
        if self._stream is not None:
            return self._stream.read(start, stop)
        if self._stored is not None and (values := self._stored.read(range(start, stop))) is not None:
            return values
        if self.kept_bytes and start // self._chunk_rows == self._broken:
            raise OSError("the chunk could not be unpacked before")
        if self.dataset.chunks is not None:
            rows = range(start, stop)
            refuse_impossible(self.dataset, self._track.axis, self._columns(), rows, self._index())
        part = self.dataset[start:stop] if self._track.axis == 0 else self.dataset[:, start:stop].T
        # A copy, so that what stays lies apart from what HDF5 needed for a moment and can use again.
        return np.array(part, order="C").reshape(-1, self._track.width)

    def _written(self, start: int, stop: int) -> NDArray[np.bool_]:
        """Return flags of rows in chunks that exist; HDF5 makes others up from a fill value."""
        if not self._has_holes:
            return np.ones(stop - start, np.bool_)
        size = self._chunk_rows
        chunks = np.arange(start // size, -(-stop // size))
        if self._written_chunks is None:
            written = np.array([self.chunk_offset(chunk * size) is not None for chunk in chunks.tolist()])
        else:
            first, end = np.searchsorted(self._written_chunks, chunks[[0, -1]] + [0, 1])
            written = np.isin(chunks, self._written_chunks[first:end])
        return np.repeat(written, size)[start % size :][: stop - start]

    def chunk_offset(self, row: int) -> int | None:
        """Return the byte in the file of the HDF5 chunk that holds a row; None if there is none.

        If the row's columns are in several chunks, it is that of the first one, None if any is missing.
        """
        if self.dataset.chunks is None:
            return None
        row, axis = row // self._chunk_rows * self._chunk_rows, self._track.axis
        try:
            offsets = [chunk_info(self.dataset, axis, row, at).byte_offset for at in self._columns()]
        except H5PY_ERRORS:
            return None
        return None if None in offsets else int(offsets[0])

    def _columns(self) -> range:
        if self.dataset.ndim == 1:
            return range(1)
        return range(0, self._track.width, int(self.dataset.chunks[1 - self._track.axis]))
