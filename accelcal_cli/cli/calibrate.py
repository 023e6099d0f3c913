"""`accelcal calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli.options import (
    FILE,
    calibrating_options,
    parts_option,
    place_options,
    recordings_of,
    request_of,
)
from accelcal_cli.cli.output import run_jobs
from accelcal_cli.pipeline.jobs import Job, ProgressMaker, Result, plan
from accelcal_cli.pipeline.windows import check_table_path


@click.command("calibrate")
@place_options
@calibrating_options
@parts_option
@click.option(
    "--windows",
    type=FILE,
    help="Also write every still window, and what became of it, to this .parquet or .csv file.",
)
@click.option("--html", is_flag=True, help="Also write a page for people, STEM.html, beside the report.")
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate each RECORDING; `-` reads standard input.

    Writes STEM.calibrated.parquet and STEM.calibration.json beside the recording. Prints a sentence at a
    terminal, else (or with --tsv) one tab-separated line: path, outcome, model, error before and after in mg
    on held-out postures, error before / after x 100, and the Parquet file.
    """
    from accelcal_cli.pipeline.calibrate import calibrate  # it takes longer to load than to show --help

    jobs = plan(recordings_of(recordings, values), values["output_dir"], values["output"])
    if values["windows"] is not None:
        check_table_path(values["windows"], jobs)
    request = request_of(values).for_jobs(jobs)

    def work(job: Job, bars: ProgressMaker, source: Path) -> Result:
        if not values["html"]:
            return calibrate(job, request, bars, source)
        from accelcal_cli.pages.write import refuse_page, write_page  # with jinja2, which only pages need

        refuse_page(job, force=values["force"])
        result = calibrate(job, request, bars, source)
        write_page(job.report, job.page)
        return result

    return run_jobs(jobs, work, values)
