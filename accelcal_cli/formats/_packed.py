"""Bytes of a file, plain or packed with deflate, taken in order and from several places at a time."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

PIECE = 1 << 18


class PackedStream:
    """Unpacks a stretch of a file from its beginning; can be copied where it stands.

    Attributes:
        untrue: whether the packed bytes were seen to be damaged, not only cut short.

    Args:
        offset, size: of the packed bytes.
        bare: deflate without the head and the checksum of zlib, as in zip files.
    """

    def __init__(self, path: Path, offset: int, size: int, *, bare: bool = False) -> None:
        self._path = path
        self._bare = bare
        self._offset = offset
        self._end = offset + size
        self._unpacker = zlib.decompressobj(-zlib.MAX_WBITS if bare else zlib.MAX_WBITS)
        self._pending = b""
        self.untrue = False

    def copy(self) -> PackedStream:
        """Another stream that goes on from the same place."""
        twin = PackedStream(self._path, self._offset, self._end - self._offset, bare=self._bare)
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
                self.untrue = True
                return
            if not piece and (self._unpacker.eof or not self._pending):
                return
            self._pending = self._unpacker.unconsumed_tail
            count -= len(piece)
            yield piece

    def skip(self, count: int) -> None:
        """Leave out bytes, as far as they can be unpacked."""
        for _ in self.pieces(count):
            pass

    def _packed(self) -> bytes:
        with self._path.open("rb") as file:
            file.seek(self._offset)
            packed = file.read(min(PIECE, self._end - self._offset))
        self._offset += len(packed)
        return packed


class PlainStream:
    """A stretch of a file as it is; the same contract."""

    def __init__(self, path: Path, offset: int, size: int) -> None:
        self._path, self._offset, self._end = path, offset, offset + size

    def copy(self) -> PlainStream:
        """Another stream that goes on from the same place."""
        return PlainStream(self._path, self._offset, self._end - self._offset)

    def pieces(self, count: int) -> Iterator[bytes]:
        """The next `count` bytes, in one piece; fewer where the file ends."""
        with self._path.open("rb") as file:
            file.seek(self._offset)
            piece = file.read(max(0, min(count, self._end - self._offset)))
        self._offset += len(piece)
        if piece:
            yield piece

    def skip(self, count: int) -> None:
        """Leave out bytes."""
        self._offset = min(self._offset + count, self._end)
