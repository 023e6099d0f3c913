"""The pool of `studies/executors.py`: the failure of one worker affects only its task."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from accelcal_cli.studies import executors
from accelcal_cli.studies.executors import ProcessPool
from accelcal_cli.studies.records import Finished, ProgressCallback
from tests.studies.processes import Clock, soon


def work(task: tuple[str, Any], told: ProgressCallback) -> Any:
    """Does what the task says."""
    kind, value = task
    if kind == "kill":
        os.kill(os.getpid(), value)
        signal.pause()
    if kind == "leave":
        os._exit(value)
    if kind == "part":
        told(value)
    if kind == "hang":
        told(value)
        signal.pause()
    if kind == "orphan":
        Path(value).write_text(str(os.getpid()))
        signal.pause()
    return os.getpid() if kind == "pid" else (kind, value)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(executors, "time", clock)
    return clock


def done(pool: ProcessPool, *tasks: tuple[str, Any]) -> dict[tuple[str, Any], Finished]:
    return {ended.task: ended for ended in pool.run(list(tasks))}


def test_a_killed_worker_costs_its_task_alone() -> None:
    tasks = [("echo", 1), ("kill", signal.SIGKILL), ("echo", 2), ("leave", 3), ("echo", 4)]
    found = done(ProcessPool(work, 2), *tasks)
    assert set(found) == set(tasks)
    assert [found["echo", n].result for n in (1, 2, 4)] == [("echo", 1), ("echo", 2), ("echo", 4)]
    killed, left = found["kill", signal.SIGKILL], found["leave", 3]
    assert (
        killed.fault is not None and "SIGKILL" in killed.fault and "memory" in killed.fault and killed.retry
    )
    assert left.fault == "its process ended unexpectedly (code 3)" and not left.retry


@pytest.mark.parametrize(("number", "again"), [(signal.SIGTERM, True), (signal.SIGSEGV, False)])
def test_the_signal_is_named(number: signal.Signals, again: bool) -> None:
    ended = done(ProcessPool(work, 1), ("kill", number))["kill", number]
    assert ended.fault == f"its process was ended by {number.name}"
    assert ended.retry == again


def test_a_task_that_takes_too_long_is_ended_and_the_next_is_done(clock: Clock) -> None:
    """An hour passes once the task has begun."""
    pool = ProcessPool(
        work, 1, timeout_s=90.0, on_progress=lambda _task, part: clock.pass_(3600.0 * (part == 0.5))
    )
    found = done(pool, ("hang", 0.5), ("echo", 1))
    assert found["hang", 0.5].fault == "took more than 1.5 minutes and was stopped"
    assert found["echo", 1].result == ("echo", 1)


def test_workers_are_used_again() -> None:
    found = done(ProcessPool(work, 1), *[("pid", number) for number in range(4)])
    assert len({ended.result for ended in found.values()}) == 1


def test_the_parts_of_a_task_end_with_one() -> None:
    moved: list[float] = []
    pool = ProcessPool(work, 1, on_progress=lambda _task, part: moved.append(part))
    done(pool, ("part", 0.25))
    assert moved == [0.0, 0.25, 1.0]


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
def test_no_worker_is_left_when_the_iteration_is_given_up(tmp_path: Path) -> None:
    told = tmp_path / "pid"
    running = ProcessPool(work, 2).run([("orphan", str(told)), ("echo", 1)])
    next(running)
    soon(lambda: told.exists() and told.read_text())
    running.close()
    assert not Path(f"/proc/{told.read_text()}").exists()


ALONE = """
import sys
from accelcal_cli.studies.executors import ProcessPool
from tests.studies.test_process_pool import work
if __name__ == "__main__":
    list(ProcessPool(work, 1).run([("orphan", sys.argv[1])]))
"""


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
def test_a_worker_does_not_outlive_the_process_that_started_it(tmp_path: Path) -> None:
    told, script = tmp_path / "pid", tmp_path / "alone.py"
    script.write_text(ALONE)
    path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    parent = subprocess.Popen([sys.executable, script, told], env={**os.environ, "PYTHONPATH": path})
    soon(lambda: told.exists() and told.read_text())
    parent.kill()
    parent.wait()
    soon(lambda: not Path(f"/proc/{told.read_text()}").exists())
