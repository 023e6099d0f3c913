"""The roles of a table's columns, by the options, by what is stated, by their names, or by their places.

Acceleration may be three columns of one number a row or one of three. Further columns are looked for in the
group of the acceleration first, then in those around it, and have as many rows.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from accelcal_cli.core.errors import NoRecordingError, Reason, UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import OtherColumn, uniquely_named
from accelcal_cli.core.vocabulary import (
    ACCELEROMETER,
    BARE,
    BARE_ACCELEROMETER,
    GYROSCOPE,
    NOT_RAW,
    HeatUnit,
    find_thermometer,
    normalized,
    quantity_of,
)
from accelcal_cli.core.written_times import is_date, is_digits_of_day
from accelcal_cli.formats._not_recordings import epochs_by_names
from accelcal_cli.formats.tables.cells import DATE_ALONE, TIME_OF_DAY, number_of, present
from accelcal_cli.formats.tables.header import Column, Kind, Source, readable, shown
from accelcal_cli.formats.tables.names import (
    AXES,
    Name,
    is_other_group,
    name_and_hint,
    name_of,
    unit_at_end,
)
from accelcal_cli.formats.tables.sensors import WHOLE, Meaning, meaning_of

LISTED = 8
"""Names of columns that a study gives of a table that it leaves out."""

MOST_DIVIDING = 1000
"""Most columns that are watched for several sensors."""

ACCELEROMETERS = ACCELEROMETER | BARE_ACCELEROMETER
NOT_READ = "the gyroscope is not read (-R gyro_unit=none)"
SEVERAL_GYROSCOPES = (
    "no gyroscope is read: several groups of columns could be one; -R gyro_columns=X,Y,Z chooses"
)

Group = tuple[Column, ...]
"""One column of three numbers a row, or three columns of one."""

Cells = Callable[[Column], list[str]]
"""Returns the first cells of a column as texts."""


@dataclass(frozen=True, slots=True)
class Roles:
    """The columns of a table by what they are.

    Attributes:
        xyz: of the acceleration.
        time: None if there is no column of times; date: where the date is, if `time` has only times of day.
        heat: of the device's temperature; heat_unit: None if only its values tell.
        like_heat: columns that look like a temperature and are not read.
        gyro: of the rotation rates; gyro_notes: on one that is there and not read.
        others: columns of other quantities, with what they become; other_notes: on those that are not read.
        dividing: columns of texts or whole numbers that may tell whose each row is.
    """

    xyz: Group
    time: Column | None = None
    date: Column | None = None
    heat: Column | None = None
    heat_unit: HeatUnit | None = None
    like_heat: tuple[Column, ...] = ()
    gyro: Group | None = None
    gyro_notes: tuple[str, ...] = ()
    others: tuple[tuple[Column, OtherColumn], ...] = ()
    other_notes: tuple[str, ...] = ()
    dividing: tuple[Column, ...] = ()


def find_roles(source: Source, options: ReadOptions, cells: Cells) -> Roles:
    """Find out what each column of a table is.

    Raises:
        NoRecordingError: no column can be acceleration.
        UnreadableError: it is not clear, or a column that is needed holds no numbers.
        UsageError: an option names no column of the file.
    """
    xyz = find_acceleration(source, options, cells)
    for column in xyz:
        if column.kind is not Kind.NUMBER:
            what = f"{column.described} does not hold numbers"
            hint = "name the columns of x, y and z with --columns"
            raise UnreadableError(what, path=source.path, line=source.first_line, hint=hint)
    home = xyz[0].group
    near = [one for one in source.columns if one.rows == xyz[0].rows and one not in xyz]
    time, date = _time_columns(source, near, home, (options, cells))
    free = [column for column in near if column not in (time, date)]
    heat, heat_unit, like_heat = _thermometer(source, free, home)
    free = [column for column in free if column is not heat]
    gyro, notes = _gyroscope(source, free, xyz, options)
    used = {column.number for column in gyro or ()} | {source.stated.marks}
    others = [column for column in free if column.number not in used and is_around(column, home)]
    dividing = _dividing(others, cells)
    measured = [column for column in others if column not in like_heat and _quantity_of(column)]
    quantities, left_out = _others(measured), _notes_on_texts(measured, cells)
    return Roles(xyz, time, date, heat, heat_unit, like_heat, gyro, notes, quantities, left_out, dividing)


def is_around(column: Column, home: str) -> bool:
    """Return True if the group of a column is around another, or is the same."""
    return f"{home.rstrip('/')}/".startswith(column.group.rstrip("/") + "/")


# Acceleration


def find_acceleration(source: Source, options: ReadOptions, cells: Cells) -> Group:
    """Return the columns of the acceleration; raises what `find_roles` does."""
    if options.columns is not None:
        return chosen_axes(source, options.columns, "--columns")
    if (known := _columns_within(source, source.stated.xyz)) is not None:
        return known
    if options.unit is None and source.place_word != "line":  # of text that is asked before
        epochs = epochs_by_names(column.name.text for column in source.columns)
        if epochs is not None:
            what, hint = f"holds {epochs.what}", epochs.hint
            raise NoRecordingError(what, path=source.path, hint=hint, reason=epochs.reason)
    sensor = options.one_sensor if names_group(source, options.one_sensor) else None
    found = [group for group in _named_axes(source) if sensor is None or _is_in(group[0], sensor)]
    if len(found) > 1:
        raise _several_groups(found, source)
    if not found and sensor is not None:
        hint = _listed(source)
        raise UsageError(f"no acceleration in a group named {sensor!r}", path=source.path, hint=hint)
    return found[0] if found else _placed_axes(source, cells)


def _several_groups(found: Sequence[Group], source: Source) -> UnreadableError:
    """Return the error that names groups for --columns: by paths, or by number if others share these."""
    paths, names = Counter(column.path for column in source.columns), []
    for group in found[:LISTED]:
        own = all(paths[column.path] == 1 for column in group)
        names.append(",".join(column.path if own else str(column.number) for column in group))
    groups = [group[0].group.strip("/") for group in found]
    return UnreadableError(
        f"several groups of columns are named like an accelerometer's: {'; '.join(names)}"
        + "; ..." * (len(found) > LISTED),
        path=source.path,
        hint=f"choose one, such as --columns {shlex.quote(names[0])}",
        sensors=groups if all(groups) and len({*groups}) == len(groups) else (),
    )


def names_group(source: Source, sensor: str | None) -> bool:
    """Return True if --sensor names a group of the file."""
    return sensor is not None and any(_is_in(column, sensor) for column in source.columns)


def _is_in(column: Column, sensor: str) -> bool:
    """Return True if a group around a column has this name, or this path: `Test5/Trial1`."""
    return f"/{sensor.strip().strip('/')}/".lower() in f"/{'/'.join(column.groups)}/".lower()


def chosen_axes(source: Source, names: Sequence[str], option: str) -> Group:
    """Return the columns that an option names: three of one number a row, or one of three.

    Raises:
        UsageError: it names no column of the file, or one twice, or columns of several lengths.
    """
    chosen = tuple(chosen_column(source, wanted, option) for wanted in names)
    numbers = {column.number for column in chosen}
    if len(numbers) == 1 and chosen[0].width == len(AXES):
        return chosen[:1]
    if len(numbers) < len(AXES):
        raise UsageError(f"{option} names one column twice", path=source.path, hint="give x, y and z")
    if any(column.width != 1 for column in chosen) or len({column.rows for column in chosen}) != 1:
        what = f"{option} must name three columns of one length, or one of three numbers a row, not "
        raise UsageError(what + described(chosen), path=source.path)
    return chosen


def chosen_column(source: Source, wanted: str, option: str) -> Column:
    """Return the column that the user named or numbered."""
    text = wanted.strip()
    ways: tuple[Callable[[Column], bool], ...] = (
        lambda column: column.path == text.strip("/"),
        lambda column: column.name.text.strip().lower() == text.lower(),
        lambda column: name_and_hint(column.name.text)[0].lower() == text.lower(),
        lambda column: bool(normalized(text)) and normalized(column.name.text) == normalized(text),
    )
    several: list[Column] = []
    for way in ways if source.has_names else ():
        found = [column for column in source.columns if way(column)]
        if len(found) == 1:
            return found[0]
        several = several or found
    if text.isdecimal() and int(text) < len(source.columns):
        return source.columns[int(text)]
    what = (
        f"is the name of several columns ({described(several)})"
        if several
        else "is not a column of this file"
    )
    raise UsageError(f"{option} {wanted!r} {what}", path=source.path, hint=_listed(source))


def described(columns: Iterable[Column]) -> str:
    """Return columns as people read them: `x, y` or `left/acc (100 rows)`."""
    return shown([one.path if one.rows is None else f"{one.path} ({one.rows} rows)" for one in columns])


def _listed(source: Source) -> str:
    """Return the columns of a file, for advice, with the shapes of those of several numbers a row."""
    sized = [one.path + f" ({one.rows} x {one.width})" * (one.width > 1) for one in source.columns]
    names = shown(sized) if source.has_names else "none has a name"
    unread = f"; {source.unread}" if source.unread else ""
    return f"its columns are 0 to {len(source.columns) - 1} ({names}){unread}"


def _columns_within(source: Source, numbers: tuple[int, ...] | None) -> Group | None:
    """Return the columns that a header names; None if the rows do not have them all."""
    if numbers is None or max(numbers) >= len(source.columns):
        return None
    return tuple(source.columns[number] for number in numbers)


def _triples(columns: Iterable[Column], numbered: bool = True) -> Iterator[Group]:
    """Yield groups of columns of x, y and z of one length whose names have the same other words.

    Two columns for each axis are two groups.

    Args:
        numbered: numbers among the words count; else `x.1` is another x, as programs rename columns.
    """
    axes: dict[tuple[object, ...], dict[str, list[Column]]] = {}
    for column in columns:
        if column.width == 1 and column.name.axis:
            stem = tuple(word for word in column.name.stem if numbered or not word.isdecimal())
            key = (column.group, stem, column.rows)
            axes.setdefault(key, {}).setdefault(column.name.axis, []).append(column)
    for one in axes.values():
        if len(one) == len(AXES):
            yield from zip(one["x"], one["y"], one["z"], strict=False)


def _named_like(
    columns: Sequence[Column], words: frozenset[str], is_named: Callable[[Name], bool]
) -> list[Group]:
    """Return columns that are named like a sensor's: by their own names, then by the group that holds them.

    Args:
        words: of the sensor, of which the name of one column of three numbers, or of a group, consists.
        is_named: tells by the name of one of three columns.
    """
    wide = [
        (one,)
        for one in columns
        if one.width == len(AXES)
        and (one.name.is_all(words) or (one.name.says_nothing and _is_in_group(one, words)))
    ]
    triples = [*_triples(columns)]
    named = [group for group in triples if is_named(group[0].name)]
    held = [group for group in triples if not group[0].name.stem and _is_in_group(group[0], words)]
    return [*wide, *named, *held]


def _is_in_group(column: Column, words: frozenset[str]) -> bool:
    """Return True if the name of the innermost group around a column consists of these words."""
    return any(name_of(group).is_all(words) for group in column.groups[-1:])


def _named_axes(source: Source) -> list[Group]:
    """Return the groups of columns that are named like an accelerometer's; else those named x, y and z alone.

    What other words or units name is left out.
    """
    candidates = [column for column in source.columns if not _is_of_other_sensor(column)]
    named = _named_like(candidates, ACCELEROMETERS, lambda name: name.is_accelerometer)
    bare = (column for column in candidates if all(map(str.isdecimal, column.name.stem)))
    return named or [*_triples(bare, numbered=False)]


def _is_of_other_sensor(column: Column) -> bool:
    return column.name.is_other or any(map(is_other_group, column.groups))


def _placed_axes(source: Source, cells: Cells) -> Group:
    """Return the only numbers there are in columns without names: x,y,z or time,x,y,z."""
    columns = source.columns
    numeric = [column.kind is Kind.NUMBER for column in columns]
    if not source.has_names and len(columns) == 3:
        return columns
    if not source.has_names and len(columns) == 4 and all(numeric[1:]) and _may_be_time(columns[0], cells):
        return columns[1:]
    if not source.has_names and len(columns) == 5 and _date_and_time(columns[:2], cells):
        return columns[2:]
    raise _no_axes(source, cells)


def _no_axes(source: Source, cells: Cells) -> UnreadableError:
    """Return the error that no columns are known as acceleration, by what the columns may be."""
    names, columns = [readable(column.name.text) for column in source.columns], source.columns
    path, line = source.path, source.names_line
    if not columns or all(column.kind is Kind.TEXT for column in columns):
        hint = source.unread or "give it x, y and z, and times, as numbers"
        return NoRecordingError("no column of numbers can be found", path=path, line=line, hint=hint)
    unknown = (one for one in columns if not (one.name.is_elsewhere or _is_of_other_sensor(one)))
    if source.has_names and sum(one.width for one in unknown) < len(AXES):
        hint = "give --columns X,Y,Z as names, or as numbers from 0, if it is there"
        return NoRecordingError(
            f"no column has a name known for acceleration: {', '.join(names)}",
            hint="; ".join(filter(None, (hint, source.unread))),
            reason=Reason.of("other_quantities", columns=tuple(names[:LISTED])),
            path=path,
            line=line,
        )
    listed = f"the columns {', '.join(names)}" if source.has_names else f"{len(names)} columns without names"
    without = {one.name.axis for one in columns if one.name.axis and NOT_RAW & set(one.name.stem)}
    if len(without) == len(AXES):
        hint = "export the acceleration that was measured; or give --columns X,Y,Z to read it anyway"
        what = f"holds acceleration without gravity only, in {listed}"
        return UnreadableError(what, path=path, line=line, hint=hint)
    what, hint = f"cannot tell which of {listed} are x, y and z", _advice_on_axes(source, cells)
    return UnreadableError(what, path=path, line=line, hint=hint)


def _advice_on_axes(source: Source, cells: Cells) -> str:
    """Return how to name the axes; no option can settle `0,012,0,996,-0,101`."""
    wide = [shlex.quote(column.path) for column in source.columns if column.width == len(AXES)]
    if wide or source.unread:
        as_in = f"name it, as in --columns {wide[0]}" if wide else "give --columns X,Y,Z"
        return f"{as_in}; {_listed(source)}"
    hint = "; ".join(("give --columns X,Y,Z as names, or as numbers from 0", *source.width_notes))
    if source.has_names or not 6 <= len(source.columns) <= 8 or source.place_word != "line":
        return hint
    texts = [cell for column in source.columns[-6:] for cell in cells(column)]
    whole = all(re.fullmatch(r"-?\d+", cell.strip()) for cell in texts)
    commas = "; if it also uses commas as decimals, export it with another delimiter or decimal point"
    return hint + commas * whole


# Times


def _may_be_time(column: Column, cells: Cells) -> bool:
    """Return True if a column without a name can be the time: dates, or numbers that only rise."""
    if column.kind is not Kind.NUMBER:
        return column.kind is Kind.TIME
    values = [value for cell in cells(column) if (value := number_of(cell)) is not None]
    rising = all(left <= right for left, right in pairwise(values))
    return rising and (len(values) < 2 or values[-1] > values[0])


def _time_columns(
    source: Source, near: Sequence[Column], home: str, given: tuple[ReadOptions, Cells]
) -> tuple[Column | None, Column | None]:
    """Return the column of the times, None without any, and that of the dates if it is another.

    Args:
        home: the group of the acceleration.
    """
    options, cells = given
    if options.time_column is not None:
        return _chosen_time(source, options.time_column, near, cells)
    if source.stated.time is not None and source.stated.time < len(source.columns):
        return source.columns[source.stated.time], None
    for level in _levels([column for column in near if column.width == 1], home):
        found = _times_among(level, cells)
        if len(found) > 1:
            what = f"several columns may be the time ({', '.join(column.described for column, _ in found)})"
            hint = "name one with -R time_column=NAME, or give -R time_column=none and --rate"
            raise UnreadableError(what, path=source.path, hint=hint)
        if found:
            return found[0]
    first = source.columns[0]
    untitled = not source.has_names and first in near
    return (first, None) if untitled and _may_be_time(first, cells) else (None, None)


def _times_among(level: Sequence[Column], cells: Cells) -> list[tuple[Column, Column | None]]:
    """Return the columns of one group that may be the times, each with that of the dates if it is another."""
    dated = [column for column in level if column.kind is Kind.TIME]
    named = [column for column in level if column.name.is_time]
    if len(named) > 1:
        named = [column for column in named if name_and_hint(column.name.text)[0] != BARE]
    both = [column for column in named if column in dated]
    for columns in (both, dated, named):
        if (pair := _date_and_time(columns, cells)) is not None:
            return [pair]
    found = both or named or dated
    return [(one, None) for one in _without_dates(found, cells)]


def _without_dates(columns: list[Column], cells: Cells) -> list[Column]:
    """Return columns without those of dates alone, which next to others are not the times of rows."""
    if len(columns) < 2:
        return columns
    dates = [one for one in columns if one.kind is Kind.TIME]
    dates = [one for one in dates if all(map(DATE_ALONE.fullmatch, present(cells(one))))]
    return [one for one in columns if one not in dates] or columns


def _levels(columns: Sequence[Column], home: str) -> Iterator[list[Column]]:
    """Yield the columns of the groups around another, the innermost first."""
    around = [column for column in columns if is_around(column, home)]
    for parent in sorted({column.group for column in around}, key=len, reverse=True):
        yield [column for column in around if column.group == parent]


def _chosen_time(
    source: Source, name: str, near: Sequence[Column], cells: Cells
) -> tuple[Column | None, Column | None]:
    """Return the column that -R time_column names, and that of the dates if it is the only one that fits."""
    if name.lower() == "none":
        return None, None
    chosen = chosen_column(source, name, "-R time_column")
    if chosen not in near or chosen.width != 1:
        what = f"{chosen.described} is not one column as long as the acceleration"
        raise UsageError(what, path=source.path, hint=_listed(source))
    others = [column for column in near if column.kind is Kind.TIME and column is not chosen]
    pairs = [pair for column in others if (pair := _date_and_time((chosen, column), cells))]
    return pairs[0] if len(pairs) == 1 else (chosen, None)


def _date_and_time(columns: Sequence[Column], cells: Cells) -> tuple[Column, Column] | None:
    """Return which of two columns has times of day and which has dates; None if they hold anything else."""
    for time, date in (columns, columns[::-1]) if len(columns) == 2 else ():
        times, dates = present(cells(time)), present(cells(date))
        clock = all(map(TIME_OF_DAY.fullmatch, times)) or all(map(is_digits_of_day, times))
        if times and dates and clock and all(DATE_ALONE.fullmatch(cell) or is_date(cell) for cell in dates):
            return time, date
    return None


# Further channels


def _thermometer(
    source: Source, free: Sequence[Column], home: str
) -> tuple[Column | None, HeatUnit | None, tuple[Column, ...]]:
    """Return the column of the temperature, its unit, and columns that look like one and are not read."""
    if not source.has_names:
        return None, None, ()
    numbers = [one for one in free if one.kind is Kind.NUMBER and one.width == 1]
    named = [one for one in numbers if find_thermometer([(one.name.text, None)])[0]]
    near = next(_levels(named, home), [])
    found, like = find_thermometer([(column.name.text, column.unit) for column in near])
    rest = [column for column in numbers if column not in named and is_around(column, home)]
    _, looking = find_thermometer([(column.name.text, None) for column in rest])
    both = [*(near[one] for one in like), *(rest[one] for one in looking)]
    others = tuple(sorted(both, key=lambda one: one.number))
    return (None, None, others) if found is None else (near[found.number], found.unit, others)


def _gyroscope(
    source: Source, free: Sequence[Column], xyz: Group, options: ReadOptions
) -> tuple[Group | None, tuple[str, ...]]:
    """Return the columns of the gyroscope, and notes: that there is one, or why it is not read.

    Raises:
        UnreadableError: a column of -R gyro_columns does not hold numbers.
        UsageError: -R gyro_columns names no column of the file, or others than the acceleration is long.
    """
    asked = options.gyro_columns
    chosen = None if asked is None else chosen_axes(source, asked, "-R gyro_columns")
    if chosen is not None and chosen[0].rows != xyz[0].rows:
        what = f"-R gyro_columns names {described(chosen)}, and the acceleration has {xyz[0].rows} rows"
        raise UsageError(what, path=source.path)
    known = chosen or _columns_within(source, source.stated.gyro)
    groups = [known] if known else _named_gyroscopes(free, xyz)
    if not groups:
        return None, ()
    if options.gyro_unit == "none":
        return None, (NOT_READ,)
    if len(groups) > 1:
        return None, (SEVERAL_GYROSCOPES,)
    names = ", ".join(column.described for column in groups[0])
    if any(column.kind is not Kind.NUMBER for column in groups[0]):
        if chosen is not None:
            what = f"{names}: not all of them hold numbers"
            raise UnreadableError(what, path=source.path, line=source.names_line)
        return None, (f"the gyroscope ({names}) is not read: not all of its columns hold numbers",)
    return groups[0], (f"gyroscope: {names}",)


def _named_gyroscopes(free: Sequence[Column], xyz: Group) -> list[Group]:
    """Return groups of columns named like a gyroscope's, if possible of the accelerometer's place."""
    found, home = _named_like(free, GYROSCOPE, lambda name: name.is_gyroscope), _home(xyz[0])
    beside = [group for group in found if _home(group[0]) == home]
    beside = beside or [group for group in found if f"{home}/".startswith(f"{_home(group[0])}/")]
    near = [group for group in beside if group[0].name.place == xyz[0].name.place]
    return near or beside


def _home(column: Column) -> str:
    """Return the group of a column, without one that only says which sensor it is."""
    sensor = any(_is_in_group(column, words) for words in (ACCELEROMETERS, GYROSCOPE))
    return "/".join(column.groups[:-1] if sensor else column.groups)


def _quantity_of(column: Column) -> str:
    """Return light, battery or the like by the name or the unit of a column; empty for other columns."""
    return (quantity_of([*column.name.words, column.name.stated.lower()]) or "") * (column.width == 1)


def _others(measured: Sequence[Column]) -> tuple[tuple[Column, OtherColumn], ...]:
    """Return the columns of numbers, named by quantity, several of one in full."""
    found = [column for column in measured if column.kind in (Kind.NUMBER, Kind.MISSING)]
    times = Counter(map(_quantity_of, found))
    columns = [
        OtherColumn(what if times[what] == 1 else "_".join(one.name.words), unit_at_end(one.name))
        for one, what in zip(found, map(_quantity_of, found), strict=True)
    ]
    return tuple(zip(found, uniquely_named(columns), strict=True))


def _notes_on_texts(measured: Sequence[Column], cells: Cells) -> tuple[str, ...]:
    """Return a note on each column whose cells are not numbers."""
    texts = [column for column in measured if column.kind in (Kind.TEXT, Kind.TIME)]
    first = [(column, (*present(cells(column)), "")[0]) for column in texts]
    return tuple(f"not read: {column.described} holds {cell!r}, not numbers" for column, cell in first)


def _dividing(free: Sequence[Column], cells: Cells) -> tuple[Column, ...]:
    """Return the columns of texts or whole numbers that may tell whose each row is.

    Where there are more than MOST_DIVIDING, those with the most telling names.
    """
    named = [one for one in free if one.width == 1 and meaning_of(one.name.text) is not Meaning.MEASURED]
    if len(named) > MOST_DIVIDING:
        named = sorted(named, key=lambda one: meaning_of(one.name.text), reverse=True)[:MOST_DIVIDING]
    return tuple(column for column in named if _may_divide(column, cells))


def _may_divide(column: Column, cells: Cells) -> bool:
    if column.kind is not Kind.NUMBER:
        return column.kind is Kind.TEXT
    return all(map(WHOLE.fullmatch, present(cells(column))))
