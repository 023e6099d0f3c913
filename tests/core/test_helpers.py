"""Helpers give their results in order, and losing one costs nothing but time."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from typing import Any

import pytest

from accelcal_cli.core import helpers as module
from accelcal_cli.core.helpers import helpers, shared_memory

linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux forks helpers")


def found(name: str, code: int = 0) -> Any:
    """What a program of `helping.py` found; its output ends when its last process has."""
    words = [sys.executable, "-W", "error", "-m", "tests.core.helping", name]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (code, "")
    return json.loads(done.stdout)


def by(caller: bool, jobs: int) -> list[list[Any]]:
    return [[10 * job, caller] for job in range(jobs)]


@linux
def test_helpers_are_processes_of_their_own_that_end_with_the_block() -> None:
    assert found("several") == {"found": [by(False, 4)] * 3, "processes": 3, "left": 0}


@linux
def test_a_process_that_is_another_programs_is_not_forked() -> None:
    assert found("guest") == {"found": [by(True, 4)] * 3, "processes": 0, "left": 0}


@linux
def test_memory_is_shared_in_both_directions() -> None:
    assert found("memory") == [[42], 42, [100], 100]


@linux
def test_what_the_work_raises_is_raised_in_the_caller() -> None:
    """And what only the helper had no memory for, the caller does."""
    assert found("fails") == [0, "no memory for 1", 2, 3, 4]


@linux
def test_a_helper_that_is_killed_costs_no_result() -> None:
    assert found("killed") == [[0, 10, 20, 30]] * 5


@linux
def test_where_no_process_can_be_had_a_thread_helps() -> None:
    """And nothing of the attempt stays."""
    assert found("refused") == [[by(True, 3)] * 2, 0]


@linux
def test_beside_a_thread_nothing_is_forked() -> None:
    assert found("threaded") == [False, by(True, 2), True]


@linux
def test_signals_are_left_to_the_caller() -> None:
    assert found("interrupted") == by(False, 3)


@linux
def test_leaving_early_ends_helpers_that_are_at_work() -> None:
    assert found("left_early") == [2, [False, False]]


@linux
def test_a_helper_that_is_cut_off_writes_no_more() -> None:
    assert found("cut_off") == [[], True, True, 0, 1, 0]


@linux
def test_a_second_interruption_does_not_keep_the_command_from_ending() -> None:
    assert found("interrupted_twice") == [1, 1]


@linux
def test_a_long_call_is_made_by_a_process_beside_the_block_and_a_short_one_by_the_caller() -> None:
    assert found("beside_a_block") == [1, 40, False, 0, 50, True]


@linux
def test_helpers_end_with_a_caller_that_is_killed() -> None:
    assert found("orphaned", -9) == [by(False, 1)] * 2


def test_threads_give_results_in_order_and_end_with_the_block(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "can_be_forked", lambda: False)
    with helpers(lambda job: (job, threading.current_thread().name), 2) as helping:
        for job in range(4):
            helping[job % 2].give(job)
        assert [one.waiting for one in helping] == [2, 2]
        taken = [helping[job % 2].take() for job in range(4)]
    assert [job for job, _ in taken] == [0, 1, 2, 3]
    assert all(name.startswith("helper") for _, name in taken)
    assert not any(thread.name.startswith("helper") for thread in threading.enumerate())


def test_memory_that_is_not_there_is_told() -> None:
    with pytest.raises(MemoryError):
        shared_memory(1 << 60)
