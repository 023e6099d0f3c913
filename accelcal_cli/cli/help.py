"""The help of commands: common options in groups, all of them with `--help-all`, and examples to be copied.

Colours are those of a terminal that shows them; `NO_COLOR` turns them off.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import click
from click.shell_completion import CompletionItem

from accelcal_cli.core.errors import did_you_mean

if TYPE_CHECKING:
    AnyType = click.ParamType[Any]
else:  # older versions of click know no kinds of these
    AnyType = click.ParamType

GROUPS: dict[str, tuple[str, ...]] = {
    "Which files": ("include", "exclude", "newer_than", "settle", "retry_failed"),
    "Output": (
        "output_dir", "out", "output", "form", "html", "effect", "report_only", "keep_refused", "windows",
        "draws", "integers", "precision_mg", "decisions", "as_json", "as_json_", "as_csv", "as_what", "tsv",
        "full", "long", "gzip", "resample", "smooth", "measured_only", "force", "quiet", "verbose",
        "all_failures", "log",
    ),
    "Running": ("dry_run", "jobs", "timeout", "prune", "unlock", "shard", "collect", "dask", "executor",
                "chunk_samples"),
    "Reading the file": (
        "format", "unit", "lsb_per_g", "rate_hz", "columns", "sensor", "timezone", "layout", "parts",
        "only_motion",
        "config", "named",
    ),
    "Judging": (
        "prior", "registry", "borrow", "pool", "keep_teaching", "max_error_mg", "strict", "model",
        "no_temperature", "profile",
        "recalibrate", "latitude", "altitude_m", "stillness", "stillness_axes", "segment_seconds",
        "stillness_threshold_g", "longest_gap_s", "optimizer", "min_distance_g", "min_subset_points",
        "max_subset_points",
    ),
    "Help": ("help", "help_all"),
}  # fmt: skip
"""Groups of options in their order, and the parameters in each. Others stand first, under `Options`."""

ALL = "accelcal.help_all"
"""Key of a context's `meta` that asks for all options."""


def heading(text: str) -> str:
    """Return a heading of a help text, bold where the terminal allows it."""
    return text if os.environ.get("NO_COLOR") else click.style(text, bold=True)


class Rare(click.Option):
    """An option that only `--help-all` shows."""


class Named(NamedTuple):
    """A value that is given by name: its form in the help, `true` for a switch, and the help."""

    form: str
    help: str
    kind: AnyType | None = None


class NameValue(AnyType):
    """Option type: `NAME=VALUE`, as a pair; a shell completes names and choices.

    Args:
        known: returns the names. A value whose kind is not stated is left to the command, as a text.
    """

    name = "NAME=VALUE"

    def __init__(self, known: Callable[[], Mapping[str, Named]]) -> None:
        self.known = known

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, Any]:
        """Split, and parse the value if its kind is known."""
        if isinstance(value, tuple):
            return value[0], value[1]
        name, mark, text = str(value).partition("=")
        name, known = name.strip().replace("-", "_"), self.known()
        if not mark:
            self.fail(f"{value!r} is not {self.name}", param, ctx)
        if name not in known:
            meant = did_you_mean(name, known) or f"known are {', '.join(known)}"
            self.fail(f"there is no {name!r}; {meant}", param, ctx)
        kind = known[name].kind
        return name, text if kind is None else kind.convert(text, param, ctx)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the names that begin so, or the choices of one."""
        name, mark, begun = incomplete.partition("=")
        if mark:
            forms = self.known()[name].form.split("|") if name in self.known() else ()
            return [CompletionItem(f"{name}={one}") for one in forms if one.startswith(begun) and one != "N"]
        return [
            CompletionItem(f"{one}=", help=about.help)
            for one, about in self.known().items()
            if one.startswith(name)
        ]


def _show_all(ctx: click.Context, _option: click.Parameter, asked: bool) -> None:
    if asked and not ctx.resilient_parsing:
        ctx.meta[ALL] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


HELP_ALL = click.Option(
    ["--help-all"], is_flag=True, expose_value=False, is_eager=True, callback=_show_all,
    help="Show all options and exit.",
)  # fmt: skip


class Command(click.Command):
    """A command whose help shows its common options in groups, and examples.

    Args:
        examples: command lines without `accelcal`, each with what it does after ` # `.
    """

    def __init__(self, *words: Any, examples: Iterable[str] = (), **more: Any) -> None:
        super().__init__(*words, **more)
        self.examples = tuple(examples)

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters, `--help-all` among them."""
        return [*super().get_params(ctx), HELP_ALL]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words; an option that is given by name now is answered with its new form."""
        words = list(args)
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if (now := self._by_name(error.option_name, words)) is None:
                raise
            raise click.UsageError(f"{error.option_name} is now {now}", ctx) from None

    def _by_name(self, option: str, words: Sequence[str]) -> str | None:
        """Return how an option is given now, with the value that it was given; None if it never was one."""
        name = option.removeprefix("--").replace("-", "_")
        for one in self.params:
            if isinstance(one.type, NameValue) and (about := one.type.known().get(name)) is not None:
                first = next((word for word in words if word.partition("=")[0] == option), option)
                after = words[words.index(first) + 1 :] if first in words else []
                given = first.partition("=")[2] or "".join(after[:1])
                value = about.form if about.form == "true" or not given else shlex.quote(given)
                return f"{one.opts[0]} {name}={value}"
        return None

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options by group, those of no group first; then those that are given by name."""
        for title, rows in self.sections(ctx, everything=ctx.meta.get(ALL, False)):
            with formatter.section(heading(title)):
                formatter.write_dl(rows)

    def sections(
        self, ctx: click.Context, *, everything: bool
    ) -> Iterator[tuple[str, list[tuple[str, str]]]]:
        """Yield the groups of options that the help shows: the title, and each option with its help.

        Args:
            everything: rare options too, and those that are given by name.
        """
        options = [one for one in self.get_params(ctx) if isinstance(one, click.Option)]
        asks = self.get_help_option(ctx)  # whose name depends on the version of click
        records: dict[str | None, list[tuple[str, str]]] = {}
        for one in options:
            if (everything or not isinstance(one, Rare)) and (record := one.get_help_record(ctx)):
                records.setdefault("help" if one is asks else one.name, []).append(record)
        grouped = {*chain.from_iterable(GROUPS.values())}
        own = tuple(name for name in records if name not in grouped)
        for title, names in {"Options": own, **GROUPS}.items():
            if rows := [record for name in names for record in records.get(name, ())]:
                yield title, rows
        if everything:
            yield from self._given_by_name(options)

    def _given_by_name(self, options: Sequence[click.Option]) -> Iterator[tuple[str, list[tuple[str, str]]]]:
        """Yield the values of options such as `-R NAME=VALUE` that have no option of their own."""
        flags = {word for one in options for word in one.opts}
        for one in options:
            if isinstance(one.type, NameValue):
                known = one.type.known().items()
                rest = ((name, about) for name, about in known if f"--{name.replace('_', '-')}" not in flags)
                rows = [(f"{name}={about.form}", about.help) for name, about in rest]
                yield f"{one.opts[0]} {one.type.name}", rows

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples."""
        if self.examples:
            with formatter.section(heading("Examples")):
                for example in self.examples:
                    line, _, what = example.partition(" # ")
                    formatter.write(f"{' ' * formatter.current_indent}accelcal {line}\n")
                    if what:
                        formatter.write(f"{' ' * formatter.current_indent}    {what}\n")
