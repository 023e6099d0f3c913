"""Slow looks at single lines, taken only where a block does not parse."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.readers._csv.cells import Kind, cell_kind
from accelcal_cli.readers._csv.dialect import Dialect, decode, split_line
from accelcal_cli.readers._csv.time import STAMP

SHOWN = 40


@dataclass(frozen=True, slots=True)
class LineCheck:
    """What every line of a file must be: so many columns, numbers in the used ones, a time."""

    dialect: Dialect
    used: tuple[int, ...]
    time: int | None

    def bad_line(self, data: bytes, first_line: int, path: Path) -> UnreadableError:
        """The error that names the first line of cleaned `data` that is no row."""
        for number, raw in enumerate(data.splitlines()):
            fault = self._fault(decode(raw)) if raw else None
            if fault:
                line, hint = first_line + number, "correct or remove that line"
                return UnreadableError(fault, path=path, line=line, hint=hint)
        return UnreadableError(
            "the lines from here on cannot be read", path=path, line=first_line, hint="look for stray quotes"
        )

    def _fault(self, text: str) -> str | None:
        """What is wrong with a line, None where nothing is."""
        cells = split_line(text, self.dialect.cleaner.delimiter)
        if len(cells) != self.dialect.columns:
            columns = "1 column" if len(cells) == 1 else f"{len(cells)} columns"
            return f"the line has {columns}, not {self.dialect.columns} ({shortened(text)!r})"
        for column in sorted(self.used):
            if not self._fits(cells[column], column):
                what = "time" if column == self.time else "number"
                return f"column {column} holds {shortened(cells[column])!r}, which is no {what}"
        return None

    def _fits(self, cell: str, column: int) -> bool:
        kind = cell_kind(cell, False)
        if column == self.time and self.dialect.kinds[column] is Kind.TIME:
            return kind is Kind.MISSING or STAMP.fullmatch(cell) is not None
        return kind in (Kind.NUMBER, Kind.MISSING)


def shortened(text: str) -> str:
    """A text short enough for a message."""
    return text if len(text) <= SHOWN else text[:SHOWN] + "..."


def blank_lines_apart(data: bytes) -> NDArray[np.int64]:
    """Numbers, from 0, of the lines of `data` that are not empty."""
    lines = data.splitlines()
    return np.array([number for number, line in enumerate(lines) if line], np.int64)
