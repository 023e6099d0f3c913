"""Paths that stand for several files, the parts of one recording: a folder, a pattern, or an archive."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from accelcal_cli.core.errors import UnreadableError, UsageError

ANY = "*"
ARCHIVES = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tbz", ".tar.xz", ".txz", ".zip")
"""Suffixes of files that may hold parts."""

NEVER = re.compile(
    r"\..*|(.*\.)?poses\.csv|.*\.(log\.csv|toml|(un)?calibrated\.parquet|(calibration|quality|integers)\.json)",
    re.I,
)
"""Names of files among parts that are none: logs (NHANES), options, layouts, lists of poses, and results of
ours."""

HOUR = re.compile(r"([^.]+\.[^.]+)\.\d{4}(?:-\d\d){5}-\d{3}-[PM]\d{4}(\.sensor\.csv(?:\.gz)?)", re.IGNORECASE)
HALF_HOUR = re.compile(r"(.+)_\d{10}\.avro", re.IGNORECASE)
DAY = re.compile(r"\d{4}-\d\d-\d\d")

MAGIC_BYTES, TAR_MAGIC, TAR_MAGIC_AT = 262, b"ustar", 257
PACKED = (b"PK\x03\x04", b"\x1f\x8b", b"BZh", b"\xfd7zXZ\x00")


def is_never(path: Path) -> bool:
    """Whether a file among parts is none, by its name."""
    return NEVER.fullmatch(path.name) is not None


def may_be_archive(path: Path) -> bool:
    """Whether a file, and no pipe, begins as an archive may; what cannot be read is none."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            head = file.read(MAGIC_BYTES)
    except (OSError, ValueError):
        return False
    return head.startswith(PACKED) or head[TAR_MAGIC_AT:] == TAR_MAGIC


def files_of(path: Path) -> tuple[Path, ...] | None:
    """The files that a folder or a pattern stands for, by name; None for any other path.

    Raises:
        UnreadableError: a folder cannot be looked into. What is in it may be parts.
    """
    try:
        if path.is_dir():
            found = _below(path)
        elif is_pattern(path):
            found = _matching(path)
        else:
            return None
        return tuple(sorted(one for one in found if one.is_file() and not is_never(one)))
    except OSError as error:
        place = error.filename or path
        hint = "check its permissions and its disk"
        raise UnreadableError(f"cannot be read ({error.strerror or error})", path=place, hint=hint) from error


def _below(folder: Path) -> Iterable[Path]:
    """All that is in a folder and in those in it; raises OSError where one cannot be looked into."""

    def refuse(error: OSError) -> None:
        raise error

    for place, _, names in os.walk(folder, onerror=refuse):
        yield from (Path(place, name) for name in names)


def is_pattern(path: Path) -> bool:
    """Whether a path is no file, but a pattern of files' names."""
    try:
        return ANY in str(path) and not os.path.lexists(path)
    except ValueError:
        return False


def _matching(path: Path) -> Iterable[Path]:
    """Files whose path fits a pattern in which only `*` has a meaning."""
    parts = path.parts
    first = next(number for number, part in enumerate(parts) if ANY in part)
    pattern = "/".join(part.replace("[", "[[]").replace("?", "[?]") for part in parts[first:])
    return Path(*parts[:first]).glob(pattern)


def set_of(path: Path) -> Path | None:
    """The pattern of all parts of the recording that a file is one of, if its name says so.

    An hour of NHANES, or half an hour of an EmbracePlus, whose folders are DATE/PERSON-DEVICE/raw_data/v6
    (Empatica, "Data Connection - raw data").
    """
    if (found := HOUR.fullmatch(path.name)) is not None:
        return path.with_name(f"{found[1]}.{ANY}{found[2]}")
    if (found := HALF_HOUR.fullmatch(path.name)) is None:
        return None
    pattern, day = path.with_name(f"{found[1]}_{ANY}.avro"), path.parents[3:4]
    if day and DAY.fullmatch(day[0].name) and path.parents[1].name == "raw_data":
        return day[0].parent / ANY / pattern.relative_to(day[0])
    return pattern


def pattern_of(paths: Sequence[Path]) -> Path:
    """The pattern that stands for just these files of one folder.

    Raises:
        UsageError: there is none.
    """
    folders, names = {path.parent for path in paths}, [path.name for path in paths]
    begin = os.path.commonprefix(names)  # noqa: RUF071 (of names, by characters)
    end = os.path.commonprefix([name[len(begin) :][::-1] for name in names])[::-1]  # noqa: RUF071
    pattern = paths[0].parent / f"{begin}{ANY}{end}"
    if len(folders) > 1 or set(files_of(pattern) or ()) != set(paths):
        hint = "put them into a folder of their own, and name that, or give a pattern in quotes"
        raise UsageError("the parts cannot be told from other files by a pattern", path=paths[0], hint=hint)
    return pattern


def size_of(path: Path) -> int:
    """Bytes of a recording's file, or of all its parts.

    Raises:
        OSError, UnreadableError: one cannot be looked at.
    """
    files = files_of(path)
    return path.stat().st_size if files is None else sum(one.stat().st_size for one in files)
