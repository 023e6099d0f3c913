"""`accelcal devices`: the devices of a study as aligned text, JSON or CSV."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.help import Command, Named, NameValue
from accelcal_cli.cli.options import FILE, Positive, Within
from accelcal_cli.cli.output import aligned, refuse_both
from accelcal_cli.core.errors import counted, printable
from accelcal_cli.devices.review import DeviceReview, Review, Verdict, as_json, chosen, columns, review, row
from accelcal_cli.devices.table import OFFSETS, PARAMETERS, Kind, Usage, added
from accelcal_cli.devices.trends import Rules, Trend, bounds_of
from accelcal_cli.output.files import csv_text
from accelcal_cli.output.numbers import formatted, with_error
from accelcal_cli.output.registry import is_registry
from accelcal_cli.output.sentences import in_words, of_device

HEAD = ("device", "recordings", "used", "refused", "first", "last", "held out mg", "mg/month", "%/month")
DETAIL = ("parameter", "value", "+-", "a month", "+-", "scatter", "recordings", "certain")
HISTORY = ("start", "outcome", "use", "model", "held out mg", "x mg", "+-", "y mg", "+-", "z mg", "+-")
PERCENT = (Kind.SCALE, Kind.MISALIGNMENT)


def overview(devices: Sequence[DeviceReview]) -> str:
    """Write a line for each device, with the verdict and its first reason."""
    often = Counter(device.key.serial for device in devices)
    cells = [_line(device, several=often[device.key.serial] > 1) for device in devices]
    return _with_last(aligned(HEAD, cells), ["verdict", "-------", *map(_verdict, devices)])


def _with_last(table: str, column: list[str]) -> str:
    """Append one more column, of any width, on the right of a table."""
    lines = table.splitlines()
    width = max(map(len, lines))
    return "\n".join(f"{line.ljust(width)}  {text}" for line, text in zip(lines, column, strict=True))


def _line(device: DeviceReview, *, several: bool) -> list[str]:
    """Write a device's cells; where several have its serial, with model and format."""
    key = device.key
    kind = f" ({key.model or '-'}, {key.format or '-'})" if several else ""
    return [
        printable(f"{key.serial}{kind}"),
        str(device.recordings),
        str(device.counted(Usage.USED, Usage.UNDATED)),
        str(device.refused),
        _date(device.begin),
        _date(device.end),
        formatted(device.held_out_mg, ".2f"),
        _fastest(device, (Kind.OFFSET,)),
        _fastest(device, PERCENT),
    ]


def _date(start: str | None) -> str:
    return "-" if start is None else start[:10]


def _fastest(device: DeviceReview, kinds: tuple[Kind, ...]) -> str:
    """Write the fastest drift of some kinds of parameters, with its standard error."""
    fastest = device.fastest_drift(*kinds)
    if fastest is None:
        return "undated" if device.counted(Usage.UNDATED) and not device.counted(Usage.USED) else "not enough"
    return with_error(fastest.per_month, fastest.error)


def _verdict(device: DeviceReview) -> str:
    if not device.findings:
        return in_words(device.verdict)
    first, *others = device.findings
    more = f"; and {len(others)} more" if others else ""
    return f"{in_words(device.verdict)}: {of_device(first.reason)}{more}"


def detail(review: Review, device: DeviceReview) -> str:
    """Write all of one device: its verdict, its parameters, its recordings."""
    key = device.key
    about = [key.model, key.format, *device.firmware]
    name = (
        f"{key.serial} ({', '.join(filter(None, about)) or 'of unknown model'}): {in_words(device.verdict)}"
    )
    reasons = [
        f"  {'perhaps: ' if one.verdict is Verdict.WATCH else ''}{of_device(one.reason)}"
        for one in device.findings
    ]
    temperature = [] if device.reference_c is None else [f"offsets at {device.reference_c:.1f} C"]
    parameters = [aligned(DETAIL, [_trend(trend) for trend in device.trends]), ""] if device.trends else []
    cells = [_recording(review, index) for index in device.rows]
    paths = [printable(review.records.text["path"][index] or "-") for index in device.rows]
    history = _with_last(aligned(HISTORY, cells), ["path", "----", *paths])
    return "\n".join([printable(name), *reasons, "", *temperature, *parameters, history])


def _trend(trend: Trend) -> list[str]:
    digits = ".4f" if trend.parameter.kind is not Kind.OFFSET else ".3f"
    drift = ["not enough", "-", "-", str(trend.number), "-"]
    if trend.drift is not None:
        change = f"{trend.drift.per_month:+{digits}}", f"{trend.drift.error:{digits}}"
        certain = "yes" if trend.drift.significant else "no"
        drift = [*change, f"{trend.drift.scatter:.1f}", str(trend.number), certain]
    label = f"{trend.parameter.label} {trend.parameter.unit}"
    return [label, f"{trend.value:+{digits}}", f"{trend.error:{digits}}", *drift]


def _recording(review: Review, index: int) -> list[str]:
    text, moved = review.records.text, review.referred.records
    cells = [_date(text["start_time"][index]), text["outcome"][index] or "-", str(review.usage[index])]
    cells += [text["model"][index] or "-", _finite(float(review.records.number["after_mg"][index]), ".2f")]
    for offset in range(len(PARAMETERS))[OFFSETS]:
        cells.append(_finite(1000 * float(moved.values[index, offset]), "+.2f"))
        cells.append(_finite(1000 * float(moved.errors[index, offset]), ".2f"))
    return cells


def _finite(value: float, form: str) -> str:
    return formatted(value if isfinite(value) else None, form)


LIMITS = {
    "offset_mg": "Limit for the offset of an axis.",
    "scale_percent": "Limit for the scale error of an axis.",
    "misalignment_percent": "Limit for the misalignment between two axes.",
    "slope_mg_per_c": "Limit for the temperature slope of an offset.",
    "drift_mg": "Limit for the drift of an offset per month, or of a slope over 10 C.",
    "drift_percent": "Limit for the drift of scale or misalignment per month.",
    "certain_mg": "Limit for the upper end of the calibration error of a recording that shows a good device.",
    "outlying": "Limit for the held-out error above that of similar devices, in robust standard deviations.",
    "refused_percent": "Limit for the share of recordings refused or borrowed.",
    "damaged_percent": "Limit for the share of recordings that lost bytes to damage.",
    "least_days": "Shortest time span, in days, over which a drift is estimated.",
}
"""Limits of the rules, and what each means."""


def known_rules() -> dict[str, Named]:
    """Return the numbers of the rules that can be set, by name."""
    limits = {
        name: Named("N", f"{text}  [default: {getattr(Rules(), name):g}]", Positive())
        for name, text in LIMITS.items()
    }
    text = "Temperature at which offsets are compared.  [default: the median of each device's recordings]"
    return limits | {"reference_c": Named("C", text, Within(*bounds_of("reference_c")))}


@click.command(
    "devices",
    cls=Command,
    examples=(
        "devices calibrated # calibrated: the output folder of a study",
        "devices calibrated --device 12345 # one device, with all parameters and recordings",
    ),
)
@click.argument("out", type=FILE)
@click.option("--device", metavar="SERIAL", help="Show this device only, in detail.")
@click.option("--json", "as_json_", is_flag=True, help="Print one JSON object.")
@click.option("--csv", "as_csv", is_flag=True, help="Print one CSV table with a row for each recording.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing on stderr.")
@click.option("--rule", "rules", type=NameValue(known_rules), multiple=True,
              help="Set a number of the rules (--help-all lists them).")  # fmt: skip
@click.option("--registry", type=FILE, metavar="FILE.json",
              help="Add the good calibrations to this registry, which is made if it is missing.")  # fmt: skip
@click.option("--keep-teaching", is_flag=True, help="Count recordings that people excluded, too.")
def command(out: Path, **values: Any) -> int:
    """Show how the devices of a study drift, which of them need service, and why.

    OUT is the output folder of `accelcal study`; only its study.parquet is read. One line is printed for each
    device: its recordings, the fastest drift of an offset and of scale or misalignment with standard errors,
    and a verdict (two sensors, service, watch, good or unknown) with the first reason.

    With --registry, the good calibrations of the study (or of another registry, if OUT is one) are added to
    FILE.json, from which `calibrate`, `apply` and `study` take the best one for a recording that cannot be
    calibrated by itself. Registries can be merged in any order, with the same result.
    """
    refuse_both(as_json=values["as_json_"], as_csv=values["as_csv"])
    if values["registry"] is not None:
        exit_codes.say(added(out, values["registry"], keep_teaching=values["keep_teaching"]))
        if is_registry(out):
            return exit_codes.OK
    rules = Rules(**dict(values["rules"]))
    reviewed = review(out, rules, time.time(), keep_teaching=values["keep_teaching"])
    devices = chosen(reviewed, values["device"], out)
    exit_codes.show(_shown(reviewed, devices, values))
    if not values["quiet"]:
        exit_codes.say(_summary(reviewed, devices))
    return exit_codes.OK


def _shown(reviewed: Review, devices: tuple[DeviceReview, ...], values: dict[str, Any]) -> str:
    if values["as_json_"]:
        return json.dumps(as_json(reviewed, devices))
    if values["as_csv"]:
        rows = [row(reviewed, device, index) for device in devices for index in device.rows]
        return csv_text(columns(), [list(one.values()) for one in rows]).rstrip("\n")
    if values["device"] is not None:
        return "\n\n".join(detail(reviewed, device) for device in devices)
    return overview(devices)


def _summary(reviewed: Review, devices: tuple[DeviceReview, ...]) -> str:
    verdicts = Counter(in_words(device.verdict) for device in devices)
    counts = [f"{number} {name}" for name, number in verdicts.items()]
    text = counted(len(devices), "device")
    text += f": {', '.join(counts)}" if counts else ""
    records = reviewed.records
    if records.excluded:
        text += f"; {counted(records.excluded, 'recording')} excluded by people"
    if records.nameless:
        text += f"; {counted(records.nameless, 'recording')} without a serial number"
        text += f", {records.failed} of them failed" if records.failed else ""
    return text
