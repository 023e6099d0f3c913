"""Work ahead: one room fills chunks while the next one uses those before."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar, cast

T = TypeVar("T")
DEPTH = 2
"""Items in flight; each holds memory."""

_END = object()


def ahead(items: Iterator[T], depth: int = DEPTH) -> Iterator[T]:
    """The items of an iterator, in order, up to `depth` of them made ahead on another thread.

    What the iterator raises is raised here, in its place. Closing this closes the iterator.
    """
    with ThreadPoolExecutor(1, thread_name_prefix="ahead") as thread:
        waiting: deque[Future[object]] = deque()
        try:
            for _ in range(depth):
                waiting.append(thread.submit(next, items, _END))
            while (item := waiting.popleft().result()) is not _END:
                waiting.append(thread.submit(next, items, _END))
                yield cast(T, item)
        finally:
            for future in waiting:
                future.cancel()
            thread.submit(_close, items).result()


def _close(items: Iterator[T]) -> None:
    close: Callable[[], None] | None = getattr(items, "close", None)
    if close is not None:
        close()
