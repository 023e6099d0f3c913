"""A connection to a cluster of dask.distributed, which is an extra and imported here alone.

Tasks in the hands of a cluster of dask.distributed: given, heard of, and taken back.

Tasks done by a cluster of dask.distributed; what befalls a worker there is made good elsewhere.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import pickle
import secrets
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from accelcal_cli.core.errors import ClusterError, UsageError, printable
from accelcal_cli.study.dask_worker import BEGAN, LEFT, PART, TOPIC, Terms, order
from accelcal_cli.study.records import Ended, Moved, Work

CONNECT_LOOK_S = 0.5
Said = Callable[[str], None]


@contextlib.contextmanager
def connected(told: str, said: Said) -> Iterator[Any]:
    """A client of the scheduler at an address, or of the one that wrote a scheduler file.

    It waits as long as distributed does (`distributed.comm.timeouts.connect`, 30 s unless configured). What
    distributed would print meanwhile is kept from the user, who is told in our words.

    Raises:
        UsageError: distributed is not installed.
        ClusterError: the scheduler cannot be reached, or is of another version.
    """
    library = _library()
    with _silence():
        client = _client(library, told, said)
        try:
            yield client
        finally:
            with contextlib.suppress(Exception):
                client.close(timeout=5)


def _library() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise UsageError("--dask needs dask.distributed", hint="pip install 'accelcal[dask]'") from error
    return distributed


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def _client(library: Any, told: str, said: Said) -> Any:
    import dask

    wait_s = dask.utils.parse_timedelta(dask.config.get("distributed.comm.timeouts.connect"))
    address = _address(told, wait_s)
    _check(library, address, wait_s)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            client = library.Client(address, timeout=wait_s, set_as_default=False, name="accelcal")
        except Exception as error:
            raise _unreachable(address, error) from error
    if any(one.category.__name__ == "VersionMismatchWarning" for one in warned):
        said("on the cluster some versions (Python, dask, numpy or others) are not those that are here")
    return client


def _check(library: Any, address: str, wait_s: float) -> None:
    """Ask for the version before a client is made: one of another version may fail, and then hangs."""
    from distributed.comm import parse_address
    from distributed.comm.registry import get_backend

    try:
        get_backend(parse_address(address)[0] if address else "")
    except ValueError as error:
        raise UsageError(
            f"--dask {printable(address)!r} is no address", hint="use one such as tcp://host:8786"
        ) from error
    try:
        there = asyncio.run(_version(library, address, wait_s))
    except Exception as error:
        raise _unreachable(address, error) from error
    if there != library.__version__:
        raise ClusterError(
            f"the scheduler at {address} has distributed {there}, here is {library.__version__}",
            hint="install the same version on every machine",
        )


async def _version(library: Any, address: str, wait_s: float) -> str:
    """Of the scheduler's distributed."""
    secured = library.Security().get_connection_args("client")
    async with asyncio.timeout(wait_s), library.rpc(address, connection_args=secured) as scheduler:
        return str((await scheduler.versions())["packages"]["distributed"])


def _unreachable(address: str, error: Exception) -> ClusterError:
    reason = " ".join(str(error).split()) or "no answer"
    return ClusterError(
        f"no scheduler answers at {address} ({reason})",
        hint="start one with `dask scheduler`, and give its address or its --scheduler-file",
    )


def _address(told: str, wait_s: float) -> str:
    """The address itself; for a scheduler file what it holds, once it is there."""
    if not told.endswith(".json"):
        return told
    path, end = Path(told), time.monotonic() + wait_s
    while (address := _written(path)) is None and time.monotonic() < end:
        time.sleep(CONNECT_LOOK_S)
    if address is None:
        raise ClusterError(
            "no scheduler has written its address here", path=printable(path), hint="start `dask scheduler`"
        )
    return address


def _written(path: Path) -> str | None:
    try:
        found = json.loads(path.read_text("utf-8"))["address"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return found if isinstance(found, str) else None


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


@dataclass(slots=True)
class Cluster(Wishes):
    """The workers of a scheduler."""

    def run(self, tasks: list[Any]) -> Generator[Ended, None, None]:
        """See `Engine`.

        Raises:
            UsageError: distributed is not installed.
            ClusterError: the scheduler cannot be reached or is lost, or a worker does not meet the terms.
            OutputError: a worker cannot write where the outputs go.
        """
        if tasks:
            with connected(self.told, self.said) as client:
                yield from Session(self, client, deque(tasks)).run()
