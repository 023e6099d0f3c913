"""`accelcal calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli.help import Command, Rare
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
from accelcal_cli.pipeline.options import MOST_DRAWS, check_draws, chosen_settings
from accelcal_cli.pipeline.windows import check_table_path


@click.command(
    "calibrate",
    cls=Command,
    examples=(
        "calibrate recording.cwa # writes recording.calibrated.parquet, .calibration.json, .quality.json",
        "calibrate *.gt3x -d calibrated --html # a folder for the results, and a page for each",
        "calibrate table.csv --unit mg --timezone Europe/Berlin # a table in mg with local times",
    ),
)
@place_options
@calibrating_options
@parts_option
@click.option(
    "--windows",
    cls=Rare,
    type=FILE,
    help="Also write a table of all still windows, and whether each was used, to this .parquet or .csv file.",
)
@click.option("--draws", cls=Rare, type=click.IntRange(1, MOST_DRAWS), metavar="N",
              help="Also write N plausible sets of coefficients to NAME.draws.json.")  # fmt: skip
@click.option("--html", is_flag=True, help="Also write a page.")
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate each RECORDING; `-` reads standard input.

    For NAME.cwa, writes NAME.calibrated.parquet (data), NAME.calibration.json (report) and NAME.quality.json
    (error by hour) next to it. At a terminal, prints one sentence per recording; in a pipe or with --tsv,
    tab-separated fields. Exit code: 0 usable, 1 some not, 3 unreadable, 4 refused, 5 not written.
    """
    from accelcal_cli.pipeline.registry import calibrate  # it takes longer to load than to show --help

    if values["draws"]:
        check_draws(chosen_settings(values))
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
