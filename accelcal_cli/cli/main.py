"""The `accelcal` command: groups that import a subcommand only when it is used."""

from __future__ import annotations

import gc
import importlib
import sys
from typing import Any, NoReturn

import click
from click.shell_completion import CompletionItem

from accelcal_cli.cli.exit_codes import run_safely
from accelcal_cli.core.errors import similar_words
from accelcal_cli.core.system import (
    collect_seldom,
    hold_to_one_thread,
    keep_freed_memory,
    take_over_process,
)
from accelcal_cli.core.version import __version__


class LazyGroup(click.Group):
    """Group that knows its commands' one-line helps by name, and imports one when it is run."""

    def __init__(self, *words: Any, parts: dict[str, str], modules: str, **more: Any) -> None:
        """Bind `command` of the module whose name is `modules` and the part's, `_` for each hyphen."""
        super().__init__(*words, **more)
        self.parts = parts
        self.modules = modules

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in their order."""
        return list(self.parts)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in self.parts:
            return None
        module = importlib.import_module(self.modules + cmd_name.replace("-", "_"))
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; one that does not exist may be a slip."""
        if args[0] not in self.parts and (meant := similar_words(args[0], self.parts, 3)):
            ctx.fail(f"No such command {args[0]!r}. Did you mean {' or '.join(map(repr, meant))}?")
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete names with their one-line helps, without importing any command; else options."""
        if incomplete.startswith("-"):
            return super().shell_complete(ctx, incomplete)
        begun = [name for name in self.parts if name.startswith(incomplete)]
        return [CompletionItem(name, help=self.parts[name]) for name in begun]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Show the one-line helps without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl(list(self.parts.items()))


COMMANDS = {
    "calibrate": "Calibrate recordings; write Parquet and a report for each.",
    "study": "Calibrate a folder of recordings, in parallel; resume an interrupted run.",
    "devices": "Show how a study's devices drift, and which to service.",
    "report": "Make pages for people, with figures, of reports or of a study.",
    "six-pose": "Calibrate a sensor from a session on its six faces.",
    "inspect": "Show what a recording holds and predict its outcome.",
    "watch": "Calibrate a recording while it grows.",
    "fit": "Fit still-window means from another tool and judge the fit.",
    "quality": "Show a recording's error by the hour, and whether its calibration holds.",
    "effect": "Show what a calibration changes in measures of activity.",
    "apply": "Apply known coefficients to recordings of the same device.",
    "export": "Hand coefficients or calibrated data on to other tools.",
    "verify": "Reproduce a report from its recording, bit for bit.",
    "gravity": "Show local gravity at a latitude and altitude.",
    "evaluate": "Compare methods and stillness rules, test claims, repeat the papers' tables.",
    "simulate": "Write a recording with known errors.",
}
"""One-line help of each command, which the module of its name (`_` for `-`) binds as `command`."""


@click.group(
    cls=LazyGroup,
    parts=COMMANDS,
    modules="accelcal_cli.cli.",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="accelcal")
def cli() -> None:
    """Calibrate raw actigraph recordings by the stillness they contain.

    Start with: accelcal calibrate RECORDING
    """


def main() -> NoReturn:
    """Console entry point: runs the command and exits with its code."""
    take_over_process()
    hold_to_one_thread()
    keep_freed_memory()
    collect_seldom()
    code = run_safely(lambda: cli.main(prog_name="accelcal", standalone_mode=False))
    gc.freeze()  # else the interpreter looks through all that is loaded once more before it ends
    sys.exit(code)
