"""Rows of an HDF5 dataset in bounded memory, whole HDF5 chunks at a time, damage left out."""

from __future__ import annotations

from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.readers._hdf5.chunks import (
    LEAST_BYTES,
    MOST_BYTES,
    STORED_BYTES,
    STORED_ROWS,
    StoredChunks,
    gzip_shuffled,
)
from accelcal_cli.readers._hdf5.deflate import DeflatedChunks
from accelcal_cli.readers._hdf5.file import H5PY_ERRORS
from accelcal_cli.readers._hdf5.track import Track

BLOCK_ROWS = 65_536
STREAM_ABOVE_BYTES = 16 << 20
REFUSE_ABOVE_BYTES = 256 << 20
SMALLEST_LOSS_ROWS = 16
HIGHEST_RATIO = 1100
"""No filter in use packs rows more densely than deflate's 1032 bytes in one."""


class TrackRows:
    """Reads rows of a track in order; each HDF5 chunk is decompressed once.

    A block that cannot be read is narrowed down to the HDF5 chunks concerned; their rows, and
    those of chunks that were never written, are marked as lost.

    Args:
        pool: unpacks ahead where it can; None where one thread does all.

    Raises:
        UnreadableError: the dataset's storage is of a kind that cannot be read in parts.
    """

    def __init__(self, file: Any, track: Track, path: Path, pool: Executor | None = None) -> None:
        self._dataset = file[track.path]
        self._track = track
        self._path = path
        self._pool = pool
        self._start = self._stop = 0
        self._values = np.empty((0, track.width), track.dtype)
        self._good = np.empty(0, np.bool_)
        self._chunk_rows, self._chunk_bytes = self._chunking()
        self._refuse_unreadable()
        self._shuffled = gzip_shuffled(self._dataset, track.axis, track.width)
        self._stream = self._open_stream() if self._is_streamed() else None
        self._stored = None if self._stream else self._open_stored()
        self._has_holes = self._find_holes()

    def _chunking(self) -> tuple[int, int]:
        """Rows of one HDF5 chunk, and bytes of all chunks side by side that hold them."""
        chunks = self._dataset.chunks
        if chunks is None:
            return 1, 0
        rows = int(chunks[self._track.axis])
        wide = max(self._track.width, int(np.prod(chunks)) // max(rows, 1))
        return rows, rows * wide * self._track.dtype.itemsize

    def _has_filters(self) -> bool:
        return bool(self._dataset.id.get_create_plist().get_nfilters())

    def _is_streamed(self) -> bool:
        return self._has_filters() and self._chunk_bytes > STREAM_ABOVE_BYTES

    def _open_stored(self) -> StoredChunks | None:
        track = self._track
        if self._shuffled is None or not LEAST_BYTES <= self._chunk_bytes <= MOST_BYTES:
            return None
        return StoredChunks(self._dataset, track.axis, track.width, self._shuffled, self._pool)

    def _open_stream(self) -> DeflatedChunks | None:
        dataset, track, shuffled = self._dataset, self._track, self._shuffled
        if shuffled is not None and dataset.file.userblock_size == 0:
            return DeflatedChunks(dataset, self._path, track.axis, track.width, shuffled)
        if self._chunk_bytes > REFUSE_ABOVE_BYTES:
            raise self._refusal(
                f"is packed in chunks of {self._chunk_bytes >> 20} MB, too large to unpack at once",
                "repack it with `h5repack -l CHUNK=65536x3` (`CHUNK=65536` for one axis)",
            )
        return None

    def _refuse_unreadable(self) -> None:
        dataset, track = self._dataset, self._track
        if dataset.external or dataset.is_virtual:
            raise self._refusal("keeps its values in other files", "copy it into one file with h5repack")
        if track.rows == 0 or self._is_unwritten():
            raise self._refusal("is empty: its values were never written", "copy it again from its source")
        size = self._path.stat().st_size
        if track.rows > size * HIGHEST_RATIO:
            raise self._refusal(
                f"claims {track.rows} rows, more than the file can hold", "copy it again from its source"
            )

    def _is_unwritten(self) -> bool:
        """Whether no value was ever written; a damaged index of chunks does not tell."""
        try:
            return bool(self._dataset.id.get_storage_size() == 0)
        except H5PY_ERRORS:
            return False

    def _refusal(self, what: str, hint: str) -> UnreadableError:
        return UnreadableError(f"dataset {self._track.path} {what}", path=self._path, hint=hint)

    def _find_holes(self) -> bool:
        chunks = self._dataset.chunks
        if chunks is None:
            return False
        expected = 1
        for length, step in zip(self._dataset.shape, chunks, strict=True):
            expected *= -(-length // step)
        try:
            return bool(self._dataset.id.get_num_chunks() != expected)
        except H5PY_ERRORS:
            return True

    @property
    def path(self) -> str:
        """The dataset's path in the file."""
        return self._track.path

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self._track.width * self._track.dtype.itemsize

    def read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Rows start..stop-1, shape (stop - start, width), and which of them are not lost."""
        values, good = [], []
        row = start
        while row < stop:
            if not self._start <= row < self._stop:
                self._load(*self._block(row))
            here = slice(row - self._start, min(stop, self._stop) - self._start)
            values.append(self._values[here])
            good.append(self._good[here])
            row = min(stop, self._stop)
        if len(values) == 1:
            return values[0], good[0]
        return np.concatenate(values), np.concatenate(good)

    def _block(self, row: int) -> tuple[int, int]:
        """The rows to read together with this one: a multiple of the HDF5 chunk, or a part of it."""
        size = self._chunk_rows
        most = BLOCK_ROWS if self._stored is None else min(STORED_ROWS, STORED_BYTES // self.row_bytes)
        if size <= most:
            step = size * (most // size)
            start = row // step * step
            return start, min(start + step, self._track.rows)
        chunk = row // size * size
        in_parts = self._stream is not None or not self._has_filters()
        step = BLOCK_ROWS if in_parts else size
        start = chunk + (row - chunk) // step * step
        return start, min(start + step, chunk + size, self._track.rows)

    def _load(self, start: int, stop: int) -> None:
        self._values, self._good = self._read(start, stop)
        self._start, self._stop = start, stop
        if self._stored is not None and stop < self._track.rows:
            self._stored.begin(*self._block(stop))

    def _read(self, start: int, stop: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Rows, zero and marked where lost; what cannot be read is halved along chunk borders."""
        try:
            values = self._fetch(start, stop)
            good = self._written(start, start + len(values))
        except H5PY_ERRORS:
            middle = self._middle(start, stop)
            if middle is not None:
                (values, good), (more, sound) = self._read(start, middle), self._read(middle, stop)
                return np.concatenate((values, more)), np.concatenate((good, sound))
            values, good = np.empty((0, self._track.width), self._track.dtype), np.empty(0, np.bool_)
        lost = stop - start - len(values)
        if lost:
            values, good = np.pad(values, ((0, lost), (0, 0))), np.pad(good, (0, lost))
        return values, good

    def _middle(self, start: int, stop: int) -> int | None:
        """A chunk border near the middle; None where the rows are lost together."""
        step = self._chunk_rows * max(1, SMALLEST_LOSS_ROWS // self._chunk_rows)
        half = start + max(1, (stop - start) // 2 // step) * step
        return half if half < stop and self._stream is None else None

    def _fetch(self, start: int, stop: int) -> NDArray[Any]:
        if self._stream is not None:
            return self._stream.read(start, stop)
        if self._stored is not None and (values := self._stored.read(range(start, stop))) is not None:
            return values
        part = self._dataset[start:stop] if self._track.axis == 0 else self._dataset[:, start:stop].T
        # A copy, so that what stays lies apart from what HDF5 needed for a moment and can use again.
        return np.array(part, order="C").reshape(-1, self._track.width)

    def _written(self, start: int, stop: int) -> NDArray[np.bool_]:
        """Which rows lie in chunks that exist; HDF5 makes others up from a fill value."""
        good = np.ones(stop - start, np.bool_)
        if self._has_holes:
            first = start // self._chunk_rows * self._chunk_rows
            for row in range(first, stop, self._chunk_rows):
                if self.chunk_offset(row) is None:
                    good[max(row - start, 0) : row - start + self._chunk_rows] = False
        return good

    def chunk_offset(self, row: int) -> int | None:
        """Byte in the file of the HDF5 chunk that holds a row; None where there is none.

        Where the row's columns are in several chunks: the first one's, None if any is missing.
        """
        if self._dataset.chunks is None:
            return None
        offsets = []
        try:
            for column in self._columns():
                place = [0] * self._dataset.ndim
                place[self._track.axis] = row // self._chunk_rows * self._chunk_rows
                if column:
                    place[1 - self._track.axis] = column
                offsets.append(self._dataset.id.get_chunk_info_by_coord(tuple(place)).byte_offset)
        except H5PY_ERRORS:
            return None
        return None if None in offsets else int(offsets[0])

    def _columns(self) -> range:
        if self._dataset.ndim == 1:
            return range(1)
        return range(0, self._track.width, int(self._dataset.chunks[1 - self._track.axis]))
