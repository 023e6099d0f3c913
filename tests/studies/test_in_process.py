"""Tasks in the process of a program that uses accelcal, and workers that know nothing of its `__main__`."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from accelcal_cli.studies.executors import done_here
from accelcal_cli.studies.records import ProgressCallback

ROOT = Path(__file__).resolve().parent.parent.parent
MAIN = """
import os
from accelcal_cli.studies.executors import ProcessPool
from tests.studies.test_in_process import main_of_worker

with open("runs", "a") as file:
    file.write("ran\\n")
found = [one for one in ProcessPool(main_of_worker, 2).run([1, 2, 3])]
assert [one.fault for one in found] == [None] * 3, found
assert {one.result for one in found} == {"nothing"}, found
assert "OMP_NUM_THREADS" not in os.environ
"""
"""A program without a guard that has tasks done by workers."""


def work(task: int, told: ProgressCallback) -> tuple[int, int]:
    told(0.5)
    return task, os.getpid()


def main_of_worker(_task: int, _told: ProgressCallback) -> str:
    """The file of the program that a worker knows of."""
    return getattr(sys.modules.get("__mp_main__"), "__file__", "nothing")


@pytest.mark.parametrize("how", ["file", "stdin", "module", "spawn"])
def test_p2_workers_do_not_run_the_program_again(how: str, tmp_path: Path) -> None:
    text = textwrap.dedent(MAIN)
    if how == "spawn":
        text = (
            "import accelcal_cli.core.system as s\ns.has_fork_server = lambda: False\n"
            "import accelcal_cli.studies.executors as p\np.has_fork_server = lambda: False\n" + text
        )
    (tmp_path / "program.py").write_text(text)
    words = {"stdin": ["-"], "module": ["-m", "program"]}.get(how, ["program.py"])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        environment.pop(name, None)
    done = subprocess.run(
        [sys.executable, *words], input=text if how == "stdin" else None, cwd=tmp_path, env=environment,
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "runs").read_text() == "ran\n"


def test_p10_tasks_stay_in_this_process() -> None:
    moved: list[float] = []
    ended = list(done_here(work, [1, 2], lambda _task, part: moved.append(part)))
    assert [one.result for one in ended] == [(1, os.getpid()), (2, os.getpid())]
    assert moved == [0.0, 0.5, 1.0, 0.0, 0.5, 1.0]
