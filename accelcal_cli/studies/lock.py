"""One run at a time in an output folder: a file that names the host and the process that hold it."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO, Any

from accelcal_cli.core.errors import LockedError, OutputError
from accelcal_cli.core.system import host, lives
from accelcal_cli.output.files import beside, discard, open_plain, output_error, parsed

try:
    import fcntl
except ImportError:  # pragma: no cover
    fcntl = None  # type: ignore[assignment]

UNFINISHED_S = 60.0
"""A lock without all its content is one whose writer is about to write it, or died before it could."""

BEGINNING = '{"host": '
LONGEST = 4096
"""How the content of a lock begins, and more characters than it has."""


@contextlib.contextmanager
def held(path: Path, others: Callable[[], Iterable[Path]] = tuple) -> Iterator[None]:
    """Hold a lock file while the block runs.

    Args:
        others: returns, once ours is held, the locks that no living process may hold meanwhile. Of two that
            exclude each other, at least one sees the other.

    Raises:
        LockedError: a living process holds one of them, or one on another host that cannot be asked.
        OutputError: the lock cannot be written, or another one not be read.
    """
    me = this_run()
    try:
        _take(path, me)
    except OSError as error:
        raise output_error(error, path) from error
    try:
        for other in others():
            if other != path:
                _check_free(other)
        yield
    finally:
        with contextlib.suppress(OSError, OutputError):
            if _read(path) == me:
                path.unlink(missing_ok=True)


def _check_free(path: Path) -> None:
    """Raise where a living process holds a lock, or where that cannot be seen."""
    try:
        owner = _read(path)
    except OSError as error:
        raise output_error(error, path) from error
    if owner is not None and not _stale(path, owner):
        raise _refusal(path, owner)


def this_run() -> dict[str, Any]:
    """What a lock of this process holds."""
    return {"host": host(), "pid": os.getpid(), "started": _started(os.getpid())}


def _take(path: Path, me: dict[str, Any]) -> None:
    while not _create(path, me):
        if (owner := _read(path)) is None:
            continue
        if not _stale(path, owner) or not take_over(path, owner, me):
            raise _refusal(path, _read(path) or owner)
        return


def _create(path: Path, me: dict[str, Any]) -> bool:
    """Make the lock with its content at once; False if there is one already."""
    temporary = beside(path)
    try:
        temporary.write_text(json.dumps(me), encoding="utf-8")
        return _link(temporary, path, me)
    finally:
        discard(temporary)


def _link(temporary: Path, path: Path, me: dict[str, Any]) -> bool:
    try:
        os.link(temporary, path)
    except FileExistsError:
        return False
    except OSError:
        return _create_exclusively(path, me)
    return True


def _create_exclusively(path: Path, me: dict[str, Any]) -> bool:
    """For disks without links."""
    try:
        with path.open("x", encoding="utf-8") as file:
            json.dump(me, file)
    except FileExistsError:
        return False
    return True


def take_over(path: Path, owner: dict[str, Any], me: dict[str, Any]) -> bool:
    """Write our name into a stale lock; False if another was faster.

    The file stays in place, so that of two that find it stale one cannot remove the other's.
    """
    with contextlib.suppress(FileNotFoundError), open_plain(path, "r+b") as file:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX)
        if _parsed(_text(file)) == owner and path.stat().st_ino == os.fstat(file.fileno()).st_ino:
            file.seek(0)
            file.truncate()
            file.write(json.dumps(me).encode())
            return True
    return False


def _read(path: Path) -> dict[str, Any] | None:
    """Who holds a lock; an empty record where it does not say yet, None if there is no lock.

    Raises:
        OutputError: the file is not a lock of ours.
    """
    try:
        with open_plain(path, "rb") as file:
            text = _text(file)
    except FileNotFoundError:
        return None
    owner = _parsed(text)
    if not owner and not text.startswith(BEGINNING[: len(text)]):
        hint = "move it away, or choose another folder with -d"
        raise OutputError("was not written by accelcal", path=path, hint=hint)
    return owner


def _text(file: IO[bytes]) -> str:
    return file.read(LONGEST).decode(errors="replace")


def _parsed(text: str) -> dict[str, Any]:
    try:
        found = parsed(text)
    except ValueError:
        return {}
    return found if isinstance(found, dict) and isinstance(found.get("pid"), int) else {}


def _stale(path: Path, owner: dict[str, Any]) -> bool:
    """Whether the process that holds a lock is gone; of another host's we cannot know."""
    if not owner:
        with contextlib.suppress(OSError):
            return time.time() - path.stat().st_mtime > UNFINISHED_S
        return False
    if owner.get("host") != host():
        return False
    return not lives(owner["pid"]) or _started(owner["pid"]) != owner.get("started")


def _started(process: int) -> str | None:
    """When a process began, so that a number that was given again is not taken for it; None if not known.

    The 22nd field of `/proc/PID/stat` (proc(5)), counted from the last parenthesis, and the boot.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        fields = Path(f"/proc/{process}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
        return f"{boot} {fields[19]}"
    except (OSError, IndexError):
        return None


def _refusal(path: Path, owner: dict[str, Any]) -> LockedError:
    who = f"process {owner['pid']} on {owner.get('host')}" if owner else "another process"
    elsewhere = owner and owner.get("host") != host()
    hint = f"if it is no longer running there, remove {path.name}" if elsewhere else "wait for it to end"
    return LockedError(f"{who} is working in this folder", path=path, hint=hint)
