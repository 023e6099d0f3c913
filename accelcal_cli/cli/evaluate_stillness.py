"""`accelcal evaluate stillness`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.output import aligned, each_recording, number, refuse_both
from accelcal_cli.core.errors import printable
from accelcal_cli.core.settings import STILLNESS
from accelcal_cli.evaluate.methods import true_errors
from accelcal_cli.evaluate.stillness import RAW, Comparison, Found, compare
from accelcal_cli.output.files import csv_text
from accelcal_cli.output.report import rounded
from accelcal_cli.pipeline import given
from accelcal_cli.pipeline.jobs import ProgressMaker

Row = dict[str, Any]
FIGURES = {
    "windows": "d",
    "still_h": ".2f",
    "points": "d",
    "postures": "d",
    "outcome": "",
    "model": "",
    "before_mg": ".2f",
    "after_mg": ".3f",
    "gain_error": ".1e",
    "offset_error_mg": ".3f",
}
"""Columns of the first table and how their values are shown."""


@click.command("stillness")
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.reading_options
@options.fitting_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Calibrate each RECORDING by every stillness rule and compare the results.

    Shows what each rule found and the held-out error on its own points, then the mean error that each
    calibration leaves on the points of every rule. For a simulated recording with STEM.truth.json
    beside it, also the largest error of a gain term and of an offset.
    """
    refuse_both(as_json=values["as_json"], as_csv=values["as_csv"])

    def work(path: Path, bars: ProgressMaker) -> tuple[str, list[Row]]:
        chosen, chunk_samples = given.fitting_settings(values), values["chunk_samples"]
        compared = compare(path, given.read_options(values), chosen, chunk_samples, bars)
        return printable(path), rows(compared)

    found, code = each_recording(recordings, work, quiet=values["quiet"])
    if found:
        exit_codes.show(_shown(dict(found), values))
    return code


def _shown(results: dict[str, list[Row]], values: dict[str, Any]) -> str:
    if values["as_json"]:
        return "\n".join(json.dumps({"recording": path, "rules": rules}) for path, rules in results.items())
    if values["as_csv"]:
        head = ["recording", "rule", *FIGURES, *(f"on_{rule}_mg" for rule in STILLNESS)]
        cells = [_cells(path, row) for path, rules in results.items() for row in rules]
        return csv_text(head, cells).rstrip("\n")
    return "\n\n".join(f"{path}\n{text(rules)}" for path, rules in results.items())


def _cells(path: str, row: Row) -> list[Any]:
    return [path, row["rule"], *(row.get(name) for name in FIGURES), *row["on_points_of_mg"].values()]


def rows(comparison: Comparison) -> list[Row]:
    """A row for raw data and for each rule; None if there is nothing to say."""
    on = {
        rule: {name: rounded(error) for name, error in errors.items()}
        for rule, errors in comparison.errors_mg().items()
    }
    rows_of_rules = [_row(item, comparison) | {"on_points_of_mg": on[item.rule]} for item in comparison.found]
    return [{"rule": RAW, "on_points_of_mg": on[RAW]}, *rows_of_rules]


def _row(result: Found, comparison: Comparison) -> Row:
    holdout, calibration = result.judgement.holdout, result.judgement.calibration
    gain, offset_mg = None, None
    if calibration is not None and comparison.truth is not None:
        gain, offset_mg = true_errors(calibration, comparison.truth)
    return {
        "rule": result.rule,
        "windows": result.windows,
        "still_h": round(result.still_s / 3600, 4),
        "points": len(result.points),
        "postures": result.postures,
        "outcome": str(result.judgement.outcome),
        "model": None if calibration is None else calibration.model,
        "before_mg": None if holdout is None else rounded(holdout.before.mean),
        "after_mg": None if holdout is None else rounded(holdout.after.mean),
        "gain_error": None if gain is None else round(gain, 8),
        "offset_error_mg": rounded(offset_mg),
    }


def text(shown: list[Row]) -> str:
    """The two tables for people."""
    known = any(row.get("gain_error") is not None for row in shown)
    columns = [name for name in FIGURES if known or name not in ("gain_error", "offset_error_mg")]
    first = [
        [row["rule"], *(number(row[name], FIGURES[name]) for name in columns)]
        for row in shown
        if row["rule"] != RAW
    ]
    cross = [
        [row["rule"], *(number(error, ".3f") for error in row["on_points_of_mg"].values())] for row in shown
    ]
    head = ["rule", *(name.replace("_", " ") for name in columns)]
    return f"{aligned(head, first)}\n\n{aligned(['mg on the points of', *STILLNESS], cross)}"
