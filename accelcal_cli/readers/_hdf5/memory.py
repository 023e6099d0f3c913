"""A bound on the memory that reading something small may take."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SPARE_BYTES = 256 << 20
STATUS = Path("/proc/self/statm")


@contextmanager
def bounded_memory() -> Iterator[None]:
    """Let larger allocations in the block fail, on systems that can say how much is in use.

    A text whose length is damaged makes the HDF5 library (1.14 and 2.0) ask for up to 4 GB before it
    looks whether there is so much.
    """
    if sys.platform == "win32" or not STATUS.exists():
        yield
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(STATUS.read_text().split()[0]) * resource.getpagesize()
    limits = [bound for bound in (soft, used + SPARE_BYTES) if bound != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
