"""Freed memory is kept: the next arrays of the same size need no fresh pages."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

COUNT = """
import resource, sys
import numpy as np
from accelcal_cli.core.system import keep_freed_memory
if sys.argv[1] == "kept":
    assert keep_freed_memory()
def used():
    held = [np.ones(1 << 18) for _ in range(8)]
used()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    used()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(how: str) -> int:
    done = subprocess.run([sys.executable, "-c", COUNT, how], capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can be told")
def test_pages_are_mapped_once() -> None:
    assert faults("kept") < 100
    assert faults("usual") > 4096
