"""`accelcal calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli.options import calibrating_options, place_options, request_of
from accelcal_cli.cli.output import run_jobs
from accelcal_cli.pipeline.calibrate import calibrate
from accelcal_cli.pipeline.jobs import plan


@click.command("calibrate")
@place_options
@calibrating_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate each RECORDING; `-` reads standard input.

    Writes STEM.calibrated.parquet and STEM.calibration.json beside the recording and prints one
    tab-separated line: path, outcome, model, error before and after in mg on held-out postures,
    improvement in percent, and the Parquet file.
    """
    jobs = plan(list(recordings), values["output_dir"], values["output"])
    request = request_of(values).for_jobs(jobs)
    return run_jobs(jobs, lambda job, bars, source: calibrate(job, request, bars, source), values)
