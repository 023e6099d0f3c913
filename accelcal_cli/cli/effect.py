"""`accelcal effect`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from accelcal_cli.activity_effect import ENDS, MeasuredEffect, as_json, check_table, effect
from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import aligned, bytes_of, each_recording, refuse_both
from accelcal_cli.cli.quality import measuring_request
from accelcal_cli.core.errors import UsageError, printable
from accelcal_cli.output.files import csv_text
from accelcal_cli.output.numbers import formatted
from accelcal_cli.pipeline.activity import CALIBRATED, EPOCH_S, LONGEST_EPOCH_S
from accelcal_cli.pipeline.jobs import ProgressMaker

FIGURES = {
    "enmo_mg": ("ENMO mg", ".2f"),
    "mad_mg": ("MAD mg", ".2f"),
    "mvpa_min": ("MVPA min", ".1f"),
    "pim_mg_s": ("PIM mg s/min", ".0f"),
    "zcm": ("ZCM /min", ".2f"),
    "angle_deg": ("arm angle deg", ".2f"),
    "inactive_min": ("inactive min", ".1f"),
    "enmo_differs_mg": ("ENMO differs mg", ".2f"),
}
"""Measures of each version: their names for people, and the formats of their numbers."""

WORDS = {
    "without_misalignment": "no misalignment",
    "calibrated_low": "95 % interval: from",
    "calibrated_high": "to",
    "raw_bias": "raw is off by",
}

ONLY_FOR_PROGRAMS = ("raw_bias_low", "raw_bias_high")
"""Rows that are left out of the table for people: they follow from the others."""


@click.command(
    "effect",
    cls=Command,
    examples=(
        "effect recording.cwa # ENMO, MAD and others, raw and calibrated",
        "effect recording.cwa --epochs epochs.csv # also a table with a row for each epoch",
    ),
)
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--coefficients", type=options.FILE, metavar="NAME.calibration.json",
              help="Report whose coefficients are applied; otherwise each recording's own.")  # fmt: skip
@click.option("--any-device", is_flag=True, help="Accept coefficients of any device.")
@click.option("--epoch", "epoch_s", type=click.IntRange(1, LONGEST_EPOCH_S), default=EPOCH_S,
              show_default=True, metavar="SECONDS", help="Length of an epoch.")  # fmt: skip
@click.option("--epochs", "table", type=options.FILE, metavar="FILE.csv",
              help="Also write a row for each epoch.")  # fmt: skip
@click.option("--force", is_flag=True, help="Overwrite a table that accelcal did not write.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table.")
@click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors on stderr.")
@options.reading_options
@options.parts_option
@options.error_option
@options.method_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Show how the calibration of each RECORDING changes measures of activity; `-` reads standard input.

    Prints ENMO, MAD, minutes of moderate to vigorous activity (ENMO of 100 mg or more), PIM, ZCM and minutes
    of sustained inactivity. They are computed from raw values, from values calibrated without misalignment,
    and from calibrated values; for a simulated recording with NAME.truth.json next to it, also with the true
    parameters. The 95 % intervals show the uncertainty of the calibration. Filled, clipped and recovered
    samples are left out. Nothing is written except the table of --epochs.
    """
    refuse_both(as_json=values["as_json"], as_csv=values["as_csv"])
    if (table := values["table"]) is not None:
        if len(recordings) > 1:
            raise UsageError("--epochs names one file, but there are several recordings", hint="give one")
        check_table(table, force=values["force"])

    def work(path: Path, bars: ProgressMaker) -> MeasuredEffect:
        request = measuring_request(path, values)
        with bytes_of(path) as source:
            return effect(path, request, values["epoch_s"], table, bars, source)

    def instead(path: Path, message: str) -> MeasuredEffect:
        return MeasuredEffect(path, "failed", printable(message), {})

    wanted = instead if values["as_json"] else None
    named = options.recordings_of(recordings, values)
    measured, code = each_recording(named, work, quiet=values["quiet"], instead=wanted)
    if measured:
        exit_codes.show(_shown(measured, values))
    return code


def _shown(measured: list[MeasuredEffect], values: dict[str, Any]) -> str:
    if values["as_json"]:
        return "\n".join(json.dumps(as_json(one)) for one in measured)
    if values["as_csv"]:
        head = ["recording", "outcome", "version", "model", *FIGURES]
        rows = [
            [printable(one.path), one.outcome, name, made.get("model"), *map(made.get, FIGURES)]
            for one in measured
            for name, made in _rows(one.effect).items()
        ]
        return csv_text(head, rows).rstrip("\n")
    return "\n\n".join(map(_text, measured))


def _rows(effect: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return figures by the name of a row: versions, the interval of the calibrated one, and the raw bias."""
    rows = {}
    for name, figures in effect["versions"].items():
        rows[name] = figures
        if name == CALIBRATED and effect["ci95"] is not None:
            rows |= _ends(name, effect["ci95"])
    if (bias := effect["raw_bias"]) is not None:
        rows["raw_bias"] = {key: one["value"] for key, one in bias.items()}
        rows |= _ends("raw_bias", {key: one["ci95"] for key, one in bias.items()})
    return rows


def _ends(name: str, intervals: dict[str, list[float]]) -> dict[str, dict[str, Any]]:
    return {
        f"{name}_{end}": {key: pair[place] for key, pair in intervals.items()}
        for place, end in enumerate(ENDS)
    }


def _text(one: MeasuredEffect) -> str:
    """Write a row for each version, and what was left out."""
    rows = [
        [
            WORDS.get(name, name) + ("" if made.get("model") is None else f" ({made['model']})"),
            *(formatted(made.get(key), form) for key, (_, form) in FIGURES.items()),
        ]
        for name, made in _rows(one.effect).items()
        if name not in ONLY_FOR_PROGRAMS
    ]
    table = aligned(["", *(words for words, _ in FIGURES.values())], rows)
    lines = [f"{one.path}: {one.outcome}: {one.message}", table, _counted(one)]
    return printable("\n".join(lines), kept="\n")


def _counted(one: MeasuredEffect) -> str:
    counts = one.effect
    left = ", ".join(f"{value} {name}" for name, value in counts["left_out"].items() if value)
    text = f"{counts['epochs']} epochs of {counts['epoch_s']} s"
    if counts["short_epochs"]:
        text += f"; {counts['short_epochs']} more with too few samples"
    return text + (f"; samples left out: {left} ({counts['left_out_percent']:.3g} %)" if left else "")
