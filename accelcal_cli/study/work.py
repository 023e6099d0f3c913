"""What a worker does with one recording, and what it tells of it."""

from __future__ import annotations

import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from accelcal_cli.core.errors import AccelcalError, OutputError
from accelcal_cli.core.judgement import Outcome
from accelcal_cli.core.memory import keep_freed_memory
from accelcal_cli.core.names import printable
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.plan import Job
from accelcal_cli.pipeline.request import Progress, Request, Result
from accelcal_cli.study import row
from accelcal_cli.study.engine import Told
from accelcal_cli.study.items import Entry, Item, Stamp, stamp

REFUSED = 4
BUG = 70
TELL_S = 0.2
STAGES = {"reading": 0.0, "writing": 0.5}
"""Where in the work a stage begins; each is half of it."""


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
    keep_freed_memory()
    try:
        return _answer(task, calibrate(task.job, task.request, _Parts(told).stage, task.item.source))
    except AccelcalError as error:
        again = isinstance(error, OutputError)
        return Answer(failure(task, error.exit_code, str(error), again=again))
    except MemoryError:
        message = f"{printable(task.item.source)}: there was not enough memory; use fewer --jobs"
        return Answer(failure(task, BUG, message, again=True))
    except Exception as error:
        message = " ".join(f"a bug in accelcal ({type(error).__name__}: {error})".split())
        return Answer(failure(task, BUG, message), trace=traceback.format_exc())


def failure(task: Task, code: int, message: str, *, again: bool = False) -> Entry:
    """The entry of a recording that gave no report."""
    item = task.item
    return Entry(item.name, item.stamps, task.asked, row.failed(item, code, message), again=again)


def _answer(task: Task, result: Result) -> Answer:
    names = {
        "parquet": _under(task, result.job.parquet) if result.has_parquet else None,
        "report": _under(task, result.job.report),
    }
    code = REFUSED if result.outcome is Outcome.REFUSED else 0
    line = row.of_report(task.item, code, result.report, _printable(names))
    outputs = _stamped(task, [name for name in names.values() if name is not None])
    found = result.report["file_health"]["problems"]
    return Answer(
        Entry(task.item.name, task.item.stamps, task.asked, line, outputs),
        result.up_to_date,
        tuple(f"{problem['code']}: {problem['message']}" for problem in found),
    )


def _under(task: Task, path: Path) -> str:
    return path.relative_to(task.out).as_posix()


def _printable(names: dict[str, str | None]) -> dict[str, str | None]:
    return {kind: None if name is None else printable(name) for kind, name in names.items()}


def _stamped(task: Task, names: list[str]) -> tuple[tuple[str, Stamp], ...]:
    if task.request.integers and task.item.job.integers.exists():
        names = [*names, _under(task, task.item.job.integers)]
    found = [(name, stamp(task.out / name)) for name in names]
    return tuple((name, held) for name, held in found if held is not None)


class _Parts:
    """Turns the bytes of each stage into the part of the work that is done."""

    def __init__(self, told: Told) -> None:
        self._told = told
        self._next: Any = 0.0

    def stage(self, name: str, total: int) -> Progress:
        """See `ProgressMaker`."""
        start = STAGES.get(name, 0.5)

        def moved(done: int) -> None:
            if time.monotonic() >= self._next:
                self._next = time.monotonic() + TELL_S
                self._told(start + 0.5 * min(1.0, done / max(total, 1)))

        return moved
