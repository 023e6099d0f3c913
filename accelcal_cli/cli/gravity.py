"""`accelcal gravity`."""

from __future__ import annotations

import json

import click

from accelcal_cli.cli.options import Within
from accelcal_cli.core.gravity import Gravity, local_gravity


@click.command("gravity")
@click.option("--latitude", type=Within(-90, 90), required=True, metavar="DEGREES")
@click.option("--altitude", type=Within(-500, 9000), default=0.0, metavar="METRES",
              show_default=True, help="Above the sea.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def command(latitude: float, altitude: float, as_json: bool) -> None:
    """Show local gravity, as `calibrate --latitude --altitude` uses it.

    International Gravity Formula of 1967 with the free-air correction (Grammenos, Mascolo,
    Crowcroft 2018, eq. 16-18). Prints m/s2 and units of standard g, separated by a tab.
    """
    metres = local_gravity(latitude, altitude)
    standard = float(Gravity(latitude, altitude).local_g())
    if as_json:
        shown = {
            "latitude": latitude,
            "altitude": altitude,
            "local_m_s2": round(metres, 6),
            "local_g": standard,
        }
        click.echo(json.dumps(shown))
    else:
        click.echo(f"{metres:.6f}\t{standard:.9f}")
