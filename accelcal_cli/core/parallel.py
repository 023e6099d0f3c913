"""The one place where threads are started.

`prefetch` takes the items of an iterator ahead of their use, `parallel_map` works on several items at a time,
`BackgroundCalls` makes calls one after another, and `thread_pool` is there for what fits none of them.
Results come in the order of the items, whatever the number of threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from itertools import islice, repeat
from threading import Lock
from typing import Any, TypeVar, cast

T = TypeVar("T")
R = TypeVar("R")

DEPTH = 2
"""Items that `prefetch` takes ahead; each holds memory."""

MOST_THREADS = 4
"""Most threads of `parallel_map`: the one that takes the items keeps no more of them busy."""

QUEUED = 2
"""Items that wait for a thread of `parallel_map`, so that no thread waits for an item."""

_END = object()


def thread_pool(threads: int, name: str) -> AbstractContextManager[Executor | None]:
    """Return a pool of named threads; None if only one thread may work."""
    return nullcontext() if threads < 2 else ThreadPoolExecutor(threads, thread_name_prefix=name)


def prefetch(items: Iterator[T], threads: int, depth: int = DEPTH) -> Generator[T]:
    """Yield the items of an iterator, in order, with up to `depth` of them taken ahead on another thread.

    What the iterator raises is raised here, in its place. Closing this closes the iterator.

    Args:
        threads: how many may work at a time; with one, nothing is taken ahead.
    """
    if threads < 2:
        yield from items
        return
    source = _Guarded(items)
    with ThreadPoolExecutor(1, thread_name_prefix="prefetch") as thread:
        waiting: deque[Future[object]] = deque()
        try:
            for _ in range(depth):
                waiting.append(thread.submit(source.next))
            while (item := waiting.popleft().result()) is not _END:
                waiting.append(thread.submit(source.next))
                yield cast(T, item)
        finally:
            for future in waiting:
                future.cancel()
            source.close()


class _Guarded:
    """An iterator that one thread at a time uses.

    A signal that arrives while a pool starts its thread leaves the pool with a second one.
    """

    def __init__(self, items: Iterator[object]) -> None:
        self._items = items
        self._lock = Lock()
        self._closed = False

    def next(self) -> object:
        """Return the next item, _END if there is none."""
        with self._lock:
            return _END if self._closed else next(self._items, _END)

    def close(self) -> None:
        """Close the iterator, once nobody uses it."""
        close: Callable[[], None] | None = getattr(self._items, "close", None)
        with self._lock:
            self._closed = True
            if close is not None:
                close()


def parallel_map(
    work: Callable[[T], R], items: Iterable[T], threads: int, most: int = MOST_THREADS + QUEUED
) -> Generator[R]:
    """Yield the work's results, in the order of the items, which are taken ahead while work is done.

    What taking an item or working on it raises is raised here, in its place. Items are taken on the
    caller's thread.

    Args:
        threads: how many may work at a time; with one, each item is taken when its result is asked for.
        most: items at most that are worked on, or wait for it or for their result to be used.
    """
    if threads < 2:
        yield from map(work, items)
        return
    threads = min(threads, most, MOST_THREADS)
    with ThreadPoolExecutor(threads, thread_name_prefix="parallel-map") as pool:
        submitted: Iterator[Future[R]] = map(pool.submit, repeat(work), items)
        waiting: deque[Future[R]] = deque()
        failure: Exception | None = None
        try:
            while True:
                try:
                    waiting.extend(islice(submitted, min(threads + QUEUED, most) - len(waiting)))
                except Exception as error:  # of taking an item, whose turn has not come yet
                    failure, submitted = error, iter(())
                if not waiting:
                    break
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
    if failure is not None:
        raise failure


class BackgroundCalls:
    """A thread that makes calls one after another; it starts with the first."""

    def __init__(self, name: str) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._waiting: deque[Future[Any]] = deque()

    def submit(self, call: Callable[..., Any], *arguments: Any) -> None:
        """Give a call to be made later."""
        self._waiting.append(self._thread.submit(call, *arguments))

    def wait(self, most: int = 0) -> None:
        """Wait until at most `most` calls are left; raises what one of the others raised."""
        while len(self._waiting) > most:
            self._waiting.popleft().result()

    def close(self) -> None:
        """End the thread, once all calls are made."""
        self._thread.shutdown()


@contextmanager
def background_result(call: Callable[[], R], *, long: bool) -> Iterator[Callable[[], R]]:
    """Make a call on a thread of its own, if it takes long, while the block continues.

    Yields:
        a function that waits for the result of the call; raises what it raised.
    """
    if not long:
        yield call
        return
    with ThreadPoolExecutor(1, thread_name_prefix="background") as thread:
        yield thread.submit(call).result
