"""What flows between the parts of a study: its files, their results, tasks and those who carry them out."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from accelcal_cli.pipeline.jobs import FileStamp, Job
from accelcal_cli.pipeline.options import StatedOption

FAILED = "failed"
"""The summary's outcome of a recording that gave no report."""

OWN = "own"
"""The first round of a study: each recording's own result."""


@dataclass(frozen=True, slots=True)
class Item:
    """A file of the study.

    Attributes:
        name: its place under OUT with its full file name, `/` between folders: what it is known by.
        stamps: its own stamp, and those of the files beside it that may describe it; None for none. Then
            that of what files state of how it is read, where they state something.
        refusal: why nothing can be done with it, found before any work.
        aside: not to be started now, since `--include` does not name it.
        choices: what files state of how it is read.
    """

    name: str
    job: Job
    stamps: tuple[FileStamp | None, ...]
    refusal: str | None = None
    aside: bool = False
    choices: tuple[StatedOption, ...] = ()

    @property
    def source(self) -> Path:
        """The file."""
        return self.job.source

    @property
    def size(self) -> int:
        """Bytes; 0 where it cannot be looked at."""
        return 0 if self.stamps[0] is None else self.stamps[0][0]

    @property
    def changed_s(self) -> float:
        """When it was last changed [s since 1970]."""
        return 0.0 if self.stamps[0] is None else self.stamps[0][1] / 1e9


@dataclass(frozen=True, slots=True)
class Entry:
    """What became of an item in one round; a line of the ledger.

    Attributes:
        stamps: the item's when it was worked on.
        asked: a hash of the settings and the version.
        row: its row in the summary; None for a file that is no recording.
        outputs: name under OUT and stamp of each file written.
        again: whether it must be tried again, because the fault was not in the recording.
        round: the round that it is of.
        inputs: identities of what else the result was made of, in the order in which it was looked at.
    """

    name: str
    stamps: tuple[FileStamp | None, ...]
    asked: str
    row: dict[str, Any] | None
    outputs: tuple[tuple[str, FileStamp], ...] = ()
    again: bool = False
    round: str = OWN
    inputs: tuple[str, ...] = ()

    @property
    def failed(self) -> bool:
        """Whether it gave no report."""
        return self.row is not None and self.row["outcome"] == FAILED


@dataclass(frozen=True, slots=True)
class RecordingState:
    """What is known of a recording after some rounds: its own result, and the last one."""

    item: Item
    own: Entry
    last: Entry


ProgressCallback = Callable[[float], None]
"""Called where the work is done with the part of its task that is done, 0 to 1."""

TaskFunction = Callable[[Any, ProgressCallback], Any]
"""What is done with a task; a function of a module, and its task and answer can be pickled."""

ProgressDelta = Callable[[Any, float], None]
"""Called with a task and by how much more of it is done; less than 0 where it begins anew."""


@dataclass(frozen=True, slots=True)
class Finished:
    """One task that ended.

    Attributes:
        result: what the work returned; None if the worker ended before that.
        fault: what happened to the worker, else None.
        retry: whether the fault may lie in the machine and not in the task.
        lacking: whether the machine had not enough of something.
    """

    task: Any
    result: Any = None
    fault: str | None = None
    retry: bool = False
    lacking: bool = False


class Executor(Protocol):
    """Does tasks, several at a time; the failure of one does not affect the others."""

    def run(self, tasks: list[Any]) -> Generator[Finished, None, None]:
        """Do all tasks; yields each as it ends. Nothing is left running when the iteration is given up."""
