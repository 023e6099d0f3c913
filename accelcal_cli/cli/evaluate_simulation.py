"""`accelcal evaluate simulation`: the command, and its tables for people."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any, get_args

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.options import METHOD, Listed, OneOf
from accelcal_cli.cli.output import aligned, figure, number, progress_bars
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.operations import MICROCONTROLLERS, predicted_charge_mc, predicted_seconds
from accelcal_cli.core.points import PARAMETER_NAMES
from accelcal_cli.evaluate.cases import USUAL, Method, Selection, methods
from accelcal_cli.evaluate.descent import NAME, Convergence, Numbers, Objective, Spread, convergence, descent
from accelcal_cli.evaluate.descent import as_json as convergence_json
from accelcal_cli.evaluate.simulation import COLUMNS, Gauge, Protocol, Scores, Table, as_json, rows, run
from accelcal_cli.output.files import csv_text

NONE = "-"
UNIT = 1e-4
NINE = PARAMETER_NAMES[:9]
SIX = " (six)"
ERRORS = ("", *NINE, "/bound", "/paper", "failed")
COUNTED = ("", "iterations", "added", "multiplied", "ms here")
COSTS = (
    *COUNTED,
    *(head for item in MICROCONTROLLERS for head in (f"{item.name.removeprefix('ARM ')} s", "mC")),
)


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
    arithmetic = scores.method.optimizer.arithmetic
    seconds, charge = predicted_seconds(done, arithmetic) or {}, predicted_charge_mc(done, arithmetic) or {}
    return (
        scores.method.label,
        number(scores.iterations, ".0f"),
        number(done.additions or None, "d"),
        number(done.multiplications or None, "d"),
        figure(None if scores.seconds is None else 1e3 * scores.seconds),
        *(figure(of.get(item.name)) for item in MICROCONTROLLERS for of in (seconds, charge)),
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
@click.option("--points", type=Listed(int, 9, 8192), default="18,144,432", show_default=True,
              metavar="N[,N...]", help="Numbers of calibration points.")  # fmt: skip
@click.option("--noise-mg", type=Listed(float, 1e-3, 100), default="1,5", show_default=True,
              metavar="MG[,MG...]", help="Noise on each axis, standard deviation.")  # fmt: skip
@click.option("--selection", type=OneOf(get_args(Selection)), default="subsets", show_default=True,
              help="subsets: chosen by the paper's collector; random: any points.")  # fmt: skip
@click.option("--gauge", type=OneOf(get_args(Gauge)), default="lower", show_default=True,
              help="Compare the paper's triangular K, or the symmetric S of Grammenos et al.")  # fmt: skip
@click.option("--optimizer", "labels", multiple=True, type=METHOD, metavar="NAME[:paper]",
              help=f"May be repeated; `all` for all optimizers.  [default: {' '.join(USUAL)}]")  # fmt: skip
@click.option("--rates", type=Listed(float, 0, 10), metavar="SCALE,MISALIGNMENT,OFFSET",
              help="Learning rates of one more method, `descent`.  [default: 0.3,0.8,0.2]")  # fmt: skip
@click.option("--iterations", type=click.IntRange(1, 10_000),
              help="Iterations of `descent`.  [default: 50]")  # fmt: skip
@click.option("--objective", type=OneOf(get_args(Objective)),
              help="What `descent` minimises: mean or sum of (|a|^2 - 1)^2, or mean of (|a| - 1)^2 (root).  "
                   "[default: mean]")  # fmt: skip
@click.option("--convergence", is_flag=True, help="Also show how `descent` converges (Fig. 9).")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=1, show_default=True,
              help="Seed for all random numbers.")  # fmt: skip
@click.option("--json", "as_what", flag_value="json", help="Print a JSON object.")
@click.option("--csv", "as_what", flag_value="csv", help="Print CSV, a row for each parameter.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def command(**values: Any) -> None:
    """Simulate sensors with known errors and compare what each optimizer finds.

    Table 2 of Farago, Maczak, Gingl 2024 (section III.A), with the paper's figures and the
    Cramer-Rao bound beside them. With --rates, --iterations, --objective or --convergence there is one
    more method, the paper's descent in double precision with these numbers.
    """
    numbers = _numbers(values)
    protocol = Protocol(
        cases=values["cases"],
        seed=values["seed"],
        points=values["points"],
        noise_mg=values["noise_mg"],
        selection=values["selection"],
        gauge=values["gauge"],
    )
    with progress_bars("simulation", quiet=values["quiet"], unit="cases") as bars:
        more: tuple[Method, ...] = () if numbers is None else (descent(numbers),)
        tables = run(protocol, (*methods(values["labels"]), *more), bars)
        courses = [
            convergence(plan, numbers, protocol.cases, protocol.seed, bars("convergence", protocol.cases))
            for plan in protocol.plans()
            if numbers is not None and values["convergence"]
        ]
    exit_codes.show(_shown(values["as_what"], protocol, tables, courses))


def _numbers(values: dict[str, Any]) -> Numbers | None:
    """Those of the descent, if it is asked for; raises UsageError for rates that are not three."""
    names = ("rates", "iterations", "objective")
    given = {name: values[name] for name in names if values[name] is not None}
    if len(given.get("rates", (0, 0, 0))) != 3:
        hint = "give three: --rates 0.3,0.8,0.2"
        raise UsageError("--rates are those of scale, misalignment and offset", hint=hint)
    return Numbers(**given) if given or values["convergence"] else None


def _shown(
    as_what: str | None, protocol: Protocol, tables: tuple[Table, ...], courses: list[Convergence]
) -> str:
    if as_what == "json":
        found = as_json(protocol, tables)
        if courses:
            found["convergence"] = list(map(convergence_json, courses))
        return json.dumps(found, allow_nan=False)
    if as_what == "csv":
        return csv_text(COLUMNS, rows(tables)).rstrip("\n")
    return "\n".join([*_lines(protocol, tables), *(line for one in courses for line in _course(one))])


def _course(found: Convergence) -> Iterator[str]:
    """How far the parameters are from where they end, and when they have arrived."""
    yield from ("", f"Convergence of {NAME} with {found.points} points, noise {found.noise_mg:g} mg")
    if not found.cases:
        yield "It diverges in all cases."
        return
    yield "Largest distance from the last iteration's in units of 1e-4: median, 90th percentile"
    groups = next(iter(found.left.values()), {})
    head = ("iteration", *(f"{name}{end}" for name in groups for end in ("", " p90")))
    yield aligned(
        head,
        [
            (str(number), *_scaled([value for one in row.values() for value in (one.median, one.p90)]))
            for number, row in found.left.items()
        ],
    )
    yield from (_arrival(limit, one) for limit, one in found.within.items())
    if found.diverged:
        yield f"It diverges in {found.diverged} more cases."


def _arrival(limit: float, one: Spread) -> str:
    after = " and ".join(number(value, ".0f") for value in (one.median, one.p90))
    return f"All nine stay within {limit:g} of it after {after} iterations (median, 90th percentile)."
