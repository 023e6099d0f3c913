"""The process that forks one for each command: `python -m tests.faults.runner FOLDER`, the shim preloaded.

Takes a line of JSON for each run, the words and the folder, and answers with the exit code.
"""

from __future__ import annotations

import atexit
import ctypes
import importlib
import json
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import threading
from dataclasses import replace
from multiprocessing import forkserver, resource_tracker
from pathlib import Path

import pyarrow as pa

from accelcal_cli.core.system import hold_to_one_thread, keep_freed_memory, take_over_process
from accelcal_cli.pipeline import outputs
from tests.faults.shim import LONGEST_S, arm
from tests.studies.processes import session, soon

COMMANDS = (
    "calibrate", "study", "apply", "export", "report", "simulate", "fit", "six_pose",
    "inspect", "verify", "watch", "devices",
)  # fmt: skip
LOADED = (
    "accelcal_cli.studies.preload", "accelcal_cli.exports.data", "accelcal_cli.pages.write",
    "accelcal_cli.simulate", "accelcal_cli.watching.row_stream", "h5py", "pyarrow.csv", "pandas",
    *(f"accelcal_cli.cli.{name}" for name in COMMANDS),
)  # fmt: skip

MORE_BYTES, OPEN_FILES = 1 << 30, 64
"""What a limited command is given: memory besides what it needs to begin, and files."""

START = "2024-03-04T00:00:00+00:00"
"""When all runs are said to have been made, on pages too."""


def main() -> None:
    """Fork a command for each line."""
    take_over_process()
    hold_to_one_thread()
    keep_freed_memory()
    for name in LOADED:
        importlib.import_module(name)
    pa.array([0]).cast(pa.int8())  # Arrow's allocator sets a gigabyte of addresses aside
    made = replace(outputs.provenance(["accelcal"]), time=START)
    outputs.provenance = lambda _command, files=None: replace(made, files=files)
    if "ACCELCAL_FORKED" in os.environ:
        _fork_workers()
    folder = Path(sys.argv[1])
    for line in sys.stdin.buffer:
        words, here, limit_s = json.loads(line)
        process = os.fork()
        if process == 0:
            _command(words, Path(here), folder, limit_s)
        code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        soon(lambda ended=process: not session(ended))
        arm(folder / "plan", False)
        sys.stdout.write(f"{code}\n")
        sys.stdout.flush()


def _fork_workers() -> None:
    """Let multiprocessing fork where it would start a server."""
    context = multiprocessing.get_context("fork")
    multiprocessing.get_context = lambda _method=None: context
    for module in (forkserver, resource_tracker):
        module.ensure_running = lambda: None


def _command(words: list[str], here: Path, folder: Path, limit_s: int) -> None:
    """What the console command does, to its end."""
    os.setsid()
    if limit_s:
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MORE_BYTES, used + MORE_BYTES))
        resource.setrlimit(resource.RLIMIT_NOFILE, (OPEN_FILES, OPEN_FILES))
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
    signal.alarm(max(LONGEST_S, limit_s))
    for number, name in enumerate(("out", "err"), 1):
        file = os.open(folder / name, os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
        os.dup2(file, number)
        os.close(file)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.environ["TMPDIR"], tempfile.tempdir = str(here / "tmp"), None
    os.chdir(here)
    sys.argv = ["accelcal", *words]
    main = importlib.import_module("accelcal_cli.cli.main").main
    arm(folder / "plan", True)
    if not limit_s:
        main()
    try:
        main()
    except SystemExit as ended:
        _end(ended.code)


def _end(code: object) -> None:
    """End as Python and its libraries do, but take no module apart: that takes longer than most runs."""
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.PyDLL(None).exit(code)


if __name__ == "__main__":
    main()
