"""What a single cell of a text file is: a number, a time, nothing, or some other text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from enum import Enum

MISSING = (
    *("", "NaN", "nan", "NAN", "-nan", "-NaN", "NA", "N/A", "n/a", "na", "#N/A", "#NA", "NULL", "null"),
    *("None", "none", "1.#QNAN", "-1.#QNAN", "1.#IND", "-1.#IND"),
)
"""Cells that stand for a missing value; the same list is given to pyarrow."""

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|infinity)", re.IGNORECASE)
POINT_NUMBER = re.compile(r"[+-]?\d*\.\d*([eE][+-]?\d+)?")
COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
DATE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([T ].*)?")
TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d(:\d\d.*)?( ?[AaPp][Mm])?")


class Kind(Enum):
    """The kind of a cell, or of a column whose cells are nearly all of it."""

    NUMBER = "number"
    TIME = "time"
    MISSING = "missing"
    TEXT = "text"


def cell_kind(cell: str, decimal_comma: bool) -> Kind:
    """The kind of one cell, blanks around it ignored."""
    cell = cell.strip()
    if cell in MISSING:
        return Kind.MISSING
    if NUMBER.fullmatch(cell) or (decimal_comma and COMMA_NUMBER.fullmatch(cell)):
        return Kind.NUMBER
    return Kind.TIME if DATE.fullmatch(cell) or TIME_OF_DAY.fullmatch(cell) else Kind.TEXT


def column_kind(cells: Sequence[str], decimal_comma: bool, share: float) -> Kind:
    """The kind that this share of the cells are or miss; text where there is none."""
    kinds = [cell_kind(cell, decimal_comma) for cell in cells]
    missing = kinds.count(Kind.MISSING)
    if missing == len(kinds):
        return Kind.MISSING
    for kind in (Kind.NUMBER, Kind.TIME):
        if kind in kinds and kinds.count(kind) + missing >= share * len(kinds):
            return kind
    return Kind.TEXT


def number_of(cell: str) -> float | None:
    """The cell as a number, None where it is none."""
    cell = cell.strip().replace(",", ".")
    return float(cell) if NUMBER.fullmatch(cell) else None
