"""Files that are packed with gzip, bzip2, xz or Zstandard: how each is known, and what is in it.

Gzip (RFC 1952) is unpacked with zlib-ng where that is installed (`accelcal[fast]`), else with zlib. Both give
the same bytes, also from damaged data, which are unpacked byte by byte up to the first impossible one. ISA-L
is faster still, but accepts some damaged data, and so would give other bytes. bzip2 and xz are unpacked by
the standard library, Zstandard by Arrow.
"""

from __future__ import annotations

import re
import shlex
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from accelcal_cli.core.errors import UnreadableError, printable

deflate: Any = zlib
with suppress(ImportError):
    deflate = import_module("zlib_ng.zlib_ng")

STEP_BYTES, FIRST_BYTES = 1 << 18, 1 << 14
"""Packed bytes that are taken at a time, and first of a gzip member: there may be millions of short ones."""

LONGEST_TEXT, MOST_BYTES = 1 << 16, 1 << 20
"""Most bytes in a name or comment of a gzip member, and unpacked at once: zeros pack a thousandfold."""

GZIP_MAGIC = b"\x1f\x8b"
XZ_MEMORY = 1 << 27
"""Most memory for the dictionary of an xz file."""

DEFLATE = 8
"""The one compression method of gzip files."""

HEADER_CHECKSUM, EXTRA, NAME, COMMENT = 2, 4, 8, 16
"""Flags of a gzip header, one for each optional field."""


class UnpackFault(Enum):
    """Why the bytes of a packed file break off."""

    CUT_OFF = "it is cut short"
    OTHER = "the bytes after its data, which were checked, are something else"
    DAMAGED = "it is damaged within"
    TOO_LARGE = "unpacking it takes more than 128 MB of memory"


@dataclass(frozen=True, slots=True)
class Piece:
    """Unpacked bytes of a file up to `end_byte`; the last has a fault if the file breaks off."""

    data: bytes
    end_byte: int
    fault: UnpackFault | None = None


class _FaultError(Exception):
    def __init__(self, fault: UnpackFault) -> None:
        super().__init__(fault.value)
        self.fault = fault


class PackedBytes:
    """The bytes of a packed file from its beginning; those that were read last can be put back."""

    closed, at_once = False, MOST_BYTES

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._data, self._at = file, b"", 0

    def read(self, count: int) -> bytes:
        """Return `count` bytes, fewer only at the end of the file; never more than `at_once`."""
        count = min(count, self.at_once)
        self._fill(count)
        part = self._data[self._at : self._at + count]
        self._at += len(part)
        return part

    def exactly(self, count: int) -> bytes:
        """Return `count` bytes; raise EOFError if there are fewer."""
        if len(data := self.read(count)) < count:
            raise EOFError
        return data

    def put_back(self, count: int) -> None:
        """Put back some of the bytes that were read last."""
        self._at -= count

    def tell(self) -> int:
        """Return the place of the next byte in the file."""
        return self._file.tell() - len(self._data) + self._at

    def pass_over(self, pattern: bytes) -> None:
        """Read past any number of short stretches that fit a pattern."""
        several, at = re.compile(rb"(?s:" + pattern + rb")*+"), -1
        while self.tell() > at:
            at = self.tell()
            self._fill(FIRST_BYTES)
            found = several.match(self._data, self._at)
            self._at = self._at if found is None else found.end()

    def begin_again(self) -> None:
        """Go back to the beginning of the file."""
        self._file.seek(0)
        self._data, self._at = b"", 0

    def close(self) -> None:
        """Do nothing: Arrow closes what it has read, and a file is closed by who opened it."""

    def _fill(self, count: int) -> None:
        """Take bytes from the file until `count` are there, fewer only at its end."""
        if self._at + count > len(self._data):
            self._data, self._at = self._data[self._at :] + self._file.read(max(count, STEP_BYTES)), 0


@dataclass(frozen=True, slots=True)
class Packing:
    """A way to pack a file, as one member or several.

    Attributes:
        suffix: usual end of the names of such files.
        command: program that unpacks them, with -k into a file next to it, with -c to where it is piped.
        magic: first bytes of each member; begins: pattern of these, and of more that tells them from others.
        pieces: yields what is in the next member, which is there; raises EOFError if it is cut short.
        empty: pattern of a member without content, of which a file may have millions; else it fits nothing.
    """

    name: str
    suffix: str
    command: str
    magic: bytes
    begins: bytes
    pieces: Callable[[PackedBytes], Iterator[Piece]]
    empty: bytes = rb"(?!)"

    def unpack_first(self, path: Path) -> str:
        """Return the hint to unpack a file that is not read packed."""
        return f"unpack it first: {self.command} -k {shlex.quote(printable(path))}"

    def refuse_large(self, fault: UnpackFault | None, path: Path) -> None:
        """Raise UnreadableError for a file that takes too much memory."""
        if fault is UnpackFault.TOO_LARGE:
            raise UnreadableError(fault.value, path=path, hint=self.unpack_first(path))


def unpacked(file: BinaryIO, packing: Packing) -> Iterator[Piece]:
    """Yield the contents of a packed file; the last piece is empty and names the fault, if there is one."""
    source, fault = PackedBytes(file), None
    try:
        while _has_member(source, packing):
            yield from packing.pieces(source)
    except EOFError:
        fault = UnpackFault.CUT_OFF
    except _FaultError as error:
        fault = error.fault
    yield Piece(b"", source.tell(), fault)


def _has_member(source: PackedBytes, packing: Packing) -> bool:
    """Return True if another member follows; raise EOFError or _FaultError for other bytes."""
    source.pass_over(packing.empty + rb"|\0")  # zeros may pad a file after its members
    begin = source.read(LONGEST_BEGIN)
    if begin and packing.magic.startswith(begin):
        raise EOFError
    source.put_back(len(begin))
    if begin and not re.match(packing.begins, begin):
        raise _FaultError(UnpackFault.OTHER)
    return bool(begin)


def _gzip_pieces(source: PackedBytes) -> Iterator[Piece]:
    """Yield the data of a member; raise _FaultError unless its checksum and length fit."""
    _pass_header(source)
    inflater, crc, size, step = Inflater(), 0, 0, FIRST_BYTES
    while not (inflater.complete or inflater.damaged):
        if inflater.needs_input:
            inflater.put(source.read(step) or source.exactly(1))
            step = min(2 * step, STEP_BYTES)
        data = inflater.take()
        crc, size = crc32(data, crc), size + len(data)
        source.put_back(len(inflater.rest))
        if data:
            yield Piece(data, source.tell() - inflater.waiting)
    if inflater.damaged or source.exactly(8) != struct.pack("<II", crc, size & 0xFFFFFFFF):
        raise _FaultError(UnpackFault.DAMAGED)


def _pass_header(source: PackedBytes) -> None:
    """Read past the header of a member; raise _FaultError for one that no file has."""
    method, flags = source.exactly(10)[2:4]
    if method != DEFLATE:
        raise _FaultError(UnpackFault.DAMAGED)
    if flags & EXTRA:
        source.exactly(int.from_bytes(source.exactly(2), "little"))
    for flag in (NAME, COMMENT):
        if flags & flag:
            text = source.read(LONGEST_TEXT)
            end = text.find(b"\0")
            if end < 0 and len(text) == LONGEST_TEXT:
                raise _FaultError(UnpackFault.DAMAGED)
            source.put_back(len(text) - end - 1 if end >= 0 else 0)
    if flags & HEADER_CHECKSUM:
        source.exactly(2)


def _bzip2_stream() -> Any:
    import bz2  # few files are packed like this

    return bz2.BZ2Decompressor()


def _xz_stream() -> Any:
    import lzma  # few files are packed like this

    return lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=XZ_MEMORY)


def _stream_pieces(begin: Callable[[], Any], source: PackedBytes) -> Iterator[Piece]:
    """Yield the data of a member as a decompressor of the standard library gives them."""
    stream = begin()
    while not stream.eof:
        packed = (source.read(FIRST_BYTES) or source.exactly(1)) if stream.needs_input else b""
        try:
            data = stream.decompress(packed, MOST_BYTES)
        except Exception as error:  # of bz2 an OSError; LZMAError is no more than an Exception
            large = "Memory usage limit" in str(error)
            raise _FaultError(UnpackFault.TOO_LARGE if large else UnpackFault.DAMAGED) from error
        if data:
            yield Piece(data, source.tell())
    source.put_back(len(stream.unused_data))


def _zstd_pieces(source: PackedBytes) -> Iterator[Piece]:
    """Yield the data of all members, as Arrow unpacks them; where it fails, byte by byte up to that place."""
    import pyarrow as pa  # few files are packed like this

    def opened() -> Any:
        return pa.CompressedInputStream(pa.PythonFile(source, "r"), "zstd")

    stream, steps = opened(), 0
    try:
        while data := stream.read(FIRST_BYTES):
            steps += 1
            yield Piece(data, source.tell())
    except OSError as error:
        if error.errno is not None:  # of the disk
            raise
        source.begin_again()
        source.at_once = 256  # what is unpacked together with the fault is lost
        stream = opened()
        for _ in range(steps):
            stream.read(FIRST_BYTES)
        with suppress(OSError):
            while data := stream.read(1):
                yield Piece(data, source.tell())
        if "Truncated" in str(error):
            raise EOFError from error
        faults = (fault for words, fault in ZSTD_FAULTS.items() if words in str(error))
        raise _FaultError(next(faults, UnpackFault.DAMAGED)) from error


ZSTD_FAULTS = {
    "Unknown frame descriptor": UnpackFault.OTHER,
    "too much memory": UnpackFault.TOO_LARGE,
}
"""Parts of what the library of Zstandard says."""

PACKINGS = (
    Packing(
        *("gzip", ".gz", "gunzip"),
        GZIP_MAGIC,
        GZIP_MAGIC,
        _gzip_pieces,
        rb"\x1f\x8b\x08(?:\0.{6}|\x08.{6}[^\0]{1,255}\0|\x04.{6}\x06\0.{6})"
        rb"(?:\x03\0|\x01\0\0\xff\xff)\0{8}",
    ),
    Packing(
        *("bzip2", ".bz2", "bunzip2"),
        b"BZh",
        rb"BZh[1-9](?:1AY&SY|\x17rE8P\x90)",
        partial(_stream_pieces, _bzip2_stream),
        rb"BZh[1-9]\x17rE8P\x90\0{4}",
    ),
    Packing(
        *("xz", ".xz", "unxz"),
        b"\xfd7zXZ\0",
        b"\xfd7zXZ\0",
        partial(_stream_pieces, _xz_stream),
        rb"\xfd7zXZ\0.{6}\0{4}\x1c\xdf\x44\x21.{10}YZ",
    ),
    Packing(
        *("Zstandard", ".zst", "unzstd"),
        b"\x28\xb5\x2f\xfd",
        rb"\x28\xb5\x2f\xfd|\x50\x2a\x4d\x18",
        _zstd_pieces,
    ),
)
"""All packings that are read; one of Zstandard may begin with a frame to be skipped, as pzstd writes it.

Sources: RFC 1952 and 1951; the bzip2 format (a file of no blocks); the .xz file format 1.2.0, 2 and 4; RFC
8878, 3.1.
"""

LONGEST_BEGIN = 10
"""Bytes by which each is known."""

PACKED_SUFFIXES = tuple(one.suffix for one in PACKINGS)


def packing_of(head: bytes) -> Packing | None:
    """Return how a file is packed that begins with some bytes; None if it is not."""
    return next((one for one in PACKINGS if re.match(one.begins, head)), None)


def plain_name(name: str) -> str:
    """Return the name of a file without the suffix of a packing: `a.csv` for `a.csv.gz`."""
    suffix = next((one for one in PACKED_SUFFIXES if name.lower().endswith(one)), "")
    return name[: len(name) - len(suffix)]


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
