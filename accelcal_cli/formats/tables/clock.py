"""The clock of a table: the form and unit of its times, and where they begin.

`find_clock` decides by the first cells, what is stated and the options; `TableClock.times` then makes
microseconds of columns. Arrow itself reads ISO 8601 with the year first; other forms are read by `cells.py`.
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

from accelcal_cli.core.clock import FIRST_US, LAST_US, MICROSECONDS, iso_time
from accelcal_cli.core.errors import UnreadableError, UsageError, printable
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.unpacking import LONGEST_BEGIN, packing_of
from accelcal_cli.core.written_times import (
    AMBIGUOUS,
    READ,
    Surroundings,
    has_buddhist_year,
    is_digits_of_day,
    is_time,
    read_date,
    stated_zone,
    written_start,
)
from accelcal_cli.formats._stamps import (
    DATES,
    DISAGREEMENT,
    EPOCH_DAYS,
    GAP_PERIODS,
    IMPOSSIBLE,
    JITTER_ERROR,
    LOST,
    NO_TIME,
    PLAUSIBLE_HZ,
    TIMES_OF_DAY,
    Pace,
    Wraps,
    find_wraps,
    jittered_step,
    nice_rate,
    only_stamp_period,
    shared_pace,
    shares_stamps,
    stamp_error,
)
from accelcal_cli.formats.tables.cells import (
    KIND_SHARE,
    MISSING,
    Written,
    cell_kind,
    column_kind,
    date_texts,
    digits_alone,
    number_of,
    order_of,
    present,
    strptime_form,
    unpadded_digits,
    written_form,
)
from accelcal_cli.formats.tables.header import As, Block, CellTexts, Column, First, Kind, Source
from accelcal_cli.formats.tables.names import Name, microseconds_in
from accelcal_cli.formats.tables.roles import Roles
from accelcal_cli.formats.tables.units import EMPTY, as_floats
from accelcal_cli.formats.tables.values import in_arrow, moments, told

STAMP = re.compile(
    r"(?P<year>\d{4})[-/]\d\d[-/]\d\d([T ]\d\d:\d\d(:\d\d(\.\d{1,9})?)?(?P<zone>Z|[+-]\d\d(:?\d\d)?)?)?"
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

    def cells(self, days: Sequence[Cell], times: Sequence[Cell]) -> list[Cell]:
        """Return cells of dates and of times of day as cells of both, empty where one of the two is."""
        pairs = zip(days, times, strict=True)
        return [
            (self.moment(day, time) if day.strip() and time.strip() else "", line)
            for (day, _), (time, line) in pairs
        ]

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
class TableClock:
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
        values, wrong = block.values[self.column.number], dict[int, str]()
        if self.format.unit_us is not None:
            times = self.format.of_numbers(values)
        elif isinstance(values, np.ndarray):
            times = values
        else:
            if self.date is None:
                times, rows = self.format.of_texts(values)
            else:
                times, rows = self.date.times(block.values[self.date.number], values, self.format)
            wrong = told(self.column.number, values, rows, "time")
        for column, lost in block.damage.items():
            if column in self.wanted:
                times = np.where(lost, LOST, times)
        return times, wrong


def find_time_format(
    cells: Sequence[Cell],
    column: Column,
    source: Source,
    options: ReadOptions,
    order: str | None,
    first: First,
) -> TimeFormat:
    """Find out how the first cells of the time column are written.

    Args:
        cells: at least one, with their lines.
        order: of day, month and year in numbers.
        first: the first rows, of which these cells are some.

    Raises:
        UnreadableError: they can be read in more than one way, or are not times.
        UsageError: -R time_format is not a pattern of strptime.
    """
    known, asked, zone = _usual_cells(cells), options.time_format, column.name.zone
    texts, asked_us = [text for text, _ in known], microseconds_in(asked or "")
    if asked is not None and asked_us is None:
        return _written_format(_asked_form(asked), known, zone, source.path)
    numbers = [value for text in texts if (value := number_of(text)) is not None]
    if len(numbers) == len(texts):
        unit_us = asked_us or source.stated.time_unit_us or column.name.time_unit_us
        form = (
            None if asked_us else _form_of_digits(texts, unit_us, lambda: source.cells(first, column, None))
        )
        if form is not None:
            return _written_format(form, known, zone, source.path)
        return _number_format(numbers, unit_us, column, source, options)
    digits = unpadded_digits(texts)
    if not digits and (iso := _iso_format(known, source, zone)) is not None:
        return iso
    if (form := written_form(texts, order, digits)) is None:
        raise _no_time(known, source.path)
    return _written_format(form, known, zone, source.path)


def _usual_cells(cells: Sequence[Cell]) -> list[Cell]:
    """Return the cells that are not missing, of numbers or of times if most are one of these; at least one.

    What is neither costs its row, not the recording.
    """
    known = [(text, line) for cell, line in cells if (text := cell.strip()) not in MISSING]
    known = known or [("", cells[0][1])]
    kind = column_kind([text for text, _ in known], KIND_SHARE)
    usual = kind in (Kind.NUMBER, Kind.TIME)
    return [cell for cell in known if not usual or cell_kind(cell[0]) is kind]


def _iso_format(known: Sequence[Cell], source: Source, zone: str | None) -> TimeFormat | None:
    """Return the format of times in ISO 8601 with the year first; None for other times."""
    found = [STAMP.fullmatch(text) for text, _ in known]
    stamps = [stamp for stamp in found if stamp is not None]
    if len(stamps) < len(found) or 2 * sum(stamp["year"] in NS_YEARS for stamp in stamps) < len(stamps):
        return None
    zones = [stamp["zone"] for stamp in stamps]
    _refuse_mixed([one is not None for one in zones], known, source.path)
    return TimeFormat(None, zoned=zones[0] is not None, has_offsets=not {*zones} <= {None, "Z"}, zone=zone)


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
        _, line = known[zoned.index(min((False, True), key=zoned.count))]
        what = "some times have a zone and some do not"
        hint = "write all of them with Z or an offset, or none"
        raise UnreadableError(what, path=path, line=line, hint=hint)


def _written_format(form: Written, known: Sequence[Cell], zone: str | None, path: Path) -> TimeFormat:
    """Return the format of cells of a form, whose dates and zones must be of one kind."""
    found = _read_cells(form, known, path)
    vague = next(filter(None, (one.vague for one in found)), None)
    offsets = vague is None and found[0].offset_s is not None
    place = found[0].place if found[0].place and stated_zone(found[0].place) else None
    how = "" if vague is None else VAGUE.format(vague, AMBIGUOUS[vague])
    if place and offsets:
        how += f" (written in {place}, read by the offsets)"
    how += f" (fractions of seconds without leading zeros: .5 is .{'5':0>{form.digits}})" * bool(form.digits)
    how += " (times of day without a date)" * (not found[0].dated)
    how += " (years of the Buddhist calendar)" * any(has_buddhist_year(text) for text, _ in known)
    return TimeFormat(
        None,
        zoned=offsets,
        since_1970=found[0].dated,
        has_offsets=offsets and any(one.offset_s for one in found),
        written=replace(form, offsets=offsets, vague=vague is not None),
        zone=None if offsets else zone or place,
        how=how,
    )


def _read_cells(form: Written, known: Sequence[Cell], path: Path) -> list[Surroundings]:
    """Return what a form says of cells; raise UnreadableError unless all are of it, and alike."""
    found = []
    for place, (text, _) in enumerate(known):
        if (cell := form.cell(text)) is None:
            raise _no_time(known[place:], path)
        found.append(cell)
    if not any(one.vague for one in found):
        _refuse_mixed([one.offset_s is not None for one in found], known, path)
    dated = [one.dated for one in found]
    if len(set(dated)) == 2:
        raise _no_time(known[dated.index(min((False, True), key=dated.count)) :], path)
    return found


def _form_of_digits(
    texts: Sequence[str], unit_us: float | None, more: Callable[[], Sequence[Cell]]
) -> Written | None:
    """Return the form of digits that are a date and a time of day, or the latter alone; None for counts.

    Digits such as 104140.000 are a time of day if a minute ends: seconds of 60 to 99 never occur, and one
    after 59 is a step of 40.
    """
    if all(map(DATE_DIGITS.fullmatch, texts)) and (form := written_form(texts)) is not None:
        return form if all(found and found.day for found in map(form.cell, texts)) else None
    if unit_us is not None or not all(map(is_digits_of_day, texts)):
        return None
    digits = present(cell for cell, _ in more())
    if not all(map(is_digits_of_day, digits)):
        return None
    seconds = [float(text.replace(",", ".")) for text in digits]
    ends = any(40 <= after - before < 100 for before, after in pairwise(seconds))
    return digits_alone() if ends or any(text.startswith("0") for text in digits) else None


def _number_format(
    values: Sequence[float], unit_us: float | None, column: Column, source: Source, options: ReadOptions
) -> TimeFormat:
    """Return the format of numbers; raise UnreadableError where neither size nor rate tells the unit."""
    if column.is_moment and unit_us is not None:
        how = f", in {UNIT_NAMES[unit_us]}" + " since 1970" * (not column.is_clock)
        return TimeFormat(unit_us, is_local=column.is_clock, how=how)
    step, middle = _usual_step(values), sorted(values)[len(values) // 2]
    rate_hz = _useful_rate(step, column.name, source, options)
    units = UNITS_US if unit_us is None else (unit_us,)
    fitting = _fitting_units(step, rate_hz, column.name)
    since = [unit for unit in units if _is_epoch(middle * unit) and step * unit <= LONGEST_PERIOD_US]
    sure = [unit for unit in since if unit in fitting]
    if sure or (since and not fitting):
        unit = (sure or since)[0]
        return TimeFormat(unit, how=f", in {UNIT_NAMES[unit]} since 1970")
    if unit_us is not None:
        return TimeFormat(unit_us, since_1970=bool(since), how=f", in {UNIT_NAMES[unit_us]}")
    return _judged_format(step, middle, rate_hz, bool(since), column.name, source.path)


def _useful_rate(step: float, name: Name, source: Source, options: ReadOptions) -> float | None:
    """Return the stated rate [Hz], or that of a line above the table if a unit fits it."""
    stated_hz = options.rate_hz or source.stated.rate_hz
    hinted_hz = stated_hz or source.stated.hint_hz
    return hinted_hz if _fitting_units(step, hinted_hz, name) else stated_hz


def _judged_format(
    step: float, middle: float, rate_hz: float | None, may_be_since_1970: bool, name: Name, path: Path
) -> TimeFormat:
    """Return the format of numbers whose unit is not stated, by the only one that fits the rate."""
    fitting = _fitting_units(step, rate_hz, name)
    day = next((day for day in EPOCH_DAYS if _is_epoch((middle - day) * DAY_US)), None)
    if fitting == [DAY_US] and day:
        return TimeFormat(DAY_US, epoch_day=day, zone=name.zone, how=", in days")
    if len(fitting) == 1 and (rate_hz or not may_be_since_1970):
        by = "the stated rate" if rate_hz else "the ticks of Xsens" if name.fine_ticks else "the rate"
        how = f", in {UNIT_NAMES[fitting[0]]} (judged by {by})"
        return TimeFormat(fitting[0], since_1970=False, how=how)
    known = f"does not fit {rate_hz:g} Hz" if rate_hz else "may be seconds or milliseconds"
    raise UnreadableError(
        f"the time column rises by {step:g} a row, which {known}",
        path=path,
        hint="give the right --rate, or -R time_column=none with --rate if it only counts rows; or say its "
        f"unit (s, ms, us or ns): accelcal calibrate {shlex.quote(printable(path.name))} -R time_format=ms",
    )


def _usual_step(values: Sequence[float]) -> float:
    """Return the rise a row, or the fall: the median, or the mean where stamps repeat."""
    steps = sorted(right - left for left, right in pairwise(values)) or [0.0]
    return abs(steps[len(steps) // 2]) or (max(values) - min(values)) / len(steps)


def _fitting_units(step: float, rate_hz: float | None, name: Name) -> list[float]:
    """Return the units [us] in which numbers that rise by a step a row fit the rate, or an actigraph's.

    A counter of ticks fits none without a rate; Xsens' counts 0.1 ms (MT Manager) or us (Movella DOT).
    """
    low, high = (rate_hz / 2, rate_hz * 2) if rate_hz else PLAUSIBLE_HZ
    exact = rate_hz is not None and 1 / DISAGREEMENT < step * TICK_US * rate_hz / 1e6 < DISAGREEMENT
    units: tuple[float, ...] = (*UNITS_US, TICK_US, DAY_US) if exact else (*UNITS_US, DAY_US)
    units = (TICK_US, 1.0) if name.fine_ticks else () if name.ticks and not rate_hz else units
    return [unit for unit in units if step * unit > 0 and low <= 1e6 / (step * unit) <= high]


def _is_epoch(time_us: float) -> bool:
    return EPOCH_S[0] <= time_us / 1e6 <= EPOCH_S[1]


def find_clock(
    source: Source, first: First, roles: Roles, options: ReadOptions
) -> tuple[TableClock | None, Source]:
    """Return the clock of a table, None if it has no times, and the source, which may read dates by itself.

    Args:
        first: the first rows.

    Raises:
        UnreadableError: its times can be read in more than one way, or in no way.
        UsageError: -R time_format is not a pattern of strptime.
    """
    if (column := roles.time) is None:
        return None, source
    if column.unit and column.name.time_unit_us is None and column.kind is Kind.NUMBER:
        what = f"the unit {column.unit!r} of the times in {column.described} is not known"
        hint = "give -R time_format=UNIT (s, ms, us or ns), or ignore them with -R time_column=none"
        raise UnreadableError(what, path=source.path, hint=hint)
    cells, order = source.cells(first, column), None
    if roles.date is not None:
        days = [f"{day.strip()} 00:00" for day, _ in source.cells(first, roles.date, None)]
        date = DateColumn(roles.date.number, order_of(date_texts(days), source, options))
        cells = date.cells(source.cells(first, roles.date), cells)
        return TableClock(column, find_time_format(cells, column, source, options, None, first), date), source
    if options.time_format is None and date_texts([cell for cell, _ in cells]):
        texts = [cell for cell, _ in source.cells(first, column, None)]
        order = order_of(date_texts(texts), source, options)
        if order is not None and (own := source.with_date_order(column, order)) is not None:
            source, order = own, None
        cells = source.cells(first, column)
    form = find_time_format(cells, column, source, options, order, first)
    return TableClock(column, _begun(form, column, cells, source)), source


def _begun(form: TimeFormat, column: Column, cells: Sequence[Cell], source: Source) -> TimeFormat:
    """Return the form of times with the moment from which its numbers count, where that is stated."""
    since = written_start(column.unit.partition(" since ")[2].strip()) if " since " in column.unit else None
    if since is not None and since.start_us:
        return replace(
            form, since_1970=False, base_us=since.start_us, is_local=since.timezone != "UTC",
            has_offsets=since.had_offset, zone="UTC" if since.timezone == "UTC" else form.zone,
        )  # fmt: skip
    about = source.stated
    stated = about.companion is not None or about.counts_from_zero or about.counts_from_start
    if about.start is None or not stated or form.unit_us is None or form.since_1970:
        return form
    first = next((value for cell, _ in cells if (value := number_of(cell)) is not None), 0.0)
    begin_us = round(first * form.unit_us) if about.counts_from_start else 0
    return replace(form, base_us=about.start.us(None, source.path) - begin_us, is_local=True)


def wraps_of(clock: TableClock | None, times: NDArray[np.int64] | None) -> Wraps:
    """Return what the clock may do whose first times (n,) [us] these are."""
    if clock is None or times is None:
        return Wraps()
    form = clock.format
    if form.unit_us is None:
        return find_wraps(times, None, DATES if form.since_1970 else TIMES_OF_DAY)
    return find_wraps(times, None if form.since_1970 else form.unit_us)


# The pace of a table's rows: by their times, by what is stated, or by the user.

OFF, NEARLY = 0.01, 0.001
"""Shares by which the user's rate may differ from that of the times, and from which on that is noted."""

ENOUGH_ROWS = 20
"""If there are more rows, and in order, most of their steps are at most a tenth of their span."""

SLOWEST_HZ, FASTEST_HZ = 1e-7, 100_000.0
RATE = re.compile(
    r"(?:sampl\w{0,5}|update|output|data|logging|acc\w{0,12}|measurement)[ _-]*(?:rate|freq\w{0,8})"
    r"\W*(?:\(?Hz\)?\W*)?(\d{1,6}(?:[.,]\d{1,6})?)(?!\d|[.,]\d|:)\s*(?!k?s\b|kHz|MHz|%|min)",
    re.IGNORECASE,
)
"""A sampling rate among the lines above a table."""


def rate_above(text: str) -> float | None:
    """Return the rate [Hz] in lines above a table, such as `Sample rate: 100 Hz`; None without one."""
    rates = {float(rate.replace(",", ".")) for rate in RATE.findall(text)}
    return rates.pop() if len(rates) == 1 and 0 < min(rates) <= FASTEST_HZ else None


def find_pace(stamps: NDArray[np.int64] | None, source: Source, options: ReadOptions) -> Pace:
    """Return the pace of the rows: by their times, by what is stated, or by the user.

    Args:
        stamps: (n,) the first times [us]; None if the table has none.

    Raises:
        UnreadableError: nothing tells the rate, two of these contradict each other, or no recorder has it; or
            the newest row is the first.
        UsageError: the user's rate contradicts that of the header of a table without times.
    """
    stated_hz, user_hz, path = source.stated.rate_hz, options.rate_hz, source.path
    if stamps is not None:
        known = stamps[stamps > LOST]
        _refuse_other_order(known, source)
        by_header = user_hz is None and stated_hz is not None
        pace = _agreeing_pace(known, stated_hz or 0, path) if by_header else _pace_of(known, user_hz, path)
    elif stated_hz is not None:
        pace = Pace(agreed_rate(options, stated_hz, path))
    elif user_hz is not None:
        pace = Pace(user_hz)
    else:
        raise UnreadableError(
            "no column is known to hold the time",
            path=path,
            hint="name it with -R time_column=NAME, or give the sampling rate with --rate HZ; means of still "
            "windows are fitted with `accelcal fit`",
        )
    if not SLOWEST_HZ <= pace.rate_hz <= FASTEST_HZ:
        what = f"a sampling rate of {pace.rate_hz:g} Hz cannot be right"
        raise UnreadableError(what, path=path, hint="give it with --rate HZ")
    return pace


def _refuse_other_order(stamps: NDArray[np.int64], source: Source) -> None:
    """Raise UnreadableError for rows that go back in time, or to and fro over a large part of their span."""
    steps = np.diff(stamps)
    newest_first = np.count_nonzero(steps < 0) > np.count_nonzero(steps > 0)
    usual = float(np.median(np.abs(steps))) if len(stamps) > ENOUGH_ROWS else 0.0
    shuffled = usual > 2 * int(np.ptp(stamps)) / ENOUGH_ROWS if usual else False
    if not (newest_first or shuffled):
        return
    hint = "sort its rows by time, the oldest first (in pandas: .sort_index() or .sort_values(NAME))"
    what = "its rows are not in the order of their times"
    if newest_first and not shuffled:
        what = "its rows are in the order newest first: their times go back"
        if source.first_line is not None:
            name, above = shlex.quote(printable(source.path)), source.first_line - 1
            with source.path.open("rb") as file:
                packing = packing_of(file.read(LONGEST_BEGIN))
            text = f"{packing.command} -c < {name}" if packing else f"cat {name}"
            rows = f"{text} | tail -n +{above + 1} | sed '$a\\' | tac"  # the last line may have no end
            command = f"({text} | head -n {above}; {rows}) > sorted.csv"
            hint = f"sort its rows by time, the oldest first: {command}"
    raise UnreadableError(what, path=source.path, line=source.first_line, hint=hint)


def _pace_of(stamps: NDArray[np.int64], user_hz: float | None, path: Path) -> Pace:
    """Return the pace of the first rows, whose times are `stamps` (n,) [us]; raises as `find_pace`."""
    pace = shared_pace(stamps) if shares_stamps(stamps) else _pace_of_single_stamps(stamps)
    if pace is None and user_hz is None:
        why = ": none of the first ones exists"
        if len(stamps):
            alike = f": {iso_time(int(stamps[0]), None)} in each of the first {len(stamps)}"
            why = alike * (not np.ptp(stamps))
        what = f"the sampling rate cannot be found from the times of its rows{why}"
        raise UnreadableError(what, path=path, hint="give it with --rate")
    if pace is None or user_hz is None:
        return pace or Pace(float(user_hz or 0), only_stamp_period(stamps))
    off, coarse = abs(user_hz / pace.rate_hz - 1), max(pace.stamp_period_us, pace.period_us)
    if off > max(OFF, 2 * coarse / max(int(np.ptp(stamps)), 1)):
        what = f"its times say {pace.rate_hz:g} Hz, not {user_hz:g} Hz"
        hint = "omit --rate, or ignore the times with -R time_column=none"
        raise UnreadableError(what, path=path, hint=hint)
    return Pace(user_hz, pace.stamp_period_us, pace.rate_hz if off > NEARLY else None)


def _agreeing_pace(stamps: NDArray[np.int64], header_hz: float, path: Path) -> Pace:
    """Return the pace of the first rows of a file whose header states its rate.

    Raises:
        UnreadableError: the rows are not made at that rate.
    """
    try:
        pace = _pace_of(stamps, None, path)
    except UnreadableError:
        return _pace_of(stamps, header_hz, path)
    if not pace.agrees(header_hz):
        what = f"its header says {header_hz:g} Hz, the times of its rows say {pace.rate_hz:g} Hz"
        hint = f"export the raw data; or give --rate {pace.rate_hz:g} if the rows are right"
        raise UnreadableError(what, path=path, hint=hint)
    return Pace(header_hz, pace.stamp_period_us)


def _pace_of_single_stamps(stamps: NDArray[np.int64]) -> Pace | None:
    """Return the pace of rows that have a stamp each: the mean step without gaps, unless stamps jitter."""
    jittered = jittered_step(stamps)
    if jittered is not None:
        return Pace(nice_rate(MICROSECONDS / jittered, JITTER_ERROR))
    starts = np.flatnonzero(np.diff(stamps, prepend=stamps[:1] - 1))
    steps, rows = np.diff(stamps[starts]), np.diff(starts)
    steps, rows = steps[steps > 0], rows[steps > 0]
    usual = steps <= GAP_PERIODS * float(np.median(steps)) if len(rows) else rows
    if not usual.any():
        return None
    steps, rows = steps[usual], rows[usual]
    each = float(steps.sum()) / float(rows.sum())
    error = max(stamp_error(stamps), float(np.std(steps / rows)) / each / len(steps) ** 0.5)
    return Pace(nice_rate(MICROSECONDS / each, error))
