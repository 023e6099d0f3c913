"""The system under this process: CPUs and memory, processes and signals, files, temporary folders, C library.

Whatever Linux, macOS and Windows do not have in common stands here, and nowhere else. CPUs and memory are
those that this process was given, not the machine's; the number of workers follows from them.
"""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from math import ceil
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiprocessing import connection  # takes long to load

    if sys.platform == "win32":
        PipeEnd = connection.PipeConnection[Any, Any]
    else:
        PipeEnd = connection.Connection[Any, Any]

WORKER_BYTES = 330_000_000
"""Most memory [bytes] that a worker needs: it peaks at 306 MB for two days with a gyroscope, at 217 MB with
one thread."""

CGROUPS = Path("/sys/fs/cgroup")
PROCESS = Path("/proc/self/cgroup")
MEMORY = Path("/proc/meminfo")
STATUS = Path("/proc/self/statm")
"""Sizes of this process's memory [pages] (proc(5))."""

FIRST_NUMBERS = "pid:[4026531836]"
"""The namespace of process numbers that a Linux host begins with (pid_namespaces(7), linux/proc_ns.h)."""

STATE, START_TIME = 0, 19
"""Places of fields of /proc/PID/stat behind the name of the program (proc(5))."""

PROCESS_QUERY_LIMITED_INFORMATION, ERROR_INVALID_PARAMETER, STILL_ACTIVE = 0x1000, 87, 259
"""On Windows: the right to query a process, the error if there is none, the exit code of a living one."""

PLAIN_FILE = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
"""Flags of `os.open` with which links are not followed, and pipes not waited for."""

FOUND_FILE = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Flags with which links are followed, and pipes not waited for."""

TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -1, -3, -8
"""Numbers of mallopt(3)'s parameters, from glibc's malloc.h."""

KEPT_BYTES, LARGEST_KEPT_BYTES = 1 << 27, 1 << 25
"""Freed memory that is kept, and the largest piece of it; glibc takes no larger one (mallopt(3))."""

COLLECTED_AFTER = 20_000
"""New objects after which Python looks for garbage, instead of some hundreds."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables in which OpenMP, OpenBLAS and MKL look for their number of threads."""

ALLOCATOR = "JE_ARROW_MALLOC_CONF", "background_thread:false"
"""The variable of Arrow's jemalloc (jemalloc(3)), and the value with which it starts no thread."""

_OURS: list[bool] = []


# --- CPUs and memory


def workers(recordings: int) -> int:
    """Return how many workers CPUs and memory allow for a number of recordings; at least one."""
    memory = available_bytes()
    fitting = cpus() if memory is None else min(cpus(), memory // WORKER_BYTES)
    return max(1, min(fitting, recordings))


def threads(workers: int) -> int:
    """Return the threads of each of several workers, so that all fit the CPUs; at least one."""
    return max(1, cpus() // workers)


def cpus() -> int:
    """Return how many CPUs this process may use, by affinity, cgroup quota (v2) and Slurm's limit."""
    affine = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limits = [affine]
    for folder in cgroups():
        words = _text(folder / "cpu.max").split()  # quota (or `max`) and period [us]
        if len(words) == 2 and words[0].isdecimal() and int(words[1]) > 0:
            limits.append(ceil(int(words[0]) / int(words[1])))
    slurm = os.environ.get("SLURM_CPUS_PER_TASK", "")
    if slurm.isdecimal():
        limits.append(int(slurm))
    return max(1, min(limits))


def available_bytes() -> int | None:
    """Return the memory left to this process by the machine and its cgroup (v2); None if neither is known."""
    limits = []
    for line in _text(MEMORY).splitlines():
        words = line.split()
        if words[:1] == ["MemAvailable:"]:
            limits.append(int(words[1]) * 1024)
    for folder in cgroups():
        limit, used = _text(folder / "memory.max").strip(), _text(folder / "memory.current").strip()
        if limit.isdecimal() and used.isdecimal():
            limits.append(int(limit) - int(used))
    return max(0, min(limits)) if limits else None


def cgroups() -> list[Path]:
    """Return this process's cgroup (v2) and those around it: each can limit it."""
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


@contextmanager
def bounded_memory(spare_bytes: int) -> Iterator[None]:
    """Let larger allocations in the block fail, on systems that can say how much memory is in use."""
    if sys.platform == "win32" or not STATUS.exists():
        yield
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(STATUS.read_text().split()[0]) * resource.getpagesize()
    limits = [bound for bound in (soft, used + spare_bytes) if bound != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


# --- processes


@cache
def host() -> str:
    """Return this host's name; of a container that counts its processes from 1, with its namespace.

    Two containers may have one name and not see each other's processes.
    """
    name = platform.node() or "host"
    try:
        numbers = Path("/proc/self/ns/pid").readlink().name
    except OSError:
        return name
    return name if numbers == FIRST_NUMBERS else f"{name}-{''.join(filter(str.isdigit, numbers))}"


def lives(process: int) -> bool:
    """Return True if a process of this host lives, or if that cannot be found out.

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
    return _process_fields(process)[STATE : STATE + 1] != ["Z"]


def lives_on_windows(process: int, kernel: Any) -> bool:
    """Do the same on Windows, where a signal 0 would end the process (OpenProcess and GetExitCodeProcess).

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


def process_start(process: int) -> str | None:
    """Return the boot and the time within it at which a process of this host began; None if unknown.

    It distinguishes a process from a later one with the same number.
    """
    boot, fields = _text(Path("/proc/sys/kernel/random/boot_id")).strip(), _process_fields(process)
    return f"{boot} {fields[START_TIME]}" if boot and len(fields) > START_TIME else None


def _process_fields(process: int) -> list[str]:
    return _text(Path(f"/proc/{process}/stat")).rpartition(")")[2].split()


def take_over_process() -> None:
    """Say that this process is accelcal's alone, and no program's that uses it: it handles signals itself."""
    _OURS.append(True)


def process_is_ours() -> bool:
    """Return True if `take_over_process` was called."""
    return bool(_OURS)


def has_fork_server() -> bool:
    """Return True if worker processes are forked from a server; libraries of macOS may end forked ones."""
    return sys.platform == "linux"


# --- signals


def ending_signals() -> list[int]:
    """Return the signals that end a command, as far as the system has them."""
    return [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def set_alarm(handler: Callable[[int, FrameType | None], None], seconds: float) -> None:
    """Call `handler` after `seconds`, if the system has timers."""
    if sys.platform != "win32" and hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, seconds)


def clear_alarm(handler: Callable[[int, FrameType | None], None]) -> None:
    """Stop an alarm of `set_alarm` with this handler."""
    if sys.platform != "win32" and hasattr(signal, "setitimer"):
        if signal.getsignal(signal.SIGALRM) is handler:
            signal.setitimer(signal.ITIMER_REAL, 0)


class TookTooLongError(BaseException):
    """Ends a block of `bounded_time`; no handler of errors takes it for one of its own."""


@contextmanager
def bounded_time(seconds: float) -> Iterator[None]:
    """Raise TookTooLongError in a block that takes longer, in the main thread of systems that have timers."""
    main = threading.current_thread() is threading.main_thread()
    if sys.platform == "win32" or not main or signal.getitimer(signal.ITIMER_REAL)[0]:
        yield
        return

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise TookTooLongError

    before = signal.getsignal(signal.SIGALRM)
    set_alarm(stop, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def interruptions_blocked() -> Iterator[None]:
    """Keep Ctrl-C from this thread, and from processes that it starts, to the end of the block."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# --- files and temporary folders


def flush_data(file: int) -> None:
    """Bring what was written to the disk, on systems that need not flush the file's description as well."""
    if hasattr(os, "fdatasync"):
        os.fdatasync(file)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Make a new folder, and remove it at the end; raises OSError if none can be made."""
    folder = new_folder()
    try:
        yield folder
    finally:
        remove_folder(folder)


def new_folder() -> Path:
    """Make a new folder for temporary files; raises OSError if none can be made."""
    import tempfile  # few runs need one

    return Path(tempfile.mkdtemp(prefix=f"{folder_start()}{os.getpid()}-"))


def folder_start() -> str:
    """Return how the names of temporary folders of this host begin; the number of their process follows."""
    import hashlib

    return f"accelcal-{hashlib.sha256(host().encode()).hexdigest()[:6]}-"


def remove_folder(folder: Path) -> None:
    """Remove a folder with all that is in it, as far as that can be done."""
    import shutil

    with suppress(OSError):  # rmtree passes on that a folder cannot be closed
        shutil.rmtree(folder, ignore_errors=True)


# --- interpreter and libraries


def keep_freed_memory() -> bool:
    """Let this process use the memory of one chunk again for the next, as far as its C library can.

    By default glibc gives arrays of some megabytes back to the system and asks for fresh ones, each
    page of which must be cleared and mapped again: a third of the time of reading a recording.

    Returns:
        True if the C library took it.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    wanted = ((MMAP_THRESHOLD, LARGEST_KEPT_BYTES), (TRIM_THRESHOLD, KEPT_BYTES), (ARENA_MAX, 1))
    return mallopt is not None and all(mallopt(name, value) for name, value in wanted)


def collect_seldom() -> None:
    """Let Python look less often for objects that hold each other: a run leaves few, and is 1 % faster."""
    gc.set_threshold(COLLECTED_AFTER)


def hold_to_one_thread() -> None:
    """Let libraries start no threads; to be called before they are loaded.

    By default matrix products take one for every CPU, which wait for each other spinning: what they took from
    the thread that encodes, half a second of a week's recording, the small products here never gave back.
    One thread also adds in the same order on every machine. Arrow's allocator has one that tidies up, which
    the server that workers of a study are forked from must not have.
    """
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    os.environ.setdefault(*ALLOCATOR)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Do the same for processes that are started in the block, and leave this one as it was."""
    names = (*THREAD_VARIABLES, ALLOCATOR[0])
    before = {name: os.environ.get(name) for name in names}
    hold_to_one_thread()
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
