"""CPUs and memory that this process was given, not the machine's; how many workers they keep busy."""

from __future__ import annotations

import os
from collections.abc import Iterator
from math import ceil
from pathlib import Path

WORKER_BYTES = 330_000_000
"""What one worker needs at most: it peaks at 285 MB for a CSV, at 205 MB where it has but one thread."""

CGROUPS = Path("/sys/fs/cgroup")
PROCESS = Path("/proc/self/cgroup")
MEMORY = Path("/proc/meminfo")


def workers(recordings: int) -> int:
    """Workers for so many recordings: at least one, at most what CPUs and memory allow."""
    memory = available_bytes()
    fitting = cpus() if memory is None else min(cpus(), memory // WORKER_BYTES)
    return max(1, min(fitting, recordings))


def threads(workers: int) -> int:
    """Threads for each of so many workers, so that all of them together fit the CPUs; at least one."""
    return max(1, cpus() // workers)


def cpus() -> int:
    """CPUs this process may use: the least of affinity, cgroup quota (v2) and Slurm's word."""
    told = os.environ.get("SLURM_CPUS_PER_TASK", "")
    limits = [_affinity(), *_quotas()]
    if told.isdecimal():
        limits.append(int(told))
    return max(1, min(limits))


def _affinity() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _quotas() -> Iterator[int]:
    """`cpu.max` holds a quota and a period, both in microseconds, or `max` for none."""
    for folder in cgroups():
        words = _text(folder / "cpu.max").split()
        if len(words) == 2 and words[0].isdecimal() and int(words[1]) > 0:
            yield ceil(int(words[0]) / int(words[1]))


def available_bytes() -> int | None:
    """Memory that is left to this process: the machine's and its cgroup's (v2); None where neither tells."""
    found = [*_machine_bytes(), *_cgroup_bytes()]
    return max(0, min(found)) if found else None


def _machine_bytes() -> Iterator[int]:
    for line in _text(MEMORY).splitlines():
        words = line.split()
        if words[:1] == ["MemAvailable:"]:
            yield int(words[1]) * 1024


def _cgroup_bytes() -> Iterator[int]:
    for folder in cgroups():
        limit, used = _text(folder / "memory.max").strip(), _text(folder / "memory.current").strip()
        if limit.isdecimal() and used.isdecimal():
            yield int(limit) - int(used)


def cgroups() -> list[Path]:
    """This process's cgroup (v2) and those around it: each can limit it."""
    for line in _text(PROCESS).splitlines():
        if line.startswith("0::"):
            own = CGROUPS / line[3:].strip().lstrip("/")
            return [own, *(folder for folder in own.parents if folder.is_relative_to(CGROUPS))]
    return []


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace")
    except OSError:
        return ""
