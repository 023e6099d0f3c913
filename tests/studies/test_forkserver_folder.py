"""The server of the workers: where it listens, what is left of it, and that a study outlives it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.run import run_process
from tests.cli.studies import study_folder
from tests.studies.processes import soon

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="workers are forked there")
ROOT = Path(__file__).resolve().parents[2]

SERVER_KILLED = """
import contextlib, multiprocessing.forkserver as server, os, signal
from accelcal_cli.studies import process_pool
from tests.studies.test_process_pool import work

@contextlib.contextmanager
def fatal():
    with plain():
        if (number := server._forkserver._forkserver_pid) and not killed:
            killed.append(number)
            os.kill(number, signal.SIGKILL)
        yield

killed, plain = [], process_pool.forkserver_folder
process_pool.forkserver_folder = fatal
if __name__ == "__main__":
    for ended in process_pool.ProcessPool(work, 1).run([("kill", signal.SIGKILL), ("echo", 1)]):
        print(ended.result)
    print(len(killed))
"""


@pytest.mark.nightly
def test_a_long_path_of_temporary_files_is_fine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / ("long" * 30)
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    ran = run_process("study", study_folder(tmp_path / "in", ("a.raw",)), "-d", tmp_path / "out")
    assert ran.code == 0, ran.err
    assert list(folder.iterdir()) == []


def test_the_next_run_removes_what_a_killed_one_left(tmp_path: Path, temporaries: Path) -> None:
    script = "from accelcal_cli.studies.executors import forkserver_folder\nwith forkserver_folder(): input()"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    killed, living = (
        subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, env=environment)
        for _ in range(2)
    )
    soon(lambda: len(list(temporaries.iterdir())) == 2)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert run_process("study", study_folder(tmp_path / "in", ("a.raw",)), "-d", tmp_path / "out").code == 0
    assert [f"-{living.pid}-" in path.name for path in temporaries.iterdir()] == [True]
    living.communicate(b"\n")
    assert list(temporaries.iterdir()) == []


@pytest.mark.nightly
def test_another_server_is_started_where_it_was_killed(tmp_path: Path) -> None:
    script = tmp_path / "pool.py"
    script.write_text(SERVER_KILLED)
    done = subprocess.run(
        [sys.executable, script],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "None\n('echo', 1)\n1\n"
