"""A real cluster of dask.distributed on this machine: a scheduler and workers, each a process."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

ROOT = Path(__file__).resolve().parents[2]
QUICK = {
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
    "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "10s",
    "DASK_TEMPORARY_DIRECTORY": ".",
    "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
}
"""A task that has killed two workers is not tried again."""

Found = TypeVar("Found")


@contextlib.contextmanager
def cluster(folder: Path, workers: int = 2, *words: str) -> Iterator[Path]:
    """A scheduler file; the processes end with the block. Nannies start killed workers again."""
    file = folder / "scheduler.json"
    with contextlib.ExitStack() as stack:
        start(stack, folder, "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file),
              "--idle-timeout", "120")  # fmt: skip
        for _ in range(workers):
            start_worker(stack, file, *words)
        soon(file.exists)
        yield file


def start_worker(stack: contextlib.ExitStack, file: Path, *words: str) -> None:
    """One more worker of one thread."""
    start(stack, file.parent, "worker", "--scheduler-file", str(file), "--nthreads", "1", *words)


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


def soon(look: Callable[[], Found], within_s: float = 30.0) -> Found:
    """What there is to see before long."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        if found := look():
            return found
        time.sleep(0.005)
    raise AssertionError("nothing came")
