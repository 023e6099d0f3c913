"""`accelcal apply`."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import run_jobs
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.settings import DEFAULT
from accelcal_cli.output.coefficients import read_coefficients
from accelcal_cli.pipeline.apply import apply, keep_coefficients
from accelcal_cli.pipeline.jobs import Request, plan
from accelcal_cli.pipeline.options import read_options, with_values
from accelcal_cli.pipeline.registry import apply as apply_best


@click.command(
    "apply",
    cls=Command,
    examples=(
        "apply --coefficients good.calibration.json night.cwa # a recording of the same device",
        "apply --coefficients march.calibration.json june.cwa --report-only # do they still fit?",
    ),
)
@options.place_options
@click.option("--coefficients", type=options.FILE, metavar="NAME.calibration.json",
              help="Report with the coefficients.")  # fmt: skip
@click.option("--registry", type=options.FILE, metavar="FILE.json",
              help="Registry from `accelcal devices`, whose best calibration is applied.")  # fmt: skip
@click.option("--any-device", is_flag=True, help="Accept recordings of any device.")
@click.option("--no-temperature", is_flag=True, help="Use the coefficients at their reference temperature.")
@options.measuring_options
@options.printing_options
@options.reading_options
@options.parts_option
@options.error_option
@options.gravity_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Apply known coefficients to each RECORDING; `-` reads standard input.

    The coefficients come from a report of this recording or of another one of the same device. With
    --registry they are those with the smallest expected error among the device's calibrations in FILE.json.
    Writes NAME.calibrated.parquet, NAME.calibration.json and NAME.quality.json (error by hour), and prints
    the same line as `calibrate`. The errors are measured on the recording's own still windows; a caution says
    from when on the coefficients do not fit.
    """
    jobs = plan(list(recordings), values["output_dir"], values["output"])
    if (values["coefficients"] is None) == (values["registry"] is None):
        hint = "--coefficients NAME.calibration.json or --registry FILE.json"
        raise UsageError("the coefficients come from a report or from a registry", hint=f"give {hint}")
    path, given = values["coefficients"], values["coefficients"] is not None
    keep_coefficients(path if given else values["registry"], jobs)
    request = Request(
        options=read_options(values),
        parts=values["parts"],
        joined=values["parts"],
        settings=replace(with_values(DEFAULT, values), temperature=not values["no_temperature"]),
        chunk_samples=values["chunk_samples"],
        report_only=values["report_only"],
        effect=values["effect"],
        force=values["force"],
        command=("accelcal", *sys.argv[1:]),
        coefficients=read_coefficients(path) if given else None,
        registry=options.registry_of(values),
        any_device=values["any_device"],
    ).for_jobs(jobs)
    work = apply if given else apply_best
    return run_jobs(jobs, lambda job, bars, source: work(job, request, bars, source), values)
