"""What must hold after any fault, and after a rerun without one."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from tests.faults.scenarios import Scenario
from tests.faults.shim import OPERATIONS, SHORT, Fault, Runner, Struck

CODES = (1, 2, 3, 5, 71)
"""Exit codes that a fault may have (docs/outputs.md): 2 where what an option names cannot be read."""

LOCK = ".lock"
"""Of a study or a part of one; may stay where a fault keeps it from being removed: the next run sees that its
process is gone."""

NOT_REMOVED = ("unlink", "list", "open", "close")
"""What fails where a temporary folder cannot be removed."""

Cells = dict[tuple[str, str, str], set[int]]
"""Exit codes by operation, error and command."""

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


@dataclass
class Tried:
    """What came of making the calls of a command fail in turn.

    Attributes:
        runs: how many there were; struck: in how many of them a call failed.
        wrong: what was not as it must be.
    """

    cells: Cells = field(default_factory=dict)
    runs: int = 0
    struck: int = 0
    wrong: list[str] = field(default_factory=list)

    def each(self, stage: TrialFolder, most: int | None) -> None:
        """Let calls of each operation of a command fail, at most so many of each; note what comes of it."""
        scenario = stage.scenario
        most = min((one for one in (most, scenario.most) if one is not None), default=None)
        for operation, errors in ERRORS.items():
            for error, fault in faults(operation, stage.calls[operation], most):
                self.runs += 1
                try:
                    struck = stage.strike(fault)
                except AssertionError as failure:
                    self.wrong.append(str(failure))
                else:
                    self._note((operation, error, scenario.command), struck)
            self.wrong += [
                f"{scenario.name}: {operation} was called {stage.calls[operation]} times, and never failed"
                for error in errors
                if stage.calls[operation] and (operation, error, scenario.command) not in self.cells
            ]

    def _note(self, place: tuple[str, str, str], struck: Struck) -> None:
        if struck.failed:
            self.struck += 1
            self.cells.setdefault(place, set()).add(struck.ran.code)


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
class TrialFolder:
    """A folder in which one command is run again and again, each time as if for the first time."""

    scenario: Scenario
    folder: Path
    runner: Runner
    undisturbed: Contents = field(default_factory=dict)
    inputs: Contents = field(default_factory=dict)
    before: Contents = field(default_factory=dict)
    said: str = ""
    calls: dict[str, int] = field(default_factory=dict)
    _mended: list[Contents] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Make the inputs, and see what comes of them undisturbed."""
        for name in ("in", "out", "tmp"):
            (self.folder / name).mkdir(parents=True)
        self.scenario.make(self.folder)
        self.inputs, self.before = contents(self.folder / "in"), contents(self.folder / "out")
        shutil.copytree(self.folder / "out", self.folder / "before")
        whole = self._finish()
        self.calls, self.said = whole.calls, whole.ran.out
        self.undisturbed = contents(self.folder / "out")

    def strike(self, fault: Fault) -> Struck:
        """Run with a fault, and again without; raises AssertionError if anything is not as it must be.

        Where the call did not come (`failed` is 0), as may be with threads, nothing was tried.
        """
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

    def _finish(self) -> Struck:
        """Run without a fault."""
        struck = self._run(Fault(OPERATIONS[0]), *self.scenario.again)
        assert struck.ran.code == self.scenario.code, struck
        return struck

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
        lost = self.scenario.parts and lost_a_part(contents(self.folder / "out"))
        if ran.code == self.scenario.code and ran.out != self.said and not lost:
            yield "ended well, but said something else"
        if ran.code == self.scenario.code:
            return
        if ran.code not in CODES and not lost:
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
        left = {name for name in found if name.endswith(LOCK) or self._not_removed(name, fault)}
        if self.scenario.parts and lost_a_part(found):
            return
        if code == self.scenario.code and (wrong := differences(found, self.undisturbed) - left):
            yield f"ended well, but {sorted(wrong)} differ"
        for name in sorted(found):
            if not name.endswith(LOCK) and not self._whole(name, found[name], fault):
                yield f"{name} is torn, or was left"
        if fault.operation not in NOT_REMOVED and any((self.folder / "tmp").iterdir()):
            yield "temporary files were left"
        if not self._paired(found):
            yield "the report is not that of the Parquet file"

    def _whole(self, name: str, held: object, fault: Fault) -> bool:
        """Whether a file is as it was or as it shall be; what is of a whole study may lack recordings."""
        if name.startswith("study."):
            return whole_table(name, held)
        if name.endswith(".jsonl") and isinstance(held, bytes):  # results that cannot be read cost themselves
            whole = self.undisturbed[name]
            return isinstance(whole, bytes) and set(held.splitlines(True)) <= set(whole.splitlines(True))
        known = (self.undisturbed.get(name), self.before.get(name))
        return held in known or self._not_removed(name, fault)

    def _not_removed(self, name: str, fault: Fault) -> bool:
        """Whether a temporary file is there because it could not be removed."""
        return fault.operation == "unlink" and name.endswith(".tmp")

    def _paired(self, found: Contents) -> bool:
        """Whether a report lies beside the Parquet file that it speaks of."""
        if REPORT not in found:
            return True
        own = self.undisturbed if found[REPORT] == self.undisturbed[REPORT] else self.before
        return found.get(TABLE) == own.get(TABLE)


def differences(found: Contents, wanted: Contents) -> set[str]:
    """Names of files that are not the same, or only on one side."""
    return {name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name)}


def lost_a_part(found: Contents) -> bool:
    """Whether a report says that a part of the recording could not be read, beside the rows of the others."""
    report: Any = found.get("parts.calibration.json")
    if report is None or all(one["code"] != "unreadable_part" for one in report["file_health"]["problems"]):
        return False
    table: Any = found.get("parts.calibrated.parquet")
    if table is None:
        return bool(report["outcome"] == "refused")
    assert pq.read_metadata(pa.BufferReader(table)).num_rows == report["recording"]["samples"]
    return True


def whole_table(name: str, held: Any) -> bool:
    """Whether a table or page of a study is complete, whatever rows it has; JSON was read before."""
    if name.endswith(".parquet"):
        return bool(pq.read_table(pa.BufferReader(held)).num_columns)
    if name.endswith(".csv"):
        head, *rows = csv.reader(io.StringIO(held.decode()))
        return bool(held.endswith(b"\n")) and {len(row) for row in rows} <= {len(head)}
    return not name.endswith(".html") or bool(held.rstrip().endswith(b"</html>"))
