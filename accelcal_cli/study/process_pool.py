"""Where the server that workers are forked from listens: a folder that goes with this process.

multiprocessing makes one in the folder for temporary files. A killed process would leave it there for ever,
and where that folder's path is long the name of the socket becomes too long to be one.

A crew of processes, each with one task at a time; what befalls one befalls its task alone.
"""

from __future__ import annotations

import contextlib
import hashlib
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import connection, forkserver, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.system import hold_to_one_thread, host, lives
from accelcal_cli.study.records import Ended, Moved, Work

LONGEST = 40
"""Bytes of the path that leave room for the rest of a socket's name, 108 in all on Linux (unix(7))."""

OTHERS = ("/tmp", "/var/tmp")

AFTER_ALL = -200
"""multiprocessing removes its own folder in ours before (at -100)."""


@contextlib.contextmanager
def short_lived() -> Iterator[None]:
    """In the block, temporary files are made in a folder that is removed when this process ends.

    If it is killed, the next one of this host and user removes it.

    Raises:
        OSError: there is no place for one.
    """
    before = tempfile.tempdir
    tempfile.tempdir = str(_folder())
    try:
        yield
    finally:
        tempfile.tempdir = before


@cache
def _folder() -> Path:
    above = next((path for path in (tempfile.gettempdir(), *OTHERS) if _fits(path)), tempfile.gettempdir())
    start = f"accelcal-{hashlib.sha256(host().encode()).hexdigest()[:6]}-"
    _sweep(Path(above), start)
    made = tempfile.mkdtemp(prefix=f"{start}{os.getpid()}-", dir=above)
    Finalize(None, shutil.rmtree, (made, True), exitpriority=AFTER_ALL)
    return Path(made)


def _fits(path: str) -> bool:
    return len(os.fsencode(path)) <= LONGEST and os.access(path, os.W_OK | os.X_OK)


def _sweep(above: Path, start: str) -> None:
    """Remove the folders of processes that are gone."""
    with contextlib.suppress(OSError), os.scandir(above) as found:
        for one in found:
            owner = one.name.removeprefix(start).split("-")[0]
            if one.name.startswith(start) and owner.isdigit() and not lives(int(owner)):
                shutil.rmtree(one.path, ignore_errors=True)


POLL_S = 1.0
GRACE_S = 10.0
TRIES = 5
GONE_S = 0.1
"""A server that was killed is known to be gone only a moment later."""

TERMINATED = 143
UNTOLD = 255
"""What multiprocessing says of a process whose server is gone."""


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    pipe: Connection
    task: Any = None
    began: float = 0.0
    part: float = 0.0


@dataclass(slots=True)
class Crew:
    """Workers that take tasks as they become free.

    Attributes:
        work: what is done with a task.
        number: how many work at a time.
        timeout_s: the longest a task may take; None for no end.
        preload: a module with all that the work imports; imported once where workers are forked.
        moved: see `Moved`.
    """

    work: Work
    number: int
    timeout_s: float | None = None
    preload: str | None = None
    moved: Moved = lambda _task, _part: None
    _idle: list[_Worker] = field(default_factory=list)
    _busy: list[_Worker] = field(default_factory=list)

    def run(self, tasks: list[Any]) -> Generator[Ended, None, None]:
        """Do all tasks; yields each as it ends. All workers are gone when the iteration is.

        Raises:
            OutputError: there is no worker left, and none can be started.
        """
        waiting = list(reversed(tasks))
        try:
            while waiting or self._busy:
                while waiting and len(self._busy) < self.number:
                    self._give(waiting)
                yield from self._listen()
        finally:
            self._dismiss()

    def _give(self, waiting: list[Any]) -> None:
        """Give the last of them to a worker; fewer work from now on if none can be started."""
        try:
            worker = self._idle.pop() if self._idle else self._start()
        except OutputError:
            if not self._busy:
                raise
            self.number = len(self._busy)
            return
        task = waiting.pop()
        worker.task, worker.began, worker.part = task, time.monotonic(), 0.0
        self._busy.append(worker)
        with contextlib.suppress(OSError):
            worker.pipe.send(task)

    def _start(self) -> _Worker:
        """A new worker; from another server if the first was killed."""
        preload = self.preload or self.work.__module__
        try:
            for _ in range(TRIES):
                with contextlib.suppress(EOFError, ConnectionError):
                    return _started(self.work, preload)
                time.sleep(GONE_S)
            return _started(self.work, preload)
        except (OSError, EOFError) as error:
            raise OutputError(
                f"no process can be started for the work ({getattr(error, 'strerror', None) or error})",
                hint="see that the working folder and that of temporary files exist, or use fewer --jobs",
            ) from error

    def _listen(self) -> Iterator[Ended]:
        """What the busy workers have to say within a moment."""
        ready = connection.wait([worker.pipe for worker in self._busy], timeout=POLL_S)
        for worker in [worker for worker in self._busy if worker.pipe in ready]:
            if (ended := self._heard(worker)) is not None:
                yield ended
        for worker in [worker for worker in self._busy if self._late(worker)]:
            self._busy.remove(worker)
            _end([worker])
            assert self.timeout_s is not None
            yield Ended(worker.task, fault=f"took more than {self.timeout_s / 60:g} minutes and was ended")

    def _late(self, worker: _Worker) -> bool:
        return self.timeout_s is not None and time.monotonic() - worker.began > self.timeout_s

    def _heard(self, worker: _Worker) -> Ended | None:
        try:
            kind, value = worker.pipe.recv()
        except (EOFError, OSError):
            self._busy.remove(worker)
            worker.process.join(GRACE_S)
            return _fallen(worker)
        if kind == "part":
            self.moved(worker.task, value - worker.part)
            worker.part = value
            return None
        self._busy.remove(worker)
        self._idle.append(worker)
        self.moved(worker.task, 1 - worker.part)
        return Ended(worker.task, answer=value)

    def _dismiss(self) -> None:
        for worker in self._idle:
            with contextlib.suppress(OSError):
                worker.pipe.send(None)
        _end(self._busy)
        for worker in self._idle:
            worker.process.join(GRACE_S)
        _end(self._idle)
        self._busy, self._idle = [], []


def _fallen(worker: _Worker) -> Ended:
    code = worker.process.exitcode
    worker.pipe.close()
    if code == UNTOLD:
        return Ended(worker.task, fault="its process ended, and the one that could say why, too", again=True)
    code = -signal.SIGTERM if code == TERMINATED else code
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        reason = ", perhaps for want of memory" if name == "SIGKILL" else ""
        again = name in ("SIGKILL", "SIGTERM", "SIGHUP")
        return Ended(worker.task, fault=f"its process was ended by {name}{reason}", again=again)
    return Ended(worker.task, fault=f"its process ended unexpectedly (code {code})")


def _end(workers: list[_Worker]) -> None:
    """End processes: kindly, so that they remove their temporary files, then not."""
    for worker in workers:
        worker.process.terminate()
    for worker in workers:
        worker.process.join(GRACE_S)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.pipe.close()


def _started(work: Work, preload: str) -> _Worker:
    """A new process, with nothing of this one's state but the pipe."""
    hold_to_one_thread()
    ours, theirs = multiprocessing.Pipe()
    process = _process(theirs, work, preload)
    try:
        with short_lived():
            _deaf_server()
            process.start()
    except (OSError, EOFError):
        ours.close()
        raise
    finally:
        theirs.close()
    return _Worker(process, ours)


def _process(pipe: Connection, work: Work, preload: str) -> BaseProcess:
    """On Linux from a server that has imported everything once, elsewhere from nothing."""
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn").Process(target=_serve, args=(pipe, work), daemon=True)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([preload])
    return context.Process(target=_serve, args=(pipe, work), daemon=True)


def _deaf_server() -> None:
    """Start the server of workers, if there is one, deaf to Ctrl-C: it would tell what it was importing."""
    if sys.platform != "linux":
        return
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(pipe: Connection, work: Work) -> None:
    """The life of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=_outlive_nobody, daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        while (task := pipe.recv()) is not None:
            pipe.send(("answer", work(task, lambda part: pipe.send(("part", part)))))


def _leave(_number: int, _frame: Any) -> None:
    raise SystemExit(TERMINATED)


def _outlive_nobody() -> None:
    """End this process when the one that started it is gone, however it went."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
