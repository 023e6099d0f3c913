"""Times of a text file: how they are written, in which order their dates are, and the sampling rate they
imply.

Times are whole microseconds since 1970. Arrow's own ways to numpy load pandas, which takes a third of a
second; `filled` and `floats` do without.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.clock import FIRST_US, LAST_US, MICROSECONDS
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.formats._stamps import (
    GAP_PERIODS,
    IMPOSSIBLE,
    NO_TIME,
    Pace,
    jittered_step,
    nice_rate,
    only_stamp_period,
    shared_pace,
    shares_stamps,
)
from accelcal_cli.formats.csv.cells import MISSING, number_of

EMPTY_NS = -(1 << 63)
"""Stands for an empty cell among Arrow's times."""

STAMP = re.compile(r"\d{4}[-/]\d\d[-/]\d\d([T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(?P<zone>Z|[+-]\d\d(:?\d\d)?)?)?")
ORDERS = ("dmy", "mdy", "ymd")
YEAR = re.compile(r"\d{4}\D")
CENTURY = 2000
"""Added to years of two digits."""

DATE_BYTES = re.compile(rb"(?<!\d)(\d{1,4})([-/.])(\d{1,2})\2(\d{1,4})([ T])(\d(?=:))?")
ISO = re.compile(r"\d{4}[-/]\d\d[-/]\d\d(?!\d)")
DAY_US = 86_400e6
UNITS_US = (1e6, 1e3, 1.0, 1e-3)
EPOCH_DAYS = (25_569.0, 719_529.0)
"""1970-01-01 as spreadsheets (from 1899-12-30) and as MATLAB number days."""

EPOCH_S = (9e8, 5e9)
"""Plain numbers count from 1970 where they then mean 1998 to 2128."""

LONGEST_PERIOD_US = 60e6
PLAUSIBLE_HZ = (5.0, 800.0)
"""Wide enough for every actigraph; narrow enough that only one unit of time fits."""


def filled(column: Any, kind: type[np.generic], null: float) -> NDArray[Any]:
    """A chunked column of numbers of eight bytes, (n,), with `null` where a cell is empty."""
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
    """A chunked column of doubles, nulls as NaN, (n,)."""
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
        """Whether its times are moments: ISO times with a zone, or a count of seconds since 1970.

        Days are what spreadsheets count, and those show a clock.
        """
        moments = self.unit_us is not None and self.since_1970 and self.unit_us != DAY_US
        return self.zoned or (moments and not self.dated)

    def counted_from(self, start_us: int) -> TimeFormat:
        """The same of numbers that count from the start of the recording, where that is known."""
        if self.unit_us is None or self.since_1970:
            return self
        return replace(self, since_1970=True, epoch_day=-start_us / self.unit_us, dated=True)

    @property
    def arrow_type(self) -> Any:
        """The type that pyarrow is to give the column."""
        if self.unit_us is not None:
            return pa.float64()
        return pa.timestamp("ns", tz="UTC" if self.zoned else None)

    def microseconds(self, column: Any) -> NDArray[np.int64]:
        """A column (n,) of that type as times (n,) [us], NO_TIME where the cell is empty.

        IMPOSSIBLE where a number lies outside the years that calendars know.
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
        """Texts (n,) as ISO times of that type, empty where there is no such time, and where that is, (n,).

        Halves what cannot be read until single cells are left: such times are few.
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
        """Whether a cell has the form of these ISO times, with a zone or without; the time may not exist."""
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
        """The time that two cells give together, as ISO 8601; what is no date stays as it is."""
        order = "ymd" if YEAR.match(day.strip()) else self.order
        found = read_date(day, order) if order else None
        return f"{day.strip() if found is None else found.isoformat()}T{time.strip()}"

    def moments(self, days: Any, times: Any) -> Any:
        """Two chunked columns of texts as one, empty where one of them is; dates are few."""
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
    """How the first cells of the time column are written; `unit_us` is what its name says.

    Args:
        cells: at least one, with their lines.

    Raises:
        UnreadableError: they can be read in more than one way, or are no times.
    """
    filled = [(text, line) for cell, line in cells if (text := cell.strip()) not in MISSING]
    numbers = [value for cell, _ in filled if (value := number_of(cell)) is not None]
    if numbers and len(numbers) == len(filled):
        return _number_format(numbers, unit_us, rate_hz, path)
    stamps = [(STAMP.fullmatch(cell), cell, line) for cell, line in filled]
    zones = [bool(stamp["zone"]) for stamp, _, _ in stamps if stamp]
    if not zones or len(zones) < len(stamps):
        wrong, line = next(((cell, line) for stamp, cell, line in stamps if stamp is None), ("", cells[0][1]))
        raise UnreadableError(
            f"the time {wrong!r} is not written as 2024-03-04 12:34:56.789",
            path=path,
            line=line,
            hint="rewrite the times that way, or the date in a column of its own, or give "
            "--time-column none and --rate",
        )
    if len(set(zones)) == 2:
        raise UnreadableError(
            "some times have a zone and some do not",
            path=path,
            line=filled[zones.index(min(set(zones), key=zones.count))][1],
            hint="write all of them with Z or an offset, or none",
        )
    offsets = any(stamp and stamp["zone"] not in (None, "Z") for stamp, _, _ in stamps)
    return TimeFormat(None, zoned=zones[0], has_offsets=offsets)


def _number_format(
    values: Sequence[float], unit_us: float | None, rate_hz: float | None, path: Path
) -> TimeFormat:
    step = _usual_step(values)
    middle = sorted(values)[len(values) // 2]
    units = UNITS_US if unit_us is None else (unit_us,)
    since = [unit for unit in units if _is_epoch(middle * unit) and step * unit <= LONGEST_PERIOD_US]
    fitting = [unit for unit in (*UNITS_US, DAY_US) if _fits(step * unit, rate_hz)]
    sure = [unit for unit in since if unit in fitting]
    if sure or (since and not fitting):
        return TimeFormat((sure or since)[0])
    if unit_us is not None:
        return TimeFormat(unit_us, since_1970=bool(since))
    for epoch_day in EPOCH_DAYS:
        if fitting == [DAY_US] and _is_epoch((middle - epoch_day) * DAY_US):
            return TimeFormat(DAY_US, epoch_day=epoch_day)
    if len(fitting) == 1 and (rate_hz or not since):
        return TimeFormat(fitting[0], since_1970=False)
    known = f"does not fit {rate_hz:g} Hz" if rate_hz else "may be seconds or milliseconds"
    raise UnreadableError(
        f"the time column rises by {step:g} a row, which {known}",
        path=path,
        hint="give the right --rate, or --time-column none with --rate if it only counts rows",
    )


def _is_epoch(time_us: float) -> bool:
    """Whether microseconds since 1970 mean a date in the life of actigraphs."""
    return EPOCH_S[0] <= time_us / 1e6 <= EPOCH_S[1]


def _usual_step(values: Sequence[float]) -> float:
    """The rise a row: the median, or the mean where stamps repeat."""
    steps = sorted(right - left for left, right in pairwise(values))
    if not steps:
        return 0.0
    return steps[len(steps) // 2] or (max(values) - min(values)) / len(steps)


def _fits(period_us: float, rate_hz: float | None) -> bool:
    low, high = (rate_hz / 2, rate_hz * 2) if rate_hz else PLAUSIBLE_HZ
    return period_us > 0 and low <= 1e6 / period_us <= high


def find_pace(stamps: NDArray[np.int64], user_hz: float | None, path: Path) -> Pace:
    """The pace of the first rows, whose times are `stamps` (n,) [us].

    Raises:
        UnreadableError: too few rows or times that do not move, without a rate from the user;
            or a rate from the user that contradicts the times.
    """
    pace = shared_pace(stamps) if shares_stamps(stamps) else _single(stamps)
    if pace is None and user_hz is None:
        raise UnreadableError(
            "the sampling rate cannot be found from the times of its rows",
            path=path,
            hint="give it with --rate",
        )
    if pace is None or user_hz is None:
        return pace or Pace(float(user_hz or 0), only_stamp_period(stamps))
    if not pace.agrees(user_hz):
        raise UnreadableError(
            f"its times say {pace.rate_hz:g} Hz, not {user_hz:g} Hz",
            path=path,
            hint="omit --rate, or ignore the times with --time-column none",
        )
    return Pace(user_hz, pace.stamp_period_us)


def agreeing_pace(stamps: NDArray[np.int64], header_hz: float, path: Path) -> Pace:
    """The pace of the first rows of a file whose header states its rate.

    Raises:
        UnreadableError: the rows are not made at that rate.
    """
    try:
        pace = find_pace(stamps, None, path)
    except UnreadableError:
        return find_pace(stamps, header_hz, path)
    if not pace.agrees(header_hz):
        raise UnreadableError(
            f"its header says {header_hz:g} Hz, the times of its rows say {pace.rate_hz:g} Hz",
            path=path,
            hint=f"export the raw data; or give --rate {pace.rate_hz:g} if the rows are right",
        )
    return Pace(header_hz, pace.stamp_period_us)


def _single(stamps: NDArray[np.int64]) -> Pace | None:
    """Every row its own stamp: the mean of the steps that are not gaps, unless stamps jitter."""
    jittered = jittered_step(stamps)
    if jittered is not None:
        return Pace(nice_rate(MICROSECONDS / jittered))
    steps = np.diff(stamps)
    steps = steps[steps >= 0]
    usual = steps[steps <= GAP_PERIODS * max(float(np.median(steps)), 1.0)] if len(steps) else steps
    if len(usual) == 0 or usual.sum() == 0:
        return None
    return Pace(nice_rate(len(usual) * MICROSECONDS / float(usual.sum())))


def year_first(block: bytes, order: str, thorough: bool) -> bytes:
    """Lines with their dates as 2024-03-04; a block holds few different dates.

    Args:
        order: of day, month and year, such as `dmy`.
        thorough: look at every line, not only at the first and the last, whose dates nearly always
            are all there are.
    """
    if thorough:
        return DATE_BYTES.sub(lambda found: _iso(found, order), block)
    end = block.find(b"\n") + 1 or len(block)
    begin = block.rstrip(b"\r\n").rfind(b"\n") + 1
    ends = [found for line in (block[:end], block[begin:]) if (found := DATE_BYTES.search(line))]
    for old, new in {found[0]: _iso(found, order) for found in ends}.items():
        block = block.replace(old, new)
    return block


def year_first_cell(cell: str, order: str) -> str:
    """One cell, likewise."""
    return year_first(cell.encode(), order, True).decode()


def read_date(text: str, order: str) -> date | None:
    """The date at the beginning of a text; None if it is not one in this order."""
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


def find_order(
    cells: Iterable[str], user_order: str | None, header_orders: Iterable[str], path: Path, line: int
) -> str:
    """The order of day, month and year in the cells of a time column that do not begin with the year.

    Args:
        cells: as they are written; what is no date is left for others to judge.
        user_order: what the user chose.
        header_orders: what a vendor's header suggests, best first.

    Raises:
        UnreadableError: several orders fit, or none, or not the one that the user chose.
    """
    texts = list(dict.fromkeys(re.split("[ T]", c.strip())[0] for c in cells if not is_year_first(c)))
    fitting = _fitting(texts) or _fitting(texts[:1])
    wanted = [user_order] if user_order else [*header_orders, *(fitting if len(fitting) == 1 else ())]
    for order in wanted:
        if order in fitting:
            return order
    raise unclear_date(texts[0], fitting, path, line)


def _fitting(texts: list[str]) -> list[str]:
    return [order for order in ORDERS if all(read_date(text, order) for text in texts)]


def is_year_first(cell: str) -> bool:
    """Whether a cell needs no other order: it begins with the year, or is no date."""
    cell = cell.strip()
    return ISO.match(cell) is not None or DATE_BYTES.match(cell.encode()) is None


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
        fault, hint = f"{text!r} and the like are not dates", "give --time-column none and --rate"
    return UnreadableError(fault, path=path, line=line, hint=hint)


def _iso(found: re.Match[bytes], order: str) -> bytes:
    """A match with the year first, hour of two digits; as it is where it is no date."""
    day = read_date(found[0].decode(), order)
    hour = b"" if found[6] is None else b"0" + found[6]
    return found[0] if day is None else day.isoformat().encode() + found[5] + hour
