"""Operations of the system that fail on purpose: `shim.c`, compiled and preloaded into the command.

A command is run in a process of its own, forked from one that has everything imported: a hundred runs take
some ten seconds.
"""

from __future__ import annotations

import errno
import json
import mmap
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from accelcal_cli.core.system import THREAD_VARIABLES
from tests.cli.run import Ran

HERE = Path(__file__).resolve().parent
OPERATIONS = (
    "open", "create", "read", "write", "fsync", "close", "rename", "unlink", "mkdir", "link", "truncate",
    "list", "stat", "fork", "thread",
)  # fmt: skip
"""In the order of the numbers in `shim.c`."""

SHORT = "short"
PATH_BYTES = 4096
LAYOUT = struct.Struct(f"=iiiiqq{8 * len(OPERATIONS)}s{PATH_BYTES}s{PATH_BYTES}s")
"""`struct plan` of `shim.c`: armed, operation, mode, error, nth, fired, counts, under, struck."""

LONGEST_S = 200
"""A run that takes longer hangs."""


@dataclass(frozen=True)
class Fault:
    """An operation that is to fail.

    Attributes:
        error: a name of `errno`, or `short` for half of the bytes.
        nth: which call of the operation, counted from 1; 0: none, they are only counted.
        on: whether all later ones fail, too.
        kills: whether all processes are killed instead, before the call of that number of any operation.
        below: a folder; only calls on what is below it fail.
    """

    operation: str
    error: str = "EIO"
    nth: int = 0
    on: bool = False
    kills: bool = False
    below: str = ""

    @property
    def number(self) -> int:
        """As `shim.c` has the error."""
        return -1 if self.error == SHORT else int(getattr(errno, self.error))


NONE = Fault(OPERATIONS[0])


@dataclass(frozen=True)
class Struck:
    """What came of a run: calls of each operation, how many failed, where the first did, what was opened."""

    ran: Ran
    calls: dict[str, int]
    failed: int
    place: str
    opened: tuple[str, ...] = field(repr=False)


def compiled(folder: Path) -> Path | None:
    """The shim; None where there is no compiler, or no Linux."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        return None
    shim = folder / "shim.so"
    words = [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", str(shim), str(HERE / "shim.c")]
    subprocess.run([*words, "-ldl"], check=True)
    return shim


class Runner:
    """A process that has everything imported, and forks one for each command."""

    def __init__(self, shim: Path | None, folder: Path, *, forked: bool = False) -> None:
        """Start it.

        Args:
            shim: None: nothing fails, and what is opened is not written down.
            folder: for the plan and what commands print; no operation on it fails.
            forked: whether workers are forked from a command itself, in milliseconds, and not from a server
                that has to import everything.
        """
        self.shim, self.folder = shim, folder
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "plan").write_bytes(bytes(LAYOUT.size))
        (folder / "opened").touch()
        names = {"ACCELCAL_FAULTS": str(folder / "plan"), "ACCELCAL_OPENED": str(folder / "opened")}
        environment = os.environ | ({"LD_PRELOAD": str(shim)} if shim else {}) | names
        environment |= dict.fromkeys(THREAD_VARIABLES, "1") | ({"ACCELCAL_FORKED": "1"} if forked else {})
        words = [sys.executable, "-m", "tests.faults.runner", str(folder)]
        self.process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, cwd=HERE.parent.parent
        )

    def run(self, words: Sequence[str], here: Path, fault: Fault = NONE, *, limit_s: int = 0) -> Struck:
        """Run a command in a folder, below which an operation fails.

        Args:
            limit_s: so many seconds of a processor, with the memory and files of `runner.py`; 0: no limits.
        """
        (self.folder / "opened").write_bytes(b"")
        mode = 2 if fault.kills else int(fault.on)
        plan = (0, OPERATIONS.index(fault.operation), mode, fault.number, fault.nth, 0)
        with (self.folder / "plan").open("r+b") as file:
            file.write(LAYOUT.pack(*plan, b"", os.fsencode(here / fault.below), b""))
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps([list(words), str(here), limit_s]).encode() + b"\n")
        self.process.stdin.flush()
        code = int(self.process.stdout.readline())
        *_, failed, counts, _, place = LAYOUT.unpack((self.folder / "plan").read_bytes())
        calls = dict(zip(OPERATIONS, struct.unpack(f"={len(OPERATIONS)}q", counts), strict=True))
        texts = [(self.folder / name).read_text("utf-8", "replace") for name in ("out", "err")]
        opened = tuple((self.folder / "opened").read_text("utf-8", "surrogateescape").splitlines())
        return Struck(Ran(code, *texts), calls, failed, place.split(b"\0")[0].decode(), opened)

    def close(self) -> None:
        """End it."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()
        self.process.wait()


@contextmanager
def running(folder: Path, *, forked: bool = False) -> Iterator[Runner | None]:
    """A runner; None where the shim cannot be made."""
    folder.mkdir(parents=True, exist_ok=True)
    shim = compiled(folder)
    runner = None if shim is None else Runner(shim, folder / "runner", forked=forked)
    try:
        yield runner
    finally:
        if runner is not None:
            runner.close()


def arm(plan: Path, armed: bool) -> None:
    """Let operations fail from now on, or no more."""
    with plan.open("r+b") as file, mmap.mmap(file.fileno(), 4) as place:
        place[:] = struct.pack("=i", armed)
