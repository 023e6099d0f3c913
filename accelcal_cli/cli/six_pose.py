"""`accelcal six-pose`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli.options import (
    Within,
    damage_option,
    gravity,
    gravity_options,
    read_options,
    reading_options,
)
from accelcal_cli.cli.output import each
from accelcal_cli.core.settings import PoseSettings
from accelcal_cli.pipeline.jobs import Request, Result, plan_report
from accelcal_cli.six_pose.run import six_pose

DEFAULT = PoseSettings()


@click.command("six-pose")
@click.argument("recording", type=click.Path(path_type=Path, readable=False))
@click.option(
    "--poses",
    type=click.Path(path_type=Path, readable=False),
    help="CSV with start,end,ax,ay,az of each pose; else the six faces are found.",
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, readable=False), help="Name of the report (JSON)."
)
@click.option(
    "-d", "--output-dir", type=click.Path(path_type=Path, readable=False), help="Folder of the report."
)
@click.option("--json", "as_json", is_flag=True, help="Print the report.")
@click.option("--force", is_flag=True, help="Redo what is up to date; overwrite what accelcal did not write.")
@click.option("-q", "--quiet", is_flag=True, help="Say nothing on stderr but errors.")
@click.option("-v", "--verbose", is_flag=True, help="Say more on stderr.")
@click.option(
    "--segment-seconds",
    type=Within(0.1, 60),
    default=DEFAULT.segment_seconds,
    show_default=True,
    help="Length of a window.",
)
@click.option(
    "--stillness-threshold-g",
    type=Within(0, 4, min_open=True),
    default=DEFAULT.stillness_threshold_g,
    show_default=True,
    help="Largest max - min of a still window.",
)
@click.option(
    "--face-degrees",
    type=Within(1, 45),
    default=DEFAULT.face_degrees,
    show_default=True,
    help="How far from its axis the raw mean of a face may be.",
)
@reading_options
@damage_option
@gravity_options
def command(recording: Path, **values: Any) -> int:
    """Calibrate from a session in which the device rested on its six faces; `-` reads standard input.

    Twelve parameters by linear least squares (docs/six-pose.md says how to make the session). Writes
    STEM.calibration.json beside the recording, and prints a line: path, outcome, model, error before
    and after in mg on orientations left out, improvement in percent, and the report, separated by tabs.
    """
    inputs = [] if values["poses"] is None else [values["poses"]]
    job = plan_report(recording, values["output_dir"], values["output"], *inputs)
    request = Request(
        options=read_options(values),
        settings=_settings(values),
        poses=values["poses"],
        report_only=True,
        chunk_samples=values["chunk_samples"],
        force=values["force"],
        command=("accelcal", *sys.argv[1:]),
    )
    return each([job], lambda job, bars, source: six_pose(job, request, bars, source), values, report_of)


def _settings(values: dict[str, Any]) -> PoseSettings:
    place = gravity(values)
    return PoseSettings(
        segment_seconds=values["segment_seconds"],
        stillness_threshold_g=values["stillness_threshold_g"],
        face_degrees=values["face_degrees"],
        latitude=place.latitude,
        altitude_m=place.altitude_m,
        max_damage_percent=values["max_damage"],
    )


def report_of(result: Result) -> Path:
    """A six-face session has no Parquet; its line names the report."""
    return result.job.report
