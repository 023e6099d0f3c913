"""Who does a study's tasks if not worker processes of its own: this process, or an executor.

An executor is any of `concurrent.futures`, whose workers may be on other machines. Each task carries what its
worker must have, which the first task in a process checks. No executor can end a task that runs: a task ends
itself when it takes too long, or when the file is gone that shows that the study waits for it.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import logging
import multiprocessing
import os
import platform
import sys
import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from accelcal_cli.core import version
from accelcal_cli.core.door import is_folder, is_there
from accelcal_cli.core.errors import AccelcalError, ClusterError, OutputError, UsageError, printable
from accelcal_cli.core.system import keep_freed_memory
from accelcal_cli.output.files import discard, owner, sweep_left, temporary_beside
from accelcal_cli.studies.records import Finished, ProgressCallback, TaskFunction, TaskProgress
from accelcal_cli.studies.study import Study
from accelcal_cli.studies.task import CalibrationTask, TaskResult, calibrated

PATIENCE_S, LOOK_S = 40.0, 1.0
"""How long [s] a shared disk may take to show a worker the study's files, and the interval of its looks."""

GRACE_S = 10.0
"""Longest wait [s] for tasks to end that the study no longer waits for."""

TRIES = 2
"""Number of times that a task is given to an executor before it fails."""


def must_stay() -> bool:
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
        keep_freed_memory()


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
            elif tries < TRIES:
                give(task, tries + 1)
            else:
                yield Finished(task, fault=fault, retry=True)
    finally:
        discard(work.mark)
        wait([future for future in given if not future.cancel()])
        outputs = [path for task in tasks for path in task.item.job.outputs]
        sweep_left(outputs, wait_s=GRACE_S if given else 0.0)


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
