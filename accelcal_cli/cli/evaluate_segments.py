"""`accelcal evaluate segments`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.output import aligned, each_recording, number
from accelcal_cli.core.errors import printable
from accelcal_cli.core.settings import Settings
from accelcal_cli.evaluate.segments import (
    Segment,
    Stillness,
    segments,
    stillness,
    stillness_of_table,
    summary,
)
from accelcal_cli.pipeline import given
from accelcal_cli.pipeline.jobs import ProgressMaker

FIGURES = {
    "segments": "d",
    "usable": "d",
    "raw_mg": ".2f",
    "true_mg": ".2f",
    "claimed_mg": ".2f",
    "above_limit": "d",
    "worse": "d",
    "holds": ".3f",
}
"""Columns of the table and how their values are shown."""


@click.command("segments")
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option(
    "--hours",
    type=options.Listed(float, 0.1, 10_000),
    default="3,6,12,24,48,72",
    show_default=True,
    help="Lengths of the segments.",
)
@click.option(
    "--number",
    type=click.IntRange(1, 10_000),
    default=24,
    show_default=True,
    help="Segments of each length at most.",
)
@click.option(
    "--table-hours",
    type=options.Positive(100_000),
    metavar="HOURS",
    help="The files are tables of still windows in the order of time that span so many hours.",
)
@click.option("--json", "as_json", is_flag=True, help="Print each segment as a JSON object on a line.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.reading_options
@options.method_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate segments of each RECORDING and hold the claims against the rest of it.

    For each length: how many segments there are and how many have a calibration, then for these the mean
    error on the rest of the recording without and with it, the mean that their reports claim, how many are
    above the limit or worse than raw data, and the share of the 95 % intervals that hold the error.
    """

    def work(path: Path, bars: ProgressMaker) -> tuple[str, list[Segment]]:
        chosen = given.settings(values)
        still = _stillness(path, chosen, values, bars)
        lengths = [segments(still, hours, values["number"], chosen) for hours in values["hours"]]
        return printable(path), [item for length in lengths for item in length]

    found, code = each_recording(recordings, work, quiet=values["quiet"])
    if found:
        exit_codes.show(_shown(dict(found), given.settings(values), as_json=values["as_json"]))
    return code


def _stillness(path: Path, chosen: Settings, values: dict[str, Any], bars: ProgressMaker) -> Stillness:
    if values["table_hours"] is not None:
        return stillness_of_table(path, chosen, values["table_hours"])
    return stillness(path, given.read_options(values), chosen, values["chunk_samples"], bars)


def _shown(results: dict[str, list[Segment]], chosen: Settings, *, as_json: bool) -> str:
    if as_json:
        pairs = [(path, item) for path, found in results.items() for item in found]
        return "\n".join(
            json.dumps({"recording": path, **asdict(item), "holds": item.holds}) for path, item in pairs
        )
    tables = [f"{path}\n{_table(found, chosen.max_error_mg)}" for path, found in results.items()]
    if len(results) > 1:
        every = [item for found in results.values() for item in found]
        tables.append(f"all recordings\n{_table(every, chosen.max_error_mg)}")
    return "\n\n".join(tables)


def _table(found: list[Segment], limit_mg: float) -> str:
    """A row for each length, and one for all."""
    lengths = dict.fromkeys(item.hours for item in found)
    groups = {f"{hours:g}": [item for item in found if item.hours == hours] for hours in lengths}
    rows = []
    for name, group in {**groups, "all": found}.items():
        row = asdict(summary(group, limit_mg))
        rows.append([name, *(number(row[key], shown) for key, shown in FIGURES.items())])
    return aligned(["hours", *(key.replace("_", " ") for key in FIGURES)], rows)
