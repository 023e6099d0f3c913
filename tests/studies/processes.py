"""Studies as processes, to be stopped at a chosen moment, interrupted and killed.

No test waits for time to pass: it waits for a file, a process or a line, and a study that must not end before
something happens is held where it is until then.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from tests.cli.run import command

Found = TypeVar("Found")

HOOK = """
import fcntl, os, platform, sys

if (node := os.environ.get("ACCELCAL_NODE")) is not None:
    platform.node = lambda: node
AT, FOLDER = os.environ["ACCELCAL_HELD_AT"], os.environ["ACCELCAL_HELD_IN"]

def hold(event, words):
    renamed = event == "os.rename" and os.fsdecode(words[1]).endswith(AT)
    if renamed or (event == "import" and words[0] == AT):
        open(f"{FOLDER}/{os.getpid()}", "w").close()
        with open(f"{FOLDER}/gate") as gate:
            fcntl.flock(gate, fcntl.LOCK_SH)

sys.addaudithook(hold)
"""
"""Imported when Python starts (`sitecustomize`)."""


@dataclass(frozen=True)
class Hold:
    """Processes stop before they give a file its final name, or before they import a module.

    Attributes:
        at: how the file's name ends, or the name of the module.
    """

    folder: Path
    at: str

    @property
    def environment(self) -> dict[str, str]:
        """Of the processes that are to stop."""
        path = os.pathsep.join([str(self.folder), os.environ.get("PYTHONPATH", "")])
        return {"PYTHONPATH": path, "ACCELCAL_HELD_AT": self.at, "ACCELCAL_HELD_IN": str(self.folder)}

    def process(self) -> int:
        """The number of a process that stopped, once there is one."""
        return int(soon(lambda: next(self.folder.glob("[0-9]*"), None)).name)


@contextlib.contextmanager
def held(folder: Path, at: str) -> Iterator[Hold]:
    """Until the block ends processes that are started with its environment stop there."""
    folder = folder / "hold"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(HOOK)
    with (folder / "gate").open("w") as gate:
        fcntl.flock(gate, fcntl.LOCK_EX)
        yield Hold(folder, at)


def begun(
    folder: Path,
    out: Path,
    *more: object,
    cwd: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> subprocess.Popen[bytes]:
    """A study in a session of its own, which hears Ctrl-C even where the tests run in the background."""
    words = command("study", folder, "-d", out, "-j", 2, *more)
    return subprocess.Popen(
        words,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        cwd=cwd,
        env={**os.environ, **(environment or {})},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def soon(look: Callable[[], Found], within_s: float = 120.0) -> Found:
    """What there is to see, once it is there; so long only where something is broken."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        if found := look():
            return found
        time.sleep(0.005)
    raise AssertionError("nothing came")


class Clock:
    """Time that passes when a test says so."""

    sleep = staticmethod(time.sleep)

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def pass_(self, seconds: float) -> None:
        self.now_s += seconds


def kill(process: subprocess.Popen[bytes]) -> None:
    """End a study at once, and wait until nothing is left of it."""
    process.kill()
    process.communicate()
    soon(lambda: not session(process.pid))


def killed_after(here: Path, number: int, *words: object) -> None:
    """Kill a study of `in` with nothing in `out` once its ledger has so many lines."""
    shutil.rmtree(here / "out")
    process = begun(Path("in"), Path("out"), *words, cwd=here)
    soon(lambda: lines(here / "out") >= number)
    kill(process)


def session(leader: int) -> list[str]:
    """Processes that a run started and that still live: those of its session (the 6th field, proc(5))."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, number = path.read_text().rpartition(")")[2].split()[:4]
            found += [path.parent.name] if int(number) == leader and state != "Z" else []
    return found


def lines(out: Path) -> int:
    """Recordings in the ledger, once for each round."""
    ledger = out / "study.ledger"
    return ledger.read_text().count('"row"') if ledger.exists() else 0
