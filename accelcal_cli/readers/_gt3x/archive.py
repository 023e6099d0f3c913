"""Where the parts of a .gt3x file, which is a zip file, lie; also in one whose directory is lost.

Source: PKWARE's APPNOTE.TXT 6.3, 4.3.7 (local headers) and 4.5.3 (sizes of 64 bits).
"""

from __future__ import annotations

import struct
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Problem
from accelcal_cli.readers._gt3x.signature import ACTIVITY, INFO, LOG, MAGIC, NAMED, holds_samples

WANTED = (INFO, LOG, ACTIVITY)
STORED, DEFLATED = zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED
ENCRYPTED = 99
"""Stands for any encryption; the method that zip files name for it."""

_LOCAL = struct.Struct("<4s5HIIIHH")
_LONGEST_MATCH = _LOCAL.size + len(ACTIVITY)
_END = b"PK\x05\x06"
_LONGEST_END = 22 + 0xFFFF
_SCAN_BYTES = 1 << 20
_IN_EXTRA = 0xFFFFFFFF
_SIZES_FOLLOW = 0x08
_BROKEN = (
    zipfile.BadZipFile,
    NotImplementedError,
    ValueError,
    OverflowError,
    EOFError,
    struct.error,
    OSError,
)
"""What zipfile raises over a damaged directory; OSError where it seeks to impossible places."""

LOST_DIRECTORY = "the zip file's directory is damaged or missing: its parts were found by their own headers"


@dataclass(frozen=True, slots=True)
class Member:
    """One part of the zip file.

    Attributes:
        method: how it is compressed, as zip files number it.
        start_byte: where its (compressed) bytes begin in the file.
        packed_bytes, unpacked_bytes, crc: None where the file does not say.
    """

    name: str
    method: int
    start_byte: int
    packed_bytes: int | None = None
    unpacked_bytes: int | None = None
    crc: int | None = None


@dataclass(frozen=True, slots=True)
class Archive:
    """The parts that matter, by name, and what was wrong with the zip file around them.

    Attributes:
        ends: the end of the zip file is there: it was not cut short.
    """

    path: Path
    size: int
    members: dict[str, Member]
    ends: bool = True
    problems: tuple[Problem, ...] = ()


def open_archive(path: Path) -> Archive:
    """Find the parts by the directory at the end of the file, else by the header before each.

    Raises:
        UnreadableError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            listed, whole = by_directory(file)
            if whole:
                return Archive(path, size, listed)
            members, ends = listed | by_headers(file), has_end(file, size)
    except OSError as error:
        raise UnreadableError(f"cannot be read ({error.strerror or error})", path=path) from error
    return Archive(path, size, members, ends, (Problem("damaged_archive", LOST_DIRECTORY, None, 0),))


def has_end(file: BinaryIO, size: int) -> bool:
    """Whether the record that ends a zip file, perhaps before a comment, is there."""
    file.seek(max(0, size - _LONGEST_END))
    return _END in file.read(_LONGEST_END)


def by_directory(file: BinaryIO) -> tuple[dict[str, Member], bool]:
    """The parts that the directory lists, and whether it is sound: it lists samples, each where it says."""
    try:
        with zipfile.ZipFile(file) as archive:
            entries = [entry for entry in archive.infolist() if entry.filename in WANTED]
        placed = {entry.filename: _placed(file, entry) for entry in entries}
    except _BROKEN:
        return {}, False
    sound = all(true for _, true in placed.values()) and holds_samples(set(placed))
    return {name: member for name, (member, _) in placed.items()}, sound


def _placed(file: BinaryIO, entry: zipfile.ZipInfo) -> tuple[Member, bool]:
    """A part listed in the directory, and whether its own header lies where it should."""
    name = entry.filename.encode()
    file.seek(entry.header_offset)
    header = file.read(_LOCAL.size + len(name)).ljust(_LOCAL.size, b"\0")
    extra_bytes = _LOCAL.unpack_from(header)[-1]
    member = Member(
        entry.filename,
        ENCRYPTED if entry.flag_bits & 1 else entry.compress_type,
        entry.header_offset + _LOCAL.size + len(name) + extra_bytes,
        entry.compress_size,
        entry.file_size,
        entry.CRC,
    )
    return member, header.startswith(MAGIC) and header.endswith(name)


def by_headers(file: BinaryIO) -> dict[str, Member]:
    """The parts whose own headers are found anywhere in the file; the first of each name."""
    found: dict[str, Member] = {}
    base, data = 0, b""
    file.seek(0)
    while block := file.read(_SCAN_BYTES):
        base, data = base + max(0, len(data) - _LONGEST_MATCH), data[-_LONGEST_MATCH:] + block
        for match in NAMED.finditer(data):
            name = match[2].decode()
            if int.from_bytes(match[1], "little") == len(name) and name not in found:
                found[name] = _by_header(file, base + match.start(), name)
                file.seek(base + len(data))
    return found


def _by_header(file: BinaryIO, at: int, name: str) -> Member:
    file.seek(at)
    fields = _LOCAL.unpack(file.read(_LOCAL.size))
    _, _, flags, method, _, _, crc, packed, unpacked, name_bytes, extra_bytes = fields
    file.seek(at + _LOCAL.size + name_bytes)
    if _IN_EXTRA in (packed, unpacked):
        unpacked, packed = _long_sizes(file.read(extra_bytes))
    start = at + _LOCAL.size + name_bytes + extra_bytes
    method = ENCRYPTED if flags & 1 else method
    if flags & _SIZES_FOLLOW and not packed:
        return Member(name, method, start)
    return Member(name, method, start, packed, unpacked, crc)


def _long_sizes(extra: bytes) -> tuple[int | None, int | None]:
    """Sizes of 64 bits, unpacked and packed, from a header's extra field."""
    at = 0
    while at + 4 <= len(extra):
        kind, length = struct.unpack_from("<HH", extra, at)
        if kind == 1 and length >= 16 and at + 20 <= len(extra):
            unpacked, packed = struct.unpack_from("<QQ", extra, at + 4)
            return unpacked, packed
        at += 4 + length
    return None, None
