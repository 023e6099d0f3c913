"""`accelcal six-pose`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import run_jobs
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.input_files import is_no_part
from accelcal_cli.core.paths import is_folder
from accelcal_cli.core.settings import POSES, PoseSettings
from accelcal_cli.pipeline.jobs import Request, plan_report, resolved_path
from accelcal_cli.pipeline.options import read_options, with_values
from accelcal_cli.six_pose.run import session_of, six_pose


@click.command(
    "six-pose",
    cls=Command,
    examples=(
        "six-pose session.cwa -d calibrated # one recording of all six sides",
        'six-pose "faces/*.csv" # a file for each side',
    ),
)
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option(
    "--poses", type=options.FILE,
    help="CSV with start,end (or file) and ax,ay,az of each pose.  [default: find the six faces]",
)  # fmt: skip
@options.setting_option(PoseSettings, "unchecked")
@click.option(
    "--roll", multiple=True, metavar="AXIS,START,END",
    help="Validate on a stretch in which the device was rolled about a level AXIS: AXIS,START,END in "
    "seconds, or AXIS,FILE.",
)  # fmt: skip
@click.option("-o", "--output", type=options.FILE, help="Name of the report (JSON).")
@click.option("-d", "--output-dir", type=options.FILE, help="Folder for the report.")
@options.printing_options
@options.setting_option(PoseSettings, "segment_seconds")
@options.setting_option(PoseSettings, "stillness_threshold_g")
@options.setting_option(PoseSettings, "longest_gap_s")
@options.setting_option(PoseSettings, "face_degrees")
@options.reading_options
@options.error_option
@options.gravity_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate from a six-position session, in which the device lies on each of its six sides.

    The session is one recording, or several of one device, such as one for each side: their folder, a pattern
    in quotes, or a list if a pattern stands for just these files. `-` reads standard input.

    Fits twelve parameters by linear least squares. Writes NAME.calibration.json next to the recording and
    prints the same line as `calibrate`, with the name of the report in place of the Parquet file.
    """
    inputs = [] if values["poses"] is None else [values["poses"]]
    session = session_of(recordings, values["poses"])
    job = plan_report(session, values["output_dir"], values["output"], *inputs)
    _refuse_among(job.report, session)
    request = Request(
        options=read_options(values),
        settings=with_values(POSES, values),
        poses=values["poses"],
        report_only=True,
        chunk_samples=values["chunk_samples"],
        force=values["force"],
        command=("accelcal", *sys.argv[1:]),
        parts=True,
    )
    return run_jobs(
        [job],
        lambda job, bars, source: six_pose(job, request, bars, source),
        values,
        written=lambda result: result.job.report,  # a session has no Parquet file
    )


def _refuse_among(report: Path, session: Path) -> None:
    """Raise UsageError for a report that would be treated as a file of the session."""
    if (
        is_folder(session)
        and resolved_path(session) in resolved_path(report).parents
        and not is_no_part(report)
    ):
        hint = "give a name outside, or one that ends in .calibration.json"
        raise UsageError(f"{printable(report)} would be among the files of the session", hint=hint)
