"""`accelcal devices`."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exits
from accelcal_cli.cli.device_tables import detail, overview
from accelcal_cli.cli.options import Positive
from accelcal_cli.cli.tables import comma_separated
from accelcal_cli.cli.within import Within
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.names import counted, printable
from accelcal_cli.fleet.document import as_json, columns, row
from accelcal_cli.fleet.review import Review, review
from accelcal_cli.fleet.rules import Rules
from accelcal_cli.fleet.unit import Unit

LIMITS = {
    "offset_mg": "Offset of an axis.",
    "scale_percent": "Scale error of an axis.",
    "misalignment_percent": "Misalignment between two axes.",
    "slope_mg_per_c": "Temperature slope of an offset.",
    "drift_mg": "Drift of an offset a month; of a slope over 10 C.",
    "drift_percent": "Drift of scale or misalignment a month.",
    "outlying": "Robust standard deviations of the held-out error above devices of its kind.",
    "refused_percent": "Share of recordings refused or borrowed.",
    "damaged_percent": "Share of recordings that lost bytes to damage.",
    "least_days": "Shortest span that gives a drift.",
}
"""Help of the options that set the limits of the rules."""


def limits(command: Callable[..., Any]) -> Callable[..., Any]:
    """An option for each limit."""
    for name, said in reversed(LIMITS.items()):
        option = f"--{name.replace('_', '-')}"
        default = getattr(Rules(), name)
        command = click.option(
            option, name, type=Positive(), default=default, show_default=True, metavar="N", help=said
        )(command)
    return command


@click.command("devices")
@click.argument("out", type=click.Path(path_type=Path, readable=False))
@click.option("--device", metavar="SERIAL", help="Only this device, in full.")
@click.option("--json", "as_json_", is_flag=True, help="Print one JSON object.")
@click.option("--csv", "as_csv", is_flag=True, help="Print one CSV table, a row a device and recording.")
@click.option("-q", "--quiet", is_flag=True, help="Nothing on stderr.")
@limits
@click.option(
    "--reference-c",
    type=Within(-100, 200),
    metavar="C",
    help="Temperature of the offsets.  [default: the median of each device's recordings]",
)
def command(out: Path, **values: Any) -> int:
    """Show how the devices of a study drift, and which to service and why.

    OUT is the folder of `accelcal study`; only its study.parquet is read. A line for each device: its
    recordings, its fastest drift of an offset and of scale or misalignment with standard errors, and
    service, watch (perhaps), good or unknown, with the first reason.
    """
    if values["as_json_"] and values["as_csv"]:
        raise UsageError("--json and --csv exclude each other", hint="give one of them")
    rules = Rules(**{field.name: values[field.name] for field in fields(Rules)})
    found = review(out, rules, time.time())
    units = _chosen(found, values["device"], out)
    click.echo(_shown(found, units, values))
    if not values["quiet"]:
        exits.say(_summary(found, units))
    return exits.OK


def _chosen(found: Review, serial: str | None, out: Path) -> tuple[Unit, ...]:
    if serial is None:
        return found.units
    units = tuple(unit for unit in found.units if unit.device.serial == serial)
    if not units:
        some = [printable(unit.device.serial) for unit in found.units[:5]]
        hint = f"there are {', '.join(some)}{', ...' if len(found.units) > 5 else ''}" if some else None
        raise UsageError(f"no recording of device {printable(serial)}", path=out, hint=hint)
    return units


def _shown(found: Review, units: tuple[Unit, ...], values: dict[str, Any]) -> str:
    if values["as_json_"]:
        return json.dumps(as_json(found, units))
    if values["as_csv"]:
        rows = [row(found, unit, at) for unit in units for at in unit.rows]
        return comma_separated(columns(), [list(map(_cell, one.values())) for one in rows])
    if values["device"] is not None:
        return "\n\n".join(detail(found, unit) for unit in units)
    return overview(units)


def _cell(value: Any) -> Any:
    """Text on one line."""
    return printable(value) if isinstance(value, str) else value


def _summary(found: Review, units: tuple[Unit, ...]) -> str:
    verdicts = Counter(str(unit.verdict) for unit in units)
    counts = [f"{number} {name}" for name, number in verdicts.items()]
    text = counted(len(units), "device")
    text += f": {', '.join(counts)}" if counts else ""
    records = found.records
    if records.nameless:
        text += f"; {counted(records.nameless, 'recording')} without a serial number"
        text += f", {records.failed} of them failed" if records.failed else ""
    return text
