"""How the C library deals with memory that was used and will be used again."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

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
    mallopt = _of_glibc("mallopt")
    wanted = ((MMAP_THRESHOLD, LARGEST_KEPT_BYTES), (TRIM_THRESHOLD, KEPT_BYTES))
    return mallopt is not None and all(mallopt(name, value) for name, value in wanted)


def give_back_freed_memory() -> bool:
    """Return to the system what is kept: what comes next needs arrays of other sizes.

    Returns:
        whether there was something that could be returned.
    """
    trim = _of_glibc("malloc_trim")
    return trim is not None and bool(trim(0))


def _of_glibc(name: str) -> Any:
    """A function that only glibc has, or None."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None
