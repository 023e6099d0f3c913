"""Rounds of a study: each gives tasks to workers, and the results of earlier rounds decide which.

Also chooses between processes of this machine and a cluster.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from accelcal_cli.core import system
from accelcal_cli.core.errors import printable
from accelcal_cli.core.version import __version__
from accelcal_cli.output.files import sweep, sweep_of
from accelcal_cli.studies import records
from accelcal_cli.studies.dask_client import Cluster, Notify
from accelcal_cli.studies.dask_worker import WorkerRequirements, calibrate_in_user_folder, code
from accelcal_cli.studies.process_pool import ProcessPool
from accelcal_cli.studies.study import Study
from accelcal_cli.studies.task import BUG, NO_MEMORY, Common, Task, TaskResult, calibrated

PRELOAD = "accelcal_cli.studies.preload"
MANY = 1 << 20


def executor_for(
    study: Study,
    work: records.TaskFunction,
    recordings: int,
    on_progress: records.ProgressDelta,
    notify: Notify,
) -> records.Executor:
    """Processes of this machine for so many recordings, or the cluster that was named.

    A cluster finds the own results; what a device's recordings have in common is found here.
    """
    if study.dask is None or work is not calibrated:
        return ProcessPool(work, workers_of(study, recordings), study.timeout_s, PRELOAD, on_progress)
    cwd = Path.cwd()
    calibrate, requirements = functools.partial(calibrate_in_user_folder, cwd), _requirements(study, cwd)
    return Cluster(
        study.dask, calibrate, requirements, study.jobs, study.timeout_s, on_progress, notify, tidy
    )


def workers_of(study: Study, recordings: int) -> int:
    """Processes of this machine that work at a time on so many recordings."""
    wanted = study.jobs if study.dask is None else None
    return min(wanted or system.workers(recordings), max(1, recordings))


def _requirements(study: Study, cwd: Path) -> WorkerRequirements:
    """The lock is the mark: it is there while the study runs, and no other run's is like it."""
    mark = cwd / study.lock
    folders = tuple(cwd / folder for folder in study.where.folders)
    return WorkerRequirements(__version__, code(), folders, mark, mark.read_text("utf-8"))


def tidy(task: Task, lost: str | None = None) -> None:
    """Remove what killed processes of this machine left, and one of another that is known to be gone."""
    for path in task.item.job.outputs:
        with contextlib.suppress(OSError):
            sweep(path)
            if lost is not None:
                sweep_of(path, lost)


class StudyObserver(Protocol):
    """Who is informed while a study runs."""

    def begin(self, items: Sequence[records.Item]) -> None:
        """Before these recordings are worked on."""

    def advance(self, bytes_done: float) -> None:
        """So many more bytes are done."""

    def finished(self, item: records.Item, result: TaskResult) -> None:
        """A recording's last result is there: it is done, was done before, or failed."""

    def note(self, text: str) -> None:
        """What a person should know meanwhile."""


@dataclass(frozen=True, slots=True)
class StudyState:
    """What is known when a round begins.

    Attributes:
        standing: the recordings that have a result, by name.
        pools: what became of each pool of recordings, by its own name.
    """

    standing: dict[str, records.RecordingState] = field(default_factory=dict)
    pools: dict[str, records.Entry] = field(default_factory=dict)

    def take(self, one: Round, name: str, entry: records.Entry) -> None:
        """Replace what is known of a recording, or of a pool, by what a round made of it."""
        if one.of_pools:
            self.pools[name] = entry
        else:
            self.standing[name] = replace(self.standing[name], last=entry)


class RoundTask(Task, Protocol):
    """A task of a round after the first."""

    @property
    def names(self) -> tuple[str, ...]:
        """Recordings whose result may change with it."""

    def stands(self, entry: records.Entry) -> bool:
        """Whether an earlier entry of the round is what would come of it now."""


@dataclass(frozen=True, slots=True)
class Round:
    """A round after that of the own results.

    Attributes:
        name: by which its entries are known.
        work: what a worker does with a task; returns a `TaskResult`.
        tasks: one for each recording (or pool) that the round concerns, from what is known. On these
            alone, and on the recording's files, its result may depend.
        of_pools: whether its tasks are of pools, and no recording's result is replaced.
    """

    name: str
    work: records.TaskFunction
    tasks: Callable[[Study, StudyState], Sequence[RoundTask]]
    of_pools: bool = False


def common_of(study: Study, recordings: int = MANY) -> Common:
    """What tasks on so many recordings share; a cluster counts its threads itself."""
    threads = 1 if study.dask is not None else system.threads(workers_of(study, recordings))
    return Common(study.out, replace(study.request, threads=threads), study.asked())


def results(
    study: Study,
    work: records.TaskFunction,
    tasks: Sequence[Any],
    observer: StudyObserver,
    check: Callable[[], None],
) -> Iterator[tuple[records.Item, TaskResult]]:
    """Have tasks done, the largest first, so that the last to end is a small one.

    Args:
        check: called whenever a task is further; what it raises ends the work.
    """
    if not tasks:
        return
    observer.begin([task.item for task in tasks])
    ordered = sorted(tasks, key=lambda task: (-task.item.size, task.item.name))

    def moved(task: Task, part: float) -> None:
        check()
        observer.advance(part * task.item.size)

    executor = executor_for(study, work, len(tasks), moved, observer.note)
    with contextlib.closing(executor.run(ordered)) as ended:
        for one in ended:
            yield one.task.item, _result(one)


def _result(ended: records.Finished) -> TaskResult:
    if ended.fault is None:
        result: TaskResult = ended.result
        return result
    task: Task = ended.task
    tidy(task)
    message = f"{printable(task.item.source)}: {ended.fault}"
    return TaskResult(task.failure(NO_MEMORY if ended.lacking else BUG, message, again=ended.retry))
