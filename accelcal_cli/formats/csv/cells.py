"""Understands the cells of a text file: numbers, units, dates and times.

Times are whole microseconds since 1970. Arrow's own ways to numpy load pandas, which takes a third of a
second; `filled` and `floats` do without.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.vocabulary import COUNTS, CSV, GIVE_UNIT, PER_G, PER_SECOND
from accelcal_cli.core.written_times import is_date, is_time, read_date
from accelcal_cli.formats._gravity import usual_length

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
BRACKET = re.compile(r"[\[(]")
OTHER_UNITS = (
    *("-", "", "deg_c", "no units", "no_units", "n/a", "local_flux", "ut", "µt", "hz", "v", "mv", "lux"),
    *("pa", "kpa", "cal"),
)
"""Units below names of columns, besides those of the vocabulary."""

DATE_BYTES = re.compile(rb"(?<!\d)(\d{1,4})([-/.])(\d{1,2})\2(\d{1,4})([ T])(\d(?=:))?")
ISO = re.compile(r"\d{4}[-/]\d\d[-/]\d\d(?!\d)")
FEW = 6
"""Lines from which on one that is unlike the others is damage."""

LARGEST_G = 127.0
"""Values beyond this [g] are damage."""

USUAL_G = (0.3, 3.0)
"""A recording's usual length of acceleration [g] lies between these, however its wearer moves."""


class CellKind(Enum):
    """The kind of a cell, or of a column whose cells are nearly all of it."""

    NUMBER = "number"
    TIME = "time"
    MISSING = "missing"
    TEXT = "text"


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


def cell_kind(cell: str, decimal_comma: bool) -> CellKind:
    """Return the kind of one cell; blanks around it do not count."""
    cell = cell.strip()
    if cell in MISSING:
        return CellKind.MISSING
    if NUMBER.fullmatch(cell) or (decimal_comma and COMMA_NUMBER.fullmatch(cell)):
        return CellKind.NUMBER
    known = DATE.fullmatch(cell) or TIME_OF_DAY.fullmatch(cell) or is_time(cell) or is_date(cell)
    return CellKind.TIME if known else CellKind.TEXT


def least_of(number: int, share: float) -> float:
    """Return how many of some lines a share is; of a few, all but one."""
    return min(share * number, number - 1) if number >= FEW else share * number


def column_kind(cells: Sequence[str], decimal_comma: bool, share: float) -> CellKind:
    """Return the kind that this share of the cells have, unless missing; TEXT if there is none.

    Where cells are few, one may be unlike the others, which is damage.
    """
    kinds = [cell_kind(cell, decimal_comma) for cell in cells]
    missing = kinds.count(CellKind.MISSING)
    if missing == len(kinds):
        return CellKind.MISSING
    for kind in (CellKind.NUMBER, CellKind.TIME):
        if kind in kinds and kinds.count(kind) + missing >= least_of(len(kinds), share):
            return kind
    return CellKind.TEXT


def number_of(cell: str) -> float | None:
    """Return the number in a cell, None if it holds none."""
    cell = cell.strip().replace(",", ".")
    return float(cell) if NUMBER.fullmatch(cell) else None


def acceleration_unit(text: str) -> str | None:
    """Return g, mg, m/s2 or counts for a word such as `m/s^2`; None for any other word."""
    return CSV.accelerations.get(text.strip().lower())


def microseconds_in(text: str) -> float | None:
    """Return the microseconds in a unit of time such as `ms`; None for any other word."""
    unit = CSV.durations.get(text.strip().lower())
    return None if unit is None else MICROSECONDS / PER_SECOND[unit]


def is_unit_cell(text: str) -> bool:
    """Return True if a cell below a column's name can be its unit."""
    text = text.strip().strip("[]()").lower()
    known = acceleration_unit(text) is not None or microseconds_in(text) is not None
    return known or text in OTHER_UNITS or text in CSV.rotations or text in CSV.temperatures


def name_and_hint(name: str) -> tuple[str, str | None]:
    """Return a column's name without its bracketed unit, and the words in the brackets."""
    name = name.strip()
    match = BRACKET.search(name, 0, len(name) - 1)
    if match is None or name[-1] not in "])":
        return name, None
    return name[: match.start()].strip(), name[match.end() : -1].strip()


@dataclass(frozen=True, slots=True)
class AccelScale:
    """How accelerations become whole counts.

    Attributes:
        unit: of the values, or `counts`.
        zero: the count that stands for 0 g; found_zero: the values show it, and nothing states it.
    """

    unit: str
    lsb_per_g: float
    zero: int = 0
    found_zero: bool = False

    @property
    def limit(self) -> float:
        """The largest believable magnitude of a count."""
        return min(LARGEST_G * self.lsb_per_g, float(np.iinfo(np.int32).max))

    def counts(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values (n,) as counts (n,), rounded half to even; NaN stays NaN."""
        if self.unit == COUNTS:
            return values - self.zero if self.zero else values
        in_g = values if self.per_g == 1.0 else values / self.per_g
        with np.errstate(over="ignore"):
            return np.rint(in_g * self.lsb_per_g)

    @property
    def per_g(self) -> float:
        """The value of one g in the unit."""
        return PER_G.get(self.unit, self.lsb_per_g)

    def check(self, values: NDArray[np.float64], path: Path) -> None:
        """Check a unit that was inferred from a vendor's layout.

        Raises:
            UnreadableError: in it, values (n, 3) are far from the length of gravity.
        """
        length = usual_length(values - self.zero) / self.per_g
        if length and not USUAL_G[0] < length < USUAL_G[1]:
            raise UnreadableError(
                f"its usual acceleration would be {length:.3g} g, so that its unit is in doubt",
                path=path,
                hint=GIVE_UNIT,
            )


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


def filled(column: Any, kind: type[np.generic], null: float) -> NDArray[Any]:
    """Return a chunked column of numbers or times of eight bytes, (n,), with `null` where a cell is empty."""
    parts = [_filled(chunk, kind, null) for chunk in column.chunks if len(chunk)]
    if len(parts) == 1:
        return parts[0]
    return np.concatenate(parts) if parts else np.empty(0, kind)


def _filled(chunk: Any, kind: type[np.generic], null: float) -> NDArray[Any]:
    values = np.frombuffer(chunk.buffers()[1], kind, len(chunk), 8 * chunk.offset)
    if not chunk.null_count:
        return values
    empty = np.from_dlpack(chunk.is_null().cast(pa.uint8())) > 0
    return np.where(empty, np.asarray(null, kind), values)


def floats(column: Any) -> NDArray[np.float64]:
    """Return a chunked column of doubles with NaN where a cell is empty, (n,)."""
    return filled(column, np.float64, np.nan)
