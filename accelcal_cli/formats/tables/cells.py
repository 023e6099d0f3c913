"""Understands cells of text: numbers, units, dates and times, in text files and in columns of texts."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.clock import FIRST_US, LAST_US
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.vocabulary import find_unit
from accelcal_cli.core.written_times import (
    DIGITS_ALONE,
    ORDERS,
    SHAPES,
    Surroundings,
    around_time,
    is_date,
    is_time,
    month_of,
    needs_order,
    read_date,
    stated_zone,
    surroundings,
    undated,
)
from accelcal_cli.formats._stamps import HOUR_24, IMPOSSIBLE, NO_TIME
from accelcal_cli.formats.tables.header import BETWEEN_GROUPS, DECIMAL, Kind, Source, unclear_date

# Reads columns of times that people wrote, many cells at a time (`core/written_times.py` knows the
# forms).
#
# Numbers of the time of day are taken from the cells by Arrow; what stands around them is read once
# for each text that differs.

EPOCH_DAY = date(1970, 1, 1).toordinal()
DAY_S = 86_400
NO_DAY, OTHER_DAY = -(1 << 40), -(1 << 41)
"""Stand for a day that does not exist, and for one that is written in another form."""

DIRECTIVES = {
    **{"H": r"(?P<h>\d{1,2})", "I": r"(?P<h>\d{1,2})", "M": r"(?P<m>\d{1,2})", "S": r"(?P<s>\d{1,2})"},
    **{"f": r"(?P<f>\d{1,9})", "%": "%", "n": r"\s+", "t": r"\s+"},
    **{"d": r"\d{1,2}", "m": r"\d{1,2}", "y": r"\d\d", "Y": r"\d{4}", "j": r"\d{1,3}", "p": r"[^\d\s]{1,6}"},
    **{"b": r"[^\d\s,/]+", "B": r"[^\d\s,/]+", "a": r"[^\d\s,/]+", "A": r"[^\d\s,/]+", "u": r"\d"},
    **{"z": r"(?:Z|[+-]\d\d:?\d\d)", "Z": r"[A-Za-z/_]+", "G": r"\d{4}", "V": r"\d\d", "U": r"\d\d"},
}
"""Patterns of the directives of strptime; those of a time of day have names."""

SHORTHANDS = {"%T": "%H:%M:%S", "%F": "%Y-%m-%d", "%D": "%m/%d/%y", "%R": "%H:%M", "%e": "%d", "%h": "%b"}


@dataclass(frozen=True, slots=True)
class Written:
    """How the cells of a column of times are written.

    Attributes:
        pattern: of a cell, with groups h, m, s and f of its time of day, and others.
        order: of day, month and year in dates of numbers.
        directives: strptime's, of the groups d0, d1, ...; empty where `surroundings` reads before and after.
        offsets: True where the times are those of the offsets that are written, False for a clock's.
        vague: names of zones are left out, since one of them stands for several.
        digits: of fractions of seconds that are written without leading zeros; 0 for decimals.
    """

    pattern: str
    order: str | None = None
    directives: tuple[str, ...] = ()
    offsets: bool = False
    vague: bool = False
    digits: int = 0

    def read(self, cells: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return texts (n,), an array of Arrow, as times (n,) [us], and the rows of those not written so.

        NO_TIME stands where a text is empty or not written so, IMPOSSIBLE for times that do not exist.
        HOUR_24 is added to those of the hour 24.
        """
        import pyarrow.compute as pc  # takes a tenth of a second, and most files need none of it

        found = pc.extract_regex(pc.utf8_trim_whitespace(cells), self.pattern)
        rows = np.flatnonzero(np.from_dlpack(found.is_valid().cast(pa.uint8())))
        others = np.from_dlpack(cells.is_valid().cast(pa.uint8())) > 0
        times = np.full(len(cells), NO_TIME, np.int64)
        if len(rows):
            read, known = self._times_of(pc, found.drop_null())
            times[rows] = np.where(known, read, NO_TIME)
            others[rows] = ~known
        return times, np.flatnonzero(others)

    def _times_of(self, pc: Any, found: Any) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the times of what the pattern found (n,), and flags of those whose day is understood."""
        names = [field.name for field in found.type]
        parts = {name: pc.fill_null(pc.struct_field(found, name), "") for name in names}
        h, m, s = (_whole(pc, parts.get(name), len(found)) for name in "hms")
        decimals = parts.get("f")
        if decimals is not None and self.digits:
            decimals = pc.utf8_lpad(decimals, self.digits, "0")
        padded = None if decimals is None else pc.utf8_slice_codeunits(pc.utf8_rpad(decimals, 9, "0"), 0, 9)
        ns = _whole(pc, padded, len(found))
        around = [parts[name] for name in names if name not in ("h", "m", "s", "f")]
        days, shift, late = self._days(pc, around, len(found))
        halves = late >= 0
        hours = np.where(halves & (h <= 12), h % 12 + 12 * late, h)
        wrong = (hours > 24) | (m > 59) | (s > 60) | ((late == 0) & (h > 12)) | (days <= NO_DAY)
        seconds = (np.where(wrong, 0, days) * 24 + hours % 24) * 3600 + m * 60 + s - shift
        times = seconds * 1_000_000 + (ns + 500) // 1000
        wrong |= (times < FIRST_US) | (times > LAST_US)
        return np.where(wrong, IMPOSSIBLE, times + HOUR_24 * (hours == 24)), days != OTHER_DAY

    def _days(self, pc: Any, around: Sequence[Any], rows: int) -> tuple[NDArray[np.int64], ...]:
        """Return the days since 1970, the seconds ahead of UTC, and 1 for PM, 0 for AM, -1 without; (n,)."""
        if not around:
            return np.zeros(rows, np.int64), np.zeros(rows, np.int64), np.full(rows, -1)
        joined = pc.binary_join_element_wise(*around, "\x1f") if len(around) > 1 else around[0]
        coded = joined.dictionary_encode()
        read = np.array([self._read(text) for text in coded.dictionary.to_pylist()], np.int64)
        values = read.reshape(-1, 3)[np.from_dlpack(coded.indices)]
        return values[:, 0], values[:, 1], values[:, 2]

    def _read(self, text: str) -> tuple[int, int, int]:
        found = self.around(text.split("\x1f"))
        if found is None or not self.fits(found):
            return OTHER_DAY, 0, -1
        day = 0 if not found.dated else NO_DAY if found.day is None else found.day.toordinal() - EPOCH_DAY
        late = -1 if found.afternoon is None else int(found.afternoon)
        return day, (found.offset_s or 0) if self.offsets else 0, late

    def fits(self, found: Surroundings) -> bool:
        """Return True if there is a zone where the others have one, and none where they have none."""
        return self.vague or self.offsets == (found.offset_s is not None)

    def around(self, texts: Sequence[str]) -> Surroundings | None:
        """Return what the texts around a time of day say; None if they are not understood."""
        if not self.directives:
            return surroundings(texts[0], texts[1], self.order)
        pairs = [_in_english(*pair) for pair in zip(self.directives, texts, strict=True)]
        asked, given = (" ".join(some) for some in zip(("%I", "1"), *pairs, strict=True))
        try:
            read = datetime.strptime(given, asked)
        except ValueError:
            return Surroundings(True) if "%d" in self.directives else None
        dated = any(one[1] in "dmyYjGV" for one, _ in pairs)
        offset = read.utcoffset()
        half = read.hour >= 12 if "%p" in self.directives else None
        offset_s = None if offset is None else round(offset.total_seconds())
        return Surroundings(dated, read.date(), offset_s, half)

    def cell(self, text: str) -> Surroundings | None:
        """Return what stands around the time of day of one cell; None if it is written otherwise."""
        found = re.fullmatch(self.pattern.removeprefix("^").removesuffix("$"), text.strip())
        if found is None:
            return None
        groups = found.groupdict("")
        return self.around([groups[name] for name in groups if name not in ("h", "m", "s", "f")] or ["", ""])


def _in_english(directive: str, text: str) -> tuple[str, str]:
    """Return a directive of strptime and its text without names that depend on a language."""
    if directive in ("%b", "%B"):
        return "%m", str(month_of(text) or text)
    if directive in ("%a", "%A"):
        return "%%", "%"
    zone = stated_zone(text) if directive == "%Z" else None
    return ("%z", zone.replace("UTC", "Z")) if zone and "/" not in zone else (directive, text)


def _whole(pc: Any, texts: Any, rows: int) -> NDArray[np.int64]:
    """Return texts of digits (n,) as numbers; 0 for an empty one, and where there are none."""
    if texts is None:
        return np.zeros(rows, np.int64)
    filled = pc.if_else(pc.equal(texts, ""), "0", texts)
    return np.from_dlpack(pc.cast(filled, pa.int64())).astype(np.int64, copy=False)


def unpadded_digits(cells: Iterable[str]) -> int:
    """Return the digits of fractions of seconds that are numbers without leading zeros, 5 for 005; else 0.

    Such numbers may end in a zero, but do not begin with one; with decimals of different lengths it is the
    other way round.
    """
    matches = (next(filter(None, (shape.fullmatch(cell) for shape in SHAPES)), None) for cell in cells)
    found = [match["f"] for match in matches if match is not None and match["f"]]
    several = [digits for digits in found if len(digits) > 1]
    numbers = any(digits.endswith("0") for digits in several) and not any(
        digits.startswith("0") for digits in several
    )
    return max(map(len, found)) if numbers and len(set(map(len, found))) > 1 else 0


def written_form(cells: Sequence[str], order: str | None = None, digits: int = 0) -> Written | None:
    """Return how cells are written, at least one; None if not all of them are times of one form."""
    forms = (Written(shape.pattern, order, digits=digits) for shape in SHAPES)
    return next((form for form in forms if all(form.cell(cell) is not None for cell in cells)), None)


def digits_alone() -> Written:
    """Return the form of times of day such as 104140.000."""
    return Written(DIGITS_ALONE)


def strptime_form(text: str) -> Written:
    """Return the form that a pattern of strptime describes.

    Raises:
        ValueError: it has no time of day, or a directive that is not known or stands twice.
    """
    for short, long in SHORTHANDS.items():
        text = text.replace(short, long)
    directives: list[str] = []
    pattern = ""
    for literal, directive in re.findall(r"([^%]+)|%(.)", text):
        if literal:
            pattern += re.escape(literal).replace(r"\ ", r"\s+")
        elif directive not in DIRECTIVES:
            raise ValueError(f"%{directive} is not known")
        elif "(?P<" in DIRECTIVES[directive] or directive in "%nt":
            pattern += DIRECTIVES[directive]
        else:
            pattern += f"(?P<d{len(directives)}>{DIRECTIVES[directive]})"
            directives.append(f"%{directive}")
    if "?P<h>" not in pattern:
        raise ValueError("it has no hour, %H or %I")
    try:
        re.compile(pattern)
    except re.error as error:
        raise ValueError("a directive is used twice") from error
    return Written(f"^{pattern}$", directives=tuple(directives))


# Understands cells of text.

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
MISSING = frozenset({
    *("", "NaN", "nan", "NAN", "Nan", "-nan", "-NaN", "NA", "N/A", "n/a", "na", "n.a.", "N.A.", "#N/A"),
    *("#NA", "NULL", "null", "Null", "(null)", "<null>", "None", "none", "NONE", "nil", "<NA>", "NaT"),
    *("undefined", "missing", "Missing", "MISSING", "-", "--", "---", "\u2013", "\u2014", "?", "??", "."),
    *("*", "#NUM!", "#VALUE!", "#DIV/0!", "1.#QNAN", "-1.#QNAN", "1.#IND", "-1.#IND"),
})  # fmt: skip
"""Cells that stand for a missing value; pyarrow is given the same list."""

NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|infinity)", re.ASCII | re.IGNORECASE)
POINT_NUMBER = re.compile(r"[+\u2212-]?\d*\.\d*([eE][+-]?\d+)?")
COMMA_NUMBER = re.compile(r"[+\u2212-]?\d*,\d+([eE][+-]?\d+)?")
GROUPS = re.compile(
    r"[+-]?[1-9]\d{0,2}(?P<mark>[ \u00a0\u2009\u202f'\u2019.,])\d{3}(?:(?P=mark)\d{3})*"
    r"(?P<decimals>(?!(?P=mark))[.,]\d*)?",
    re.ASCII,
)
"""A number with marks between groups of three digits, of which a point or a comma may be none."""

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


def cell_kind(cell: str) -> Kind:
    """Return the kind of one cell; blanks around it do not count."""
    cell = cell.strip()
    if cell in MISSING:
        return Kind.MISSING
    if number_of(cell) is not None or number_of(cell, BETWEEN_GROUPS) is not None:
        return Kind.NUMBER
    known = DATE.fullmatch(cell) or TIME_OF_DAY.fullmatch(cell) or is_time(cell) or is_date(cell)
    return Kind.TIME if known else Kind.TEXT


def present(cells: Iterable[str]) -> list[str]:
    """Return the cells that are not missing, without blanks around them."""
    return [text for cell in cells if (text := cell.strip()) not in MISSING]


def least_of(number: int, share: float) -> float:
    """Return how many of some lines a share is; of a few, all but one."""
    return min(share * number, number - 1) if number >= FEW else share * number


def column_kind(cells: Sequence[str], share: float) -> Kind:
    """Return the kind that this share of the cells have, unless missing; TEXT if there is none.

    Where cells are few, one may be unlike the others, which is damage.
    """
    kinds = [*map(cell_kind, cells)]
    missing = kinds.count(Kind.MISSING)
    if missing == len(kinds):
        return Kind.MISSING
    for kind in (Kind.NUMBER, Kind.TIME):
        if kind in kinds and kinds.count(kind) + missing >= least_of(len(kinds), share):
            return kind
    return Kind.TEXT


def plain_number(cell: str, comma: str) -> str:
    """Return a number with an ASCII minus, a decimal point and no other marks; other texts as they are.

    Args:
        comma: what a comma alone becomes: DECIMAL, BETWEEN_GROUPS, or UNKNOWN.
    """
    text = cell.strip().replace("\u2212", "-")
    found = GROUPS.fullmatch(text)
    if found and (found["decimals"] or found["mark"].replace(",", comma) not in (*".,",)):
        return text.replace(found["mark"], "").replace(",", ".")
    return text.replace(",", ".") if comma == DECIMAL and not text.endswith(",") else text


def number_of(cell: str, comma: str = DECIMAL) -> float | None:
    """Return the number in a cell, None if it holds none."""
    text = plain_number(cell, comma)
    return float(text) if NUMBER.fullmatch(text) else None


def shows_decimal_comma(cell: str) -> bool:
    """Return True for a number whose comma cannot stand before a group of three digits."""
    return number_of(cell, BETWEEN_GROUPS) is None and number_of(cell) is not None


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


# The order of day, month and year in the dates of a table.


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
