"""Working ahead changes nothing but the time it takes."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from accelcal_cli.core.parallel import ahead


@pytest.mark.parametrize("number", [0, 1, 2, 3, 50])
@pytest.mark.parametrize("depth", [1, 2, 5])
@pytest.mark.parametrize("threads", [1, 2])
def test_all_items_come_in_their_order(number: int, depth: int, threads: int) -> None:
    assert list(ahead(iter(range(number)), threads, depth)) == list(range(number))


def test_with_one_thread_nothing_is_made_before_it_is_asked_for() -> None:
    made: list[int] = []

    def items() -> Iterator[int]:
        for number in range(5):
            assert threading.current_thread() is threading.main_thread()
            made.append(number)
            yield number

    for number in ahead(items(), 1):
        assert made == list(range(number + 1))


def test_items_are_made_on_another_thread_and_no_more_than_asked_for() -> None:
    made: list[int] = []

    def items() -> Iterator[int]:
        for number in range(10):
            assert threading.current_thread() is not threading.main_thread()
            made.append(number)
            yield number

    for number in ahead(items(), 2, 2):
        assert len(made) <= number + 4
    assert made == list(range(10))


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_comes_where_the_item_would_have_come(threads: int) -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("broken")

    running = ahead(items(), threads)
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

    running = ahead(items(), threads)
    next(running)
    running.close()
    assert closed.is_set()
    assert not any(thread.name.startswith("ahead") for thread in threading.enumerate())
