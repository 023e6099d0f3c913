"""Work on several things at a time, whose results come in the order of the things."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

T = TypeVar("T")
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
