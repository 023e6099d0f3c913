"""The help of commands: options in groups, the commonest first, and examples that can be copied.

Colours are those of a terminal that shows them; `NO_COLOR` turns them off.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import click

OUTPUT, READING, TIME, METHOD = "Output", "Reading the file", "Time", "Method"
PAPER, ADVANCED = "Reproducing the paper", "Advanced"

GROUPS: dict[str, tuple[str, ...]] = {
    "Which files": ("include", "exclude", "newer_than", "settle", "retry_failed"),
    OUTPUT: (
        "output_dir", "out", "output", "form", "html", "as_json", "as_json_", "as_csv", "as_what", "tsv",
        "report_only", "effect", "windows", "keep_refused", "precision_mg", "integers", "all_failures",
        "force", "quiet", "verbose",
    ),
    "Other recordings of the device": ("borrow", "pool"),
    "Running": ("jobs", "dry_run", "timeout", "shard", "collect", "dask", "takeover", "unlock"),
    READING: (
        "format", "unit", "lsb_per_g", "rate_hz", "columns", "time_column", "sensor", "layout", "parts",
        "config", "gyro_columns", "gyro_unit", "lsb_per_dps", "max_damage_percent",
    ),
    TIME: (
        "timezone", "date_format", "start", "shift_s", "configured_zone", "worn_zone", "force_timezone",
    ),
    METHOD: (
        "max_error_mg", "strict", "model", "prior", "no_temperature", "stillness",
        "recalibrate", "latitude", "altitude_m",
    ),
    PAPER: (
        "profile", "optimizer", "stillness_axes", "min_distance_g", "min_subset_points", "max_subset_points",
    ),
    ADVANCED: ("segment_seconds", "stillness_threshold_g", "longest_gap_s", "chunk_samples"),
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
        """Write the options by group, those of no group first and `--help` last."""
        options = (one for one in self.get_params(ctx) if isinstance(one, click.Option))
        records = {one.name: one.get_help_record(ctx) for one in options}
        shown = {name: record for name, record in records.items() if record is not None}
        help_record = shown.pop("help", None)
        grouped = {name for names in GROUPS.values() for name in names}
        own = [record for name, record in shown.items() if name not in grouped]
        sections = {"Options": own} | {
            title: [shown[name] for name in names if name in shown] for title, names in GROUPS.items()
        }
        last = next((title for title in (OUTPUT, "Options") if sections[title]), "Options")
        if help_record is not None:
            sections[last].append(help_record)
        for title, rows in sections.items():
            if rows:
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
