"""Archives of a recording's parts: `.tar` (plain or packed with gzip, bzip2 or xz) and `.zip`.

Members are unpacked one after the other into a temporary folder, under their own names; nothing else that an
archive says is believed. Of a damaged archive those before the damage are there.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import shutil
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO, Protocol

from accelcal_cli.core.errors import OutputError, UnreadableError

ZIP_MAGIC, TAR_MAGIC, TAR_MAGIC_AT = b"PK\x03\x04", b"ustar", 257
PACKED: dict[bytes, Callable[[BinaryIO], Any]] = {
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\x00": lzma.LZMAFile,
}
"""How the streams begin that may hold a tar file, and what unpacks them."""

BROKEN = (tarfile.TarError, zipfile.BadZipFile, EOFError, OSError, zlib.error, lzma.LZMAError, ValueError)
"""What reading a damaged archive raises."""

COPIED_BYTES = 1 << 20
LONGEST_NAME = 200

_LOCAL = struct.Struct("<4s5HIIIHH")
"""The header before each member of a zip file (PKWARE's APPNOTE.TXT 6.3, 4.3.7)."""


@dataclass(frozen=True, slots=True)
class Unpacked:
    """Members as files, in the order of the archive.

    Attributes:
        damage: what broke off, and after how many members; None for a sound archive.
        lost_bytes: of the member that could not be unpacked to its end.
    """

    files: tuple[Path, ...]
    damage: str | None = None
    lost_bytes: int = 0


def is_archive(path: Path) -> bool:
    """Whether a file is a tar or zip file, by its first bytes; what cannot be read is none."""
    try:
        with _unpacking(path) as file:
            head = file.read(TAR_MAGIC_AT + len(TAR_MAGIC))
        return bool(head.startswith(ZIP_MAGIC) or head[TAR_MAGIC_AT:] == TAR_MAGIC)
    except (*BROKEN, UnreadableError):
        return False


def first_names(path: Path, number: int) -> list[str]:
    """Names of the first members of an archive, as many as can be read."""
    names: list[str] = []
    try:
        for name, _ in _members(path):
            names.append(name)
            if len(names) == number:
                break
    except BROKEN:
        pass
    return names


def unpack(path: Path, folder: Path, wanted: Callable[[str], bool]) -> Unpacked:
    """Unpack members into a folder.

    Args:
        wanted: whether a member of this name is.

    Raises:
        OutputError: there is no room for them.
        UnreadableError: nothing can be unpacked.
    """
    files: list[Path] = []
    target: Path | None = None
    try:
        for name, stream in _members(path):
            if wanted(name):
                target = folder / f"{len(files):06d}" / name
                target.parent.mkdir()
                _copy(stream, target)
                files.append(target)
                target = None
    except BROKEN as error:
        if isinstance(error, OutputError):
            raise
        lost = target.stat().st_size if target is not None and target.exists() else 0
        if not files:
            text = f"damaged archive: nothing can be unpacked ({error})"
            raise UnreadableError(text, path=path, hint="copy it again from its source") from error
        return Unpacked(tuple(files), f"the archive breaks off after {files[-1].name}", lost)
    return Unpacked(tuple(files))


def _copy(stream: Stream, target: Path) -> None:
    while piece := stream.read(COPIED_BYTES):
        try:
            with target.open("ab") as file:
                file.write(piece)
        except OSError as error:
            raise OutputError(
                f"the archive cannot be unpacked ({error.strerror or error})",
                path=target.parent.parent,
                hint="set TMPDIR to a disk with more space",
            ) from error


class Stream(Protocol):
    """Bytes of a member."""

    def read(self, count: int, /) -> bytes:
        """The next ones, at most so many; none at the end."""


def _members(path: Path) -> Iterator[tuple[str, Stream]]:
    """The plain files of an archive: their names without folders, and their bytes."""
    with path.open("rb") as file:
        zipped = file.read(len(ZIP_MAGIC)) == ZIP_MAGIC
    members = _zip_members(path) if zipped else _tar_members(path)
    return ((_plain(name), stream) for name, stream in members)


def _plain(name: str) -> str:
    """The last part of a member's name, as a file may have it."""
    last = name.replace("\\", "/").rstrip("/").rpartition("/")[2].replace("\0", "")
    return last[-LONGEST_NAME:] if last not in ("", ".", "..") else "member"


def _tar_members(path: Path) -> Iterator[tuple[str, Stream]]:
    """tarfile itself takes an archive that breaks off for one that ends: here its last block is missed."""
    with _unpacking(path) as source, tarfile.open(fileobj=source, mode="r|") as tar:
        for member in tar:
            if member.isfile() and (stream := tar.extractfile(member)) is not None:
                yield member.name, _Whole(stream, member.size)
        if source.tell() < tar.offset + tarfile.BLOCKSIZE:
            raise EOFError("the archive ends early")


@contextmanager
def _unpacking(path: Path) -> Iterator[Any]:
    """The bytes of a file, of a packed one unpacked."""
    with path.open("rb") as file:
        head = file.read(max(map(len, PACKED)))
        file.seek(0)
        kind = next((kind for magic, kind in PACKED.items() if head.startswith(magic)), None)
        yield file if kind is None else kind(file)


class _Whole:
    """A stream of a stated length; a shorter one is damaged."""

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream, self._left = stream, size

    def read(self, count: int) -> bytes:
        piece = self._stream.read(count)
        self._left -= len(piece)
        if not piece and self._left > 0:
            raise EOFError("the archive ends early")
        return piece


def _zip_members(path: Path) -> Iterator[tuple[str, Stream]]:
    """By the directory at the end, which a file cut short lacks: then by the header before each member."""
    try:
        archive = zipfile.ZipFile(path)
    except zipfile.BadZipFile:
        yield from _zip_stream(path)
        return
    with archive:
        for member in archive.infolist():
            if not member.is_dir():
                with archive.open(member) as stream:
                    yield member.filename, stream


def _zip_stream(path: Path) -> Iterator[tuple[str, Stream]]:
    with path.open("rb") as file:
        while len(head := file.read(_LOCAL.size)) == _LOCAL.size:
            magic, _, flags, method, _, _, crc, packed, _, name_bytes, extra_bytes = _LOCAL.unpack(head)
            if magic != ZIP_MAGIC:
                break
            name = file.read(name_bytes).decode("utf-8", "replace")
            file.seek(extra_bytes, 1)
            if flags & 0x09 or method not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                break  # encrypted, or of a length that only the lost directory says
            start = file.tell()
            if not name.endswith("/"):
                yield name, _Inflated(file, packed, method, crc)
            file.seek(start + packed)
    raise zipfile.BadZipFile("its directory is missing")


class _Inflated:
    """The unpacked bytes of one member, whose checksum is compared at its end."""

    def __init__(self, file: BinaryIO, packed: int, method: int, crc: int) -> None:
        self._file, self._left, self._crc, self._sum = file, packed, crc, 0
        self._inflate = zlib.decompressobj(-15) if method == zipfile.ZIP_DEFLATED else None

    def read(self, count: int) -> bytes:
        piece = b""
        while not piece and (self._left or (self._inflate and self._inflate.unconsumed_tail)):
            piece = self._step(count)
        self._sum = zlib.crc32(piece, self._sum)
        if not piece and self._sum != self._crc:
            raise zipfile.BadZipFile("a member has a wrong checksum")
        return piece

    def _step(self, count: int) -> bytes:
        packed = self._inflate.unconsumed_tail if self._inflate else b""
        if not packed:
            packed = self._file.read(min(count, self._left))
            self._left -= len(packed)
            if not packed:
                raise EOFError("the archive ends early")
        return self._inflate.decompress(packed, count) if self._inflate else packed


def removed(folder: Path) -> None:
    """Remove what was unpacked."""
    shutil.rmtree(folder, ignore_errors=True)
