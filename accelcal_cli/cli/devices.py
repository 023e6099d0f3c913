"""`accelcal devices`: the devices of a study as aligned text, JSON or CSV."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import fields
from math import isfinite
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.options import Positive, Within
from accelcal_cli.cli.output import aligned, comma_separated, number
from accelcal_cli.core.errors import UsageError, counted, printable
from accelcal_cli.devices.review import Review, Unit, as_json, columns, review, row
from accelcal_cli.devices.table import OFFSETS, PARAMETERS, Kind, Use, with_error
from accelcal_cli.devices.trends import Drift, Rules, Trend

HEAD = ("device", "recordings", "used", "refused", "first", "last", "held out mg", "mg/month", "%/month")
DETAIL = ("parameter", "value", "+-", "a month", "+-", "scatter", "recordings", "certain")
HISTORY = ("start", "outcome", "use", "model", "held out mg", "x mg", "+-", "y mg", "+-", "z mg", "+-")
PERCENT = (Kind.SCALE, Kind.MISALIGNMENT)


def overview(units: Sequence[Unit]) -> str:
    """A line for each device, with the verdict and its first reason."""
    names = _names(units)
    lines = aligned(HEAD, [_line(name, unit) for name, unit in zip(names, units, strict=True)]).splitlines()
    said = ["verdict", "-------", *(_verdict(unit) for unit in units)]
    width = max(map(len, lines))
    return "\n".join(f"{line.ljust(width)}  {text}" for line, text in zip(lines, said, strict=True))


def _names(units: Sequence[Unit]) -> list[str]:
    """Serials; with model and format where several devices have the same."""
    often = Counter(unit.device.serial for unit in units)
    return [printable(_name(unit, alone=often[unit.device.serial] == 1)) for unit in units]


def _name(unit: Unit, *, alone: bool) -> str:
    device = unit.device
    return device.serial if alone else f"{device.serial} ({device.model or '-'}, {device.format or '-'})"


def _line(name: str, unit: Unit) -> list[str]:
    return [
        name,
        str(unit.recordings),
        str(unit.counted(Use.USED, Use.UNDATED)),
        str(unit.refused),
        _date(unit.begin),
        _date(unit.end),
        number(unit.held_out_mg, ".2f"),
        _fastest(unit, (Kind.OFFSET,)),
        _fastest(unit, PERCENT),
    ]


def _date(start: str | None) -> str:
    return "-" if start is None else start[:10]


def _fastest(unit: Unit, kinds: tuple[Kind, ...]) -> str:
    """The fastest drift of some kinds of parameters, with its standard error."""
    drifts = [one.drift for one in unit.trends if one.drift is not None and one.parameter.kind in kinds]
    if not drifts:
        return "undated" if unit.counted(Use.UNDATED) and not unit.counted(Use.USED) else "not enough"
    fastest = max(drifts, key=lambda drift: abs(drift.per_month))
    return with_error(fastest.per_month, fastest.error)


def _verdict(unit: Unit) -> str:
    if not unit.reasons:
        return str(unit.verdict)
    more = f"; and {len(unit.reasons) - 1} more" if len(unit.reasons) > 1 else ""
    return f"{unit.verdict}: {unit.reasons[0].text}{more}"


def detail(review: Review, unit: Unit) -> str:
    """All of one device: its verdict, its parameters, its recordings."""
    device = unit.device
    about = [device.model, device.format, *unit.firmware]
    name = f"{device.serial} ({', '.join(filter(None, about)) or 'of unknown model'}): {unit.verdict}"
    reasons = [f"  {'' if one.certain else 'perhaps: '}{one.text}" for one in unit.reasons]
    warm = [] if unit.reference_c is None else [f"offsets at {unit.reference_c:.1f} C"]
    return "\n".join([printable(name), *reasons, "", *warm, *_parameters(unit), _history(review, unit)])


def _parameters(unit: Unit) -> list[str]:
    if not unit.trends:
        return []
    return [aligned(DETAIL, [_trend(trend) for trend in unit.trends]), ""]


def _trend(trend: Trend) -> list[str]:
    digits = ".4f" if trend.parameter.kind is not Kind.OFFSET else ".3f"
    value = [f"{trend.parameter.label} {trend.parameter.unit}", f"{trend.value:+{digits}}"]
    return [*value, f"{trend.error:{digits}}", *_drift(trend.drift, digits, trend.number)]


def _drift(drift: Drift | None, digits: str, recordings: int) -> list[str]:
    if drift is None:
        return ["not enough", "-", "-", str(recordings), "-"]
    certain = "yes" if drift.significant else "no"
    shown = [f"{drift.per_month:+{digits}}", f"{drift.error:{digits}}", f"{drift.scatter:.1f}"]
    return [*shown, str(recordings), certain]


def _history(review: Review, unit: Unit) -> str:
    """A line for each recording, its path last."""
    lines = aligned(HISTORY, [_recording(review, at) for at in unit.rows]).splitlines()
    paths = ["path", "----", *(printable(review.records.text["path"][at] or "-") for at in unit.rows)]
    width = max(map(len, lines))
    return "\n".join(f"{line.ljust(width)}  {path}" for line, path in zip(lines, paths, strict=True))


def _recording(review: Review, at: int) -> list[str]:
    text, moved = review.records.text, review.referred.records
    cells = [_date(text["start_time"][at]), text["outcome"][at] or "-", str(review.use[at])]
    cells += [text["model"][at] or "-", _finite(float(review.records.number["after_mg"][at]), ".2f")]
    for index in range(len(PARAMETERS))[OFFSETS]:
        cells.append(_finite(1000 * float(moved.values[at, index]), "+.2f"))
        cells.append(_finite(1000 * float(moved.errors[at, index]), ".2f"))
    return cells


def _finite(value: float, form: str) -> str:
    return number(value if isfinite(value) else None, form)


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
        exit_codes.say(_summary(found, units))
    return exit_codes.OK


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
