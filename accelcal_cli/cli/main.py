"""The `accelcal` command: groups that import a subcommand only when it is used."""

from __future__ import annotations

import gc
import importlib
import sys
from typing import Any, NoReturn

import click
from click.shell_completion import CompletionItem

from accelcal_cli.cli.exit_codes import run_safely
from accelcal_cli.cli.help import heading
from accelcal_cli.core.errors import similar_words
from accelcal_cli.core.system import collect_seldom, hold_to_one_thread, keep_freed_memory, take_over_process
from accelcal_cli.core.version import __version__


class LazyGroup(click.Group):
    """Group that knows its commands' one-line helps by name, and imports one when it is run."""

    def __init__(
        self,
        *words: Any,
        parts: dict[str, str],
        modules: str,
        sections: dict[str, tuple[str, ...]] | None = None,
        gone: dict[str, str] | None = None,
        **more: Any,
    ) -> None:
        """Bind `command` of the module whose name is `modules` and the part's, `_` for each hyphen."""
        super().__init__(*words, **more)
        self.sections = sections or {"Commands": tuple(parts)}
        self.parts = parts
        self.gone = gone or {}
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
        """Find a command; one that does not exist may be gone, or a slip."""
        if args[0] in self.gone:
            ctx.fail(f"`{args[0]}` is now {self.gone[args[0]]}")
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
        width = max(map(len, self.parts))
        for title, names in self.sections.items():
            with formatter.section(heading(title)):
                formatter.write_dl([(name.ljust(width), self.parts[name]) for name in names])


COMMANDS = {
    "calibrate": "Calibrate recordings; write calibrated data and a report for each.",
    "inspect": "Show the contents of a recording and predict its outcome.",
    "apply": "Apply known coefficients to recordings of the same device; check whether they fit.",
    "fit": "Calibrate from still-window means found by another tool, such as GGIR.",
    "six-pose": "Calibrate from a six-position session: the device lies on each of its sides.",
    "watch": "Calibrate a recording while it grows.",
    "study": "Calibrate a folder of recordings, in parallel; resume an interrupted run.",
    "devices": "Show how the devices of a study drift, and which to service.",
    "report": "Create HTML pages with figures from reports or from a whole study.",
    "verify": "Reproduce a report from its recording, bit for bit.",
    "export": "Export coefficients or calibrated data to GGIR, actipy, omconvert and others.",
    "evaluate": "Compare methods and stillness rules; reproduce the published tables.",
    "simulate": "Write a simulated recording with known errors.",
    "gravity": "Show local gravity at a latitude and altitude.",
}
"""One-line help of each command, which the module of its name (`_` for `-`) binds as `command`."""

SECTIONS = {
    "Calibrate": ("calibrate", "inspect", "apply", "fit", "six-pose", "watch"),
    "Studies": ("study", "devices", "report"),
    "Check": ("verify",),
    "Export": ("export",),
    "Laboratory": ("evaluate", "simulate", "gravity"),
}
"""Commands by purpose, the commonest first."""

GONE = {
    "effect": "accelcal calibrate RECORDING --effect --report-only (key `effect` of the report)",
    "quality": "accelcal apply --coefficients NAME.calibration.json RECORDING --report-only",
}
"""Commands that are gone, each with what to type in its place."""


FIRST_STEPS = """\
accelcal autocalibrates raw accelerometer (actigraph) recordings. To begin:

  accelcal inspect recording.cwa            show the contents of a recording and what to expect
  accelcal calibrate recording.cwa --html   write calibrated data, a report and a page
  accelcal study recordings -d calibrated   calibrate all recordings of a folder

All commands: accelcal --help
Options and examples of a command: accelcal calibrate --help"""
"""Screen of `accelcal` without arguments."""


def _show_version(ctx: click.Context, _option: click.Parameter, asked: bool) -> None:
    """Print the version with its commit and end; a build or a checkout is asked for it only then."""
    if asked and not ctx.resilient_parsing:
        click.echo(f"accelcal, version {__version__}")
        ctx.exit()


@click.group(
    cls=LazyGroup,
    parts=COMMANDS,
    modules="accelcal_cli.cli.",
    sections=SECTIONS,
    gone=GONE,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--version", is_flag=True, expose_value=False, is_eager=True, callback=_show_version,
              help="Show the version and exit.")  # fmt: skip
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Autocalibrate raw accelerometer (actigraph) recordings, using their periods without movement.

    Start with `accelcal inspect RECORDING`, then `accelcal calibrate RECORDING`; for a folder of
    recordings, `accelcal study FOLDER -d OUT`. `accelcal COMMAND --help` shows examples.
    """
    if ctx.invoked_subcommand is None:
        click.echo(FIRST_STEPS)
        ctx.exit(2)


def main() -> NoReturn:
    """Console entry point: runs the command and exits with its code."""
    take_over_process()
    hold_to_one_thread()
    keep_freed_memory()
    collect_seldom()
    code = run_safely(lambda: cli.main(prog_name="accelcal", standalone_mode=False))
    gc.freeze()  # else the interpreter looks through all that is loaded once more before it ends
    sys.exit(code)
