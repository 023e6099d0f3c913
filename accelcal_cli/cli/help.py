"""The help of commands: options in groups, the commonest first, and examples that can be copied.

Colours are those of a terminal that shows them; `NO_COLOR` turns them off.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import click

GROUPS: dict[str, tuple[str, ...]] = {
    "Which files": ("include", "exclude", "newer_than", "settle", "retry_failed", "keep_older"),
    "Output": (
        "output_dir", "out", "output", "form", "html", "as_json", "as_json_", "as_csv", "as_what", "tsv",
        "full", "long", "report_only", "effect", "windows", "draws", "keep_refused", "precision_mg",
        "integers", "decisions", "all_failures", "gzip", "resample", "smooth", "measured_only", "force",
        "quiet", "verbose", "help",
    ),
    "Other recordings of the device": ("registry", "borrow", "pool"),
    "Running": ("jobs", "dry_run", "timeout", "log", "shard", "collect", "dask", "executor",
                "unlock", "prune"),
    "Reading the file": (
        "format", "unit", "lsb_per_g", "zero", "rate_hz", "columns", "time_column", "sensor", "layout",
        "parts", "config", "gyro_columns", "gyro_unit", "lsb_per_dps", "max_damage_percent",
    ),
    "Time": (
        "timezone", "date_format", "time_format", "start", "shift_s", "configured_zone", "worn_zone",
        "force_timezone",
    ),
    "Method": (
        "max_error_mg", "strict", "model", "prior", "no_temperature", "stillness",
        "recalibrate", "latitude", "altitude_m",
    ),
    "Reproducing the paper": (
        "profile", "optimizer", "stillness_axes", "min_distance_g", "min_subset_points", "max_subset_points",
    ),
    "Advanced": ("segment_seconds", "stillness_threshold_g", "longest_gap_s", "chunk_samples"),
}  # fmt: skip
"""Groups of options in their order, and the parameters in each. Others stand first, under `Options`."""


def heading(text: str) -> str:
    """Return a heading of a help text, bold where the terminal allows it."""
    return text if os.environ.get("NO_COLOR") else click.style(text, bold=True)


class Command(click.Command):
    """A command whose help shows its options in groups, and examples.

    Args:
        examples: command lines without `accelcal`, each with what it does after ` # `.
    """

    def __init__(self, *words: Any, examples: Iterable[str] = (), **more: Any) -> None:
        super().__init__(*words, **more)
        self.examples = tuple(examples)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options by group, those of no group first."""
        options = (one for one in self.get_params(ctx) if isinstance(one, click.Option))
        asks = self.get_help_option(ctx)  # whose name depends on the version of click
        records = {"help" if one is asks else one.name: one.get_help_record(ctx) for one in options}
        grouped = {name for names in GROUPS.values() for name in names}
        own = tuple(name for name in records if name not in grouped)
        for title, names in {"Options": own, **GROUPS}.items():
            if rows := [record for name in names if (record := records.get(name)) is not None]:
                with formatter.section(heading(title)):
                    formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples."""
        if self.examples:
            with formatter.section(heading("Examples")):
                for example in self.examples:
                    line, _, what = example.partition(" # ")
                    formatter.write(f"{' ' * formatter.current_indent}accelcal {line}\n")
                    if what:
                        formatter.write(f"{' ' * formatter.current_indent}    {what}\n")
