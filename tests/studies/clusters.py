"""A real cluster of dask.distributed on this machine: a scheduler and workers, each a process."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.studies.processes import soon

ROOT = Path(__file__).resolve().parents[2]
QUICK = {
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
    "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "10s",
    "DASK_TEMPORARY_DIRECTORY": ".",
    "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
}
"""A task that has killed two workers is not tried again."""


ENDLESS = """
import os, pathlib, time
from accelcal_cli.studies import task

def stage(self, name, total, plain=task.StageProgress.stage):
    moved = plain(self, name, total)

    def endless(done):
        moved(done)
        while name == "writing" and pathlib.Path("endless").exists():
            pathlib.Path(f"{os.getpid()}.begun").touch()
            time.sleep(0.01)
            self.report_progress(0.5)

    return endless

task.StageProgress.stage = stage
"""
"""Imported by each worker: while a file is there, no recording ends but by being cancelled."""


@contextlib.contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[Path]:
    """A scheduler file; the processes end with the block. Nannies start killed workers again."""
    file = folder / "scheduler.json"
    (folder / "endless.py").write_text(ENDLESS)
    with contextlib.ExitStack() as stack:
        start(stack, folder, "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file),
              "--idle-timeout", "3600")  # fmt: skip
        if workers:
            start_workers(stack, file, workers)
        soon(file.exists)
        yield file


def start_workers(stack: contextlib.ExitStack, file: Path, number: int) -> None:
    """So many workers of one thread."""
    start(stack, file.parent, "worker", "--scheduler-file", str(file), "--nthreads", "1",
          "--nworkers", str(number), "--preload", "endless.py")  # fmt: skip


@dataclass(frozen=True)
class Endless:
    """Recordings of a cluster do not end until they may, or are cancelled."""

    folder: Path

    def worker(self) -> int:
        """A process that is writing one."""
        return int(soon(lambda: next(self.folder.glob("*.begun"), None)).stem)

    def end(self) -> None:
        """From now on recordings end."""
        (self.folder / "endless").unlink(missing_ok=True)


@contextlib.contextmanager
def endless(scheduler: Path) -> Iterator[Endless]:
    """Until the block ends nothing ends on a cluster."""
    (scheduler.parent / "endless").touch()
    for path in scheduler.parent.glob("*.begun"):
        path.unlink()
    work = Endless(scheduler.parent)
    yield work
    work.end()


def start(stack: contextlib.ExitStack, folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """`dask WORDS`, away from the project's folder, ended with the stack."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *words, "--no-dashboard"],
        cwd=folder,
        env={**os.environ, **QUICK},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    stack.callback(_end, process)
    return process


def _end(process: subprocess.Popen[bytes]) -> None:
    """A nanny, its worker and their helpers are one session of ours."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
