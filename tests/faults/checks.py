"""What must hold after any fault, and after a rerun without one."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.scenarios import Scenario
from tests.faults.shim import OPERATIONS, SHORT, Fault, Runner, Struck

ABORTED = -6
CODES = (1, 2, 3, 5, 71)
"""Exit codes that a fault may have (docs/outputs.md): 2 where what an option names cannot be read."""

LOCK = "study.lock"
"""May stay where a fault keeps it from being removed: the next run sees that its process is gone."""

NOT_REMOVED = ("unlink", "list", "open", "close")
"""What fails where a temporary folder cannot be removed."""

PLACES = ("out/", "in/", "tmp", "threads")
REPORT, TABLE = "good.calibration.json", "good.calibrated.parquet"
Contents = dict[str, object]

ERRORS: dict[str, tuple[str, ...]] = {
    "open": ("EIO", "EMFILE"),
    "create": ("ENOSPC", "EACCES"),
    "read": ("EIO", "EINTR", SHORT),
    "write": ("ENOSPC", "ENOSPC, lasting", "EIO", "EINTR", SHORT),
    "fsync": ("EIO", "ENOSPC", "EINTR"),
    "close": ("EIO",),
    "rename": ("EIO", "ENOSPC"),
    "unlink": ("EIO",),
    "mkdir": ("ENOSPC",),
    "link": ("EIO",),
    "truncate": ("ENOSPC",),
    "list": ("EIO",),
    "fork": ("EAGAIN", "ENOMEM"),
    "thread": ("EAGAIN",),
}
"""The errors that each operation is made to fail with."""


def faults(operation: str, calls: int, most: int | None) -> Iterator[tuple[str, Fault]]:
    """The faults of an operation that is called so often, each with the name of its error.

    Args:
        most: of so many calls, spread over all; None: of every one.
    """
    numbers = range(1, calls + 1)
    if most is not None and calls > most:
        numbers = sorted({1 + index * (calls - 1) // (most - 1) for index in range(most)})
    for name in ERRORS[operation]:
        error, _, lasting = name.partition(", ")
        yield from ((name, Fault(operation, error, nth, bool(lasting))) for nth in numbers)


def contents(folder: Path) -> Contents:
    """All files below a folder by name, reports without provenance; without the ledger, which knows times."""
    found: Contents = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix != ".ledger":
            held: object = path.read_bytes()
            if path.name.endswith(".json"):
                held = json.loads(path.read_text())
                if isinstance(held, dict):
                    held.pop("provenance", None)
            found[path.relative_to(folder).as_posix()] = held
    return found


@dataclass
class Stage:
    """A folder in which one command is run again and again, each time as if for the first time."""

    scenario: Scenario
    folder: Path
    runner: Runner
    undisturbed: Contents = field(default_factory=dict)
    inputs: Contents = field(default_factory=dict)
    before: Contents = field(default_factory=dict)
    calls: dict[str, int] = field(default_factory=dict)
    _mended: list[Contents] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Make the inputs, and see what comes of them undisturbed."""
        for name in ("in", "out", "tmp"):
            (self.folder / name).mkdir(parents=True)
        self.scenario.make(self.folder)
        self.inputs, self.before = contents(self.folder / "in"), contents(self.folder / "out")
        shutil.copytree(self.folder / "out", self.folder / "before")
        self.calls = self._finish()
        self.undisturbed = contents(self.folder / "out")

    def strike(self, fault: Fault) -> Struck:
        """Run with a fault, and again without; raises AssertionError if anything is not as it must be."""
        self._reset()
        struck = self._run(fault)
        if struck.failed:
            wrong = [*self._wrong_ending(struck), *self._wrong_files(fault, struck)]
            assert not wrong, f"{self.scenario.name}, {fault}: {'; '.join(wrong)}; {struck}"
            assert contents(self.folder / "in") == self.inputs, fault
            self._rerun(fault, struck)
        return struck

    def _reset(self) -> None:
        for name in ("out", "tmp"):
            shutil.rmtree(self.folder / name)
        shutil.copytree(self.folder / "before", self.folder / "out")
        (self.folder / "tmp").mkdir()

    def _run(self, fault: Fault, *more: str) -> Struck:
        return self.runner.run((*self.scenario.words, *more), self.folder, fault)

    def _finish(self) -> dict[str, int]:
        """Run without a fault; how often each operation was called."""
        struck = self._run(Fault(OPERATIONS[0]), *self.scenario.again)
        assert struck.ran.code == 0, struck
        return struck.calls

    def _rerun(self, fault: Fault, struck: Struck) -> None:
        """Run again over what is left, if that was not done before over the same."""
        left = contents(self.folder / "out")
        if left in self._mended and not self.scenario.forks:
            return
        self._finish()
        wrong = differences(contents(self.folder / "out"), self.undisturbed)
        assert not wrong, f"{self.scenario.name}, {fault}: after a rerun {wrong} differ; {struck}"
        self._mended.append(left)

    def _wrong_ending(self, struck: Struck) -> Iterator[str]:
        """What is wrong with the exit code and with what is said."""
        ran = struck.ran
        if ran.code in (0, ABORTED):
            return
        if ran.code not in CODES:
            yield f"exit code {ran.code}"
        if "Traceback" in ran.err or "bug in accelcal" in ran.err:
            yield "told as a bug"
        if not self.scenario.forks and ran.err.count("\n") != 1:
            yield "not told in one line"
        if not self.scenario.forks and not any(place in ran.err for place in PLACES):
            yield "told without a path"

    def _wrong_files(self, fault: Fault, struck: Struck) -> Iterator[str]:
        """What is wrong with the files that are there."""
        found, code = contents(self.folder / "out"), struck.ran.code
        if code == ABORTED:
            assert fault.operation == "thread"
            return
        left = {name for name in found if name == LOCK or self._not_removed(name, fault)}
        if code == 0 and (wrong := differences(found, self.undisturbed) - left):
            yield f"ended well, but {sorted(wrong)} differ"
        for name in sorted(found.keys() - {LOCK}):
            if not self._whole(name, found[name], fault):
                yield f"{name} is torn, or was left"
        if fault.operation not in NOT_REMOVED and any((self.folder / "tmp").iterdir()):
            yield "temporary files were left"
        if not self._paired(found):
            yield "the report is not that of the Parquet file"

    def _whole(self, name: str, held: object, fault: Fault) -> bool:
        """Whether a file is as it was or as it shall be; tables of a study may hold a part of the rows."""
        if self.scenario.forks and name.startswith("study."):
            return True
        known = (self.undisturbed.get(name), self.before.get(name))
        return held in known or self._not_removed(name, fault)

    def _not_removed(self, name: str, fault: Fault) -> bool:
        """Whether a temporary file is there because it could not be removed."""
        return fault.operation == "unlink" and name.endswith((".tmp", ".claim"))

    def _paired(self, found: Contents) -> bool:
        """Whether a report lies beside the Parquet file that it speaks of."""
        if REPORT not in found or TABLE not in self.undisturbed:
            return True
        own = self.undisturbed if found[REPORT] == self.undisturbed[REPORT] else self.before
        return found.get(TABLE) == own.get(TABLE)


def differences(found: Contents, wanted: Contents) -> set[str]:
    """Names of files that are not the same, or only on one side."""
    return {name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name)}
