"""The clock of a table: the form and unit of its times, and where they begin.

`find_clock` decides by the first cells, what is stated and the options; `Clock.times` then makes microseconds
of columns. ISO 8601 with the year first is what Arrow reads fastest; other forms are read by
`formats/_written.py`.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import FIRST_US, LAST_US
from accelcal_cli.core.errors import UnreadableError, UsageError, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.written_times import (
    AMBIGUOUS,
    READ,
    has_buddhist_year,
    is_digits_of_day,
    is_time,
    read_date,
    stated_zone,
    written_start,
)
from accelcal_cli.formats._stamps import (
    DISAGREEMENT,
    EPOCH_DAYS,
    IMPOSSIBLE,
    LOST,
    NO_TIME,
    PLAUSIBLE_HZ,
)
from accelcal_cli.formats._wraps import DATES, TIMES_OF_DAY, Wraps, find_wraps
from accelcal_cli.formats._written import Written, digits_alone, strptime_form, written_form
from accelcal_cli.formats.tables.cells import (
    KIND_SHARE,
    MISSING,
    cell_kind,
    column_kind,
    number_of,
)
from accelcal_cli.formats.tables.dates import date_texts, order_of
from accelcal_cli.formats.tables.header import (
    As,
    Block,
    CellTexts,
    Column,
    First,
    Kind,
    Source,
)
from accelcal_cli.formats.tables.names import microseconds_in
from accelcal_cli.formats.tables.roles import Roles
from accelcal_cli.formats.tables.units import EMPTY, as_floats
from accelcal_cli.formats.tables.values import in_arrow, moments, told

STAMP = re.compile(
    r"(?P<year>\d{4})[-/]\d\d[-/]\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?(?P<zone>Z|[+-]\d\d(:?\d\d)?)?)?"
)
YEAR = re.compile(r"\d{4}\D")
NS_YEARS = frozenset(str(year) for year in range(1678, 2262))
"""Years that nanoseconds in 64 bits reach."""

DATE_DIGITS = re.compile(r"(19|20|25)\d{12}(\d{3})?([.,]\d+)?")
"""20240314104140, with milliseconds or decimals."""

DAY_US = 86_400e6
UNITS_US = (1e6, 1e3, 1.0, 1e-3)
"""Units in which a plain number may count time [us]."""

TICK_US = 100.0
"""A tick of Xsens' clock of 10 kHz [us]."""

UNIT_NAMES = {1e6: "s", 1e3: "ms", TICK_US: "ticks of 0.1 ms", 1.0: "us", 1e-3: "ns", DAY_US: "days"}

VAGUE = " ({} is {}: taken as the device's clock, --timezone gives its zone)"
EPOCH_S = (9e8, 5e9)
"""Plain numbers count from 1970 where they then mean 1998 to 2128."""

LONGEST_PERIOD_US = 60e6
"""A number that counts from 1970 rises by at most this a row."""


Cell = tuple[str, int | None]
"""The text of a cell, and its line in a text file."""


@dataclass(frozen=True, slots=True)
class TimeFormat:
    """How the cells of the time column are written.

    Attributes:
        unit_us: microseconds in one unit of a plain number; None for texts.
        zoned: every ISO time ends in Z or an offset, so that the times are UTC.
        since_1970: False if the numbers count from the start of the recording.
        epoch_day: the number of 1970-01-01 where days are counted from another date.
        has_offsets: the ISO times end in an offset such as +01:00, not in Z.
        base_us: the moment from which numbers count that do not count from 1970; None if it is not known.
        is_local: the times are those of a clock of an unknown zone, or of the zone of `base_us`.
        written: another form than ISO 8601 with the year first.
        zone: of the clock, by the name of the column or of a zone behind the times.
        how: for people: the unit, and how it was found.
    """

    unit_us: float | None
    zoned: bool = False
    since_1970: bool = True
    epoch_day: float = 0.0
    has_offsets: bool = False
    base_us: int | None = None
    is_local: bool = False
    written: Written | None = None
    zone: str | None = None
    how: str = ""

    @property
    def is_utc(self) -> bool:
        """True if its times are moments: ISO times with a zone, or a count of seconds since 1970.

        Days are what spreadsheets count, and those show a clock.
        """
        moments = self.unit_us is not None and self.since_1970 and self.unit_us != DAY_US
        return self.zoned or (moments and not self.is_local)

    @property
    def has_dates(self) -> bool:
        """True if its times have a date: they count from 1970, or from a known moment."""
        return self.since_1970 or self.base_us is not None

    def counted_from(self, start_us: int) -> TimeFormat:
        """Return the format of numbers that count from the start of the recording, with that start known."""
        if self.unit_us is None or self.since_1970:
            return self
        return replace(self, base_us=start_us, is_local=True)

    def of_numbers(self, values: NDArray[Any]) -> NDArray[np.int64]:
        """Return numbers (n,) as times (n,) [us], NO_TIME where one is empty.

        IMPOSSIBLE stands where a number lies outside the years that calendars know.
        """
        assert self.unit_us is not None
        base = self.base_us or 0
        if values.dtype.kind in "iu" and not self.epoch_day and self.unit_us in (1e6, 1e3, 1.0, 1e-3):
            low, high = (int((end - base) / self.unit_us) for end in (FIRST_US, LAST_US))
            empty = values == EMPTY if values.dtype == np.int64 else np.zeros(len(values), np.bool_)
            with np.errstate(over="ignore"):
                usable = (values >= low) & (values <= high) & ~empty
                kept = np.where(usable, values, 0).astype(np.int64)
            ticks = (kept + 500) // 1000 if self.unit_us < 1 else kept * int(self.unit_us)
            return np.where(usable, ticks + base, np.where(empty, NO_TIME, IMPOSSIBLE))
        floats = as_floats(values)
        with np.errstate(over="ignore", invalid="ignore"):
            ticks = np.rint((floats - self.epoch_day) * self.unit_us)
            usable = (ticks >= FIRST_US - base) & (ticks <= LAST_US - base)
        other = np.where(np.isnan(floats), NO_TIME, IMPOSSIBLE)
        return np.where(usable, np.where(usable, ticks, 0).astype(np.int64) + base, other)

    def of_texts(self, cells: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return texts (n,) as times (n,) [us], and the rows of those that are written otherwise."""
        return moments(cells, self.zoned) if self.written is None else self.written.read(cells)


@dataclass(frozen=True, slots=True)
class DateColumn:
    """Dates in a column of their own.

    Attributes:
        number: of the column.
        order: of day, month and year, such as `dmy`, where they do not begin with the year.
    """

    number: int
    order: str | None = None

    def moment(self, day: str, time: str) -> str:
        """Return the time that two cells give together, as ISO 8601; what is not a date stays as it is."""
        found = read_date(day.strip(), None if YEAR.match(day.strip()) else self.order)
        return f"{day.strip() if found is None else found.isoformat()}T{time.strip()}"

    def times(
        self, days: CellTexts, hours: Any, form: TimeFormat
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return texts of dates and of times of day (n,) as times (n,) [us], and the rows of all others.

        They are empty where one of the two is; dates are few.
        """
        import pyarrow as pa
        import pyarrow.compute as pc  # takes a tenth of a second, and most files have one column

        written = [self.moment(text, "") for text in days.texts]
        known = np.where(days.codes < 0, len(written), days.codes)
        dates = pa.array([*written, None], pa.string()).take(in_arrow(known))
        read = form.of_texts(pc.binary_join_element_wise(dates, hours, ""))
        if len(read[1]):
            longer = pc.replace_substring_regex(hours, r"^(\d:)", r"0\1")
            read = form.of_texts(pc.binary_join_element_wise(dates, longer, ""))
        return read


@dataclass(frozen=True, slots=True)
class Clock:
    """The times of a table's rows.

    Attributes:
        column: of the times; date: of the dates, where they stand in another.
    """

    column: Column
    format: TimeFormat
    date: DateColumn | None = None

    @property
    def wanted(self) -> dict[int, As]:
        """How the columns are asked for."""
        if self.date is not None:
            return {self.column.number: As.TEXT, self.date.number: As.CODES}
        if self.format.unit_us is not None:
            return {self.column.number: As.NUMBER}
        iso = As.ZONED_MOMENT if self.format.zoned else As.MOMENT
        return {self.column.number: As.TEXT if self.format.written is not None else iso}

    def times(self, block: Block) -> tuple[NDArray[np.int64], dict[int, str]]:
        """Return the times (n,) [us] of the rows of a block, and what is wrong with rows of other texts.

        NO_TIME stands where a time is missing, IMPOSSIBLE where it does not exist, LOST where it is in a lost
        part of the file.
        """
        times, wrong = self._times(block)
        for damage in block.damage:
            if damage.column in self.wanted:
                times = np.where(damage.lost, LOST, times)
        return times, wrong

    def _times(self, block: Block) -> tuple[NDArray[np.int64], dict[int, str]]:
        """Return what `times` does, with anything in lost rows."""
        values = block.values[self.column.number]
        if self.format.unit_us is not None:
            return self.format.of_numbers(values), {}
        if isinstance(values, np.ndarray):
            return values, {}
        if self.date is None:
            times, wrong = self.format.of_texts(values)
        else:
            times, wrong = self.date.times(block.values[self.date.number], values, self.format)
        number = self.column.number
        return times, told(number, values, wrong, "time")


@dataclass(frozen=True, slots=True)
class TimeRules:
    """The facts known of a column of times before its cells are looked at.

    Attributes:
        asked: -R time_format.
        unit_us: microseconds in one unit, by the name of the column or the vendor.
        ticks: the column counts ticks of an unknown length; fine: it is Xsens' SampleTimeFine.
        rate_hz: sampling rate, as the user or a vendor's header says; hint_hz: as lines above the table do.
        order: of day, month and year in numbers.
        zone: of the clock, by the name of the column.
        decimal_comma: decimals are written with a comma.
        moments: the type of the column says that it counts from 1970; local: on a clock of an unknown zone.
        more: the cells of all first rows.
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
    moments: bool = False
    local: bool = False
    more: Callable[[], list[str]] = list


def find_time_format(cells: Sequence[Cell], rules: TimeRules, path: Path) -> TimeFormat:
    """Find out how the first cells of the time column are written.

    Args:
        cells: at least one, with their lines.

    Raises:
        UnreadableError: they can be read in more than one way, or are not times.
        UsageError: -R time_format is not a pattern of strptime.
    """
    known = [(text, line) for cell, line in cells if (text := cell.strip()) not in MISSING]
    known = known or [("", cells[0][1])]
    kind = column_kind([text for text, _ in known], rules.decimal_comma, KIND_SHARE)
    if kind in (Kind.NUMBER, Kind.TIME):  # what is neither costs its row, not the recording
        known = [cell for cell in known if cell_kind(cell[0], rules.decimal_comma) is kind]
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
        raise UsageError(f"-R time_format={asked!r} is not understood: {error}", hint=hint) from error


def _no_time(known: Sequence[Cell], path: Path) -> UnreadableError:
    """Return the error that names the first text that is not a time, else the first that differs."""
    text, line = next(((text, line) for text, line in known if not is_time(text)), known[0])
    name = shlex.quote(printable(path.name))
    return UnreadableError(
        f"the time {text!r} is not written as {READ}",
        path=path,
        line=line,
        hint="give the form as strptime does: "
        f"accelcal calibrate {name} -R time_format='%d/%m/%Y %H:%M:%S.%f'; "
        "or read without times: -R time_column=none and --rate",
    )


def _refuse_mixed(zoned: Sequence[bool], known: Sequence[Cell], path: Path) -> None:
    if len(set(zoned)) == 2:
        raise UnreadableError(
            "some times have a zone and some do not",
            path=path,
            line=known[zoned.index(min((False, True), key=zoned.count))][1],
            hint="write all of them with Z or an offset, or none",
        )


def _written_format(form: Written, known: Sequence[Cell], rules: TimeRules, path: Path) -> TimeFormat:
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
    if rules.moments and rules.unit_us is not None:
        how = f", in {UNIT_NAMES[rules.unit_us]}" + " since 1970" * (not rules.local)
        return TimeFormat(rules.unit_us, is_local=rules.local, how=how)
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
        hint="give the right --rate, or -R time_column=none with --rate if it only counts rows; "
        f"or say its unit (s, ms, us or ns): accelcal calibrate {name} -R time_format=ms",
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


def find_clock(
    source: Source, first: First, roles: Roles, options: ReadOptions
) -> tuple[Clock | None, Source]:
    """Return the clock of a table, None if it has no times, and the source, which may read dates by itself.

    Args:
        first: the first rows.

    Raises:
        UnreadableError: its times can be read in more than one way, or in no way.
        UsageError: -R time_format is not a pattern of strptime.
    """
    column, about, path = roles.time, source.stated, source.path
    if column is None:
        return None, source
    name = column.name
    if column.unit and name.time_unit_us is None and column.kind is Kind.NUMBER:
        raise UnreadableError(
            f"the unit {column.unit!r} of the times in {column.described} is not known",
            path=path,
            hint="give -R time_format=UNIT (s, ms, us or ns), or ignore them with -R time_column=none",
        )

    def texts(one: Column) -> list[str]:
        return [cell for cell, _ in source.cells(first, one, None)]

    rules = TimeRules(
        asked=options.time_format,
        unit_us=about.time_unit_us or name.time_unit_us,
        ticks=name.ticks,
        fine=name.fine_ticks,
        rate_hz=options.rate_hz or about.rate_hz,
        hint_hz=about.hint_hz,
        zone=name.zone,
        decimal_comma=source.decimal_comma,
        moments=column.is_moment,
        local=column.is_clock,
        more=lambda: texts(column),
    )
    cells = source.cells(first, column)
    if roles.date is not None:
        days = [f"{day.strip()} 00:00" for day in texts(roles.date)]
        date = DateColumn(roles.date.number, order_of(date_texts(days), source, options))
        pairs = zip(source.cells(first, roles.date), cells, strict=True)
        moments_of = [
            (date.moment(day, time) if day.strip() and time.strip() else "", line)
            for (day, _), (time, line) in pairs
        ]
        return Clock(column, find_time_format(moments_of, rules, path), date), source
    if options.time_format is None and date_texts([cell for cell, _ in cells]):
        order = order_of(date_texts(texts(column)), source, options)
        own = None if order is None else source.with_date_order(column, order)
        source, rules = own or source, replace(rules, order=None if own else order)
        cells = source.cells(first, column)
    form = find_time_format(cells, rules, path)
    return Clock(column, _begun(form, column, cells, source)), source


def _begun(form: TimeFormat, column: Column, cells: Sequence[Cell], source: Source) -> TimeFormat:
    """Return the form of times with the moment from which its numbers count, where that is stated."""
    since = written_start(column.unit.partition(" since ")[2].strip()) if " since " in column.unit else None
    if since is not None and since.start_us:
        return replace(
            form, since_1970=False, base_us=since.start_us, is_local=since.timezone != "UTC",
            has_offsets=since.had_offset, zone="UTC" if since.timezone == "UTC" else form.zone,
        )  # fmt: skip
    about = source.stated
    from_zero = about.companion is not None or about.counts_from_zero
    if about.start is None or not (from_zero or about.counts_from_start):
        return form
    first = next((value for cell, _ in cells if (value := number_of(cell)) is not None), 0.0)
    begin_us = round(first * (form.unit_us or 0)) if about.counts_from_start else 0
    return form.counted_from(about.start.us(None, source.path) - begin_us)


def wraps_of(clock: Clock | None, times: NDArray[np.int64] | None) -> Wraps:
    """Return what the clock may do whose first times (n,) [us] these are."""
    if clock is None or times is None:
        return Wraps()
    form = clock.format
    if form.unit_us is None:
        return find_wraps(times, None, DATES if form.since_1970 else TIMES_OF_DAY)
    return find_wraps(times, None if form.since_1970 else form.unit_us)
