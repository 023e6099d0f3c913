"""The parts of a .gt3x file, which is a zip file: their places, and their bytes as a stream.

Both survive damage: a lost directory of the zip file, and parts that break off or have a wrong checksum.
Source: PKWARE's APPNOTE.TXT 6.3, 4.3.7 (local headers) and 4.5.3 (sizes of 64 bits).
"""

from __future__ import annotations

import re
import struct
import zipfile
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import BinaryIO

from accelcal_cli.core.errors import UnreadableError, listed, printable, unread
from accelcal_cli.core.formats import ZIP_MAGIC
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.recording import Closing, Problem
from accelcal_cli.core.unpacking import MOST_BYTES, STEP_BYTES, Inflater, crc32
from accelcal_cli.formats._bytes import IN_EXTRA, ZIP_LOCAL, ShortReads, long_sizes

INFO, LOG, ACTIVITY = "info.txt", "log.bin", "activity.bin"
CALIBRATION, TEMPERATURE_CALIBRATION = "calibration.json", "temperature_calibration.json"
ABOUT = "info.json"
"""Only files of CentrePoint have it; its times count from 1970."""

NAMED = re.compile(
    rb"PK\x03\x04.{22}(..)..((?:[^\0/\\]{1,100}[/\\]){0,3}"
    rb"(?:info\.(?:txt|json)|log\.bin|activity\.bin|(?:temperature_)?calibration\.json))",
    re.DOTALL | re.IGNORECASE,
)
"""Local header of one of the parts, perhaps in a folder; the groups are the length of its name, and this."""

WANTED = (INFO, LOG, ACTIVITY, CALIBRATION, TEMPERATURE_CALIBRATION, ABOUT)
STORED, DEFLATED = zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED
ENCRYPTED = 99
"""Method that stands for any encryption; zip files use it for AES."""

_LONGEST_MATCH = ZIP_LOCAL.size + 303 + max(map(len, WANTED))
_END = b"PK\x05\x06"
_LONGEST_END = 22 + 0xFFFF
_SCAN_BYTES, _LARGEST_DIRECTORY = 1 << 20, 1 << 20
"""Bytes that are scanned at a time, and most of a directory, enough for about 20 000 parts."""
_SIZES_FOLLOW, _UTF8 = 0x08, 0x800
_BROKEN = (
    zipfile.BadZipFile,
    NotImplementedError,
    ValueError,
    OverflowError,
    EOFError,
    struct.error,
    OSError,
)
"""Errors that zipfile raises for a damaged directory; OSError if it seeks to impossible places."""

LOST_DIRECTORY = "the zip file's directory is damaged or missing: its parts were found by their own headers"

UNKNOWN_SIZE = 1 << 62
SMALL_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Member:
    """One part of the zip file.

    Attributes:
        method: its compression, as zip files number it.
        start_byte: where its (compressed) bytes begin in the file.
        packed_bytes, unpacked_bytes, crc: None if the file does not say.
    """

    name: str
    method: int
    start_byte: int
    packed_bytes: int | None = None
    unpacked_bytes: int | None = None
    crc: int | None = None


@dataclass(frozen=True, slots=True)
class Archive:
    """The parts that matter, by name, and what is wrong with the zip file around them.

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
        UnreadableError: the file cannot be read, or holds several recordings.
    """
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            known, whole, repeated = by_directory(file)
            if whole:
                return Archive(path, size, known, problems=repeated)
            found, repeated = by_headers(file)
            file.seek(max(0, size - _LONGEST_END))
            members, ends = known | found, _END in file.read(_LONGEST_END)
    except UnreadableError as error:
        error.path = path
        raise
    except OSError as error:
        raise unread(error, path) from error
    lost = Problem("damaged_archive", LOST_DIRECTORY, None, 0)
    return Archive(path, size, members, ends, (lost, *repeated))


def holds_samples(names: Iterable[str]) -> bool:
    """Return True if one of the names, perhaps in a folder, is of a part with samples, of either kind."""
    return not {last_name(name) for name in names}.isdisjoint((LOG, ACTIVITY))


def last_name(name: str) -> str:
    """Return a part's name without its folders, in lower case: programs that pack it again change that."""
    return re.split(r"[/\\]", name)[-1].lower()


def directory_names(file: BinaryIO) -> list[str] | None:
    """Return all names in the directory; None if it is damaged or missing."""
    try:
        with zipfile.ZipFile(ShortReads(file, _LARGEST_DIRECTORY)) as archive:
            return archive.namelist()
    except _BROKEN:
        return None


def by_directory(file: BinaryIO) -> tuple[dict[str, Member], bool, tuple[Problem, ...]]:
    """Return the parts that the directory lists, whether it is sound, and which parts it lists twice.

    A sound one lists samples, and each part at the place of its own header. The parts may lie in a folder;
    raises UnreadableError if samples lie in several.
    """
    try:
        with zipfile.ZipFile(ShortReads(file, _LARGEST_DIRECTORY)) as archive:
            entries = _of_one_folder([one for one in archive.infolist() if last_name(one.filename) in WANTED])
        placed = {last_name(entry.filename): _placed(file, entry) for entry in entries}
    except _BROKEN:
        return {}, False, ()
    sound = all(true for _, true in placed.values()) and holds_samples(placed)
    numbers = Counter(last_name(entry.filename) for entry in entries)
    found = {name: member for name, (member, _) in placed.items()}
    return found, sound, tuple(_repeated(name, n, "last") for name, n in numbers.items() if n > 1)


def _of_one_folder(entries: list[zipfile.ZipInfo]) -> list[zipfile.ZipInfo]:
    """Return the entries of the folder that holds samples, of all if none does."""
    places = {one.filename: one.filename[: -len(last_name(one.filename))] for one in entries}
    folders = sorted({place for name, place in places.items() if holds_samples([name])})
    if len(folders) > 1:
        names = listed([printable(one.rstrip("/\\")) or "the file itself" for one in folders])
        raise UnreadableError(f"holds {len(folders)} recordings, in {names}", hint="unpack it, and give each")
    return [one for one in entries if not folders or places[one.filename] == folders[0]]


def _repeated(name: str, number: int, which: str) -> Problem:
    text = f"holds {number} parts named {name}: the {which} one was read"
    return Problem("repeated_part", text, None, 0, number - 1)


def _placed(file: BinaryIO, entry: zipfile.ZipInfo) -> tuple[Member, bool]:
    """Return a part listed in the directory, and whether its own header lies where it should."""
    name = entry.orig_filename.encode("utf-8" if entry.flag_bits & _UTF8 else "cp437", "replace")
    file.seek(entry.header_offset)
    header = file.read(ZIP_LOCAL.size + len(name)).ljust(ZIP_LOCAL.size, b"\0")
    extra_bytes = ZIP_LOCAL.unpack_from(header)[-1]
    member = Member(
        last_name(entry.filename),
        ENCRYPTED if entry.flag_bits & 1 else entry.compress_type,
        entry.header_offset + ZIP_LOCAL.size + len(name) + extra_bytes,
        entry.compress_size,
        entry.file_size,
        entry.CRC,
    )
    return member, header.startswith(ZIP_MAGIC) and header.endswith(name)


def by_headers(file: BinaryIO) -> tuple[dict[str, Member], tuple[Problem, ...]]:
    """Return the parts whose own headers are found, the first of each name; and which are repeated."""
    members: dict[str, Member] = {}
    places: dict[str, set[int]] = {}
    base, data = 0, b""
    file.seek(0)
    while block := file.read(_SCAN_BYTES):
        base, data = base + max(0, len(data) - _LONGEST_MATCH), data[-_LONGEST_MATCH:] + block
        for match in NAMED.finditer(data):
            if int.from_bytes(match[1], "little") != len(match[2]):
                continue
            name = last_name(match[2].decode("ascii", "replace"))
            places.setdefault(name, set()).add(base + match.start())
            if name not in members:
                members[name] = _by_header(file, base + match.start(), name)
                file.seek(base + len(data))
    many = {name: len(found) for name, found in places.items() if len(found) > 1}
    return members, tuple(_repeated(name, number, "first") for name, number in many.items())


def _by_header(file: BinaryIO, offset: int, name: str) -> Member:
    file.seek(offset)
    fields = ZIP_LOCAL.unpack(file.read(ZIP_LOCAL.size))
    _, _, flags, method, _, _, crc, packed, unpacked, name_bytes, extra_bytes = fields
    file.seek(offset + ZIP_LOCAL.size + name_bytes)
    if IN_EXTRA in (packed, unpacked):
        unpacked, packed = long_sizes(file.read(extra_bytes)) or (None, None)
    start = offset + ZIP_LOCAL.size + name_bytes + extra_bytes
    method = ENCRYPTED if flags & 1 else method
    if flags & _SIZES_FOLLOW and not packed:
        return Member(name, method, start)
    return Member(name, method, start, packed, unpacked, crc)


class Fault(Enum):
    """Reason why a part is not as it was packed."""

    CUT_OFF = "the file is cut short"
    DAMAGED = "it is damaged within"
    WRONG_CHECKSUM = "its checksum does not fit"


@dataclass(frozen=True, slots=True)
class Piece:
    """Some bytes of a part, perhaps the last, and how far the file on the disk has been read."""

    data: bytes
    last: bool
    end_byte: int


class MemberStream(Closing):
    """Reads a part from its beginning: `size` uncompressed bytes so far; a fault is known after the last."""

    def __init__(self, archive: Archive, member: Member) -> None:
        """Open a part; raises UnreadableError if it is encrypted, unusually compressed, or not readable."""
        self.member, self.size = member, 0
        self.fault: Fault | None = None
        self._path, self._ends = archive.path, archive.ends
        if member.method not in (STORED, DEFLATED):
            encrypted = member.method == ENCRYPTED
            how = "is encrypted" if encrypted else f"is compressed in an unusual way ({member.method})"
            hint = "unpack it and pack it again as a plain zip file"
            raise UnreadableError(f"{member.name} in it {how}", path=self._path, hint=hint)
        self._left = UNKNOWN_SIZE if member.packed_bytes is None else member.packed_bytes
        self._inflater = Inflater() if member.method == DEFLATED else None
        self._ended, self._crc = False, 0
        try:
            self._file = archive.path.open("rb")
            self._file.seek(min(member.start_byte, archive.size))
        except OSError as error:
            raise unread(error, self._path) from error

    def read(self, count: int) -> bytes:
        """Return `count` bytes, fewer only at the end; raises UnreadableError if the disk fails."""
        parts: list[bytes] = []
        while count > 0 and not self._ended:
            parts.append(self._step(count))
            count -= len(parts[-1])
        return b"".join(parts)

    def pieces(self, count: int, threads: int) -> Generator[Piece]:
        """Yield the whole part, `count` bytes at a time; the last piece is shorter, and may be empty."""
        return prefetch(self._all_pieces(count), threads)

    def _all_pieces(self, count: int) -> Iterator[Piece]:
        last = False
        while not last:
            data = self.read(count)
            last = len(data) < count
            yield Piece(data, last, self._file.tell())

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def problem(self, sample: int) -> Problem | None:
        """Return what is wrong with the part as a whole, once it has been read."""
        name = self.member.name
        if self.fault is None:
            return None
        if self.fault is Fault.WRONG_CHECKSUM:
            what = f"the checksum of {name} in the zip file is wrong"
            text = f"{what}: some of its bytes are not what was written"
            return Problem("archive_checksum", text, None, sample)
        lost = max(0, (self.member.unpacked_bytes or 0) - self.size)
        amounts = (lost, 0) if self.fault is Fault.DAMAGED else (0, lost)
        how_much = f"{lost} bytes of it are missing" if lost else "how much is missing is not known"
        text = f"{name} breaks off, as {self.fault.value}: {how_much}"
        return Problem("truncated", text, self.size, sample, max(1, lost), *amounts)

    def _step(self, most: int) -> bytes:
        if self._inflater is None:
            data = self._taken(most)
            over = not data or self._left == 0
        else:
            data, over = self._inflated(self._inflater, most)
        self._crc = crc32(data, self._crc)
        self.size += len(data)
        if over:
            self._end()
        return data

    def _inflated(self, inflater: Inflater, most: int) -> tuple[bytes, bool]:
        """Return the next bytes, at most `most`, and whether they are the last."""
        if inflater.needs_input:
            packed = self._taken(STEP_BYTES)
            if not packed:
                return b"", True
            inflater.put(packed)
        data = inflater.take(min(most, MOST_BYTES))
        return data, inflater.damaged or inflater.complete

    def _taken(self, most: int) -> bytes:
        try:
            packed = self._file.read(min(most, STEP_BYTES, self._left))
        except OSError as error:
            raise unread(error, self._path) from error
        self._left -= len(packed)
        return packed

    def _end(self) -> None:
        self._ended = True
        inflater = self._inflater
        if inflater is not None and inflater.damaged:
            self.fault = Fault.DAMAGED
        elif self._left > 0 if inflater is None else not inflater.complete:
            self.fault = Fault.DAMAGED if self._ends else Fault.CUT_OFF
        elif self.member.unpacked_bytes not in (None, self.size):
            self.fault = Fault.DAMAGED
        elif self.member.crc not in (None, self._crc):
            self.fault = Fault.WRONG_CHECKSUM


def small_part(archive: Archive, name: str) -> bytes | None:
    """Return a part that describes the recording, None if it is damaged; raises KeyError if there is none."""
    try:
        with MemberStream(archive, archive.members[name]) as stream:
            data = stream.read(SMALL_BYTES)
            return None if stream.fault else data
    except UnreadableError:
        return None
