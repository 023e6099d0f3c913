"""`accelcal fit`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.options import FILE, error_option, fitting_options, strict_option
from accelcal_cli.cli.output import say_refused, show_result
from accelcal_cli.core.results import Outcome
from accelcal_cli.output.sections import report_view
from accelcal_cli.pipeline.jobs import JSON, refuse_misnamed, refuse_nameless, refuse_overwriting
from accelcal_cli.pipeline.options import fit_settings
from accelcal_cli.pipeline.outputs import refuse_report_of_another, save_report, with_provenance
from accelcal_cli.pipeline.windows import fit_points


@click.command(
    "fit",
    cls=Command,
    examples=(
        "fit points.csv # still-window means from another tool, such as GGIR",
        "fit points.csv -o points.calibration.json",
    ),
)
@click.argument("points", type=FILE)
@click.option("-o", "--output", type=FILE, help="Name of the report. Without it, no report is written.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as one JSON object.")
@click.option("--tsv", is_flag=True, help="Print tab-separated fields, even at a terminal.")
@click.option("--force", is_flag=True, help="Overwrite a file that accelcal did not write.")
@fitting_options
@error_option
@strict_option
def command(points: Path, output: Path | None, as_json: bool, force: bool, **values: Any) -> int:
    """Calibrate from still-window means found by another tool, such as GGIR.

    POINTS is a CSV or Parquet table with columns x, y, z in g (or meanx, meany, meanz), and
    optionally temperature_c, weight and posture; or the table of `calibrate --windows`. Prints the
    same line as `calibrate`, with the name of the report, if one is written, in place of the Parquet
    file. Nothing is written if the points are refused.
    """
    if output is not None:
        refuse_nameless(output)
        refuse_overwriting((output,), (points,))
        refuse_misnamed(output, JSON)
    if output is not None and not force:
        refuse_report_of_another(output, points)
    fitted = fit_points(points, fit_settings(values))
    report = with_provenance(fitted, ("accelcal", *sys.argv[1:]), recording=points)
    view = report_view(report)
    refused = view.outcome is Outcome.REFUSED
    if output is not None and not refused:
        save_report(output, report)
    shown = None if output is None or refused else output
    if as_json:
        exit_codes.show(json.dumps(report))
    else:
        show_result(view, points, shown, values)
    if refused:
        say_refused(view.message, points, values, shown=not as_json)
        return exit_codes.REFUSED
    return exit_codes.OK
