"""`accelcal evaluate methods`."""

from __future__ import annotations

import json
from itertools import chain
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.output import aligned, each_recording, number, refuse_both
from accelcal_cli.core.errors import UsageError
from accelcal_cli.evaluate.methods import TABLE_3_OF_F, Row, as_json, compare, means
from accelcal_cli.optimize import all_optimizers, named_optimizer
from accelcal_cli.output.files import csv_text
from accelcal_cli.pipeline import given
from accelcal_cli.pipeline.jobs import ProgressMaker

HEAD = ("optimizer", "model", "before mg", "after mg", "improved %", "iterations", "operations", "ms")
MEANS = ("mean over recordings", "calibrated", "before mg", "after mg", "improved %")
PUBLISHED = ("Table 3 of Farago, Maczak, Gingl 2024 (own recordings)", "before mg", "after mg", "improved %")


@click.command("methods")
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option(
    "--only", type=options.OPTIMIZERS, metavar="A,B", help="Compare only these optimizers.  [default: all]"
)
@click.option("--json", "as_json_", is_flag=True, help="Print one JSON object.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.reading_options
@options.comparing_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Fit the same points of each RECORDING with every optimizer and judge them all by the same hold-out.

    Before and after are the mean held-out errors, improved is before / after x 100 (eq. 21 of the
    paper), operations are additions and multiplications where they are counted, ms is the time of
    one fit. All fit without a prior, so that they can be compared; `calibrate` has one by default,
    and its figures differ. With --profile paper: 18 points and a second set to judge by, as in the paper.
    """
    refuse_both(as_json=values["as_json_"], as_csv=values["as_csv"])
    names = _names(values["only"])

    def work(path: Path, bars: ProgressMaker) -> list[Row]:
        return list(compare(path, given.read_options(values), given.settings(values), names, bars))

    found, code = each_recording(recordings, work, quiet=values["quiet"])
    if rows := list(chain.from_iterable(found)):
        exit_codes.show(_shown(rows, values))
    return code


def _names(only: str | None) -> tuple[str, ...]:
    if only is None:
        return tuple(item.name for item in all_optimizers())
    names = tuple(name.strip() for name in only.split(",") if name.strip())
    if not names:
        raise UsageError("--only names no optimizer")
    return tuple(named_optimizer(name).name for name in names)


def _shown(rows: list[Row], values: dict[str, Any]) -> str:
    if values["as_json_"]:
        return json.dumps(as_json(rows))
    if values["as_csv"]:
        fields = list(Row.__dataclass_fields__)
        return csv_text(fields, [[getattr(row, name) for name in fields] for row in rows]).rstrip("\n")
    published = [[name, str(before), str(after), str(gain)] for name, before, after, gain in TABLE_3_OF_F]
    return "\n\n".join([*_tables(rows), *_means(rows), aligned(PUBLISHED, published)])


def _tables(rows: list[Row]) -> list[str]:
    tables = []
    for recording in dict.fromkeys(row.recording for row in rows):
        own = [row for row in rows if row.recording == recording]
        refusals = [f"{row.optimizer}: {row.outcome}: {row.message}" for row in own if row.model is None]
        tables.append("\n".join([recording, aligned(HEAD, [_cells(row) for row in own]), *refusals]))
    return tables


def _means(rows: list[Row]) -> list[str]:
    """A table of the means over recordings; none for a single one."""
    lines = [
        [
            one.optimizer,
            str(one.recordings),
            number(one.before_mg, ".3f"),
            number(one.after_mg, ".3f"),
            number(one.improvement_percent, ".0f"),
        ]
        for one in means(rows)
    ]
    return [aligned(MEANS, lines)] if lines else []


def _cells(row: Row) -> list[str]:
    counted = None if row.additions is None else row.additions + (row.multiplications or 0)
    return [
        row.optimizer,
        row.model or row.outcome,
        number(row.before_mg, ".3f"),
        number(row.after_mg, ".3f"),
        number(row.improvement_percent, ".0f"),
        number(row.iterations, "d"),
        number(counted, "d"),
        number(None if row.seconds is None else row.seconds * 1000, ".1f"),
    ]
