"""A text file as blocks of whole lines, and blocks as columns of numbers and times.

Single lines are looked at only where a block cannot be parsed, to name the first bad one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Channels, Closing
from accelcal_cli.core.system import process_is_ours
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._stamps import IMPOSSIBLE
from accelcal_cli.formats.csv.cells import MISSING, Kind, cell_kind
from accelcal_cli.formats.csv.columns import Roles
from accelcal_cli.formats.csv.dialect import BYTE_ORDER_MARK, Dialect, decode, split_line
from accelcal_cli.formats.csv.times import DateColumn, TimeFormat, floats

PIECE_BYTES = 1 << 18
"""Taken from the file at a time."""

PARSER_BYTES = 1 << 20
"""What is parsed at a time."""

if process_is_ours():  # else Arrow starts a thread for signals, and ends the process where it is given none
    pa.enable_signal_handlers(False)

CACHED_BYTES = 1 << 18
LONGEST_LINE = 1 << 20
LINE_END = ord("\n")
BLANKS = (b"\n", b"\r")
DATES = pa.dictionary(pa.int32(), pa.string())
PADDING = frozenset(b" \t\r\n")
SHOWN = 40


@dataclass(frozen=True, slots=True)
class Block:
    """Whole lines of a file.

    Attributes:
        data: the lines.
        tail: the rest of the file behind its last line end; only in the last block.
        line: number of its first line, from 1.
        lines: how many lines `data` has.
        offset: byte at which it begins, in the uncompressed stream.
        end: byte behind its last line end.
        end_byte: how far the file on the disk has been read.
        last: nothing follows.
        broken: the compressed data ended early or is damaged.
        zeros: how many bytes of value 0 follow the tail, where they are too many to be kept.
    """

    data: bytes
    tail: bytes
    line: int
    lines: int
    offset: int
    end: int
    end_byte: int
    last: bool
    broken: bool
    zeros: int = 0

    def without_lines(self) -> Block:
        """Where it lies, without the memory of its lines."""
        return replace(self, data=b"")


def lone_block(data: bytes, line: int, offset: int) -> Block:
    """Some lines of a file, looked at by themselves."""
    return Block(data, b"", line, count_lines(data), offset, offset + len(data), 0, False, False)


class LineFile(Closing):
    """A text file, plain or gzip, read once from its beginning."""

    def __init__(self, path: Path, bare_returns: bool = False, threads: int = 1) -> None:
        self._source = ByteSource(path, threads)
        self._bare_returns = bare_returns

    def close(self) -> None:
        """Release the file."""
        self._source.close()

    def read(self, count: int) -> bytes:
        """`count` bytes, fewer only at the end of the data.

        Raises:
            UnreadableError: the disk fails, or a gzip file is damaged there.
        """
        data = b"".join(self._pieces(count))
        self._source.refuse_damaged()
        return data

    def _pieces(self, count: int) -> list[bytes]:
        parts: list[bytes] = []
        while count > 0 and (part := self._piece(count)):
            parts.append(part)
            count -= len(part)
        return parts

    def _piece(self, most: int) -> bytes:
        piece = self._source.read(min(most, PIECE_BYTES))
        return piece.replace(b"\r", b"\n") if self._bare_returns else piece

    def blocks(self, start: int, line: int, block_bytes: int) -> Iterator[Block]:
        """All lines from byte `start`, which begins line number `line`, about `block_bytes` at a time.

        Raises:
            UnreadableError: a line does not end within 1 MiB, the disk fails, or, after the lines before that
                place, a gzip file is damaged.
        """
        fresh = [b"".join(self._pieces(start + block_bytes))[start:]]
        tail, offset, last, zeros = b"", start, False, 0
        while not last:
            endless = zeros > 0 and any(piece.strip(b"\0") for piece in fresh)
            data, tail = _cut([tail, *fresh])
            fresh = self._pieces(block_bytes)
            last = not fresh
            if len(tail) > LONGEST_LINE and not data:
                text = tail.rstrip(b"\0")
                zeros += len(tail) - len(text)
                tail = text
            if endless or (len(tail) > LONGEST_LINE and not data):
                raise UnreadableError(
                    "a line has no end", path=self._source.path, line=line, byte_offset=offset
                )
            if data or last:
                rest, lines = tail if last else b"", count_lines(data)
                disk, broken = self._source.disk_position(), self._source.broken
                ends = last and not self._source.damaged
                yield Block(data, rest, line, lines, offset, offset + len(data), disk, ends, broken, zeros)
                line += lines
                offset += len(data)
        self._source.refuse_damaged()


class LineCutter:
    """Cuts the bytes of a growing text file into blocks of whole lines."""

    def __init__(self, dialect: Dialect, path: Path) -> None:
        self._path = path
        self._bare_returns = dialect.bare_returns
        self._skip, self._line, self._offset = dialect.offset, dialect.skipped + 1, dialect.offset
        self._rest = b""
        self._zeros = 0

    def cut(self, data: bytes, *, last: bool) -> Block:
        """The lines that end in the next bytes; there may be none.

        Raises:
            UnreadableError: a line does not end within 1 MiB.
        """
        skipped = min(self._skip, len(data))
        self._skip -= skipped
        fresh = data[skipped:].replace(b"\r", b"\n") if self._bare_returns else data[skipped:]
        endless = self._zeros > 0 and fresh.strip(b"\0") != b""
        lines, self._rest = _cut([self._rest, fresh])
        if len(self._rest) > LONGEST_LINE:
            text = self._rest.rstrip(b"\0")
            self._zeros, self._rest = self._zeros + len(self._rest) - len(text), text
        if endless or len(self._rest) > LONGEST_LINE:
            raise UnreadableError(
                "a line has no end", path=self._path, line=self._line, byte_offset=self._offset
            )
        line, offset = self._line, self._offset
        self._line, self._offset = line + count_lines(lines), offset + len(lines)
        rest, zeros = (self._rest, self._zeros) if last else (b"", 0)
        ends = self._offset, self._offset + len(self._rest)
        return Block(lines, rest, line, self._line - line, offset, *ends, last, False, zeros)


class RepeatedHeads:
    """Blanks the names of the columns where they stand again, as between files that were joined.

    Args:
        head: the file up to its first row.

    Attributes:
        lines: numbers of the lines in which the names stand again.
    """

    def __init__(self, head: bytes) -> None:
        self._head = head.removeprefix(BYTE_ORDER_MARK).splitlines(keepends=True)
        self.lines: list[int] = []

    def without(self, block: Block) -> Block:
        """The block with the same lines, those of a repeated head empty."""
        names = self._head[-1] if self._head and not self._head[-1].startswith(BLANKS) else b""
        if not names or names not in block.data:
            return block
        lines = block.data.splitlines(keepends=True)
        for number in range(len(lines)):
            if lines[number] == names:
                self.lines.append(block.line + number)
                self._blank(lines, number)
        return replace(block, data=b"".join(lines))

    def _blank(self, lines: list[bytes], last: int) -> None:
        """Empty a repeated head whose last line is here, as far up as it is the same."""
        for up, line in enumerate(reversed(self._head)):
            if last < up or lines[last - up].removeprefix(BYTE_ORDER_MARK) != line:
                break
            lines[last - up] = b"\n"


def _cut(pieces: list[bytes]) -> tuple[bytes, bytes]:
    """All whole lines of pieces that follow each other, and what is left."""
    for number in reversed(range(len(pieces))):
        piece = pieces[number]
        if cut := piece.rfind(b"\n") + 1:
            whole = b"".join((*pieces[:number], memoryview(piece)[:cut]))
            return whole, b"".join((piece[cut:], *pieces[number + 1 :]))
    return b"", b"".join(pieces)


def count_lines(data: bytes) -> int:
    """How many line ends there are; several times as fast as `bytes.count` where lines are short."""
    view = np.frombuffer(data, np.uint8)
    return sum(
        int(np.count_nonzero(view[start : start + CACHED_BYTES] == LINE_END))
        for start in range(0, len(view), CACHED_BYTES)
    )


@dataclass(frozen=True, slots=True)
class LineCheck:
    """What every line of a file must be: so many columns, numbers in the used ones, a time in one or two."""

    dialect: Dialect
    used: tuple[int, ...]
    time: int | None
    format: TimeFormat | None
    date: DateColumn | None = None

    def bad_line(self, raw: bytes, line: int, path: Path) -> UnreadableError:
        """The error for a cleaned line that cannot be parsed."""
        fault = self._fault(decode(raw)) or f"the line cannot be read ({shortened(decode(raw))!r})"
        return UnreadableError(fault, path=path, line=line, hint="correct or remove that line")

    def _fault(self, text: str) -> str | None:
        """What is wrong with a line, None if nothing is."""
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
            return kind is Kind.MISSING or self.format.is_written_right(cell)
        return kind in (Kind.NUMBER, Kind.MISSING)


def shortened(text: str) -> str:
    """A text short enough for a message."""
    return text if len(text) <= SHOWN else text[:SHOWN] + "..."


def blank_lines_apart(data: bytes) -> NDArray[np.int64]:
    """Numbers, from 0, of the lines of `data` that are not empty."""
    lines = data.splitlines()
    return np.array([number for number, line in enumerate(lines) if line], np.int64)


def _three(table: Any, columns: tuple[int, int, int]) -> NDArray[np.float64]:
    """Three columns of a parsed table, (n, 3)."""
    values = np.empty((table.num_rows, 3))
    for axis, column in enumerate(columns):
        values[:, axis] = floats(table[str(column)])
    return values


@dataclass(frozen=True, slots=True)
class ParsedTable:
    """The columns of a block that are used, one entry a row.

    line: (n,) number in the file. values: (n, 3) float64 in the file's unit, NaN where empty.
    time_us: (n,), or None without a time column. channels: (n,) float64 each, as `values`.
    rates: (n, 3) of a gyroscope, as `values`, or None.
    """

    line: NDArray[np.int64]
    values: NDArray[np.float64]
    time_us: NDArray[np.int64] | None
    channels: Channels
    rates: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class TableParser:
    """What is needed to turn a block of lines into columns."""

    path: Path
    dialect: Dialect
    roles: Roles
    time: TimeFormat | None
    date: DateColumn | None = None

    @property
    def used(self) -> list[int]:
        """The numbers of the columns that are read, but for that of dates alone."""
        time = () if self.roles.time is None else (self.roles.time,)
        return [*self.roles.xyz, *time, *self.roles.channels.values(), *(self.roles.gyro or ())]

    @cached_property
    def _parsing(self) -> Any:
        """How pyarrow cuts lines into cells."""
        delimiter = self.dialect.normaliser.delimiter
        return pa_csv.ParseOptions(delimiter=delimiter, newlines_in_values=False)

    @cached_property
    def _converting(self) -> Any:
        """How pyarrow makes values of cells."""
        return self._converting_times(None if self.time is None else self.time.arrow_type)

    def _converting_times(self, kind: Any) -> Any:
        types = {str(column): pa.float64() for column in self.used}
        if kind is not None:
            types[str(self.roles.time)] = kind
        if self.date is not None:
            types |= {str(self.roles.time): pa.string(), str(self.date.column): DATES}
        return pa_csv.ConvertOptions(
            column_types=types,
            include_columns=list(types),
            null_values=list(MISSING),
            strings_can_be_null=True,
            quoted_strings_can_be_null=True,
        )

    def cells(self, block: Block) -> ParsedTable:
        """The rows of a block's whole lines.

        Raises:
            UnreadableError: a line has a wrong number of columns, or a text where a number belongs.
        """
        data = self.dialect.normaliser(block.data)
        table, data, impossible = self._table(data, block)
        line = block.line + np.arange(table.num_rows, dtype=np.int64)
        if block.lines != table.num_rows:
            line = block.line + blank_lines_apart(data)
        values = _three(table, self.roles.xyz)
        stamps = None if self.time is None else self.time.microseconds(table[str(self.roles.time)])
        if stamps is not None and impossible is not None:
            stamps[impossible] = IMPOSSIBLE
        channels = {name: floats(table[str(column)]) for name, column in self.roles.channels.items()}
        rates = None if self.roles.gyro is None else _three(table, self.roles.gyro)
        return ParsedTable(line, values, stamps, channels, rates)

    def _table(self, data: bytes, block: Block) -> tuple[Any, bytes, NDArray[np.bool_] | None]:
        """The parsed columns, the text that they come from, which has the same lines; impossible times."""
        try:
            return self._parsed(data), data, None
        except pa.ArrowException:
            thorough = replace(self.dialect.normaliser, thorough=True)(block.data)
        try:
            return self._parsed(thorough), thorough, None
        except pa.ArrowException as error:
            if found := self._with_impossible_times(thorough):
                return found[0], thorough, found[1]
            raise self._bad_line(thorough, block.line) from error

    def _with_impossible_times(self, data: bytes) -> tuple[Any, NDArray[np.bool_]] | None:
        """The columns of text with impossible times empty, and where these are; None if more is wrong."""
        if self.time is None or self.time.unit_us is not None:
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

    def _bad_line(self, data: bytes, first_line: int) -> UnreadableError:
        """The error that names the first line of text that cannot be parsed."""
        lines = data.splitlines(keepends=True)
        good, bad = 0, len(lines)
        while bad - good > 1:
            middle = (good + bad) // 2
            good, bad = (middle, bad) if self._is_sound(b"".join(lines[:middle])) else (good, middle)
        check = LineCheck(self.dialect, tuple(self.used), self.roles.time, self.time, self.date)
        return check.bad_line(lines[good].rstrip(b"\r\n"), first_line + good, self.path)

    def _is_sound(self, data: bytes) -> bool:
        try:
            self._parsed(data)
        except pa.ArrowException:
            return self._with_impossible_times(data) is not None
        return True

    def _parsed(self, data: bytes, times_as: Any = None) -> Any:
        """A table, in the C library's memory: Arrow's own keeps an eighth more of what was freed.

        Args:
            times_as: another type for the column of times.
        """
        converting = self._converting if times_as is None else self._converting_times(times_as)
        if PADDING.issuperset(data):
            types = converting.column_types
            return pa.table({name: pa.array([], kind) for name, kind in types.items()})
        names = [str(column) for column in range(self.dialect.columns)]
        reading = pa_csv.ReadOptions(column_names=names, block_size=PARSER_BYTES, use_threads=False)
        pool = pa.system_memory_pool()
        table = pa_csv.read_csv(pa.BufferReader(data), reading, self._parsing, converting, memory_pool=pool)
        return table if self.date is None else self._with_moments(table, times_as)

    def _with_moments(self, table: Any, times_as: Any) -> Any:
        """A table with dates and times of day joined in the column of the latter."""
        assert self.date is not None and self.time is not None
        name = str(self.roles.time)
        moments = self.date.moments(table[str(self.date.column)], table[name])
        column = moments.cast(times_as or self.time.arrow_type)
        return table.set_column(table.schema.get_field_index(name), name, column)
