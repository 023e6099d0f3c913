"""Work ahead: one room fills chunks while the next one uses those before.

A file that is written behind the back of whoever fills it.

Work on several things at a time, whose results come in the order of the things.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from threading import Lock
from typing import BinaryIO, TypeVar, cast

T = TypeVar("T")
DEPTH = 2
"""Items in flight; each holds memory."""

_END = object()


def ahead(items: Iterator[T], threads: int, depth: int = DEPTH) -> Iterator[T]:
    """The items of an iterator, in order, up to `depth` of them made ahead on another thread.

    What the iterator raises is raised here, in its place. Closing this closes the iterator.

    Args:
        threads: how many may work at a time; nothing is made ahead where there is but one.
    """
    if threads < 2:
        yield from items
        return
    made = _Guarded(items)
    with ThreadPoolExecutor(1, thread_name_prefix="ahead") as thread:
        waiting: deque[Future[object]] = deque()
        try:
            for _ in range(depth):
                waiting.append(thread.submit(made.next))
            while (item := waiting.popleft().result()) is not _END:
                waiting.append(thread.submit(made.next))
                yield cast(T, item)
        finally:
            for future in waiting:
                future.cancel()
            made.close()


class _Guarded:
    """An iterator that one thread at a time uses.

    A signal in the moment in which a pool starts its thread leaves it with a second one.
    """

    def __init__(self, items: Iterator[object]) -> None:
        self._items = items
        self._lock = Lock()
        self._closed = False

    def next(self) -> object:
        """The next item, or the end."""
        with self._lock:
            return _END if self._closed else next(self._items, _END)

    def close(self) -> None:
        """Close the iterator, once nobody uses it."""
        close: Callable[[], None] | None = getattr(self._items, "close", None)
        with self._lock:
            self._closed = True
            if close is not None:
                close()


"""Portions that may wait to be written; each holds memory."""


class Behind:
    """A binary file, open for writing, whose portions a thread of its own hands to the system.

    Copying three hundred megabytes to the system's cache takes half a second and more, in which the
    thread that makes them can go on.
    """

    def __init__(self, file: BinaryIO) -> None:
        """Take over a file; it is closed with this one."""
        self._file = file
        self._taken = 0
        self._waiting: deque[Future[int]] = deque()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="behind")

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._file.closed

    def tell(self) -> int:
        """Bytes that were taken so far."""
        return self._taken

    def write(self, data: bytes) -> int:
        """Take bytes, to be written later.

        Raises:
            OSError: some that were taken before could not be written.
        """
        self._settle(DEPTH - 1)
        self._waiting.append(self._thread.submit(self._file.write, bytes(data)))
        self._taken += len(data)
        return len(data)

    def flush(self) -> None:
        """Wait until the system has all bytes; raises OSError if some could not be written."""
        self._settle(0)
        self._file.flush()

    def _settle(self, most: int) -> None:
        while len(self._waiting) > most:
            self._waiting.popleft().result()

    def close(self) -> None:
        """Write what is left, and close the file even if that fails; raises OSError."""
        try:
            self._settle(0)
        finally:
            self._thread.shutdown()
            self._file.close()


R = TypeVar("R")
MOST_THREADS = 4
"""The one that takes the items keeps no more of them busy; each holds memory."""

AHEAD = 2
"""Items that wait for a thread, so that none of them waits for an item."""


def side_by_side(work: Callable[[T], R], items: Iterable[T], threads: int) -> Iterator[R]:
    """The work's results, in the order of the items; items are taken ahead while work is done.

    What taking an item or working on it raises is raised here, in its place. Items are taken on the
    caller's thread.

    Args:
        threads: how many may work at a time; with one, each item is taken when its result is asked for.
    """
    if threads < 2:
        yield from map(work, items)
        return
    threads = min(threads, MOST_THREADS)
    with ThreadPoolExecutor(threads, thread_name_prefix="side-by-side") as pool:
        begun = _begun(work, items, pool)
        waiting = deque(islice(begun, threads + AHEAD - 1))
        try:
            while waiting:
                waiting.extend(islice(begun, 1))
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _begun(work: Callable[[T], R], items: Iterable[T], pool: ThreadPoolExecutor) -> Iterator[Future[R]]:
    """The work on each item; where taking one fails, that failure in its place."""
    try:
        for item in items:
            yield pool.submit(work, item)
    except Exception as error:
        failed: Future[R] = Future()
        failed.set_exception(error)
        yield failed
