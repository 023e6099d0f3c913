"""`accelcal study --dask` on a real scheduler and two workers."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.cli.run import Ran, assert_one_line, command, nightly
from tests.cli.studies import results, study_folder
from tests.recordings import directions, still_counts, write_raw
from tests.studies.clusters import QUICK, cluster, endless, start_workers
from tests.studies.processes import soon

pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.xdist_group("cluster"),
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc"),
]
NAMES = ("a/p0.raw", "b/p1.raw")
LONG = "long.raw"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Good recordings, a long one, and a damaged one."""
    found = study_folder(tmp_path_factory.mktemp("study") / "in", NAMES)
    write_raw(found / LONG, still_counts(directions(80)))
    (found / "zeros.cwa").write_bytes(bytes(4096))
    return found


@pytest.fixture(scope="module")
def undisturbed(folder: Path) -> dict[str, object]:
    assert ran(folder.parent, "in", "-d", "one", "-j", 1).code == 1
    return results(folder.parent / "one")


def begun(here: Path, *words: object, **environment: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        command("study", *words),
        cwd=here,
        env={**os.environ, **QUICK, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def ended(process: subprocess.Popen[bytes]) -> Ran:
    out, said = process.communicate()
    return Ran(process.returncode, out.decode(), said.decode())


def ran(here: Path, *words: object, **environment: str) -> Ran:
    return ended(begun(here, *words, **environment))


def test_the_bytes_are_the_same(scheduler: Path, folder: Path, undisturbed: dict[str, object]) -> None:
    done = ran(folder.parent, "in", "-d", "two", "--dask", scheduler)
    assert done.code == 1
    assert "4 recordings: 3 calibrated, 1 failed" in done.err
    assert sorted(line.split("\t")[0] for line in done.lines) == sorted(
        f"in/{name}" for name in (*NAMES, LONG, "zeros.cwa")
    )
    assert results(folder.parent / "two") == undisturbed
    again = ran(folder.parent, "in", "-d", "two", "--dask", "127.0.0.1:9")
    assert (again.code, "4 unchanged" in again.err) == (1, True)


@pytest.mark.nightly
def test_a_worker_that_is_killed_is_made_good_elsewhere(
    scheduler: Path, folder: Path, undisturbed: dict[str, object], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with endless(scheduler) as work:
        process = begun(folder.parent, "in", "-d", out, "--dask", scheduler)
        worker = work.worker()
        assert worker != process.pid
        work.end()
        os.kill(worker, signal.SIGKILL)
    assert ended(process).code == 1
    assert results(out) == undisturbed
    assert not list(out.rglob("*.tmp"))


@pytest.mark.parametrize("number", [signal.SIGTERM, nightly(signal.SIGINT)])
def test_interrupted_it_leaves_nothing_running_and_nothing_half_written(
    scheduler: Path, folder: Path, tmp_path: Path, number: int
) -> None:
    out = tmp_path / "out"
    with endless(scheduler) as work:
        process = begun(folder, "a", "-d", out, "--dask", scheduler)
        work.worker()
        assert list(out.glob(".p0.calibrated.parquet.*.tmp"))
        process.send_signal(number)
        left = ended(process)
    said = (
        "interrupted; no incomplete output was left behind; 0 recordings done; the same command does the rest"
    )
    assert (left.code, left.err) == (130, f"accelcal: {said}\n")
    assert not list(out.iterdir())


@pytest.mark.nightly
def test_the_next_run_ends_what_a_killed_one_left(scheduler: Path, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with endless(scheduler) as work:
        process = begun(folder, "a", "-d", out, "--dask", scheduler)
        work.worker()
        assert list(out.glob(".p0.calibrated.parquet.*.tmp"))
        process.kill()
        process.communicate()
        assert ran(folder, "a", "-d", out).code == 0
        soon(lambda: not list(out.rglob("*.tmp")))
    assert not list(out.glob("study.lock"))


@pytest.mark.nightly
def test_what_takes_too_long_is_ended(scheduler: Path, folder: Path, tmp_path: Path) -> None:
    words = ("in", "-d", tmp_path / "out", "--include", LONG, "--timeout", 0.001)
    with endless(scheduler):
        late = ran(folder.parent, *words, "--dask", scheduler)
        assert late.code == 70
        assert f"in/{LONG}: took more than 0.001 minutes and was stopped" in late.err
        soon(lambda: not list(tmp_path.rglob("*.tmp")))


def test_no_scheduler_is_said(folder: Path, tmp_path: Path) -> None:
    short = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "300ms"}
    lost = ran(folder.parent, "in", "-d", tmp_path / "out", "--dask", "tcp://127.0.0.1:9", **short)
    assert lost.code == 69
    assert_one_line(lost, "no scheduler answers at tcp://127.0.0.1:9 (", "dask scheduler")
    assert not list(tmp_path.glob("out/*"))


def test_without_the_extra_it_is_named(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "distributed.py").write_text("raise ModuleNotFoundError('distributed')\n")
    path = os.pathsep.join([str(tmp_path), QUICK["PYTHONPATH"]])
    lost = ran(folder.parent, "in", "-d", tmp_path / "out", "--dask", "tcp://127.0.0.1:9", PYTHONPATH=path)
    assert lost.code == 2
    assert_one_line(lost, "pip install distributed")


@pytest.mark.nightly
def test_a_worker_may_come_later(folder: Path, tmp_path: Path) -> None:
    with cluster(tmp_path, 0) as file, contextlib.ExitStack() as stack:
        process = begun(folder.parent, "in", "-d", tmp_path / "out", "--include", NAMES[0], "--dask", file)
        soon(lambda: list(tmp_path.glob("out/.study.lock.*.tmp")))
        start_workers(stack, file, 1)
        assert ended(process).code == 0


@pytest.mark.nightly
def test_without_the_scheduler_recordings_fail_and_are_tried_again(folder: Path, tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(cluster(tmp_path, 0))
        process = begun(folder.parent, "in", "-d", tmp_path / "out", "--include", NAMES[0], "--dask", file)
        soon(lambda: list(tmp_path.glob("out/.study.lock.*.tmp")))
        stack.close()
        lost = ended(process)
    assert lost.code == 70
    assert f"in/{NAMES[0]}: its worker was lost" in lost.err
    assert ran(folder.parent, "in", "-d", tmp_path / "out", "--include", NAMES[0]).code == 0
