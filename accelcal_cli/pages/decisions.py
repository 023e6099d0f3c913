"""Decisions of people on the page of a study: the rows of their file, and the faults of some of them.

Both come from `study.json`, which others may have changed: what does not fit is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from accelcal_cli.core.errors import printable
from accelcal_cli.output.decisions import CAUTIOUS, COLUMNS, MOST_FINDINGS, NAME

USE = COLUMNS.index("use")
"""Place of the decision in a row."""


def _section(summary: Mapping[str, Any], name: str) -> list[Any]:
    """Return a list under `decisions` of `study.json`; empty if there is none."""
    held = summary.get("decisions")
    found = held.get(name) if isinstance(held, dict) else None
    return found if isinstance(found, list) else []


def rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Return the rows of the file for the script of the page: texts in the order of COLUMNS."""
    return [list(map(printable, row)) for row in _section(summary, "rows") if _fits(row)]


def _fits(row: Any) -> bool:
    """Return True for a row as a study writes it."""
    texts = isinstance(row, list) and len(row) == len(COLUMNS) and all(isinstance(one, str) for one in row)
    return texts and row[USE] in CAUTIOUS


def findings(summary: Mapping[str, Any]) -> list[str]:
    """Return a line for each finding about decisions, with the name of their file."""
    held = summary.get("decisions")
    file = str(held.get("file") or NAME) if isinstance(held, dict) else NAME
    found = [one for one in _section(summary, "findings") if isinstance(one, dict)][: MOST_FINDINGS + 1]
    return [printable(f"{file}: {one.get('message')}") for one in found]
