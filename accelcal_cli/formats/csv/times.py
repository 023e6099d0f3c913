"""Understands the column of times of a text file: its form, its unit where it counts, the order of dates.

`find_time_format` decides by the first cells, the head and the options; `TimeFormat` then makes times of
columns. ISO 8601 with the year first is what Arrow reads fastest; other forms are read by
`formats/_written.py`.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.clock import FIRST_US, LAST_US
from accelcal_cli.core.errors import UnreadableError, UsageError, printable
from accelcal_cli.core.written_times import (
    AMBIGUOUS,
    COLONS,
    ORDERS,
    READ,
    around_time,
    has_buddhist_year,
    is_digits_of_day,
    is_time,
    needs_order,
    read_date,
    stated_zone,
    undated,
)
from accelcal_cli.formats._stamps import DISAGREEMENT, EPOCH_DAYS, IMPOSSIBLE, NO_TIME, PLAUSIBLE_HZ
from accelcal_cli.formats._written import Written, digits_alone, strptime_form, written_form
from accelcal_cli.formats.csv.cells import (
    MISSING,
    filled,
    floats,
    is_year_first,
    microseconds_in,
    number_of,
)

STAMP = re.compile(
    r"(?P<year>\d{4})[-/]\d\d[-/]\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?(?P<zone>Z|[+-]\d\d(:?\d\d)?)?)?"
)
YEAR = re.compile(r"\d{4}\D")
NS_YEARS = frozenset(str(year) for year in range(1678, 2262))
"""Years that nanoseconds in 64 bits reach."""

FARTHEST_NS_US = 9_223_372_036_854_775
DATE_DIGITS = re.compile(r"(19|20|25)\d{12}(\d{3})?([.,]\d+)?")
"""20240314104140, with milliseconds or decimals."""

EMPTY_NS = -(1 << 63)
"""Stands for an empty cell among Arrow's times."""

DAY_US = 86_400e6
UNITS_US = (1e6, 1e3, 1.0, 1e-3)
"""Units in which a plain number may count time [us]."""

FASTEST_HZ = 100_000.0
RATE = re.compile(
    r"(?:sampl\w{0,5}|update|output|data|logging|acc\w{0,12}|measurement)[ _-]*(?:rate|freq\w{0,8})"
    r"\W*(?:\(?Hz\)?\W*)?(\d{1,6}(?:[.,]\d{1,6})?)(?!\d|[.,]\d|:)\s*(?!k?s\b|kHz|MHz|%|min)",
    re.IGNORECASE,
)
"""A sampling rate among the lines above a table."""

TICK_US = 100.0
"""A tick of Xsens' clock of 10 kHz [us]."""

UNIT_NAMES = {1e6: "s", 1e3: "ms", TICK_US: "ticks of 0.1 ms", 1.0: "us", 1e-3: "ns", DAY_US: "days"}

VAGUE = " ({} is {}: taken as the device's clock, --timezone gives its zone)"
EPOCH_S = (9e8, 5e9)
"""Plain numbers count from 1970 where they then mean 1998 to 2128."""

LONGEST_PERIOD_US = 60e6
"""A number that counts from 1970 rises by at most this a row."""


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
    texts: Sequence[str], user_order: str | None, header_orders: Iterable[str], path: Path, line: int
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
        written: another form than ISO 8601 with the year first.
        zone: of the clock, by the name of the column or of a zone behind the times.
        how: for people: the unit, and how it was found.
    """

    unit_us: float | None
    zoned: bool = False
    since_1970: bool = True
    epoch_day: float = 0.0
    has_offsets: bool = False
    dated: bool = False
    written: Written | None = None
    zone: str | None = None
    how: str = ""

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
        if self.written is not None:
            return pa.string()
        return pa.timestamp("ns", tz="UTC" if self.zoned else None)

    def microseconds(self, column: Any) -> NDArray[np.int64]:
        """Return a column (n,) of that type, or of times [us], as times (n,) [us], NO_TIME where it is empty.

        IMPOSSIBLE stands where a number lies outside the years that calendars know.
        """
        if self.written is not None:
            return filled(column, np.int64, NO_TIME)
        if self.unit_us is None:
            whole = filled(column, np.int64, EMPTY_NS)
            return np.where(whole == EMPTY_NS, NO_TIME, (whole + 500) // 1000)
        with np.errstate(over="ignore"):
            values = np.rint((floats(column) - self.epoch_day) * self.unit_us)
        usable = (values >= FIRST_US) & (values <= LAST_US)
        other = np.where(np.isnan(values), NO_TIME, IMPOSSIBLE)
        return np.where(usable, np.where(usable, values, 0).astype(np.int64), other)

    def possible(self, cells: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Return texts (n,) as times of that type, and flags (n,) of those that are not times, left empty.

        Texts that cannot be read are halved until single cells are left: such times are few.
        """
        try:
            return cells.cast(self.arrow_type), np.zeros(len(cells), np.bool_)
        except pa.ArrowException:
            if len(cells) == 1:
                return self._second_60(cells)
        half = len(cells) // 2
        times, wrong = zip(self.possible(cells[:half]), self.possible(cells[half:]), strict=True)
        return pa.concat_arrays(times), np.concatenate(wrong)

    def _second_60(self, cell: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Return `possible` of one cell: a leap second, or a rounded 60, is the next minute."""
        right = ":60" in (text := cell[0].as_py()) and self.is_written_right(text)
        time_us = int(Written(COLONS, offsets=self.zoned).times(cell)[0]) if right else IMPOSSIBLE
        if abs(time_us) > FARTHEST_NS_US:
            return pa.nulls(1, self.arrow_type), np.ones(1, np.bool_)
        return pa.array([1000 * time_us]).cast(self.arrow_type), np.zeros(1, np.bool_)

    def is_written_right(self, cell: str) -> bool:
        """Return True if a cell has the form of these ISO times; the time need not exist."""
        if self.written is not None:
            found = self.written.cell(cell)
            return found is not None and self.written.fits(found)
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
        found = read_date(day.strip(), None if YEAR.match(day.strip()) else self.order)
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


def rate_above(text: str) -> float | None:
    """Return the rate [Hz] in lines above a table, such as `Sample rate: 100 Hz`; None without one."""
    rates = {float(rate.replace(",", ".")) for rate in RATE.findall(text)}
    return rates.pop() if len(rates) == 1 and 0 < min(rates) <= FASTEST_HZ else None


@dataclass(frozen=True, slots=True)
class TimeRules:
    """The facts known of a column of times before its cells are looked at.

    Attributes:
        asked: --time-format.
        unit_us: microseconds in one unit, by the name of the column or the vendor.
        ticks: the column counts ticks of an unknown length; fine: it is Xsens' SampleTimeFine.
        rate_hz: sampling rate, as the user or a vendor's header says; hint_hz: as lines above the table do.
        order: of day, month and year in numbers.
        zone: of the clock, by the name of the column.
        decimal_comma: decimals are written with a comma.
        more: the cells of the first megabyte.
    """

    asked: str | None = None
    unit_us: float | None = None
    ticks: bool = False
    fine: bool = False
    rate_hz: float | None = None
    hint_hz: float | None = None
    order: str | None = None
    zone: str | None = None
    decimal_comma: bool = False
    more: Callable[[], list[str]] = list


def find_time_format(cells: Sequence[tuple[str, int]], rules: TimeRules, path: Path) -> TimeFormat:
    """Find out how the first cells of the time column are written.

    Args:
        cells: at least one, with their lines.

    Raises:
        UnreadableError: they can be read in more than one way, or are not times.
        UsageError: --time-format is not a pattern of strptime.
    """
    known = [(text, line) for cell, line in cells if (text := cell.strip()) not in MISSING]
    known = known or [("", cells[0][1])]
    texts = [text for text, _ in known]
    asked_us = microseconds_in(rules.asked or "")
    if rules.asked is not None and asked_us is None:
        return _written_format(_asked_form(rules.asked), known, rules, path)
    numbers = [value for text in texts if (value := number_of(text)) is not None]
    if len(numbers) == len(texts):
        if asked_us is None and (form := _form_of_digits(texts, rules)) is not None:
            return _written_format(form, known, rules, path)
        return _number_format(numbers, rules if asked_us is None else replace(rules, unit_us=asked_us), path)
    commas = [text.replace(",", ".") for text in texts] if rules.decimal_comma else texts
    stamps = [STAMP.fullmatch(text) for text in commas]
    near = [stamp is not None and stamp["year"] in NS_YEARS for stamp in stamps]
    if None not in stamps and 2 * sum(near) >= len(near):
        zones = [stamp["zone"] for stamp in stamps if stamp is not None]
        _refuse_mixed([zone is not None for zone in zones], known, path)
        offsets = not {*zones} <= {None, "Z"}
        return TimeFormat(None, zoned=zones[0] is not None, has_offsets=offsets, zone=rules.zone)
    form = written_form(texts, rules.order)
    if form is None:
        raise _no_time(known, path)
    return _written_format(form, known, rules, path)


def _asked_form(asked: str) -> Written:
    try:
        return strptime_form(asked)
    except ValueError as error:
        hint = "write it as strptime does, such as '%d/%m/%Y %H:%M:%S.%f'; for numbers s, ms, us or ns"
        raise UsageError(f"--time-format {asked!r} is not understood: {error}", hint=hint) from error


def _no_time(known: Sequence[tuple[str, int]], path: Path) -> UnreadableError:
    """Return the error that names the first text that is not a time, else the first that differs."""
    text, line = next(((text, line) for text, line in known if not is_time(text)), known[0])
    name = shlex.quote(printable(path.name))
    return UnreadableError(
        f"the time {text!r} is not written as {READ}",
        path=path,
        line=line,
        hint="give the form as strptime does: "
        f"accelcal calibrate {name} --time-format '%d/%m/%Y %H:%M:%S.%f'; "
        "or read without times: --time-column none and --rate",
    )


def _refuse_mixed(zoned: Sequence[bool], known: Sequence[tuple[str, int]], path: Path) -> None:
    if len(set(zoned)) == 2:
        raise UnreadableError(
            "some times have a zone and some do not",
            path=path,
            line=known[zoned.index(min((False, True), key=zoned.count))][1],
            hint="write all of them with Z or an offset, or none",
        )


def _written_format(
    form: Written, known: Sequence[tuple[str, int]], rules: TimeRules, path: Path
) -> TimeFormat:
    """Return the format of cells of a form, whose dates and zones must be of one kind."""
    around = [form.cell(text) for text, _ in known]
    if None in around:
        raise _no_time(known[around.index(None) :], path)
    found = [one for one in around if one is not None]
    vague = next((one.vague for one in found if one.vague), None)
    zoned = [one.offset_s is not None for one in found]
    if vague is None:
        _refuse_mixed(zoned, known, path)
    offsets = vague is None and zoned[0]
    dated = [one.dated for one in found]
    if len(set(dated)) == 2:
        raise _no_time(known[dated.index(min((False, True), key=dated.count)) :], path)
    place = found[0].place if found[0].place and stated_zone(found[0].place) else None
    how = [] if vague is None else [VAGUE.format(vague, AMBIGUOUS[vague])]
    how += [f" (written in {place}, read by the offsets)"] * bool(place and offsets)
    how += [" (times of day without a date)"] * (not dated[0])
    how += [" (years of the Buddhist calendar)"] * any(map(has_buddhist_year, (text for text, _ in known)))
    return TimeFormat(
        None,
        zoned=offsets,
        since_1970=dated[0],
        has_offsets=offsets and any(one.offset_s for one in found),
        written=replace(form, offsets=offsets, vague=vague is not None),
        zone=None if offsets else rules.zone or place,
        how="".join(how),
    )


def _form_of_digits(texts: Sequence[str], rules: TimeRules) -> Written | None:
    """Return the form of digits that are a date and a time of day, or the latter alone; None for counts.

    Digits such as 104140.000 are a time of day if a minute ends: seconds of 60 to 99 never occur, and one
    after 59 is a step of 40.
    """
    if all(map(DATE_DIGITS.fullmatch, texts)) and (form := written_form(texts)) is not None:
        return form if all(found and found.day for found in map(form.cell, texts)) else None
    if rules.unit_us is not None or not all(map(is_digits_of_day, texts)):
        return None
    digits = [text for cell in rules.more() if (text := cell.strip()) not in MISSING]
    if not all(map(is_digits_of_day, digits)):
        return None
    seconds = [float(text.replace(",", ".")) for text in digits]
    ends = any(40 <= after - before < 100 for before, after in pairwise(seconds))
    return digits_alone() if ends or any(text.startswith("0") for text in digits) else None


def _number_format(values: Sequence[float], rules: TimeRules, path: Path) -> TimeFormat:
    step, middle = _usual_step(values), sorted(values)[len(values) // 2]
    hinted = replace(rules, rate_hz=rules.rate_hz or rules.hint_hz)
    rules = hinted if _fitting_units(step, hinted) else rules
    unit_us, rate_hz = rules.unit_us, rules.rate_hz
    since = _units_since_1970(UNITS_US if unit_us is None else (unit_us,), step, middle)
    fitting = _fitting_units(step, rules)
    sure = [unit for unit in since if unit in fitting]
    if sure or (since and not fitting):
        unit = (sure or since)[0]
        return TimeFormat(unit, how=f", in {UNIT_NAMES[unit]} since 1970")
    if unit_us is not None:
        return TimeFormat(unit_us, since_1970=bool(since), how=f", in {UNIT_NAMES[unit_us]}")
    if fitting == [DAY_US] and (epoch_day := _epoch_day(middle)):
        return TimeFormat(DAY_US, epoch_day=epoch_day, zone=rules.zone, how=", in days")
    if len(fitting) == 1 and (rate_hz or not since):
        by = "the stated rate" if rate_hz else "the ticks of Xsens" if rules.fine else "the rate"
        return TimeFormat(fitting[0], since_1970=False, how=f", in {UNIT_NAMES[fitting[0]]} (judged by {by})")
    name = shlex.quote(printable(path.name))
    known = f"does not fit {rate_hz:g} Hz" if rate_hz else "may be seconds or milliseconds"
    raise UnreadableError(
        f"the time column rises by {step:g} a row, which {known}",
        path=path,
        hint="give the right --rate, or --time-column none with --rate if it only counts rows; "
        f"or say its unit (s, ms, us or ns): accelcal calibrate {name} --time-format ms",
    )


def _fitting_units(step: float, rules: TimeRules) -> list[float]:
    """Return the units [us] in which numbers that rise by a step a row fit the rate, or an actigraph's.

    A counter of ticks fits none without a rate; Xsens' counts 0.1 ms (MT Manager) or us (Movella DOT).
    """
    rate_hz = rules.rate_hz
    low, high = (rate_hz / 2, rate_hz * 2) if rate_hz else PLAUSIBLE_HZ
    exact = rate_hz is not None and 1 / DISAGREEMENT < step * TICK_US * rate_hz / 1e6 < DISAGREEMENT
    units: tuple[float, ...] = (*UNITS_US, TICK_US, DAY_US) if exact else (*UNITS_US, DAY_US)
    units = (TICK_US, 1.0) if rules.fine else () if rules.ticks and not rate_hz else units
    periods = {unit: step * unit for unit in units}
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
