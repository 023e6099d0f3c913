"""Helpers, which do jobs beside their caller, each one after another.

Python's threads wait for each other at every step that holds the interpreter's lock, so a helper is a process
forked from this one where that is safe, and a thread elsewhere. What jobs are about lies in memory that both
see (`shared_memory`); they and their results are small. A process that is lost, however it went, costs time
only: the caller does its jobs itself.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from mmap import mmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NoReturn, TypeVar, cast

from accelcal_cli.core.parallel import BackgroundCalls
from accelcal_cli.core.system import give_back_freed_memory, process_is_ours

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

J = TypeVar("J")
R = TypeVar("R")

ENDING_SIGNALS = {getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)}
"""They end a command, and its first process handles them."""

LINGERS_MS = 100
"""So long a thread that was joined is waited for: until it has ended for the system, too."""

TASKS = Path("/proc/self/task")
"""The threads of this process, Python's and others (proc(5))."""


class Helper(ABC, Generic[J, R]):
    """One that does jobs beside the caller and gives their results in the order of the jobs.

    Attributes:
        lost: whether it is gone, so that the caller does its jobs when it takes their results.
    """

    lost = False

    @property
    @abstractmethod
    def waiting(self) -> int:
        """Jobs whose results were not taken yet."""

    @abstractmethod
    def give(self, job: J) -> None:
        """Give a job to be done later."""

    @abstractmethod
    def ready(self) -> bool:
        """Whether the next result can be taken at once; there is a job."""

    @abstractmethod
    def take(self) -> R:
        """The next result, waited for; raises what the work raised."""

    @abstractmethod
    def close(self) -> None:
        """End the helper; jobs that are left may stay undone."""


def shared_memory(size: int) -> mmap:
    """Zeros, so many bytes, which helpers see as the caller does.

    Raises:
        MemoryError: there is not enough memory.
    """
    try:
        return mmap(-1, size)
    except OSError as error:
        raise MemoryError(str(error)) from error


@contextlib.contextmanager
def helpers(work: Callable[[J], R], number: int) -> Iterator[list[Helper[J, R]]]:
    """So many helpers that do this work, to the end of the block.

    Memory that they share with the caller is there before they are. Threads start with their first job.
    """
    with contextlib.ExitStack() as stack:
        forked = number > 0 and can_be_forked()
        made = []
        for _ in range(number):
            made.append(_helper(work, forked=forked))
            stack.callback(made[-1].close)
        yield made


@contextlib.contextmanager
def beside(call: Callable[[], R], *, long: bool) -> Iterator[Callable[[], R]]:
    """A call that a helper makes beside the block, if it takes long; what is given waits for its result."""

    def work(_job: None) -> R:
        return call()

    with helpers(work, int(long)) as made:
        for helper in made:
            helper.give(None)
        yield made[0].take if made else call


def _helper(work: Callable[[J], R], *, forked: bool) -> Helper[J, R]:
    """A process if one can be had, else a thread."""
    if forked:
        with contextlib.suppress(OSError):
            return _Process(work)
    return _Thread(work)


def can_be_forked() -> bool:
    """Whether a fork of this process can work: it is ours alone, and no other thread holds a lock.

    On Linux only: libraries of macOS may end a process that was forked.
    """
    if sys.platform != "linux" or not process_is_ours() or threading.active_count() > 1:
        return False
    return any(_has_one_thread() for _ in range(LINGERS_MS))


def _has_one_thread() -> bool:
    """Whether the system knows of no other thread; if it does, a millisecond later."""
    try:
        alone = len([*TASKS.iterdir()]) == 1
    except OSError:
        return False
    if not alone:
        time.sleep(0.001)
    return alone


class _Thread(Helper[J, R]):
    """A helper that waits for the interpreter's lock as the caller does."""

    def __init__(self, work: Callable[[J], R]) -> None:
        self._work, self._calls = work, BackgroundCalls("helper")

    @property
    def waiting(self) -> int:
        """See `Helper`."""
        return len(self._calls)

    def give(self, job: J) -> None:
        """See `Helper`."""
        self._calls.submit(self._work, job)

    def ready(self) -> bool:
        """See `Helper`."""
        return self._calls.ready()

    def take(self) -> R:
        """See `Helper`."""
        return cast(R, self._calls.take())

    def close(self) -> None:
        """See `Helper`."""
        self._calls.close()


class _Process(Helper[J, R]):
    """A helper in a process of its own, which ends with the caller's end of the pipe."""

    def __init__(self, work: Callable[[J], R]) -> None:
        """Fork it; raises OSError if that is not possible."""
        from multiprocessing import Pipe  # few runs need a helper

        self._work = work
        self._jobs: deque[J] = deque()
        self._pipe, theirs = Pipe()
        give_back_freed_memory()  # what both then use anew would be copied
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
        try:
            self._process = os.fork()
            if not self._process:
                _serve(theirs, self._pipe, work)
        finally:
            theirs.close()
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    @property
    def waiting(self) -> int:
        """See `Helper`."""
        return len(self._jobs)

    def give(self, job: J) -> None:
        """See `Helper`."""
        self._jobs.append(job)
        if not self.lost:
            try:
                self._pipe.send(job)
            except OSError:
                self.close()

    def ready(self) -> bool:
        """See `Helper`."""
        return self.lost or self._pipe.poll()

    def take(self) -> R:
        """See `Helper`."""
        job = self._jobs.popleft()
        if not self.lost:
            try:
                return cast(R, self._pipe.recv())
            except (OSError, EOFError):
                self.close()
        return self._work(job)

    def close(self) -> None:
        """See `Helper`; it writes no more into memory that others may then use."""
        self._pipe.close()
        if not self.lost:
            self.lost = True
            with contextlib.suppress(OSError):  # where a program ignores SIGCHLD nobody waits for it
                os.kill(self._process, signal.SIGKILL)
                os.waitpid(self._process, 0)


def _serve(pipe: Connection, of_caller: Connection, work: Callable[[Any], Any]) -> NoReturn:
    """What a helper's process does until the caller is gone, or work fails, which the caller finds out."""
    try:
        for number in ENDING_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING_SIGNALS)
        of_caller.close()
        while True:
            pipe.send(work(pipe.recv()))
    finally:
        os._exit(0)
