"""`accelcal calibrate`."""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path
from typing import Any, BinaryIO

import click

from accelcal_cli.cli import exits
from accelcal_cli.cli.options import method_options, read_options, reading_options, settings
from accelcal_cli.cli.progress import progress_bars
from accelcal_cli.cli.results import line
from accelcal_cli.core.errors import AccelcalError, UsageError
from accelcal_cli.core.judgement import Outcome
from accelcal_cli.core.names import printable
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.identity import spooled
from accelcal_cli.pipeline.plan import STDIN, Job, plan
from accelcal_cli.pipeline.request import Request, Result


@click.command("calibrate")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path, readable=False))
@click.option(
    "-d", "--output-dir", type=click.Path(path_type=Path, readable=False), help="Folder of the outputs."
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, readable=False), help="Name of the Parquet file."
)
@click.option("--json", "as_json", is_flag=True, help="Print the report, one JSON object a line.")
@click.option("--report-only", is_flag=True, help="Write the report but no Parquet.")
@click.option(
    "--integers", is_flag=True, help="Also write the fit's points and result as fixed-point integers."
)
@click.option("--force", is_flag=True, help="Redo what is up to date; overwrite what accelcal did not write.")
@click.option("-q", "--quiet", is_flag=True, help="Say nothing on stderr but errors.")
@click.option("-v", "--verbose", is_flag=True, help="Say more on stderr.")
@reading_options
@method_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate each RECORDING; `-` reads standard input.

    Writes STEM.calibrated.parquet and STEM.calibration.json beside the recording, and prints a line
    for each: path, outcome, model, error before and after in mg on postures held out, improvement in
    percent, and the Parquet file, separated by tabs.
    """
    jobs = plan(list(recordings), values["output_dir"], values["output"])
    request = Request(
        options=read_options(values),
        settings=settings(values),
        chunk_samples=values["chunk_samples"],
        report_only=values["report_only"],
        integers=values["integers"],
        force=values["force"],
        command=("accelcal", *sys.argv[1:]),
    )
    codes = [_one(job, request, values) for job in jobs]
    if len(codes) == 1:
        return codes[0]
    return exits.SOME_FAILED if any(codes) else exits.OK


def _one(job: Job, request: Request, values: dict[str, Any]) -> int:
    """Calibrate one recording and print its result; a failure is said and does not stop the rest."""
    source = None
    try:
        with contextlib.ExitStack() as stack:
            if job.source == STDIN:
                source = stack.enter_context(spooled(stdin()))
            bars = stack.enter_context(progress_bars(job.source.name, quiet=values["quiet"]))
            result = calibrate(job, request, bars, source)
    except AccelcalError as error:
        error.path = STDIN if source is not None and error.path == source else error.path
        exits.say(str(error))
        return error.exit_code
    except Exception:
        return exits.report_bug()
    shown = line(result.report, result.job.source, _written(result))
    click.echo(json.dumps(result.report) if values["as_json"] else shown)
    comment(result, values)
    return exits.REFUSED if result.outcome is Outcome.REFUSED else exits.OK


def stdin() -> BinaryIO:
    """Standard input; raises UsageError where it is closed."""
    if sys.stdin is None:
        raise UsageError("standard input is closed", hint="name a file")
    return sys.stdin.buffer


def _written(result: Result) -> Path | None:
    return result.job.parquet if result.has_parquet else None


def comment(result: Result, values: dict[str, Any]) -> None:
    """Reasons and warnings, on stderr."""
    report = result.report
    if result.outcome is Outcome.REFUSED:
        exits.say(f"{printable(result.job.source)}: refused: {report['message']}")
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
