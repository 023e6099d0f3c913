"""`accelcal evaluate segments`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.output import aligned, each_recording, number
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.core.settings import Settings
from accelcal_cli.evaluate.segments import (
    Segment,
    Stillness,
    segments,
    starts,
    stillness,
    stillness_of_table,
    summary,
)
from accelcal_cli.evaluate.sensors import Population, Simulation, simulated
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

OF_SENSORS = {"measured_mg": ".2f"}
"""Those that simulated sensors have besides."""


USUAL = Population()
ERRORS = ("gain_percent", "misalignment_percent", "offset_mg", "one_misalignment_percent")


def _error_option(name: str, unit: str, text: str, largest: int) -> Callable[[Any], Any]:
    """The option that sets an error of the simulated sensors."""
    default = getattr(USUAL, name)
    shown = "as the others" if default is None else f"{default:g}"
    words = f"{text}, with --sensors.  [default: {shown}]"
    option = f"--{name.replace('_', '-')}"
    return click.option(option, type=options.Within(0, largest), metavar=unit, help=words)


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
@click.option(
    "--sensors",
    type=click.IntRange(1, 100_000),
    help="Let so many simulated sensors, with known errors, measure each recording's rests.",
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of these sensors.")
@_error_option("gain_percent", "PERCENT", "Their gains differ by up to this", 20)
@_error_option("misalignment_percent", "PERCENT", "Their misalignments are up to this", 20)
@_error_option("offset_mg", "MG", "Their offsets are up to this", 500)
@_error_option("one_misalignment_percent", "PERCENT", "One misalignment of each is this", 20)
@click.option("--json", "as_json", is_flag=True, help="Print each segment as a JSON object on a line.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.reading_options
@options.method_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate segments of each RECORDING and hold the claims against the rest of it.

    For each length: how many segments there are and how many have a calibration, then for these the mean
    error on the rest of the recording without and with it, the mean that their reports claim, how many are
    above the limit or worse than raw data, and the share of the 95 % intervals that hold the error.

    With --sensors, what the sensor measured in its still windows is replaced by what simulated ones would
    have measured, each in one of the segments. The errors are then the true ones over the whole sphere;
    `measured` is what rests would show of them, whose |a| scatters: the intervals are held against that.
    """

    def work(path: Path, bars: ProgressMaker) -> tuple[str, list[Segment]]:
        chosen = given.settings(values)
        still = _stillness(path, chosen, values, bars)
        return printable(path), list(_found(still, chosen, values))

    found, code = each_recording(recordings, work, quiet=values["quiet"])
    if found:
        exit_codes.show(_shown(dict(found), given.settings(values), as_json=values["as_json"]))
    return code


def _found(still: Stillness, chosen: Settings, values: dict[str, Any]) -> Iterator[Segment]:
    """The recording's segments, or simulated sensors in them."""
    simulation = _simulation(values)
    if simulation is None:
        for hours in values["hours"]:
            yield from segments(still, hours, values["number"], chosen)
        return
    lengths = [(hours, starts(still, hours, values["number"], chosen)) for hours in values["hours"]]
    places = [(hours, start) for hours, found in lengths for start in found]
    yield from simulated(still, places, chosen, simulation)


def _simulation(values: dict[str, Any]) -> Simulation | None:
    """Which sensors are to be simulated; None if none are. Raises UsageError for errors of none."""
    given = {name: values[name] for name in ERRORS if values[name] is not None}
    if values["sensors"] is not None:
        return Simulation(values["sensors"], values["seed"], replace(USUAL, **given))
    if given:
        name = next(iter(given)).replace("_", "-")
        raise UsageError(f"--{name} is of simulated sensors", hint="add --sensors, or omit it")
    return None


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
    shown = FIGURES | (OF_SENSORS if any(item.sensor is not None for item in found) else {})
    lengths = dict.fromkeys(item.hours for item in found)
    groups = {f"{hours:g}": [item for item in found if item.hours == hours] for hours in lengths}
    rows = []
    for name, group in {**groups, "all": found}.items():
        row = asdict(summary(group, limit_mg))
        rows.append([name, *(number(row[key], form) for key, form in shown.items())])
    return aligned(["hours", *(key.replace("_", " ") for key in shown)], rows)
