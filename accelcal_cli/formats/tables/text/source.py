"""A text file of numbers as a source of named columns: its encoding, layout, head and blocks of lines."""

from __future__ import annotations

import copy
from collections.abc import Generator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import AccelcalError, UnreadableError, counted, printable
from accelcal_cli.core.formats import WIDE_BYTES, ReadOptions, wide_text
from accelcal_cli.core.recording import CUT_SHORT, Problem, Reader
from accelcal_cli.core.unpacking import packing_of
from accelcal_cli.formats.tables.cells import decode, is_year_first, split_line, year_first
from accelcal_cli.formats.tables.clock import rate_above
from accelcal_cli.formats.tables.header import (
    SAMPLE_ROWS,
    Block,
    Column,
    Cut,
    First,
    Piece,
    Source,
    Start,
    Stated,
    Wanted,
    refuse_doubtful,
)
from accelcal_cli.formats.tables.names import name_of
from accelcal_cli.formats.tables.reader import TableReader, open_table
from accelcal_cli.formats.tables.roles import find_acceleration
from accelcal_cli.formats.tables.siblings import (
    LONGEST_DELAY_S,
    PHYPHOX_HEAD,
    READ_AS,
    WithGyroscope,
    bids_description,
    experiment_start,
    sibling_gyroscope,
)
from accelcal_cli.formats.tables.text.dialect import (
    DEEPEST_BYTES,
    Dialect,
    find_deep_dialect,
    find_dialect,
    names_all_axes,
    numbered_rows,
)
from accelcal_cli.formats.tables.text.lines import (
    InUtf8,
    LineBlock,
    LineCutter,
    LineFile,
    LineParser,
    RepeatedHeads,
    lone_block,
)
from accelcal_cli.formats.tables.vendors import Head, export_description, names_description

HEAD_BYTES = 1 << 20
"""Bytes that are read to understand a file."""

RATE_BYTES = 1 << 14
"""Bytes above the rows that may state the rate."""

TAIL_BYTES = 1 << 16
"""Bytes that are read to find the last row."""

BLOCK_BYTES = 1 << 21
"""Text that is parsed at a time, however many samples are wanted: its table takes as much again."""

NO_LINE_END = "no_line_end"
BROKEN_OFF = "the compressed data ends early or is damaged; the rows before that were read"


class TextSource(Source):
    """A text file of numbers. See `docs/csv-files.md` for what is recognised.

    Raises:
        NoRecordingError: it is the export of a known vendor without raw acceleration.
        UnreadableError: it holds no rows of numbers, or a sidecar is damaged.
    """

    format, place_word = "csv", "line"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path = path
        head = _head(path, HEAD_BYTES)
        stated = bids_description(path) or export_description(head) or Stated()
        refuse_doubtful(stated, options, path)
        head, dialect = _layout(head, stated, path)
        self.dialect, self._above = dialect, head[: dialect.offset]
        text = self._above[-RATE_BYTES:].decode("latin-1")
        if not stated.title:
            stated = described_by_names(dialect, text, path) or stated
            refuse_doubtful(stated, options, path)
        if PHYPHOX_HEAD.match(head) and (begun := experiment_start(path)) is not None:
            zero, pauses = begun
            stated = replace(stated, start=Start(zero), timezone="UTC", counts_from_zero=True, pauses=pauses)
        self.stated = replace(stated, hint_hz=rate_above(text))
        end = head.rfind(b"\n") + 1  # in a file of one unfinished line, that one
        rows = head[dialect.offset : end if end > dialect.offset else len(head)]
        self._first = self._heads().without(lone_block(rows, dialect.skipped + 1, dialect.offset))
        self.row_bytes = len(self._first.data) / max(self._first.lines, 1) or 1.0
        self.has_names, self.comma = dialect.names is not None, dialect.normaliser.comma
        self.names_line, self.first_line = dialect.names_line, dialect.skipped + 1
        self.columns = columns_of(dialect)
        headings = (dialect.names is not stated.names) + (dialect.units is not None)
        above = dialect.skipped - stated.preamble - headings
        said = f"not used: {counted(above, 'line')} above the first row"
        self.width_notes = _notes_on_widths(dialect, self._above)
        self.last_notes = ((said,) if above > 0 else ()) + self.width_notes

    def _heads(self) -> RepeatedHeads:
        return RepeatedHeads(self.path, self._above, self.dialect, self.stated)

    def head(self, _wanted: Wanted) -> LineBlock:
        """See `Source`."""
        return self._first

    def last(self, wanted: Wanted) -> LineBlock | None:
        """Return the last lines; None if the file is compressed, or in UTF-16 or the like."""
        with self.path.open("rb") as file:
            mark = file.read(WIDE_BYTES)
            packed = packing_of(mark) is not None or wide_text(mark) is not None
            if packed or self.dialect.bare_returns:
                return None
            start = max(self.dialect.offset, file.seek(0, 2) - TAIL_BYTES)
            file.seek(start)
            lines = file.read().splitlines(keepends=True)[start > self.dialect.offset :]
        whole = [line for line in lines if line.endswith((b"\n", b"\r")) and line.strip()]
        return lone_block(b"".join(whole), 1, 0)

    def pieces(
        self, wanted: Wanted, samples: int, start: int = 0, stop: int | None = None, threads: int = 1
    ) -> Generator[LineBlock]:
        """See `Source`."""
        dialect, heads = self.dialect, self._heads()
        size = max(1, min(BLOCK_BYTES, int(0.95 * samples * self.row_bytes)))
        with LineFile(self.path, dialect.bare_returns, threads) as file:
            for block in file.blocks(dialect.offset, dialect.skipped + 1, size, dialect.quotes):
                yield self._whole(block, heads)

    def _whole(self, block: LineBlock, heads: RepeatedHeads) -> LineBlock:
        """Return a block without the names of the columns, the last one with a last row without its end."""
        block = replace(heads.without(block), heads=heads.lines, restarts=heads.restarts)
        if not block.last or block.broken or block.zeros or not self.dialect.is_row(block.tail):
            return block
        end = block.end + len(block.tail)
        return replace(block, data=block.data + block.tail + b"\n", lines=block.lines + 1, tail=b"", end=end)

    @cached_property
    def _lines(self) -> LineParser:
        return LineParser(self.path, self.dialect)

    def parse(self, piece: Piece, wanted: Wanted) -> Block:
        """See `Source`."""
        assert isinstance(piece, LineBlock)
        return self._lines.parse(piece, wanted)

    def joined(self, pieces: Sequence[Piece]) -> LineBlock:
        """See `Source`."""
        blocks = [piece for piece in pieces if isinstance(piece, LineBlock)]
        return lone_block(b"".join(block.data for block in blocks), blocks[0].line, blocks[0].offset)

    def cells(
        self, first: First, column: Column, most: int | None = SAMPLE_ROWS
    ) -> list[tuple[str, int | None]]:
        """See `Source`."""
        dialect, number = self.dialect, column.number
        if first.lines is None and most is not None:
            return [*zip(dialect.cells(number), dialect.lines, strict=True)]
        assert isinstance(first.piece, LineBlock)
        lines = first.piece.data.splitlines(keepends=True)
        rows = numbered_rows(lines, dialect.normaliser, first.piece.line, dialect.columns)
        cells: list[tuple[str, int | None]] = [
            (dialect.cell(row, number), line)
            for line, row in rows
            if number < len(row) and (first.lines is None or line in first.lines)
        ]
        return cells[:most]

    def with_date_order(self, column: Column, order: str) -> TextSource | None:
        """Return the file with times that begin with the year; None where they do already."""
        if all(map(is_year_first, self.dialect.cells(column.number))):
            return None
        number = column.number
        sample = tuple(
            (*row[:number], year_first(row[number].encode(), order, True).decode(), *row[number + 1 :])
            for row in self.dialect.sample
        )
        normaliser = replace(self.dialect.normaliser, date_order=order)
        source = copy.copy(self)
        source.dialect = replace(self.dialect, normaliser=normaliser, sample=sample)
        return source

    def end_problems(self, piece: Piece, samples: int, lost_bytes: int) -> tuple[Problem, ...]:
        """Return what is wrong with the end: files that were joined, and a last line that is cut off.

        More is missing unless the last line has all its cells.
        """
        assert isinstance(piece, LineBlock)
        problems, heads, left = [], piece.heads, len(piece.tail) + piece.zeros
        if heads:
            more = f" and {counted(len(heads) - 1, 'more line')}" if len(heads) > 1 else ""
            text = f"the names of the columns are repeated in line {heads[0]}{more}: files that were joined"
            problems.append(Problem("repeated_head", text, None, samples, count=len(heads)))
        code, text = CUT_SHORT, BROKEN_OFF
        if not piece.broken:
            line = piece.line + piece.lines
            text = f"line {line}, the last one, has no end: it may be cut off and was left out"
            code = NO_LINE_END if self.dialect.is_whole(piece.tail) else CUT_SHORT
            if not piece.tail.strip(b"\0"):
                text = f"the file ends in {left} bytes of zeros, which hold no rows"
        if piece.broken or piece.tail.strip() or piece.zeros:
            problems.append(Problem(code, text, piece.end, samples, lost_bytes=left))
        return tuple(problems)

    def intake(self) -> Cut:
        """See `Source`."""
        dialect, heads, in_utf8 = self.dialect, self._heads(), InUtf8()
        cutter = LineCutter(self.path, dialect.offset, dialect.skipped + 1, dialect.quotes)

        def cut(data: bytes, last: bool) -> LineBlock | None:
            data = in_utf8(data)
            lines = cutter.cut([data.replace(b"\r", b"\n") if dialect.bare_returns else data])
            block = cutter.block(lines, last)
            return self._whole(block, heads) if block.data or last else None

        return cut


def _notes_on_widths(dialect: Dialect, above: bytes) -> tuple[str, ...]:
    """Return the note that rows do not have a cell for each name, if that is so.

    Args:
        above: the lines above the rows.
    """
    named, columns = dialect.named, dialect.columns
    cells = split_line(decode(above.rstrip().rpartition(b"\n")[2]), dialect.normaliser.delimiter)
    if dialect.names is None and names_all_axes(cells):
        return (f"the last line above the rows names {len(cells)} columns and they have {columns}: unused",)
    if named in (0, columns):
        return ()
    usual = f"the header names {named} columns and rows usually have {columns}"
    return (f"{usual}: names belong to columns from the left",)


def columns_of(dialect: Dialect) -> tuple[Column, ...]:
    """Return the columns of a layout."""
    names, units = dialect.names or ("",) * dialect.columns, dialect.units or ("",) * dialect.columns
    cells = enumerate(zip(names, units, dialect.kinds, strict=True))
    return tuple(
        Column(number, name_of(name, unit), kind, f"column {number}" + f" ({name!r})" * bool(name), unit)
        for number, (name, unit, kind) in cells
    )


def described_by_names(dialect: Dialect, above: str, path: Path) -> Stated | None:
    """Return what the names of a vendor's columns say; None if no vendor is known by them.

    Args:
        above: the lines above the rows.
    """
    if dialect.names is None:
        return None
    lines = tuple(above.splitlines()[: -1 if above else None])
    return names_description(Head(dialect.names, dialect.cells, lines), path.name)


def _head(path: Path, most_bytes: int) -> bytes:
    with LineFile(path) as file:
        return file.read(most_bytes).rstrip(b"\0")


def _layout(head: bytes, stated: Stated, path: Path) -> tuple[bytes, Dialect]:
    """Return the beginning of a file up to the rows of numbers, and its layout, with names by the export.

    Raises:
        UnreadableError: there are no rows, or a sidecar describes another number of columns.
    """
    dialect = find_dialect(head, stated.preamble)
    if dialect is None:
        head = _head(path, DEEPEST_BYTES)
        dialect = find_deep_dialect(head, stated.preamble)
    if dialect is None:
        what = f"holds no rows of three or more numbers in its first {DEEPEST_BYTES >> 20} MB"
        hint = "check that it holds samples, or name its format with --format"
        raise UnreadableError(what, path=path, line=1, hint=hint)
    names = stated.names or ()
    if stated.companion is not None and len(names) != dialect.columns:
        sidecar = printable(stated.companion.name)
        what = f"has {dialect.columns} columns, and {sidecar} describes {len(names)}"
        hint = "correct that file, or take it away"
        raise UnreadableError(what, path=path, line=dialect.names_line, hint=hint)
    if dialect.named != dialect.columns == len(names):
        dialect = replace(dialect, names=stated.names, named=len(names))
    return head.replace(b"\r", b"\n") if dialect.bare_returns else head, dialect


def refuse_other_names(dialect: Dialect, options: ReadOptions, path: Path) -> None:
    """Raise NoRecordingError for a table whose names are those of other quantities.

    Other faults raise what `find_acceleration` does.
    """
    source = Source()
    source.path, source.columns = path, columns_of(dialect)
    source.stated = described_by_names(dialect, "", path) or Stated()
    refuse_doubtful(source.stated, options, path)
    source.place_word, source.has_names = "line", dialect.names is not None
    source.names_line, source.first_line = dialect.names_line, dialect.skipped + 1
    find_acceleration(source, options, lambda column: dialect.cells(column.number))


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a text file of numbers, with the gyroscope of a phone's export next to it.

    Raises:
        UnreadableError: it holds no rows of numbers, or they can be read in several ways; the
            hint says which option settles it.
        UsageError: an option names no column, or counts come without their scale.
    """
    reader = open_table(TextSource(path, options), options)
    stated = options.gyro_unit is not None or options.gyro_columns is not None or options.columns is not None
    gyro = None if stated else sibling_gyroscope(path)
    if gyro is None or reader.recording.gyro_dps_per_lsb is not None:
        return reader
    read_as = ReadOptions(unit=READ_AS[gyro.unit][0], columns=gyro.columns, gyro_unit="none")
    try:
        rates = open_table(TextSource(gyro.path, read_as), read_as)
    except AccelcalError as error:
        return _noted(reader, f"{gyro.path.name} was not used: {error.message}")
    one, two = reader.recording.start_us, rates.recording.start_us
    apart_us = abs((one or 0) - (two or 0))
    if (one is None) != (two is None) or apart_us > LONGEST_DELAY_S * MICROSECONDS:
        return _noted(reader, f"{gyro.path.name} was not used: it did not begin together with {path.name}")
    return WithGyroscope(reader, rates, gyro.path.name, gyro.unit)


def _noted(reader: TableReader, note: str) -> TableReader:
    """Return a reader whose recording has one more note."""
    reader.recording = replace(reader.recording, notes=(*reader.recording.notes, printable(note)))
    return reader
