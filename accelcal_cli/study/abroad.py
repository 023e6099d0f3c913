"""A recording calibrated by a process whose current folder is not the user's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from accelcal_cli.core.names import printable
from accelcal_cli.study.engine import Told
from accelcal_cli.study.work import Answer, Task, calibrated


def calibrated_from(cwd: Path, task: Task, told: Told) -> Answer:
    """See `calibrated`; the answer and the files written are those that a process in `cwd` would give.

    Nobody's current folder is changed: other threads of this process may rely on it.
    """
    answer = calibrated(seen_from(cwd, task), told)
    if not answer.entry.failed or answer.entry.row is None:
        return answer
    row = {**answer.entry.row, "message": _as_said(cwd, task, answer.entry.row["message"])}
    return replace(answer, entry=replace(answer.entry, row=row))


def seen_from(cwd: Path, task: Task) -> Task:
    """The task with absolute paths."""
    job, options = task.item.job, task.request.options
    there = replace(job, source=cwd / job.source, parquet=cwd / job.parquet, report=cwd / job.report)
    layout = None if options.layout is None else cwd / options.layout
    return replace(
        task,
        item=replace(task.item, job=there),
        out=cwd / task.out,
        request=replace(task.request, options=replace(options, layout=layout)),
        said=job.source,
    )


def _as_said(cwd: Path, task: Task, message: str) -> str:
    """A message with the folders as the user named them."""
    layout = task.request.options.layout
    folders = [task.item.source.parent, task.out, *([] if layout is None else [layout.parent])]
    for folder in folders:
        message = message.replace(_start(cwd / folder), _start(folder))
    return message


def _start(folder: Path) -> str:
    """What names in a folder begin with."""
    return "" if folder == Path() else str(Path(printable(folder)) / "_")[:-1]
