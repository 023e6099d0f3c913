"""Archives of recordings: `.tar` (plain or packed with gzip, bzip2 or xz) and `.zip`, unpacked within bounds.

Members are unpacked one after the other into a temporary folder, those of one folder of the archive into one
folder there, under their own names; nothing else that an archive says is believed. From a damaged archive,
the members before the damage are read. An archive that unpacks to more than a recording does is refused, and
the disk of the temporary folder is never filled.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from accelcal_cli.core.errors import OutputError, UnreadableError, counted, unread
from accelcal_cli.core.formats import ZIP_MAGIC
from accelcal_cli.core.input_files import TAR_MAGIC, TAR_MAGIC_AT
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.recording import Problem
from accelcal_cli.formats._parts.members import BROKEN, Allowance, members, unpacking

LONGEST_NAME = 200
"""Most bytes in a file's name; file systems take 255."""

MOST_BYTES, MOST_TIMES = 1 << 30, 250
"""Bytes that any archive may unpack to, and further ones for each byte of its own."""

MORE_SPACE = "set TMPDIR to a disk with more space"

LOOKED_BYTES, MOST_EMPTY = 1 << 24, 100
"""Bytes in which names are looked for, and members without bytes that are unpacked."""

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
        with unpacking(path) as file:
            head = file.read(TAR_MAGIC_AT + len(TAR_MAGIC))
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
