"""What a worker of a cluster does with a task, and whether it is suitable; imported there without click.

Its current folder is not the user's: paths become absolute, and messages name files as the user did.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from accelcal_cli.core import version
from accelcal_cli.core.errors import AccelcalError, ClusterError, OutputError, printable
from accelcal_cli.output.files import beside, owner
from accelcal_cli.studies.records import ProgressCallback, TaskFunction
from accelcal_cli.studies.task import CalibrationTask, TaskResult, calibrated

TOPIC = "accelcal"
"""Under which workers send how far they are."""

BEGAN, PROGRESS, ENDED = "began", "progress", "ended"
TELL_S = 1.0
LOOK_S = 1.0


@dataclass(frozen=True, slots=True)
class WorkerRequirements:
    """What a worker must be and see, so that its results are the study's.

    Attributes:
        code: see `code`.
        folders: of the recordings; absolute.
        mark: a file in the folder of the outputs, and what it holds; absolute.
        patience_s: how long a shared disk may take to show them.
    """

    version: str
    code: str
    folders: tuple[Path, ...]
    mark: Path
    content: str
    patience_s: float = 40.0


class _CancelledError(BaseException):
    """Nobody waits for the task any more."""


@dataclass(frozen=True, slots=True)
class _SerializedTask:
    """Becomes the result of `do_task` where its pickle is loaded."""

    work: TaskFunction
    task: Any
    requirements: WorkerRequirements

    def __reduce__(self) -> tuple[Any, ...]:
        return do_task, (pickle.dumps((self.work, self.task)), self.requirements)


def serialized_task(work: TaskFunction, task: Any, requirements: WorkerRequirements) -> bytes:
    """Bytes to be done by `pickle.loads` in a thread of a worker.

    Neither the scheduler nor a worker without this package, or with another, can stumble over them: the
    task itself fails. (A worker that cannot unpickle a task of distributed's ends.)
    """
    return pickle.dumps(_SerializedTask(work, task, requirements))


def do_task(content: bytes, requirements: WorkerRequirements) -> tuple[str, Any]:
    """Do a task in a thread of a worker.

    Returns:
        `result` and what the work returned, `unsuitable` and why this worker must not do it, or `ended` and
        None if the task was cancelled meanwhile.
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


def _progress_callback(worker: Any, key: Any, send: Callable[[str, Any], None]) -> Callable[[float], None]:
    """Tells the parts, not too often, and ends the work once its task is cancelled.

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


@lru_cache
def code() -> str:
    """A hash of this package's source: two versions of one name are not the same."""
    root, digest = Path(version.__file__).parent.parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


@lru_cache
def unsuitable(requirements: WorkerRequirements) -> AccelcalError | None:
    """Why this process must not work for a study; None if it may. Looked at once a study."""
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
    """What a worker does not see; a shared disk may take its time to show a new file."""
    end = time.monotonic() + requirements.patience_s
    while (missing := _missing(requirements)) is not None and time.monotonic() < end:
        time.sleep(LOOK_S)
    return missing


def _missing(requirements: WorkerRequirements) -> Path | None:
    for folder in requirements.folders:
        if not folder.is_dir() or not os.access(folder, os.R_OK | os.X_OK):
            return folder
    try:
        same = requirements.mark.read_text("utf-8", "replace") == requirements.content
    except OSError:
        same = False
    return None if same else requirements.mark.parent


def _unwritable(mark: Path, here: str) -> AccelcalError | None:
    try:
        beside(mark).unlink(missing_ok=True)
    except OutputError as error:
        return OutputError(
            f"{here}: {error.message}", path=mark.parent, hint="give its user permission to write there"
        )
    return None


def calibrate_in_user_folder(
    cwd: Path, task: CalibrationTask, report_progress: ProgressCallback
) -> TaskResult:
    """See `calibrated`; the result and the files written are those that a process in `cwd` would give.

    Nobody's current folder is changed: other threads of this process may rely on it.
    """
    result = calibrated(in_user_folder(cwd, task), report_progress)
    if not result.entry.failed or result.entry.row is None:
        return result
    row = {**result.entry.row, "message": _as_named(cwd, task, result.entry.row["message"])}
    return replace(result, entry=replace(result.entry, row=row))


def in_user_folder(cwd: Path, task: CalibrationTask) -> CalibrationTask:
    """The task with absolute paths."""
    job, common = task.item.job, task.common
    options = common.request.options
    there = replace(job, source=cwd / job.source, parquet=cwd / job.parquet, report=cwd / job.report)
    layout = None if options.layout is None else cwd / options.layout
    request = replace(common.request, options=replace(options, layout=layout))
    common = replace(common, out=cwd / common.out, request=request)
    return replace(task, item=replace(task.item, job=there), common=common, named=job.source)


def _as_named(cwd: Path, task: CalibrationTask, message: str) -> str:
    """A message with the folders as the user named them."""
    layout = task.common.request.options.layout
    folders = [task.item.source.parent, task.common.out, *([] if layout is None else [layout.parent])]
    for folder in folders:
        message = message.replace(_start(cwd / folder), _start(folder))
    return message


def _start(folder: Path) -> str:
    return "" if folder == Path() else str(Path(printable(folder)) / "_")[:-1]
