"""What commands that find each recording's own calibration are asked to do with it."""

from __future__ import annotations

import sys
from typing import Any

import click

from accelcal_cli.cli.options import (
    Command,
    damage_option,
    method_options,
    read_options,
    reading_options,
    saying_options,
    settings,
)
from accelcal_cli.pipeline.request import Request

_REPORT_ONLY = click.option("--report-only", is_flag=True, help="Write reports but no Parquet.")
_INTEGERS = click.option(
    "--integers", is_flag=True, help="Also write each fit's points and result as fixed-point integers."
)


def calibrating_options(command: Command) -> Command:
    """The options that `request_of` needs, and how much is said."""
    for decorator in (method_options, damage_option, reading_options, saying_options):
        command = decorator(command)
    return _REPORT_ONLY(_INTEGERS(command))


def request_of(values: dict[str, Any]) -> Request:
    """The request that the options of `calibrate` and `study` make; raises what its parts raise."""
    return Request(
        options=read_options(values),
        settings=settings(values),
        chunk_samples=values["chunk_samples"],
        report_only=values["report_only"],
        integers=values["integers"],
        force=values["force"],
        command=("accelcal", *sys.argv[1:]),
    )
