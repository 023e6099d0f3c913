"""The one door to the file system: every question about a path, and every file that was found, not named.

A disk may refuse any question (no permission, a name that is too long, a loop of links, a fault, a server
that is gone). Whoever asks here gets an answer or one of our errors, so that a bad path costs itself alone.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.system import FOUND_FILE

ABSENT = frozenset((errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP, errno.EBADF, errno.EINVAL))
"""Error numbers that say that there is nothing of that name, not that the disk cannot tell."""

NOT_PLAIN = "is a pipe, a device or a folder, not a plain file"
CHECK_DISK = "check its permissions and its disk"


def stat_or_none(path: Path, *, follow: bool = True) -> os.stat_result | None:
    """Return what is at a path; None if there is nothing, or can be nothing of that name.

    Args:
        follow: go through a link to what it leads to.

    Raises:
        OSError: the disk cannot tell.
    """
    try:
        return os.stat(path, follow_symlinks=follow)  # noqa: PTH116 (this is the door)
    except ValueError:  # a name with a zero byte
        return None
    except OSError as error:
        if error.errno in ABSENT:
            return None
        raise


def is_file(path: Path) -> bool:
    """Return True for a plain file, or a link to one; False also where the disk cannot tell."""
    found = _seen(path)
    return found is not None and stat.S_ISREG(found.st_mode)


def is_folder(path: Path) -> bool:
    """Return True for a folder, or a link to one; False also where the disk cannot tell."""
    found = _seen(path)
    return found is not None and stat.S_ISDIR(found.st_mode)


def is_link(path: Path) -> bool:
    """Return True for a link, broken or not; False also where the disk cannot tell."""
    found = _seen(path, follow=False)
    return found is not None and stat.S_ISLNK(found.st_mode)


def is_there(path: Path) -> bool:
    """Return True if anything is at a path, or if the disk cannot tell: then it must not be taken as gone."""
    try:
        return stat_or_none(path, follow=False) is not None
    except OSError:
        return True


def _seen(path: Path, *, follow: bool = True) -> os.stat_result | None:
    try:
        return stat_or_none(path, follow=follow)
    except OSError:
        return None


def has_file(path: Path) -> bool:
    """Return True for a plain file that counts if it is there, such as one that says how to read another.

    Raises:
        UnreadableError: the disk does not answer, and to continue without it might read a recording wrongly.
    """
    try:
        found = stat_or_none(path)
    except OSError as error:
        raise unreadable(error, path) from error
    return found is not None and stat.S_ISREG(found.st_mode)


def is_same(path: Path, other: Path) -> bool:
    """Return True if two paths lead to one file; False also where the disk cannot tell."""
    one, two = _seen(path), _seen(other)
    return one is not None and two is not None and (one.st_dev, one.st_ino) == (two.st_dev, two.st_ino)


def matching(folder: Path, pattern: str) -> list[Path]:
    """Return the paths below a folder that fit a pattern, sorted; raises OSError if the disk cannot tell."""
    return sorted(folder.glob(pattern))


def files_below(
    folder: Path, faults: list[OSError], *, follow: bool = False
) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Yield each folder, with the names of its folders (those left in the list are entered) and files.

    Args:
        faults: receives the error of each folder that cannot be listed.
        follow: enter links to folders, too.
    """
    for place, folders, names in os.walk(folder, onerror=faults.append, followlinks=follow):
        yield Path(place), folders, names


def open_found(path: Path) -> BinaryIO:
    """Open a file that was found, not named: it is looked at first, since opening a pipe would wait.

    Raises:
        UnreadableError: it is not a plain file.
        OSError: it is not there or cannot be opened.
    """
    handle = os.open(path, os.O_RDONLY | FOUND_FILE)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise UnreadableError(NOT_PLAIN, path=path, hint="move it away")
    return os.fdopen(handle, "rb")


def unreadable(error: OSError, path: Path) -> UnreadableError:
    """Return the error to show for a path that the disk cannot tell about."""
    what = f"cannot be read ({error.strerror or error})"
    return UnreadableError(what, path=error.filename or path, hint=CHECK_DISK)
