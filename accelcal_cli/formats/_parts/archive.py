"""Archives of recordings: `.tar` (plain, or packed by any of `core/unpacking.py`) and `.zip`, within bounds.

Members are unpacked one after the other into a temporary folder, those of one folder of the archive into one
folder there, under their own names; nothing else that an archive says is believed. From a damaged archive,
the members before the damage are read. An archive that unpacks to more than a recording does is refused, and
the disk of the temporary folder is never filled.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from accelcal_cli.core.errors import OutputError, UnreadableError, counted, unread
from accelcal_cli.core.formats import ZIP_MAGIC
from accelcal_cli.core.input_files import TAR_MAGIC, TAR_MAGIC_AT
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.recording import Problem
from accelcal_cli.core.unpacking import STEP_BYTES, Inflater, crc32
from accelcal_cli.formats._bytes import IN_EXTRA, ZIP_LOCAL, ByteSource, ShortReads, long_sizes

# The members of an archive, one after the other: their names, and the bytes of those that are wanted.
#
# What an archive may cost is bounded before a library reads it: members of any kind are counted,
# headers have a longest length, and only what every program packs is unpacked (stored and deflated
# members, no sparse files).

BROKEN = (
    tarfile.TarError, zipfile.BadZipFile, EOFError, OSError, zlib.error, ValueError,
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


def _tar_members(path: Path, allowance: Allowance, wanted: Wanted) -> Iterator[Piece]:
    with ByteSource(path) as unpacked:
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

    def __init__(self, file: ByteSource, allowance: Allowance) -> None:
        self._file, self._allowance = file, allowance

    def read(self, count: int) -> bytes:
        """Return the next bytes; raises UnreadableError for too many, EOFError for none."""
        piece = self._file.read(count)
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


# Archives of recordings.

LONGEST_NAME = 200
"""Most bytes in a file's name; file systems take 255."""

MOST_BYTES, MOST_TIMES = 1 << 30, 250
"""Bytes that any archive may unpack to, and further ones for each byte of its own."""

MORE_SPACE = "set TMPDIR to a disk with more space"

LOOKED_BYTES = 1 << 24
"""Unpacked bytes, and bytes of a zip file's directory, in which names are looked for."""

MOST_EMPTY = 100
"""Members without bytes that are unpacked; the others are counted."""

META, FREE_SHARE = "meta", 0.05
"""The one folder within a folder that stays there; share of the disk of temporary files that stays free."""


@dataclass(slots=True)
class PartFiles:
    """The files of a recording.

    Attributes:
        names: in the order of the archive, with their names in it; those of a folder have their own.
        damage: where the archive that held them breaks off; None for a sound one.
        lost_bytes: bytes of the member that could not be unpacked to its end.
        folder: temporary folder, to be removed.
        joined: the files are parts of one recording, whatever their names.
        aside: names of files that are not recordings.
        problems: one for each file that cannot be read.
    """

    names: dict[Path, str]
    damage: str | None = None
    lost_bytes: int = 0
    folder: Path | None = None
    joined: bool = True
    aside: list[str] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files alone."""
        return tuple(self.names)


def is_archive(path: Path) -> bool:
    """Return True for a tar or zip file, by its first bytes; False for a damaged one."""
    try:
        with ByteSource(path) as file:
            head = file.read_exact(TAR_MAGIC_AT + len(TAR_MAGIC))
        return bool(head.startswith(ZIP_MAGIC) or head[TAR_MAGIC_AT:] == TAR_MAGIC)
    except BROKEN as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise unread(error, path) from error
        return False


def first_names(path: Path, number: int) -> Iterator[str]:
    """Yield the names of the first files of an archive, as many as a short look shows."""
    with suppress(*BROKEN, UnreadableError):
        found = members(path, Allowance(path, min(LOOKED_BYTES, MOST_BYTES), 0), lambda _name: False)
        for name, _ in islice(found, number):
            yield name.rpartition("/")[2]


def unpack(path: Path, folder: Path, wanted: Callable[[str], bool], threads: int = 1) -> PartFiles:
    """Unpack the members whose names are `wanted` into a folder; one thread may unpack what another writes.

    Raises:
        OutputError: there is no room for them.
        UnreadableError: nothing can be unpacked, or more than any recording has, or in an unusual way.
    """
    files, found = _Files(folder), members(path, Allowance(path, MOST_BYTES, MOST_TIMES), wanted)
    unpacked = PartFiles(files.whole, folder=folder)
    try:
        with closing(prefetch(found, threads)) as pieces:
            for name, piece in pieces:
                if piece is not None:
                    files.take(name, piece)
    except BROKEN as error:
        if isinstance(error, OSError) and error.errno is not None:  # of the disk, not of what is packed
            raise unread(error, path) from error
        if not files.whole:
            text = f"damaged archive: nothing can be unpacked ({error})"
            raise UnreadableError(text, path=path, hint="copy it again from its source") from error
        unpacked.damage = f"the archive breaks off after {[*files.whole][-1].name}"
        unpacked.lost_bytes = files.begun.stat().st_size if files.begun is not None else 0
    unpacked.aside += [counted(files.empty, "empty file")] if files.empty else []
    return unpacked


@dataclass(slots=True)
class _Files:
    """The files that members become: whole ones, one begun, and a number of empty ones beyond MOST_EMPTY."""

    folder: Path
    whole: dict[Path, str] = field(default_factory=dict)
    empty: int = 0
    begun: Path | None = None
    _without_bytes: int = 0
    _folders: dict[str, Path] = field(default_factory=dict)
    _taken: set[Path] = field(default_factory=set)

    def take(self, name: str, piece: bytes) -> None:
        """Take the next piece of a member; b"" comes after it."""
        if piece:
            first, self.begun = self.begun is None, self.begun or self._place(name)
            _write(self.begun, piece, first=first)
        else:
            self._end(name)

    def _end(self, name: str) -> None:
        if self.begun is None:
            self._without_bytes += 1
            if self._without_bytes > MOST_EMPTY:
                self.empty += 1
                return
            self.begun = self._place(name)
            _write(self.begun, b"", first=True)
        self.whole[self.begun] = name[-LONGEST_NAME:]
        self.begun = None

    def _place(self, name: str) -> Path:
        """Return where a member goes: next to others of its folder, unless one there has its name."""
        place, _, last = name.rpartition("/")
        safe = os.fsdecode(os.fsencode(last)[-LONGEST_NAME:]) if last not in ("", ".", "..") else "member"
        target = self._folder(place) / safe
        if (taken := target.with_name(safe.lower())) in self._taken or safe.lower() == META:
            target = self._folder(f"{place}/{len(self._folders)}\0") / safe
        self._taken.add(taken)
        return target

    def _folder(self, place: str) -> Path:
        above, _, last = place.rpartition("/")
        if last == META:  # its files describe those of the folder above
            return self._folder(above) / META
        return self._folders.setdefault(place, self.folder / f"{len(self._folders):06d}")


def _write(target: Path, piece: bytes, *, first: bool) -> None:
    """Begin a member's file, or append to it; raises OutputError if the disk is all but full."""
    try:
        if first:
            target.parent.mkdir(parents=target.parent.name == META, exist_ok=True)
        with target.open("wb" if first else "ab") as file:
            disk = shutil.disk_usage(target.parent)
            if disk.free < FREE_SHARE * disk.total:
                raise OSError(errno.ENOSPC, f"less than {FREE_SHARE:.0%} of the disk would be left")
            file.write(piece)
    except OSError as error:
        what = f"the archive cannot be unpacked ({error.strerror or error})"
        raise OutputError(what, path=target.parent.parent, hint=MORE_SPACE) from error
