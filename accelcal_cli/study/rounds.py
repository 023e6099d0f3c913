"""Which engine does the tasks of a study, and what is left to tidy up after it.

A study goes in rounds: each gives tasks to workers, and what came of the earlier ones decides which.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from accelcal_cli import __version__
from accelcal_cli.core import system
from accelcal_cli.core.errors import printable
from accelcal_cli.output.files import sweep, sweep_of
from accelcal_cli.study.dask_client import Cluster, Said
from accelcal_cli.study.dask_worker import Terms, calibrated_from, code
from accelcal_cli.study.plan import Study
from accelcal_cli.study.process_pool import Crew
from accelcal_cli.study.records import Ended, Engine, Entry, Item, Moved, Standing, Work
from accelcal_cli.study.task import BUG, Answer, Common, Doing, calibrated

PRELOAD = "accelcal_cli.study.preload"
MANY = 1 << 20


def engine_of(study: Study, work: Work, recordings: int, moved: Moved, said: Said) -> Engine:
    """Processes of this machine for so many recordings, or the cluster that was named.

    A cluster finds the own results; what a device's recordings have in common is found here.
    """
    if study.dask is None or work is not calibrated:
        return Crew(work, workers_of(study, recordings), study.timeout_s, PRELOAD, moved)
    cwd = Path.cwd()
    abroad, terms = functools.partial(calibrated_from, cwd), _terms(study, cwd)
    return Cluster(study.dask, abroad, terms, study.jobs, study.timeout_s, moved, said, tidy)


def workers_of(study: Study, recordings: int) -> int:
    """Processes of this machine that work at a time on so many recordings."""
    wanted = study.jobs if study.dask is None else None
    return min(wanted or system.workers(recordings), max(1, recordings))


def threads_of(study: Study, recordings: int = MANY) -> int:
    """Threads for one recording, so that all that work at a time fit the CPUs; a cluster counts its own."""
    return 1 if study.dask is not None else system.threads(workers_of(study, recordings))


def _terms(study: Study, cwd: Path) -> Terms:
    """The lock is the mark: it is there while the study runs, and no other run's is like it."""
    mark = cwd / study.lock
    folders = tuple(cwd / folder for folder in study.where.folders)
    return Terms(__version__, code(), folders, mark, mark.read_text("utf-8"))


def tidy(task: Doing, lost: str | None = None) -> None:
    """Remove what killed processes of this machine left, and one of another that is known to be gone."""
    for path in (task.item.job.parquet, task.item.job.report, task.item.job.integers):
        with contextlib.suppress(OSError):
            sweep(path)
            if lost is not None:
                sweep_of(path, lost)


class Watch(Protocol):
    """Who is told while a study runs."""

    def begin(self, items: Sequence[Item]) -> None:
        """Before these recordings are worked on."""

    def moved(self, bytes_done: float) -> None:
        """So many more bytes are done."""

    def ended(self, item: Item, answer: Answer) -> None:
        """A recording's last result is there: it is done, was done before, or failed."""

    def said(self, text: str) -> None:
        """What a person should know meanwhile."""


@dataclass(frozen=True, slots=True)
class Known:
    """What is known when a round begins.

    Attributes:
        standing: the recordings that have a result, by name.
        pools: what became of each pool of recordings, by its own name.
    """

    standing: dict[str, Standing] = field(default_factory=dict)
    pools: dict[str, Entry] = field(default_factory=dict)


class Later(Doing, Protocol):
    """A task of a round after the first."""

    @property
    def names(self) -> tuple[str, ...]:
        """Recordings whose result may change with it."""

    def stands(self, entry: Entry) -> bool:
        """Whether an earlier entry of the round is what would come of it now."""


@dataclass(frozen=True, slots=True)
class Round:
    """A round after that of the own results.

    Attributes:
        name: by which its entries are known.
        work: what a worker does with a task; returns an `Answer`.
        tasks: one for each recording (or pool) that the round concerns, from what is known. On these
            alone, and on the recording's files, its result may depend.
        of_pools: whether its tasks are of pools, and no recording's result is replaced.
    """

    name: str
    work: Work
    tasks: Callable[[Study, Known], Sequence[Later]]
    of_pools: bool = False


def common_of(study: Study) -> Common:
    """What all tasks of a study share."""
    return Common(study.out, replace(study.request, threads=threads_of(study)), study.asked())


def answers(study: Study, work: Work, tasks: Sequence[Any], watch: Watch) -> Iterator[tuple[Item, Answer]]:
    """Have tasks done, the largest first, so that the last to end is a small one."""
    if not tasks:
        return
    watch.begin([task.item for task in tasks])
    ordered = sorted(tasks, key=lambda task: (-task.item.size, task.item.name))
    engine = engine_of(
        study, work, len(tasks), lambda task, part: watch.moved(part * task.item.size), watch.said
    )
    with contextlib.closing(engine.run(ordered)) as ended:
        for one in ended:
            yield one.task.item, _answer(one)


def _answer(ended: Ended) -> Answer:
    if ended.fault is None:
        answer: Answer = ended.answer
        return answer
    task: Doing = ended.task
    tidy(task)
    message = f"{printable(task.item.source)}: {ended.fault}"
    return Answer(task.failure(BUG, message, again=ended.again))
