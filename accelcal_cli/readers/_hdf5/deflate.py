"""Gzip-packed HDF5 chunks that are too large to unpack at once, unpacked bit by bit.

The bytes of an unpacked chunk fall into planes that run side by side: one for each byte of a
number where the shuffle filter was used (all first bytes, then all second bytes, ...), and one
for each axis where the rows run along the second dimension. One pass through the packed bytes
keeps a copy of the unpacker at the beginning of each plane; then all planes advance together.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PIECE = 1 << 18


class PackedStream:
    """Unpacks a stretch of a file from its beginning; can be copied where it stands."""

    def __init__(self, path: Path, offset: int, size: int) -> None:
        self._path = path
        self._offset = offset
        self._end = offset + size
        self._unpacker = zlib.decompressobj()
        self._pending = b""

    def copy(self) -> PackedStream:
        """Another stream that goes on from the same place."""
        twin = PackedStream(self._path, self._offset, self._end - self._offset)
        twin._unpacker = self._unpacker.copy()
        twin._pending = self._pending
        return twin

    def pieces(self, count: int) -> Iterator[bytes]:
        """The next `count` bytes, in pieces; fewer where the packed bytes are damaged."""
        while count:
            if not self._pending:
                self._pending = self._packed()
            try:
                piece = self._unpacker.decompress(self._pending, min(count, PIECE))
            except zlib.error:
                return
            if not piece and (self._unpacker.eof or not self._pending):
                return
            self._pending = self._unpacker.unconsumed_tail
            count -= len(piece)
            yield piece

    def _packed(self) -> bytes:
        with self._path.open("rb") as file:
            file.seek(self._offset)
            packed = file.read(min(PIECE, self._end - self._offset))
        self._offset += len(packed)
        return packed


class DeflatedChunks:
    """Rows of a dataset whose chunks are packed with gzip, in order."""

    def __init__(self, dataset: Any, path: Path, axis: int, width: int, shuffled: bool) -> None:
        self._dataset = dataset
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
        """Rows start..stop-1 of one chunk, shape (n, width); fewer where it is damaged.

        Raises:
            OSError: the chunk is not there or cannot be read.
        """
        chunk = start // self._chunk_rows
        if chunk != self._chunk or start < self._row:
            self._enter(chunk)
        for plane in self._planes:
            self._skip(plane, (start - self._row) * self._row_bytes)
        rows = self._take(stop - start)
        self._row = stop
        return rows

    def _enter(self, chunk: int) -> None:
        """Place one stream at the beginning of each plane of a chunk."""
        self._chunk = self._row = -1
        place = [0] * self._dataset.ndim
        place[self._axis] = chunk * self._chunk_rows
        info = self._dataset.id.get_chunk_info_by_coord(tuple(place))
        if info.byte_offset is None or info.filter_mask:
            raise OSError("the chunk is absent or packed in another way")
        stream = PackedStream(self._path, info.byte_offset, info.size)
        self._planes = []
        for plane in range(self._bytes * self._axes):
            if plane:
                self._skip(stream, self._chunk_rows * self._row_bytes)
            self._planes.append(stream.copy())
        self._chunk, self._row = chunk, chunk * self._chunk_rows

    @staticmethod
    def _skip(stream: PackedStream, count: int) -> None:
        for _ in stream.pieces(count):
            pass

    def _take(self, rows: int) -> NDArray[Any]:
        """The next rows of all planes put together, as many as every plane still gives."""
        parts = [b"".join(plane.pieces(rows * self._row_bytes)) for plane in self._planes]
        rows = min(len(part) for part in parts) // self._row_bytes
        raw = np.frombuffer(b"".join(part[: rows * self._row_bytes] for part in parts), np.uint8)
        numbers = (self._axes, rows, self._width // self._axes)
        if self._bytes > 1:
            raw = np.moveaxis(raw.reshape(self._bytes, *numbers), 0, -1)
        values = np.frombuffer(raw.tobytes(), self._dataset.dtype).reshape(numbers)
        return values.transpose(1, 0, 2).reshape(rows, self._width)
