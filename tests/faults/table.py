"""The table of docs/reliability.md: which exit codes a command has where an operation fails."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from tests.faults.checks import ERRORS, Cells

PAGE = Path(__file__).resolve().parent.parent.parent / "docs" / "reliability.md"
HEAD = "| operation | error |"
NEVER = "never"
COLUMNS = (
    "calibrate", "apply", "fit", "six-pose", "report", "export", "simulate",
    "inspect", "verify", "devices", "watch", "study",
)  # fmt: skip


def rows(cells: Cells) -> list[str]:
    """The lines of the table, its head first."""
    lines = [f"{HEAD} {' | '.join(COLUMNS)} |", "|---|---|" + "---|" * len(COLUMNS)]
    for operation, errors in ERRORS.items():
        for error in errors:
            shown = (_cell(cells.get((operation, error, column), ())) for column in COLUMNS)
            lines.append(f"| {operation} | {error} | {' | '.join(shown)} |")
    return lines


def _cell(codes: Iterable[int]) -> str:
    return " ".join(map(str, sorted(codes))) or NEVER


def written(path: Path = PAGE) -> list[str]:
    """The lines of the table that a page holds."""
    lines = path.read_text("utf-8").splitlines()
    start, stop = _place(lines)
    return lines[start:stop]


def put(cells: Cells, path: Path = PAGE) -> None:
    """Replace the table of a page."""
    lines = path.read_text("utf-8").splitlines()
    start, stop = _place(lines)
    path.write_text("\n".join([*lines[:start], *rows(cells), *lines[stop:]]) + "\n", "utf-8")


def _place(lines: list[str]) -> tuple[int, int]:
    """Where the table begins and ends: with an empty line."""
    start = next(number for number, line in enumerate(lines) if line.startswith(HEAD))
    return start, lines.index("", start)


def read(path: Path = PAGE) -> Cells:
    """The cells of a page's table."""
    found: Cells = {}
    (_, _, *columns), _, *lines = (
        [cell.strip() for cell in line.strip("|").split("|")] for line in written(path)
    )
    for operation, error, *shown in lines:
        for column, text in zip(columns, shown, strict=True):
            words = [] if text == NEVER else text.split()
            found[operation, error, column] = set(map(int, words))
    return found
