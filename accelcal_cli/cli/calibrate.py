"""`accelcal calibrate`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli.each import each
from accelcal_cli.cli.options import (
    damage_option,
    method_options,
    place_options,
    read_options,
    reading_options,
    saying_options,
    settings,
)
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.plan import plan
from accelcal_cli.pipeline.request import Request


@click.command("calibrate")
@place_options
@click.option("--report-only", is_flag=True, help="Write the report but no Parquet.")
@click.option(
    "--integers", is_flag=True, help="Also write the fit's points and result as fixed-point integers."
)
@saying_options
@reading_options
@damage_option
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
    return each(jobs, lambda job, bars, source: calibrate(job, request, bars, source), values)
