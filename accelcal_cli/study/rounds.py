"""A study goes in rounds: each gives tasks to workers, and what came of the earlier ones decides which."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from accelcal_cli.core.names import printable
from accelcal_cli.study.engine import Ended, Work
from accelcal_cli.study.engines import engine_of, threads_of, tidy
from accelcal_cli.study.items import Entry, Item, Standing
from accelcal_cli.study.plan import Study
from accelcal_cli.study.work import BUG, Answer, Common, Doing


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
