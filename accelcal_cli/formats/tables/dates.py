"""The order of day, month and year in the dates of a table."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.written_times import ORDERS, around_time, needs_order, read_date, undated
from accelcal_cli.formats.tables.cells import is_year_first
from accelcal_cli.formats.tables.header import Source, unclear_date


def date_texts(cells: Iterable[str]) -> list[str]:
    """Return the different dates in cells of times that need an order: numbers without the year first.

    Args:
        cells: as they are written; what is not a date is left for others to judge.
    """
    open_dates = (re.split("[ T]", cell.strip())[0] for cell in cells if not is_year_first(cell))
    found = dict.fromkeys(open_dates)
    around = {pair for cell in cells if (pair := around_time(cell.strip())) is not None} if not found else ()
    texts = (text for before, after in sorted(around) if (text := undated(before, after)))
    return [*found, *(text for text in texts if needs_order(text))]


def find_order(
    texts: Sequence[str], user_order: str | None, header_orders: Iterable[str], path: Path, line: int | None
) -> str:
    """Return the order of day, month and year in the texts of dates, at least one.

    Args:
        user_order: what the user chose.
        header_orders: what a vendor's header suggests, best first.

    Raises:
        UnreadableError: several orders fit, or none, or not the one that the user chose.
    """
    fitting = _fitting_orders(texts) or _fitting_orders(texts[:1])
    wanted = [user_order] if user_order else [*header_orders, *(fitting if len(fitting) == 1 else ())]
    for order in wanted:
        if order in fitting:
            return order
    raise unclear_date(texts[0], fitting, path, line)


def _fitting_orders(texts: Sequence[str]) -> list[str]:
    return [order for order in ORDERS if all(read_date(text, order) for text in texts)]


def order_of(texts: list[str], source: Source, options: ReadOptions) -> str | None:
    """Return the order of day, month and year in dates; None if there are none that need it.

    A header suggests the only order in which the first row lies on the day on which it says it began.
    """
    if not texts:
        return None
    about = source.stated
    days = about.start.days(about.date_order) if about.start is not None else ()
    fitting = [order for order in ORDERS if days and read_date(texts[0], order) in days]
    stated = [order for order in (fitting[0] if len(fitting) == 1 else None, about.date_order) if order]
    return find_order(texts, options.date_format, stated, source.path, source.first_line)
