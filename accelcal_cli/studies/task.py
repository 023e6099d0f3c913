"""What a worker does with one recording, and the result that it returns."""

from __future__ import annotations

import functools
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from accelcal_cli.core.errors import (
    AccelcalError,
    OutputError,
    cause_of_kind,
    is_environment_error,
    missing_resource,
    printable,
)
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.system import keep_freed_memory
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import FileStamp, Job, Progress, Request, Result, file_stamp
from accelcal_cli.pipeline.outputs import applied_by_hand
from accelcal_cli.studies import summary
from accelcal_cli.studies.records import Entry, Item, ProgressCallback

REFUSED = 4
BUG = 70
NO_MEMORY = 71
REPORT_S = 0.2
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


class Task(Protocol):
    """Something to do for one recording in one round; it can be pickled."""

    @property
    def item(self) -> Item:
        """The recording."""

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """What is remembered if it cannot be done."""


@dataclass(frozen=True, slots=True)
class CalibrationTask:
    """One recording to calibrate.

    Attributes:
        named: how the user named the recording, if its path is another where the work is done.
    """

    item: Item
    common: Common
    named: Path | None = None

    @property
    def job(self) -> Job:
        """The item's job, with the name that its report gives the recording."""
        return self.item.job if self.named is None else replace(self.item.job, source=self.named)

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """See `Task`."""
        item, row = self.item, summary.failed(self.item, code, message)
        return Entry(item.name, item.stamps, self.common.asked, row, again=again)


@dataclass(frozen=True, slots=True)
class TaskResult:
    """What a worker reports.

    Attributes:
        up_to_date: whether nothing had to be done.
        problems: code and message of each problem of the file.
        trace: the traceback of a bug in accelcal.
    """

    entry: Entry
    up_to_date: bool = False
    problems: tuple[str, ...] = ()
    trace: str | None = None


AnyTask = TypeVar("AnyTask", bound="Task")
Work = Callable[[AnyTask, ProgressCallback], TaskResult]


def guarded(work: Work[AnyTask]) -> Work[AnyTask]:
    """Work that returns a result whatever happens, unless the process is to end."""

    @functools.wraps(work)
    def guarded_work(task: AnyTask, report_progress: ProgressCallback) -> TaskResult:
        keep_freed_memory()
        try:
            return work(task, report_progress)
        except Exception as error:
            if (end := cause_of_kind(error, SystemExit)) is not None:
                raise end from None
            return _failed(task, error)

    return guarded_work


def _failed(task: Task, error: Exception) -> TaskResult:
    if isinstance(error, AccelcalError):
        again = isinstance(error, OutputError) or is_environment_error(error)
        return TaskResult(task.failure(error.exit_code, str(error), again=again))
    if (lack := missing_resource(error)) is not None:
        message = f"{printable(task.item.source)}: {lack}; use fewer --jobs"
        return TaskResult(task.failure(NO_MEMORY, message, again=True))
    message = printable(" ".join(f"a bug in accelcal ({type(error).__name__}: {error})".split()))
    return TaskResult(task.failure(BUG, message, again=False), trace=traceback.format_exc())


@guarded
def calibrated(task: CalibrationTask, report_progress: ProgressCallback) -> TaskResult:
    """Calibrate one recording; coefficients that were applied to it by hand stay."""
    request, source = task.common.request, task.item.source
    kept = None if request.force else applied_by_hand(task.job, source)
    result = kept or calibrate(task.job, request, StageProgress(report_progress).stage, source)
    line, outputs = row_of(task.item, task.common, result), outputs_of(task.item, task.common, result)
    entry = Entry(task.item.name, task.item.stamps, task.common.asked, line, outputs)
    return TaskResult(entry, result.up_to_date, problems_of(result))


def row_of(item: Item, common: Common, result: Result) -> dict[str, Any]:
    """A result's row in the summary."""
    code = REFUSED if result.outcome is Outcome.REFUSED else 0
    names = {
        "parquet": None if result.parquet is None else _under(common, result.parquet),
        "report": _under(common, result.job.report),
    }
    shown = {kind: None if name is None else printable(name) for kind, name in names.items()}
    return summary.of_report(item, code, result.report, shown)


def outputs_of(item: Item, common: Common, result: Result) -> tuple[tuple[str, FileStamp], ...]:
    """Name under OUT and stamp of each file of a result."""
    paths = [path for path in (result.parquet, result.job.report) if path is not None]
    if common.request.integers and item.job.integers.exists():
        paths.append(item.job.integers)
    stamps = [(_under(common, path), file_stamp(path)) for path in paths]
    return tuple((name, stamp) for name, stamp in stamps if stamp is not None)


def problems_of(result: Result) -> tuple[str, ...]:
    """Code and message of each problem of a result's file."""
    problems = result.view.file_health.problems
    return tuple(f"{problem.code}: {problem.message}" for problem in problems)


@dataclass(frozen=True, slots=True)
class ReplacementTask:
    """One recording whose own result may give way to one with coefficients found elsewhere.

    Attributes:
        own: its own result.
        inputs: identities of its own result and of all else that decides, in the order in which it is used.
        round: by which its entries are known.
        refusal: what the message of a row says before the reason why the own result stays.
    """

    item: Item
    common: Common
    own: Entry
    inputs: tuple[str, ...]
    round: ClassVar[str]
    refusal: ClassVar[str]

    @property
    def names(self) -> tuple[str, ...]:
        """See `RoundTask`."""
        return (self.item.name,)

    @property
    def own_row(self) -> dict[str, Any]:
        """The row of the own result."""
        assert self.own.row is not None
        return self.own.row

    def stands(self, entry: Entry) -> bool:
        """See `RoundTask`."""
        return entry.inputs == self.inputs

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """See `Task`: the own result stays, if it is still there."""
        if all(file_stamp(self.common.out / name) == before for name, before in self.own.outputs):
            return self.entry(self.kept(message), self.own.outputs, again=again)
        return self.entry(summary.failed(self.item, code, message), (), again=True)

    def entry(
        self,
        row: dict[str, Any],
        outputs: tuple[tuple[str, FileStamp], ...],
        inputs: tuple[str, ...] | None = None,
        *,
        again: bool = False,
    ) -> Entry:
        """What is remembered of the round; `inputs` if not all were needed."""
        item, used = self.item, self.inputs if inputs is None else inputs
        return Entry(item.name, item.stamps, self.common.asked, row, outputs, again, self.round, used)

    def kept(self, why: str) -> dict[str, Any]:
        """The own result's row, and why it stays."""
        return {**self.own_row, "message": f"{self.own_row['message']}; {self.refusal}: {why}"}

    def result(
        self, result: Result, row: dict[str, Any], inputs: tuple[str, ...] | None = None
    ) -> TaskResult:
        """What the worker returns."""
        entry = self.entry(row, outputs_of(self.item, self.common, result), inputs)
        return TaskResult(entry, result.up_to_date, problems_of(result))


def _under(common: Common, path: Path) -> str:
    return path.relative_to(common.out).as_posix()


class StageProgress:
    """Turns the bytes of each stage into the part of the work that is done."""

    def __init__(self, report_progress: ProgressCallback) -> None:
        self.report_progress = report_progress
        self._next: Any = 0.0
        self._part = 0.0

    def stage(self, name: str, total: int) -> Progress:
        """See `ProgressMaker`; a stage that comes again shows only when it is further than before."""
        start = STAGES.get(name, 0.5)

        def moved(done: int) -> None:
            part = start + 0.5 * min(1.0, done / max(total, 1))
            if part > self._part and time.monotonic() >= self._next:
                self._next, self._part = time.monotonic() + REPORT_S, part
                self.report_progress(part)

        return moved
