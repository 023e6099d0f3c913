"""Reads a text file as blocks of whole lines: a file from its beginning, or one that grows."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from numpy.typing import NDArray

from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import wide_text
from accelcal_cli.core.recording import Closing
from accelcal_cli.core.system import process_is_ours
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._stamps import NO_TIME
from accelcal_cli.formats.tables.cells import BYTE_ORDER_MARK, MISSING, decode, number_of, split_line
from accelcal_cli.formats.tables.header import DECIMAL, As, Block, CellTexts, Piece, Stated, Wanted
from accelcal_cli.formats.tables.text.dialect import (
    QUOTE,
    Dialect,
    Quotes,
    line_ends,
    names_all_axes,
)
from accelcal_cli.formats.tables.values import (
    MOMENTS,
    NO_ROWS,
    NOT_ROWS,
    NULLS,
    STAMPS,
    TYPES,
    UNREAD,
    in_arrow,
    read_as,
    shortened,
    told_of,
    values_of,
    wrong_cell,
)
from accelcal_cli.formats.tables.vendors import export_description

PIECE_BYTES = 1 << 18
"""Bytes taken from the file at a time."""

CACHED_BYTES = 1 << 18
"""Bytes in which line ends are counted at a time."""

LONGEST_LINE = 1 << 20
LINE_END = ord("\n")
MOST_NAMES, HEAD_MARK = 40, re.compile(rb";?[^\d:=,;\t\r\n]{4,60}")
"""Names of columns with which a line may begin, and the first words of a head: they find one again."""

RARE = re.compile(rb"[^\W\d_aefinAEFINTZ]")
"""A letter that numbers and times do not have."""

CUT_THERE = "cut the file before that line, and calibrate each part"


@dataclass(frozen=True, slots=True)
class LineBlock(Piece):
    """Whole lines of a file.

    Attributes:
        data: the lines; lines: how many they are; line: number of the first, from 1.
        tail: the rest of the file behind its last line end; only in the last block.
        end: byte behind its last line end, in the uncompressed stream.
        broken: the compressed data ended early or is damaged.
        zeros: how many bytes of value 0 follow the tail, where they are too many to be kept.
        heads: the lines up to here in which a head stands again.
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
    heads: Sequence[int] = ()
    restarts: Sequence[tuple[int, int]] = ()

    def emptied(self) -> LineBlock:
        """Return the place of the block, without the memory of its lines."""
        return replace(self, data=b"")


def lone_block(data: bytes, line: int, offset: int) -> LineBlock:
    """Return a block of some lines of a file that are looked at by themselves."""
    return LineBlock(data, b"", line, count_lines(data), offset, offset + len(data), 0, False, False)


class LineCutter:
    """Cuts the bytes of a text file, in the pieces in which they come, into blocks of whole lines.

    Args:
        skip: bytes before the first line that is wanted.
        line: number of that line.
        quotes: keep lines over which a cell may reach in one block; None: none does.
    """

    def __init__(self, path: Path, skip: int, line: int, quotes: Quotes | None = None) -> None:
        self._path, self._quotes = path, quotes
        self._skip = self._offset = skip
        self._line = line
        self._rest = self._open = b""
        self._zeros = 0

    def cut(self, pieces: list[bytes]) -> bytes:
        """Return the lines that end in the next pieces; there may be none.

        Raises:
            UnreadableError: a line does not end within 1 MiB.
        """
        if self._skip:
            data = b"".join(pieces)
            pieces = [data[self._skip :]]
            self._skip -= min(self._skip, len(data))
        endless = self._zeros > 0 and any(piece.strip(b"\0") for piece in pieces)
        data = b"".join((self._rest, *pieces))
        whole = data.rfind(b"\n") + 1
        lines, self._rest = data[:whole], data[whole:]
        if len(self._rest) > LONGEST_LINE and not lines:
            text = self._rest.rstrip(b"\0")
            self._zeros, self._rest = self._zeros + len(self._rest) - len(text), text
        if endless or (len(self._rest) > LONGEST_LINE and not lines):
            line, offset = self._line + count_lines(self._open), self._offset + len(self._open)
            raise UnreadableError("a line has no end", path=self._path, line=line, byte_offset=offset)
        if self._quotes is None:
            return lines
        lines = self._open + lines if self._open else lines
        sure = self._quotes.sure_bytes(lines)
        self._open = lines[sure:]
        return lines[:sure]

    def block(self, lines: bytes, last: bool, end_byte: int | None = None, broken: bool = False) -> LineBlock:
        """Return the lines that were cut as a block; `end_byte` is set for a file on the disk."""
        if last:
            lines, self._open = lines + self._open, b""
        line, offset, number = self._line, self._offset, count_lines(lines)
        self._line, self._offset = line + number, offset + len(lines)
        rest, zeros = (self._rest, self._zeros) if last else (b"", 0)
        end = self._offset + len(self._open) + len(self._rest) if end_byte is None else end_byte
        return LineBlock(lines, rest, line, number, offset, self._offset, end, last, broken, zeros)


class InUtf8:
    """Makes UTF-8 of text in UTF-16 and UTF-32; any other text stays as it is."""

    def __init__(self) -> None:
        self._decoder: codecs.IncrementalDecoder | None = None
        self._begun = False

    def __call__(self, piece: bytes) -> bytes:
        """Return the next bytes; the first piece decides."""
        if not self._begun and piece:
            self._begun = True
            if (name := wide_text(piece)) is not None:
                self._decoder = codecs.getincrementaldecoder(name)("replace")
        return piece if self._decoder is None else self._decoder.decode(piece).encode()


class LineFile(Closing):
    """A text file, plain or packed, read once from its beginning."""

    def __init__(self, path: Path, bare_returns: bool = False, threads: int = 1) -> None:
        self._source = ByteSource(path, threads)
        self._bare_returns = bare_returns
        self._in_utf8 = InUtf8()

    def close(self) -> None:
        """Release the file."""
        self._source.close()

    def read(self, count: int) -> bytes:
        """Read `count` bytes, fewer only at the end of the data.

        Raises:
            UnreadableError: the disk fails, or a packed file is damaged there.
        """
        data = b"".join(self._pieces(count))
        self._source.refuse_damaged()
        return data

    def _pieces(self, count: int) -> list[bytes]:
        parts: list[bytes] = []
        while count > 0 and (read := self._source.read(min(count, PIECE_BYTES))):
            part = self._in_utf8(read)
            parts.append(part.replace(b"\r", b"\n") if self._bare_returns else part)
            count -= len(part)
        return parts

    def blocks(
        self, start: int, line: int, block_bytes: int, quotes: Quotes | None = None
    ) -> Iterator[LineBlock]:
        """Yield all lines from byte `start`, which begins line number `line`, about `block_bytes` at a time.

        Raises:
            UnreadableError: a line does not end within 1 MiB, the disk fails, or, after the lines before that
                place, a packed file is damaged.
        """
        cutter, last = LineCutter(self._source.path, start, line, quotes), False
        fresh = self._pieces(start + block_bytes)
        while not last:
            lines = cutter.cut(fresh)
            fresh = self._pieces(block_bytes)
            last = not fresh
            if lines or last:
                block = cutter.block(lines, last, self._source.disk_position(), self._source.broken)
                yield replace(block, last=False) if self._source.damaged else block
        self._source.refuse_damaged()


class RepeatedHeads:
    """Blanks heads that stand among the rows, as where files were joined, and checks what they say.

    Args:
        head: the file up to its first row.
        stated: what that says of the recording.

    Attributes:
        lines: numbers of the lines in which the names stand again, or of the first one of a head.
        restarts: see `Piece`.
    """

    def __init__(self, path: Path, head: bytes, dialect: Dialect, stated: Stated) -> None:
        lines = head.removeprefix(BYTE_ORDER_MARK).splitlines(keepends=True)
        self._path, self._dialect, self._stated, self._head = path, dialect, stated, lines
        has_names = dialect.names is not None and dialect.names_line <= len(lines)
        named = lines[dialect.names_line - 1] if has_names else b""
        self._names = dialect.cells_of(named) if has_names else []
        delimiter = dialect.normaliser.delimiter.encode()
        names = (name.strip() for name in named.split(delimiter)[:MOST_NAMES])
        words = HEAD_MARK.match(lines[0]) if len(lines) > 1 else None
        self._begin = None if words is None else words[0]
        self._marks = [name + delimiter for name in names if name]
        if self._begin is not None:
            self._marks.append(self._begin)
        self._open: list[bytes] | None = None
        self._first = 0
        self.lines: list[int] = []
        self.restarts: list[tuple[int, int]] = []

    def without(self, block: LineBlock) -> LineBlock:
        """Return the block with the same lines, those of a repeated head empty.

        Raises:
            UnreadableError: such a head is that of another device, or of other columns.
        """
        begins = self._begins(block.data)
        if self._open is None and not begins:
            return block
        lines = block.data.splitlines(keepends=True)
        for number, line in enumerate(lines):
            if self._open is not None and (len(self._open) == len(self._head) or self._dialect.fits(line)):
                self._close()
            if self._open is None and number in begins and not self._dialect.fits(line):
                begun = self._begin is not None and line.startswith(self._begin)
                if not begun and not self._are_names(self._dialect.cells_of(line)):
                    continue
                self._open, self._first = [], block.line + number
            if self._open is not None:
                self._open.append(line)
                lines[number] = b"\n"
        if block.last and self._open is not None:
            self._close()
        return replace(block, data=b"".join(lines))

    def _begins(self, data: bytes) -> set[int]:
        """Return the numbers of the lines, from 0, that begin as the head or the names do."""
        places = {0} if data.startswith(tuple(self._marks)) else set()
        for mark in self._marks:
            rare = RARE.search(mark)
            if rare is not None and rare[0] not in data:  # one letter is found much sooner
                continue
            place = -1
            while (place := data.find(b"\n" + mark, place + 1)) >= 0:
                places.add(place + 1)
        return {*np.searchsorted(line_ends(data), [*places]).tolist()}

    def _close(self) -> None:
        """Take the lines of a head that is over."""
        head, self._open = self._open or [], None
        cells = [self._dialect.cells_of(line) for line in head]
        named = [number for number, row in enumerate(cells) if self._are_names(row)]
        line = self._first + (named[0] if named else 0)
        self.lines.append(line)
        if named and (found := cells[named[0]]) != self._names:
            raise self._other_head(line, f"names the columns {', '.join(found)}", ", ".join(self._names))
        stated = export_description(b"".join(head)) or Stated()
        start, zero = self._start_of(stated), self._start_of(self._stated)
        for what, before, after in (
            ("serial number", self._stated.device.serial, stated.device.serial),
            ("rate", self._stated.rate_hz, stated.rate_hz),
            ("unit", self._stated.unit, stated.unit),
            ("scale", self._stated.lsb_per_g, stated.lsb_per_g),
            ("start", iso_time(zero if self._stated.counts_from_zero else None, None), iso_time(start, None)),
            ("line of the serial number", _serial_of(self._head), _serial_of(head)),
        ):
            if None not in (before, after) and before != after:
                raise self._other_head(self._first, f"has the {what} {after}", str(before))
        if start is not None:
            self.restarts.append((self._first + len(head), start))

    def _start_of(self, stated: Stated) -> int | None:
        """Return when a head says that its rows begin [us]; None without, or if its date is unclear."""
        start, order = stated.start, stated.date_order
        if start is None or (start.written is not None and len(start.days(order)) != 1):
            return None
        return start.us(order, self._path)

    def _other_head(self, line: int, found: str, before: str) -> UnreadableError:
        what = f"the head of another recording begins: it {found}, not {before}"
        return UnreadableError(what, path=self._path, line=line, hint=CUT_THERE)

    def _are_names(self, cells: list[str]) -> bool:
        """Return True if cells are the names of the columns in any order, or other names of x, y and z."""
        return len(cells) == len(self._names) and (
            sorted(cells) == sorted(self._names) or names_all_axes(cells)
        )


def _serial_of(head: Sequence[bytes]) -> str | None:
    """Return the line of a head that states a serial number; None without one."""
    found = next((line for line in head if b"serial" in line.lower()), None)
    return None if found is None else decode(found).strip()


def count_lines(data: bytes) -> int:
    """Count line ends; several times as fast as `bytes.count` where lines are short."""
    view = np.frombuffer(data, np.uint8)
    return sum(
        int(np.count_nonzero(view[start : start + CACHED_BYTES] == LINE_END))
        for start in range(0, len(view), CACHED_BYTES)
    )


# Parses blocks of lines into columns of numbers, times and texts, and says which lines are not rows.
#
# pyarrow parses a block at once. Where it meets a cell that it does not understand, it parses all
# cells as texts, and whole columns of these are made numbers and times; the lines of all other cells
# are looked at once more, after every change that lines may need. So damage costs about as much as
# the lines that it is in.

PARSER_BYTES = 1 << 20
"""Text that pyarrow parses at a time."""

if process_is_ours():  # else Arrow starts a thread for signals, and ends the process where it is given none
    pa.enable_signal_handlers(False)

LOST, MENDABLE = -1, -2
"""The places of lines that are not rows: whatever is done, or until every change is made."""


@dataclass(frozen=True, slots=True)
class _Reading:
    """The result of one reading of some lines.

    Attributes:
        place: (n,) where each line that is not blank is in the values; LOST or MENDABLE if it is not a row.
        damaged: there are cells that do not fit their column.
        blank: numbers of those of these lines that hold blanks alone.
        rows: how many entries these have.
        values: by the number of the column; of lines with the right number of cells.
    """

    place: NDArray[np.int64]
    damaged: bool
    blank: Sequence[int]
    rows: int
    values: dict[int, Any]


class LineParser:
    """Parses blocks of a text file; several at a time, on any threads, and in any order."""

    def __init__(self, path: Path, dialect: Dialect) -> None:
        self._path, self._dialect = path, dialect
        self._damaged = False  # the block before was: how a block is read, not what it gives, hangs on it

    def parse(self, block: LineBlock, wanted: Wanted) -> Block:
        """Return some columns, at least one, of the rows of a block; blank lines do not count.

        Raises:
            UnreadableError: no single line is what cannot be parsed.
        """
        lines = _BlockLines(block, self._dialect)
        reading = self._reading(lines.text, wanted, block.line, self._damaged)
        self._damaged = reading.damaged
        first, place = lines.first_of(len(reading.place)), reading.place
        if reading.blank:
            first, place = np.delete(first, reading.blank), np.delete(place, reading.blank)
        values, lost = reading.values, np.flatnonzero(place < 0)
        if not len(lost):
            return Block(lines.numbers(first), values, {})
        parts, rows = [values], np.flatnonzero(place == MENDABLE)
        if len(rows):
            texts = self._dialect.quotes.settled(self._thorough(lines.raw(first[rows])), join=False).text
            again = self._reading(self._dialect.fitted(texts), wanted, block.line, damaged=True)
            if len(again.place) == len(rows):
                parts.append(again.values)
                place[rows] = np.where(again.place < 0, LOST, again.place + reading.rows)
        place = np.maximum(place, LOST)
        values = {column: _picked([part[column] for part in parts], place) for column in wanted}
        lost = np.flatnonzero(place < 0)
        rows = told_of(lost)
        whys = [self._why(line, wanted) for line in self._thorough(lines.raw(first[rows])).split(b"\n")]
        told = dict(zip(rows.tolist(), whys, strict=False))
        return Block(lines.numbers(first), values, dict.fromkeys(lost.tolist(), NOT_ROWS) | told)

    def _thorough(self, lines: Sequence[bytes]) -> bytes:
        """Return lines after every change that lines of the file may need."""
        return replace(self._dialect.normaliser, thorough=True)(b"\n".join([*lines, b""]))

    def _reading(self, text: bytes, wanted: Wanted, line: int, damaged: bool) -> _Reading:
        """Return what the lines of a text give.

        Args:
            line: the number of the first one in the file.
            damaged: it is likely that there are cells that Arrow does not understand.
        """
        ragged: dict[int, int] = {}
        wrong = untidy = NO_ROWS
        normaliser, comma = self._dialect.normaliser, self._dialect.normaliser.comma
        try:
            table = None if damaged else self._table(text, wanted, TYPES, ragged)
        except pa.ArrowException:
            table = None
        if table is not None:
            values = {column: values_of(table[str(column)], how) for column, how in wanted.items()}
        else:
            ragged.clear()
            table = self._table_of_texts(text, wanted, line, ragged)
            values = {}
            for column, how in wanted.items():
                values[column], wrong_here, untidy_here = read_as(table[str(column)], how, comma)
                wrong, untidy = np.append(wrong, wrong_here), np.append(untidy, untidy_here)
        place = np.arange(table.num_rows)
        place[wrong] = LOST if normaliser.date_order is None else MENDABLE
        place[untidy] = MENDABLE
        if ragged:
            place = np.insert(place, np.array([*ragged]) - np.arange(len(ragged)), LOST)
            every = normaliser.delimiter == " " or QUOTE in text
            place[[row for row, cells in ragged.items() if every or cells in self._dialect.widths]] = MENDABLE
        blank = [row for row, cells in ragged.items() if not cells]
        return _Reading(place, len(wrong) > 0, blank, table.num_rows, values)

    def _table_of_texts(self, text: bytes, wanted: Wanted, line: int, ragged: dict[int, int]) -> Any:
        """Return columns as `_table` does, all as texts."""
        try:
            return self._table(text, wanted, UNREAD, ragged)
        except pa.ArrowException as error:
            what, hint = f"the lines from here on cannot be read ({error})", "correct or remove that line"
            raise UnreadableError(what, path=self._path, line=line, hint=hint) from error

    def _table(self, text: bytes, wanted: Wanted, types: Mapping[As, Any], ragged: dict[int, int]) -> Any:
        """Return columns of the lines that have the right number of cells.

        They are in the C library's memory: Arrow's own keeps an eighth more of what was freed.

        Args:
            ragged: takes the numbers of the other lines, from 0 and without blank ones, and how many cells
                each has; 0 for blanks alone.
        """

        def note(row: Any) -> str:
            ragged[row.number - 1] = 0 if row.text.isspace() else row.actual_columns
            return "skip"

        if text.startswith(BYTE_ORDER_MARK):  # Arrow would leave it out, wherever in the file that is
            text = b"\n" + text
        converting = pa_csv.ConvertOptions(
            column_types={str(column): types[how] for column, how in wanted.items()},
            include_columns=[str(column) for column in wanted],
            null_values=NULLS,
            strings_can_be_null=True,
            quoted_strings_can_be_null=True,
            check_utf8=False,  # they are: see `_in_utf8`
            decimal_point="," if self._dialect.normaliser.comma == DECIMAL else ".",
        )
        names = [str(column) for column in range(self._dialect.columns)]
        at_once = PARSER_BYTES if types is TYPES else len(text) + 1
        reading = pa_csv.ReadOptions(column_names=names, block_size=at_once, use_threads=False)
        parsing = pa_csv.ParseOptions(
            delimiter=self._dialect.normaliser.delimiter, newlines_in_values=False, invalid_row_handler=note
        )
        source = pa.BufferReader(text or b"\n")
        return pa_csv.read_csv(source, reading, parsing, converting, memory_pool=pa.system_memory_pool())

    def _why(self, line: bytes, wanted: Wanted) -> str:
        """Return what is wrong with a line that is not a row."""
        text = decode(line.rstrip(b"\r"))
        cells = split_line(text, self._dialect.normaliser.delimiter)
        if len(cells) != self._dialect.columns:
            columns = "1 column" if len(cells) == 1 else f"{len(cells)} columns"
            return f"the line has {columns}, not {self._dialect.columns} ({shortened(text)!r})"
        for column, how in sorted(wanted.items(), key=lambda one: one[0]):
            cell = cells[column].strip()
            if how in (As.TEXT, As.CODES) or cell in MISSING:
                continue
            if how in MOMENTS and not re.match(STAMPS[how is As.ZONED_MOMENT], cell):
                return wrong_cell(column, cells[column], "time")
            if how is As.NUMBER and number_of(cell, self._dialect.normaliser.comma) is None:
                return wrong_cell(column, cells[column], "number")
        return f"the line cannot be read ({shortened(text)!r})"


class _BlockLines:
    """The lines of a block, as they are and as they are parsed.

    Attributes:
        text: for pyarrow.
    """

    def __init__(self, block: LineBlock, dialect: Dialect) -> None:
        self._block = block
        self._raw, self._returns = _with_line_ends(_in_utf8(block.data))
        self._settled = dialect.quotes.settled(dialect.normaliser(self._raw))
        self.text = self._settled.text

    @cached_property
    def _raw_ends(self) -> NDArray[np.int64]:
        return line_ends(self._raw)

    @cached_property
    def _ends(self) -> NDArray[np.int64]:
        return self._raw_ends if self.text is self._raw else line_ends(self.text)

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        """The lines before they were settled, from 0, at which those of the text begin."""
        return self._settled.first_of(len(self._raw_ends))

    def first_of(self, rows: int) -> NDArray[np.int64]:
        """Return the lines, from 0 and before they were settled, at which this number of lines begin.

        These are all that are not blank.
        """
        plain = not len(self._returns) and not len(self._settled.joined)
        if plain and rows == self._block.lines:
            return np.arange(rows)
        starts = np.concatenate([[0], self._ends[:-1] + 1])
        letters = np.frombuffer(self.text + b"\n", np.uint8)
        blank = (starts == self._ends) | ((starts + 1 == self._ends) & (letters[starts] == ord("\r")))
        found: NDArray[np.int64] = self._first[~blank]
        return found

    def numbers(self, lines: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the numbers in the file of lines from 0."""
        numbers = self._block.line + lines
        if len(self._returns):
            numbers -= np.searchsorted(self._returns, lines, side="right")
        return numbers

    def raw(self, lines: NDArray[np.int64]) -> list[bytes]:
        """Return lines as they are in the file, with those that they are joined with."""
        if not len(self._settled.joined):
            return _cut_cells(self._raw, self._raw_ends, lines, lines)
        behind = np.append(self._first[1:], len(self._raw_ends))
        last = behind[np.searchsorted(self._first, lines)] - 1
        found = _cut_cells(self._raw, self._raw_ends, lines, last)
        return [line.replace(b"\r\n", b" ").replace(b"\n", b" ") for line in found]


def _cut_cells(
    text: bytes, ends: NDArray[np.int64], first: NDArray[np.int64], last: NDArray[np.int64]
) -> list[bytes]:
    """Return stretches of lines of a text (n,), each without its last end."""
    starts = np.where(first > 0, ends[first - 1] + 1, 0).tolist()
    return [text[start:end] for start, end in zip(starts, ends[last].tolist(), strict=True)]


def _in_utf8(text: bytes) -> bytes:
    """Return lines in UTF-8; those that are not are taken as Latin-1."""
    if text.isascii():
        return text
    try:
        text.decode()
    except UnicodeDecodeError:
        return b"\n".join(decode(line).encode() for line in text.split(b"\n"))
    return text


def _with_line_ends(text: bytes) -> tuple[bytes, NDArray[np.int64]]:
    """Return a text with line ends for returns that stand alone, and the lines, from 0, behind these."""
    if b"\r" not in text:
        return text, np.empty(0, np.int64)
    letters = np.frombuffer(text, np.uint8)
    alone = letters == ord("\r")
    alone[:-1] &= letters[1:] != ord("\n")
    if not alone.any():
        return text, np.empty(0, np.int64)
    changed = np.where(alone, np.uint8(ord("\n")), letters).tobytes()
    return changed, np.searchsorted(line_ends(changed), np.flatnonzero(alone)) + 1


def _picked(parts: Sequence[Any], place: NDArray[np.int64]) -> Any:
    """Return entries of stretches of a column that follow each other, empty where the place is -1."""
    if isinstance(parts[0], CellTexts):
        codes: dict[str, int] = {}
        own = [[*(codes.setdefault(text, len(codes)) for text in part.texts), -1] for part in parts]
        pairs = zip(own, parts, strict=True)
        joined = [np.array(numbers, np.int32)[part.codes] for numbers, part in pairs]
        return CellTexts(tuple(codes), np.concatenate([*joined, np.full(1, -1, np.int32)])[place])
    if isinstance(parts[0], np.ndarray):
        empty = NO_TIME if parts[0].dtype == np.int64 else np.nan
        return np.concatenate([*parts, np.full(1, empty, parts[0].dtype)])[place]
    texts = pa.concat_arrays([*parts, pa.nulls(1, pa.string())])
    return texts.take(in_arrow(np.where(place < 0, len(texts) - 1, place)))
