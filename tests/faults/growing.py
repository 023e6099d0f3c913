"""What must hold after a fault in `watch`, whose outputs are behind its input by design (docs/watch.md).

The state, the rows and what was told are those of an undisturbed watch at an earlier moment, and the state
knows of no rows that are not there. Going on, with rows in a file of its own, ends as an undisturbed watch.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from tests.faults.checks import NOT_REMOVED, Contents, Stage, contents
from tests.faults.scenarios import Scenario
from tests.faults.shim import Fault, Runner, Struck

STATE = "state"


def staged(scenario: Scenario, folder: Path, runner: Runner) -> Stage:
    """The stage on which a command is tried."""
    return (GrowingStage if scenario.rows else Stage)(scenario, folder, runner)


class GrowingStage(Stage):
    """A folder in which a watch fails, and goes on."""

    def _wrong_ending(self, struck: Struck) -> Iterator[str]:
        yield from super()._wrong_ending(struck)
        if not self.said.startswith(struck.ran.out):
            yield "told what an undisturbed watch does not"

    def _wrong_files(self, fault: Fault, struck: Struck) -> Iterator[str]:
        found, ends = contents(self.folder / "out"), self._ends()
        try:
            rows = rows_of(found, self.scenario.rows)
        except (OSError, ValueError) as error:
            yield f"{self.scenario.rows} is torn ({error})"
            return
        if rows != ends[: len(rows)]:
            yield "there are other rows"
        if self._begin(found) > len(rows):
            yield "the state knows of rows that are not there"
        if struck.ran.code == self.scenario.code and (rows, found.get(STATE)) != (
            ends,
            self.undisturbed.get(STATE),
        ):
            yield "ended well, but rows or state differ"
        for name in found.keys() - {STATE, self.scenario.rows, *self.before}:
            if not self._not_removed(name, fault):
                yield f"{name} was left"
        if fault.operation not in NOT_REMOVED and any((self.folder / "tmp").iterdir()):
            yield "temporary files were left"

    def _rerun(self, fault: Fault, struck: Struck) -> None:
        """Go on, if that was not done before from the same."""
        left, told = contents(self.folder / "out"), struck.ran.out.splitlines()
        if {**left, "told": told} in self._mended:
            return
        said, events = self.said.splitlines(), self._finish().ran.out.splitlines()
        found = contents(self.folder / "out")
        shown = f"{self.scenario.name}, {fault}: {struck}"
        assert rows_of(found, self._more) == self._ends()[self._begin(left) :], f"other rows; {shown}"
        assert found.get(STATE) == self.undisturbed.get(STATE), f"another state; {shown}"
        assert events == said[-len(events) :], f"other events; {shown}"
        assert len(told) + len(events) >= len(said), f"lost events; {shown}"
        self._mended.append({**left, "told": told})

    @property
    def _more(self) -> str:
        """The rows of a rerun, and of the undisturbed run."""
        return Path(self.scenario.again[-1]).name

    def _ends(self) -> list[Any]:
        """The rows of an undisturbed run."""
        return rows_of(self.undisturbed, self._more)

    def _begin(self, found: Contents) -> int:
        """How many of them a state knows of."""
        ends = self._ends()
        if STATE not in found:
            return 0
        return max(0, sample_of(found) - (sample_of(self.undisturbed) - len(ends)))


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


def sample_of(found: Contents) -> int:
    """How many samples a state knows of."""
    held: Any = found.get(STATE)
    return 0 if held is None else int(json.loads(held.split(b"\n", 1)[0])["samples"])
