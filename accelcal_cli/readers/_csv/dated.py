"""In which order a file writes day, month and year: from the user, its header, or its rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.readers._csv.blocks import Block
from accelcal_cli.readers._csv.dates import ORDERS, find_order, is_year_first, read_date, year_first_cell
from accelcal_cli.readers._csv.dialect import Dialect, cells_of
from accelcal_cli.readers._csv.vendor import Known


def dated(
    block: Block, dialect: Dialect, column: int, known: Known, options: ReadOptions, path: Path
) -> Dialect:
    """The layout with times that begin with the year, whatever the file's begin with.

    Args:
        block: the head's rows; column: of the times.

    Raises:
        UnreadableError: day and month cannot be told apart.
    """
    if all(map(is_year_first, dialect.cells(column))):
        return dialect
    cells = cells_of(block.data, dialect, column)
    told = [order for order in (_of_the_start(cells, known), known.date_order) if order]
    order = find_order(cells, options.date_format, told, path, dialect.skipped + 1)
    if order is None:
        return dialect
    sample = tuple(
        (*row[:column], year_first_cell(row[column], order), *row[column + 1 :]) for row in dialect.sample
    )
    return replace(dialect, cleaner=replace(dialect.cleaner, date_order=order), sample=sample)


def _of_the_start(cells: list[str], known: Known) -> str | None:
    """The one order in which the first row lies on the day on which the header says it began."""
    if known.start is None or not cells:
        return None
    days = known.start.days(known.date_order)
    fitting = [order for order in ORDERS if read_date(cells[0], order) in days]
    return fitting[0] if len(fitting) == 1 else None
