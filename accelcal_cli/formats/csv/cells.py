"""Understands the cells of a text file: numbers, units, dates and times.

Times are whole microseconds since 1970. Arrow's own ways to numpy load pandas, which takes a third of a
second; `filled` and `floats` do without.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.clock import FIRST_US, LAST_US, MICROSECONDS
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.vocabulary import COUNTS, CSV, GIVE_UNIT, PER_G, PER_SECOND
from accelcal_cli.formats._gravity import usual_length
from accelcal_cli.formats._stamps import EPOCH_DAYS, IMPOSSIBLE, NO_TIME, PLAUSIBLE_HZ

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
MISSING = (
    *("", "NaN", "nan", "NAN", "-nan", "-NaN", "NA", "N/A", "n/a", "na", "#N/A", "#NA", "NULL", "null"),
    *("None", "none", "1.#QNAN", "-1.#QNAN", "1.#IND", "-1.#IND"),
)
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

ORDERS = ("dmy", "mdy", "ymd")
"""Orders of day, month and year in a date."""

YEAR = re.compile(r"\d{4}\D")
CENTURY = 2000
"""Added to years of two digits."""

DATE_BYTES = re.compile(rb"(?<!\d)(\d{1,4})([-/.])(\d{1,2})\2(\d{1,4})([ T])(\d(?=:))?")
ISO = re.compile(r"\d{4}[-/]\d\d[-/]\d\d(?!\d)")
STAMP = re.compile(r"\d{4}[-/]\d\d[-/]\d\d([T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(?P<zone>Z|[+-]\d\d(:?\d\d)?)?)?")
LARGEST_G = 127.0
"""Values beyond this [g] are damage."""

USUAL_G = (0.3, 3.0)
"""A recording's usual length of acceleration [g] lies between these, however its wearer moves."""

EMPTY_NS = -(1 << 63)
"""Stands for an empty cell among Arrow's times."""

DAY_US = 86_400e6
UNITS_US = (1e6, 1e3, 1.0, 1e-3)
"""Units in which a plain number may count time [us]."""

EPOCH_S = (9e8, 5e9)
"""Plain numbers count from 1970 where they then mean 1998 to 2128."""

LONGEST_PERIOD_US = 60e6
"""A number that counts from 1970 rises by at most this a row."""


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
    return CellKind.TIME if DATE.fullmatch(cell) or TIME_OF_DAY.fullmatch(cell) else CellKind.TEXT


def column_kind(cells: Sequence[str], decimal_comma: bool, share: float) -> CellKind:
    """Return the kind that this share of the cells have, unless missing; TEXT if there is none."""
    kinds = [cell_kind(cell, decimal_comma) for cell in cells]
    missing = kinds.count(CellKind.MISSING)
    if missing == len(kinds):
        return CellKind.MISSING
    for kind in (CellKind.NUMBER, CellKind.TIME):
        if kind in kinds and kinds.count(kind) + missing >= share * len(kinds):
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
        zero: the count that stands for 0 g.
    """

    unit: str
    lsb_per_g: float
    zero: int = 0

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


def read_date(text: str, order: str) -> date | None:
    """Return the date at the beginning of a text; None if it is not one in this order."""
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


def order_in(words: str) -> str | None:
    """Return the order that a pattern such as `dd/MM/yyyy` stands for; None for names of months."""
    found = "".join(dict.fromkeys(letter for letter in words.lower() if letter in "dmy"))
    return found if found in ORDERS and "mmm" not in words.lower() else None


def find_order(
    cells: Iterable[str], user_order: str | None, header_orders: Iterable[str], path: Path, line: int
) -> str:
    """Return the order of day, month and year in cells of times that do not begin with the year.

    Args:
        cells: as they are written; what is not a date is left for others to judge.
        user_order: what the user chose.
        header_orders: what a vendor's header suggests, best first.

    Raises:
        UnreadableError: several orders fit, or none, or not the one that the user chose.
    """
    texts = list(dict.fromkeys(re.split("[ T]", c.strip())[0] for c in cells if not is_year_first(c)))
    fitting = _fitting_orders(texts) or _fitting_orders(texts[:1])
    wanted = [user_order] if user_order else [*header_orders, *(fitting if len(fitting) == 1 else ())]
    for order in wanted:
        if order in fitting:
            return order
    raise unclear_date(texts[0], fitting, path, line)


def _fitting_orders(texts: list[str]) -> list[str]:
    return [order for order in ORDERS if all(read_date(text, order) for text in texts)]


def unclear_date(text: str, fitting: Sequence[str], path: Path, line: int) -> UnreadableError:
    """Return the error that asks for the order of a date.

    Args:
        fitting: the orders in which it, and its like, can be read.
    """
    words = " or ".join(fitting)
    fault, hint = f"the date {text!r} can be read as {words}", f"say which with --date-format {words}"
    if len(fitting) == 1:
        fault, hint = f"the date {text!r} can only be read as {words}", f"give --date-format {words}"
    elif not fitting:
        fault, hint = f"{text!r} and the like are not dates", "give --time-column none and --rate"
    return UnreadableError(fault, path=path, line=line, hint=hint)


def filled(column: Any, kind: type[np.generic], null: float) -> NDArray[Any]:
    """Return a chunked column of numbers of eight bytes, (n,), with `null` where a cell is empty."""
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


@dataclass(frozen=True, slots=True)
class TimeFormat:
    """How the cells of the time column are written.

    Attributes:
        unit_us: microseconds in one unit of a plain number; None for ISO 8601.
        zoned: every ISO time ends in Z or an offset, so that the times are UTC.
        since_1970: False if the numbers count from the start of the recording.
        epoch_day: the number of 1970-01-01 where days are counted from another date.
        has_offsets: the ISO times end in an offset such as +01:00, not in Z.
        dated: the numbers count from a start that is a local time.
    """

    unit_us: float | None
    zoned: bool = False
    since_1970: bool = True
    epoch_day: float = 0.0
    has_offsets: bool = False
    dated: bool = False

    @property
    def is_utc(self) -> bool:
        """True if its times are moments: ISO times with a zone, or a count of seconds since 1970.

        Days are what spreadsheets count, and those show a clock.
        """
        moments = self.unit_us is not None and self.since_1970 and self.unit_us != DAY_US
        return self.zoned or (moments and not self.dated)

    def counted_from(self, start_us: int) -> TimeFormat:
        """Return the format of numbers that count from the start of the recording, with that start known."""
        if self.unit_us is None or self.since_1970:
            return self
        return replace(self, since_1970=True, epoch_day=-start_us / self.unit_us, dated=True)

    @property
    def arrow_type(self) -> Any:
        """The type that pyarrow gives the column."""
        if self.unit_us is not None:
            return pa.float64()
        return pa.timestamp("ns", tz="UTC" if self.zoned else None)

    def microseconds(self, column: Any) -> NDArray[np.int64]:
        """Return a column (n,) of that type as times (n,) [us], NO_TIME where the cell is empty.

        IMPOSSIBLE stands where a number lies outside the years that calendars know.
        """
        if self.unit_us is None:
            whole = filled(column.cast(pa.int64()), np.int64, EMPTY_NS)
            return np.where(whole == EMPTY_NS, NO_TIME, (whole + 500) // 1000)
        with np.errstate(over="ignore"):
            values = np.rint((floats(column) - self.epoch_day) * self.unit_us)
        usable = (values >= FIRST_US) & (values <= LAST_US)
        other = np.where(np.isnan(values), NO_TIME, IMPOSSIBLE)
        return np.where(usable, np.where(usable, values, 0).astype(np.int64), other)

    def possible(self, cells: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Return texts (n,) as times of that type, and flags (n,) of those that are not times and are left
        empty.

        Texts that cannot be read are halved until single cells are left: such times are few.
        """
        try:
            return cells.cast(self.arrow_type), np.zeros(len(cells), np.bool_)
        except pa.ArrowException:
            if len(cells) == 1:
                return pa.nulls(1, self.arrow_type), np.ones(1, np.bool_)
        half = len(cells) // 2
        times, wrong = zip(self.possible(cells[:half]), self.possible(cells[half:]), strict=True)
        return pa.concat_arrays(times), np.concatenate(wrong)

    def is_written_right(self, cell: str) -> bool:
        """Return True if a cell has the form of these ISO times; the time need not exist."""
        stamp = STAMP.fullmatch(cell)
        return stamp is not None and bool(stamp["zone"]) == self.zoned


@dataclass(frozen=True, slots=True)
class DateColumn:
    """Dates in a column of their own.

    Attributes:
        column: its number.
        order: of day, month and year, such as `dmy`, where they do not begin with the year.
    """

    column: int
    order: str | None = None

    def moment(self, day: str, time: str) -> str:
        """Return the time that two cells give together, as ISO 8601; what is not a date stays as it is."""
        order = "ymd" if YEAR.match(day.strip()) else self.order
        found = read_date(day, order) if order else None
        return f"{day.strip() if found is None else found.isoformat()}T{time.strip()}"

    def moments(self, days: Any, times: Any) -> Any:
        """Join two chunked columns of texts, empty where one of them is; dates are few."""
        import pyarrow.compute as pc  # takes a tenth of a second, and most files have one column

        parts = []
        for day, time in zip(days.chunks, times.chunks, strict=True):
            written = [None if text is None else self.moment(text, "") for text in day.dictionary.to_pylist()]
            dates = pa.array(written, pa.string()).take(day.indices)
            parts.append(pc.binary_join_element_wise(dates, pc.utf8_trim_whitespace(time), ""))
        return pa.chunked_array(parts, pa.string())


def find_time_format(
    cells: Sequence[tuple[str, int]], unit_us: float | None, rate_hz: float | None, path: Path
) -> TimeFormat:
    """Find out how the first cells of the time column are written.

    Args:
        cells: at least one, with their lines.
        unit_us: what the name of the column says.

    Raises:
        UnreadableError: they can be read in more than one way, or are not times.
    """
    written = [(text, line) for cell, line in cells if (text := cell.strip()) not in MISSING]
    numbers = [value for text, _ in written if (value := number_of(text)) is not None]
    if numbers and len(numbers) == len(written):
        return _number_format(numbers, unit_us, rate_hz, path)
    zones: list[str | None] = []
    for text, line in written or [("", cells[0][1])]:
        stamp = STAMP.fullmatch(text)
        if stamp is None:
            raise UnreadableError(
                f"the time {text!r} is not written as 2024-03-04 12:34:56.789",
                path=path,
                line=line,
                hint="rewrite the times that way, or the date in a column of its own, or give "
                "--time-column none and --rate",
            )
        zones.append(stamp["zone"])
    zoned = [zone is not None for zone in zones]
    if len(set(zoned)) == 2:
        raise UnreadableError(
            "some times have a zone and some do not",
            path=path,
            line=written[zoned.index(min((False, True), key=zoned.count))][1],
            hint="write all of them with Z or an offset, or none",
        )
    return TimeFormat(None, zoned=zoned[0], has_offsets=not {*zones} <= {None, "Z"})


def _number_format(
    values: Sequence[float], unit_us: float | None, rate_hz: float | None, path: Path
) -> TimeFormat:
    step, middle = _usual_step(values), sorted(values)[len(values) // 2]
    since = _units_since_1970(UNITS_US if unit_us is None else (unit_us,), step, middle)
    fitting = _fitting_units(step, rate_hz)
    sure = [unit for unit in since if unit in fitting]
    if sure or (since and not fitting):
        return TimeFormat((sure or since)[0])
    if unit_us is not None:
        return TimeFormat(unit_us, since_1970=bool(since))
    if fitting == [DAY_US] and (epoch_day := _epoch_day(middle)):
        return TimeFormat(DAY_US, epoch_day=epoch_day)
    if len(fitting) == 1 and (rate_hz or not since):
        return TimeFormat(fitting[0], since_1970=False)
    known = f"does not fit {rate_hz:g} Hz" if rate_hz else "may be seconds or milliseconds"
    raise UnreadableError(
        f"the time column rises by {step:g} a row, which {known}",
        path=path,
        hint="give the right --rate, or --time-column none with --rate if it only counts rows",
    )


def _fitting_units(step: float, rate_hz: float | None) -> list[float]:
    """Return the units [us] in which numbers that rise by a step a row fit the rate, or an actigraph's."""
    low, high = (rate_hz / 2, rate_hz * 2) if rate_hz else PLAUSIBLE_HZ
    periods = {unit: step * unit for unit in (*UNITS_US, DAY_US)}
    return [unit for unit, period in periods.items() if period > 0 and low <= 1e6 / period <= high]


def _units_since_1970(units: Sequence[float], step: float, middle: float) -> list[float]:
    """Return the units [us] in which numbers count from 1970 and rise slowly enough."""
    return [unit for unit in units if _is_epoch(middle * unit) and step * unit <= LONGEST_PERIOD_US]


def _epoch_day(middle: float) -> float | None:
    """Return the number of 1970-01-01 by which a number of days is a date of our time, None if none is."""
    return next((day for day in EPOCH_DAYS if _is_epoch((middle - day) * DAY_US)), None)


def _is_epoch(time_us: float) -> bool:
    return EPOCH_S[0] <= time_us / 1e6 <= EPOCH_S[1]


def _usual_step(values: Sequence[float]) -> float:
    """Return the rise a row: the median, or the mean where stamps repeat."""
    steps = sorted(right - left for left, right in pairwise(values))
    if not steps:
        return 0.0
    return steps[len(steps) // 2] or (max(values) - min(values)) / len(steps)
