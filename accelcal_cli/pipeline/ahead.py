"""Work ahead: one room fills chunks while the next one uses those before."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Lock
from typing import TypeVar, cast

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
