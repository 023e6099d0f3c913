"""Files that users name: paths that stand for the parts of a recording, and small text files read whole.

Parts are given as a folder, a pattern or an archive. A text file (a layout, a list of poses, options of a
study) may be a pipe or a device that never ends, so no more is read than such a file can hold.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.paths import files_below, has_file, is_file, open_found, unreadable
from accelcal_cli.core.paths import stat_or_none as look
from accelcal_cli.core.unpacking import PACKED_SUFFIXES, packing_of

ANY = "*"
ARCHIVES = (
    ".tar",
    *(f".tar{one}" for one in PACKED_SUFFIXES),
    ".tgz",
    ".tbz2",
    ".tbz",
    ".txz",
    ".tzst",
    ".zip",
)
"""Suffixes of files that may hold parts."""

NO_PART = re.compile(
    r"\..*|(.*\.)?poses\.csv|.*\.(log\.csv|toml|(un)?calibrated\.parquet|(calibration|quality|integers)\.json)",
    re.I,
)
"""Names that no part has: of logs (NHANES), options, layouts, lists of poses, and our own results."""

HOUR = re.compile(
    r"([^.]+\.[^.]+)\.\d{4}(?:-\d\d){5}-\d{3}-[PM]\d{4}(\.sensor\.csv(?:\.gz|\.bz2|\.xz|\.zst)?)", re.I
)
HALF_HOUR = re.compile(r"(.+)_\d{10}\.avro", re.IGNORECASE)
DAY = re.compile(r"\d{4}-\d\d-\d\d")

MAGIC_BYTES, TAR_MAGIC, TAR_MAGIC_AT = 262, b"ustar", 257
LONGEST_LINE = 1000
"""Most characters in a line of TOML: the time to parse a line grows with its square."""


def is_no_part(path: Path) -> bool:
    """Return True for a file among parts that is not one of them, by its name."""
    return NO_PART.fullmatch(path.name) is not None


def may_be_archive(path: Path) -> bool:
    """Return True if a plain file begins as an archive may.

    Raises:
        UnreadableError: the disk does not answer.
    """
    if not has_file(path):
        return False
    try:
        with path.open("rb") as file:
            head = file.read(MAGIC_BYTES)
    except OSError as error:
        raise unreadable(error, path) from error
    return head.startswith(b"PK\x03\x04") or packing_of(head) is not None or head[TAR_MAGIC_AT:] == TAR_MAGIC


def files_of(path: Path) -> tuple[Path, ...] | None:
    """Return the files that a folder or a pattern stands for, by name; None for any other path.

    Raises:
        UnreadableError: a folder cannot be looked into. What is in it may be parts.
    """
    try:
        status = look(path)
        if status is not None and stat.S_ISDIR(status.st_mode):
            faults: list[OSError] = []
            found = [place / name for place, _, names in files_below(path, faults) for name in names]
            if faults:
                raise faults[0]
        elif is_pattern(path):
            found = list(matching(path))
        else:
            return None
        return tuple(sorted(one for one in found if is_file(one) and not is_no_part(one)))
    except OSError as error:
        raise unreadable(error, path) from error


def is_pattern(path: Path) -> bool:
    """Return True if a path is not a file, but a pattern of file names."""
    try:
        return ANY in str(path) and not os.path.lexists(path)
    except ValueError:
        return False


def matching(path: Path) -> Iterable[Path]:
    """Return the files whose path fits a pattern in which only `*` has a meaning."""
    parts = path.parts
    first = next(number for number, part in enumerate(parts) if ANY in part)
    pattern = "/".join(part.replace("[", "[[]").replace("?", "[?]") for part in parts[first:])
    return Path(*parts[:first]).glob(pattern)


def pattern_of_siblings(path: Path) -> Path | None:
    """Return the pattern of all parts of the recording that a file is one of, if its name says so.

    A part is an hour of NHANES, or half an hour of an EmbracePlus, whose folders are
    DATE/PERSON-DEVICE/raw_data/v6 (Empatica, "Data Connection - raw data").
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
    """Return the pattern that stands for just these files of one folder.

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
    """Return the bytes of a recording's file, or of all its parts.

    Raises:
        OSError, UnreadableError: one cannot be looked at.
    """
    files = files_of(path)
    return path.stat().st_size if files is None else sum(one.stat().st_size for one in files)


def read_text(path: Path, what: str, most_bytes: int, encoding: str = "utf-8", *, found: bool = False) -> str:
    """Return the text of a file, with lines ended by `\\n`.

    Args:
        what: what to call it in errors, such as `the layout`.
        most_bytes: the longest that it may be.
        found: it was not named, so that a pipe is not waited for.

    Raises:
        UsageError: it cannot be read, is longer, or is not UTF-8.
    """
    try:
        with open_found(path) if found else path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except UnreadableError as error:
        raise UsageError(f"{what} {error.message}", path=path, hint=error.hint) from error
    except OSError as error:
        raise UsageError(f"{what} cannot be read ({error.strerror or error})", path=path) from error
    if len(data) > most_bytes:
        raise UsageError(f"{what} is too large, more than {most_bytes} bytes", path=path)
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        raise UsageError(f"{what} is not UTF-8 text", path=path, byte_offset=error.start) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: Path, what: str, most_bytes: int, *, found: bool = False) -> dict[str, Any]:
    """Return the content of a TOML file; arguments as for `read_text`.

    Raises:
        UsageError: it cannot be read, or is not TOML.
    """
    import tomllib  # few recordings have such a file

    text = read_text(path, what, most_bytes, "utf-8-sig", found=found)
    for number, line in enumerate(text.split("\n"), 1):
        if len(line) > LONGEST_LINE:
            raise UsageError(
                f"{what} has a line of more than {LONGEST_LINE} characters", path=path, line=number
            )
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise UsageError(f"{what} is not valid: its brackets are nested too deep", path=path) from error
    except ValueError as error:
        match = re.search(r"at line (\d+)", str(error))
        place = int(match[1]) if match else None
        raise UsageError(f"{what} is not valid TOML ({error})", path=path, line=place) from error
