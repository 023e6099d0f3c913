"""Dates that do not begin with the year: in which order they are written, and year first instead."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from datetime import date
from pathlib import Path

from accelcal_cli.core.errors import UnreadableError

ORDERS = ("dmy", "mdy", "ymd")
CENTURY = 2000
"""Added to years of two digits."""

DATE = re.compile(rb"(?<!\d)(\d{1,4})([-/.])(\d{1,2})\2(\d{1,4})([ T])(\d(?=:))?")
ISO = re.compile(r"\d{4}[-/]\d\d[-/]\d\d(?!\d)")


def year_first(block: bytes, order: str, thorough: bool) -> bytes:
    """Lines with their dates as 2024-03-04; a block holds few different dates.

    Args:
        order: of day, month and year, such as `dmy`.
        thorough: look at every line, not only at the first and the last, whose dates nearly always
            are all there are.
    """
    if thorough:
        return DATE.sub(lambda found: _iso(found, order), block)
    end = block.find(b"\n") + 1 or len(block)
    begin = block.rstrip(b"\r\n").rfind(b"\n") + 1
    ends = [found for line in (block[:end], block[begin:]) if (found := DATE.search(line))]
    for old, new in {found[0]: _iso(found, order) for found in ends}.items():
        block = block.replace(old, new)
    return block


def year_first_cell(cell: str, order: str) -> str:
    """One cell, likewise."""
    return year_first(cell.encode(), order, True).decode()


def read_date(text: str, order: str) -> date | None:
    """The date at the beginning of a text; None where it is none in this order."""
    numbers = re.match(r"\D*(\d{1,4})\D{1,3}(\d{1,2})\D{1,3}(\d{1,4})(?!\d)", text)
    if numbers is None:
        return None
    parts = dict(zip(order, (numbers[1], numbers[2], numbers[3]), strict=True))
    if len(parts["y"]) not in (2, 4) or len(parts["d"]) > 2:
        return None
    year = int(parts["y"]) + (CENTURY if len(parts["y"]) == 2 else 0)
    try:
        return date(year, int(parts["m"]), int(parts["d"]))
    except ValueError:
        return None


def order_in(words: str) -> str | None:
    """The order that a pattern such as `dd/MM/yyyy` stands for; None for names of months."""
    found = "".join(dict.fromkeys(letter for letter in words.lower() if letter in "dmy"))
    return found if found in ORDERS and "mmm" not in words.lower() else None


def find_order(cells: Iterable[str], said: str | None, told: Iterable[str], path: Path, line: int) -> str:
    """The order of day, month and year in the cells of a time column that do not begin with the year.

    Args:
        cells: as they are written; what is no date is left for others to judge.
        said: what the user said.
        told: what a vendor's header lets expect, best first.

    Raises:
        UnreadableError: several orders fit, or none, or not the one that the user said.
    """
    texts = list(dict.fromkeys(re.split("[ T]", c.strip())[0] for c in cells if not is_year_first(c)))
    fitting = _fitting(texts) or _fitting(texts[:1])
    wanted = [said] if said else [*told, *(fitting if len(fitting) == 1 else ())]
    for order in wanted:
        if order in fitting:
            return order
    raise unclear_date(texts[0], fitting, path, line)


def _fitting(texts: list[str]) -> list[str]:
    return [order for order in ORDERS if all(read_date(text, order) for text in texts)]


def is_year_first(cell: str) -> bool:
    """Whether a cell needs no other order: it begins with the year, or is no date."""
    cell = cell.strip()
    return ISO.match(cell) is not None or DATE.match(cell.encode()) is None


def unclear_date(text: str, fitting: Sequence[str], path: Path, line: int) -> UnreadableError:
    """The error that asks for the order of a date.

    Args:
        fitting: the orders in which it, and its like, can be read.
    """
    words = " or ".join(fitting)
    fault, hint = f"the date {text!r} can be read as {words}", f"say which with --date-format {words}"
    if len(fitting) == 1:
        fault, hint = f"the date {text!r} can only be read as {words}", f"give --date-format {words}"
    elif not fitting:
        fault, hint = f"{text!r} and its like are no dates", "give --time-column none and --rate"
    return UnreadableError(fault, path=path, line=line, hint=hint)


def _iso(found: re.Match[bytes], order: str) -> bytes:
    """A match with the year first, hour of two digits; as it is where it is no date."""
    day = read_date(found[0].decode(), order)
    hour = b"" if found[6] is None else b"0" + found[6]
    return found[0] if day is None else day.isoformat().encode() + found[5] + hour
