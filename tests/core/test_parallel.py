"""Threads change nothing but the time it takes: order, errors and bytes are those of one thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from accelcal_cli.core.parallel import (
    DEPTH,
    MOST_THREADS,
    QUEUED,
    BackgroundCalls,
    background_result,
    parallel_map,
    prefetch,
    thread_pool,
)

# --- prefetch


@pytest.mark.parametrize("number", [0, 1, 2, 3, 50])
@pytest.mark.parametrize("depth", [1, 2, 5])
@pytest.mark.parametrize("threads", [1, 2])
def test_all_items_come_in_their_order(number: int, depth: int, threads: int) -> None:
    assert list(prefetch(iter(range(number)), threads, depth)) == list(range(number))


def test_with_one_thread_nothing_is_made_before_it_is_asked_for() -> None:
    made: list[int] = []

    def items() -> Iterator[int]:
        for number in range(5):
            assert threading.current_thread() is threading.main_thread()
            made.append(number)
            yield number

    for number in prefetch(items(), 1):
        assert made == list(range(number + 1))


def test_items_are_made_on_another_thread_and_no_more_than_asked_for() -> None:
    made: list[int] = []

    def items() -> Iterator[int]:
        for number in range(10):
            assert threading.current_thread() is not threading.main_thread()
            made.append(number)
            yield number

    for number in prefetch(items(), 2, 2):
        assert len(made) <= number + 4
    assert made == list(range(10))


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_comes_where_the_item_would_have_come(threads: int) -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("broken")

    running = prefetch(items(), threads)
    assert next(running) == 1
    with pytest.raises(ValueError, match="broken"):
        next(running)


@pytest.mark.parametrize("threads", [1, 2])
def test_leaving_early_closes_the_iterator(threads: int) -> None:
    closed = threading.Event()

    def items() -> Iterator[int]:
        try:
            yield from range(1000)
        finally:
            closed.set()

    running = prefetch(items(), threads)
    next(running)
    running.close()
    assert closed.is_set()
    assert not any(thread.name.startswith("prefetch") for thread in threading.enumerate())


# --- parallel_map


@pytest.mark.parametrize("threads", [1, 2, 9])
@pytest.mark.parametrize("number", [0, 1, 3, 40])
def test_results_come_in_the_order_of_the_items(threads: int, number: int) -> None:
    def work(item: int) -> int:
        time.sleep(0.002 * (item % 3 == 0))
        return 10 * item

    assert list(parallel_map(work, range(number), threads)) == [10 * item for item in range(number)]


def test_several_items_are_worked_on_at_a_time() -> None:
    both = threading.Barrier(2, timeout=20)
    assert list(parallel_map(lambda _: both.wait() >= 0, range(4), 2)) == [True] * 4


def test_with_one_thread_nothing_is_taken_before_it_is_asked_for() -> None:
    taken: list[int] = []
    for number in parallel_map(lambda item: item, (taken.append(n) or n for n in range(5)), 1):
        assert taken == list(range(number + 1))


def test_few_items_are_taken_ahead() -> None:
    taken: list[int] = []
    for number in parallel_map(lambda item: item, (taken.append(n) or n for n in range(50)), 99):
        assert len(taken) <= number + 1 + MOST_THREADS + QUEUED


@pytest.mark.parametrize("most", [1, 2, 3, 99])
def test_no_more_items_are_in_work_than_are_wanted(most: int) -> None:
    taken: list[int] = []
    for number in parallel_map(lambda item: item, (taken.append(n) or n for n in range(50)), 9, most):
        assert len(taken) <= number + most


@pytest.mark.parametrize("threads", [1, 3])
def test_the_first_failure_counts_wherever_it_happened(threads: int) -> None:
    def items() -> Iterator[int]:
        yield from range(4)
        raise KeyError("no more")

    def work(item: int) -> int:
        return 1 // (3 - item)

    running = parallel_map(work, items(), threads)
    assert [next(running) for _ in range(3)] == [0, 0, 1]
    with pytest.raises(ZeroDivisionError):
        next(running)
    running = parallel_map(lambda item: item, items(), threads)
    assert [next(running) for _ in range(4)] == [0, 1, 2, 3]
    with pytest.raises(KeyError, match="no more"):
        next(running)


def test_leaving_early_ends_the_threads() -> None:
    running = parallel_map(lambda item: item, range(1000), 2)
    next(running)
    running.close()
    assert not any(thread.name.startswith("parallel-map") for thread in threading.enumerate())


# --- BackgroundCalls, thread_pool


def test_background_calls_are_made_in_their_order_on_one_thread() -> None:
    calls, threads, numbers = BackgroundCalls("encoder"), set(), []

    def note(number: int) -> None:
        threads.add(threading.current_thread().name)
        numbers.append(number)

    for number in range(50):
        calls.wait(DEPTH)
        calls.submit(note, number)
    calls.wait()
    calls.close()
    assert numbers == list(range(50))
    assert len(threads) == 1 and threads.pop().startswith("encoder")


def test_a_background_call_that_failed_raises_where_it_is_waited_for() -> None:
    calls = BackgroundCalls("encoder")
    calls.submit(int, "x")
    with pytest.raises(ValueError, match="invalid literal"):
        calls.wait()
    calls.close()


@pytest.mark.parametrize("long", [True, False])
def test_a_long_call_is_made_while_the_block_goes_on_and_a_short_one_when_it_is_needed(long: bool) -> None:
    begun = threading.Event()
    with background_result(begun.set, long=long) as result:
        assert begun.wait(20 if long else 0) == long
        assert result() is None and begun.is_set()
    with (
        pytest.raises(ValueError, match="invalid literal"),
        background_result(lambda: int("x"), long=long) as number,
    ):
        number()


def test_where_one_thread_may_work_there_is_no_pool() -> None:
    with thread_pool(1, "a") as pool:
        assert pool is None
    with thread_pool(2, "a") as pool:
        assert pool is not None and list(pool.map(int, "12")) == [1, 2]
