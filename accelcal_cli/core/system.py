"""The machine under this process: CPUs, memory, processes, temporary folders, C library and linear algebra.

CPUs and memory are those that this process was given, not the machine's; the number of workers follows
from them.
"""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from math import ceil
from pathlib import Path
from typing import Any

WORKER_BYTES = 330_000_000
"""What one worker needs at most: it peaks at 306 MB for two days with a gyroscope, at 217 MB where it has
but one thread."""

CGROUPS = Path("/sys/fs/cgroup")
PROCESS = Path("/proc/self/cgroup")
MEMORY = Path("/proc/meminfo")

FIRST_NUMBERS = "pid:[4026531836]"
"""The namespace of process numbers that a Linux host begins with (pid_namespaces(7), linux/proc_ns.h)."""

TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -1, -3, -8
"""Numbers of mallopt(3)'s parameters, from glibc's malloc.h."""

PROCESS_QUERY_LIMITED_INFORMATION, ERROR_INVALID_PARAMETER, STILL_ACTIVE = 0x1000, 87, 259
"""Of Windows: what is asked of a process, the error if there is none, and the exit code of one that lives."""

KEPT_BYTES = 1 << 27
LARGEST_KEPT_BYTES = 1 << 25
"""glibc takes no larger one on 64-bit machines (mallopt(3))."""

COLLECTED_AFTER = 20_000
"""New objects, instead of some hundreds."""

_OURS: list[bool] = []

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What OpenMP, OpenBLAS and MKL ask for, in this process and those it starts."""

ALLOCATOR = "JE_ARROW_MALLOC_CONF", "background_thread:false"
"""What Arrow's jemalloc asks for (jemalloc(3)), and that it should start no thread."""


def workers(recordings: int) -> int:
    """Workers for so many recordings: at least one, at most what CPUs and memory allow."""
    memory = available_bytes()
    fitting = cpus() if memory is None else min(cpus(), memory // WORKER_BYTES)
    return max(1, min(fitting, recordings))


def threads(workers: int) -> int:
    """Threads for each of so many workers, so that all of them together fit the CPUs; at least one."""
    return max(1, cpus() // workers)


def cpus() -> int:
    """CPUs this process may use: the least of affinity, cgroup quota (v2) and what Slurm allows."""
    slurm = os.environ.get("SLURM_CPUS_PER_TASK", "")
    limits = [_affinity(), *_quotas()]
    if slurm.isdecimal():
        limits.append(int(slurm))
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
    """Memory that is left to this process: the machine's and its cgroup's (v2); None if neither is known."""
    limits = [*_machine_bytes(), *_cgroup_bytes()]
    return max(0, min(limits)) if limits else None


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


@cache
def host() -> str:
    """This host's name; of a container that counts its processes from 1, with its namespace.

    Two containers may have one name and not see each other's processes.
    """
    name = platform.node() or "host"
    try:
        numbers = Path("/proc/self/ns/pid").readlink().name
    except OSError:
        return name
    return name if numbers == FIRST_NUMBERS else f"{name}-{''.join(filter(str.isdigit, numbers))}"


def lives(process: int) -> bool:
    """Whether a process of this host lives; True if that cannot be found out.

    One that has ended but has not been waited for is dead (state Z in proc(5)).
    """
    if sys.platform == "win32":
        return lives_on_windows(process, ctypes.WinDLL("kernel32", use_last_error=True))
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return _state(process) != "Z"


def process_start(process: int) -> str | None:
    """Return when a process of this host began, so that a number given again is told apart; None if unknown.

    The boot, and the 22nd field of `/proc/PID/stat` (proc(5)), counted from the last parenthesis.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        fields = Path(f"/proc/{process}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
        return f"{boot} {fields[19]}"
    except (OSError, IndexError):
        return None


def lives_on_windows(process: int, kernel: Any) -> bool:
    """The same on Windows, where a signal 0 would end the process (OpenProcess and GetExitCodeProcess).

    Args:
        kernel: kernel32, with the last error kept.
    """
    if process >= 1 << 32:
        return False
    kernel.OpenProcess.restype = ctypes.c_void_p
    kernel.GetExitCodeProcess.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    kernel.CloseHandle.argtypes = [ctypes.c_void_p]
    handle = kernel.OpenProcess(PROCESS_QUERY_LIMITED_INFORMATION, False, process)
    if not handle:
        return bool(ctypes.get_last_error() != ERROR_INVALID_PARAMETER)  # type: ignore[attr-defined,unused-ignore]
    code = ctypes.c_uint32()
    known = kernel.GetExitCodeProcess(handle, ctypes.byref(code))
    kernel.CloseHandle(handle)
    return not known or code.value == STILL_ACTIVE


def _state(process: int) -> str:
    try:
        return Path(f"/proc/{process}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return ""


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A new folder, removed at the end; raises OSError if none can be made."""
    folder = new_folder()
    try:
        yield folder
    finally:
        remove_folder(folder)


def new_folder() -> Path:
    """A new folder for temporary files; raises OSError if none can be made."""
    import tempfile  # few runs need one

    return Path(tempfile.mkdtemp(prefix="accelcal-"))


def remove_folder(folder: Path) -> None:
    """Remove a folder with all that is in it, as far as that can be done."""
    import shutil

    with suppress(OSError):  # rmtree passes on that a folder cannot be closed
        shutil.rmtree(folder, ignore_errors=True)


def keep_freed_memory() -> bool:
    """Let this process use the memory of one chunk again for the next, as far as its C library can.

    By default glibc gives arrays of some megabytes back to the system and asks for fresh ones, each
    page of which must be cleared and mapped anew: a third of the time of reading a recording.

    Returns:
        whether the C library took it.
    """
    mallopt = _of_glibc("mallopt")
    wanted = ((MMAP_THRESHOLD, LARGEST_KEPT_BYTES), (TRIM_THRESHOLD, KEPT_BYTES), (ARENA_MAX, 1))
    return mallopt is not None and all(mallopt(name, value) for name, value in wanted)


def give_back_freed_memory() -> bool:
    """Return to the system what is kept: what comes next needs arrays of other sizes.

    Returns:
        whether there was something that could be returned.
    """
    trim = _of_glibc("malloc_trim")
    return trim is not None and bool(trim(0))


def collect_seldom() -> None:
    """Let Python look less often for objects that hold each other: a run leaves few, and is 1 % faster."""
    gc.set_threshold(COLLECTED_AFTER)


def _of_glibc(name: str) -> Any:
    """A function that only glibc has, or None."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None


def take_over_process() -> None:
    """Say that this process is accelcal's alone, and no program's that uses it: it handles signals itself."""
    _OURS.append(True)


def process_is_ours() -> bool:
    """Whether `take_over_process` was called."""
    return bool(_OURS)


def hold_to_one_thread() -> None:
    """Let libraries start no threads; to be called before they are loaded.

    By default matrix products take one for every CPU, which wait for each other spinning: what they took from
    the thread that encodes, half a second of a week's recording, the small products here never gave back.
    One thread also adds in the same order on every machine. Arrow's allocator has one that tidies up, which
    the server that workers of a study are forked from must not have.
    """
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    os.environ.setdefault(*ALLOCATOR)
