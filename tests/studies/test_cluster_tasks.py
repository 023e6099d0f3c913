"""The executor on a real scheduler, with work that misbehaves."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import accelcal_cli
from accelcal_cli.core.errors import ClusterError, OutputError, UsageError
from accelcal_cli.studies import cluster
from accelcal_cli.studies.cluster import Cluster, WorkerRequirements, code, connected
from accelcal_cli.studies.records import Finished, ProgressCallback
from tests.studies.processes import Clock

pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.xdist_group("cluster"),
    pytest.mark.skipif(os.name != "posix", reason="kills processes"),
]


def work(task: tuple[str, Any], told: ProgressCallback) -> Any:
    """Does what the task says."""
    kind, value = task
    if kind == "kill":
        Path(value).unlink(missing_ok=True)
        told(0.5)
        while not Path(value).exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "parts":
        told(0.25)
    while kind == "hang":
        time.sleep(0.01)
        told(value)
    if kind == "where":
        return os.getpid(), threading.current_thread() is threading.main_thread()
    return kind, value


class UnknownError(Exception):
    """What the other side cannot make."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (__import__, ("no_such_module_anywhere",))


@pytest.fixture
def requirements(tmp_path: Path) -> WorkerRequirements:
    mark = tmp_path / "study.lock"
    mark.write_text("this study's")
    return WorkerRequirements(
        accelcal_cli.__version__, code(), (tmp_path,), mark, "this study's", patience_s=0
    )


def done(executor: Cluster, *tasks: tuple[str, Any]) -> dict[tuple[str, Any], Finished]:
    return {ended.task: ended for ended in executor.run(list(tasks))}


def test_a_task_that_kills_its_workers_fails_alone(
    scheduler: Path, requirements: WorkerRequirements, tmp_path: Path
) -> None:
    """Two tries, as the scheduler of these tests allows; those that waited behind it are done.

    Each ends once it is known to have begun, and so all that its worker did before.
    """
    known, kill = tmp_path / "known", ("kill", str(tmp_path / "known"))
    lost: list[Any] = []
    executor = Cluster(
        str(scheduler),
        work,
        requirements,
        limit=6,
        on_progress=lambda task, _part: known.touch() if task == kill else None,
        lost=lambda task, _owner: lost.append(task),
    )
    others = [("echo", number) for number in range(8)]
    found = done(executor, kill, *others)
    assert [found[one].result for one in others] == others
    killed = found[kill]
    assert killed.fault == "every worker that tried it was lost, perhaps for lack of memory"
    assert killed.retry
    assert set(lost) == {kill}


def test_the_parts_of_a_task_add_up_to_one(scheduler: Path, requirements: WorkerRequirements) -> None:
    moved: list[float] = []
    executor = Cluster(str(scheduler), work, requirements, on_progress=lambda _task, part: moved.append(part))
    done(executor, ("parts", 1))
    assert moved == [0.25, 0.75]


def test_it_runs_beside_others_in_a_thread(scheduler: Path, requirements: WorkerRequirements) -> None:
    found = done(Cluster(str(scheduler), work, requirements), *[("where", number) for number in range(8)])
    assert {ended.result[1] for ended in found.values()} == {False}
    assert os.getpid() not in {ended.result[0] for ended in found.values()}


def test_what_takes_too_long_is_ended_and_the_next_is_done(
    scheduler: Path, requirements: WorkerRequirements, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An hour passes once the task has begun."""
    clock = Clock()
    monkeypatch.setattr(cluster, "time", clock)
    executor = Cluster(str(scheduler), work, requirements, limit=1, timeout_s=90.0)
    executor.on_progress = lambda _task, part: clock.pass_(3600.0 * (part == 0.5))
    found = done(executor, ("hang", 0.5), ("echo", 1))
    assert found["hang", 0.5].fault == "took more than 1.5 minutes and was stopped"
    assert found["echo", 1].result == ("echo", 1)


def test_a_worker_that_does_not_meet_the_terms_ends_the_study(
    scheduler: Path, requirements: WorkerRequirements
) -> None:
    other = requirements.mark.with_name("other")
    for wrong, kind, said in (
        (replace(requirements, version="0.0.9"), ClusterError, "not 0.0.9; install the same version"),
        (replace(requirements, content="another's"), ClusterError, "cannot see it; the cluster must share"),
        (replace(requirements, folders=(other,)), ClusterError, f"{other}: the worker on"),
    ):
        with pytest.raises(kind, match=said) as raised:
            done(Cluster(str(scheduler), work, wrong), ("echo", 1))
        assert not isinstance(raised.value, OutputError)


def test_what_cannot_be_taken_up_ends_the_study(scheduler: Path, requirements: WorkerRequirements) -> None:
    with pytest.raises(ClusterError, match=r"no_such_module_anywhere.*install the same accelcal"):
        done(Cluster(str(scheduler), work, requirements), ("echo", UnknownError()))


def test_no_task_needs_no_scheduler(requirements: WorkerRequirements) -> None:
    assert done(Cluster("tcp://127.0.0.1:9", work, requirements)) == {}


def test_an_address_that_is_none(tmp_path: Path) -> None:
    import dask

    with dask.config.set({"distributed.comm.timeouts.connect": "200ms"}):
        with (
            pytest.raises(UsageError, match="'nonsense://x' is not an address"),
            connected("nonsense://x", print),
        ):
            pass
        with pytest.raises(UsageError, match="'' is not an address"), connected("", print):
            pass
        missing = str(tmp_path / "none.json")
        with pytest.raises(ClusterError, match="no scheduler has written"), connected(missing, print):
            pass


def test_another_version_of_the_scheduler_is_refused(
    scheduler: Path, requirements: WorkerRequirements, monkeypatch: pytest.MonkeyPatch
) -> None:
    import distributed

    monkeypatch.setattr(distributed, "__version__", "2020.1.0")
    with pytest.raises(
        ClusterError, match=r"has distributed 20.*, this machine has 2020\.1\.0; install the same"
    ):
        done(Cluster(str(scheduler), work, requirements), ("echo", 1))


def test_other_versions_of_other_libraries_are_said(
    scheduler: Path, requirements: WorkerRequirements, monkeypatch: pytest.MonkeyPatch
) -> None:
    from distributed import versions

    have, said = versions.get_versions(), list[str]()
    other = {**have, "packages": {**have["packages"], "python": "3.1.4.final.0"}}
    monkeypatch.setattr(versions, "get_versions", lambda *_names: other)
    found = done(Cluster(str(scheduler), work, requirements, notify=said.append), ("echo", 1))
    assert found["echo", 1].result == ("echo", 1)
    assert [line for line in said if "versions on the cluster (Python, dask, numpy or others) differ" in line]
