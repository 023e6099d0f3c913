"""What a worker does with one recording, and what it tells of it."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from accelcal_cli.core.errors import AccelcalError, OutputError, printable
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.system import keep_freed_memory
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import Job, Progress, Request, Result
from accelcal_cli.study import summary
from accelcal_cli.study.records import Entry, Item, Stamp, Told, stamp

REFUSED = 4
BUG = 70
TELL_S = 0.2
STAGES = {"reading": 0.0, "writing": 0.5}
"""Where in the work a stage begins; each is half of it."""


@dataclass(frozen=True, slots=True)
class Common:
    """What the tasks of a study share.

    Attributes:
        out: folder of the study's outputs.
        asked: see `Entry`.
    """

    out: Path
    request: Request
    asked: str


class Doing(Protocol):
    """Something to do for one recording in one round; it can be pickled."""

    @property
    def item(self) -> Item:
        """The recording."""

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """What is remembered if it cannot be done."""


@dataclass(frozen=True, slots=True)
class Task:
    """One recording to calibrate.

    Attributes:
        out: folder of the study's outputs.
        asked: see `Entry`.
        said: how the user named the recording, if its path is another where the work is done.
    """

    item: Item
    out: Path
    request: Request
    asked: str
    said: Path | None = None

    @property
    def job(self) -> Job:
        """The item's job, with the name that its report gives the recording."""
        return self.item.job if self.said is None else replace(self.item.job, source=self.said)

    @property
    def common(self) -> Common:
        """What it shares with others."""
        return Common(self.out, self.request, self.asked)

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """See `Doing`."""
        item = self.item
        return Entry(item.name, item.stamps, self.asked, summary.failed(item, code, message), again=again)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a worker tells.

    Attributes:
        up_to_date: whether nothing had to be done.
        problems: code and message of each problem of the file.
        trace: the traceback of a bug in accelcal.
    """

    entry: Entry
    up_to_date: bool = False
    problems: tuple[str, ...] = ()
    trace: str | None = None


def calibrated(task: Task, told: Told) -> Answer:
    """Calibrate one recording; whatever happens is an answer."""
    return guarded(task, lambda: _calibrated(task, told))


def guarded(task: Doing, work: Callable[[], Answer]) -> Answer:
    """The work's answer, or what befell it."""
    keep_freed_memory()
    try:
        return work()
    except AccelcalError as error:
        again = isinstance(error, OutputError)
        return Answer(task.failure(error.exit_code, str(error), again=again))
    except MemoryError:
        message = f"{printable(task.item.source)}: there was not enough memory; use fewer --jobs"
        return Answer(task.failure(BUG, message, again=True))
    except Exception as error:
        message = " ".join(f"a bug in accelcal ({type(error).__name__}: {error})".split())
        return Answer(task.failure(BUG, message, again=False), trace=traceback.format_exc())


def _calibrated(task: Task, told: Told) -> Answer:
    result = calibrate(task.job, task.request, Parts(told).stage, task.item.source)
    line, outputs = row_of(task.item, task.common, result), outputs_of(task.item, task.common, result)
    entry = Entry(task.item.name, task.item.stamps, task.asked, line, outputs)
    return Answer(entry, result.up_to_date, problems_of(result))


def row_of(item: Item, common: Common, result: Result) -> dict[str, Any]:
    """A result's row in the summary."""
    code = REFUSED if result.outcome is Outcome.REFUSED else 0
    names = {
        "parquet": _under(common, result.job.parquet) if result.has_parquet else None,
        "report": _under(common, result.job.report),
    }
    shown = {kind: None if name is None else printable(name) for kind, name in names.items()}
    return summary.of_report(item, code, result.report, shown)


def outputs_of(item: Item, common: Common, result: Result) -> tuple[tuple[str, Stamp], ...]:
    """Name under OUT and stamp of each file of a result."""
    paths = [result.job.parquet] if result.has_parquet else []
    paths.append(result.job.report)
    if common.request.integers and item.job.integers.exists():
        paths.append(item.job.integers)
    found = [(_under(common, path), stamp(path)) for path in paths]
    return tuple((name, held) for name, held in found if held is not None)


def problems_of(result: Result) -> tuple[str, ...]:
    """Code and message of each problem of a result's file."""
    found = result.report["file_health"]["problems"]
    return tuple(f"{problem['code']}: {problem['message']}" for problem in found)


def _under(common: Common, path: Path) -> str:
    return path.relative_to(common.out).as_posix()


class Parts:
    """Turns the bytes of each stage into the part of the work that is done."""

    def __init__(self, told: Told) -> None:
        self._told = told
        self._next: Any = 0.0
        self._part = 0.0

    def stage(self, name: str, total: int) -> Progress:
        """See `ProgressMaker`; a stage that comes again shows only when it is further than before."""
        start = STAGES.get(name, 0.5)

        def moved(done: int) -> None:
            part = start + 0.5 * min(1.0, done / max(total, 1))
            if part > self._part and time.monotonic() >= self._next:
                self._next, self._part = time.monotonic() + TELL_S, part
                self._told(part)

        return moved
