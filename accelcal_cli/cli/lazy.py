"""Groups of commands that are imported only when asked for."""

from __future__ import annotations

import importlib
from typing import Any

import click


class LazyGroup(click.Group):
    """A group that knows its commands' one-line helps by name, and imports one when it is run."""

    def __init__(self, *words: Any, parts: dict[str, str], modules: str, **more: Any) -> None:
        """Bind `command` of the module whose name is `modules` and the part's, `_` for each hyphen."""
        super().__init__(*words, **more)
        self.parts = parts
        self.modules = modules

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in their order."""
        return list(self.parts)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in self.parts:
            return None
        module = importlib.import_module(self.modules + cmd_name.replace("-", "_"))
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Show the one-line helps without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl(list(self.parts.items()))
