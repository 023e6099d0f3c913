"""Which processes live, and what this host is called."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from accelcal_cli.core.system import FIRST_NUMBERS, host, lives

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")


def test_this_one_and_its_parent_live() -> None:
    assert lives(os.getpid()) and lives(os.getppid())


def test_one_that_ended_does_not_live_even_before_it_is_asked_about() -> None:
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    assert lives(process.pid)
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert "\nState:\tZ" in Path(f"/proc/{process.pid}/status").read_text()
    assert not lives(process.pid)
    process.communicate()
    assert not lives(process.pid)
    assert not lives(1 << 62)


@pytest.mark.parametrize(("numbers", "more"), [(FIRST_NUMBERS, ""), ("pid:[4026532701]", "-4026532701")])
def test_a_container_with_numbers_of_its_own_is_another_host(
    monkeypatch: pytest.MonkeyPatch, numbers: str, more: str
) -> None:
    monkeypatch.setattr(Path, "readlink", lambda _path: Path(numbers))
    assert host.__wrapped__() == platform.node() + more
