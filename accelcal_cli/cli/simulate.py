"""`accelcal simulate`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.options import ENCODER, FILE, Positive, Within
from accelcal_cli.cli.output import progress_bars
from accelcal_cli.core.errors import printable
from accelcal_cli.formats import named_encoder
from accelcal_cli.simulate import LARGEST_SEED, plan_of, simulate

LONGEST_DAYS, RATES_HZ = 3660, (0.1, 100_000)
"""Longest recording, ten years, and the rates at which movement can be simulated."""


@click.command(
    "simulate",
    cls=Command,
    examples=(
        "simulate week.cwa --format cwa --days 7",
        "simulate sensor.csv --format csv --days 1 --errors 0 # a perfect sensor",
    ),
)
@click.argument("out", type=FILE)
@click.option("--format", "format_name", type=ENCODER, default="flash", show_default=True, metavar="NAME",
              help="flash, raw (with its layout file), csv, hdf5, cwa, geneactiv or gt3x.")  # fmt: skip
@click.option("--days", type=Positive(LONGEST_DAYS), default=1.0, show_default=True, help="Length in days.")
@click.option("--rate", "rate_hz", type=Within(*RATES_HZ), default=100.0, show_default=True, metavar="HZ",
              help="Sampling rate.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0, LARGEST_SEED), metavar="N", default=1, show_default=True,
              help="Seed for movement and noise.")  # fmt: skip
@click.option("--truth", type=click.IntRange(0, LARGEST_SEED), metavar="N",
              help="Seed for the sensor's errors.  [default: that of --seed]")  # fmt: skip
@click.option("--errors", type=Within(0, 100), default=1.0, show_default=True,
              help="Factor applied to all sensor errors; 0 for a perfect sensor.")  # fmt: skip
@click.option("--misalignment", type=Within(-100, 100), default=1.0, show_default=True,
              help="Factor applied to the misalignment.")  # fmt: skip
@click.option("--temp-slope", type=Within(-1000, 1000), nargs=3, default=(0.0, 0.0, 0.0), metavar="X Y Z",
              help="Change of the offsets in mg per degree Celsius.")  # fmt: skip
@click.option("--noise-mg", type=Within(0, 100_000), default=3.0, show_default=True,
              help="Noise on each axis, standard deviation.")  # fmt: skip
@click.option("--lsb-per-g", type=Within(1, 1_000_000), default=256.0, show_default=True,
              help="Counts per g.")  # fmt: skip
@click.option("--range-g", type=Within(1, 10_000), default=8.0, show_default=True,
              help="Range of the sensor.")  # fmt: skip
@click.option("--gyro", is_flag=True, help="Record a gyroscope too (csv, hdf5, raw, cwa as an AX6).")
@click.option("--gyro-temp-slope", type=Within(-10, 10), nargs=3, default=(0.0, 0.0, 0.0), metavar="X Y Z",
              help="Change of its bias in deg/s per degree Celsius.")  # fmt: skip
@click.option("--no-temperature", is_flag=True, help="Record no temperature.")
@click.option("--force", is_flag=True, help="Replace existing files.")
@click.option("--json", "as_json", is_flag=True, help="Print the content of OUT.truth.json.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def command(out: Path, **values: Any) -> None:
    """Write a recording of simulated wrist wear to OUT, and its true errors to OUT.truth.json.

    The format's suffix is added to OUT if it is missing. The recording has nights in a few sleeping
    positions, desk work, walking, chores, the device left on a table, a temperature swing, noise and
    quantisation. Scale, misalignment and offset errors are drawn at random, from a seed.
    """
    plan = plan_of(values)
    named_encoder(values["format_name"])
    with progress_bars(out.name, quiet=values["quiet"], unit="samples") as bars:
        shown = bars("writing", plan.samples)
        path, truth = simulate(out, values["format_name"], plan, force=values["force"], progress=shown)
    exit_codes.show(
        json.dumps(truth) if values["as_json"] else f"{printable(path)}\t{truth['samples']} samples"
    )
