"""Understands cells of text: numbers, units, dates and times, in text files and in columns of texts."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence

from accelcal_cli.core.vocabulary import find_unit
from accelcal_cli.core.written_times import is_date, is_time, read_date
from accelcal_cli.formats.tables.header import Kind

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
MISSING = frozenset({
    *("", "NaN", "nan", "NAN", "Nan", "-nan", "-NaN", "NA", "N/A", "n/a", "na", "n.a.", "N.A.", "#N/A"),
    *("#NA", "NULL", "null", "Null", "(null)", "<null>", "None", "none", "NONE", "nil", "<NA>", "NaT"),
    *("undefined", "missing", "Missing", "MISSING", "-", "--", "---", "\u2013", "\u2014", "?", "??", "."),
    *("*", "#NUM!", "#VALUE!", "#DIV/0!", "1.#QNAN", "-1.#QNAN", "1.#IND", "-1.#IND"),
})  # fmt: skip
"""Cells that stand for a missing value; pyarrow is given the same list."""

NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|infinity)", re.IGNORECASE)
POINT_NUMBER = re.compile(r"[+-]?\d*\.\d*([eE][+-]?\d+)?")
COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
DATE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([T ].*)?")
DATE_ALONE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}")
TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d(:\d\d.*)?( ?[AaPp][Mm])?")
NO_UNIT = ("", "-", "deg_c", "no units", "no_units", "n/a", "local_flux", "cal")
"""Cells in a line of units of columns that have none, or one that is not looked at."""

DATE_BYTES = re.compile(rb"(?<!\d)(\d{1,4})([-/.])(\d{1,2})\2(\d{1,4})([ T])(\d(?=:))?")
ISO = re.compile(r"\d{4}[-/]\d\d[-/]\d\d(?!\d)")
FEW = 6
"""Lines from which on one that is unlike the others is damage."""

KIND_SHARE = 0.9
"""Share of the first texts of a column that must be numbers or times."""


def decode(line: bytes) -> str:
    """Return a line as text: UTF-8, or Latin-1 where it is not UTF-8."""
    try:
        return line.decode()
    except UnicodeDecodeError:
        return line.decode("latin-1")


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line without their quotes."""
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return []


def cell_kind(cell: str, decimal_comma: bool) -> Kind:
    """Return the kind of one cell; blanks around it do not count."""
    cell = cell.strip()
    if cell in MISSING:
        return Kind.MISSING
    if NUMBER.fullmatch(cell) or (decimal_comma and COMMA_NUMBER.fullmatch(cell)):
        return Kind.NUMBER
    known = DATE.fullmatch(cell) or TIME_OF_DAY.fullmatch(cell) or is_time(cell) or is_date(cell)
    return Kind.TIME if known else Kind.TEXT


def present(cells: Iterable[str]) -> list[str]:
    """Return the cells that are not missing, without blanks around them."""
    return [text for cell in cells if (text := cell.strip()) not in MISSING]


def least_of(number: int, share: float) -> float:
    """Return how many of some lines a share is; of a few, all but one."""
    return min(share * number, number - 1) if number >= FEW else share * number


def column_kind(cells: Sequence[str], decimal_comma: bool, share: float) -> Kind:
    """Return the kind that this share of the cells have, unless missing; TEXT if there is none.

    Where cells are few, one may be unlike the others, which is damage.
    """
    kinds = [cell_kind(cell, decimal_comma) for cell in cells]
    missing = kinds.count(Kind.MISSING)
    if missing == len(kinds):
        return Kind.MISSING
    for kind in (Kind.NUMBER, Kind.TIME):
        if kind in kinds and kinds.count(kind) + missing >= least_of(len(kinds), share):
            return kind
    return Kind.TEXT


def number_of(cell: str) -> float | None:
    """Return the number in a cell, None if it holds none."""
    cell = cell.strip().replace(",", ".")
    return float(cell) if NUMBER.fullmatch(cell) else None


def is_unit_cell(text: str) -> bool:
    """Return True if a cell below a column's name can be its unit."""
    return text.strip().strip("[]()").lower() in NO_UNIT or find_unit(text) is not None


def is_year_first(cell: str) -> bool:
    """Return True if a cell needs no other order: it begins with the year, or is not a date."""
    cell = cell.strip()
    return ISO.match(cell) is not None or DATE_BYTES.match(cell.encode()) is None


def year_first(block: bytes, order: str, thorough: bool) -> bytes:
    """Return lines with their dates as 2024-03-04; a block holds few different dates.

    Args:
        order: of day, month and year, such as `dmy`.
        thorough: look at every line, not only at the first and the last, whose dates nearly always
            are all there are.
    """
    if thorough:
        return DATE_BYTES.sub(lambda found: _with_year_first(found, order), block)
    end = block.find(b"\n") + 1 or len(block)
    begin = block.rstrip(b"\r\n").rfind(b"\n") + 1
    ends = [found for line in (block[:end], block[begin:]) if (found := DATE_BYTES.search(line))]
    for old, new in {found[0]: _with_year_first(found, order) for found in ends}.items():
        block = block.replace(old, new)
    return block


def _with_year_first(found: re.Match[bytes], order: str) -> bytes:
    """Return a match with the year first and an hour of two digits; unchanged where it is not a date."""
    day = read_date(found[0].decode(), order)
    hour = b"" if found[6] is None else b"0" + found[6]
    return found[0] if day is None else day.isoformat().encode() + found[5] + hour
