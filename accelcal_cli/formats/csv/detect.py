"""What a text file is, found out from its first megabyte, the options, and the header of a known vendor.

`detect` takes the steps in order; the time of the last row is looked up without reading what lies before it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from accelcal_cli.core.errors import UnreadableError, UsageError, printable
from accelcal_cli.core.formats import GZIP_MAGIC, ReadOptions, agreed_rate
from accelcal_cli.formats._gravity import guess_unit
from accelcal_cli.formats._stamps import IMPOSSIBLE, Pace
from accelcal_cli.formats._tables.units import Scale as TurnScale
from accelcal_cli.formats.csv import times
from accelcal_cli.formats.csv.bids import bids_description
from accelcal_cli.formats.csv.cells import Scale, check_unit, scale_for, stated_unit
from accelcal_cli.formats.csv.columns import CHANNELS, UNKNOWN, Roles, column_name, find_roles
from accelcal_cli.formats.csv.dialect import Dialect, cells_of, find_dialect
from accelcal_cli.formats.csv.gyroscope import find_gyroscope, often_missing
from accelcal_cli.formats.csv.table import (
    Block,
    LineFile,
    ParsedTable,
    RepeatedHeads,
    TableParser,
    lone_block,
)
from accelcal_cli.formats.csv.vendors import ExportDescription, export_description

HEAD_BYTES = 1 << 20
TAIL_BYTES = 1 << 16


@dataclass(frozen=True, slots=True)
class Detected:
    """Everything that the head of a file shows.

    Attributes:
        start_us: time of the first row where rows carry none; None if it is not known.
        first_values: of each channel, its first value; a column that the head leaves empty is none.
        gyro: how rates of turn become counts, None without a gyroscope; gyro_notes: how it was understood.
        head: the file up to its first row.
    """

    export: ExportDescription
    start_us: int | None
    parser: TableParser
    scale: Scale
    pace: Pace
    first_values: dict[str, int]
    line_bytes: float
    guessed_unit: bool
    head: bytes
    gyro: TurnScale | None = None
    gyro_notes: tuple[str, ...] = ()

    @property
    def has_dates(self) -> bool:
        """Whether its times count from 1970 rather than from its first row."""
        return self.start_us is not None if self.parser.time is None else self.parser.time.since_1970

    @property
    def timezone(self) -> str | None:
        """Zone of its clock, as the file says it."""
        written = self.parser.time
        return "UTC" if written is not None and written.is_utc else self.export.timezone

    def notes(self) -> tuple[str, ...]:
        """How the file was understood, for people."""
        dialect, roles = self.parser.dialect, self.parser.roles
        axes = ", ".join(column_name(dialect, column) for column in roles.xyz)
        how = " (judged by the length of gravity)" if self.guessed_unit else ""
        notes = [f"an export of {self.export.title}"] * bool(self.export.title)
        notes += [f"x, y, z: {axes}", f"unit: {self.scale.unit}{how}"]
        if roles.time is not None:
            dates = "" if roles.date is None else f"{column_name(dialect, roles.date)} and "
            notes.append(f"time: {dates}{column_name(dialect, roles.time)}")
        notes += [*self.gyro_notes, *self.pace.notes]
        headings = (dialect.names is not self.export.names) + (dialect.units is not None)
        above = dialect.skipped - self.export.preamble - headings
        if above > 0:
            notes.append(f"{above} lines before the header or the first row were not used")
        return tuple(notes)


def detect(path: Path, options: ReadOptions) -> Detected:
    """Understand a text file of numbers from its beginning.

    Raises:
        UnreadableError: it holds no rows of numbers, or they can be read in several ways; the
            hint says which option settles it.
        UsageError: an option names no column, or counts come without their scale.
    """
    _refuse_not_positive(options)
    head = _head(path, False)
    export = bids_description(path) or export_description(head, path.name) or ExportDescription()
    _refuse_doubtful(export, options, path)
    dialect = find_dialect(head, export.preamble)
    if dialect is None:
        raise _no_rows(path, head)
    if dialect.bare_returns:
        head = _head(path, True)
    dialect = _named(dialect, export, path)
    block = RepeatedHeads(head[: dialect.offset]).without(_head_block(head, dialect))
    roles = find_roles(dialect, options, path, export.xyz, export.time)
    parser = _table_parser(block, dialect, roles, export, options, path)
    gyro, gyro_notes = find_gyroscope(dialect, roles, export, options, path)
    if gyro is not None:
        parser = replace(parser, roles=replace(roles, gyro=gyro.xyz))
    cells = parser.cells(block)
    if cells.rates is not None and (fault := often_missing(cells.values, cells.rates)):
        gyro, gyro_notes, parser = None, (fault,), replace(parser, roles=roles)
    scale, guessed = _scale(cells, roles, export, options, path)
    pace = _pace(cells, export, options, path)
    start_us = None
    if parser.time is None and export.start is not None:
        start_us = export.start.us(options.date_format or export.date_order, path)
    line_bytes = len(block.data) / max(len(cells.line), 1) or 1.0
    above = head[: dialect.offset]
    turning = None if gyro is None else gyro.scale
    found = Detected(export, start_us, parser, scale, pace, _first_values(cells), line_bytes, guessed, above)
    return replace(found, gyro=turning, gyro_notes=gyro_notes)


def _named(dialect: Dialect, export: ExportDescription, path: Path) -> Dialect:
    """The layout with the names that the export gives to columns without.

    Raises:
        UnreadableError: a file beside it describes another number of columns.
    """
    names = export.names or ()
    if export.companion is not None and len(names) != dialect.columns:
        raise UnreadableError(
            f"has {dialect.columns} columns, and {printable(export.companion.name)} describes {len(names)}",
            path=path,
            line=dialect.names_line,
            hint="correct that file, or take it away",
        )
    unnamed = dialect.names is None and len(names) == dialect.columns
    return replace(dialect, names=export.names) if unnamed else dialect


def _refuse_doubtful(export: ExportDescription, options: ReadOptions, path: Path) -> None:
    """What is no raw acceleration is read only by who insists on its unit."""
    if export.doubt is not None and options.unit is None:
        raise UnreadableError(export.doubt.message, path=path, line=1, hint=export.doubt.hint)


def _refuse_not_positive(options: ReadOptions) -> None:
    for name, value in (("--rate", options.rate_hz), ("--lsb-per-g", options.lsb_per_g)):
        if value is not None and not 0 < value < np.inf:
            raise UsageError(
                f"{name} {value:g} is not a positive number", hint="give it as a number such as 100"
            )


def _head(path: Path, bare_returns: bool) -> bytes:
    with LineFile(path, bare_returns) as file:
        return file.read(HEAD_BYTES).rstrip(b"\0")


def _head_block(head: bytes, dialect: Dialect) -> Block:
    """The whole lines of the head; in a file of one unfinished line, that one."""
    end = head.rfind(b"\n") + 1
    end = end if end > dialect.offset else len(head)
    return lone_block(head[dialect.offset : end], dialect.skipped + 1, dialect.offset)


def _no_rows(path: Path, head: bytes) -> UnreadableError:
    hint = "name its format with --format"
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        hint = "it is written in UTF-16; save it again as UTF-8"
    return UnreadableError("holds no rows of three or more numbers", path=path, line=1, hint=hint)


def _table_parser(
    block: Block, dialect: Dialect, roles: Roles, export: ExportDescription, options: ReadOptions, path: Path
) -> TableParser:
    if roles.time is None:
        return TableParser(path, dialect, roles, None)
    rate_hz = options.rate_hz or export.rate_hz
    if roles.date is not None:
        order = _date_order(block, dialect, roles.date, export, options, path)
        date = times.DateColumn(roles.date, order)
        pairs = zip(dialect.cells(roles.date), dialect.cells(roles.time), strict=True)
        moments = [date.moment(*pair) if all(map(str.strip, pair)) else "" for pair in pairs]
        cells = [*zip(moments, dialect.lines, strict=True)]
        return TableParser(path, dialect, roles, times.find_time_format(cells, None, rate_hz, path), date)
    dialect = _with_date_order(block, dialect, roles.time, export, options, path)
    cells = [*zip(dialect.cells(roles.time), dialect.lines, strict=True)]
    time = times.find_time_format(cells, roles.time_unit_us, rate_hz, path)
    if export.companion is not None and export.start is not None:
        time = time.counted_from(export.start.us(None, path))
    return TableParser(path, dialect, roles, time)


def _date_order(
    block: Block, dialect: Dialect, column: int, export: ExportDescription, options: ReadOptions, path: Path
) -> str | None:
    """The order of the dates in a column; None if all begin with the year."""
    cells = [f"{cell.strip()} 00:00" for cell in cells_of(block.data, dialect, column)]
    days = [cell for cell in cells if not times.is_year_first(cell)]
    if not days:
        return None
    stated = [order for order in (_order_of_start(days, export), export.date_order) if order]
    return times.find_order(days, options.date_format, stated, path, dialect.skipped + 1)


def _with_date_order(
    block: Block, dialect: Dialect, column: int, export: ExportDescription, options: ReadOptions, path: Path
) -> Dialect:
    """The layout with times that begin with the year, whatever those of the head's rows begin with."""
    if all(map(times.is_year_first, dialect.cells(column))):
        return dialect
    cells = cells_of(block.data, dialect, column)
    stated = [order for order in (_order_of_start(cells, export), export.date_order) if order]
    order = times.find_order(cells, options.date_format, stated, path, dialect.skipped + 1)
    if order is None:
        return dialect
    sample = tuple(
        (*row[:column], times.year_first_cell(row[column], order), *row[column + 1 :])
        for row in dialect.sample
    )
    return replace(dialect, normaliser=replace(dialect.normaliser, date_order=order), sample=sample)


def _order_of_start(cells: list[str], export: ExportDescription) -> str | None:
    """The one order in which the first row lies on the day on which the header says it began."""
    if export.start is None or not cells:
        return None
    days = export.start.days(export.date_order)
    fitting = [order for order in times.ORDERS if times.read_date(cells[0], order) in days]
    return fitting[0] if len(fitting) == 1 else None


def _scale(
    cells: ParsedTable, roles: Roles, export: ExportDescription, options: ReadOptions, path: Path
) -> tuple[Scale, bool]:
    """The scale, and whether gravity alone decided the unit."""
    stated = stated_unit(options, set(roles.hints))
    if stated is None and export.unit is not None:
        scale = scale_for(export.unit, export.lsb_per_g, export.zero)
        check_unit(cells.values, scale, path)
        return scale, False
    unit = stated or guess_unit(cells.values, path)
    return scale_for(unit, options.lsb_per_g, export.zero), stated is None


def _pace(cells: ParsedTable, export: ExportDescription, options: ReadOptions, path: Path) -> Pace:
    if cells.time_us is not None:
        stamps = cells.time_us[cells.time_us > IMPOSSIBLE]
        if options.rate_hz is None and export.rate_hz is not None:
            return times.agreeing_pace(stamps, export.rate_hz, path)
        return times.find_pace(stamps, options.rate_hz, path)
    if export.rate_hz is not None:
        return Pace(agreed_rate(options, export.rate_hz, path))
    if options.rate_hz is None:
        raise UnreadableError(
            "no column is known to hold the time",
            path=path,
            hint="name it with --time-column, or give the sampling rate with --rate; means of still "
            "windows are fitted with `accelcal fit`",
        )
    return Pace(options.rate_hz)


def _first_values(cells: ParsedTable) -> dict[str, int]:
    """The first value in the head of each channel that has one there."""
    channels = {name: CHANNELS[name].channel(values) for name, values in cells.channels.items()}
    known = {name: values[values != UNKNOWN] for name, values in channels.items()}
    return {name: int(values[0]) for name, values in known.items() if len(values)}


def last_timestamp(parser: TableParser) -> int | None:
    """Time of the last row [us]; None if the file is compressed or has no times."""
    with parser.path.open("rb") as file:
        if parser.time is None or file.read(2) == GZIP_MAGIC or parser.dialect.bare_returns:
            return None
        size = file.seek(0, 2)
        file.seek(max(parser.dialect.offset, size - TAIL_BYTES))
        lines = file.read().splitlines(keepends=True)[-3:]
    whole = [line for line in lines if line.endswith((b"\n", b"\r")) and line.strip()][-1:]
    try:
        stamps = parser.cells(lone_block(b"".join(whole), 1, 0)).time_us
    except UnreadableError:
        return None
    usable = stamps is not None and len(stamps) and stamps[-1] > IMPOSSIBLE
    return int(stamps[-1]) if stamps is not None and usable else None
