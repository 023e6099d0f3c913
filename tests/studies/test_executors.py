"""Executors of `concurrent.futures` that do a study's tasks: the bits of the own pool, whatever happens."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import accelcal
from accelcal_cli.core.errors import ClusterError, OutputError, UsageError
from accelcal_cli.core.system import host
from accelcal_cli.output.files import sweep_left
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.studies import executors
from accelcal_cli.studies.discovery import Where, files
from accelcal_cli.studies.executors import RemoteWork, check_worker, done_by, named_executor, work_for
from accelcal_cli.studies.study import Study
from accelcal_cli.studies.task import CalibrationTask, Common
from tests.cli.studies import results, study_folder, study_in

NAMES = ("a/p0.raw", "b/p1.raw")
LOST = "its worker was lost, perhaps for lack of memory"


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two good recordings and a damaged one in `in`."""
    here = tmp_path_factory.mktemp("study")
    (study_folder(here / "in", NAMES) / "zeros.cwa").write_bytes(bytes(4096))
    return here


@pytest.fixture(scope="module")
def own_pool(here: Path) -> dict[str, object]:
    """The outputs of the study's own worker processes."""
    assert study_in(here, out="own").code == 1
    return results(here / "own")


@pytest.fixture
def work(tmp_path: Path) -> RemoteWork:
    (tmp_path / "out").mkdir()
    return work_for(Study(Where((tmp_path,), tmp_path / "out"), Request()))


def processes_elsewhere(folder: Path) -> Executor:
    """Processes in another folder than the program."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(2, context, initializer=os.chdir, initargs=(folder,))


class Unreliable(ThreadPoolExecutor):
    """Loses the first workers of each task in one of three ways, or is broken from the beginning."""

    def __init__(self, losses: int, *, broken: bool = False) -> None:
        super().__init__(2)
        self.losses, self.broken = losses, broken
        self.submitted: list[str] = []

    def submit(self, fn: Any, /, *words: Any, **named: Any) -> Future[Any]:
        if self.broken:
            raise BrokenProcessPool("gone")
        task = words[0]
        self.submitted.append(task.item.name)
        if self.submitted.count(task.item.name) > self.losses:
            return super().submit(fn, *words, **named)
        future: Future[Any] = Future()
        if task.item.name == NAMES[0]:
            future.cancel()
        else:
            future.set_exception(BrokenProcessPool("gone"))
        return future


@pytest.mark.parametrize(
    "make", [lambda _: ThreadPoolExecutor(2), processes_elsewhere, lambda _: Unreliable(1)]
)
def test_the_bytes_are_those_of_the_own_pool(
    make: Callable[[Path], Executor],
    here: Path,
    own_pool: dict[str, object],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(here)
    out = Path(tmp_path.name)
    with make(tmp_path) as executor:
        accelcal.study("in", out, executor=executor)
    assert results(here / out) == own_pool


@pytest.mark.parametrize("broken", [False, True])
def test_what_is_lost_again_and_again_fails_and_is_tried_by_the_next_run(
    broken: bool, here: Path, own_pool: dict[str, object], tmp_path: Path
) -> None:
    with Unreliable(2, broken=broken) as executor:
        table = accelcal.study(here / "in", tmp_path / "out", executor=executor)
    assert table["outcome"].tolist() == ["failed"] * 3
    assert set(table["message"]) == {LOST}
    assert len(executor.submitted) == (0 if broken else 6)
    assert sorted(accelcal.study(here / "in", tmp_path / "out")["outcome"]) == ["calibrated"] * 2 + ["failed"]


def test_what_takes_too_long_is_ended(here: Path, tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as executor:
        table = accelcal.study(
            here / "in", tmp_path / "out", include=["*.raw"], executor=executor, timeout=1e-9
        )
    assert set(table["message"]) == {"took more than 1e-09 minutes and was stopped"}
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_worker_with_another_build_ends_the_study(here: Path, tmp_path: Path) -> None:
    class Other(ThreadPoolExecutor):
        def submit(self, fn: Any, /, *words: Any, **named: Any) -> Future[Any]:
            return super().submit(replace(fn, build="0.0.9 (code 12ab)"), *words, **named)

    with Other(1) as executor, pytest.raises(ClusterError, match=r"not 0\.0\.9 \(code 12ab\); install the"):
        accelcal.study(here / "in", tmp_path / "out", executor=executor)
    assert not [path for path in (tmp_path / "out").rglob("*") if path.suffix in (".tmp", ".lock")]


def test_a_worker_must_see_the_folders_and_may_write(
    work: RemoteWork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executors, "PATIENCE_S", 0.0)
    check_worker(work)
    assert list(work.mark.parent.iterdir()) == [work.mark]
    for wrong in (replace(work, folders=(tmp_path / "x",)), replace(work, mark=tmp_path / "x/y")):
        with pytest.raises(ClusterError, match=f"{tmp_path}/x: the worker on .* cannot see it; its machine"):
            check_worker(wrong)
    if not (system := Path("/proc/version")).exists():
        pytest.skip("needs /proc")
    with pytest.raises(OutputError, match=r"/proc: the worker on .*; give its user permission"):
        check_worker(replace(work, mark=system))


def test_given_up_nothing_is_left_running(here: Path, work: RemoteWork, tmp_path: Path) -> None:
    """The first task is done, the second one ends as soon as it looks whether the study still waits."""
    out = work.mark.parent
    items = files(Where((here / "in",), out, include=("*.raw",)), [])
    tasks = [CalibrationTask(item, Common(out, Request(), "")) for item in items]
    with ThreadPoolExecutor(1) as executor:
        running = done_by(executor, work, tasks, lambda _task, _part: None)
        assert next(running).fault is None
        running.close()
        assert executor.submit(os.getpid).result() == os.getpid()
    assert [path.name for path in out.rglob("*.calibration.json")] == ["p0.calibration.json"]
    assert not list(out.rglob("*.tmp"))
    assert work(tasks[1], 1) == "the study no longer waited for it"


def test_an_executor_is_named_on_the_command_line(here: Path, own_pool: dict[str, object]) -> None:
    named = study_in(here, "--executor", "concurrent.futures:ThreadPoolExecutor", out="named")
    assert (named.code, results(here / "named")) == (1, own_pool)
    both = study_in(here, "--executor", "a:b", "--dask", "tcp://host:1", out="both")
    assert (both.code, "give one of them" in both.err) == (2, True)


@pytest.mark.parametrize("name", ["no_such_module:x", "os:no_such", "os", ":x", "os:name", "os:getcwd"])
def test_what_gives_no_executor_is_said(name: str) -> None:
    with pytest.raises(UsageError, match=f"--executor {name} returns no executor"), named_executor(name):
        pass


def test_what_lost_processes_left_is_removed_and_no_more(tmp_path: Path) -> None:
    """Those of other machines, and of a process of this one that is gone."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    lost = [f".a.parquet.{one}.ff.tmp" for one in ("there.12", "node.b.org.12", f"{host()}.{gone.pid}")]
    kept = [".b.parquet.there.12.ff.tmp", f".a.parquet.{host()}.{os.getpid()}.ff.tmp", ".a.parquet.tmp"]
    for name in (*lost, *kept):
        (tmp_path / name).touch()
    sweep_left([tmp_path / "a.parquet", tmp_path / "none/c.parquet"])
    assert {path.name for path in tmp_path.iterdir()} == set(kept)
