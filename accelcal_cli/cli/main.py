"""The `accelcal` command: loads a subcommand only when it is used."""

from __future__ import annotations

import importlib
import sys
from typing import NoReturn

import click

from accelcal_cli import __version__
from accelcal_cli.cli.exits import run_safely

COMMANDS = {
    "calibrate": "Calibrate recordings: calibrated Parquet and a report for each.",
    "inspect": "Show what a recording holds and what calibrating it would give.",
    "fit": "Fit still-window means from another tool, and judge them.",
    "gravity": "Show local gravity at a latitude and altitude.",
    "simulate": "Write a recording with known errors.",
}
"""Each lives in the module of its name and binds `command`."""


class LazyGroup(click.Group):
    """A group whose commands are imported only when asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of COMMANDS."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"accelcal_cli.cli.{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Show the one-line helps without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="accelcal")
def cli() -> None:
    """Calibrate raw actigraph recordings by the stillness they contain.

    Start with: accelcal calibrate RECORDING
    """


def main() -> NoReturn:
    """Console entry point: runs the command and exits with its code."""
    sys.exit(run_safely(lambda: cli.main(prog_name="accelcal", standalone_mode=False)))
