"""Times whole processes, with all that they start: wall clock, CPU and peak memory."""

from __future__ import annotations

import contextlib
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

MEGABYTE = 1024 if sys.platform != "darwin" else 1024 * 1024

LEFT_OUT = ("PYTHONDONTWRITEBYTECODE", "PYTHONPATH")
"""Variables that would change what is timed."""

SAMPLED_S = 0.01
"""Memory is looked at so often, in a run of its own, since that takes time."""


@dataclass(frozen=True, slots=True)
class Command:
    """What is timed, and the file or folder that it makes, which is removed before each run."""

    words: Sequence[str]
    makes: Path | None = None

    def prepare(self) -> None:
        """Let the disk come to rest, without what an earlier run made."""
        if self.makes is not None and self.makes.is_dir():
            shutil.rmtree(self.makes)
        elif self.makes is not None:
            self.makes.unlink(missing_ok=True)
        if hasattr(os, "sync"):
            os.sync()


@dataclass(frozen=True, slots=True)
class Run:
    """One process from start to end.

    Attributes:
        memory_mb: peak resident memory of the largest process.
    """

    wall_s: float
    cpu_s: float
    memory_mb: float


@dataclass(frozen=True, slots=True)
class Timing:
    """Several runs of one command: medians, and the spread of the wall clock.

    Attributes:
        memory_mb: peak memory of all its processes together, where the system tells (`peak_mb`).
    """

    wall_s: float
    wall_least_s: float
    wall_most_s: float
    cpu_s: float
    memory_mb: float
    runs: int

    def as_json(self) -> dict[str, Any]:
        """Rounded to what the clock can tell."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


def run(command: Command, rest_s: float = 0) -> Run:
    """Run a command to its end, after so long a rest; raises CalledProcessError."""
    command.prepare()
    time.sleep(rest_s)
    start = time.perf_counter()
    process = _begun(command, subprocess.PIPE)
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        told = said.decode(errors="replace")
        raise subprocess.CalledProcessError(process.returncode, command.words, stderr=told)
    return Run(wall, used.ru_utime + used.ru_stime, used.ru_maxrss / MEGABYTE)


def peak_mb(command: Command) -> float | None:
    """Most memory that a command's processes had together, of which shared pages count once.

    Sampled by PSS (proc(5), smaps_rollup); None where there is none.
    """
    command.prepare()
    process, most = _begun(command, subprocess.DEVNULL), 0
    while process.poll() is None:
        most = max(most, sum(map(_pss_kb, _tree(process.pid))))
        time.sleep(SAMPLED_S)
    return most / 1024 if most else None


def _tree(process: int) -> Iterator[int]:
    """A process and all that it, or they, started."""
    yield process
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{process}/task").iterdir():
            for child in (task / "children").read_text().split():
                yield from _tree(int(child))


def _pss_kb(process: int) -> int:
    """The memory of a process, of what it shares its share; 0 if it is gone."""
    with contextlib.suppress(OSError):
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
        return next((int(line.split()[1]) for line in lines if line.startswith("Pss:")), 0)
    return 0


def _begun(command: Command, errors: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen([*command.words], stdout=subprocess.DEVNULL, stderr=errors, env=_environment())


def _environment() -> dict[str, str]:
    """This one's; compiled modules are kept, as they are where accelcal is installed."""
    return {name: value for name, value in os.environ.items() if name not in LEFT_OUT}


def timed(commands: Mapping[str, Command], runs: int, rest_s: float = 0) -> dict[str, Timing]:
    """Run several commands in turn, A B A B, so that a machine that drifts drifts for all of them.

    Args:
        rest_s: so long nothing is done before each run.
    """
    held: dict[str, list[Run]] = {name: [] for name in commands}
    for _ in range(runs):
        for name, command in commands.items():
            held[name].append(run(command, rest_s))
    return {name: _summary(found, peak_mb(commands[name])) for name, found in held.items()}


def _summary(found: list[Run], memory_mb: float | None) -> Timing:
    walls = [item.wall_s for item in found]
    return Timing(
        statistics.median(walls),
        min(walls),
        max(walls),
        statistics.median(item.cpu_s for item in found),
        memory_mb or statistics.median(item.memory_mb for item in found),
        len(found),
    )
