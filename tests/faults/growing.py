"""What must hold after a fault in `watch`, whose outputs are behind its input by design (docs/watch.md).

Rows and events are those of an undisturbed watch at an earlier moment. Another watch, with rows in a file of
its own, ends as an undisturbed one.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from tests.faults.checks import NOT_REMOVED, Contents, TrialFolder, contents
from tests.faults.scenarios import Scenario
from tests.faults.shim import Fault, Runner, Struck


def trial_folder(scenario: Scenario, folder: Path, runner: Runner) -> TrialFolder:
    """The folder in which a command is tried."""
    return (WatchTrialFolder if scenario.rows else TrialFolder)(scenario, folder, runner)


class WatchTrialFolder(TrialFolder):
    """A folder in which a watch fails, and another one follows."""

    def _wrong_ending(self, struck: Struck) -> Iterator[str]:
        yield from super()._wrong_ending(struck)
        if not self.said.startswith(struck.ran.out):
            yield "told what an undisturbed watch does not"

    def _wrong_files(self, fault: Fault, struck: Struck) -> Iterator[str]:
        found, ends = contents(self.folder / "out"), rows_of(self.undisturbed, self._more)
        try:
            rows = rows_of(found, self.scenario.rows)
        except (OSError, ValueError) as error:
            yield f"{self.scenario.rows} is torn ({error})"
            return
        if rows != ends[: len(rows)]:
            yield "there are other rows"
        if struck.ran.code == self.scenario.code and rows != ends:
            yield "ended well, but rows differ"
        if found.keys() - {self.scenario.rows, *self.before}:
            yield f"{sorted(found)} were left"
        if fault.operation not in NOT_REMOVED and any((self.folder / "tmp").iterdir()):
            yield "temporary files were left"

    def _rerun(self, fault: Fault, struck: Struck) -> None:
        """Watch again, if that was not done before beside the same."""
        left = contents(self.folder / "out")
        if left in self._mended:
            return
        shown = f"{self.scenario.name}, {fault}: {struck}"
        assert self._finish().ran.out == self.said, f"other events; {shown}"
        rows = rows_of(contents(self.folder / "out"), self._more)
        assert rows == rows_of(self.undisturbed, self._more), f"other rows; {shown}"
        self._mended.append(left)

    @property
    def _more(self) -> str:
        """The rows of a rerun, and of the undisturbed run."""
        return Path(self.scenario.again[-1]).name


def rows_of(found: Contents, name: str) -> list[Any]:
    """The rows of a file that is whole; none where there is no file; raises ValueError or OSError."""
    held: Any = found.get(name)
    if held is None:
        return []
    if name.endswith(".csv"):
        if not held.endswith(b"\n"):
            raise ValueError("its last row is not complete")
        return held.decode().splitlines()[1:]
    with pa.ipc.open_stream(io.BytesIO(held)) as stream:
        return stream.read_all().to_pylist()
