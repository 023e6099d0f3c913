"""Processes of this host: what it is called, and which of them live."""

from __future__ import annotations

import os
import platform
from functools import cache
from pathlib import Path

FIRST_NUMBERS = "pid:[4026531836]"
"""The namespace of process numbers that a Linux host begins with (pid_namespaces(7), linux/proc_ns.h)."""


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
    """Whether a process of this host lives; yes where it cannot be told.

    One that ended and that nobody asked about yet is dead (state Z in proc(5)).
    """
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return _state(process) != "Z"


def _state(process: int) -> str:
    try:
        return Path(f"/proc/{process}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return ""
