"""How the C library deals with memory that was used and will be used again."""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Numbers of mallopt(3)'s parameters, from glibc's malloc.h."""

KEPT_BYTES = 1 << 27
LARGEST_KEPT_BYTES = 1 << 25
"""glibc takes no larger one on 64-bit machines (mallopt(3))."""


def keep_freed_memory() -> bool:
    """Let this process use the memory of one chunk again for the next, as far as its C library can.

    By default glibc gives arrays of some megabytes back to the system and asks for fresh ones, each
    page of which must be cleared and mapped anew: a third of the time of reading a recording.

    Returns:
        whether the C library took it.
    """
    if sys.platform != "linux":
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    wanted = ((MMAP_THRESHOLD, LARGEST_KEPT_BYTES), (TRIM_THRESHOLD, KEPT_BYTES))
    return all(mallopt(name, value) for name, value in wanted)
