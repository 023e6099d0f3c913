"""`accelcal evaluate simulation`: the command, and its tables for people."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any, get_args

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.options import METHOD, Listed, OneOf
from accelcal_cli.cli.output import aligned, figure, number, progress_bars
from accelcal_cli.core.operations import MICROCONTROLLERS, predicted_seconds
from accelcal_cli.core.points import PARAMETER_NAMES
from accelcal_cli.evaluate.cases import USUAL, Selection, methods
from accelcal_cli.evaluate.simulation import COLUMNS, Protocol, Scores, Table, as_json, rows, run
from accelcal_cli.output.files import csv_text

NONE = "-"
UNIT = 1e-4
NINE = PARAMETER_NAMES[:9]
SIX = " (six)"
ERRORS = ("", *NINE, "/bound", "/paper", "failed")
COUNTED = ("", "iterations", "additions", "multiplications", "ms here")
COSTS = (*COUNTED, *(f"{item.name} s" for item in MICROCONTROLLERS))


def _lines(protocol: Protocol, tables: tuple[Table, ...]) -> Iterator[str]:
    """All tables, then what each method costs."""
    chosen = "chosen by nine subsets" if protocol.selection == "subsets" else "at random"
    yield f"{protocol.cases} cases (seed {protocol.seed}), points uniform on the sphere, {chosen}."
    yield "Absolute errors in units of 1e-4 (offsets 1e-4 g): mean, and below it SD. bound: Cramer-Rao."
    yield "/bound: mean over the parameters. /paper: the largest ratio to Table 2."
    for table in tables:
        yield from ("", f"{table.points} points, noise {table.noise_mg:g} mg")
        yield aligned(ERRORS, list(_errors(table)))
    for table in tables[:: len(protocol.noise_mg)]:
        yield from ("", f"Cost of a fit with {table.points} points, noise {table.noise_mg:g} mg (medians)")
        yield aligned(COSTS, [_cost(scores) for scores in table.scores])
    yield from _notes(tables)


def _errors(table: Table) -> Iterator[tuple[str, ...]]:
    if table.published is not None:
        yield from _pair("paper, Table 2", table.published.mean, table.published.sd, (NONE, "1", NONE))
    yield ("bound", *_scaled(table.bound), "1", NONE, NONE)
    for scores in table.scores:
        label = scores.method.label + ("" if scores.method.model.name == "9" else SIX)
        ratios = figure(scores.ratio_to_bound), figure(table.worst_against_paper(scores))
        yield from _pair(label, scores.mean, scores.sd, (*ratios, str(sum(scores.failures.values()))))


def _pair(
    label: str, mean: Sequence[float | None], sd: Sequence[float | None], end: tuple[str, str, str]
) -> Iterator[tuple[str, ...]]:
    yield (label, *_scaled(mean), *end)
    yield ("  SD", *_scaled(sd), "", "", "")


def _scaled(values: Sequence[float | None]) -> list[str]:
    return [figure(None if value is None else value / UNIT) for value in values]


def _cost(scores: Scores) -> tuple[str, ...]:
    done = scores.operations
    seconds = predicted_seconds(done, scores.method.optimizer.arithmetic) or {}
    return (
        scores.method.label,
        number(scores.iterations, ".0f"),
        number(done.additions or None, "d"),
        number(done.multiplications or None, "d"),
        figure(None if scores.seconds is None else 1e3 * scores.seconds),
        *(figure(seconds.get(item.name)) for item in MICROCONTROLLERS),
    )


def _notes(tables: tuple[Table, ...]) -> Iterator[str]:
    every = [scores for table in tables for scores in table.scores]
    if any(scores.method.model.name == "6" for scores in every):
        yield from (
            "",
            "six: fits only scale and offset, which the misalignment biases; the bound is for all nine.",
        )
    if any(scores.failures for scores in every):
        yield from ("", "Failed fits (excluded from their row and its bound):")
    for table in tables:
        for scores in table.scores:
            for reason, times in scores.failures.items():
                where = f"{table.points} points, {table.noise_mg:g} mg, {scores.method.label}"
                yield f"{where}: {times} x {reason}"


@click.command("simulation")
@click.option("--cases", type=click.IntRange(1), default=500, show_default=True,
              help="How many sensors to simulate.")  # fmt: skip
@click.option("--points", type=Listed(int, 10, 8192), default="18,144,432", show_default=True,
              metavar="N[,N...]", help="Numbers of calibration points.")  # fmt: skip
@click.option("--noise-mg", type=Listed(float, 1e-3, 100), default="1,5", show_default=True,
              metavar="MG[,MG...]", help="Noise on each axis, standard deviation.")  # fmt: skip
@click.option("--selection", type=OneOf(get_args(Selection)), default="subsets", show_default=True,
              help="subsets: chosen by the paper's collector; random: any points.")  # fmt: skip
@click.option("--optimizer", "labels", multiple=True, type=METHOD, metavar="NAME[:paper]",
              help=f"May be repeated; `all` for all optimizers.  [default: {' '.join(USUAL)}]")  # fmt: skip
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=1, show_default=True,
              help="Seed for all random numbers.")  # fmt: skip
@click.option("--json", "as_what", flag_value="json", help="Print a JSON object.")
@click.option("--csv", "as_what", flag_value="csv", help="Print CSV, a row for each parameter.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def command(**values: Any) -> None:
    """Simulate sensors with known errors and compare what each optimizer finds.

    Table 2 of Farago, Maczak, Gingl 2024 (section III.A), with the paper's figures and the
    Cramer-Rao bound beside them.
    """
    protocol = Protocol(
        cases=values["cases"],
        seed=values["seed"],
        points=values["points"],
        noise_mg=values["noise_mg"],
        selection=values["selection"],
    )
    with progress_bars("simulation", quiet=values["quiet"], unit="cases") as bars:
        tables = run(protocol, methods(values["labels"]), bars)
    exit_codes.show(_shown(values["as_what"], protocol, tables))


def _shown(as_what: str | None, protocol: Protocol, tables: tuple[Table, ...]) -> str:
    if as_what == "json":
        return json.dumps(as_json(protocol, tables), allow_nan=False)
    if as_what == "csv":
        return csv_text(COLUMNS, rows(tables)).rstrip("\n")
    return "\n".join(_lines(protocol, tables))
