"""`accelcal evaluate duration`: how long a device has to be worn for a calibration of a given error.

Segments of each length are calibrated as if they were all there is. The error over all orientations is that
against the calibration of the rest of the recording, which the segment has no part in; segments are at most
half as long as the recording, so that the rest is better known. For a recording that is refused as a whole,
the lengths at which others of its kind are calibrated say how many more hours usually help.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, astuple, dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import click
import numpy as np

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import aligned, each_recording, refuse_both
from accelcal_cli.core.arithmetic import mean, quantile
from accelcal_cli.core.calibration import IDENTITY, Calibration
from accelcal_cli.core.errors import printable
from accelcal_cli.core.recording import Device
from accelcal_cli.core.results import Outcome
from accelcal_cli.core.settings import Settings
from accelcal_cli.judge.errors import apart_mg
from accelcal_cli.laboratory.segments import (
    Stillness,
    collected,
    inside,
    starts,
    stillness,
    stillness_of_table,
    table_hours_option,
)
from accelcal_cli.output.files import csv_text
from accelcal_cli.output.numbers import formatted
from accelcal_cli.output.sentences import explained, kind_of
from accelcal_cli.pipeline.jobs import ProgressMaker
from accelcal_cli.pipeline.options import chosen_settings, read_options, recording_options
from accelcal_cli.pipeline.procedures import fitting
from accelcal_cli.pipeline.survey import open_marked
from accelcal_cli.studies.discovery import recordings_in

NONE = Calibration("0", IDENTITY)
"""Calibration of raw data: none."""

ENOUGH = 0.9
"""Share of the segments of a length that are calibrated where it usually suffices."""

USUAL_H = 12.0
"""Length [h] that sufficed in 84 h of a GENEActiv (docs/evaluation.md), if no other recording tells."""


@dataclass(frozen=True, slots=True)
class Worn:
    """One segment of a recording, calibrated as if it were all there is.

    Attributes:
        error_mg: mean | |a| - 1 g | over all orientations by the calibration of the rest; None where one of
            the two has no calibration. raw_mg: the same without calibration.
        claimed_mg: the error that the report claims.
    """

    recording: str
    kind: str
    hours: float
    start_h: float
    outcome: str
    error_mg: float | None
    raw_mg: float | None
    claimed_mg: float | None


@dataclass(frozen=True, slots=True)
class Measured:
    """One recording: its segments, and why it is refused as a whole, if it is."""

    recording: str
    kind: str
    span_h: float
    segments: tuple[Worn, ...]
    refusal: str | None


@dataclass(frozen=True, slots=True)
class Length:
    """Segments of one length together; errors are None without any that has one.

    Attributes:
        usable: share with a calibration; provisional: share whose calibration is to be used with care.
        error_mg, error_p90_mg: mean and 90th percentile of the error over all orientations.
    """

    kind: str
    hours: float
    segments: int
    usable: float
    provisional: float
    error_mg: float | None
    error_p90_mg: float | None
    claimed_mg: float | None
    raw_mg: float | None


def measured(path: Path, still: Stillness, device: Device, hours: Sequence[float], settings: Settings,
             number: int) -> Measured:  # fmt: skip
    """Judge segments of a recording of up to half its length, and all of it.

    Raises:
        UsageError: the settings have a profile without orientation cells.
    """
    kind = kind_of(str(path), device.model)
    found = [
        _worn(still, start, length, settings, (printable(path), kind))
        for length in hours
        if 2 * length <= still.span_h
        for start in starts(still, length, number, settings)
    ]
    verdict = collected(still, np.ones(len(still.windows), np.bool_), settings).judge(fitting(settings))
    refused = verdict.outcome is Outcome.REFUSED
    refusal = explained(verdict.reason, verdict.advice) if refused else None
    return Measured(printable(path), kind, still.span_h, tuple(found), refusal)


def _worn(still: Stillness, start_h: float, hours: float, settings: Settings, named: tuple[str, str]) -> Worn:
    which, how = inside(still, start_h, hours), fitting(settings)
    verdict = collected(still, which, settings).judge(how)
    rest = collected(still, ~which, settings).judge(how)
    error = raw = None
    if verdict.calibration is not None and rest.calibration is not None:
        error, raw = (apart_mg(one, rest.calibration) for one in (verdict.calibration, NONE))
    claimed = None if verdict.sphere is None or verdict.calibration is None else verdict.sphere.mean
    return Worn(*named, hours, start_h, str(verdict.outcome), error, raw, claimed)


def lengths(found: Sequence[Measured]) -> list[Length]:
    """Return the segments of each kind and length together, and of all kinds if there are several."""
    segments = list(chain.from_iterable(one.segments for one in found))
    kinds = list(dict.fromkeys(segment.kind for segment in segments))
    rows = [row for kind in kinds for row in _lengths(kind, [one for one in segments if one.kind == kind])]
    return [*rows, *(_lengths("all", segments) if len(kinds) > 1 else [])]


def _lengths(kind: str, segments: Sequence[Worn]) -> Iterator[Length]:
    for hours in sorted({one.hours for one in segments}):
        group = [one for one in segments if one.hours == hours]
        outcomes = [one.outcome for one in group]
        columns = {
            name: [value for one in group if (value := getattr(one, name)) is not None]
            for name in ("error_mg", "claimed_mg", "raw_mg")
        }
        means = {name: mean(values) if values else None for name, values in columns.items()}
        errors = sorted(columns["error_mg"])
        yield Length(
            kind,
            hours,
            len(group),
            usable=1 - outcomes.count(Outcome.REFUSED) / len(group),
            provisional=outcomes.count(Outcome.PROVISIONAL) / len(group),
            error_p90_mg=quantile(errors, 0.9) if errors else None,
            **means,
        )


def missing(one: Measured, rows: Sequence[Length]) -> str:
    """Return what a refused recording lacks, and how many more hours usually bring it."""
    needed, known_from = USUAL_H, "a recording of 84 h of a GENEActiv"
    for kind, words in (("all", "the other recordings"), (one.kind, f"other recordings of {one.kind}")):
        of_kind = [row for row in rows if row.kind == kind]
        if enough := [row.hours for row in of_kind if row.usable - row.provisional >= ENOUGH]:
            needed, known_from = min(enough), words
    more = needed - one.span_h
    lacks = f"about {more:.0f} more usually help" if more > 0 else "length is not what it lacks"
    usually = f"{ENOUGH:.0%} of segments of {needed:g} h are calibrated, by {known_from}"
    return f"{one.refusal}. It has {one.span_h:.1f} h, and {usually}: {lacks}"


FIGURES = {
    "hours": "g", "segments": "d", "usable": ".0%", "provisional": ".0%", "error_mg": ".3f",
    "error_p90_mg": ".3f", "claimed_mg": ".3f", "raw_mg": ".2f",
}  # fmt: skip
"""Columns of the table and how their values are shown."""


@click.command(
    "duration",
    cls=Command,
    examples=("evaluate duration recording.cwa", "evaluate duration recordings --hours 6,12,24,48"),
)
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--hours", type=options.Listed(float, 0.1, 10_000), default="1,3,6,12,24,48,72,96",
              show_default=True,
              help="Lengths of wear; those of more than half a recording are left out.")  # fmt: skip
@click.option("--number", type=click.IntRange(1, 10_000), metavar="N", default=12, show_default=True,
              help="Largest number of segments of each length in a recording.")  # fmt: skip
@table_hours_option
@click.option("--json", "as_json_", is_flag=True, help="Print one JSON object.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.laboratory_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Show the calibration error over all orientations by hours of wear, for RECORDINGs or folders of them.

    Calibrates segments of each length as if each were a whole recording. Shows the share with a calibration,
    and with a provisional one, the mean and the 90th percentile of their error over all orientations, the
    error that their reports claim, and that of raw data. The calibration of the rest of the recording counts
    as the truth. Each model of device has rows of its own, and each wear site that the name of a file or
    folder shows. For a refused recording, shows what it lacks, and how many more hours usually bring it.
    """
    refuse_both(as_json=values["as_json_"], as_csv=values["as_csv"])
    reading, settings = read_options(values), chosen_settings(values)

    def work(path: Path, bars: ProgressMaker) -> Measured:
        if values["table_hours"] is not None:
            still, device = stillness_of_table(path, settings, values["table_hours"]), Device()
        else:
            with open_marked(path, recording_options(path, reading)) as reader:
                device = reader.recording.device
            still = stillness(path, reading, settings, values["chunk_samples"], bars)
        return measured(path, still, device, values["hours"], settings, values["number"])

    found, code = each_recording(recordings_in(recordings, reading), work, quiet=values["quiet"])
    if found:
        exit_codes.show(printable(_shown(found, values), kept="\n"))
    return code


def _shown(found: list[Measured], values: dict[str, Any]) -> str:
    rows = lengths(found)
    refused = {one.recording: missing(one, rows) for one in found if one.refusal is not None}
    if values["as_json_"]:
        segments = list(chain.from_iterable(one.segments for one in found))
        shown = {"lengths": list(map(asdict, rows)), "segments": list(map(asdict, segments))}
        return json.dumps(shown | {"refused": refused})
    if values["as_csv"]:
        return csv_text([*Length.__dataclass_fields__], map(astuple, rows)).rstrip("\n")
    table = (
        f"no recording is twice as long as the shortest of {', '.join(map('{:g} h'.format, values['hours']))}"
    )
    if rows:
        cells = [[formatted(getattr(row, key), form) for key, form in FIGURES.items()] for row in rows]
        head = ["device", *(key.replace("_", " ") for key in FIGURES)]
        table = aligned(head, [[row.kind, *shown] for row, shown in zip(rows, cells, strict=True)])
    return "\n".join([table, *(f"{name}: refused: {text}" for name, text in refused.items())])
