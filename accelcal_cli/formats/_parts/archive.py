"""Archives of a recording's parts: `.tar` (plain or packed with gzip, bzip2 or xz) and `.zip`.

Members are unpacked one after the other into a temporary folder, under their own names; nothing else that an
archive says is believed. From a damaged archive, the members before the damage are read. An archive that
unpacks to more than a recording does is refused, and the disk of the temporary folder is never filled.
"""

from __future__ import annotations

import bz2
import errno
import gzip
import lzma
import os
import shutil
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO, Any, BinaryIO, Protocol, Self, cast

from accelcal_cli.core.errors import OutputError, UnreadableError
from accelcal_cli.core.formats import ZIP_MAGIC
from accelcal_cli.core.input_files import TAR_MAGIC, TAR_MAGIC_AT
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.formats._bytes import ShortReads

PACKED: dict[bytes, Callable[[BinaryIO], Any]] = {
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\x00": lzma.LZMAFile,
}
"""First bytes of streams that may hold a tar file, and what unpacks them."""

BROKEN = (
    tarfile.TarError, zipfile.BadZipFile, EOFError, OSError, zlib.error, lzma.LZMAError, ValueError,
    struct.error, OverflowError, NotImplementedError,
)  # fmt: skip
"""Errors from reading a damaged archive, or one whose members are packed in an unknown way."""

COPIED_BYTES = 1 << 20

LONGEST_NAME = 200
"""Most bytes in a file's name; file systems take 255."""

MOST_BYTES, MOST_TIMES = 1 << 30, 250
"""Bytes that any archive may unpack to, and further ones for each byte of its own."""

MOST_MEMBERS = 100_000
LONGEST_HEADER = LARGEST_DIRECTORY = 1 << 24
"""Most bytes that tarfile and zipfile read at once, whatever the archive says."""

HEADERS = (
    tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.SOLARIS_XHDTYPE, tarfile.GNUTYPE_LONGNAME,
    tarfile.GNUTYPE_LONGLINK,
)  # fmt: skip
"""Kinds of members that tarfile reads into memory."""

FREE_SHARE = 0.05
"""Share of the disk of temporary files that stays free."""

_LOCAL = struct.Struct("<4s5HIIIHH")
"""Header before each member of a zip file (PKWARE's APPNOTE.TXT 6.3, 4.3.7)."""


@dataclass(frozen=True, slots=True)
class Unpacked:
    """Members as files, in the order of the archive.

    Attributes:
        damage: where the archive breaks off; None for a sound archive.
        lost_bytes: bytes of the member that could not be unpacked to its end.
    """

    files: tuple[Path, ...]
    damage: str | None = None
    lost_bytes: int = 0


def is_archive(path: Path) -> bool:
    """Return True for a tar or zip file, by its first bytes; False for a file that cannot be read."""
    try:
        with _unpacking(path) as file:
            head = file.read(TAR_MAGIC_AT + len(TAR_MAGIC))
        return bool(head.startswith(ZIP_MAGIC) or head[TAR_MAGIC_AT:] == TAR_MAGIC)
    except (*BROKEN, UnreadableError):
        return False


def first_names(path: Path, number: int) -> Iterator[str]:
    """Yield the names of the first members of an archive, as many as can be read."""
    with suppress(*BROKEN, UnreadableError):
        for name, _ in islice(_members(path), number):
            yield name


def unpack(path: Path, folder: Path, wanted: Callable[[str], bool], threads: int = 1) -> Unpacked:
    """Unpack members into a folder.

    Args:
        wanted: takes a member's name; only members for which it returns True are unpacked.
        threads: how many may work at a time; one of its own unpacks what another writes.

    Raises:
        OutputError: there is no room for them.
        UnreadableError: nothing can be unpacked, or more than any recording has.
    """
    allowance = _Allowance(path)
    files: list[Path] = []
    target: Path | None = None
    try:
        with closing(prefetch(_pieces(path, wanted), threads)) as pieces:
            for name, piece in pieces:
                if piece is None or target is None:
                    target = folder / f"{len(files):06d}" / name
                    _write(target, None)
                elif piece:
                    allowance.take(len(piece))
                    _write(target, piece)
                else:
                    files.append(target)
                    target = None
    except BROKEN as error:
        if isinstance(error, OSError) and error.errno is not None:  # of the disk, not of what is packed
            raise UnreadableError(f"cannot be read ({error.strerror or error})", path=path) from error
        lost = target.stat().st_size if target is not None and target.exists() else 0
        if not files:
            text = f"damaged archive: nothing can be unpacked ({error})"
            raise UnreadableError(text, path=path, hint="copy it again from its source") from error
        return Unpacked(tuple(files), f"the archive breaks off after {files[-1].name}", lost)
    return Unpacked(tuple(files))


class _Allowance:
    """The bytes that an archive may still unpack to."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._left = MOST_BYTES + MOST_TIMES * path.stat().st_size

    def take(self, count: int) -> None:
        """Raise UnreadableError if an archive unpacks to more than it may."""
        self._left -= count
        if self._left < 0:
            raise _too_much(self._path, f"unpacks to more than {MOST_TIMES} times its size")


def _too_much(path: Path, what: str) -> UnreadableError:
    return UnreadableError(
        f"{what}, as no recording does", path=path, hint="give --parts a folder of its files"
    )


def _pieces(path: Path, wanted: Callable[[str], bool]) -> Iterator[tuple[str, bytes | None]]:
    """Yield wanted members in pieces, with their names; None comes before a member, b"" after it."""
    for name, stream in _members(path):
        if wanted(name):
            yield name, None
            while piece := stream.read(COPIED_BYTES):
                yield name, piece
            yield name, b""


def _write(target: Path, piece: bytes | None) -> None:
    """Begin a member's file (None), or append to it; raises OutputError if the disk is all but full."""
    try:
        if piece is None:
            target.parent.mkdir()
            target.touch()
            return
        with target.open("ab") as file:
            disk = shutil.disk_usage(target.parent)
            if disk.free < FREE_SHARE * disk.total:
                raise OSError(errno.ENOSPC, f"less than {FREE_SHARE:.0%} of the disk would be left")
            file.write(piece)
    except OSError as error:
        raise OutputError(
            f"the archive cannot be unpacked ({error.strerror or error})",
            path=target.parent.parent,
            hint="set TMPDIR to a disk with more space",
        ) from error


class Stream(Protocol):
    """The bytes of a member."""

    def read(self, count: int, /) -> bytes:
        """Return the next bytes, at most this many; none at the end."""


def _members(path: Path) -> Iterator[tuple[str, Stream]]:
    """Yield the plain files of an archive: their names without folders, and their bytes."""
    with path.open("rb") as file:
        zipped = file.read(len(ZIP_MAGIC)) == ZIP_MAGIC
    members = _zip_members(path) if zipped else _tar_members(path)
    for number, (name, stream) in enumerate(members):
        if number == MOST_MEMBERS:
            raise _too_much(path, f"has more than {MOST_MEMBERS} members")
        last = name.replace("\\", "/").rstrip("/").rpartition("/")[2].replace("\0", "")
        safe = os.fsdecode(os.fsencode(last)[-LONGEST_NAME:]) if last not in ("", ".", "..") else "member"
        yield safe, stream


def _tar_members(path: Path) -> Iterator[tuple[str, Stream]]:
    with (
        _unpacking(path) as unpacked,
        nullcontext(_Counted(unpacked, path)) as source,
        tarfile.open(fileobj=cast(BinaryIO, source), mode="r|", tarinfo=_MemberHeader) as tar,
    ):
        for member in tar:
            if member.isfile() and (stream := tar.extractfile(member)) is not None:
                yield member.name, _Whole(stream, member.size)
        if source.tell() < tar.offset + tarfile.BLOCKSIZE:
            raise EOFError("the archive ends early")


@contextmanager
def _unpacking(path: Path) -> Iterator[Any]:
    """Open a file, and unpack its bytes if they are packed."""
    with path.open("rb") as file:
        head = file.read(max(map(len, PACKED)))
        file.seek(0)
        kind = next((kind for magic, kind in PACKED.items() if head.startswith(magic)), None)
        yield file if kind is None else kind(file)


class _MemberHeader(tarfile.TarInfo):
    """Header of a member, which tarfile also uses to read what belongs to it, such as long names."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
        """See `TarInfo`; raises ValueError for a header longer than any real one."""
        header = super().frombuf(buf, encoding, errors)
        if header.type in HEADERS and header.size > LONGEST_HEADER:
            raise ValueError(f"a header claims {header.size} bytes")
        return header


class _Counted:
    """Unpacked bytes of an archive, counted against its allowance whether they are used or skipped."""

    def __init__(self, file: Any, path: Path) -> None:
        self._file, self._allowance, self.tell = file, _Allowance(path), file.tell

    def read(self, count: int) -> bytes:
        """Return the next bytes; raises UnreadableError for too many."""
        piece: bytes = self._file.read(count)
        self._allowance.take(len(piece))
        return piece


class _Whole:
    """Stream of a stated length; raises EOFError if it is shorter."""

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream, self._left = stream, size

    def read(self, count: int) -> bytes:
        piece = self._stream.read(count)
        self._left -= len(piece)
        if not piece and self._left > 0:
            raise EOFError("the archive ends early")
        return piece


def _zip_members(path: Path) -> Iterator[tuple[str, Stream]]:
    """Yield members by the directory at the end, or by their own headers in a file cut short."""
    with path.open("rb") as file, ExitStack() as stack:
        try:
            archive = stack.enter_context(zipfile.ZipFile(ShortReads(file, LARGEST_DIRECTORY)))
        except zipfile.BadZipFile:
            yield from _zip_stream(path)
            return
        if len(archive.infolist()) > MOST_MEMBERS:
            raise _too_much(path, f"has more than {MOST_MEMBERS} members")
        for member in archive.infolist():
            if member.flag_bits & 1:
                raise zipfile.BadZipFile("it is encrypted")
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
