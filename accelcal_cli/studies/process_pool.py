"""Worker processes of this machine, which do a study's tasks; one that dies loses only its own task.

On Linux workers are forked from a server that has imported everything once. It listens in a folder of our
own: that of multiprocessing would remain if the process is killed, and its path may be too long for the name
of a socket. Workers never run the program that started them, so that a script needs no guard.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import tempfile
import threading
import time
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import connection, forkserver, resource_tracker, spawn
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from pathlib import Path
from typing import TYPE_CHECKING, Any

from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.system import (
    collect_seldom,
    folder_start,
    has_fork_server,
    interruptions_blocked,
    keep_freed_memory,
    lives,
    one_thread_each,
    remove_folder,
)
from accelcal_cli.studies.records import Finished, TaskFunction, TaskProgress

if TYPE_CHECKING:
    from accelcal_cli.core.system import PipeEnd

LONGEST_PATH = 40
"""Bytes of a path that leave room for the rest of a socket's name, 108 in all on Linux (unix(7))."""

SHORT_FOLDERS = ("/tmp", "/var/tmp")

EXIT_PRIORITY = -200
"""Priority of the removal of our folder, after that of multiprocessing's own in it (-100)."""

POLL_S = 1.0
"""Interval [s] at which time limits are checked."""

GRACE_S = 10.0
"""Time [s] that a process has to end before it is killed."""

TRIES, RETRY_S = 5, 0.1
"""Further tries to start a worker, and the wait [s] before each: a killed server is noticed late."""

TERMINATED, NO_THREAD = 143, 144
"""Exit codes of a worker that got SIGTERM, and of one that could not start its watching thread."""

NAME = "accelcal-worker"
"""Name of a worker's process."""

SERVER_GONE = 255
"""Exit code that multiprocessing gives a process whose server is gone."""


@contextlib.contextmanager
def forkserver_folder() -> Iterator[None]:
    """Make temporary files in the block in a folder that is removed when this process ends.

    If the process is killed, the next one of this host and user removes the folder.

    Raises:
        OSError: no folder can be made.
    """
    before = tempfile.tempdir
    tempfile.tempdir = str(_temporary_folder())
    try:
        yield
    finally:
        tempfile.tempdir = before


@cache
def _temporary_folder() -> Path:
    sweep_folders()
    folder = Path(tempfile.mkdtemp(prefix=f"{folder_start()}{os.getpid()}-", dir=_parent()))
    Finalize(None, remove_folder, (folder,), exitpriority=EXIT_PRIORITY)
    return folder


def sweep_folders() -> None:
    """Remove the folders of killed processes of this host and user."""
    start = folder_start()
    for place in {_parent(), tempfile.gettempdir()}:
        with contextlib.suppress(OSError), os.scandir(place) as entries:
            for entry in entries:
                owner = entry.name.removeprefix(start).split("-")[0]
                if entry.name.startswith(start) and owner.isdigit() and not lives(int(owner)):
                    remove_folder(Path(entry.path))


def _parent() -> str:
    usual = tempfile.gettempdir()
    short = (path for path in (usual, *SHORT_FOLDERS) if len(os.fsencode(path)) <= LONGEST_PATH)
    return next((path for path in short if os.access(path, os.W_OK | os.X_OK)), usual)


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    pipe: PipeEnd
    task: Any = None
    began: float = 0.0


@dataclass(slots=True)
class ProcessPool:
    """Workers that take tasks as they become free.

    Attributes:
        work: the work on a task.
        number: number of workers.
        timeout_s: longest time of a task; None for no limit.
        preload: name of a module with all that the work imports, which the server imports once.
        on_progress: see `TaskProgress`.
    """

    work: TaskFunction
    number: int
    timeout_s: float | None = None
    preload: str | None = None
    on_progress: TaskProgress = lambda _task, _part: None
    _idle: list[_Worker] = field(default_factory=list)
    _busy: list[_Worker] = field(default_factory=list)

    def run(self, tasks: list[Any]) -> Generator[Finished, None, None]:
        """Carry out tasks and yield each as it ends; all workers have ended when the iteration has.

        Raises:
            OutputError: there is no worker left, and none can be started.
        """
        waiting = list(reversed(tasks))
        try:
            while waiting or self._busy:
                while waiting and len(self._busy) < self.number:
                    self._assign(waiting)
                yield from self._listen()
        finally:
            self._stop_all()

    def _assign(self, waiting: list[Any]) -> None:
        """Give the last task to a worker; if none can be started, continue with the busy ones."""
        try:
            worker = self._idle.pop() if self._idle else self._start()
        except OutputError:
            if not self._busy:
                raise
            self.number = len(self._busy)
            return
        task = waiting.pop()
        worker.task, worker.began = task, time.monotonic()
        self._busy.append(worker)
        with contextlib.suppress(OSError):
            worker.pipe.send(task)
        self.on_progress(task, 0.0)

    def _start(self) -> _Worker:
        """Start a worker, from a new server if the first was killed."""
        preload = self.preload or self.work.__module__
        try:
            for _ in range(TRIES):
                with contextlib.suppress(EOFError, ConnectionError):
                    return _started(self.work, preload)
                time.sleep(RETRY_S)
            return _started(self.work, preload)
        except (OSError, EOFError) as error:
            raise OutputError(
                f"no worker process can be started ({getattr(error, 'strerror', None) or error})",
                hint="check that the current folder and that of temporary files exist, or use fewer --jobs",
            ) from error

    def _listen(self) -> Iterator[Finished]:
        ready = connection.wait([worker.pipe for worker in self._busy], timeout=POLL_S)
        for worker in [worker for worker in self._busy if worker.pipe in ready]:
            if (ended := self._receive(worker)) is not None:
                yield ended
        if self.timeout_s is None:
            return
        latest = time.monotonic() - self.timeout_s
        for worker in [worker for worker in self._busy if worker.began < latest]:
            self._busy.remove(worker)
            _end([worker])
            sweep_folders()
            fault = f"took more than {self.timeout_s / 60:g} minutes and was stopped"
            yield Finished(worker.task, fault=fault)

    def _receive(self, worker: _Worker) -> Finished | None:
        try:
            kind, value = worker.pipe.recv()
        except (EOFError, OSError):
            self._busy.remove(worker)
            worker.process.join(GRACE_S)
            return _lost_worker(worker)
        if kind == "progress":
            self.on_progress(worker.task, value)
            return None
        self._busy.remove(worker)
        self._idle.append(worker)
        self.on_progress(worker.task, 1.0)
        return Finished(worker.task, result=value)

    def _stop_all(self) -> None:
        for worker in self._idle:
            with contextlib.suppress(OSError):
                worker.pipe.send(None)
        _end(self._busy)
        for worker in self._idle:
            worker.process.join(GRACE_S)
        _end(self._idle)
        self._busy, self._idle = [], []


def _lost_worker(worker: _Worker) -> Finished:
    code = worker.process.exitcode
    worker.pipe.close()
    if code == SERVER_GONE:
        fault = "its process ended, and so did the one that could say why"
        return Finished(worker.task, fault=fault, retry=True)
    code = -signal.SIGTERM if code == TERMINATED else code
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        reason = ", perhaps for lack of memory" if name == "SIGKILL" else ""
        retry = name in ("SIGKILL", "SIGTERM", "SIGHUP")
        return Finished(worker.task, fault=f"its process was ended by {name}{reason}", retry=retry)
    if code == NO_THREAD:
        fault = "no more threads could be started; use fewer --jobs"
        return Finished(worker.task, fault=fault, retry=True, lacking=True)
    return Finished(worker.task, fault=f"its process ended unexpectedly (code {code})")


def _end(workers: list[_Worker]) -> None:
    """End processes by SIGTERM, at which they remove temporary files, or by SIGKILL after GRACE_S."""
    for worker in workers:
        worker.process.terminate()
    for worker in workers:
        worker.process.join(GRACE_S)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.pipe.close()


_STARTING = threading.Lock()
"""Held while a worker is started: the folder of temporary files and the environment are the process's."""


def _started(work: TaskFunction, preload: str) -> _Worker:
    """Start a process that has nothing of this one's state but the pipe."""
    pipe: tuple[Any, Any] = multiprocessing.Pipe()  # connections are of another class on Windows
    ours, theirs = pipe
    try:
        with _STARTING, one_thread_each(), forkserver_folder():
            _keep_main_out()
            forked = has_fork_server() and _start_server(preload)
            context: Any = multiprocessing.get_context("forkserver" if forked else "spawn")
            process = context.Process(target=_serve, args=(theirs, work), name=NAME, daemon=True)
            process.start()
    except (OSError, EOFError):
        ours.close()
        raise
    finally:
        theirs.close()
    return _Worker(process, ours)


def _start_server(preload: str) -> bool:
    """Start the server so that it ignores Ctrl-C, at which it would print a traceback.

    Returns:
        False if this process was forked from one that has a server, which it cannot wait for.
    """
    multiprocessing.get_context("forkserver").set_forkserver_preload([preload])
    try:
        resource_tracker.ensure_running()
        with interruptions_blocked():
            forkserver.ensure_running()
    except ChildProcessError:
        return False
    return True


def _keep_main_out() -> None:
    """Let multiprocessing tell workers nothing of `__main__`, which they would run once more.

    Other processes of the program still get it.
    """
    if getattr(spawn.get_preparation_data, "keeps_main_out", False):
        return
    usual = spawn.get_preparation_data

    def prepared(name: str) -> dict[str, Any]:
        data = usual(name)
        main = [key for key in data if key.startswith("init_main_")] if name == NAME else []
        return {key: value for key, value in data.items() if key not in main}

    prepared.keeps_main_out = True  # type: ignore[attr-defined]
    spawn.get_preparation_data = prepared


def _serve(pipe: PipeEnd, work: TaskFunction) -> None:
    """Do one task after another until None is received: the loop of a worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _terminate)
    collect_seldom()
    keep_freed_memory()
    try:
        threading.Thread(target=_end_with_parent, daemon=True).start()
    except RuntimeError:
        raise SystemExit(NO_THREAD) from None
    with contextlib.suppress(EOFError, OSError):
        while (task := pipe.recv()) is not None:
            pipe.send(("result", work(task, lambda fraction: pipe.send(("progress", fraction)))))


def _terminate(_number: int, _frame: Any) -> None:
    raise SystemExit(TERMINATED)


def _end_with_parent() -> None:
    """End this process when the one that started it is gone."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
