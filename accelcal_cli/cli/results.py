"""One result as a line of tab-separated fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from accelcal_cli.core.names import printable


def line(report: dict[str, Any], source: Path, written: Path | None) -> str:
    """Path, outcome, model, errors before and after [mg], improvement [%], output; `-` for nothing."""
    held, found = report["holdout"], report["calibration"]
    told = held is not None and found is not None
    fields = [
        printable(source),
        report["outcome"],
        "-" if found is None else found["model"],
        "-" if held is None else f"{held['before_mg']['mean']:.3f}",
        f"{held['after_mg']['mean']:.3f}" if told else "-",
        _percent(held["improvement_percent"]) if told else "-",
        "-" if written is None else printable(written),
    ]
    return "\t".join(fields)


def study_line(row: dict[str, Any], source: Path, written: Path | None) -> str:
    """The same fields from a recording's row in a study's summary."""
    fields = [
        printable(source),
        row["outcome"],
        row["model"] or "-",
        *("-" if row[name] is None else f"{row[name]:.3f}" for name in ("before_mg", "after_mg")),
        _percent(row["improvement_percent"]),
        "-" if written is None else printable(written),
    ]
    return "\t".join(fields)


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f}"
