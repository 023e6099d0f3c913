"""The work of a study, done by worker processes of this machine, by this process, or by an executor.

A worker that dies loses only its own task."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import logging
import multiprocessing
import os
import platform
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial
from multiprocessing import connection, forkserver, resource_tracker, spawn
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from accelcal_cli.core import system, version
from accelcal_cli.core.errors import AccelcalError, ClusterError, OutputError, UsageError, printable
from accelcal_cli.core.paths import is_folder, is_there
from accelcal_cli.output.files import discard, owner, sweep_left, temporary_beside
from accelcal_cli.studies.records import Finished, ProgressCallback, TaskFunction, TaskProgress
from accelcal_cli.studies.study import Study
from accelcal_cli.studies.task import CalibrationTask, TaskResult, calibrated

if TYPE_CHECKING:
    from accelcal_cli.core.system import PipeEnd

# Worker processes of this machine, which do a study's tasks; one that dies loses only its own task.
#
# On Linux workers are forked from a server that has imported everything once. It listens in a folder
# of our own: that of multiprocessing would remain if the process is killed, and its path may be too
# long for the name of a socket. Workers never run the program that started them, so that a script
# needs no guard.

LONGEST_PATH = 40
"""Bytes of a path that leave room for the rest of a socket's name, 108 in all on Linux (unix(7))."""

SHORT_FOLDERS = ("/tmp", "/var/tmp")

EXIT_PRIORITY = -200
"""Priority of the removal of our folder, after that of multiprocessing's own in it (-100)."""

POLL_S = 1.0
"""Interval [s] at which time limits are checked."""

GRACE_S = 10.0
"""Time [s] that a process has to end before it is killed."""

START_TRIES, RETRY_S = 5, 0.1
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
    folder = Path(tempfile.mkdtemp(prefix=f"{system.folder_start()}{os.getpid()}-", dir=_parent()))
    Finalize(None, system.remove_folder, (folder,), exitpriority=EXIT_PRIORITY)
    return folder


def sweep_folders() -> None:
    """Remove the folders of killed processes of this host and user."""
    start = system.folder_start()
    for place in {_parent(), tempfile.gettempdir()}:
        with contextlib.suppress(OSError), os.scandir(place) as entries:
            for entry in entries:
                owner = entry.name.removeprefix(start).split("-")[0]
                if entry.name.startswith(start) and owner.isdigit() and not system.lives(int(owner)):
                    system.remove_folder(Path(entry.path))


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
            for _ in range(START_TRIES):
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
        with _STARTING, system.one_thread_each(), forkserver_folder():
            _keep_main_out()
            forked = system.has_fork_server() and _start_server(preload)
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
        with system.interruptions_blocked():
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
    system.collect_seldom()
    system.keep_freed_memory()
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


# Who does a study's tasks if not worker processes of its own: this process, or an executor.
#
# An executor is any of `concurrent.futures`, whose workers may be on other machines. Each task
# carries what its worker must have, which the first task in a process checks. No executor can end a
# task that runs: a task ends itself when it takes too long, or when the file is gone that shows that
# the study waits for it.

PATIENCE_S, LOOK_S = 40.0, 1.0
"""How long [s] a shared disk may take to show a worker the study's files, and the interval of its looks."""

SWEEP_S = 10.0
"""Longest wait [s] for tasks to end that the study no longer waits for."""

TASK_TRIES = 2
"""Number of times that a task is given to an executor before it fails."""


def may_not_start_processes() -> bool:
    """Return True if this process cannot start others: a worker of a pool of multiprocessing or of Dask."""
    return bool(multiprocessing.current_process().daemon)


def done_here(work: TaskFunction, tasks: Sequence[Any], on_progress: TaskProgress) -> Iterator[Finished]:
    """Do each task in this process when its result is asked for."""
    for task in tasks:
        on_progress(task, 0.0)
        result = work(task, partial(on_progress, task))
        on_progress(task, 1.0)
        yield Finished(task, result=result)


@dataclass(frozen=True, slots=True)
class RemoteWork:
    """The work on a recording for a worker of an executor, and what the worker must have.

    Attributes:
        build: version and code of this package (see `build`).
        study: `HOST.PROCESS` of the study.
        cwd: the folder in which relative paths begin.
        folders: absolute paths of the recordings' folders.
        mark: absolute path of a file in the folder of the outputs, which is there while the study waits.
        timeout_s: longest time of a task; None for no limit.
    """

    build: str
    study: str
    cwd: Path
    folders: tuple[Path, ...]
    mark: Path
    timeout_s: float | None = None

    def __call__(self, task: CalibrationTask, _tries: int) -> TaskResult | str:
        """Return the result of a task, or why it was stopped.

        Raises:
            ClusterError, OutputError: see `check_worker`.
        """
        check_worker(self)
        began = time.monotonic()

        def stop_if_needed(_part: float) -> None:
            if not _can_be_opened(self.mark):
                raise _StoppedError("the study no longer waited for it")
            if self.timeout_s is not None and time.monotonic() - began > self.timeout_s:
                raise _StoppedError(f"took more than {self.timeout_s / 60:g} minutes and was stopped")

        try:
            return calibrated_in(self.cwd, task, stop_if_needed)
        except _StoppedError as stop:
            return str(stop)


class _StoppedError(BaseException):
    """The task must end; work on a recording, which catches all errors, lets this one pass."""


def work_for(study: Study) -> RemoteWork:
    """Return the work on a study's recordings, for which a file is made that is to be removed at the end."""
    cwd = Path.cwd()
    folders = tuple(cwd / folder for folder in study.where.folders)
    return RemoteWork(build(), owner(), cwd, folders, cwd / temporary_beside(study.lock), study.timeout_s)


@lru_cache
def build() -> str:
    """Return the version with a hash of this package's source: builds of one version may differ."""
    root, digest = Path(version.__file__).parent.parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{version.__version__} (code {digest.hexdigest()[:12]})"


@lru_cache
def check_worker(work: RemoteWork) -> None:
    """Check, once a study, that this process may work for it.

    Raises:
        ClusterError: it has another build of accelcal, or does not see the study's folders.
        OutputError: it cannot write where the outputs go.
    """
    here = f"the worker on {platform.node() or 'a host'}"
    if work.build != build():
        have = f"{here} has accelcal {build()}, not {work.build}"
        raise ClusterError(have, hint="install the same build on every machine")
    end = time.monotonic() + PATIENCE_S
    while (hidden := _hidden(work)) is not None:
        if time.monotonic() >= end:
            hint = "its machine must share the disks of FOLDER and OUT"
            raise ClusterError(f"{here} cannot see it", path=hidden, hint=hint)
        time.sleep(LOOK_S)
    try:
        discard(temporary_beside(work.mark))
    except OutputError as error:
        hint = "give its user permission to write there"
        raise OutputError(f"{here}: {error.message}", path=work.mark.parent, hint=hint) from error
    if work.study != owner():
        system.keep_freed_memory()


def _hidden(work: RemoteWork) -> Path | None:
    """Return a folder that this process does not see; None if it sees all."""
    for folder in work.folders:
        if not is_folder(folder) or not os.access(folder, os.R_OK | os.X_OK):
            return folder
    return None if _can_be_opened(work.mark) else work.mark.parent


def _can_be_opened(path: Path) -> bool:
    """Return True if a file is there; it is opened, so that NFS asks the server."""
    try:
        os.close(os.open(path, os.O_RDONLY))
    except OSError:
        return False
    return True


def calibrated_in(cwd: Path, task: CalibrationTask, report_progress: ProgressCallback) -> TaskResult:
    """Calibrate a recording as `calibrated` would in a process whose current folder is `cwd`.

    The current folder is not changed: other threads of this process may rely on it.
    """
    result = calibrated(with_absolute_paths(cwd, task), report_progress)
    if not result.entry.failed or result.entry.row is None:
        return result
    row = {**result.entry.row, "message": _as_named(cwd, task, result.entry.row["message"])}
    return replace(result, entry=replace(result.entry, row=row))


def with_absolute_paths(cwd: Path, task: CalibrationTask) -> CalibrationTask:
    """Return the task with absolute paths, and the name of its recording as it was."""
    job, common = task.item.job, task.common
    options = common.request.options
    there = replace(job, source=cwd / job.source, parquet=cwd / job.parquet, report=cwd / job.report)
    layout = None if options.layout is None else cwd / options.layout
    request = replace(common.request, options=replace(options, layout=layout))
    common = replace(common, out=cwd / common.out, request=request)
    return replace(task, item=replace(task.item, job=there), common=common, named=job.source)


def _as_named(cwd: Path, task: CalibrationTask, message: str) -> str:
    """Return a message with the folders as the user named them."""
    layout = task.common.request.options.layout
    folders = [task.item.source.parent, task.common.out, *([] if layout is None else [layout.parent])]
    for folder in folders:
        message = message.replace(_start(cwd / folder), _start(folder))
    return message


def _start(folder: Path) -> str:
    return "" if folder == Path() else str(Path(printable(folder)) / "_")[:-1]


def done_by(
    executor: Executor, work: RemoteWork, tasks: Sequence[CalibrationTask], on_progress: TaskProgress
) -> Generator[Finished, None, None]:
    """Have an executor do tasks, and yield each as it ends; closing the generator ends what still runs.

    A task whose worker was lost is given to the executor once more.

    Raises:
        ClusterError, OutputError: a worker must not work for the study (see `check_worker`).
    """
    ended: SimpleQueue[Future[Any]] = SimpleQueue()
    given: dict[Future[Any], tuple[CalibrationTask, int]] = {}

    def give(task: CalibrationTask, tries: int) -> None:
        try:
            future = executor.submit(work, task, tries)
        except Exception as error:  # as it does once it is broken
            future = Future()
            future.set_exception(error)
        given[future] = task, tries
        future.add_done_callback(ended.put)

    try:
        for task in tasks:
            give(task, 1)
        while given:
            task, tries = given.pop(future := ended.get())
            if (fault := _fault(future)) is None:
                on_progress(task, 1.0)
                result = future.result()
                stopped = isinstance(result, str)
                yield Finished(task, fault=result) if stopped else Finished(task, result=result)
            elif tries < TASK_TRIES:
                give(task, tries + 1)
            else:
                yield Finished(task, fault=fault, retry=True)
    finally:
        discard(work.mark)
        wait([future for future in given if not future.cancel()])
        outputs = [path for task in tasks for path in task.item.job.outputs]
        sweep_left(outputs, wait_s=SWEEP_S if given else 0.0)


def _fault(future: Future[Any]) -> str | None:
    """Return what happened to the worker of a task; None if it returned something.

    Raises:
        AccelcalError: the worker must not work for the study.
    """
    error = CancelledError() if future.cancelled() else future.exception()
    if error is None:
        return None
    if isinstance(error, AccelcalError):
        raise error
    if isinstance(error, BrokenExecutor | CancelledError) or type(error).__name__ == "KilledWorker":
        return "its worker was lost, perhaps for lack of memory"
    return " ".join(f"its worker failed ({type(error).__name__}: {error})".split())


@contextlib.contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Hold an executor of the Dask cluster at the address of a scheduler, or with its scheduler file.

    Raises:
        UsageError: distributed is not installed.
        ClusterError: the scheduler cannot be reached.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError("--dask needs dask.distributed", hint="pip install distributed") from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # its messages are for its own developers
    by_file = address.endswith(".json")
    try:
        if by_file and not is_there(Path(address)):
            raise FileNotFoundError("no such file")
        client = Client(**{"scheduler_file" if by_file else "address": address}, set_as_default=False)
    except Exception as error:
        reason = " ".join(str(error).split()) or "no answer"
        raise ClusterError(
            f"no scheduler answers at {printable(address)} ({reason})",
            hint="start one with `dask scheduler`, and give --dask its address or its scheduler file",
        ) from error
    with client:
        yield client.get_executor(pure=False)


@contextlib.contextmanager
def named_executor(name: str) -> Iterator[Executor]:
    """Hold the executor that a callable returns, which is named `MODULE:CALLABLE`.

    Raises:
        UsageError: there is no such callable, or it returns something else.
    """
    module, _, attribute = name.partition(":")
    sys.path.append(str(Path.cwd()))  # which an installed command does not search
    try:
        executor = getattr(importlib.import_module(module), attribute)()
        if not isinstance(executor, Executor):
            raise TypeError(f"{type(executor).__name__} is not a concurrent.futures.Executor")
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        hint = "give MODULE:CALLABLE, such as mpi4py.futures:MPIPoolExecutor"
        raise UsageError(f"--executor {printable(name)} returns no executor ({error})", hint=hint) from error
    with executor:
        yield executor
