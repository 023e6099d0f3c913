"""`accelcal inspect`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import aligned, bytes_of, counted_once, progress_bars
from accelcal_cli.core.errors import AccelcalError, Reason, UsageError, counted, printable
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, OtherColumn
from accelcal_cli.formats import refuse_unused
from accelcal_cli.output.sentences import sentence
from accelcal_cli.pipeline.inspect import Inspection, as_json, failed_json, inspect, inspection_settings
from accelcal_cli.pipeline.jobs import STDIN, Request
from accelcal_cli.pipeline.options import read_options

HEAD = ["recording", "format", "device", "start", "hours", "Hz", "range g", "prediction"]
WIDTH, WIDEST_CELL, SHORTEST_NAME = 100, 16, 12
"""Columns of a terminal that the table of several recordings has, and bounds of its cells."""

CLOCKS_S_PER_DAY = 86.4
"""Drift [s per day] beyond which a nominal rate is not meant as exact: no clock is a thousandth off."""


@click.command(
    "inspect",
    cls=Command,
    examples=(
        "inspect recording.cwa # header, rate, range, gaps and the predicted outcome",
        "inspect table.csv --unit mg --json # the same of a table in mg, for programs",
    ),
)
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--full", is_flag=True, help="Read everything, not just pieces.")
@click.option("--long", is_flag=True, help="Show everything about each recording, even if there are several.")
@click.option("--json", "as_json_", is_flag=True, help="Print one JSON object per line.")
@options.reading_options
@options.config_option
@options.parts_option
@options.error_option
@options.strict_option
@options.method_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Show what each RECORDING holds and predict the outcome of calibrating it; `-` reads standard input.

    Files of up to 8 MB are read completely. In larger files only the headers and pieces spread over the file
    are read, unless --full is given. Several recordings are shown as a table with a row for each.
    """
    if recordings.count(STDIN) > 1:
        raise UsageError("standard input can be read only once", hint="give - only once")
    named = options.recordings_of(recordings, values)
    several = len(named) > 1
    reading = read_options(values)
    if several and STDIN not in recordings:
        refuse_unused(named, reading)
    rules, parts = options.rules_of(values), values["parts"]
    request = Request(
        reading,
        inspection_settings(values, full=values["full"]),
        several=several,
        rules=rules,
        parts=parts,
        joined=parts,
    )
    if several and not (values["long"] or values["as_json_"]):
        return _table(named, request, values)
    return exit_codes.of_all([_one(path, request, values) for path in named])


def _table(named: Sequence[Path], request: Request, values: dict[str, Any]) -> int:
    """Print a table of several recordings, those that failed among them."""
    rows, codes = [], []
    with progress_bars("inspect", quiet=False, unit="") as bars:
        done = bars("recordings", len(named))
        for path in named:
            inspection, code = _inspected(path, request, values)
            rows.append(_row(path, None if inspection is None else as_json(inspection)))
            codes.append(code)
            done(len(rows))
    if sys.stdout.isatty():
        others = sum(2 + max(map(len, cells)) for cells in list(zip(HEAD, *rows, strict=True))[1:])
        rows = [[_shortened(row[0], max(SHORTEST_NAME, WIDTH - others)), *row[1:]] for row in rows]
    exit_codes.show(aligned(HEAD, rows))
    return exit_codes.of_all(codes)


def _row(path: Path, shown: dict[str, Any] | None) -> list[str]:
    """Return the cells of a recording, `-` for what is not known."""
    if shown is None:
        return [printable(path), *["-"] * (len(HEAD) - 2), "failed"]
    about = shown["recording"]
    device, hours = about["device"], about["duration_s"]
    cells = [
        about["format"],
        device["serial"] or device["model"],
        (about["start_time"] or "")[:16].replace("T", " "),
        None if hours is None else f"{hours / 3600:.2f}",
        f"{about['sample_rate_hz']:.5g}",
        _known("{:g}", about["range_g"]),
        shown["prediction"]["outcome"],
    ]
    return [printable(path), *(printable(cell)[:WIDEST_CELL] if cell else "-" for cell in cells)]


def _shortened(name: str, width: int) -> str:
    """Return a name that is too wide for its column without its middle."""
    half = (width - 2) // 2
    return name if len(name) <= width else f"{name[: width - 2 - half]}..{name[-half:]}"


def _inspected(path: Path, request: Request, values: dict[str, Any]) -> tuple[Inspection | None, int]:
    """Return what was found in a recording, and the exit code; a failure is printed."""
    try:
        with bytes_of(path) as source:
            inspection = inspect(source, request, full=values["full"])
    except AccelcalError as error:
        code = exit_codes.of_failure(error)
        if values["as_json_"]:
            exit_codes.show(json.dumps(failed_json(path, code, error.line_for((path,)))))
        return None, code
    return replace(inspection, recording=replace(inspection.recording, path=path)), exit_codes.OK


def _one(path: Path, request: Request, values: dict[str, Any]) -> int:
    inspection, code = _inspected(path, request, values)
    if inspection is None:
        return code
    shown = as_json(inspection)
    exit_codes.show(json.dumps(shown) if values["as_json_"] else text(inspection, shown))
    return code


def text(inspection: Inspection, shown: dict[str, Any]) -> str:
    """Write an inspection for people."""
    windows = f"{shown['read']['still_windows']} of {inspection.windows.complete}"
    scope = "all of it" if inspection.whole else f"{inspection.facts.samples} samples in pieces"
    problems = counted_once((one["code"], one["message"]) for one in shown["file_health"]["problems"])[:5]
    lines = [
        *_recording(shown["recording"], inspection.facts.rate_hz, inspection.recording.others),
        f"  read         {scope}: {windows} windows still",
        *_values(shown["values"]),
        f"  problems     {'; '.join(problems) or 'none found'}",
        f"  damage       {shown['file_health']['lost_percent']:g} % of the bytes that were read are lost",
        f"  clock        {_clock(shown['file_health']['clock'])}",
        f"  prediction   {shown['prediction']['outcome']}: {shown['prediction']['message']}",
        *(f"  caution      {sentence(one)}" for one in inspection.prediction.cautions),
        *(f"  caution      {sentence(Reason(**one))}" for one in shown["prediction"]["cautions"]),
        *(f"  what to do   {sentence(one)}" for one in inspection.prediction.advice),
    ]
    notes = [f"  note         {note}" for note in shown["recording"]["notes"]]
    return "\n".join(map(printable, lines + notes))


def _recording(about: dict[str, Any], rate_hz: float | None, others: Iterable[OtherColumn]) -> list[str]:
    """Write lines about a recording, by the object of its inspection and its measured rate."""
    device = " ".join(value for value in about["device"].values() if value) or "unknown"
    extras = [*(name for name in ("temperature", "gyroscope") if about[name]), *(one.name for one in others)]
    scale = f"{about['lsb_per_g']:.10g} counts per g"
    if about["lsb_per_g"] >= FLOAT_LSB_PER_G:
        scale = "decimal values, in steps of 2^-24 g"
    hours = None if about["duration_s"] is None else f"{about['duration_s'] / 3600:.2f} h"
    return [
        about["path"],
        f"  format       {about['format']}, {about['bytes']} bytes",
        f"  device       {device}",
        f"  rate         {about['sample_rate_hz']:g} Hz{_known(' (measured {:.3f})', rate_hz)}",
        f"  scale        {scale}{_known(', range +-{:g} g', about['range_g'])}",
        f"  start        {about['start_time'] or 'unknown'} ({about['timezone'] or 'device clock'})",
        f"  duration     {hours or 'unknown'}{_known(', {} samples', about['samples'])}",
        f"  also holds   {', '.join(extras) or 'nothing'}",
    ]


def _values(values: dict[str, Any] | None) -> list[str]:
    """Write lines about raw values; none without samples."""
    if values is None:
        return []
    rows = [f"{one['time']}  {'  '.join(f'{v:8.4f}' for v in one['g'])}" for one in values["first"]]
    axes = zip("xyz", values["low_g"], values["high_g"], values["mean_g"], strict=True)
    spans = ", ".join(f"{axis} {low:.2f} to {high:.2f} (mean {mean:.2f})" for axis, low, high, mean in axes)
    lines = [f"  {'first rows' if not place else '':<12} {row} g" for place, row in enumerate(rows)]
    lines += [f"  values       {spans} g"]
    rest = values["rest"]
    if rest is not None:
        low, middle, high = (rest[name] for name in ("p5_g", "median_g", "p95_g"))
        spread = f"5th to 95th percentile {low:.3f} to {high:.3f} g"
        lines += [f"  at rest      |a|: median {middle:.3f} g, {spread}"]
    return lines


def _known(text: str, value: float | None) -> str:
    """Put a value into a text; empty if the value is not known."""
    return "" if value is None else text.format(value)


def _clock(clock: dict[str, Any]) -> str:
    drift, gaps = clock["drift_s_per_day"], clock["gaps"]
    if drift is None:
        parts = ["drift unknown"]
    elif abs(drift) > CLOCKS_S_PER_DAY:
        parts = [f"{clock['rate_hz_measured']:.4g} Hz measured, {clock['rate_hz_nominal']:g} Hz nominal"]
    else:
        parts = [f"drift {drift + 0.0:+g} s/day"]
    if gaps is not None:
        back = "1 step back" if clock["backward"] == 1 else f"{clock['backward']} steps back"
        parts += [f"{counted(gaps, 'gap')} ({clock['gap_seconds']:g} s)", back]
    return ", ".join(parts)
