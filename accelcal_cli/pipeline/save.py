"""Reports with their provenance, to the disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from accelcal_cli.output.atomic import write_text
from accelcal_cli.output.report import dumps
from accelcal_cli.pipeline.provenance import provenance


def with_provenance(report: dict[str, Any], command: tuple[str, ...]) -> dict[str, Any]:
    """The report, and who made it when."""
    return {**report, "provenance": provenance(list(command))}


def save_report(path: Path, report: dict[str, Any]) -> None:
    """Write a report; it appears complete or not at all.

    Raises:
        OutputError: the file cannot be written.
    """
    write_text(path, dumps(report, pretty=True) + "\n")
