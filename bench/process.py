"""Times whole processes: wall clock, CPU and peak memory."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

MEGABYTE = 1024 if sys.platform != "darwin" else 1024 * 1024


@dataclass(frozen=True, slots=True)
class Run:
    """One process from start to end.

    Attributes:
        memory_mb: its peak resident memory.
    """

    wall_s: float
    cpu_s: float
    memory_mb: float


@dataclass(frozen=True, slots=True)
class Timing:
    """Several runs of one command: medians, and the spread of the wall clock."""

    wall_s: float
    wall_least_s: float
    wall_most_s: float
    cpu_s: float
    memory_mb: float
    runs: int

    def as_json(self) -> dict[str, Any]:
        """Rounded to what the clock can tell."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


def run(command: Sequence[str]) -> Run:
    """Run a command to its end, once the disk has what the one before wrote; raises CalledProcessError."""
    if hasattr(os, "sync"):
        os.sync()
    start = time.perf_counter()
    process = subprocess.Popen(
        list(command), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=_environment()
    )
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command, stderr=said.decode(errors="replace"))
    return Run(wall, used.ru_utime + used.ru_stime, used.ru_maxrss / MEGABYTE)


def _environment() -> dict[str, str]:
    """This one's; compiled modules are kept, as they are where accelcal is installed."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def timed(commands: dict[str, Sequence[str]], runs: int) -> dict[str, Timing]:
    """Run several commands in turn, A B A B, so that a machine that drifts drifts for all of them."""
    held: dict[str, list[Run]] = {name: [] for name in commands}
    for _ in range(runs):
        for name, command in commands.items():
            held[name].append(run(command))
    return {name: _summary(found) for name, found in held.items()}


def _summary(found: list[Run]) -> Timing:
    walls = [item.wall_s for item in found]
    return Timing(
        statistics.median(walls),
        min(walls),
        max(walls),
        statistics.median(item.cpu_s for item in found),
        statistics.median(item.memory_mb for item in found),
        len(found),
    )
