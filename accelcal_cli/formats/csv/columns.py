"""Which column of a text file is what: by the options, by the names of the columns, or by their places.

`CHANNELS` says how the columns beside the time and the acceleration become channels.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.vocabulary import (
    ACCELEROMETER,
    GYROSCOPE,
    NOT_RAW,
    ROTATION,
    TEMPERATURE,
    THERMOMETER,
    TIMES,
    In,
    names_in,
)
from accelcal_cli.formats.csv.cells import (
    DATE_ALONE,
    MISSING,
    TIME_OF_DAY,
    Kind,
    acceleration_unit,
    microseconds_in,
    name_and_hint,
    number_of,
)
from accelcal_cli.formats.csv.dialect import Dialect

ACCEL_NAMES = names_in(ACCELEROMETER, In.CSV)
NEUTRAL = frozenset({"axis", "raw", "value", "cal", "calibrated", "uncalibrated", "uncal"})
GYRO_NAMES = names_in(GYROSCOPE, In.CSV)
SHORT = frozenset({"g", "w"})
"""What `gx` and `wx` begin with: rates of turn, beside `ax`."""

OTHER_SENSORS = frozenset({*GYRO_NAMES, *NOT_RAW, "mag", "magnetometer", "user"})
TIME_NAMES = names_in(TIMES, In.CSV)
BARE_TIME_NAMES = frozenset({"t", "s", "ms", "us", "seconds", "millis", "milliseconds", "elapsed"})
G_FORCE = re.compile(r"^gF([xyz])$")
"""As Physics Toolbox names the acceleration in g."""

AXES = ("x", "y", "z")
UNKNOWN = np.iinfo(np.int32).min
"""Stands for a value of a channel that only earlier rows can give."""


@dataclass(frozen=True, slots=True)
class ChannelRule:
    """How a column of numbers becomes a channel.

    Attributes:
        names: of the column, in lower case.
        units: that its title may mention, in lower case; "" for none.
        steps: of the channel in one unit of the column.
        limit: values of this magnitude (in the column's unit) and above are not believed.
    """

    names: frozenset[str]
    units: frozenset[str]
    steps: int
    limit: float

    def channel(self, values: NDArray[np.float64]) -> NDArray[np.int32]:
        """Values (n,) of all rows: where one is missing, the last one before it, `UNKNOWN` before any."""
        usable = np.abs(values) < self.limit
        if not usable.all():
            last = np.maximum.accumulate(np.where(usable, np.arange(len(usable)), -1))
            values = np.where(last < 0, UNKNOWN / self.steps, values[last])
        channel: NDArray[np.int32] = np.rint(values * self.steps).astype(np.int32)
        return channel


CHANNELS = {
    "temperature_mc": ChannelRule(
        names_in(THERMOMETER, In.CSV), frozenset({"", "deg", *TEMPERATURE.names(In.CSV)}), 1000, 1000.0
    )
}
"""Channels that a text file may have, by their name in Chunk. This is all that there is to know of one."""


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
    """

    xyz: tuple[int, int, int]
    time: int | None
    channels: dict[str, int]
    hints: frozenset[str] = frozenset()
    time_unit_us: float | None = None
    date: int | None = None
    gyro: tuple[int, int, int] | None = None


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
            if len(words) > last and (_is_rate(end) if last > 1 else _is_unit(end)):
                words, stated = words[:-last], end
                break
        return cls(number, words, stated.strip().strip("[]()"))

    @property
    def axis(self) -> str | None:
        """The axis that its first or last word names."""
        ends = [word for word in self.words if word in AXES]
        return ends[0] if len(ends) == 1 else None

    @property
    def stem(self) -> tuple[str, ...]:
        """Its words without the axis."""
        return tuple(word for word in self.words if word not in AXES and word not in NEUTRAL)


def _axis_apart(word: str) -> tuple[str, ...]:
    """`accx` and `xacc` as two words, and so `gyrox` and `gx`."""
    if word[:-1] in ACCEL_NAMES | GYRO_NAMES | SHORT and word[-1] in AXES:
        return word[:-1], word[-1]
    if word[1:] in ACCEL_NAMES | GYRO_NAMES and word[:1] in AXES:
        return word[1:], word[0]
    return (word,)


def _is_unit(word: str) -> bool:
    known = acceleration_unit(word) is not None or microseconds_in(word) is not None
    return known or _is_rate(word) or any(word in rule.units for rule in CHANNELS.values())


def _is_rate(word: str) -> bool:
    """Whether it is a unit of rates of turn: `dps`, or `rads` of `gyro_x_rad_s`."""
    return ROTATION.find_in_table(word) is not None


def find_roles(
    dialect: Dialect,
    options: ReadOptions,
    path: Path,
    known_xyz: tuple[int, int, int] | None = None,
    known_time: int | None = None,
) -> Roles:
    """What each column is; x, y, z and the time may be known, unless the options say otherwise.

    Raises:
        UnreadableError: it is not clear, or a column that is needed holds no numbers.
        UsageError: --columns or --time-column names no column of the file.
    """
    titles = titles_of(dialect)
    xyz = chosen_axes(dialect, options.columns, path) or known_xyz
    xyz = xyz or _named_axes(titles, path) or _placed_axes(dialect, path)
    for column in xyz:
        if dialect.kinds[column] is not Kind.NUMBER:
            raise UnreadableError(
                f"{column_name(dialect, column)} does not hold numbers",
                path=path,
                line=dialect.skipped + 1,
                hint="name the columns of x, y and z with --columns",
            )
    known = (known_time, None) if known_time is not None and options.time_column is None else None
    time, date = known or _time_columns(dialect, titles, options, xyz, path)
    hints = frozenset(
        unit for title in titles if title.number in xyz and (unit := acceleration_unit(title.hint))
    )
    unit_us = next((microseconds_in(_time_unit(title)) for title in titles if title.number == time), None)
    free = [title for title in titles if title.number not in (*xyz, time, date)]
    return Roles(xyz, time, _channels(dialect, free), hints, unit_us, date)


def column_name(dialect: Dialect, column: int) -> str:
    """A column as people find it."""
    name = dialect.names[column] if dialect.names else ""
    return f"column {column} ({name!r})" if name else f"column {column}"


def titles_of(dialect: Dialect) -> list[Title]:
    """The names of the columns, taken apart."""
    if dialect.names is None:
        return []
    units = dialect.units or ("",) * dialect.columns
    pairs = zip(dialect.names, units, strict=True)
    return [Title.of(number, name, unit) for number, (name, unit) in enumerate(pairs)]


def _time_unit(title: Title) -> str:
    return title.hint or (title.words[0] if len(title.words) == 1 else "")


def _pick(dialect: Dialect, wanted: str, option: str, path: Path) -> int:
    """The number of the column that the user named or numbered."""
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


def chosen_axes(
    dialect: Dialect, names: tuple[str, str, str] | None, path: Path, option: str = "--columns"
) -> tuple[int, int, int] | None:
    """The columns that an option names; None if it is not given.

    Raises:
        UsageError: it names no column of the file, or one twice.
    """
    if names is None:
        return None
    x, y, z = (_pick(dialect, wanted, option, path) for wanted in names)
    if len({x, y, z}) < 3:
        raise UsageError(f"{option} names one column twice", path=path, hint="give x, y and z")
    return x, y, z


def _named_axes(titles: list[Title], path: Path) -> tuple[int, int, int] | None:
    """Columns whose names end in x, y and z and otherwise say accelerometer, or nothing."""
    groups: dict[tuple[str, ...], dict[str, int]] = {}
    for title in titles:
        if title.axis and not OTHER_SENSORS & set(title.stem):
            groups.setdefault(title.stem, {}).setdefault(title.axis, title.number)
    full = {stem: group for stem, group in groups.items() if len(group) == 3}
    named = [group for stem, group in full.items() if ACCEL_NAMES & set(stem)]
    found = named or [group for stem, group in full.items() if not stem]
    if len(found) > 1:
        raise UnreadableError(
            "several groups of columns are named like an accelerometer's",
            path=path,
            hint="name the columns of x, y and z with --columns",
        )
    return (found[0]["x"], found[0]["y"], found[0]["z"]) if found else None


def _placed_axes(dialect: Dialect, path: Path) -> tuple[int, int, int]:
    """The only numbers there are: x,y,z or time,x,y,z."""
    numeric = [kind is Kind.NUMBER for kind in dialect.kinds]
    if dialect.names is None and dialect.columns == 3:
        return 0, 1, 2
    if dialect.names is None and dialect.columns == 4 and all(numeric[1:]) and _may_be_time(dialect, 0):
        return 1, 2, 3
    if dialect.names is None and dialect.columns == 5 and _date_and_time(dialect, [0, 1]):
        return 2, 3, 4
    what = (
        f"columns {', '.join(dialect.names)}" if dialect.names else f"{dialect.columns} columns without names"
    )
    raise UnreadableError(
        f"which columns are x, y and z cannot be told from {what}",
        path=path,
        line=dialect.names_line,
        hint=f"give --columns X,Y,Z as names, or as numbers from 0{_if_commas(dialect)}",
    )


def _if_commas(dialect: Dialect) -> str:
    """Advice for `0,012,0,996,-0,101`, which no option can settle."""
    cells = [cell for row in dialect.sample for cell in row[-6:]]
    doubtful = dialect.normaliser.delimiter == "," and dialect.columns in (6, 7, 8)
    if not doubtful or not all(re.fullmatch(r"-?\d+", cell.strip()) for cell in cells):
        return ""
    return "; if it also uses commas as decimals, export it with another delimiter or decimal point"


def _may_be_time(dialect: Dialect, column: int) -> bool:
    """Whether a column without a name can be the time: dates, or numbers that only rise."""
    if dialect.kinds[column] is not Kind.NUMBER:
        return dialect.kinds[column] is Kind.TIME
    values = [value for cell in dialect.cells(column) if (value := number_of(cell)) is not None]
    rising = all(left <= right for left, right in pairwise(values))
    return rising and (len(values) < 2 or values[-1] > values[0])


def _time_columns(
    dialect: Dialect, titles: list[Title], options: ReadOptions, xyz: tuple[int, int, int], path: Path
) -> tuple[int | None, int | None]:
    """The column of the times, None without any, and that of the dates if it is another."""
    dated = [number for number, kind in enumerate(dialect.kinds) if kind is Kind.TIME]
    name = options.time_column
    if name == "none":
        return None, None
    if name is not None:
        chosen = _pick(dialect, name, "--time-column", path)
        others = [column for column in dated if column != chosen]
        pairs = [pair for column in others if (pair := _date_and_time(dialect, [chosen, column]))]
        return pairs[0] if len(pairs) == 1 else (chosen, None)
    named = [title.number for title in titles if title.number in dated and _is_time_name(title)]
    pair = _date_and_time(dialect, named) or _date_and_time(dialect, dated)
    return pair or (_time_column(dialect, titles, xyz, path), None)


def _date_and_time(dialect: Dialect, columns: list[int]) -> tuple[int, int] | None:
    """Of two columns, the one with times of day and the one with dates; None if they are anything else."""
    if len(columns) != 2:
        return None
    for time, date in (columns, columns[::-1]):
        times, dates = (
            [cell.strip() for cell in dialect.cells(column) if cell.strip() not in MISSING]
            for column in (time, date)
        )
        found = times and dates and all(map(TIME_OF_DAY.fullmatch, times))
        if found and all(map(DATE_ALONE.fullmatch, dates)):
            return time, date
    return None


def _time_column(dialect: Dialect, titles: list[Title], xyz: tuple[int, int, int], path: Path) -> int | None:
    named = [title for title in titles if title.number not in xyz and _is_time_name(title)]
    date_columns = [number for number, kind in enumerate(dialect.kinds) if kind is Kind.TIME]
    for found in (
        [title.number for title in named if title.number in date_columns],
        [t.number for t in named],
        date_columns,
    ):
        if len(found) == 1:
            return found[0]
        if found:
            which = ", ".join(column_name(dialect, item) for item in found)
            raise UnreadableError(
                f"several columns may be the time ({which})",
                path=path,
                hint="name one with --time-column, or give --time-column none and --rate",
            )
    return 0 if not titles and min(xyz) > 0 and _may_be_time(dialect, 0) else None


def _is_time_name(title: Title) -> bool:
    bare = len(title.words) == 1 and title.words[0] in BARE_TIME_NAMES
    return bare or bool(TIME_NAMES & set(title.words))


def _channels(dialect: Dialect, titles: list[Title]) -> dict[str, int]:
    """Of each channel, the one column of numbers that is named like it."""
    columns: dict[str, int] = {}
    for name, rule in CHANNELS.items():
        found = [
            title.number
            for title in titles
            if {*title.words} <= rule.names and len({*title.words}) == 1 and title.hint.lower() in rule.units
        ]
        if len(found) == 1 and dialect.kinds[found[0]] is Kind.NUMBER:
            columns[name] = found[0]
    return columns
