"""Finds out what a text file is: from its first megabyte, the options, a vendor's header, or sidecars.

`detect` takes the steps in order; the time of the last row is looked up without reading what lies before it.

A file of Motion-BIDS, `*_motion.tsv`, has no head. `*_channels.tsv` says what each column is (type ACCEL,
component, tracked point, units), `*_motion.json` the rate and the device (Motion-BIDS,
bids-specification.readthedocs.io); the start is in `*_scans.tsv`, in the folder above or the same.
"""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, iso_time
from accelcal_cli.core.door import has_file
from accelcal_cli.core.errors import UnreadableError, UsageError, counted, printable
from accelcal_cli.core.formats import GZIP_MAGIC, WIDE_BYTES, ReadOptions, agreed_rate, wide_text
from accelcal_cli.core.input_files import read_text
from accelcal_cli.core.recording import Device
from accelcal_cli.core.written_times import ORDERS, read_date, written_start
from accelcal_cli.formats._stamps import (
    GAP_PERIODS,
    IMPOSSIBLE,
    Pace,
    jittered_step,
    nice_rate,
    only_stamp_period,
    shared_pace,
    shares_stamps,
)
from accelcal_cli.formats._tables.channels import CountScale
from accelcal_cli.formats._unsigned import FOUND_ZERO
from accelcal_cli.formats._wraps import DATES, TIMES_OF_DAY, RunningOn, Wraps, find_wraps
from accelcal_cli.formats.csv import BIDS_CHANNELS, BIDS_MOTION, bids_channels_path
from accelcal_cli.formats.csv.cells import (
    AccelScale,
    is_year_first,
    number_of,
    year_first,
)
from accelcal_cli.formats.csv.columns import (
    CHANNELS,
    UNKNOWN,
    Roles,
    find_gyroscope,
    find_roles,
    heat_notes,
    why_not_read,
)
from accelcal_cli.formats.csv.dialect import (
    DEEPEST_BYTES,
    Dialect,
    cells_of,
    find_deep_dialect,
    find_dialect,
)
from accelcal_cli.formats.csv.exports import PHYPHOX_HEAD, experiment_start
from accelcal_cli.formats.csv.lines import Block, LineFile, RepeatedHeads, lone_block
from accelcal_cli.formats.csv.rows import ParsedTable, TableParser, not_rows, usual_stride, with_heat_unit
from accelcal_cli.formats.csv.scales import find_scale
from accelcal_cli.formats.csv.sensors import SensorWatch, dividing_columns, rows_of_sensor
from accelcal_cli.formats.csv.times import (
    FASTEST_HZ,
    DateColumn,
    TimeRules,
    date_texts,
    find_order,
    find_time_format,
    rate_above,
)
from accelcal_cli.formats.csv.vendors import ExportDescription, Start, export_description, refuse_doubtful

HEAD_BYTES = 1 << 20
"""Bytes that are read to understand a file."""

TAIL_BYTES, LAST_LINES = 1 << 16, 20
"""Bytes that are read to find the last row, and lines below the last row of one sensor."""

ABOUT = "_motion.json"
"""End of the name of the sidecar with rate and device."""

LARGEST_SIDECAR = 1 << 20
ACCEL, GYRO, AXES = "ACCEL", "GYRO", ("x", "y", "z")
CELSIUS = ("oC", "\u00b0C", "degC")

SPARSE = "one row in {} holds acceleration; the others are left out"

Sidecar = list[dict[str, str]]
"""Rows of a table of Motion-BIDS, by the names of its columns."""


@dataclass(frozen=True, slots=True)
class Detected:
    """Everything that the head of a file shows.

    Attributes:
        start_us: time of the first row where rows carry none; None if it is not known.
        first_values: the first value of each channel; a column that the head leaves empty is not a channel.
        gyro: how rotation rates become counts, None without a gyroscope; gyro_notes: how it was understood.
        head: the file up to its first row.
        wraps: what its clock may do.
        stride: rows from one with values to the next, in a table that other sensors share.
        watch: over columns that may separate several sensors, with the head seen; None without such columns.
    """

    export: ExportDescription
    start_us: int | None
    parser: TableParser
    scale: AccelScale
    pace: Pace
    first_values: dict[str, int]
    line_bytes: float
    guessed_unit: bool
    head: bytes
    gyro: CountScale | None = None
    gyro_notes: tuple[str, ...] = ()
    watch: SensorWatch | None = None
    wraps: Wraps = field(default_factory=Wraps)
    stride: int = 1

    @property
    def has_dates(self) -> bool:
        """True if its times count from 1970 rather than from its first row."""
        return self.start_us is not None if self.parser.time is None else self.parser.time.since_1970

    @property
    def timezone(self) -> str | None:
        """The zone of its clock, as the file says it."""
        written = self.parser.time
        if written is not None and written.is_utc:
            return "UTC"
        return self.export.timezone if written is None else written.zone or self.export.timezone

    def notes(self) -> tuple[str, ...]:
        """Return how the file was understood, for people."""
        dialect, roles = self.parser.dialect, self.parser.roles
        axes = ", ".join(map(dialect.column_name, roles.xyz))
        how = " (judged by the length of gravity)" if self.guessed_unit else ""
        notes = [f"an export of {self.export.title}"] * bool(self.export.title) + [*self.export.notes]
        notes += [f"x, y, z: {axes}", f"unit: {self.scale.unit}{how}"]
        notes += [FOUND_ZERO.format(self.scale.zero)] * self.scale.found_zero
        if roles.time is not None:
            dates = "" if roles.date is None else f"{dialect.column_name(roles.date)} and "
            how = "" if self.parser.time is None else self.parser.time.how
            notes.append(f"time: {dates}{dialect.column_name(roles.time)}{how}")
        notes += [self.watch.note] if self.parser.sensor and self.watch else []
        notes += heat_notes(dialect, roles)
        notes += [SPARSE.format(self.stride)] * (self.stride > 1)
        notes += [*self.gyro_notes, *self.pace.notes]
        headings = (dialect.names is not self.export.names) + (dialect.units is not None)
        if self.export.pauses:
            notes.append(f"{counted(self.export.pauses, 'pause')} of the experiment are not in its times")
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
    head = _head(path, HEAD_BYTES)
    export = bids_description(path) or export_description(head, path.name) or ExportDescription()
    export = _with_start(export, head, path)
    refuse_doubtful(export, options, path)
    head, dialect = _layout(head, export, path)
    above = head[: dialect.offset]
    block = RepeatedHeads(above).without(_head_block(head, dialect))
    roles = find_roles(dialect, options, path, export.xyz, export.time)
    roles = replace(roles, rate_hz=rate_above(above[-HEAD_BYTES // 64 :].decode("latin-1")))
    if roles.time is None and options.rate_hz is None and export.rate_hz is None and roles.rate_hz:
        said = f"rate: {roles.rate_hz:g} Hz, by a line above the rows"
        export = replace(export, rate_hz=roles.rate_hz, notes=(*export.notes, said))
    gyro, gyro_notes = find_gyroscope(dialect, roles, export, options, path)
    all_roles = roles if gyro is None else replace(roles, gyro=gyro.xyz)
    dividing = dividing_columns(dialect, all_roles)
    sensor = rows_of_sensor(options.one_sensor, dialect, dividing, path)
    if sensor is not None:
        block, dialect = RepeatedHeads(above).without(sensor.block), sensor.sample_of(dialect)
    parser = _table_parser(block, dialect, roles, export, options, path)
    parser = replace(parser, roles=all_roles, sensor=() if sensor is None else sensor.texts)
    table = parser.parse(block)
    if 2 * len(table.bad) > len(table.line):
        raise not_rows(path, *next(iter(table.bad.items())))
    parser, table, roles = with_heat_unit(parser, table, roles)
    wraps = _wraps(parser, table)
    if table.time_us is not None:
        table = replace(table, time_us=RunningOn(wraps).running_on(table.time_us))
    watch = None
    if dividing and (options.one_sensor is None or sensor is not None):
        watch = SensorWatch(parser, dividing, options.sensor)
        watch.see(watch.all_of(block, table), table.time_us)
    if table.rates is not None and (fault := why_not_read(table.values, table.rates)):
        gyro, gyro_notes, parser = None, (fault,), replace(parser, roles=roles)
    scale, guessed = find_scale(table.values, roles.hints, export, options, path)
    stride = usual_stride(table.values)
    measured = table if stride == 1 else table.only(np.asarray(~np.isnan(table.values).any(axis=1)))
    pace = _pace(measured, export, options, path)
    start_us = None
    if parser.time is None and export.start is not None:
        start_us = export.start.us(options.date_format or export.date_order, path)
    line_bytes = len(block.data) / max(len(table.line), 1) or 1.0
    turns = None if gyro is None else gyro.scale
    first = _first_values(table)
    about = (export, start_us, parser, scale, pace, first, line_bytes, guessed, above, turns, gyro_notes)
    return Detected(*about, watch, wraps, stride)


def _with_start(export: ExportDescription, head: bytes, path: Path) -> ExportDescription:
    """Return the description of an export with the start that a file next to it tells."""
    if not PHYPHOX_HEAD.match(head) or (start := experiment_start(path)) is None:
        return export
    zero = Start(start.us)
    return replace(export, start=zero, timezone="UTC", counts_from_zero=True, pauses=start.pauses)


def _refuse_not_positive(options: ReadOptions) -> None:
    for name, value in (("--rate", options.rate_hz), ("--lsb-per-g", options.lsb_per_g)):
        if value is not None and not 0 < value < np.inf:
            raise UsageError(
                f"{name} {value:g} is not a positive number", hint="give it as a number such as 100"
            )


def _head(path: Path, most_bytes: int) -> bytes:
    with LineFile(path) as file:
        return file.read(most_bytes).rstrip(b"\0")


def _layout(head: bytes, export: ExportDescription, path: Path) -> tuple[bytes, Dialect]:
    """Return the layout of a file, and its beginning up to the rows of numbers; raises UnreadableError."""
    dialect = find_dialect(head, export.preamble)
    if dialect is None:
        head = _head(path, DEEPEST_BYTES)
        dialect = find_deep_dialect(head, export.preamble)
    if dialect is None:
        what = f"holds no rows of three or more numbers in its first {DEEPEST_BYTES >> 20} MB"
        hint = "check that it holds samples, or name its format with --format"
        raise UnreadableError(what, path=path, line=1, hint=hint)
    if dialect.bare_returns:
        head = head.replace(b"\r", b"\n")
    return head, _with_names(dialect, export, path)


def _with_names(dialect: Dialect, export: ExportDescription, path: Path) -> Dialect:
    """Return the layout with the names that the export gives to columns without.

    Raises:
        UnreadableError: a sidecar describes another number of columns.
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


def _head_block(head: bytes, dialect: Dialect) -> Block:
    """Return the whole lines of the head; in a file of one unfinished line, that one."""
    end = head.rfind(b"\n") + 1
    end = end if end > dialect.offset else len(head)
    return lone_block(head[dialect.offset : end], dialect.skipped + 1, dialect.offset)


def _table_parser(
    block: Block, dialect: Dialect, roles: Roles, export: ExportDescription, options: ReadOptions, path: Path
) -> TableParser:
    if roles.time is None:
        return TableParser(path, dialect, roles, None)
    cells = partial(cells_of, block.data, dialect, roles.time)
    rules = TimeRules(
        asked=options.time_format,
        unit_us=export.time_unit_us or roles.time_unit_us,
        ticks=roles.ticks,
        fine=roles.fine_ticks,
        rate_hz=options.rate_hz or export.rate_hz,
        hint_hz=roles.rate_hz,
        zone=roles.zone,
        decimal_comma=dialect.normaliser.decimal_comma,
        more=cells,
    )
    if roles.date is not None:
        days = cells_of(block.data, dialect, roles.date)
        order = _order_of(date_texts(f"{day.strip()} 00:00" for day in days), dialect, export, options, path)
        date = DateColumn(roles.date, order)
        pairs = zip(dialect.cells(roles.date), dialect.cells(roles.time), strict=True)
        moments = [date.moment(*pair) if all(map(str.strip, pair)) else "" for pair in pairs]
        time = find_time_format([*zip(moments, dialect.lines, strict=True)], rules, path)
        return TableParser(path, dialect, roles, time, date)
    if options.time_format is None and date_texts(dialect.cells(roles.time)):
        order = _order_of(date_texts(cells()), dialect, export, options, path)
        dialect = _with_year_first(dialect, roles.time, order)
        rules = replace(rules, order=None if dialect.normaliser.date_order else order)
    written = [*zip(dialect.cells(roles.time), dialect.lines, strict=True)]
    time = find_time_format(written, rules, path)
    from_zero = export.companion is not None or export.counts_from_zero
    if export.start is not None and (from_zero or export.counts_from_start):
        first = next((value for cell, _ in written if (value := number_of(cell)) is not None), 0.0)
        begin_us = round(first * (time.unit_us or 0)) if export.counts_from_start else 0
        time = time.counted_from(export.start.us(None, path) - begin_us)
    return TableParser(path, dialect, roles, time)


def _order_of(
    texts: list[str], dialect: Dialect, export: ExportDescription, options: ReadOptions, path: Path
) -> str | None:
    """Return the order of day, month and year in dates; None if there are none that need it."""
    if not texts:
        return None
    return find_order(texts, options.date_format, _stated_orders(texts, export), path, dialect.skipped + 1)


def _with_year_first(dialect: Dialect, column: int, order: str | None) -> Dialect:
    """Return the layout with times that begin with the year where they begin with another date in numbers."""
    if order is None or all(map(is_year_first, dialect.cells(column))):
        return dialect
    sample = tuple(
        (*row[:column], year_first(row[column].encode(), order, True).decode(), *row[column + 1 :])
        for row in dialect.sample
    )
    return replace(dialect, normaliser=replace(dialect.normaliser, date_order=order), sample=sample)


def _stated_orders(cells: list[str], export: ExportDescription) -> list[str]:
    """Return the orders of dates that a header suggests, best first.

    The best one is the only one in which the first row lies on the day on which the header says it began.
    """
    days = export.start.days(export.date_order) if export.start is not None and cells else ()
    fitting = [order for order in ORDERS if days and read_date(cells[0], order) in days]
    return [order for order in (fitting[0] if len(fitting) == 1 else None, export.date_order) if order]


def _pace(table: ParsedTable, export: ExportDescription, options: ReadOptions, path: Path) -> Pace:
    if table.time_us is not None:
        stamps = table.time_us[table.time_us > IMPOSSIBLE]
        if options.rate_hz is None and export.rate_hz is not None:
            return _agreeing_pace(stamps, export.rate_hz, path)
        return _find_pace(stamps, options.rate_hz, path)
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


def _wraps(parser: TableParser, table: ParsedTable) -> Wraps:
    """Return what the clock may do whose first times are in a table."""
    time = parser.time
    if time is None or table.time_us is None:
        return Wraps()
    if time.unit_us is None:
        return find_wraps(table.time_us, None, DATES if time.since_1970 else TIMES_OF_DAY)
    return find_wraps(table.time_us, None if time.since_1970 and not time.dated else time.unit_us)


def _find_pace(stamps: NDArray[np.int64], user_hz: float | None, path: Path) -> Pace:
    """Return the pace of the first rows, whose times are `stamps` (n,) [us].

    Raises:
        UnreadableError: too few rows or times that do not move, without a rate from the user;
            or a rate from the user that contradicts the times.
    """
    pace = shared_pace(stamps) if shares_stamps(stamps) else _pace_of_single_stamps(stamps)
    if pace is None and user_hz is None:
        raise UnreadableError(
            f"the sampling rate cannot be found from the times of its rows{_alike(stamps)}",
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


def _alike(stamps: NDArray[np.int64]) -> str:
    """Return what is wrong with times (n,) that show no rate, for a message."""
    if not len(stamps):
        return ": none of the first ones exists"
    return f": {iso_time(int(stamps[0]), None)} in each of the first {len(stamps)}" * (not np.ptp(stamps))


def _agreeing_pace(stamps: NDArray[np.int64], header_hz: float, path: Path) -> Pace:
    """Return the pace of the first rows of a file whose header states its rate.

    Raises:
        UnreadableError: the rows are not made at that rate.
    """
    try:
        pace = _find_pace(stamps, None, path)
    except UnreadableError:
        return _find_pace(stamps, header_hz, path)
    if not pace.agrees(header_hz):
        raise UnreadableError(
            f"its header says {header_hz:g} Hz, the times of its rows say {pace.rate_hz:g} Hz",
            path=path,
            hint=f"export the raw data; or give --rate {pace.rate_hz:g} if the rows are right",
        )
    return Pace(header_hz, pace.stamp_period_us)


def _pace_of_single_stamps(stamps: NDArray[np.int64]) -> Pace | None:
    """Return the pace of rows that have a stamp each: the mean step without gaps, unless stamps jitter."""
    jittered = jittered_step(stamps)
    if jittered is not None:
        return Pace(nice_rate(MICROSECONDS / jittered))
    steps = np.diff(stamps)
    steps = steps[steps >= 0]
    usual = steps[steps <= GAP_PERIODS * max(float(np.median(steps)), 1.0)] if len(steps) else steps
    if len(usual) == 0 or usual.sum() == 0:
        return None
    return Pace(nice_rate(len(usual) * MICROSECONDS / float(usual.sum())))


def _first_values(table: ParsedTable) -> dict[str, int]:
    """Return the first value in the head of each channel that has one there."""
    channels = {name: CHANNELS[name].channel(values) for name, values in table.channels.items()}
    known = {name: values[values != UNKNOWN] for name, values in channels.items()}
    return {name: int(values[0]) for name, values in known.items() if len(values)}


def last_timestamp(parser: TableParser) -> int | None:
    """Return the time of the last row [us]; None if the file is compressed or has no times."""
    with parser.path.open("rb") as file:
        mark = file.read(WIDE_BYTES)
        packed = mark.startswith(GZIP_MAGIC) or wide_text(mark) is not None
        if parser.time is None or packed or parser.dialect.bare_returns:
            return None
        size = file.seek(0, 2)
        file.seek(max(parser.dialect.offset, size - TAIL_BYTES))
        lines = file.read().splitlines(keepends=True)[1 if parser.sensor else -LAST_LINES :]
    whole = [line for line in lines if line.endswith((b"\n", b"\r")) and line.strip()]
    stamps = parser.parse(lone_block(b"".join(whole), 1, 0)).time_us
    usable = None if stamps is None else stamps[stamps > IMPOSSIBLE]
    return None if usable is None or not len(usable) else int(usable[-1])


def bids_description(path: Path) -> ExportDescription | None:
    """Return what the sidecars of a file of Motion-BIDS say; None if it has no `*_channels.tsv`.

    Raises:
        UnreadableError: a sidecar is damaged, or its channels have no accelerometer, or several.
        UsageError: a sidecar cannot be read.
    """
    table = bids_channels_path(path)
    if table is None or not has_file(table):
        return None
    stem = table.name.removesuffix(BIDS_CHANNELS)
    channels, about = _sidecar_rows(table), _sidecar_object(table.with_name(stem + ABOUT))
    written = _acquisition_time(path.parent, stem)
    accel, gyro = _axes_by_point(channels, ACCEL), _axes_by_point(channels, GYRO)
    if not accel:
        hint = "name three columns with --columns if one of other types is acceleration"
        raise UnreadableError("lists no channels of type ACCEL for x, y and z", path=table, hint=hint)
    point = next(iter(accel)) if len(accel) == 1 else None
    rates = [one.get("sampling_frequency", "") for one in channels if one.get("type") == ACCEL]
    rates.append(str(about.get("SamplingFrequency")))
    return ExportDescription(
        title="Motion-BIDS",
        device=Device(_text(about, "ManufacturersModelName"), _text(about, "DeviceSerialNumber")),
        names=tuple(_title(channel) for channel in channels),
        xyz=None if point is None else accel[point],
        gyro=None if point is None else gyro.get(point),
        time=next((at for at, one in enumerate(channels) if one.get("type") == "LATENCY"), None),
        rate_hz=next((rate for rate in map(_positive, rates) if rate is not None), None),
        start=_start(written),
        timezone="UTC" if written.endswith("Z") else None,
        companion=table,
    )


def _sidecar_rows(path: Path) -> Sidecar:
    """Return the rows of a table with tabs, by the names in its first line."""
    text = read_text(path, "the sidecar", LARGEST_SIDECAR, "utf-8-sig")
    try:
        rows = list(csv.DictReader(io.StringIO(text), delimiter="\t"))
    except csv.Error as error:
        raise UnreadableError(f"is damaged ({error})", path=path, hint="correct it") from error
    return [{str(key): value for key, value in row.items() if isinstance(value, str)} for row in rows]


def _sidecar_object(path: Path) -> dict[str, Any]:
    if not has_file(path):
        return {}
    try:
        found = json.loads(read_text(path, "the sidecar", LARGEST_SIDECAR, "utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise UnreadableError(f"is not valid JSON ({error})", path=path, hint="correct it") from error
    return found if isinstance(found, dict) else {}


def _text(about: dict[str, Any], key: str) -> str | None:
    value = about.get(key)
    return value if isinstance(value, str) else None


def _positive(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 0 < value <= FASTEST_HZ else None


def _title(channel: dict[str, str]) -> str:
    name, unit = channel.get("name", ""), channel.get("units", "n/a")
    unit = "C" if unit in CELSIUS else unit
    return name if unit in ("", "n/a") else f"{name} [{unit}]"


def _axes_by_point(channels: Sidecar, kind: str) -> dict[str, tuple[int, int, int]]:
    """Return the columns of x, y and z of a type by their tracked point, where all three are there."""
    points: dict[str, dict[str, int]] = {}
    for number, channel in enumerate(channels):
        axis = channel.get("component", "").lower()
        if channel.get("type") == kind and axis in AXES:
            points.setdefault(channel.get("tracked_point", ""), {})[axis] = number
    whole = {point: axes for point, axes in points.items() if len(axes) == len(AXES)}
    return {point: (axes["x"], axes["y"], axes["z"]) for point, axes in whole.items()}


def _acquisition_time(folder: Path, stem: str) -> str:
    """Return the time in the list of scans of a subject or session: local, or in UTC with Z; "" if none."""
    whose = "_".join(part for part in stem.split("_") if part.startswith(("sub-", "ses-")))
    lists = (place / f"{whose}_scans.tsv" for place in (folder.parent, folder))
    rows = next((_sidecar_rows(path) for path in lists if has_file(path)), [])
    file = stem + BIDS_MOTION
    times = (row.get("acq_time", "") for row in rows if Path(row.get("filename", "")).name == file)
    return next(times, "")


def _start(written: str) -> Start | None:
    start = written_start(written.removesuffix("Z"))
    return None if start is None else Start(start.start_us)
