"""Studies as processes, to be killed."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from tests.cli.run import command

Found = TypeVar("Found")


def begun(folder: Path, out: Path, *more: object, cwd: Path | None = None) -> subprocess.Popen[bytes]:
    """A study in a session of its own, which hears Ctrl-C even where the tests run in the background."""
    words = command("study", folder, "-d", out, "-j", 2, *more)
    return subprocess.Popen(
        words,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        cwd=cwd,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def soon(look: Callable[[], Found]) -> Found:
    """What there is to see, within half a minute."""
    for _ in range(6000):
        if found := look():
            return found
        time.sleep(0.005)
    raise AssertionError("nothing came")


def session(leader: int) -> list[str]:
    """Processes that a run started and that still live: those of its session (the 6th field, proc(5))."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, number = path.read_text().rpartition(")")[2].split()[:4]
            found += [path.parent.name] if int(number) == leader and state != "Z" else []
    return found


def commands(leader: int) -> list[bytes]:
    """The command lines of what `session` finds."""
    found = []
    for pid in session(leader):
        with contextlib.suppress(OSError):
            found.append(Path(f"/proc/{pid}/cmdline").read_bytes())
    return found


def lines(out: Path) -> int:
    """Recordings in the ledger, once for each round."""
    ledger = out / "study.ledger"
    return ledger.read_text().count('"row"') if ledger.exists() else 0
