"""Tasks in the hands of a cluster of dask.distributed: given, heard of, and taken back."""

from __future__ import annotations

import contextlib
import pickle
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any

from accelcal_cli.core.errors import ClusterError
from accelcal_cli.study.connect import Said
from accelcal_cli.study.engine import Ended, Moved, Work
from accelcal_cli.study.remote import BEGAN, LEFT, PART, TOPIC, Terms, order

POLL_S = 1.0
LOOK_S = 3.0
GRACE_S = 10.0
DONE = "done"


@dataclass(slots=True)
class Wishes:
    """What a cluster is asked to do.

    Attributes:
        told: address of the scheduler, or name of its scheduler file.
        work: what is done with a task.
        terms: what a worker must be.
        limit: how many tasks the cluster is given at a time; None for as many as its workers have threads.
        timeout_s: the longest a task may take from when it began; None for no end.
        moved: see `Moved`.
        said: called with what a person should know.
        lost: called with a task and the `HOST.PROCESS` that began it and is gone.
    """

    told: str
    work: Work
    terms: Terms
    limit: int | None = None
    timeout_s: float | None = None
    moved: Moved = lambda _task, _part: None
    said: Said = lambda _text: None
    lost: Callable[[Any, str], None] = lambda _task, _owner: None


@dataclass(slots=True)
class _Given:
    """A task in the hands of the cluster; `owners` began it, all but the last of them in vain."""

    task: Any
    future: Any
    tries: int
    owners: list[str] = field(default_factory=list)
    began: float | None = None
    lives: bool = False
    part: float = 0.0


@dataclass(slots=True)
class Session:
    """One run; the keys of its tasks begin with its name.

    No more is given out than can begin: if a worker is lost, distributed blames all that it held.
    """

    wishes: Wishes
    client: Any
    waiting: deque[Any]
    name: str = field(default_factory=lambda: f"accelcal-{secrets.token_hex(6)}")
    running: dict[str, _Given] = field(default_factory=dict)
    heard: SimpleQueue[tuple[str, str, Any]] = field(default_factory=SimpleQueue)
    number: int = 0
    threads: int = -1
    looked: float = 0.0

    def run(self) -> Iterator[Ended]:
        """Give, and listen, until nothing is left."""
        self.client.subscribe_topic(TOPIC, lambda event: self.heard.put(tuple(event[1])))
        try:
            while self.waiting or self.running:
                self._look()
                while self.waiting and len(self.running) < (self.wishes.limit or max(1, self.threads)):
                    self._give(self.waiting.popleft(), tries=1)
                yield from self._listen()
                yield from self._late()
        finally:
            with contextlib.suppress(Exception):
                self._give_up()

    def _look(self) -> None:
        """How many can work now, from time to time."""
        if time.monotonic() < self.looked:
            return
        self.looked = time.monotonic() + LOOK_S
        try:
            threads = sum(self.client.nthreads().values())
        except Exception as error:
            raise self._lost(error) from error
        if threads == 0 and self.threads != 0:
            self.wishes.said(f"{self.wishes.told} has no workers; waiting for one")
        self.threads = threads

    def _lost(self, reason: object) -> ClusterError:
        return ClusterError(
            f"the scheduler {self.wishes.told} was lost ({reason})",
            hint="what is done is kept: run this again",
        )

    def _give(self, task: Any, tries: int) -> None:
        self.number += 1
        key = f"{self.name}-{self.number}"
        try:
            given = order(self.wishes.work, task, self.wishes.terms)
            future = self.client.submit(pickle.loads, given, key=key, pure=False)
        except Exception as error:
            raise self._lost(error) from error
        self.running[key] = _Given(task, future, tries)
        future.add_done_callback(lambda _future: self.heard.put((key, DONE, None)))

    def _listen(self) -> Iterator[Ended]:
        """What comes within a moment; what others do is none of ours."""
        try:
            key, kind, value = self.heard.get(timeout=POLL_S)
        except Empty:
            return
        given = self.running.get(key)
        if given is None:
            return
        if kind == DONE:
            yield from self._done(key, given)
        elif kind == BEGAN:
            given.owners.append(value)
            given.began, given.lives = time.monotonic(), True
        elif kind == LEFT:
            given.lives = False
        elif kind == PART:
            self._moved(given, value)

    def _moved(self, given: _Given, part: float) -> None:
        self.wishes.moved(given.task, part - given.part)
        given.part = part

    def _done(self, key: str, given: _Given) -> Iterator[Ended]:
        """One that is not pending any more, unless its result was lost with the worker."""
        status = given.future.status
        if status == "pending":
            given.future.add_done_callback(lambda _future: self.heard.put((key, DONE, None)))
            return
        if status == "cancelled":
            raise self._lost("its tasks are gone")
        if status == "error":
            yield from self._erred(key, given, given.future.exception())
            return
        kind, value = self._result(given)
        if kind == "unfit":
            raise value
        del self.running[key]
        self._clear(given, given.owners[:-1])
        self._moved(given, 1.0)
        yield Ended(given.task, answer=value)

    def _result(self, given: _Given) -> tuple[str, Any]:
        try:
            result: tuple[str, Any] = given.future.result()
        except Exception as error:
            raise self._lost(error) from error
        return result

    def _erred(self, key: str, given: _Given, error: Exception) -> Iterator[Ended]:
        """Work never raises: either its workers were killed, or they could not take the task up."""
        if type(error).__name__ != "KilledWorker":
            said = " ".join(f"{type(error).__name__}: {error}".split())
            raise ClusterError(
                f"a worker cannot take up a task ({said})",
                hint="install the same accelcal on every machine",
            ) from error
        del self.running[key]
        self._clear(given, given.owners)
        if not given.owners and given.tries == 1:
            self._give(given.task, tries=2)
            return
        fault = "every worker that tried it was lost, perhaps for want of memory"
        yield Ended(given.task, fault=fault, again=True)

    def _clear(self, given: _Given, owners: list[str]) -> None:
        for owner in owners:
            self.wishes.lost(given.task, owner)

    def _late(self) -> Iterator[Ended]:
        limit = self.wishes.timeout_s
        if limit is None:
            return
        for key, given in list(self.running.items()):
            if given.began is not None and time.monotonic() - given.began > limit:
                del self.running[key]
                with contextlib.suppress(OSError):
                    self.client.cancel([given.future], force=True)
                yield Ended(given.task, fault=f"took more than {limit / 60:g} minutes and was ended")

    def _give_up(self) -> None:
        """Cancel what runs, and wait a moment for it to be gone, so that nothing half-written is left."""
        self.client.cancel([given.future for given in self.running.values()], force=True)
        begun = {key for key, given in self.running.items() if given.lives}
        end = time.monotonic() + GRACE_S
        while begun and (left := end - time.monotonic()) > 0:
            with contextlib.suppress(Empty):
                key, kind, _ = self.heard.get(timeout=left)
                if kind == LEFT:
                    begun.discard(key)
