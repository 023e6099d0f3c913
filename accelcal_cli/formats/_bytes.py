"""Takes bytes from a file for readers: plain, packed (`core/unpacking.py`), or of a member of a zip file."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from accelcal_cli.core.errors import UnreadableError, unread
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.recording import Closing
from accelcal_cli.core.unpacking import LONGEST_BEGIN, Piece, UnpackFault, packing_of, unpacked

ZIP_LOCAL, IN_EXTRA = struct.Struct("<4s5HIIIHH"), 0xFFFFFFFF
"""Header before a member of a zip file (APPNOTE.TXT 6.3, 4.3.7); the size of one in the extra field."""


class ByteSource(Closing):
    """The (uncompressed) bytes of a file, from its beginning.

    A damaged packed file ends at the same byte whatever is read at a time and whichever library unpacks it.

    Attributes:
        packing: how the file is packed; None if it is not.
        file_bytes: length of the file itself.
        broken: its bytes broke off (a truncated or damaged packed file) rather than ended.
        damaged: they broke off because the packed data is damaged inside, not only cut short.

    Args:
        threads: how many threads may work at a time; with more than one, another thread unpacks ahead.
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        """Open a file; raises UnreadableError if that fails."""
        self.path, self._ahead, self._at, self._unpacked_to = path, b"", 0, 0
        self._fault: UnpackFault | None = None
        try:
            self._file = path.open("rb")
            self.file_bytes = os.fstat(self._file.fileno()).st_size
            self.packing = packing_of(self._file.read(LONGEST_BEGIN))
            self._file.seek(0)
        except OSError as error:
            raise unread(error, self.path) from error
        packing = self.packing
        self._pieces = None if packing is None else prefetch(unpacked(self._file, packing), threads)

    @property
    def compressed(self) -> bool:
        """Return True if the file is packed."""
        return self.packing is not None

    @property
    def broken(self) -> bool:
        """See the class."""
        return self._fault is not None

    @property
    def damaged(self) -> bool:
        """See the class."""
        return self._fault is UnpackFault.DAMAGED

    def read(self, count: int) -> bytes:
        """Return up to `count` bytes, none only at the end; raises UnreadableError if the disk fails."""
        try:
            return self._file.read1(count) if self._pieces is None else self._unpacked(self._pieces, count)
        except OSError as error:
            raise unread(error, self.path) from error

    def read_exact(self, count: int) -> bytes:
        """Return `count` bytes, fewer only at the end; raises UnreadableError if the disk fails."""
        parts: list[bytes] = []
        while count > 0 and (part := self.read(count)):
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    def refuse_damaged(self) -> None:
        """Refuse packed data that is damaged inside; any byte without a checksum of its own may be wrong."""
        if self.damaged and self.packing is not None:
            what = f"the {self.packing.name} data is damaged: some values are not what was compressed"
            hint = "copy it again from its source"
            raise UnreadableError(what, path=self.path, byte_offset=self.disk_position(), hint=hint)

    def seek(self, offset: int) -> None:
        """Go to a byte; a compressed file is read up to it, and only from its beginning."""
        if self._pieces is None:
            self._file.seek(offset)
            return
        while offset > 0 and (passed := self.read(offset)):
            offset -= len(passed)

    def disk_position(self) -> int:
        """Return how far the file on the disk has been read."""
        return self._unpacked_to if self.compressed else self._file.tell()

    def undecoded(self) -> int:
        """Return the number of bytes on the disk after the place where a damaged packed file broke off."""
        return max(0, os.fstat(self._file.fileno()).st_size - self._unpacked_to) if self.broken else 0

    def close(self) -> None:
        """Release the file. A failure to close costs nothing that was read, so it is ignored."""
        with suppress(OSError):
            if self._pieces is not None:
                self._pieces.close()
            self._file.close()

    def _unpacked(self, pieces: Iterator[Piece], count: int) -> bytes:
        if self._at == len(self._ahead) and (piece := next(pieces, None)) is not None:
            self._ahead, self._unpacked_to, self._fault, self._at = piece.data, piece.end_byte, piece.fault, 0
            if self.packing is not None:
                self.packing.refuse_large(piece.fault, self.path)
        part = self._ahead[self._at : self._at + count]
        self._at += len(part)
        return part


def refuse_packed(path: Path, kind: str) -> None:
    """Raise UnreadableError for a packed file of a kind, such as `a Parquet file`, that is not read so."""
    with ByteSource(path) as source:
        if source.packing is not None:
            hint = source.packing.unpack_first(path)
            raise UnreadableError(f"is {kind} inside {source.packing.name}", path=path, hint=hint)


class ShortReads:
    """A file from which zipfile cannot read a huge directory, which it would read all at once."""

    def __init__(self, file: BinaryIO, most_bytes: int) -> None:
        """Wrap a file that is open for reading."""
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable
        self._file, self._most = file, most_bytes

    def read(self, count: int = -1) -> bytes:
        """Read up to `count` bytes; raise OSError if `count` is more than `most_bytes`."""
        if count > self._most:
            raise OSError("the directory is too long")
        return self._file.read(count)


def long_sizes(extra: bytes) -> tuple[int, int] | None:
    """Return the sizes of 64 bits, unpacked and packed, from the extra field of a zip file's header."""
    index = 0
    while index + 4 <= len(extra):
        kind, length = struct.unpack_from("<HH", extra, index)
        if kind == 1 and length >= 16 and index + 20 <= len(extra):
            unpacked_bytes, packed_bytes = struct.unpack_from("<QQ", extra, index + 4)
            return unpacked_bytes, packed_bytes
        index += 4 + length
    return None
