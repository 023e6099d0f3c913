"""`accelcal evaluate simulation`."""

from __future__ import annotations

import json
from typing import Any, get_args

import click

from accelcal_cli.cli.options import Listed
from accelcal_cli.cli.progress import progress_bars
from accelcal_cli.cli.simulation_tables import as_text
from accelcal_cli.cli.tables import comma_separated
from accelcal_cli.evaluate.simulated.cases import Selection
from accelcal_cli.evaluate.simulated.optimizers import USUAL, methods
from accelcal_cli.evaluate.simulated.records import COLUMNS, as_json, rows
from accelcal_cli.evaluate.simulation import Protocol, Table, run


@click.command("simulation")
@click.option("--cases", type=click.IntRange(1), default=500, show_default=True, help="Sensors to simulate.")
@click.option("--points", type=Listed(int, 10, 8192), default="18,144,432", show_default=True,
              metavar="N[,N...]", help="Numbers of calibration points.")  # fmt: skip
@click.option("--noise-mg", type=Listed(float, 1e-3, 100), default="1,5", show_default=True,
              metavar="MG[,MG...]", help="Noise on each axis, standard deviation.")  # fmt: skip
@click.option("--selection", type=click.Choice(get_args(Selection)), default="subsets", show_default=True,
              help="subsets: the paper's collector chooses among random points; random: any.")  # fmt: skip
@click.option("--optimizer", "labels", multiple=True, metavar="NAME[:paper]",
              help=f"May be repeated; `all` for every one.  [default: {' '.join(USUAL)}]")  # fmt: skip
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=1, show_default=True)
@click.option("--json", "as_what", flag_value="json", help="Print a JSON object.")
@click.option("--csv", "as_what", flag_value="csv", help="Print CSV, a row for each parameter.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def command(**values: Any) -> None:
    """Simulate sensors with known errors and compare what each optimizer finds.

    Table 2 of Farago, Maczak, Gingl 2024 (section III.A), with the paper's figures and the
    Cramer-Rao bound beside.
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
    click.echo(_shown(values["as_what"], protocol, tables))


def _shown(as_what: str | None, protocol: Protocol, tables: tuple[Table, ...]) -> str:
    if as_what == "json":
        return json.dumps(as_json(protocol, tables), allow_nan=False)
    if as_what == "csv":
        return comma_separated(COLUMNS, rows(tables))
    return as_text(protocol, tables)
