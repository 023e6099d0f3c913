"""What deflate packed, unpacked step by step: bare streams (RFC 1951), and gzip files (RFC 1952).

zlib-ng unpacks where it is installed (`accelcal[fast]`), else zlib. Both give the same bytes, also of damaged
data: these are unpacked byte by byte up to the first that fits nowhere. ISA-L, faster still, takes some
damaged data for sound, and so would give others.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from typing import Any, BinaryIO

from accelcal_cli.core.formats import GZIP_MAGIC

deflate: Any = zlib
with suppress(ImportError):
    deflate = import_module("zlib_ng.zlib_ng")

STEP_BYTES = 1 << 18
"""Packed bytes that are taken from a file at a time."""

MOST_BYTES = 1 << 20
"""Of unpacked bytes at once: damaged or empty stretches unpack to a thousand times their size."""

DEFLATE = 8
"""The one method of gzip files."""

HEADER_CHECKSUM, EXTRA, NAME, COMMENT = 2, 4, 8, 16
"""Flags of what a gzip header holds."""


def crc32(data: bytes, before: int = 0) -> int:
    """CRC-32 (IEEE 802.3) of bytes that follow others of this checksum."""
    return int(deflate.crc32(data, before))


def unpacked(packed: bytes, size: int) -> bytes | None:
    """What a whole zlib stream (RFC 1950) holds, about `size` bytes; None if it is damaged."""
    try:
        return bytes(deflate.decompress(packed, bufsize=size))
    except deflate.error:
        return None


class Inflater:
    """Unpacks a bare stream; where a damaged one breaks off does not depend on how much is put in at a time.

    Attributes:
        damaged: nothing more can be unpacked.
        rest: bytes that were put in, and lie behind the end of the stream or where it is damaged.
    """

    def __init__(self) -> None:
        self._stream = deflate.decompressobj(-zlib.MAX_WBITS)
        self._waiting = b""
        self._full = False
        self.damaged = False
        self.rest = b""

    @property
    def complete(self) -> bool:
        """Whether the end of the stream was reached."""
        return bool(self._stream.eof)

    @property
    def hungry(self) -> bool:
        """Whether all that was put in has been unpacked, and more is needed."""
        return not (self._waiting or self._full or self.damaged or self.complete)

    @property
    def waiting(self) -> int:
        """How many bytes that were put in have not been unpacked yet."""
        return len(self._waiting)

    def put(self, packed: bytes) -> None:
        """The next packed bytes, once it is hungry."""
        self._waiting = packed

    def take(self, most: int = MOST_BYTES) -> bytes:
        """The next unpacked bytes, at most so many; none where more must be put in, or nothing follows."""
        if self.damaged or self.complete:
            return b""
        before = self._stream.copy()
        try:
            data = bytes(self._stream.decompress(self._waiting, most))
        except deflate.error:
            return self._salvaged(before)
        self._waiting, self._full = self._stream.unconsumed_tail, len(data) == most
        if self.complete:
            self._waiting, self.rest = b"", self._stream.unused_data
        return data

    def _salvaged(self, before: Any) -> bytes:
        """What comes before the first byte that fits nowhere."""
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


class GzipFault(Enum):
    """Why a gzip file does not go on."""

    CUT_OFF = "it is cut short"
    OTHER = "what follows its data, which were checked, is no gzip"
    DAMAGED = "it is damaged within"


@dataclass(frozen=True, slots=True)
class Piece:
    """Unpacked bytes of a gzip file.

    Attributes:
        end_byte: how far the file has been unpacked with them.
        fault: after the last bytes: why there are no more.
    """

    data: bytes
    end_byte: int
    fault: GzipFault | None = None


def gunzipped(file: BinaryIO) -> Iterator[Piece]:
    """A gzip file's bytes, in pieces; without any at the end, where a fault may be told.

    Raises:
        OSError: the disk fails.
    """
    try:
        while _header(file):
            yield from _member(file)
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


def _header(file: BinaryIO) -> bool:
    """Pass over a member's header; whether there is one. Zeros may fill up a file behind its members."""
    magic = file.read(1)
    while magic == b"\0":
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
        while flags & flag and file.read(1) not in (b"", b"\0"):
            pass
    if flags & HEADER_CHECKSUM:
        _exactly(file, 2)
    return True


def _member(file: BinaryIO) -> Iterator[Piece]:
    """The data of a member, which its checksum and length must fit."""
    inflater, crc, size = Inflater(), 0, 0
    while not (inflater.complete or inflater.damaged):
        if inflater.hungry:
            inflater.put(_some(file))
        data = inflater.take()
        crc, size = crc32(data, crc), size + len(data)
        if inflater.rest:
            file.seek(-len(inflater.rest), 1)
        if data:
            yield Piece(data, file.tell() - inflater.waiting)
    if inflater.damaged or _exactly(file, 8) != struct.pack("<II", crc, size & 0xFFFFFFFF):
        raise _FaultError(GzipFault.DAMAGED)


def _some(file: BinaryIO) -> bytes:
    return _exactly(file, 1) if not (data := file.read(STEP_BYTES)) else data


def _exactly(file: BinaryIO, count: int) -> bytes:
    """So many bytes; raises EOFError if there are fewer."""
    data = file.read(count)
    if len(data) < count:
        raise EOFError
    return data
