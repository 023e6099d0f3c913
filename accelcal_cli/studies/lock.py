"""One run at a time in an output folder: a lock file that names its run.

A lock is linked to its name with its content (open(2) says why link(2), not O_EXCL, is to be used on NFS). It
is taken away by renaming it, which only one of several runs can, and put back if it is another's by then. The
lock of another host stays until a user removes it. A run whose lock was removed finds that before it writes
what two runs must not write.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import LockedError, OutputError
from accelcal_cli.core.system import host, lives, process_start
from accelcal_cli.output.files import discard, disk_errors, open_plain, parsed, temporary_beside

UNFINISHED_S = 60.0
"""Age [s] from which a lock without all its content is that of a run that died while it wrote it."""
HIGHEST_PROCESS = 1 << 32
"""More than any number of a process; any other text, or 0 or less, would mean other processes."""
BEGINNING, LONGEST = '{"host": ', 4096
"""Beginning of the content of every lock, and more bytes than it has."""
GO_ON = "finished recordings are kept; run the same command again to continue"


@dataclass(frozen=True, slots=True)
class Lock:
    """A lock file as it was read: content, run (empty where it is not complete), time of the last touch."""

    text: str
    run: dict[str, Any]
    touched_s: float

    def __str__(self) -> str:
        return f"process {self.run['pid']} on {self.run.get('host')}" if self.run else "another process"

    def has_ended(self) -> bool:
        """Return True if its run is known to have ended, which is never known of another host's."""
        if not self.run:
            return time.time() - self.touched_s > UNFINISHED_S
        pid, started = self.run["pid"], self.run.get("started")
        return self.run.get("host") == host() and (not lives(pid) or process_start(pid) != started)


@dataclass(frozen=True, slots=True)
class Lease:
    """The lock that this run holds."""

    path: Path
    text: str

    def confirm(self) -> None:
        """Raise LockedError if the lock is no longer this run's: before what two runs must not write."""
        try:
            lock = read_lock(self.path)
        except OutputError as error:
            reason = f"the lock of this run was replaced ({error.message})"
            raise LockedError(reason, path=self.path) from error
        except OSError:  # a disk that does not answer does not take what is written next, either
            return
        if lock is None or lock.text != self.text:
            how = "was removed" if lock is None else f"was taken over by {lock}"
            raise LockedError(f"the lock of this run {how}", path=self.path, hint=GO_ON)


@contextlib.contextmanager
def locked(path: Path, others: Callable[[], Iterable[Path]] = tuple) -> Iterator[Lease]:
    """Hold a lock file while the block runs; of two that exclude each other at least one sees the other.

    Args:
        others: returns, once ours is there, locks that no living run may hold at the same time.

    Raises:
        LockedError: a living process holds one of them, or one on another host that cannot be asked.
        OutputError: the lock cannot be written, or another one not be read.
    """
    text = this_run()
    with disk_errors(path):
        while not _create(path, text):
            _remove_ended([path], text)
    try:
        with disk_errors(path):
            _remove_ended([one for one in others() if one != path], text)
        yield Lease(path, text)
    finally:
        with contextlib.suppress(OSError, OutputError):
            remove(path, text)


def this_run() -> str:
    """Return the content of a lock of this process, different each time."""
    process = {"host": host(), "pid": os.getpid(), "started": process_start(os.getpid())}
    return json.dumps({**process, "run": os.urandom(8).hex()})


def read_lock(path: Path) -> Lock | None:
    """Read a lock, None if there is none; raises OSError, and OutputError for a file that is not a lock."""
    try:
        with open_plain(path, "rb") as file:  # opened, so that NFS asks the server
            text, touched_s = file.read(LONGEST).decode(errors="replace"), os.fstat(file.fileno()).st_mtime
        run = parsed(text)
    except FileNotFoundError:
        return None
    except ValueError:
        run = None
    if isinstance(run, dict) and type(run.get("pid")) is int and 0 < run["pid"] < HIGHEST_PROCESS:
        return Lock(text, run, touched_s)
    if text.startswith(BEGINNING[: len(text)]):
        return Lock(text, {}, touched_s)
    hint = "move it away, or choose another folder with -d"
    raise OutputError("was not written by accelcal", path=path, hint=hint)


def remove(path: Path, text: str) -> bool:
    """Remove the lock of this content; False if there is none, or it is another run's, which keeps it."""
    if not _is_ours(path, text):
        return False
    aside = temporary_beside(path)
    try:
        path.replace(aside)
        if _is_ours(aside, text):
            return True
        with contextlib.suppress(OSError):
            os.link(aside, path)  # it has become another run's just now
    except FileNotFoundError:
        pass
    finally:
        discard(aside)
    return False


def _create(path: Path, text: str) -> bool:
    """Make a lock with its content at once; False if there is one already."""
    temporary = temporary_beside(path)
    try:
        temporary.write_bytes(text.encode())
        try:
            os.link(temporary, path)
        except FileExistsError:
            pass
        except OSError:  # a disk without links, or a link was made but the answer of the server was lost
            with contextlib.suppress(FileExistsError), path.open("xb") as file:
                file.write(text.encode())
    finally:
        discard(temporary)
    return _is_ours(path, text)


def _is_ours(path: Path, text: str) -> bool:
    return (lock := read_lock(path)) is not None and lock.text == text


def _remove_ended(paths: Iterable[Path], ours: str) -> None:
    """Remove locks whose runs have ended, or raise LockedError; ours may just have been put back."""
    found = {path: lock for path in paths if (lock := read_lock(path)) is not None}
    locks = {path: lock for path, lock in found.items() if lock.text != ours}
    for path, lock in locks.items():
        if not lock.has_ended():
            raise _refusal(path, lock)
    for path, lock in locks.items():
        if not remove(path, lock.text) and (faster := read_lock(path)) is not None and faster.text != ours:
            raise _refusal(path, faster)


def _refusal(path: Path, lock: Lock) -> LockedError:
    """Return the error for a lock of another run."""
    hint = "wait for it to end"
    if lock.run and lock.run.get("host") != host():
        part = path.stem.removeprefix("study").removeprefix(".").replace("-of-", "/")
        options = f"--shard {part} --unlock" if part else "--unlock"
        hint = f"if it is no longer running there, remove its lock with {options}"
    return LockedError(f"{lock} is working in this folder", path=path, hint=hint)
