"""`accelcal gravity`."""

from __future__ import annotations

import json

import click

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.options import setting_option
from accelcal_cli.core.gravity import Gravity, local_gravity
from accelcal_cli.core.settings import Settings


@click.command(
    "gravity",
    cls=Command,
    examples=("gravity --latitude 52.5 --altitude 40", "gravity --latitude -33.9 --json"),
)
@setting_option(Settings, "latitude", required=True)
@setting_option(Settings, "altitude_m", default=0.0)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def command(latitude: float, altitude_m: float, as_json: bool) -> None:
    """Show local gravity, as used by `calibrate --latitude --altitude`.

    International Gravity Formula of 1980 with the free-air correction (Grammenos, Mascolo,
    Crowcroft 2018, eq. 16-18). Prints m/s2 and units of standard g, separated by a tab.
    """
    metres = local_gravity(latitude, altitude_m)
    standard = float(Gravity(latitude, altitude_m).local_g())
    if as_json:
        place = {"latitude": latitude, "altitude": altitude_m}
        exit_codes.show(json.dumps(place | {"local_m_s2": round(metres, 6), "local_g": standard}))
    else:
        exit_codes.show(f"{metres:.6f}\t{standard:.9f}")
