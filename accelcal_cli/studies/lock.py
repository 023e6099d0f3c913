"""One run at a time in an output folder: a lock file that names its run, and that this run keeps touching.

A lock is linked to its name with its content (open(2) says why link(2), not O_EXCL, is to be used on NFS). It
is taken away by renaming it, which only one of several runs can, and put back if it is another's by then. No
clocks are compared: a run that waits for one of another host counts its own looks that saw nothing new. A run
that was only held up finds that its lock is gone before it writes what two runs must not write.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import LockedError, OutputError, printable
from accelcal_cli.core.system import host, lives, process_start
from accelcal_cli.output.files import discard, disk_errors, open_plain, parsed, temporary_beside

BEAT_S = 10.0
"""Interval [s] at which a run touches its lock."""
LOOK_S = 5.0
"""Interval [s] at which a run looks at the lock of another host that it waits for."""
LEAST_SILENCE_S = 120.0
"""Shortest silence [s] that may count as an end: twelve beats, twice NFS's `acregmax` by default (nfs(5))."""
BLIND_S = 60.0
"""Time [s] after which a run that cannot read its lock writes nothing more: it may have been taken over."""
SIGNS = 2
"""Number of changes of a lock that show that its run lives: a cache may show one after it has ended."""
UNFINISHED_S = 60.0
"""Age [s] from which a lock without all its content is that of a run that died while it wrote it."""
HIGHEST_PROCESS = 1 << 32
"""More than any number of a process; any other text, or 0 or less, would mean other processes."""
BEGINNING, LONGEST = '{"host": ', 4096
"""Beginning of the content of every lock, and more bytes than it has."""
GO_ON = "finished recordings are kept; run the same command again to continue"


@dataclass(frozen=True, slots=True)
class Patience:
    """How long [s] runs of other hosts may be silent, and what is called with a line about the wait."""

    silence_s: float
    notify: Callable[[str], None]


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


class Lease:
    """The lock that this run holds.

    Attributes:
        lost: locks that were taken over from runs of other hosts, this one or others, and these hosts.
    """

    def __init__(self, path: Path, text: str) -> None:
        self.lost: dict[Path, str] = {}
        self._path, self._text = path, text
        self._loss: LockedError | None = None
        self._seen_s = time.monotonic()

    def check(self) -> None:
        """Raise LockedError if the lock was found to be lost; reads nothing."""
        if self._loss is not None:
            raise self._loss

    def confirm(self) -> None:
        """Raise LockedError if the lock is lost or unreadable for BLIND_S: before what two must not write."""
        self.check()
        try:
            lock = read_lock(self._path)
            self._seen_s = time.monotonic()
            if lock is None or lock.text != self._text:
                how = "was removed" if lock is None else f"was taken over by {lock}"
                self._loss = LockedError(f"the lock of this run {how}", path=self._path, hint=GO_ON)
        except OutputError as error:
            reason = f"the lock of this run was replaced ({error.message})"
            self._loss = LockedError(reason, path=self._path)
        except OSError as error:
            blind_s = time.monotonic() - self._seen_s
            if blind_s > BLIND_S:
                reason = f"cannot be read for {blind_s:.0f} s ({error.strerror or error})"
                raise LockedError(reason, path=self._path, hint=GO_ON) from error
        self.check()

    def beat(self, ended: threading.Event) -> None:
        """Touch the lock every BEAT_S until it is lost or the run has ended."""
        while self._loss is None and not ended.wait(BEAT_S):
            with contextlib.suppress(LockedError, OSError):
                self.confirm()
                os.utime(self._path)


@contextlib.contextmanager
def locked(
    path: Path, others: Callable[[], Iterable[Path]] = tuple, patience: Patience | None = None
) -> Iterator[Lease]:
    """Hold a lock file while the block runs; of two that exclude each other at least one sees the other.

    Args:
        others: returns, once ours is there, locks that no living run may hold at the same time.
        patience: None: only a run of this host is found to have ended.

    Raises:
        LockedError: a living process holds one of them, or one on another host that cannot be asked.
        OutputError: the lock cannot be written, or another one not be read.
    """
    text, ended = this_run(), threading.Event()
    lease = Lease(path, text)
    with disk_errors(path):
        while not _create(path, text):
            lease.lost |= _remove_ended([path], patience)
    heart = threading.Thread(target=lease.beat, args=(ended,), daemon=True, name="heartbeat")
    heart.start()
    try:
        with disk_errors(path):
            lease.lost |= _remove_ended([one for one in others() if one != path], patience)
        yield lease
    finally:
        ended.set()
        heart.join()
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


def _remove_ended(paths: Iterable[Path], patience: Patience | None) -> dict[Path, str]:
    """Remove locks whose runs have ended, or raise LockedError; returns the other hosts' locks, with host."""
    locks = {path: lock for path in paths if (lock := read_lock(path)) is not None}
    unknown = {path: lock for path, lock in locks.items() if not lock.has_ended()}
    for path, lock in unknown.items():
        if patience is None or lock.run.get("host") in (None, host()):
            raise _refusal(path, lock)
    if patience is not None:
        for path, lock in unknown.items():
            what = f"{printable(path)} is taken over from {lock}"
            patience.notify(f"{what} after {patience.silence_s / 60:g} minutes without a sign of life")
        if (alive := _one_that_lives(unknown, patience.silence_s)) is not None:
            raise _refusal(alive, unknown[alive], seen=True)
    lost = {path: lock.run.get("host") for path, lock in locks.items() if remove(path, lock.text)}
    for path in locks.keys() - lost:
        if (faster := read_lock(path)) is not None:
            raise _refusal(path, faster)
    return {path: name for path, name in lost.items() if name not in (None, host())}


def _one_that_lives(paths: Iterable[Path], silence_s: float) -> Path | None:
    """Watch locks until the run of one shows that it lives; None if all were silent for this long."""
    last, changes, quiet = {path: read_lock(path) for path in paths}, Counter[Path](), 0
    while any(last.values()) and quiet < ceil(silence_s / LOOK_S):
        time.sleep(LOOK_S)  # time in which a disk does not answer counts as one look
        seen = {path: read_lock(path) for path in paths}
        changes.update(path for path, lock in seen.items() if lock is not None and lock != last[path])
        if (alive := next((path for path, number in changes.items() if number >= SIGNS), None)) is not None:
            return alive
        quiet = quiet + 1 if seen == last else 0
        last = seen
    return None


def _refusal(path: Path, lock: Lock, *, seen: bool = False) -> LockedError:
    """Return the error for a lock of another run; `seen`: that run gave signs of life."""
    hint = "wait for it to end"
    if lock.run and lock.run.get("host") != host() and not seen:
        hint = f"if it is no longer running there, remove {path.name}, or give --takeover MINUTES"
    return LockedError(f"{lock} is working in this folder", path=path, hint=hint)
