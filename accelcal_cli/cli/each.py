"""What commands share that make a result of each recording: the loop, the line, the comments."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import click

from accelcal_cli.cli import exits
from accelcal_cli.cli.progress import progress_bars
from accelcal_cli.cli.results import line
from accelcal_cli.core.errors import AccelcalError, UsageError
from accelcal_cli.core.judgement import Outcome
from accelcal_cli.core.names import printable
from accelcal_cli.pipeline.identity import spooled
from accelcal_cli.pipeline.plan import STDIN, Job
from accelcal_cli.pipeline.remarks import warning
from accelcal_cli.pipeline.request import ProgressMaker, Result

Work = Callable[[Job, ProgressMaker, Path | None], Result]
"""Makes one recording's result; the path is where its bytes are, if not at the job's source."""


def parquet_of(result: Result) -> Path | None:
    """The Parquet file of a result, if it has one."""
    return result.job.parquet if result.has_parquet else None


def each(
    jobs: list[Job],
    work: Work,
    values: dict[str, Any],
    written: Callable[[Result], Path | None] = parquet_of,
) -> int:
    """Do every job, print its result, and return the exit code of all.

    Args:
        values: the options `quiet`, `verbose` and `as_json`.
        written: the output that a result's line names.
    """
    codes = [_one(job, work, values, written) for job in jobs]
    if len(codes) == 1:
        return codes[0]
    return exits.SOME_FAILED if any(codes) else exits.OK


def _one(job: Job, work: Work, values: dict[str, Any], written: Callable[[Result], Path | None]) -> int:
    """Do one job; a failure is said and does not stop the rest."""
    source = None
    try:
        with contextlib.ExitStack() as stack:
            if job.source == STDIN:
                source = stack.enter_context(spooled(stdin()))
            bars = stack.enter_context(progress_bars(job.source.name, quiet=values["quiet"]))
            result = work(job, bars, source)
    except AccelcalError as error:
        error.path = STDIN if source is not None and error.path == source else error.path
        exits.say(str(error))
        return error.exit_code
    except Exception:
        return exits.report_bug()
    shown = line(result.report, result.job.source, written(result))
    click.echo(json.dumps(result.report) if values["as_json"] else shown)
    _comment(result, values)
    return exits.REFUSED if result.outcome is Outcome.REFUSED else exits.OK


def stdin() -> BinaryIO:
    """Standard input; raises UsageError where there is none."""
    if sys.stdin is None:
        raise UsageError("standard input is closed", hint="name a file")
    return sys.stdin.buffer


def _comment(result: Result, values: dict[str, Any]) -> None:
    """Reasons and warnings, on stderr."""
    report = result.report
    if result.outcome is Outcome.REFUSED:
        exits.say(f"{printable(result.job.source)}: refused: {report['message']}")
    if (beware := warning(report)) is not None:
        exits.say(f"{printable(result.job.source)}: {beware}")
    if values["quiet"]:
        return
    if result.up_to_date:
        exits.say(f"{printable(result.job.source)}: up to date")
    problems = report["file_health"]["problems"]
    for problem in problems if values["verbose"] else problems[:1]:
        more = (
            ""
            if values["verbose"] or len(problems) == 1
            else f" (and {len(problems) - 1} more, see the report)"
        )
        exits.say(f"{printable(result.job.source)}: {problem['code']}: {problem['message']}{more}")
    if values["verbose"]:
        exits.say(f"{printable(result.job.source)}: {report['message']}")
        for trial in report["models_tried"]:
            found = trial["reason"] if trial["after_mg"] is None else f"{trial['after_mg']:.3f} mg held out"
            exits.say(f"{printable(result.job.source)}: model {trial['model']}: {found}")
