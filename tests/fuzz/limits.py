"""What a mutant may cost: time, and memory at its highest."""

from __future__ import annotations

import contextlib
import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

SECONDS = 20.0
FIT_SECONDS = 60.0
"""What a command may take that fits points: those that do not determine a model take all iterations."""

MEMORY_BYTES = 450 << 20
"""More than the process had."""

CPU_SECONDS = 1.5
"""What a mutant of few bytes may take of a processor."""

CPU_SECONDS_PER_BYTE = 4e-6
CPU_SECONDS_PER_ROW = 4e-6
"""Rows may be many more than bytes: a device that sleeps has a row for each sample that it did not take."""

STATUS = Path("/proc/self/status")
RESET = Path("/proc/self/clear_refs")
RESET_PEAK = "5"


class HangError(BaseException):
    """A mutant takes too long; nothing that catches errors holds it up."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise HangError in a block that takes more of a processor, however busy the machine is."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise HangError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def forget_peak() -> None:
    with contextlib.suppress(OSError):
        RESET.write_text(RESET_PEAK)


def peak_bytes() -> int:
    with contextlib.suppress(OSError):
        for line in STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def allowed_seconds(size: int, rows: int) -> float:
    """Processor time for a file of so many bytes that gives so many rows."""
    return CPU_SECONDS + size * CPU_SECONDS_PER_BYTE + rows * CPU_SECONDS_PER_ROW
