"""The members of an archive, one after the other, as streams of bytes.

What an archive may cost is bounded before a library reads it: members of any kind are counted, headers have a
longest length, a dictionary has a largest size, and only what every program packs is unpacked (stored and
deflated members, no sparse files).
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ZIP_MAGIC
from accelcal_cli.formats._bytes import (
    IN_EXTRA,
    STEP_BYTES,
    ZIP_LOCAL,
    Inflater,
    ShortReads,
    crc32,
    long_sizes,
)

LZMA_MEMORY = 1 << 27
"""Most memory for a dictionary of xz; `xz -9` takes half of it."""


XZ_BYTES = 1 << 12
"""Packed bytes that are taken at a time: what follows a stream is copied, and there may be millions."""


class Xz:
    """The unpacked bytes of an xz file, with bounded memory."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._size = file, 0
        self._unpacker = lzma.LZMADecompressor(memlimit=LZMA_MEMORY)

    def read(self, count: int) -> bytes:
        """Return the next bytes, fewer only at the end."""
        parts: list[bytes] = []
        while count > 0 and (piece := self._step(count)):
            parts.append(piece)
            count -= len(piece)
        return b"".join(parts)

    def _step(self, count: int) -> bytes:
        while True:
            if self._unpacker.eof:
                rest = self._unpacker.unused_data.lstrip(b"\0") or self._file.read(XZ_BYTES).lstrip(b"\0")
                if not rest:
                    return b""
                self._unpacker = lzma.LZMADecompressor(memlimit=LZMA_MEMORY)
            elif self._unpacker.needs_input:
                rest = self._file.read(XZ_BYTES)
                if not rest:
                    raise EOFError("the archive ends early")
            else:
                rest = b""
            if piece := self._unpacker.decompress(rest, count):
                return piece


PACKED: dict[bytes, Callable[[BinaryIO], Any]] = {
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\x00": Xz,
}
"""First bytes of streams that may hold a tar file, and what unpacks them."""

BROKEN = (
    tarfile.TarError, zipfile.BadZipFile, EOFError, OSError, zlib.error, lzma.LZMAError, ValueError,
    struct.error, OverflowError, NotImplementedError,
)  # fmt: skip
"""Errors from reading a damaged archive."""

COPIED_BYTES = 1 << 20

SHOWN = 100
"""Most characters of a member's name in a message."""

MOST_MEMBERS = 100_000
"""Most members of any kind."""

LARGEST_DIRECTORY = 1 << 24
"""Most bytes that zipfile reads at once, whatever the archive says."""

LONGEST_HEADER = 1 << 20
"""Most bytes in a header of a tar file that describes another member."""

HEADERS = (
    tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.SOLARIS_XHDTYPE, tarfile.GNUTYPE_LONGNAME,
    tarfile.GNUTYPE_LONGLINK,
)  # fmt: skip
"""Kinds of members that describe others."""

PAX_RECORD = re.compile(rb"(?:^|\n)\d+ (path|size|GNU\.sparse\.[^=\n]*)=([^\n]*)")
"""A record of an extended header (POSIX pax) that matters here."""

_ENCRYPTED, _SIZES_FOLLOW = 0x01, 0x08
_DESCRIPTOR = b"PK\x07\x08"
_UNKNOWN = 1 << 62


class Allowance:
    """The bytes that an archive may still unpack to."""

    def __init__(self, path: Path, most: int, times: int) -> None:
        self._path, self.directory_bytes = path, min(most, LARGEST_DIRECTORY)
        self._left = most + times * path.stat().st_size
        self._times = times

    def take(self, count: int) -> None:
        """Raise UnreadableError if an archive unpacks to more than it may."""
        self._left -= count
        if self._left < 0:
            raise _too_much(self._path, f"unpacks to more than {self._times} times its size")


def _too_much(path: Path, what: str) -> UnreadableError:
    return UnreadableError(f"{what}, as no recording does", path=path, hint="unpack it, and give its files")


def _shown(name: str) -> str:
    """Return the end of a member's name, which may be a megabyte long."""
    return name if len(name) <= SHOWN else f"...{name[-SHOWN:]}"


class Stream(Protocol):
    """The bytes of a member."""

    def read(self, count: int, /) -> bytes:
        """Return the next bytes, at most this many; none at the end."""


Member = tuple[str, Stream | None]
"""The name of a member in the archive, and its bytes; None for anything but a plain file."""


def members(path: Path, allowance: Allowance) -> Iterator[tuple[str, Stream]]:
    """Yield the plain files of an archive: their names with folders, and their bytes."""
    with path.open("rb") as file:
        zipped = file.read(len(ZIP_MAGIC)) == ZIP_MAGIC
    members = _zip_members(path, allowance) if zipped else _tar_members(path, allowance)
    for number, (name, stream) in enumerate(members):
        if number == MOST_MEMBERS:
            raise _too_much(path, f"has more than {MOST_MEMBERS} members")
        if stream is not None:
            yield name.replace("\\", "/").rstrip("/").replace("\0", ""), stream


@contextmanager
def unpacking(path: Path) -> Iterator[Any]:
    """Open a file, and unpack its bytes if they are packed."""
    with path.open("rb") as file:
        head = file.read(max(map(len, PACKED)))
        file.seek(0)
        kind = next((kind for magic, kind in PACKED.items() if head.startswith(magic)), None)
        yield file if kind is None else kind(file)


def _tar_members(path: Path, allowance: Allowance) -> Iterator[Member]:
    with unpacking(path) as unpacked:
        source = _Blocks(unpacked, allowance)
        about: dict[bytes, bytes] = {}
        while True:
            block = source.exactly(tarfile.BLOCKSIZE)
            if not block.strip(b"\0"):
                return
            header = tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
            if header.type in HEADERS:
                if header.size > LONGEST_HEADER:
                    raise ValueError(f"a header claims {header.size} bytes")
                about |= _described(header.type, source.exactly(header.size))
                source.pass_over(-header.size % tarfile.BLOCKSIZE)
                yield header.name, None
                continue
            name = about.get(b"path", b"").decode("utf-8", "surrogateescape") or header.name
            if header.type == tarfile.GNUTYPE_SPARSE or b"sparse" in about:
                hint = "pack it again without --sparse"
                raise UnreadableError(
                    f"{_shown(name)} in it is a sparse file, which is not unpacked", path=path, hint=hint
                )
            size = int(about.get(b"size", header.size))
            about = {}
            if header.isreg() or header.type not in tarfile.SUPPORTED_TYPES:
                member = _TarMember(source, size)
                yield name, member if header.isreg() else None
                member.end()
            else:
                yield name, None


def _described(kind: bytes, data: bytes) -> dict[bytes, bytes]:
    """Return what a header says of the member after it: its path and size, and whether it is sparse."""
    if kind == tarfile.GNUTYPE_LONGNAME:
        return {b"path": data.split(b"\0")[0]}
    if kind == tarfile.GNUTYPE_LONGLINK:
        return {}
    found = dict(PAX_RECORD.findall(data))
    sparse = {b"sparse": b""} if any(key.startswith(b"GNU.sparse.") for key in found) else {}
    if kind == tarfile.XGLTYPE:  # of all members: only one can have a path and a size
        return sparse
    return {key: found[key] for key in (b"path", b"size") if key in found} | sparse


class _Blocks:
    """Unpacked bytes of a tar file, counted against its allowance whether they are used or skipped."""

    def __init__(self, file: Any, allowance: Allowance) -> None:
        self._file, self._allowance = file, allowance

    def read(self, count: int) -> bytes:
        """Return the next bytes; raises UnreadableError for too many, EOFError for none."""
        piece: bytes = self._file.read(count)
        self._allowance.take(len(piece))
        if count and not piece:
            raise EOFError("the archive ends early")
        return piece

    def exactly(self, count: int) -> bytes:
        """Return the next bytes; raises EOFError if there are fewer."""
        parts: list[bytes] = []
        while count > 0:
            parts.append(self.read(count))
            count -= len(parts[-1])
        return b"".join(parts)

    def pass_over(self, count: int) -> None:
        """Read past some bytes."""
        while count > 0:
            count -= len(self.read(min(count, COPIED_BYTES)))


class _TarMember:
    """The bytes of a member of a tar file."""

    def __init__(self, source: _Blocks, size: int) -> None:
        if size < 0:
            raise ValueError("a member has a negative size")
        self._source, self._left, self._padding = source, size, -size % tarfile.BLOCKSIZE

    def read(self, count: int) -> bytes:
        piece = self._source.read(min(count, self._left))
        self._left -= len(piece)
        return piece

    def end(self) -> None:
        """Go to the next member."""
        self._source.pass_over(self._left + self._padding)


def _zip_members(path: Path, allowance: Allowance) -> Iterator[Member]:
    """Yield members by the directory at the end, or by their own headers in a file cut short."""
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(ShortReads(file, allowance.directory_bytes)) as archive:
                entries = archive.infolist()
            if min((entry.header_offset for entry in entries), default=0) > 0:
                raise zipfile.BadZipFile("its directory is that of a zip file within")
        except zipfile.BadZipFile:
            yield from _zip_stream(path, file, allowance)
            return
        for entry in entries:
            member = ZipMember(path, file, entry.filename, entry.flag_bits, entry.compress_type, allowance)
            member.at = entry.header_offset
            member.packed, member.size, member.crc = entry.compress_size, entry.file_size, entry.CRC
            yield entry.filename, None if entry.filename.endswith("/") else member


def _zip_stream(path: Path, file: BinaryIO, allowance: Allowance) -> Iterator[Member]:
    """Yield the members of a zip file without a directory, each from where the one before ends."""
    at = 0
    while True:
        file.seek(at)
        head = file.read(ZIP_LOCAL.size)
        if len(head) < ZIP_LOCAL.size or not head.startswith(ZIP_MAGIC):
            raise zipfile.BadZipFile("its directory is missing")
        _, _, flags, method, _, _, crc, packed, size, name_bytes, extra_bytes = ZIP_LOCAL.unpack(head)
        name = file.read(name_bytes).decode("utf-8", "replace")
        if IN_EXTRA in (packed, size):
            size, packed = long_sizes(file.read(extra_bytes)) or (size, packed)
        member = ZipMember(path, file, name, flags, method, allowance)
        member.at, member.packed, member.size, member.crc = at, packed, size, crc
        if follows := bool(flags & _SIZES_FOLLOW):
            member.crc, member.size = None, -1
            member.packed = packed or _UNKNOWN
            if not packed and method == zipfile.ZIP_STORED:
                raise zipfile.BadZipFile("only its directory, which is missing, says how long a member is")
        yield name, None if name.endswith("/") else member
        at = member.passed(follows)


@dataclass(slots=True)
class ZipMember:
    """The unpacked bytes of one member, whose checksum is compared at its end.

    Attributes:
        at: where its own header begins.
        packed, size: its bytes, packed and unpacked; -1: not known.
        crc: its checksum; None: it follows the data.
    """

    path: Path
    file: BinaryIO
    name: str
    flags: int
    method: int
    allowance: Allowance
    at: int = 0
    packed: int = 0
    size: int = 0
    crc: int | None = None
    _sum: int = 0
    _inflater: Inflater | None = None
    _ended: bool = False
    _begun: bool = False

    def read(self, count: int) -> bytes:
        """See `Stream`."""
        if not self._begun:
            self._begin()
        piece = b""
        while not piece and not self._ended:
            piece = self._stored(count) if self._inflater is None else self._inflated(self._inflater, count)
        self.allowance.take(len(piece))
        self._sum = crc32(piece, self._sum)
        if self._ended and self.crc not in (None, self._sum):
            raise zipfile.BadZipFile("a member has a wrong checksum")
        return piece

    def passed(self, follows: bool) -> int:
        """Go to the end of a member, and return where what follows it begins.

        Args:
            follows: its checksum and sizes follow its data, in 12 to 24 bytes (4.3.9).
        """
        if (not self._begun and self.packed < _UNKNOWN) or self.size == 0:
            self._go_to_data()
            self.file.seek(self.packed, 1)
            self._ended = True
        while not self._ended:
            self.read(COPIED_BYTES)
        end = self.file.tell() - (0 if self._inflater is None else len(self._inflater.rest))
        return end + self._descriptor(end) if follows else end

    def _descriptor(self, end: int) -> int:
        self.file.seek(end)
        data = self.file.read(26)
        first = len(_DESCRIPTOR) if data.startswith(_DESCRIPTOR) else 0
        if len(data) < first + 12:
            raise EOFError("the archive ends early")
        if self._begun and int.from_bytes(data[first : first + 4], "little") != self._sum:
            raise zipfile.BadZipFile("a member has a wrong checksum")
        return next((n for n in (first + 12, first + 20) if data[n : n + 2] in (b"PK", b"")), len(data))

    def _begin(self) -> None:
        """Go to the data; raises UnreadableError if they are packed in a way that is not unpacked."""
        self._begun, hint = True, "pack it again as an ordinary zip file, or give what is in it"
        if self.flags & _ENCRYPTED:
            hint = f"unpack it with its password, and give {_shown(self.name.rpartition('/')[2])}"
            raise UnreadableError("is encrypted", path=self.path, hint=hint)
        if self.method not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            names = {9: "Deflate64", 12: "bzip2", 14: "LZMA", 93: "zstd", 95: "xz"}
            how = names.get(self.method, f"method {self.method}")
            raise UnreadableError(
                f"{_shown(self.name)} in it is packed with {how}, which is not unpacked",
                path=self.path,
                hint=hint,
            )
        if self.size == 0:
            self._ended = True
            return
        self._go_to_data()
        self._inflater = Inflater() if self.method == zipfile.ZIP_DEFLATED else None
        self._ended = self._inflater is None and self.packed == 0

    def _go_to_data(self) -> None:
        self.file.seek(self.at)
        head = self.file.read(ZIP_LOCAL.size)
        if len(head) < ZIP_LOCAL.size or not head.startswith(ZIP_MAGIC):
            raise zipfile.BadZipFile("a member is not where the directory says")
        self.file.seek(sum(ZIP_LOCAL.unpack(head)[-2:]), 1)

    def _stored(self, count: int) -> bytes:
        data = self.file.read(min(count, self.packed))
        self.packed -= len(data)
        if not data and self.packed > 0:
            raise EOFError("the archive ends early")
        self._ended = self.packed <= 0
        return data

    def _inflated(self, inflater: Inflater, count: int) -> bytes:
        if inflater.needs_input:
            data = self.file.read(min(STEP_BYTES, self.packed))
            self.packed -= len(data)
            if not data:
                raise EOFError("the archive ends early")
            inflater.put(data)
        piece = inflater.take(count)
        if inflater.damaged:
            raise zipfile.BadZipFile("a member is damaged")
        self._ended = inflater.complete
        return piece
