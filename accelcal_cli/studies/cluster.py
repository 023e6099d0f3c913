"""The executor that has tasks done by the workers of a dask.distributed cluster.

First the side of the workers: what they must be, and how they do a task and report it. Then this side: the
scheduler is found, tasks are submitted, and if a worker is lost, another does its task. distributed is an
optional extra, imported in functions only.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import logging
import os
import pickle
import platform
import secrets
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from accelcal_cli.core import version
from accelcal_cli.core.door import is_folder
from accelcal_cli.core.errors import AccelcalError, ClusterError, OutputError, UsageError, printable
from accelcal_cli.core.system import keep_freed_memory
from accelcal_cli.output.files import owner, temporary_beside
from accelcal_cli.studies.records import Finished, ProgressCallback, ProgressDelta, TaskFunction
from accelcal_cli.studies.task import CalibrationTask, TaskResult, calibrated

FILE_POLL_S = 0.5
"""Interval [s] at which a scheduler file that is not there yet is looked for."""
POLL_S = 1.0
"""Longest wait [s] for an event before the time limits of tasks are looked at."""
COUNT_S = 3.0
"""Interval [s] at which the threads of the cluster are counted."""
GRACE_S = 10.0
"""Longest wait [s] for cancelled tasks to end."""
TELL_S = 1.0
"""Shortest interval [s] at which a worker reports progress."""
LOOK_S = 1.0
"""Interval [s] at which a worker looks whether a shared disk shows the study's files."""
TOPIC = "accelcal"
"""Topic of distributed's events under which workers report."""
BEGAN, PROGRESS, ENDED, DONE = "began", "progress", "ended", "done"
"""Kinds of events: the first three come from workers, the last one from the task's future."""
Notify = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class WorkerRequirements:
    """Conditions that a worker must meet, so that its results are the study's.

    Attributes:
        code: hash of the package's source (see `code`).
        folders: absolute paths of the recordings' folders.
        mark: absolute path of a file in the folder of the outputs.
        content: content of `mark`.
        patience_s: how long a shared disk may take to show them.
    """

    version: str
    code: str
    folders: tuple[Path, ...]
    mark: Path
    content: str
    patience_s: float = 40.0


@lru_cache
def unsuitable(requirements: WorkerRequirements) -> AccelcalError | None:
    """Return why this process must not work for a study; None if it may. Checked once a study."""
    here = f"the worker on {platform.node() or 'a host'}"
    if requirements.version != version.__version__:
        have = f"{here} has accelcal {version.__version__}, not {requirements.version}"
        return ClusterError(have, hint="install the same version on every machine")
    if requirements.code != code():
        have = f"{here} also has accelcal {requirements.version}, but its code differs"
        return ClusterError(have, hint="install the same build on every machine")
    if (hidden := _hidden(requirements)) is not None:
        return ClusterError(
            f"{here} cannot see it", path=hidden, hint="the cluster must share the disks of FOLDER and OUT"
        )
    return _unwritable(requirements.mark, here)


def _hidden(requirements: WorkerRequirements) -> Path | None:
    """Return a folder that the worker does not see, once a shared disk has had time to show it."""
    end = time.monotonic() + requirements.patience_s
    while (missing := _missing(requirements)) is not None and time.monotonic() < end:
        time.sleep(LOOK_S)
    return missing


def _missing(requirements: WorkerRequirements) -> Path | None:
    for folder in requirements.folders:
        if not is_folder(folder) or not os.access(folder, os.R_OK | os.X_OK):
            return folder
    try:
        same = requirements.mark.read_text("utf-8", "replace") == requirements.content
    except OSError:
        same = False
    return None if same else requirements.mark.parent


def _unwritable(mark: Path, here: str) -> AccelcalError | None:
    try:
        temporary_beside(mark).unlink(missing_ok=True)
    except OutputError as error:
        return OutputError(
            f"{here}: {error.message}", path=mark.parent, hint="give its user permission to write there"
        )
    return None


@lru_cache
def code() -> str:
    """Return a hash of this package's source: builds of one version may differ."""
    root, digest = Path(version.__file__).parent.parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def serialized_task(work: TaskFunction, task: Any, requirements: WorkerRequirements) -> bytes:
    """Return bytes that do the task when a worker calls `pickle.loads` on them in a thread.

    The scheduler, or a worker without this package or with another version, cannot fail on them: the task
    itself fails. (A worker that cannot unpickle one of distributed's own tasks ends.)
    """
    return pickle.dumps(_SerializedTask(work, task, requirements))


@dataclass(frozen=True, slots=True)
class _SerializedTask:
    """Becomes the result of `do_task` when its pickle is loaded."""

    work: TaskFunction
    task: Any
    requirements: WorkerRequirements

    def __reduce__(self) -> tuple[Any, ...]:
        return do_task, (pickle.dumps((self.work, self.task)), self.requirements)


def do_task(content: bytes, requirements: WorkerRequirements) -> tuple[str, Any]:
    """Do a task in a thread of a worker.

    Returns:
        `result` and the result of the work; `unsuitable` and the reason why this worker must not do it; or
        `ended` and None if the task was cancelled.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def send(kind: str, value: Any) -> None:
        worker.log_event(TOPIC, (key, kind, value))

    error = unsuitable(requirements)
    if error is not None:
        return "unsuitable", error
    work, task = pickle.loads(content)
    send(BEGAN, owner())
    try:
        return "result", work(task, _progress_callback(worker, key, send))
    except _CancelledError:
        return ENDED, None
    finally:
        send(ENDED, owner())


class _CancelledError(BaseException):
    """The task was cancelled."""


def _progress_callback(worker: Any, key: Any, send: Callable[[str, Any], None]) -> Callable[[float], None]:
    """Return a callback that reports progress every TELL_S and ends the work once its task is cancelled.

    A cluster cannot end a thread; the state of a task is described in distributed's "Worker State Machine".
    """
    following = 0.0

    def report_progress(fraction: float) -> None:
        nonlocal following
        state = worker.state.tasks.get(key)
        if state is None or state.state == "cancelled":
            raise _CancelledError
        if time.monotonic() >= following:
            following = time.monotonic() + TELL_S
            send(PROGRESS, fraction)

    return report_progress


def calibrate_in_user_folder(
    cwd: Path, task: CalibrationTask, report_progress: ProgressCallback
) -> TaskResult:
    """Calibrate a recording as `calibrated` would in a process whose current folder is `cwd`.

    The current folder is not changed: other threads of this process may rely on it.
    """
    keep_freed_memory()
    result = calibrated(in_user_folder(cwd, task), report_progress)
    if not result.entry.failed or result.entry.row is None:
        return result
    row = {**result.entry.row, "message": _as_named(cwd, task, result.entry.row["message"])}
    return replace(result, entry=replace(result.entry, row=row))


def in_user_folder(cwd: Path, task: CalibrationTask) -> CalibrationTask:
    """Return the task with absolute paths."""
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


@contextlib.contextmanager
def connected(address: str, notify: Notify) -> Iterator[Any]:
    """Connect a client to the scheduler at an address, or to the one that wrote a scheduler file.

    It waits as long as distributed does (`distributed.comm.timeouts.connect`, 30 s unless configured). The
    messages of distributed are hidden: the error says it in our own words.

    Raises:
        UsageError: distributed is not installed.
        ClusterError: the scheduler cannot be reached, or is of another version.
    """
    try:
        import distributed
    except ImportError as error:
        raise UsageError("--dask needs dask.distributed", hint="pip install distributed") from error
    with contextlib.ExitStack() as stack:
        stack.callback(logging.disable, logging.root.manager.disable)
        logging.disable(logging.CRITICAL)
        client = _client(distributed, address, notify)
        try:
            yield client
        finally:
            with contextlib.suppress(Exception):
                client.close(timeout=5)


def _client(library: Any, named: str, notify: Notify) -> Any:
    import dask

    wait_s = dask.utils.parse_timedelta(dask.config.get("distributed.comm.timeouts.connect"))
    address = _address(named, wait_s)
    _check(library, address, wait_s)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            client = library.Client(address, timeout=wait_s, set_as_default=False, name="accelcal")
        except Exception as error:
            raise _unreachable(address, error) from error
    if any(one.category.__name__ == "VersionMismatchWarning" for one in warned):
        notify(
            "some versions on the cluster (Python, dask, numpy or others) differ from those on this machine"
        )
    return client


def _address(named: str, wait_s: float) -> str:
    """Return the address, or that in a scheduler file once it is there."""
    if not named.endswith(".json"):
        return named
    path, end = Path(named), time.monotonic() + wait_s
    while (address := _address_in(path)) is None and time.monotonic() < end:
        time.sleep(FILE_POLL_S)
    if address is None:
        raise ClusterError(
            "no scheduler has written its address here", path=printable(path), hint="start `dask scheduler`"
        )
    return address


def _address_in(path: Path) -> str | None:
    try:
        address = json.loads(path.read_text("utf-8"))["address"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return address if isinstance(address, str) else None


def _check(library: Any, address: str, wait_s: float) -> None:
    """Check the version before a client is made, which may fail or hang with another one."""
    from distributed.comm import parse_address
    from distributed.comm.registry import get_backend

    try:
        get_backend(parse_address(address)[0] if address else "")
    except ValueError as error:
        raise UsageError(
            f"--dask {printable(address)!r} is not an address", hint="use one such as tcp://host:8786"
        ) from error
    try:
        version = asyncio.run(_version(library, address, wait_s))
    except Exception as error:
        raise _unreachable(address, error) from error
    if version != library.__version__:
        raise ClusterError(
            f"the scheduler at {address} has distributed {version}, this machine has {library.__version__}",
            hint="install the same version on every machine",
        )


async def _version(library: Any, address: str, wait_s: float) -> str:
    """Return the version of the scheduler's distributed."""
    secured = library.Security().get_connection_args("client")
    async with asyncio.timeout(wait_s), library.rpc(address, connection_args=secured) as scheduler:
        return str((await scheduler.versions())["packages"]["distributed"])


def _unreachable(address: str, error: Exception) -> ClusterError:
    reason = " ".join(str(error).split()) or "no answer"
    return ClusterError(
        f"no scheduler answers at {address} ({reason})",
        hint="start one with `dask scheduler`, and give --dask its address or its scheduler file",
    )


@dataclass(slots=True)
class Cluster:
    """The executor of a Dask cluster: the workers of a scheduler.

    Attributes:
        address: address of the scheduler, or name of its scheduler file.
        work: the work on a task.
        requirements: conditions that a worker must meet.
        limit: number of tasks that the cluster is given at a time; None for that of its threads.
        timeout_s: longest time of a task from when it began; None for no limit.
        on_progress: see `ProgressDelta`.
        notify: called with each line for the user.
        lost: called with a task and the `HOST.PROCESS` that began it and is gone.
    """

    address: str
    work: TaskFunction
    requirements: WorkerRequirements
    limit: int | None = None
    timeout_s: float | None = None
    on_progress: ProgressDelta = lambda _task, _fraction: None
    notify: Notify = lambda _text: None
    lost: Callable[[Any, str], None] = lambda _task, _owner: None

    def run(self, tasks: list[Any]) -> Generator[Finished, None, None]:
        """See `Executor`.

        Raises:
            UsageError: distributed is not installed.
            ClusterError: the scheduler cannot be reached or is lost, or a worker is unsuitable.
            OutputError: a worker cannot write where the outputs go.
        """
        if tasks:
            with connected(self.address, self.notify) as client:
                yield from DaskSession(self, client, deque(tasks)).run()


@dataclass(slots=True)
class _Running:
    """A task that was submitted; the processes `owners` began it, and all but the last one were lost."""

    task: Any
    future: Any
    tries: int
    owners: list[str] = field(default_factory=list)
    began: float | None = None
    at_work: bool = False
    fraction: float = 0.0


@dataclass(slots=True)
class DaskSession:
    """One run of an executor, whose name begins the keys of its tasks.

    No more tasks are submitted than can begin: if a worker is lost, distributed blames all that it held.
    """

    cluster: Cluster
    client: Any
    waiting: deque[Any]
    name: str = field(default_factory=lambda: f"accelcal-{secrets.token_hex(6)}")
    running: dict[str, _Running] = field(default_factory=dict)
    events: SimpleQueue[tuple[str, str, Any]] = field(default_factory=SimpleQueue)
    number: int = 0
    threads: int = -1
    next_count_s: float = 0.0

    def run(self) -> Iterator[Finished]:
        """Submit tasks and handle events until all tasks have ended."""
        self.client.subscribe_topic(TOPIC, lambda event: self.events.put(tuple(event[1])))
        try:
            while self.waiting or self.running:
                self._count_workers()
                while self.waiting and len(self.running) < (self.cluster.limit or max(1, self.threads)):
                    self._submit(self.waiting.popleft(), tries=1)
                yield from self._listen()
                yield from self._overdue()
        finally:
            with contextlib.suppress(Exception):
                self._cancel_all()

    def _count_workers(self) -> None:
        if time.monotonic() < self.next_count_s:
            return
        self.next_count_s = time.monotonic() + COUNT_S
        try:
            threads = sum(self.client.nthreads().values())
        except Exception as error:
            raise self._lost(error) from error
        if threads == 0 and self.threads != 0:
            self.cluster.notify(f"{self.cluster.address} has no workers yet; waiting")
        self.threads = threads

    def _lost(self, reason: object) -> ClusterError:
        return ClusterError(
            f"the connection to the scheduler {self.cluster.address} was lost ({reason})",
            hint="finished recordings are kept: run the command again",
        )

    def _submit(self, task: Any, tries: int) -> None:
        self.number += 1
        key = f"{self.name}-{self.number}"
        try:
            content = serialized_task(self.cluster.work, task, self.cluster.requirements)
            future = self.client.submit(pickle.loads, content, key=key, pure=False)
        except Exception as error:
            raise self._lost(error) from error
        self.running[key] = _Running(task, future, tries)
        future.add_done_callback(lambda _future: self.events.put((key, DONE, None)))

    def _listen(self) -> Iterator[Finished]:
        """Handle the next event of this run, if there is one within POLL_S."""
        try:
            key, kind, value = self.events.get(timeout=POLL_S)
        except Empty:
            return
        running = self.running.get(key)
        if running is None:
            return
        if kind == DONE:
            yield from self._done(key, running)
        elif kind == BEGAN:
            running.owners.append(value)
            running.began, running.at_work = time.monotonic(), True
        elif kind == ENDED:
            running.at_work = False
        elif kind == PROGRESS:
            self._progress(running, value)

    def _progress(self, running: _Running, fraction: float) -> None:
        self.cluster.on_progress(running.task, fraction - running.fraction)
        running.fraction = fraction

    def _done(self, key: str, running: _Running) -> Iterator[Finished]:
        """Handle a task that is done, or pending again since its result was lost with the worker."""
        status = running.future.status
        if status == "pending":
            running.future.add_done_callback(lambda _future: self.events.put((key, DONE, None)))
            return
        if status == "cancelled":
            raise self._lost("its tasks are gone")
        if status == "error":
            yield from self._erred(key, running, running.future.exception())
            return
        kind, value = self._result(running)
        if kind == "unsuitable":
            raise value
        del self.running[key]
        self._clear(running, running.owners[:-1])
        self._progress(running, 1.0)
        yield Finished(running.task, result=value)

    def _result(self, running: _Running) -> tuple[str, Any]:
        try:
            result: tuple[str, Any] = running.future.result()
        except Exception as error:
            raise self._lost(error) from error
        return result

    def _erred(self, key: str, running: _Running, error: Exception) -> Iterator[Finished]:
        """Handle an error, which means that workers were killed or could not begin: the work never raises."""
        if type(error).__name__ != "KilledWorker":
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise ClusterError(
                f"a worker cannot start a task ({reason})", hint="install the same accelcal on every machine"
            ) from error
        del self.running[key]
        self._clear(running, running.owners)
        if not running.owners and running.tries == 1:
            self._submit(running.task, tries=2)
            return
        fault = "every worker that tried it was lost, perhaps for lack of memory"
        yield Finished(running.task, fault=fault, retry=True)

    def _clear(self, running: _Running, owners: list[str]) -> None:
        for lost in owners:
            self.cluster.lost(running.task, lost)

    def _overdue(self) -> Iterator[Finished]:
        limit = self.cluster.timeout_s
        if limit is None:
            return
        for key, running in list(self.running.items()):
            if running.began is not None and time.monotonic() - running.began > limit:
                del self.running[key]
                with contextlib.suppress(OSError):
                    self.client.cancel([running.future], force=True)
                yield Finished(running.task, fault=f"took more than {limit / 60:g} minutes and was stopped")

    def _cancel_all(self) -> None:
        """Cancel all tasks and wait GRACE_S for them to end, so that no incomplete file is left."""
        self.client.cancel([running.future for running in self.running.values()], force=True)
        begun = {key for key, running in self.running.items() if running.at_work}
        end = time.monotonic() + GRACE_S
        while begun and (left := end - time.monotonic()) > 0:
            with contextlib.suppress(Empty):
                key, kind, _ = self.events.get(timeout=left)
                if kind == ENDED:
                    begun.discard(key)
