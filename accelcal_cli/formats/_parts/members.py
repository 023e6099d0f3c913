"""The members of an archive, one after the other: their names, and the bytes of those that are wanted.

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
from typing import Any, BinaryIO

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

LZMA_MEMORY, XZ_BYTES = 1 << 27, 1 << 12
"""Most memory for a dictionary of xz, and packed bytes that are taken at a time."""


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
SHOWN, MOST_MEMBERS = 100, 100_000
"""Most characters of a member's name in a message, and most members of any kind."""

LARGEST_DIRECTORY, LONGEST_HEADER = 1 << 24, 1 << 20
"""Most bytes of a zip file that are read at once, and of a header that describes another member."""

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

Piece = tuple[str, bytes | None]
"""The name of a plain file in an archive, with None where it begins, then its bytes, b"" where it ends."""

Wanted = Callable[[str], bool]
"""Returns True for the last part of a name if the bytes of the file are wanted."""


class Allowance:
    """The bytes that an archive may still unpack to, and the members that it may still have."""

    def __init__(self, path: Path, most: int, times: int) -> None:
        self._path, self._times = path, times
        self._left, self._members = most + times * path.stat().st_size, 0

    def take(self, count: int) -> None:
        """Raise UnreadableError if an archive unpacks to more than it may."""
        self._left -= count
        if self._left < 0:
            raise self._too_much(f"unpacks to more than {self._times} times its size")

    def add_member(self) -> None:
        """Raise UnreadableError if an archive has more members than it may."""
        self._members += 1
        if self._members > MOST_MEMBERS:
            raise self._too_much(f"has more than {MOST_MEMBERS} members")

    def _too_much(self, what: str) -> UnreadableError:
        hint = "unpack it, and give its files"
        return UnreadableError(f"{what}, as no recording does", path=self._path, hint=hint)


def _shown(name: str) -> str:
    """Return the end of a member's name, which may be a megabyte long."""
    return name if len(name) <= SHOWN else f"...{name[-SHOWN:]}"


def members(path: Path, allowance: Allowance, wanted: Wanted) -> Iterator[Piece]:
    """Yield the plain files of an archive: their names with folders, and the bytes of wanted ones."""
    with path.open("rb") as file:
        zipped = file.read(len(ZIP_MAGIC)) == ZIP_MAGIC
    return (_zip_members if zipped else _tar_members)(path, allowance, wanted)


def _file(name: str, pieces: Iterator[bytes], wanted: Wanted) -> Iterator[Piece]:
    """Yield one file."""
    name = name.replace("\\", "/").rstrip("/").replace("\0", "")
    yield name, None
    if wanted(name.rpartition("/")[2]):
        for piece in pieces:
            yield name, piece
        yield name, b""


@contextmanager
def unpacking(path: Path) -> Iterator[Any]:
    """Open a file, and unpack its bytes if they are packed."""
    with path.open("rb") as file:
        head = file.read(max(map(len, PACKED)))
        file.seek(0)
        kind = next((kind for magic, kind in PACKED.items() if head.startswith(magic)), None)
        yield file if kind is None else kind(file)


def _tar_members(path: Path, allowance: Allowance, wanted: Wanted) -> Iterator[Piece]:
    with unpacking(path) as unpacked:
        source = _Blocks(unpacked, allowance)
        about: dict[bytes, bytes] = {}
        while (block := source.exactly(tarfile.BLOCKSIZE)).strip(b"\0"):
            header = tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
            allowance.add_member()
            if header.type in HEADERS:
                if header.size > LONGEST_HEADER:
                    raise ValueError(f"a header claims {header.size} bytes")
                about |= _described(header.type, source.exactly(header.size))
                source.pass_over(-header.size % tarfile.BLOCKSIZE)
                continue
            name = about.get(b"path", b"").decode("utf-8", "surrogateescape") or header.name
            if header.type == tarfile.GNUTYPE_SPARSE or b"sparse" in about:
                what = f"{_shown(name)} in it is a sparse file, which is not unpacked"
                raise UnreadableError(what, path=path, hint="pack it again without --sparse")
            size = int(about.get(b"size", header.size))
            about = {}
            if header.isreg() or header.type not in tarfile.SUPPORTED_TYPES:
                if size < 0:
                    raise ValueError("a member has a negative size")
                pieces = source.pieces(size)
                if header.isreg():
                    yield from _file(name, pieces, wanted)
                for _ in pieces:  # those that are not wanted
                    pass
                source.pass_over(-size % tarfile.BLOCKSIZE)


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
        return b"".join(self.pieces(count))

    def pieces(self, count: int) -> Iterator[bytes]:
        """Yield the next bytes in pieces; raises EOFError if there are fewer."""
        while count > 0:
            piece = self.read(min(count, COPIED_BYTES))
            count -= len(piece)
            yield piece

    def pass_over(self, count: int) -> None:
        """Read past some bytes."""
        for _ in self.pieces(count):
            pass


def _zip_members(path: Path, allowance: Allowance, wanted: Wanted) -> Iterator[Piece]:
    """Yield members by the directory at the end, or by their own headers in a file cut short."""
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(ShortReads(file, LARGEST_DIRECTORY)) as archive:
                entries = archive.infolist()
            if min((entry.header_offset for entry in entries), default=0) > 0:
                raise zipfile.BadZipFile("its directory is that of a zip file within")
        except zipfile.BadZipFile:
            yield from _zip_stream(path, file, allowance, wanted)
            return
        for entry in entries:
            allowance.add_member()
            if not entry.filename.endswith("/"):
                data = _ZipData(path, file, entry, allowance)
                yield from _file(entry.filename, data.pieces(), wanted)


def _zip_stream(path: Path, file: BinaryIO, allowance: Allowance, wanted: Wanted) -> Iterator[Piece]:
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
        follows = bool(flags & _SIZES_FOLLOW)
        if follows:
            size, packed = -1, packed or _UNKNOWN
            if packed == _UNKNOWN and method == zipfile.ZIP_STORED:
                raise zipfile.BadZipFile("only its directory, which is missing, says how long a member is")
        entry = zipfile.ZipInfo()
        entry.filename, entry.header_offset, entry.flag_bits, entry.compress_type = name, at, flags, method
        entry.compress_size, entry.file_size, entry.CRC = packed, size, crc
        allowance.add_member()
        data = _ZipData(path, file, entry, allowance, follows)
        if not name.endswith("/"):
            yield from _file(name, data.pieces(), wanted)
        at = data.end()


@dataclass(slots=True)
class _ZipData:
    """The data of one member, whose checksum is compared at its end.

    The checksum and sizes of one that `follows` stand after its data, in 12 to 24 bytes (4.3.9).
    """

    path: Path
    file: BinaryIO
    entry: zipfile.ZipInfo
    allowance: Allowance
    follows: bool = False
    checksum: int | None = None

    def pieces(self) -> Iterator[bytes]:
        """Yield the unpacked bytes, and stay where the packed ones end, if there are any."""
        self._refuse_packing()
        self.checksum, unpacked = 0, iter([(b"", True)])
        if self.entry.file_size:
            left, is_stored = self._go_to_data(), self.entry.compress_type == zipfile.ZIP_STORED
            unpacked = self._stored(left) if is_stored else self._inflated(left)
        for piece, is_last in unpacked:
            self.allowance.take(len(piece))
            self.checksum = crc32(piece, self.checksum)
            if is_last and not self.follows and self.checksum != self.entry.CRC:
                raise zipfile.BadZipFile("a member has a wrong checksum")
            if piece:
                yield piece

    def _stored(self, left: int) -> Iterator[tuple[bytes, bool]]:
        """Yield pieces, and whether each is the last."""
        while True:
            piece = self.file.read(min(COPIED_BYTES, left))
            left -= len(piece)
            if not piece and left > 0:
                raise EOFError("the archive ends early")
            yield piece, left <= 0
            if left <= 0:
                return

    def _inflated(self, left: int) -> Iterator[tuple[bytes, bool]]:
        """Yield pieces, and whether each is the last; stay behind the deflate stream."""
        inflater = Inflater()
        while not inflater.complete:
            if inflater.needs_input:
                data = self.file.read(min(STEP_BYTES, left))
                left -= len(data)
                if not data:
                    raise EOFError("the archive ends early")
                inflater.put(data)
            piece = inflater.take(COPIED_BYTES)
            if inflater.damaged:
                raise zipfile.BadZipFile("a member is damaged")
            yield piece, inflater.complete
        self.file.seek(-len(inflater.rest), 1)

    def end(self) -> int:
        """Return where the next member begins, past what is not read yet."""
        if not self.entry.file_size or (self.checksum is None and self.entry.compress_size < _UNKNOWN):
            self.file.seek(self._go_to_data(), 1)
        elif self.checksum is None:
            for _ in self.pieces():
                pass
        end = self.file.tell()
        if not self.follows:
            return end
        data = self.file.read(26)
        first = len(_DESCRIPTOR) if data.startswith(_DESCRIPTOR) else 0
        if len(data) < first + 12:
            raise EOFError("the archive ends early")
        if self.checksum not in (None, int.from_bytes(data[first : first + 4], "little")):
            raise zipfile.BadZipFile("a member has a wrong checksum")
        return end + next((n for n in (first + 12, first + 20) if data[n : n + 2] in (b"PK", b"")), len(data))

    def _refuse_packing(self) -> None:
        """Raise UnreadableError if the data are packed in a way that is not unpacked."""
        name, method = self.entry.filename, self.entry.compress_type
        if self.entry.flag_bits & _ENCRYPTED:
            hint = f"unpack it with its password, and give {_shown(name.rpartition('/')[2])}"
            raise UnreadableError("is encrypted", path=self.path, hint=hint)
        if method not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            names = {9: "Deflate64", 12: "bzip2", 14: "LZMA", 93: "zstd", 95: "xz"}
            what = f"{_shown(name)} in it is packed with {names.get(method, f'method {method}')}"
            hint = "pack it again as an ordinary zip file, or give what is in it"
            raise UnreadableError(f"{what}, which is not unpacked", path=self.path, hint=hint)

    def _go_to_data(self) -> int:
        """Go to the packed bytes, and return their number."""
        self.file.seek(self.entry.header_offset)
        head = self.file.read(ZIP_LOCAL.size)
        if len(head) < ZIP_LOCAL.size or not head.startswith(ZIP_MAGIC):
            raise zipfile.BadZipFile("a member is not where the directory says")
        self.file.seek(sum(ZIP_LOCAL.unpack(head)[-2:]), 1)
        return self.entry.compress_size
