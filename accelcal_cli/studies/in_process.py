"""The executors of a program that uses accelcal: its own process, and its pools of concurrent.futures."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Generator
from concurrent.futures import BrokenExecutor, Future, as_completed, wait
from concurrent.futures import Executor as Pool
from dataclasses import dataclass
from typing import Any

from accelcal_cli.studies.records import Finished, ProgressDelta, TaskFunction


def must_stay() -> bool:
    """Return True if this process cannot start others: a worker of a pool of multiprocessing or of Dask."""
    return bool(multiprocessing.current_process().daemon)


@dataclass(frozen=True, slots=True)
class InProcess:
    """Carries out tasks in this process, one after another (see `Executor`)."""

    work: TaskFunction
    on_progress: ProgressDelta

    def run(self, tasks: list[Any]) -> Generator[Finished, None, None]:
        """Carry out each task when its result is asked for."""
        for task in tasks:
            yield Finished(task, result=self._done(task))

    def _done(self, task: Any) -> Any:
        reached = 0.0

        def moved(part: float) -> None:
            nonlocal reached
            self.on_progress(task, part - reached)
            reached = part

        moved(0.0)
        result = self.work(task, moved)
        moved(1.0)
        return result


@dataclass(frozen=True, slots=True)
class Futures:
    """Gives tasks to a pool of concurrent.futures, or to what behaves like one (see `Executor`)."""

    pool: Pool
    work: TaskFunction
    on_progress: ProgressDelta

    def run(self, tasks: list[Any]) -> Generator[Finished, None, None]:
        """Yield each task as it ends; none of them runs any more when the iteration has ended."""
        given: dict[Future[Any], Any] = {}
        try:
            with contextlib.suppress(BrokenExecutor):
                given.update((self.pool.submit(self.work, task, _unseen), task) for task in tasks)
            for one in as_completed(given):
                self.on_progress(given[one], 1.0)
                yield _ended(given[one], one)
            yield from (_lost(task) for task in tasks[len(given) :])
        finally:
            wait([one for one in given if not one.cancel()])


def _unseen(_part: float) -> None:
    """Take the progress of a task that is done elsewhere."""


def _ended(task: Any, future: Future[Any]) -> Finished:
    error = future.exception()
    if error is None:
        return Finished(task, result=future.result())
    if isinstance(error, BrokenExecutor):
        return _lost(task)
    return Finished(task, fault=f"its worker failed ({type(error).__name__}: {error})", retry=True)


def _lost(task: Any) -> Finished:
    return Finished(task, fault="the pool's workers ended", retry=True)
