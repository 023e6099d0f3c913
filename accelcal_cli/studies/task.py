"""The work on one recording, which a worker does, and the result that it returns."""

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
    UnreadableError,
    cause_of_kind,
    disk_fault,
    is_environment_error,
    missing_resource,
    printable,
)
from accelcal_cli.core.formats import EACH
from accelcal_cli.core.paths import is_file
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.quality import wear_hours
from accelcal_cli.output.report_reading import load_our_json
from accelcal_cli.output.sentences import kept
from accelcal_cli.pipeline.jobs import FileStamp, Job, Progress, Request, Result, file_stamp
from accelcal_cli.pipeline.outputs import applied_by_hand
from accelcal_cli.pipeline.registry import calibrate
from accelcal_cli.studies import summary
from accelcal_cli.studies.records import Entry, Item, ProgressCallback

REFUSED, BUG, NO_MEMORY, INTERRUPTED = 4, 70, 71, 130
"""Exit codes in rows of the summary."""

REPORT_S = 0.2
"""Shortest interval [s] at which a worker reports progress."""

STAGES = {"reading": 0.0, "writing": 0.5}
"""Part of the work before each stage, which is half of it."""


@dataclass(frozen=True, slots=True)
class Common:
    """Settings that the tasks of a study share.

    Attributes:
        out: folder of the study's outputs.
        asked: see `Entry`.
    """

    out: Path
    request: Request
    asked: str

    def request_for(self, item: Item) -> Request:
        """Return the request for a recording, which may be one of the sensors of its file."""
        options = self.request.options
        if options.sensor == EACH:  # a file of one sensor has none to choose
            options = replace(options, sensor=item.sensor)
        return replace(self.request, options=options, each=item.sensor)


class Task(Protocol):
    """The work on one recording in one round; it can be pickled."""

    @property
    def item(self) -> Item:
        """The recording to work on."""

    @property
    def sources(self) -> tuple[Path, ...]:
        """Paths of the recording, which the message of a failure leaves out."""

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """Return the entry that is kept if the work fails."""


@dataclass(frozen=True, slots=True)
class CalibrationTask:
    """One recording to calibrate.

    Attributes:
        named: path of the recording as the user gave it, if the work is done with another one.
    """

    item: Item
    common: Common
    named: Path | None = None

    @property
    def job(self) -> Job:
        """The item's job, with the path that the report names."""
        return self.item.job if self.named is None else replace(self.item.job, source=self.named)

    @property
    def sources(self) -> tuple[Path, ...]:
        """See `Task`."""
        return self.item.source, self.job.source

    def failure(self, code: int, message: str, *, again: bool) -> Entry:
        """See `Task`."""
        item, row = self.item, summary.failed(self.item, code, message)
        return Entry(item.name, item.stamps, self.common.asked, row, again=again)


@dataclass(frozen=True, slots=True)
class TaskResult:
    """The result that a worker returns.

    Attributes:
        up_to_date: whether nothing had to be done.
        problems: code and message of each problem of the file.
        trace: traceback of a bug in accelcal.
    """

    entry: Entry
    up_to_date: bool = False
    problems: tuple[str, ...] = ()
    trace: str | None = None


AnyTask = TypeVar("AnyTask", bound="Task")
Work = Callable[[AnyTask, ProgressCallback], TaskResult]


def guarded(work: Work[AnyTask]) -> Work[AnyTask]:
    """Decorate work so that it returns a result whatever happens, unless the process is to end."""

    @functools.wraps(work)
    def guarded_work(task: AnyTask, report_progress: ProgressCallback) -> TaskResult:
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
        return TaskResult(task.failure(error.exit_code, error.line_for(task.sources), again=again))
    if (lack := missing_resource(error)) is not None:
        return TaskResult(task.failure(NO_MEMORY, f"{lack}; use fewer --jobs", again=True))
    if (fault := disk_fault(error)) is not None:
        return TaskResult(task.failure(UnreadableError.exit_code, fault, again=True))
    message = printable(" ".join(f"a bug in accelcal ({type(error).__name__}: {error})".split()))
    return TaskResult(task.failure(BUG, message, again=False), trace=traceback.format_exc())


@guarded
def calibrated(task: CalibrationTask, report_progress: ProgressCallback) -> TaskResult:
    """Calibrate one recording; coefficients that were applied to it by hand stay."""
    request, source = task.common.request_for(task.item), task.item.source
    kept = None if request.force else applied_by_hand(task.job, source)
    result = kept or calibrate(task.job, request, StageProgress(report_progress).stage, source)
    line, outputs = row_of(task.item, task.common, result), outputs_of(task.item, task.common, result)
    entry = Entry(task.item.name, task.item.stamps, task.common.asked, line, outputs)
    return TaskResult(entry, result.up_to_date, problems_of(result))


def row_of(item: Item, common: Common, result: Result) -> dict[str, Any]:
    """Return a result's row in the summary."""
    code = REFUSED if result.outcome is Outcome.REFUSED else 0
    paths = {"parquet": result.parquet, "report": result.job.report}
    shown = {kind: None if path is None else printable(_under(common, path)) for kind, path in paths.items()}
    quality = load_our_json(result.job.quality)
    return summary.of_report(item, code, result.report, shown, wear_hours(quality or {}))


def outputs_of(item: Item, common: Common, result: Result) -> tuple[tuple[str, FileStamp], ...]:
    """Return name under OUT and stamp of each file of a result."""
    paths = [path for path in (result.parquet, result.job.report) if path is not None]
    if common.request.integers and is_file(item.job.integers):
        paths.append(item.job.integers)
    stamps = [(_under(common, path), file_stamp(path)) for path in paths]
    return tuple((name, stamp) for name, stamp in stamps if stamp is not None)


def problems_of(result: Result) -> tuple[str, ...]:
    """Return code and message of each problem of a result's file."""
    problems = result.view.file_health.problems
    return tuple(f"{problem.code}: {problem.message}" for problem in problems)


@dataclass(frozen=True, slots=True)
class ReplacementTask:
    """One recording whose own result may be replaced by one with coefficients found elsewhere.

    Attributes:
        own: entry of its own result.
        inputs: hashes of its own result and of all else that decides, in the order of use.
        round: name of the round in its entries.
        refusal: code among a row's cautions where the own result stays.
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
    def sources(self) -> tuple[Path, ...]:
        """See `Task`."""
        return (self.item.source,)

    @property
    def own_row(self) -> dict[str, Any]:
        """The row of the own result."""
        assert self.own.row is not None
        return self.own.row

    def is_current(self, entry: Entry) -> bool:
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
        """Return the entry of the round; `inputs` are those that were used, if not all were."""
        item, used = self.item, self.inputs if inputs is None else inputs
        return Entry(item.name, item.stamps, self.common.asked, row, outputs, again, self.round, used)

    def kept(self, why: str) -> dict[str, Any]:
        """Return the own result's row, with the code and the sentences that say why it stays."""
        row = self.own_row
        cautions = " ".join(filter(None, (row["cautions"], self.refusal)))
        return {**row, "cautions": cautions, "message": kept(row["message"], self.refusal, why)}

    def result(
        self, result: Result, row: dict[str, Any], inputs: tuple[str, ...] | None = None
    ) -> TaskResult:
        """Return the result of the task."""
        entry = self.entry(row, outputs_of(self.item, self.common, result), inputs)
        return TaskResult(entry, result.up_to_date, problems_of(result))


def _under(common: Common, path: Path) -> str:
    return path.relative_to(common.out).as_posix()


class StageProgress:
    """Converts the bytes of each stage to the part of the work that is done."""

    def __init__(self, report_progress: ProgressCallback) -> None:
        self.report_progress = report_progress
        self._next: Any = 0.0
        self._part = 0.0

    def stage(self, name: str, total: int) -> Progress:
        """See `ProgressMaker`; a repeated stage is shown only once it is further than before."""
        start = STAGES.get(name, 0.5)

        def moved(done: int) -> None:
            part = start + 0.5 * min(1.0, done / max(total, 1))
            if part > self._part and time.monotonic() >= self._next:
                self._next, self._part = time.monotonic() + REPORT_S, part
                self.report_progress(part)

        return moved
