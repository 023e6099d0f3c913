"""Turns blocks of lines into columns of numbers and times, and these into counts and faults.

Single lines are looked at only where a block cannot be parsed: those that are not rows are damage.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.parallel import parallel_map
from accelcal_cli.core.recording import Channels, cut_channels, cut_columns, joined_channels, joined_columns
from accelcal_cli.core.system import process_is_ours
from accelcal_cli.core.thermometers import unit_by_values
from accelcal_cli.core.vocabulary import COUNTS, PHYSICAL_UNITS
from accelcal_cli.formats._stamps import IMPOSSIBLE, NO_TIME
from accelcal_cli.formats._tables.channels import CountScale
from accelcal_cli.formats._tables.sensors import CellTexts
from accelcal_cli.formats._written import Written
from accelcal_cli.formats.csv.cells import (
    BYTE_ORDER_MARK,
    MISSING,
    AccelScale,
    CellKind,
    cell_kind,
    decode,
    filled,
    floats,
    split_line,
)
from accelcal_cli.formats.csv.columns import CHANNELS, HEAT, UNKNOWN, Roles
from accelcal_cli.formats.csv.dialect import Dialect
from accelcal_cli.formats.csv.lines import Block
from accelcal_cli.formats.csv.times import DateColumn, TimeFormat

PARSER_BYTES = 1 << 20
"""Text that pyarrow parses at a time."""

if process_is_ours():  # else Arrow starts a thread for signals, and ends the process where it is given none
    pa.enable_signal_handlers(False)

DATES, TEXTS = (pa.dictionary(pa.int32(), kind) for kind in (pa.string(), pa.binary()))
PADDING = frozenset(b" \t\r\n")
MOST_BAD = 100_000
"""Lines that are not rows, above which a file that mostly has such lines is not read on."""

SHOWN = 40
"""Letters of a line that a message shows."""


@dataclass(frozen=True, slots=True)
class LineCheck:
    """Finds what is wrong with a line: the number of its columns, or a cell that is not a number or time."""

    dialect: Dialect
    used: tuple[int, ...]
    time: int | None
    format: TimeFormat | None
    date: DateColumn | None = None

    def fault(self, raw: bytes) -> str:
        """Return what is wrong with a normalised line that cannot be parsed."""
        text = decode(raw.rstrip(b"\r\n"))
        return self._fault(text) or f"the line cannot be read ({shortened(text)!r})"

    def _fault(self, text: str) -> str | None:
        cells = split_line(text, self.dialect.normaliser.delimiter)
        if len(cells) != self.dialect.columns:
            columns = "1 column" if len(cells) == 1 else f"{len(cells)} columns"
            return f"the line has {columns}, not {self.dialect.columns} ({shortened(text)!r})"
        if self.date is not None and self.time is not None:
            cells[self.time] = self.date.moment(cells[self.date.column], cells[self.time])
        for column in sorted(self.used):
            if not self._fits(cells[column], column):
                what = "time" if column == self.time else "number"
                return f"column {column} holds {shortened(cells[column])!r}, which is not a {what}"
        return None

    def _fits(self, cell: str, column: int) -> bool:
        kind = cell_kind(cell, False)
        if column == self.time and self.format is not None and self.format.unit_us is None:
            return kind is CellKind.MISSING or self.format.is_written_right(cell)
        return kind in (CellKind.NUMBER, CellKind.MISSING)


def shortened(text: str) -> str:
    """Return a text short enough for a message."""
    return text if len(text) <= SHOWN else text[:SHOWN] + "..."


def _xyz(table: Any, columns: tuple[int, int, int]) -> NDArray[np.float64]:
    values = np.empty((table.num_rows, 3))
    for axis, column in enumerate(columns):
        values[:, axis] = floats(table[str(column)])
    return values


@dataclass(frozen=True, slots=True)
class ParsedTable:
    """The columns of a block that are used, one entry a row.

    Attributes:
        line: (n,) number in the file.
        values: (n, 3) accelerations in the file's unit, NaN where empty.
        time_us: (n,), or None without a time column.
        channels: (n,) each, as `values`.
        rates: (n, 3) rotation rates, as `values`, or None.
        wanted: flags of the rows of the block that these are, None for all.
        bad: what is wrong with lines that are not rows, by their number; each is a row without values.
    """

    line: NDArray[np.int64]
    values: NDArray[np.float64]
    time_us: NDArray[np.int64] | None
    channels: Channels
    rates: NDArray[np.float64] | None = None
    wanted: NDArray[np.bool_] | None = None
    bad: Mapping[int, str] = field(default_factory=dict)

    def only(self, wanted: NDArray[np.bool_]) -> ParsedTable:
        """Return some of the rows."""
        columns = cut_columns(self, ("line", "values", "time_us", "rates"), wanted)
        return replace(self, channels=cut_channels(self.channels, wanted), wanted=wanted, **columns)


@dataclass(frozen=True)
class TableParser:
    """Turns blocks of lines into columns.

    Attributes:
        sensor: texts of columns, one of each of which the rows that are read have; of none to read all.
    """

    path: Path
    dialect: Dialect
    roles: Roles
    time: TimeFormat | None
    date: DateColumn | None = None
    sensor: tuple[tuple[int, frozenset[str]], ...] = ()

    @property
    def used(self) -> list[int]:
        """The numbers of the columns that are read, without that of dates alone."""
        time = () if self.roles.time is None else (self.roles.time,)
        return [*self.roles.xyz, *time, *self.roles.channels.values(), *(self.roles.gyro or ())]

    @cached_property
    def _converting(self) -> Any:
        return self._converting_times(None if self.time is None else self.time.arrow_type)

    def _converting_times(self, kind: Any) -> Any:
        """Return how pyarrow makes values of cells, with this type for times."""
        types = {str(column): pa.float64() for column in self.used}
        if kind is not None:
            types[str(self.roles.time)] = kind
        if self.date is not None:
            types |= {str(self.roles.time): pa.string(), str(self.date.column): DATES}
        return _converting(types)

    def parse(self, block: Block) -> ParsedTable:
        """Return the rows of a block's whole lines; those that cannot be parsed have no values.

        Raises:
            UnreadableError: no single line is what cannot be parsed.
        """
        try:
            return self._rows(block)
        except pa.ArrowException:
            bad = self._bad_lines(block)
        try:
            return replace(self._rows(_without(block, bad, self._empty_line)), bad=bad)
        except pa.ArrowException as error:
            raise not_rows(
                self.path, block.line, f"the lines from here on cannot be read ({error})"
            ) from error

    def _rows(self, block: Block) -> ParsedTable:
        data = self.dialect.normaliser(block.data)
        table, data, impossible = self._table(data, block)
        line = block.line + np.arange(table.num_rows, dtype=np.int64)
        if block.lines != table.num_rows:
            rows = [number for number, text in enumerate(data.splitlines()) if text]
            line = block.line + np.array(rows, np.int64)
        values = _xyz(table, self.roles.xyz)
        stamps = None if self.time is None else self.time.microseconds(table[str(self.roles.time)])
        if stamps is not None and impossible is not None:
            stamps[impossible] = IMPOSSIBLE
        channels: Channels = {}
        for name, column in self.roles.channels.items():
            heat = floats(table[str(column)])
            channels[name] = heat if self.roles.heat is None else self.roles.heat.celsius(heat)
        rates = None if self.roles.gyro is None else _xyz(table, self.roles.gyro)
        parsed = ParsedTable(line, values, stamps, channels, rates)
        return parsed.only(self._of_sensor(block)) if self.sensor else parsed

    def values(self, block: Block, columns: Sequence[int]) -> tuple[CellTexts, ...]:
        """Return columns of a block that can be parsed, as texts."""
        converting = _converting({str(column): TEXTS for column in columns})
        try:
            table = self._read(self.dialect.normaliser(block.data), converting)
        except pa.ArrowException:
            table = self._read_repaired(block, converting)
        return tuple(_text_values(table[str(column)]) for column in columns)

    def _read_repaired(self, block: Block, converting: Any) -> Any:
        """Return columns of a block, empty in the lines that cannot be read as these."""
        thorough = replace(self.dialect.normaliser, thorough=True)(block.data)
        with suppress(pa.ArrowException):
            return self._read(thorough, converting)

        def is_sound(data: bytes) -> bool:
            try:
                self._read(data, converting)
            except pa.ArrowException:
                return False
            return True

        lines = thorough.splitlines(keepends=True)
        for place in list(_unsound(lines, is_sound, 0, len(lines))):
            lines[place] = self._empty_line
        return self._read(b"".join(lines), converting)

    def _of_sensor(self, block: Block) -> NDArray[np.bool_]:
        """Return flags of the rows of a block that are of the sensor."""
        return self.wanted_rows(self.values(block, [column for column, _ in self.sensor]))

    def wanted_rows(self, columns: Sequence[CellTexts]) -> NDArray[np.bool_]:
        """Return flags of the rows of the sensor, from the columns that choose it."""
        flags = [
            np.isin(column.codes, [code for code, text in enumerate(column.texts) if text in texts])
            for column, (_, texts) in zip(columns, self.sensor, strict=True)
        ]
        wanted: NDArray[np.bool_] = np.logical_and.reduce(flags)
        return wanted

    def _table(self, data: bytes, block: Block) -> tuple[Any, bytes, NDArray[np.bool_] | None]:
        """Return the parsed columns, the text of the same lines behind them, and impossible times."""
        try:
            return self._parsed(data), data, None
        except pa.ArrowException:
            thorough = replace(self.dialect.normaliser, thorough=True)(block.data)
        try:
            return self._parsed(thorough), thorough, None
        except pa.ArrowException:
            if found := self._with_impossible_times(thorough):
                return found[0], thorough, found[1]
            raise

    def _with_impossible_times(self, data: bytes) -> tuple[Any, NDArray[np.bool_]] | None:
        """Return the columns with impossible times empty, and flags of these; None if more is wrong."""
        if self.time is None or self.time.unit_us is not None or self.time.written is not None:
            return None
        try:
            table = self._parsed(data, times_as=pa.string())
        except pa.ArrowException:
            return None
        name = str(self.roles.time)
        cells = pa.concat_arrays(table[name].chunks)
        times, impossible = self.time.possible(cells)
        if not all(self.time.is_written_right(cells[row].as_py()) for row in np.flatnonzero(impossible)):
            return None
        place = table.schema.get_field_index(name)
        return table.set_column(place, name, pa.chunked_array([times])), impossible

    @property
    def _empty_line(self) -> bytes:
        """A line without a value in any column."""
        return self.dialect.normaliser.delimiter.encode().join([b"NaN"] * self.dialect.columns) + b"\n"

    def _bad_lines(self, block: Block) -> dict[int, str]:
        """Return what is wrong with lines of a block that cannot be parsed, by their numbers."""
        lines = replace(self.dialect.normaliser, thorough=True)(block.data).splitlines(keepends=True)
        check = LineCheck(self.dialect, tuple(self.used), self.roles.time, self.time, self.date)
        unsound = _unsound(lines, self._is_sound, 0, len(lines))
        return {block.line + place: check.fault(lines[place]) for place in unsound}

    def _is_sound(self, data: bytes) -> bool:
        try:
            self._parsed(data)
        except pa.ArrowException:
            return self._with_impossible_times(data) is not None
        return True

    def _parsed(self, data: bytes, times_as: Any = None) -> Any:
        """Return a table in the C library's memory: Arrow's own keeps an eighth more of what was freed.

        Args:
            times_as: another type for the column of times.
        """
        if self.time is not None and self.time.written is not None:
            return self._with_written(data, self.time.written)
        table = self._read(data, self._converting if times_as is None else self._converting_times(times_as))
        return table if self.date is None or not len(table) else self._with_moments(table, times_as)

    def _with_written(self, data: bytes, written: Written) -> Any:
        """Return a table with times [us] in the column of the times."""
        table = self._read(decode(data).encode(), self._converting)
        if self.date is not None and len(table):
            table = self._with_moments(table, None)
        name = str(self.roles.time)
        times = [pa.array(written.times(chunk)) for chunk in table[name].chunks if len(chunk)]
        return table.set_column(table.schema.get_field_index(name), name, pa.chunked_array(times, pa.int64()))

    def _read(self, data: bytes, converting: Any) -> Any:
        if PADDING.issuperset(data):
            types = converting.column_types
            return pa.table({name: pa.array([], kind) for name, kind in types.items()})
        names = [str(column) for column in range(self.dialect.columns)]
        reading = pa_csv.ReadOptions(column_names=names, block_size=PARSER_BYTES, use_threads=False)
        parsing = pa_csv.ParseOptions(delimiter=self.dialect.normaliser.delimiter, newlines_in_values=False)
        pool = pa.system_memory_pool()
        if data.startswith(BYTE_ORDER_MARK):  # Arrow would leave it out, wherever in the file that is
            data = b"\n" + data
        return pa_csv.read_csv(pa.BufferReader(data), reading, parsing, converting, memory_pool=pool)

    def _with_moments(self, table: Any, times_as: Any) -> Any:
        """Return a table with dates and times of day joined in the column of the latter."""
        assert self.date is not None and self.time is not None
        name = str(self.roles.time)
        moments = self.date.moments(table[str(self.date.column)], table[name])
        column = moments.cast(times_as or self.time.arrow_type)
        return table.set_column(table.schema.get_field_index(name), name, column)


def _unsound(lines: list[bytes], is_sound: Callable[[bytes], bool], first: int, end: int) -> Iterator[int]:
    """Yield the places of lines that are not sound, by halving stretches with one."""
    if is_sound(b"".join(lines[first:end])):
        return
    if end - first == 1:
        yield first
        return
    middle = (first + end) // 2
    yield from _unsound(lines, is_sound, first, middle)
    yield from _unsound(lines, is_sound, middle, end)


def _without(block: Block, bad: Iterable[int], empty: bytes) -> Block:
    """Return a block with other lines in place of some."""
    lines = block.data.splitlines(keepends=True)
    for number in bad:
        lines[number - block.line] = empty
    return replace(block, data=b"".join(lines))


def not_rows(path: Path, line: int, fault: str) -> UnreadableError:
    """Return the error of a file most of whose lines are not rows, by the first of these."""
    return UnreadableError(fault, path=path, line=line, hint="correct or remove that line")


def _converting(types: dict[str, Any]) -> Any:
    """Return how pyarrow makes values of the cells of these columns."""
    return pa_csv.ConvertOptions(
        column_types=types,
        include_columns=list(types),
        null_values=sorted(MISSING),
        strings_can_be_null=True,
        quoted_strings_can_be_null=True,
    )


def _text_values(column: Any) -> CellTexts:
    """Return a chunked column of texts, whose chunks have a dictionary each."""
    numbers: dict[str, int] = {}
    parts = [np.empty(0, np.int32)]
    for chunk in column.chunks:
        texts = [decode(text).strip() for text in chunk.dictionary.to_pylist()]
        own = [numbers.setdefault(text, len(numbers)) if text else -1 for text in texts]
        indices = pa.chunked_array([chunk.indices.cast(pa.int64())])
        parts.append(np.array([*own, -1], np.int32)[filled(indices, np.int64, -1)])
    return CellTexts(tuple(numbers), np.concatenate(parts))


def with_heat_unit(
    parser: TableParser, table: ParsedTable, roles: Roles
) -> tuple[TableParser, ParsedTable, Roles]:
    """Return the parser, its first rows, and the roles, with the unit that the temperature's values show.

    A column whose unit nothing shows is not read.
    """
    if HEAT not in table.channels or roles.heat is not None:
        return parser, table, roles
    values, unit = table.channels[HEAT], unit_by_values(table.channels[HEAT])
    if unit is None:
        changed: dict[str, Any] = {"channels": {}, "like_heat": (*roles.like_heat, roles.channels[HEAT])}
        channels = {}
    else:
        changed, channels = {"heat": unit}, {HEAT: unit.celsius(values)}
    parser = replace(parser, roles=replace(parser.roles, **changed))
    return parser, replace(table, channels=channels), replace(roles, **changed)


def usual_stride(values: NDArray[np.float64]) -> int:
    """Return the usual distance [rows] between rows (n, 3) with values, 1 where they follow one another."""
    places = np.flatnonzero(~np.isnan(values).any(axis=1))
    return max(1, int(np.median(np.diff(places)))) if len(places) > 1 else 1


class RowWatch(Protocol):
    """Looks at blocks for what only all rows together show."""

    def look(self, block: Block, table: ParsedTable) -> Any:
        """Return what is seen of a block; this may run in any order."""

    def see(self, seen: Any, times: NDArray[np.int64] | None) -> None:
        """Take what was seen of the next block, and the times of its rows; raise AccelcalError to refuse."""


class Fault(IntEnum):
    """The reason why a row cannot be used."""

    NONE = 0
    MISSING = 1
    OUT_OF_RANGE = 2
    TIME = 3
    EMPTY = 4
    LINE = 5


@dataclass(frozen=True, slots=True)
class CsvRows:
    """Consecutive rows of a file, good and bad ones.

    Attributes:
        first_row: number of the first, from 0.
        line: (n,) number in the text.
        counts: (n, 3).
        fault: (n,) of `Fault`.
        time_us: (n,) or None.
        channels: (n,) or (n, 3) int32 each.
        filled: (n,) rows that the device did not measure, or None if none are known.
        bad: what is wrong with lines that are not rows, by their number.
    """

    first_row: int
    line: NDArray[np.int64]
    counts: NDArray[np.int32]
    fault: NDArray[np.uint8]
    time_us: NDArray[np.int64] | None
    channels: Channels
    filled: NDArray[np.bool_] | None = None
    bad: Mapping[int, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.line)

    @property
    def row(self) -> NDArray[np.int64]:
        """(n,) number of each row within the file, from 0."""
        return self.first_row + np.arange(len(self), dtype=np.int64)

    def part(self, start: int, stop: int) -> CsvRows:
        """Return rows start..stop-1 as views."""
        rows = slice(start, stop)
        columns, channels = cut_columns(self, COLUMNS, rows), cut_channels(self.channels, rows)
        return replace(self, first_row=self.first_row + start, channels=channels, **columns)


COLUMNS = ("line", "counts", "fault", "time_us", "filled")
"""Fields of `CsvRows` with one entry a row."""


def joined_rows(parts: list[CsvRows]) -> CsvRows:
    """Join rows of the same file that follow each other, at least one stretch of them."""
    if len(parts) == 1:
        return parts[0]
    channels = joined_channels([part.channels for part in parts])
    bad = {line: fault for part in parts for line, fault in part.bad.items()}
    return CsvRows(parts[0].first_row, channels=channels, bad=bad, **joined_columns(parts, COLUMNS))


class RowParser:
    """Turns blocks into rows, in the order of the file.

    Args:
        first_values: the file's first value of each channel that is wanted, for rows before it.
        gyro: how rotation rates become counts, None without.
        watch: looks at every block, None if nothing does.
    """

    def __init__(
        self,
        parser: TableParser,
        scale: AccelScale,
        first_values: dict[str, int],
        gyro: CountScale | None = None,
        watch: RowWatch | None = None,
    ) -> None:
        self._parser, self._watch = parser, watch
        self._scale = scale
        self._gyro = gyro
        self._last_values = dict(first_values)
        self._next_row = self._bad = 0
        self._first_bad: tuple[int, str] | None = None

    def rows(self, blocks: Iterable[Block], threads: int) -> Iterator[tuple[CsvRows, Block]]:
        """Yield the rows of blocks that follow each other, and each block without its lines.

        Args:
            threads: how many may work at a time.

        Raises:
            UnreadableError: most lines are not rows of the file, or counts are not whole.
        """
        for rows, block, seen in parallel_map(self._rows_of, blocks, threads):
            if rows.bad or self._bad:
                self._refuse_mostly_bad(rows)
            if self._watch is not None:
                self._watch.see(seen, rows.time_us)
            yield self._placed(rows), block

    def _refuse_mostly_bad(self, rows: CsvRows) -> None:
        """Raise UnreadableError once most lines up to one are not rows, however the lines were cut."""
        self._first_bad = self._first_bad or next(iter(rows.bad.items()))
        bad = self._bad + np.cumsum(rows.fault == Fault.LINE)
        number = self._next_row + np.arange(1, len(rows) + 1)
        if ((bad > MOST_BAD) & (2 * bad > number)).any():
            raise not_rows(self._parser.path, *self._first_bad)
        self._bad = int(bad[-1]) if len(bad) else self._bad

    def _placed(self, rows: CsvRows) -> CsvRows:
        """Return the next rows with their number in the file, and values of channels from before them."""
        first, self._next_row = self._next_row, self._next_row + len(rows)
        for name in self._last_values if len(rows) else ():
            values = rows.channels[name]
            np.copyto(values, self._last_values[name], where=values == UNKNOWN)
            self._last_values[name] = int(values[-1])
        return replace(rows, first_row=first)

    def _rows_of(self, block: Block) -> tuple[CsvRows, Block, Any]:
        """Return the rows of a block by themselves, and what the watch saw; this may run in any order."""
        table = self._parser.parse(block)
        self._refuse_fractions(table)
        counts, fault = self._counts(table.values)
        if table.time_us is not None:
            fault[(table.time_us == NO_TIME) & (fault != Fault.EMPTY)] = Fault.MISSING
            fault[table.time_us == IMPOSSIBLE] = Fault.TIME
        channels: Channels = {
            name: CHANNELS[name].channel(table.channels[name]) for name in self._last_values
        }
        if self._gyro is not None and table.rates is not None:
            channels["gyro_counts"], faults = self._gyro.counts(table.rates)
            fault[faults["missing_value"] & (fault == Fault.NONE)] = Fault.MISSING
            fault[faults["out_of_range"] & (fault == Fault.NONE)] = Fault.OUT_OF_RANGE
        if table.bad:
            fault[np.isin(table.line, list(table.bad))] = Fault.LINE
        seen = None if self._watch is None else self._watch.look(block, table)
        rows = CsvRows(0, table.line, counts, fault, table.time_us, channels, bad=table.bad)
        return rows, block.without_lines(), seen

    def _counts(self, values: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        scaled = self._scale.counts(values)
        fault = np.zeros(len(values), np.uint8)
        limit = self._scale.limit
        if len(scaled) and not (scaled.max() <= limit and scaled.min() >= -limit):
            fault[(np.abs(scaled) > limit).any(axis=1)] = Fault.OUT_OF_RANGE
            fault[np.isnan(scaled).any(axis=1)] = Fault.EMPTY
            scaled = np.where((fault == Fault.NONE)[:, None], scaled, 0.0)
        return scaled.astype(np.int32), fault

    def _refuse_fractions(self, table: ParsedTable) -> None:
        """Raise UnreadableError for the first value that should be a whole number of counts."""
        if self._scale.unit == COUNTS:
            self._refuse(table.values, table.line, f"--unit {PHYSICAL_UNITS}")
        if self._gyro is not None and self._gyro.divisor is None and table.rates is not None:
            self._refuse(table.rates, table.line, "--gyro-unit deg/s or rad/s")

    def _refuse(self, values: NDArray[np.float64], line: NDArray[np.int64], option: str) -> None:
        broken = (np.rint(values) != values) & np.isfinite(values)
        if not broken.any():
            return
        row, axis = np.argwhere(broken)[0]
        raise UnreadableError(
            f"{values[row, axis]:g} is not a whole number of counts",
            path=self._parser.path,
            line=int(line[row]),
            hint=f"give the unit of the values with {option}",
        )
