"""Takes bytes from a file for readers: plain, gzip (RFC 1952) or packed with deflate (RFC 1951).

zlib-ng unpacks where it is installed (`accelcal[fast]`), else zlib. Both give the same bytes, also from
damaged data, which are unpacked byte by byte up to the first impossible one. ISA-L is faster still, but
accepts some damaged data, and so would give other bytes.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from accelcal_cli.core.errors import UnreadableError, unread
from accelcal_cli.core.formats import GZIP_MAGIC
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.recording import Closing

deflate: Any = zlib
with suppress(ImportError):
    deflate = import_module("zlib_ng.zlib_ng")

STEP_BYTES = 1 << 18
"""Packed bytes that are taken at a time."""

FIRST_BYTES = 1 << 14
"""Packed bytes at the beginning of a gzip member, doubled each time: there may be millions of short ones."""

LONGEST_TEXT, MOST_BYTES = 1 << 16, 1 << 20
"""Most bytes in a name or comment of a gzip member, and unpacked at once: zeros pack a thousandfold."""

DEFLATE = 8
"""The one compression method of gzip files."""

HEADER_CHECKSUM, EXTRA, NAME, COMMENT = 2, 4, 8, 16
"""Flags of a gzip header, one for each optional field."""

ZIP_LOCAL, IN_EXTRA = struct.Struct("<4s5HIIIHH"), 0xFFFFFFFF
"""Header before a member of a zip file (APPNOTE.TXT 6.3, 4.3.7); the size of one in the extra field."""


class ByteSource(Closing):
    """The (uncompressed) bytes of a file, from its beginning.

    A damaged gzip file ends at the same byte whatever is read at a time and whichever library unpacks it.

    Attributes:
        compressed: the file is gzip.
        file_bytes: length of the file itself.
        broken: its bytes broke off (a truncated or damaged gzip) rather than ended.
        damaged: they broke off because the gzip data is damaged inside, not only cut short.

    Args:
        threads: how many threads may work at a time; with more than one, another thread unpacks ahead.
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        """Open a file; raises UnreadableError if that fails."""
        self.path, self._ahead, self._unpacked_to = path, b"", 0
        self._fault: GzipFault | None = None
        try:
            self._file = path.open("rb")
            self.file_bytes = os.fstat(self._file.fileno()).st_size
            self.compressed = self._file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
            self._file.seek(0)
        except OSError as error:
            raise unread(error, self.path) from error
        self._pieces = prefetch(gunzipped(self._file), threads) if self.compressed else None

    @property
    def broken(self) -> bool:
        """See the class."""
        return self._fault is not None

    @property
    def damaged(self) -> bool:
        """See the class."""
        return self._fault is GzipFault.DAMAGED

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
        """Refuse gzip data that is damaged inside; any byte without a checksum of its own may be wrong."""
        if self.damaged:
            what = "the gzip data is damaged: some values are not what was compressed"
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
        """Return the number of bytes on the disk after the place where a damaged gzip broke off."""
        return max(0, os.fstat(self._file.fileno()).st_size - self._unpacked_to) if self.broken else 0

    def close(self) -> None:
        """Release the file. A failure to close costs nothing that was read, so it is ignored."""
        with suppress(OSError):
            if self._pieces is not None:
                self._pieces.close()
            self._file.close()

    def _unpacked(self, pieces: Iterator[Piece], count: int) -> bytes:
        if not self._ahead and (piece := next(pieces, None)) is not None:
            self._ahead, self._unpacked_to, self._fault = piece.data, piece.end_byte, piece.fault
        part, self._ahead = self._ahead[:count], self._ahead[count:]
        return part


class GzipFault(Enum):
    """Why the bytes of a gzip file break off."""

    CUT_OFF = "it is cut short"
    OTHER = "the bytes after its data, which were checked, are not gzip"
    DAMAGED = "it is damaged within"


@dataclass(frozen=True, slots=True)
class Piece:
    """Unpacked bytes of a gzip file up to `end_byte`; the last has a fault if the file breaks off."""

    data: bytes
    end_byte: int
    fault: GzipFault | None = None


def gunzipped(file: BinaryIO) -> Iterator[Piece]:
    """Yield the contents of a gzip file; the last piece is empty and names the fault, if there is one."""
    try:
        while _pass_header(file):
            yield from _unpack_member(file)
    except EOFError:
        yield Piece(b"", file.tell(), GzipFault.CUT_OFF)
    except _FaultError as error:
        yield Piece(b"", file.tell(), error.fault)
    else:
        yield Piece(b"", file.tell())


class _FaultError(Exception):
    def __init__(self, fault: GzipFault) -> None:
        super().__init__(fault.value)
        self.fault = fault


def _pass_header(file: BinaryIO) -> bool:
    """Read past the header of the next member; return False if there is none."""
    magic = file.read(1)
    while magic == b"\0":  # zeros may pad a file after its members
        zeros = file.read(STEP_BYTES)
        left = len(zeros.lstrip(b"\0"))
        file.seek(-left, 1)
        magic = file.read(1)
    if not magic:
        return False
    magic += file.read(1)
    if magic != GZIP_MAGIC:
        if GZIP_MAGIC.startswith(magic):
            raise EOFError
        file.seek(-len(magic), 1)
        raise _FaultError(GzipFault.OTHER)
    method, flags = _exactly(file, 8)[:2]
    if method != DEFLATE:
        raise _FaultError(GzipFault.DAMAGED)
    if flags & EXTRA:
        _exactly(file, int.from_bytes(_exactly(file, 2), "little"))
    for flag in (NAME, COMMENT):
        if flags & flag:
            _pass_text(file)
    if flags & HEADER_CHECKSUM:
        _exactly(file, 2)
    return True


def _pass_text(file: BinaryIO) -> None:
    """Read past a name or comment; raise _FaultError for one that is too long."""
    for _ in range(LONGEST_TEXT):
        if file.read(1) in (b"", b"\0"):
            return
    raise _FaultError(GzipFault.DAMAGED)


def _unpack_member(file: BinaryIO) -> Iterator[Piece]:
    """Yield the data of a member; raise _FaultError unless its checksum and length fit."""
    inflater, crc, size, step = Inflater(), 0, 0, FIRST_BYTES
    while not (inflater.complete or inflater.damaged):
        if inflater.needs_input:
            inflater.put(file.read(step) or _exactly(file, 1))
            step = min(2 * step, STEP_BYTES)
        data = inflater.take()
        crc, size = crc32(data, crc), size + len(data)
        if inflater.rest:
            file.seek(-len(inflater.rest), 1)
        if data:
            yield Piece(data, file.tell() - inflater.waiting)
    if inflater.damaged or _exactly(file, 8) != struct.pack("<II", crc, size & 0xFFFFFFFF):
        raise _FaultError(GzipFault.DAMAGED)


def _exactly(file: BinaryIO, count: int) -> bytes:
    """Read `count` bytes; raise EOFError if there are fewer."""
    data = file.read(count)
    if len(data) < count:
        raise EOFError
    return data


def crc32(data: bytes, before: int = 0) -> int:
    """Return the CRC-32 (IEEE 802.3) of bytes that follow others whose checksum is `before`."""
    return int(deflate.crc32(data, before))


class Inflater:
    """Unpacks a bare deflate stream; where a damaged one breaks off does not depend on how it is cut.

    The `rest` is the input after the end of the stream, or from the first damaged byte on.
    """

    def __init__(self) -> None:
        self._stream = deflate.decompressobj(-zlib.MAX_WBITS)
        self._waiting = self.rest = b""
        self._full = self.damaged = False

    @property
    def complete(self) -> bool:
        """Return True if the end of the stream was reached."""
        return bool(self._stream.eof)

    @property
    def needs_input(self) -> bool:
        """Return True if all input has been unpacked and the stream continues."""
        return not (self._waiting or self._full or self.damaged or self.complete)

    @property
    def waiting(self) -> int:
        """Return the number of input bytes that have not been unpacked yet."""
        return len(self._waiting)

    def put(self, packed: bytes) -> None:
        """Add the next packed bytes; only while it needs input."""
        self._waiting = packed

    def take(self, most: int = MOST_BYTES) -> bytes:
        """Return up to `most` unpacked bytes; none if it needs input or nothing follows."""
        if self.damaged or self.complete:
            return b""
        before = self._stream.copy()  # after an error its state is unknown
        try:
            data = bytes(self._stream.decompress(self._waiting, most))
        except deflate.error:
            return self._salvaged(before)
        self._waiting, self._full = self._stream.unconsumed_tail, len(data) == most
        if self.complete:
            self._waiting, self.rest = b"", self._stream.unused_data
        return data

    def _salvaged(self, before: Any) -> bytes:
        """Unpack the input byte by byte up to the first impossible byte."""
        self.damaged = True
        parts: list[bytes] = []
        for index in range(len(self._waiting)):
            try:
                parts.append(before.decompress(self._waiting[index : index + 1]))
            except deflate.error:
                self.rest = self._waiting[index:]
                break
        self._waiting = b""
        return b"".join(parts)


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
