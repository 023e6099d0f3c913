"""What a worker of a cluster does with a task, and whether it may: imported there, without the command.

A recording calibrated by a process whose current folder is not the user's.
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

import accelcal_cli
from accelcal_cli.core.errors import AccelcalError, ClusterError, OutputError, printable
from accelcal_cli.output.files import beside, owner
from accelcal_cli.study.records import Told, Work
from accelcal_cli.study.task import Answer, Task, calibrated

TOPIC = "accelcal"
"""Under which workers tell how far they are."""

BEGAN, PART, LEFT = "began", "part", "left"
TELL_S = 1.0
LOOK_S = 1.0


@dataclass(frozen=True, slots=True)
class Terms:
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
class _Order:
    """Becomes the result of `carry_out` where its pickle is loaded."""

    work: Work
    task: Any
    terms: Terms

    def __reduce__(self) -> tuple[Any, ...]:
        return carry_out, (pickle.dumps((self.work, self.task)), self.terms)


def order(work: Work, task: Any, terms: Terms) -> bytes:
    """Bytes to be done by `pickle.loads` in a thread of a worker.

    Neither the scheduler nor a worker without this package, or with another, can stumble over them: the
    task itself fails. (A worker that cannot unpickle a task of distributed's ends.)
    """
    return pickle.dumps(_Order(work, task, terms))


def carry_out(order: bytes, terms: Terms) -> tuple[str, Any]:
    """Do a task in a thread of a worker.

    Returns:
        `answer` and what the work returned, `unfit` and why this worker must not do it, or `left` and
        None where the task was cancelled meanwhile.
    """
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def tell(kind: str, value: Any) -> None:
        worker.log_event(TOPIC, (key, kind, value))

    error = unfit(terms)
    if error is not None:
        return "unfit", error
    work, task = pickle.loads(order)
    tell(BEGAN, owner())
    try:
        return "answer", work(task, _telling(worker, key, tell))
    except _CancelledError:
        return LEFT, None
    finally:
        tell(LEFT, owner())


def _telling(worker: Any, key: Any, tell: Callable[[str, Any], None]) -> Callable[[float], None]:
    """Tells the parts, not too often, and ends the work once its task is cancelled.

    A cluster cannot end a thread; the state of a task is described in distributed's "Worker State Machine".
    """
    following = 0.0

    def told(part: float) -> None:
        nonlocal following
        state = worker.state.tasks.get(key)
        if state is None or state.state == "cancelled":
            raise _CancelledError
        if time.monotonic() >= following:
            following = time.monotonic() + TELL_S
            tell(PART, part)

    return told


@lru_cache
def code() -> str:
    """A hash of this package's source: two versions of one name are not the same."""
    root, digest = Path(accelcal_cli.__file__).parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


@lru_cache
def unfit(terms: Terms) -> AccelcalError | None:
    """Why this process must not work for a study; None where it may. Looked at once a study."""
    here = f"the worker on {platform.node() or 'a host'}"
    if terms.version != accelcal_cli.__version__:
        have = f"{here} has accelcal {accelcal_cli.__version__}, not {terms.version}"
        return ClusterError(have, hint="install the same version on every machine")
    if terms.code != code():
        have = f"{here} has another accelcal that is also called {terms.version}"
        return ClusterError(have, hint="install the same on every machine")
    if (hidden := _hidden(terms)) is not None:
        return ClusterError(
            f"{here} does not see it", path=hidden, hint="the cluster must share the disks of FOLDER and OUT"
        )
    return _unwritable(terms.mark, here)


def _hidden(terms: Terms) -> Path | None:
    """What a worker does not see; a shared disk may take its time to show a new file."""
    end = time.monotonic() + terms.patience_s
    while (missing := _missing(terms)) is not None and time.monotonic() < end:
        time.sleep(LOOK_S)
    return missing


def _missing(terms: Terms) -> Path | None:
    for folder in terms.folders:
        if not folder.is_dir() or not os.access(folder, os.R_OK | os.X_OK):
            return folder
    try:
        same = terms.mark.read_text("utf-8", "replace") == terms.content
    except OSError:
        same = False
    return None if same else terms.mark.parent


def _unwritable(mark: Path, here: str) -> AccelcalError | None:
    try:
        beside(mark).unlink(missing_ok=True)
    except OutputError as error:
        return OutputError(f"{here}: {error.message}", path=mark.parent, hint="let its user write there")
    return None


def calibrated_from(cwd: Path, task: Task, told: Told) -> Answer:
    """See `calibrated`; the answer and the files written are those that a process in `cwd` would give.

    Nobody's current folder is changed: other threads of this process may rely on it.
    """
    answer = calibrated(seen_from(cwd, task), told)
    if not answer.entry.failed or answer.entry.row is None:
        return answer
    row = {**answer.entry.row, "message": _as_said(cwd, task, answer.entry.row["message"])}
    return replace(answer, entry=replace(answer.entry, row=row))


def seen_from(cwd: Path, task: Task) -> Task:
    """The task with absolute paths."""
    job, options = task.item.job, task.request.options
    there = replace(job, source=cwd / job.source, parquet=cwd / job.parquet, report=cwd / job.report)
    layout = None if options.layout is None else cwd / options.layout
    return replace(
        task,
        item=replace(task.item, job=there),
        out=cwd / task.out,
        request=replace(task.request, options=replace(options, layout=layout)),
        said=job.source,
    )


def _as_said(cwd: Path, task: Task, message: str) -> str:
    """A message with the folders as the user named them."""
    layout = task.request.options.layout
    folders = [task.item.source.parent, task.out, *([] if layout is None else [layout.parent])]
    for folder in folders:
        message = message.replace(_start(cwd / folder), _start(folder))
    return message


def _start(folder: Path) -> str:
    """What names in a folder begin with."""
    return "" if folder == Path() else str(Path(printable(folder)) / "_")[:-1]
