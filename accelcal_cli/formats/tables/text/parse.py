"""Parses blocks of lines into columns of numbers, times and texts, and says which lines are not rows.

pyarrow parses a block at once. Where it meets a cell that it does not understand, it parses all cells as
texts, and whole columns of these are made numbers and times; the lines of all other cells are looked at once
more, after every change that lines may need. So damage costs about as much as the lines that it is in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.system import process_is_ours
from accelcal_cli.formats._stamps import NO_TIME
from accelcal_cli.formats.tables.cells import BYTE_ORDER_MARK, MISSING, NUMBER, decode, split_line
from accelcal_cli.formats.tables.header import As, Block, CellTexts, Wanted
from accelcal_cli.formats.tables.text.dialect import Dialect
from accelcal_cli.formats.tables.text.lines import LineBlock
from accelcal_cli.formats.tables.text.quotes import QUOTE
from accelcal_cli.formats.tables.values import (
    MOMENTS,
    NO_ROWS,
    NOT_ROWS,
    NULLS,
    TYPES,
    UNREAD,
    in_arrow,
    is_stamp,
    read_as,
    shortened,
    told_of,
    values_of,
    wrong_cell,
)

PARSER_BYTES = 1 << 20
"""Text that pyarrow parses at a time."""

if process_is_ours():  # else Arrow starts a thread for signals, and ends the process where it is given none
    pa.enable_signal_handlers(False)

LOST, MENDABLE = -1, -2
"""The places of lines that are not rows: whatever is done, and as long as not every change is made."""


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
            again = self._reading(texts, wanted, block.line, damaged=True)
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
        ragged: dict[int, bool] = {}
        wrong = untidy = NO_ROWS
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
                values[column], wrong_here, untidy_here = read_as(table[str(column)], how)
                wrong, untidy = np.append(wrong, wrong_here), np.append(untidy, untidy_here)
        place, normaliser = np.arange(table.num_rows), self._dialect.normaliser
        place[wrong] = LOST if normaliser.date_order is None else MENDABLE
        place[untidy] = MENDABLE
        if ragged:
            place = np.insert(place, np.array([*ragged]) - np.arange(len(ragged)), LOST)
            if normaliser.delimiter == " " or QUOTE in text:
                place[[*ragged]] = MENDABLE
        blank = [number for number, is_blank in ragged.items() if is_blank]
        return _Reading(place, len(wrong) > 0, blank, table.num_rows, values)

    def _table_of_texts(self, text: bytes, wanted: Wanted, line: int, ragged: dict[int, bool]) -> Any:
        """Return columns as `_table` does, all as texts."""
        try:
            return self._table(text, wanted, UNREAD, ragged)
        except pa.ArrowException as error:
            what, hint = f"the lines from here on cannot be read ({error})", "correct or remove that line"
            raise UnreadableError(what, path=self._path, line=line, hint=hint) from error

    def _table(self, text: bytes, wanted: Wanted, types: Mapping[As, Any], ragged: dict[int, bool]) -> Any:
        """Return columns of the lines that have the right number of cells.

        They are in the C library's memory: Arrow's own keeps an eighth more of what was freed.

        Args:
            ragged: takes the numbers of the other lines, from 0 and without blank ones, and whether they hold
                blanks alone.
        """

        def note(row: Any) -> str:
            ragged[row.number - 1] = row.actual_columns == 1 and not row.text.strip(" ")
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
            if not (is_stamp(cell, how is As.ZONED_MOMENT) if how in MOMENTS else NUMBER.fullmatch(cell)):
                return wrong_cell(column, cells[column], "time" if how in MOMENTS else "number")
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
        return _line_ends(self._raw)

    @cached_property
    def _ends(self) -> NDArray[np.int64]:
        return self._raw_ends if self.text is self._raw else _line_ends(self.text)

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
            return _cut(self._raw, self._raw_ends, lines, lines)
        behind = np.append(self._first[1:], len(self._raw_ends))
        last = behind[np.searchsorted(self._first, lines)] - 1
        found = _cut(self._raw, self._raw_ends, lines, last)
        return [line.replace(b"\r\n", b" ").replace(b"\n", b" ") for line in found]


def _cut(
    text: bytes, ends: NDArray[np.int64], first: NDArray[np.int64], last: NDArray[np.int64]
) -> list[bytes]:
    """Return stretches of lines of a text (n,), each without its last end."""
    starts = np.where(first > 0, ends[first - 1] + 1, 0).tolist()
    return [text[start:end] for start, end in zip(starts, ends[last].tolist(), strict=True)]


def _line_ends(text: bytes) -> NDArray[np.int64]:
    """Return the places of the ends of lines, also of a last one without."""
    ends: NDArray[np.int64] = np.flatnonzero(np.frombuffer(text, np.uint8) == ord("\n"))
    return ends if not text or text.endswith(b"\n") else np.append(ends, len(text))


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
    return changed, np.searchsorted(_line_ends(changed), np.flatnonzero(alone)) + 1


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
