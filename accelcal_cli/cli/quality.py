"""`accelcal quality`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import aligned, bytes_of, progress_bars
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.output.coefficients import read_coefficients
from accelcal_cli.output.numbers import formatted
from accelcal_cli.output.words import begun_small, explained
from accelcal_cli.pipeline.jobs import Request
from accelcal_cli.pipeline.options import chosen_settings, read_options, recipient_settings
from accelcal_cli.pipeline.quality import Quality, QualityState, as_json, quality

CODES = {
    QualityState.HOLDS: exit_codes.OK,
    QualityState.DEGRADED: exit_codes.DEGRADED,
    QualityState.UNCHECKED: exit_codes.REFUSED,
    QualityState.REFUSED: exit_codes.REFUSED,
}
WORDS = {
    QualityState.HOLDS: "the calibration still fits",
    QualityState.DEGRADED: "the calibration has degraded",
    QualityState.UNCHECKED: "not judged",
    QualityState.REFUSED: "refused",
}
WORN = {True: "yes", False: "no", None: "-"}


@click.command(
    "quality",
    cls=Command,
    examples=(
        "quality recording.cwa # the error by the hour",
        "quality june.cwa --coefficients march.calibration.json # do the coefficients of March still fit?",
    ),
)
@click.argument("recording", type=options.FILE)
@click.option("--coefficients", type=options.FILE, metavar="NAME.calibration.json",
              help="Report whose coefficients are checked; otherwise the recording's own.")  # fmt: skip
@click.option("--any-device", is_flag=True, help="Accept coefficients of any device.")
@click.option("--json", "as_json_", is_flag=True, help="Print a JSON object.")
@click.option("--tsv", is_flag=True, help="Print tab-separated rows with all columns at a terminal too.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors on stderr.")
@options.reading_options
@options.parts_option
@options.error_option
@options.method_options
def command(recording: Path, **values: Any) -> int:
    """Check, hour by hour, whether a calibration still fits RECORDING; `-` reads standard input.

    With --coefficients, checks the coefficients of an earlier report against this recording. Prints a row
    for each hour, then a sentence, and writes nothing. The exit code is 0 if the calibration still fits, 1 if
    it does not, and 4 if the recording is refused or does not show it.
    """
    request = measuring_request(recording, values)
    with bytes_of(recording) as source, progress_bars(recording.name, quiet=values["quiet"]) as bars:
        judged = quality(recording, request, bars, source)
    shown = as_json(judged)
    exit_codes.show(json.dumps(shown) if values["as_json_"] else text(judged, shown, tsv=values["tsv"]))
    return CODES[judged.state]


def measuring_request(recording: Path, values: dict[str, Any]) -> Request:
    """Make the request; raises UsageError for options that mean nothing."""
    path = values["coefficients"]
    if path is None and values["any_device"]:
        raise UsageError("--any-device is for --coefficients only", path=recording, hint="omit it")
    return Request(
        options=read_options(values),
        parts=values["parts"],
        joined=values["parts"],
        settings=chosen_settings(values) if path is None else recipient_settings(values),
        chunk_samples=values["chunk_samples"],
        coefficients=None if path is None else read_coefficients(path),
        any_device=values["any_device"],
        report_only=True,
    )


def text(judged: Quality, shown: dict[str, Any], *, tsv: bool) -> str:
    """Write rows and a sentence: aligned and without rarely read columns for people, else tab-separated."""
    rows = shown["rows"]
    if not rows["start"]:
        return _sentence(judged)
    columns = {"start": [time.partition(".")[0] for time in rows["start"]], "windows": rows["windows"]}
    for when in ("before_mg", "after_mg"):
        both = rows[when] or dict.fromkeys(("mean", "p95"), [None] * len(rows["start"]))
        columns |= {f"{when}": both["mean"], f"{when.removesuffix('mg')}p95_mg": both["p95"]}
    columns |= {"celsius": rows["temperature_c"], "worn": [WORN[one] for one in rows["worn"]]}
    if sys.stdout.isatty() and not tsv:
        return f"{aligned(list(columns), _lines(columns))}\n\n{_sentence(judged)}"
    columns |= {name: rows[name] for name in ("still", "moving", "gap_s", "filled", "clipped", "recovered")}
    lines = _lines(columns)
    return "\n".join(["\t".join(line) for line in (columns, *lines)] + [_sentence(judged)])


def _lines(columns: dict[str, list[Any]]) -> list[list[str]]:
    cells = (
        [str(value) if isinstance(value, str | int) else formatted(value, ".2f") for value in column]
        for column in columns.values()
    )
    return [list(line) for line in zip(*cells, strict=True)]


def _sentence(judged: Quality) -> str:
    why = begun_small(explained(judged.reasons[0], judged.reasons[1:]))
    return printable(f"{judged.path}: {WORDS[judged.state]}: {why}")
