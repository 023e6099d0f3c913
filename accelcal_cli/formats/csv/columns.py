"""The roles of a text file's columns, by the options, by their names, or by their places.

`CHANNELS` says how columns besides the
time and the acceleration become channels. Rotation rates whose unit nothing states are not read: no length
of gravity tells it.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import NoRecordingError, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.reasons import Reason
from accelcal_cli.core.thermometers import BARE, HeatUnit, find_thermometer
from accelcal_cli.core.vocabulary import ABOUT_PEOPLE, BARE_TIMES, CSV, LABELS, MEASURES, NOT_RAW, OWNERS
from accelcal_cli.core.written_times import is_date, is_digits_of_day, stated_zone
from accelcal_cli.formats._tables.channels import NOT_READ, CountScale, turn_scale
from accelcal_cli.formats.csv.cells import (
    DATE_ALONE,
    MISSING,
    TIME_OF_DAY,
    CellKind,
    acceleration_unit,
    microseconds_in,
    name_and_hint,
    number_of,
)
from accelcal_cli.formats.csv.dialect import Dialect
from accelcal_cli.formats.csv.vendors import ExportDescription

SHORT_GYRO_NAMES = frozenset({"g", "w"})
"""First letters of `gx` and `wx`, which are rotation rates if there is an `ax`."""

GYRO_WORDS = (("angular", "velocity"), ("angular", "rate"), ("rotation", "rate"))
"""Pairs of words that name a gyroscope."""

NOT_MEASURED_TURNS = frozenset({"bias", "drift", "unbiased", "mag", "magnetometer", "temp", "temperature"})
"""Words in names of a gyroscope's columns that do not hold what it measures."""

OTHER_SENSORS = frozenset({*CSV.gyroscope, *NOT_RAW, "mag", "magnetometer", "user"})
NEUTRAL = frozenset({"axis", "raw", "value", "cal", "calibrated", "uncalibrated", "uncal"})
"""Words that say nothing about the sensor."""

ZONE_WORD = re.compile(
    r"(?:(?:^|[\W_]|(?<=[a-z]))(?:UTC|GMT)|(?:^|[\W_])(?:utc|gmt))(?![A-Za-z])\s*(?:[+-]\d{1,2}(?::?\d\d)?)?"
)
"""A zone among the words of a column's name."""

G_FORCE = re.compile(r"^gF([xyz])$")
"""Name of an acceleration in g in files of Physics Toolbox."""

AXES = ("x", "y", "z")
LISTED = 8
"""Names of columns that a study gives of a table that it leaves out."""

ELSEWHERE = (MEASURES | LABELS | ABOUT_PEOPLE | OWNERS | OTHER_SENSORS) - {"sensor", "node", "imu"} - NOT_RAW
"""Words in the name of a column that is not an axis of acceleration."""

UNKNOWN = np.iinfo(np.int32).min
"""Stands for a value of a channel that only earlier rows can give."""

LEAST_GYRO_SHARE = 0.99
"""Share of the first rows with an acceleration that must have a rotation rate: rows without are left out."""

NO_GYRO_UNIT = "its unit is not known, give --gyro-unit deg/s or rad/s"


@dataclass(frozen=True, slots=True)
class ChannelRule:
    """How a column of numbers becomes a channel.

    Attributes:
        steps: of the channel in one unit of the column.
        limit: values of this magnitude (in the column's unit) and above are not believed.
    """

    steps: int
    limit: float

    def channel(self, values: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return values (n,) of all rows; where one is missing, the last before it, `UNKNOWN` before any."""
        usable = np.abs(values) < self.limit
        if not usable.all():
            last = np.maximum.accumulate(np.where(usable, np.arange(len(usable)), -1))
            values = np.where(last < 0, UNKNOWN / self.steps, values[last])
        channel: NDArray[np.int32] = np.rint(values * self.steps).astype(np.int32)
        return channel


HEAT = "temperature_mc"
CHANNELS = {HEAT: ChannelRule(1000, 1000.0)}
"""Channels that a text file may have, by their name in Chunk; nothing else is particular to one."""


@dataclass(frozen=True, slots=True)
class Roles:
    """Column numbers, and what the columns' names say of their units.

    Attributes:
        time: None if the file has no time column.
        gyro: those of a gyroscope, None without one or where it is not read.
        date: where the date is, if the time column has only the time of day.
        channels: column of each of `CHANNELS` that the file has.
        hints: units of acceleration in the names of x, y and z.
        time_unit_us: microseconds in one unit of the time column, None if its name does not say.
        ticks: its name says that it counts ticks; fine_ticks: those of Xsens.
        zone: of the clock, by the name of the time column.
        rate_hz: a rate above the names of the columns.
        heat: unit of the temperature, None if only its values tell.
        like_heat: columns that look like a temperature and are not read.
    """

    xyz: tuple[int, int, int]
    time: int | None
    channels: dict[str, int]
    hints: frozenset[str] = frozenset()
    time_unit_us: float | None = None
    date: int | None = None
    gyro: tuple[int, int, int] | None = None
    ticks: bool = False
    fine_ticks: bool = False
    zone: str | None = None
    rate_hz: float | None = None
    heat: HeatUnit | None = None
    like_heat: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Title:
    """A column's name taken apart into lower-case words, and the unit it mentions."""

    number: int
    words: tuple[str, ...]
    hint: str

    @classmethod
    def of(cls, number: int, name: str, unit: str | None) -> Title:
        """Take the title of a column apart; `unit` is what the user or the vendor stated."""
        plain, hint = name_and_hint(G_FORCE.sub(r"acc_\1 [g]", name.strip()))
        spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", plain)
        words = tuple(
            word for part in re.split(r"[\W_]+", spaced.lower()) for word in _axis_apart(part) if word
        )
        stated = unit or hint or ""
        for last in (3, 2, 1) if not stated else ():
            end = "".join(words[-last:])
            if len(words) > last and (_is_turn_unit(end) if last > 1 else _is_unit(end)):
                words, stated = words[:-last], end
                break
        return cls(number, words, stated.strip().strip("[]()"))

    @property
    def axis(self) -> str | None:
        """The one axis among its words, None if there is none or several."""
        ends = [word for word in self.words if word in AXES]
        return ends[0] if len(ends) == 1 else None

    @property
    def stem(self) -> tuple[str, ...]:
        """Its words without the axis."""
        return tuple(word for word in self.words if word not in AXES and word not in NEUTRAL)

    @property
    def is_time(self) -> bool:
        """True if it names a column of times."""
        bare = len(self.words) == 1 and self.words[0] in BARE_TIMES
        return bare or bool(CSV.times & set(self.words))

    @property
    def is_gyroscope(self) -> bool:
        """True if it names what a gyroscope measures."""
        stem = set(self.stem)
        if NOT_MEASURED_TURNS & stem:
            return False
        short = len(self.stem) == 1 and self.stem[0] in SHORT_GYRO_NAMES
        return bool(CSV.gyroscope & stem) or short or any(pair in GYRO_WORDS for pair in pairwise(self.stem))

    @property
    def place(self) -> tuple[str, ...]:
        """Its words without axis and sensor, such as a side of the body."""
        words = (word for pair in GYRO_WORDS for word in pair)
        sensor = {*CSV.accelerometer, *CSV.gyroscope, *SHORT_GYRO_NAMES, *words}
        return tuple(word for word in self.stem if word not in sensor)


def _axis_apart(word: str) -> tuple[str, ...]:
    """Return `accx`, `xacc`, `gyrox` or `gx` as two words."""
    if word[:-1] in CSV.accelerometer | CSV.gyroscope | SHORT_GYRO_NAMES and word[-1] in AXES:
        return word[:-1], word[-1]
    if word[1:] in CSV.accelerometer | CSV.gyroscope and word[:1] in AXES:
        return word[1:], word[0]
    return (word,)


def _is_unit(word: str) -> bool:
    known = acceleration_unit(word) is not None or microseconds_in(word) is not None
    return known or _is_turn_unit(word) or word in CSV.temperatures or word in ("", "deg")


def _is_turn_unit(word: str) -> bool:
    """Return True for a unit of rotation rates: `dps`, or `rads` of `gyro_x_rad_s`."""
    return turn_scale(word) is not None


def titles_of(dialect: Dialect) -> list[Title]:
    """Return the names of the columns, taken apart."""
    if dialect.names is None:
        return []
    units = dialect.units or ("",) * dialect.columns
    pairs = zip(dialect.names, units, strict=True)
    return [Title.of(number, name, unit) for number, (name, unit) in enumerate(pairs)]


def find_roles(
    dialect: Dialect,
    options: ReadOptions,
    path: Path,
    known_xyz: tuple[int, int, int] | None = None,
    known_time: int | None = None,
) -> Roles:
    """Find out what each column is; x, y, z and the time may be known, unless the options say otherwise.

    Raises:
        UnreadableError: it is not clear, or a column that is needed holds no numbers.
        UsageError: --columns or --time-column names no column of the file.
    """
    titles = titles_of(dialect)
    xyz = chosen_axes(dialect, options.columns, path) or _within(dialect, known_xyz)
    xyz = xyz or _named_axes(titles, dialect, path) or _placed_axes(dialect, path)
    for column in xyz:
        if dialect.kinds[column] is not CellKind.NUMBER:
            raise UnreadableError(
                f"{dialect.column_name(column)} does not hold numbers",
                path=path,
                line=dialect.skipped + 1,
                hint="name the columns of x, y and z with --columns",
            )
    known = (known_time, None) if known_time is not None and options.time_column is None else None
    time, date = known or _time_columns(dialect, titles, options, xyz, path)
    units = {acceleration_unit(title.hint) for title in titles if title.number in xyz}
    free = [title for title in titles if title.number not in (*xyz, time, date)]
    hints = frozenset(unit for unit in units if unit is not None)
    channels, heat, like_heat = _channels(dialect, [title.number for title in free])
    name = dialect.names[time] if dialect.names is not None and time is not None else ""
    return Roles(
        xyz,
        time,
        channels,
        hints,
        _time_unit_us(titles, time),
        date,
        ticks=re.search("tick", name, re.IGNORECASE) is not None,
        fine_ticks=re.fullmatch(r"sample_?time_?fine", name.strip(), re.IGNORECASE) is not None,
        zone=_zone_in(name),
        heat=heat,
        like_heat=like_heat,
    )


def _zone_in(name: str) -> str | None:
    """Return the zone in the name of a column of times, such as `Timestamp UTC` or `time (+0100)`."""
    plain, hint = name_and_hint(name)
    found = ZONE_WORD.search(plain)
    words = "" if found is None else found[0].strip("_ ")
    return (stated_zone(hint) if hint and not hint.isdigit() else None) or stated_zone(words)


def _time_unit_us(titles: list[Title], time: int | None) -> float | None:
    """Return the microseconds in the unit that the name of the time column mentions, or is."""
    for title in titles:
        if title.number == time:
            return microseconds_in(title.hint or (title.words[0] if len(title.words) == 1 else ""))
    return None


def chosen_axes(
    dialect: Dialect, names: tuple[str, str, str] | None, path: Path, option: str = "--columns"
) -> tuple[int, int, int] | None:
    """Return the columns that an option names; None if it is not given.

    Raises:
        UsageError: it names no column of the file, or one twice.
    """
    if names is None:
        return None
    x, y, z = (_chosen_column(dialect, wanted, option, path) for wanted in names)
    if len({x, y, z}) < 3:
        raise UsageError(f"{option} names one column twice", path=path, hint="give x, y and z")
    return x, y, z


def _chosen_column(dialect: Dialect, wanted: str, option: str, path: Path) -> int:
    """Return the number of the column that the user named or numbered."""
    names = [name.lower() for name in dialect.names or ()]
    plain = [name_and_hint(name)[0] for name in names]
    for listed in (names, plain):
        if listed.count(wanted.strip().lower()) == 1:
            return listed.index(wanted.strip().lower())
    if wanted.strip().isdecimal() and int(wanted) < dialect.columns:
        return int(wanted)
    all_names = ", ".join(dialect.names or ()) or "none has a name"
    raise UsageError(
        f"{option} {wanted!r} is not a column of this file",
        path=path,
        hint=f"its columns are 0 to {dialect.columns - 1} ({all_names})",
    )


def _named_axes(titles: list[Title], dialect: Dialect, path: Path) -> tuple[int, int, int] | None:
    """Return the columns whose names have x, y and z and otherwise say accelerometer, or nothing."""
    groups: dict[tuple[str, ...], dict[str, int]] = {}
    for title in titles:
        if title.axis and not OTHER_SENSORS & set(title.stem):
            groups.setdefault(title.stem, {}).setdefault(title.axis, title.number)
    full = {stem: group for stem, group in groups.items() if len(group) == 3}
    named = [group for stem, group in full.items() if CSV.accelerometer & set(stem)]
    found = named or [group for stem, group in full.items() if not stem]
    if len(found) > 1:
        names = [",".join((dialect.names or ())[one[axis]].strip() for axis in AXES) for one in found]
        raise UnreadableError(
            f"several groups of columns are named like an accelerometer's: {'; '.join(names)}",
            path=path,
            hint=f"choose one, such as --columns {shlex.quote(names[0])}",
        )
    return (found[0]["x"], found[0]["y"], found[0]["z"]) if found else None


def could_be_axes(names: tuple[str, ...]) -> bool:
    """Return True if three columns or more have names that do not say that they are something else."""
    titles = [Title.of(number, name, None) for number, name in enumerate(names)]
    unknown = [
        one
        for one in titles
        if not (ELSEWHERE & set(one.words) or one.is_time or (one.is_gyroscope and len(one.words) > 1))
    ]
    return len(unknown) >= len(AXES)


def _placed_axes(dialect: Dialect, path: Path) -> tuple[int, int, int]:
    """Return the only numbers there are in columns without names: x,y,z or time,x,y,z."""
    numeric = [kind is CellKind.NUMBER for kind in dialect.kinds]
    if dialect.names is None and dialect.columns == 3:
        return 0, 1, 2
    if dialect.names is None and dialect.columns == 4 and all(numeric[1:]) and _may_be_time(dialect, 0):
        return 1, 2, 3
    if dialect.names is None and dialect.columns == 5 and _date_and_time(dialect, [0, 1]):
        return 2, 3, 4
    if dialect.names and not could_be_axes(dialect.names):
        raise NoRecordingError(
            f"no column has a name known for acceleration: {', '.join(dialect.names)}",
            path=path,
            line=dialect.names_line,
            hint="give --columns X,Y,Z as names, or as numbers from 0, if it is there",
            reason=Reason.of("other_quantities", columns=dialect.names[:LISTED]),
        )
    columns = (
        f"the columns {', '.join(dialect.names)}"
        if dialect.names
        else f"{dialect.columns} columns without names"
    )
    without = [title.axis for title in titles_of(dialect) if title.axis and NOT_RAW & set(title.stem)]
    if len(set(without)) == len(AXES):
        raise UnreadableError(
            f"holds acceleration without gravity only, in {columns}",
            path=path,
            line=dialect.names_line,
            hint="export the acceleration that was measured; or give --columns X,Y,Z to read it anyway",
        )
    raise UnreadableError(
        f"cannot tell which of {columns} are x, y and z",
        path=path,
        line=dialect.names_line,
        hint=f"give --columns X,Y,Z as names, or as numbers from 0{_advice_on_commas(dialect)}",
    )


def _advice_on_commas(dialect: Dialect) -> str:
    """Return advice for `0,012,0,996,-0,101`, which no option can settle."""
    cells = [cell for row in dialect.sample for cell in row[-6:]]
    doubtful = dialect.normaliser.delimiter == "," and dialect.columns in (6, 7, 8)
    if not doubtful or not all(re.fullmatch(r"-?\d+", cell.strip()) for cell in cells):
        return ""
    return "; if it also uses commas as decimals, export it with another delimiter or decimal point"


def _may_be_time(dialect: Dialect, column: int) -> bool:
    """Return True if a column without a name can be the time: dates, or numbers that only rise."""
    if dialect.kinds[column] is not CellKind.NUMBER:
        return dialect.kinds[column] is CellKind.TIME
    values = [value for cell in dialect.cells(column) if (value := number_of(cell)) is not None]
    rising = all(left <= right for left, right in pairwise(values))
    return rising and (len(values) < 2 or values[-1] > values[0])


def _time_columns(
    dialect: Dialect, titles: list[Title], options: ReadOptions, xyz: tuple[int, int, int], path: Path
) -> tuple[int | None, int | None]:
    """Return the column of the times, None without any, and that of the dates if it is another."""
    dated = dialect.columns_of(CellKind.TIME)
    if options.time_column is not None:
        return _chosen_time(dialect, options.time_column, dated, path)
    named = [title.number for title in titles if title.number not in xyz and title.is_time]
    if len(named) > 1:
        named = [column for column in named if not _is_bare_heat(dialect, column)]
    both = sorted({*named} & {*dated})
    for columns in (both, dated, named):
        if pair := _date_and_time(dialect, columns):
            return pair
    found = both or named or dated
    if len(found) > 1:
        raise UnreadableError(
            f"several columns may be the time ({', '.join(map(dialect.column_name, found))})",
            path=path,
            hint="name one with --time-column, or give --time-column none and --rate",
        )
    if found:
        return found[0], None
    untitled = not titles and min(xyz) > 0
    return (0, None) if untitled and _may_be_time(dialect, 0) else (None, None)


def _is_bare_heat(dialect: Dialect, column: int) -> bool:
    return dialect.names is not None and name_and_hint(dialect.names[column])[0] == BARE


def _chosen_time(dialect: Dialect, name: str, dated: list[int], path: Path) -> tuple[int | None, int | None]:
    """Return the column that --time-column names, and that of the dates if it is the only one that fits."""
    if name == "none":
        return None, None
    chosen = _chosen_column(dialect, name, "--time-column", path)
    others = [column for column in dated if column != chosen]
    pairs = [pair for column in others if (pair := _date_and_time(dialect, [chosen, column]))]
    return pairs[0] if len(pairs) == 1 else (chosen, None)


def _date_and_time(dialect: Dialect, columns: list[int]) -> tuple[int, int] | None:
    """Return which of two columns has times of day and which has dates; None if they hold anything else."""
    if len(columns) != 2:
        return None
    for time, date in (columns, columns[::-1]):
        times, dates = (
            [cell.strip() for cell in dialect.cells(column) if cell.strip() not in MISSING]
            for column in (time, date)
        )
        clock = all(map(TIME_OF_DAY.fullmatch, times)) or all(map(is_digits_of_day, times))
        if times and dates and clock and all(DATE_ALONE.fullmatch(cell) or is_date(cell) for cell in dates):
            return time, date
    return None


def _channels(dialect: Dialect, free: list[int]) -> tuple[dict[str, int], HeatUnit | None, tuple[int, ...]]:
    """Return the column of the temperature, its unit, and columns that look like one and are not read."""
    names, units = dialect.names or (), dialect.units or ("",) * dialect.columns
    numbers = [number for number in free if names and dialect.kinds[number] is CellKind.NUMBER]
    found, like = find_thermometer([(names[number], units[number]) for number in numbers])
    others = tuple(numbers[one] for one in like)
    return ({}, None, others) if found is None else ({HEAT: numbers[found.number]}, found.unit, others)


def heat_notes(dialect: Dialect, roles: Roles) -> list[str]:
    """Return which column is the temperature, and which look like one and are not read."""
    notes = []
    if HEAT in roles.channels and roles.heat is not None:
        notes.append(f"temperature: {dialect.column_name(roles.channels[HEAT])}, in {roles.heat.name}")
    if roles.like_heat:
        names = ", ".join(map(dialect.column_name, sorted(roles.like_heat)))
        notes.append(f"not read, though it looks like a temperature: {names}")
    return notes


class GyroColumns(NamedTuple):
    """The columns of x, y and z, and how their numbers become counts."""

    xyz: tuple[int, int, int]
    scale: CountScale


def _within(dialect: Dialect, xyz: tuple[int, int, int] | None) -> tuple[int, int, int] | None:
    """Return the columns that a header names; None if the rows do not have them all."""
    return xyz if xyz is not None and max(xyz) < dialect.columns else None


def find_gyroscope(
    dialect: Dialect, roles: Roles, export: ExportDescription, options: ReadOptions, path: Path
) -> tuple[GyroColumns | None, tuple[str, ...]]:
    """Return the gyroscope of a file, and notes: that there is one, or why it is not read.

    Raises:
        UnreadableError: a column of --gyro-columns does not hold numbers.
        UsageError: --gyro-columns names no column of the file.
    """
    chosen = chosen_axes(dialect, options.gyro_columns, path, "--gyro-columns")
    used = {*roles.xyz, roles.time, roles.date, *roles.channels.values()}
    titles = [title for title in titles_of(dialect) if title.number not in used]
    known = chosen or _within(dialect, export.gyro)
    groups = [known] if known else _named_gyroscopes(titles, dialect, roles)
    if not groups:
        return None, ()
    if options.gyro_unit == "none":
        return None, (NOT_READ,)
    if len(groups) > 1:
        return None, ("no gyroscope is read: several groups of columns could be one; --gyro-columns chooses",)
    xyz = groups[0]
    names = ", ".join(map(dialect.column_name, xyz))
    if any(dialect.kinds[column] is not CellKind.NUMBER for column in xyz):
        if chosen:
            raise UnreadableError(
                f"{names}: not all of them hold numbers", path=path, line=dialect.names_line
            )
        return None, (f"the gyroscope ({names}) is not read: not all of its columns hold numbers",)
    scale = _gyro_scale(titles, xyz, export, options)
    if scale is None:
        return None, (f"the gyroscope ({names}) is not read: {NO_GYRO_UNIT}",)
    return GyroColumns(xyz, scale), (f"gyroscope: {names}",)


def _named_gyroscopes(titles: list[Title], dialect: Dialect, roles: Roles) -> list[tuple[int, int, int]]:
    """Return groups of three columns named like a gyroscope's, if possible of the accelerometer's place.

    A group with two columns for one axis counts as two.
    """
    groups: dict[tuple[str, ...], dict[str, list[int]]] = {}
    for title in titles:
        if title.axis and title.is_gyroscope:
            groups.setdefault(title.stem, {}).setdefault(title.axis, []).append(title.number)
    places = {title.place for title in titles_of(dialect) if title.number in roles.xyz}
    found = {
        stem: list(zip(axes["x"], axes["y"], axes["z"], strict=False))
        for stem, axes in groups.items()
        if len(axes) == 3
    }
    place_of = {title.stem: title.place for title in titles}
    near = [group for stem, same in found.items() if place_of[stem] in places for group in same]
    return near or [group for same in found.values() for group in same]


def _gyro_scale(
    titles: list[Title], xyz: tuple[int, int, int], export: ExportDescription, options: ReadOptions
) -> CountScale | None:
    """Return the scale by the user, the names of the columns, or the vendor; None if none states it."""
    if options.lsb_per_dps is not None:
        return CountScale(options.lsb_per_dps)
    hints = {title.hint for title in titles if title.number in xyz and microseconds_in(title.hint) is None}
    named = next(iter(hints)) if len(hints) == 1 else ""
    unit = options.gyro_unit or named or export.gyro_unit
    return None if unit is None else turn_scale(unit)


def why_not_read(values: NDArray[np.float64], rates: NDArray[np.float64]) -> str | None:
    """Return the reason not to read a gyroscope whose rates (n, 3) are missing in many rows, or None."""
    rows = ~np.isnan(values).any(axis=1)
    missing = int((rows & np.isnan(rates).any(axis=1)).sum())
    if missing <= (1 - LEAST_GYRO_SHARE) * rows.sum():
        return None
    return f"the gyroscope is not read: {missing} of the first {rows.sum()} rows have no value of it"
