"""The layout of a text file of numbers: delimiter, decimals, the first row, the names of the columns.

`Normaliser` rewrites blocks of lines so that pyarrow's parser understands them. Lines stay lines.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.formats import HEAD_BYTES, is_text
from accelcal_cli.core.vocabulary import acceleration_unit
from accelcal_cli.formats.tables.cells import (
    BYTE_ORDER_MARK,
    COMMA_NUMBER,
    POINT_NUMBER,
    cell_kind,
    column_kind,
    decode,
    is_unit_cell,
    least_of,
    number_of,
    plain_number,
    split_line,
    year_first,
)
from accelcal_cli.formats.tables.header import BETWEEN_GROUPS, DECIMAL, UNKNOWN, Kind
from accelcal_cli.formats.tables.names import AXES, name_of

# Quotes in lines of text: one grammar, RFC 4180, before whatever splits them into cells.
#
# A cell that begins with a quote lasts to its closing quote; in between, two quotes are one, and
# delimiters and line ends are text. A quote elsewhere is a letter. Parsers that meet an opening quote
# without its closing one take all that follows for its cell; `Quotes.settled` leaves them none, so
# that it costs at most its own line.

MOST_JOINED = 64
"""Lines behind the first one over which a cell in quotes may reach."""

QUOTE, LETTER = b'"', b"'"
LINE_END, RETURN = b"\n\r"
NO_LINES = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class Settled:
    """Lines in each of which every opening quote has its closing one.

    Attributes:
        text: as many bytes as before; a line end within a cell is a blank, and a quote that is never closed
            an apostrophe.
        joined: (n,) numbers, from 0, of the lines whose ends became blanks.
    """

    text: bytes
    joined: NDArray[np.int64]

    def first_of(self, lines: int) -> NDArray[np.int64]:
        """Return the number of the line, of all before they were settled, at which each line begins."""
        first = np.arange(lines, dtype=np.int64)
        return np.delete(first, self.joined + 1) if len(self.joined) else first


@dataclass(frozen=True)
class Quotes:
    """The quotes of one file.

    Attributes:
        normaliser: changes lines as they are changed before they are parsed.
        delimiter: between the columns.
        columns: the number of cells of a row.
    """

    normaliser: Callable[[bytes], bytes]
    delimiter: str
    columns: int

    @cached_property
    def _mark(self) -> bytes:
        return self.delimiter.encode()

    def settled(self, text: bytes, join: bool = True) -> Settled:
        """Return normalised lines with their quotes settled.

        A line that a quote leaves open is joined with the next ones, at most `MOST_JOINED`, if these close
        the cell and give a row, and are not rows by themselves.

        Args:
            join: the lines follow each other in the file.
        """
        if QUOTE not in text:
            return Settled(text, NO_LINES)
        lines, out, joined = _Lines(text), bytearray(text), list[int]()
        for first, found in self._open_lines(lines, join):
            last = first if found is None else found
            joined += range(first, last)
            for end in lines.ends[first:last].tolist():
                begin = end - (text[end - 1] == RETURN)
                out[begin : end + 1] = b" " * (end + 1 - begin)
            if first == last:
                (start, stop), line = lines.bounds(first), lines[first]
                while (place := self._open_quote(line)[0]) >= 0:
                    line = line[:place] + LETTER + line[place + 1 :]
                out[start:stop] = line
        return Settled(bytes(out), np.array(joined, np.int64))

    def sure_bytes(self, lines: bytes) -> int:
        """Return how many bytes of whole lines, from the first, can be settled without the next ones."""
        tail = len(lines)
        for _ in range(MOST_JOINED + 1):
            tail = lines.rfind(b"\n", 0, max(tail, 0))
        if QUOTE not in lines[tail + 1 :]:
            return len(lines)
        for first, last in self._open_lines(_Lines(self.normaliser(lines)), join=True):
            if last is None:
                return _Lines(lines).bounds(first)[0]
        return len(lines)

    def _open_lines(self, lines: _Lines, join: bool) -> Iterator[tuple[int, int | None]]:
        """Yield each line that a quote leaves open, and the line in which its cell ends: itself if in none.

        The latter is None where the lines end before that shows.
        """
        last = -1
        for line in self._doubtful(lines).tolist():
            if line > last and self._open_quote(lines[line])[0] >= 0:
                found = self._last_line(lines, line) if join else line
                yield line, found
                last = line if found is None else found

    def _last_line(self, lines: _Lines, first: int) -> int | None:
        parts = [lines[first]]
        for line in range(first + 1, min(first + MOST_JOINED + 1, len(lines))):
            parts.append(lines[line])
            if QUOTE in parts[-1]:
                place, cells = self._open_quote(b" ".join(parts))
                if place < 0:
                    fits = cells == self.columns and not (self._is_row(parts[0]) and self._is_row(parts[-1]))
                    return line if fits else first
            if self._is_row(parts[-1]):
                return first
        return first if first + MOST_JOINED < len(lines) else None

    def _is_row(self, line: bytes) -> bool:
        """Return True if a line has the cells of a row, by its quotes or without regard to them."""
        place, cells = self._open_quote(line)
        return line.count(self._mark) + 1 == self.columns or (place < 0 and cells == self.columns)

    def _open_quote(self, line: bytes) -> tuple[int, int]:
        """Return the place of the quote that a line does not close, -1 if there is none, and its cells."""
        place, cells = 0, 1
        while True:
            if line.startswith(QUOTE, place):
                begin, place = place, _behind_closing(line, place + 1)
                if place < 0:
                    return begin, cells
            place = line.find(self._mark, place) + 1
            if not place:
                return -1, cells
            cells += 1

    def _doubtful(self, lines: _Lines) -> NDArray[np.int64]:
        """Return the lines whose quotes are not simply one before, and one behind a cell, or doubled."""
        view = np.frombuffer(lines.text, np.uint8)
        quotes = np.flatnonzero(view == QUOTE[0])
        before = np.searchsorted(quotes, lines.ends)
        number = np.diff(before, prepend=0)
        line = np.repeat(np.arange(len(number)), number)
        opens = (np.arange(len(quotes)) - np.repeat(before - number, number)) % 2 == 0
        neighbours = np.frombuffer(b"\n" + lines.text + b"\n", np.uint8)
        beside = np.where(opens, neighbours[quotes], neighbours[quotes + 2])
        right = np.isin(beside, np.frombuffer(b'\n"' + self._mark, np.uint8))
        right |= ~opens & (beside == RETURN)
        doubtful = number % 2 == 1
        doubtful[line[~right]] = True
        return np.flatnonzero(doubtful)


class _Lines:
    """Lines of a text by their number, without their ends."""

    def __init__(self, text: bytes) -> None:
        self.text, self.ends = text, line_ends(text)

    def __len__(self) -> int:
        return len(self.ends)

    def bounds(self, line: int) -> tuple[int, int]:
        """Return where a line begins, and where its end is."""
        return int(self.ends[line - 1]) + 1 if line else 0, int(self.ends[line])

    def __getitem__(self, line: int) -> bytes:
        start, stop = self.bounds(line)
        return self.text[start:stop]


def line_ends(text: bytes) -> NDArray[np.int64]:
    """Return the places of the ends of lines, also of a last one without."""
    ends: NDArray[np.int64] = np.flatnonzero(np.frombuffer(text, np.uint8) == LINE_END)
    return ends if not text or text.endswith(b"\n") else np.append(ends, len(text))


def _behind_closing(line: bytes, place: int) -> int:
    """Return the place behind the next quote that is not doubled, -1 if there is none."""
    while (place := line.find(QUOTE, place)) >= 0:
        if not line.startswith(QUOTE, place + 1):
            return place + 1
        place += 2
    return -1


# The layout of a text file of numbers.

DELIMITERS = (",", ";", "\t", "|", " ")
COMMENT = re.compile(r"^\s*(#+|%+|//)\s*([\w ()]+:=\s*)?")
LABEL = re.compile(r"\s*[;#%]+\s*(headers?|columns?|names?|fields?|labels?)\b", re.IGNORECASE)
"""The word before the names of columns in a comment."""

SPLIT_DATE = re.compile(rb"(\d{4}[-/]\d\d[-/]\d\d) (?=\d\d:\d\d)")
SLASH_DATE = re.compile(rb"(?:^|[^\d/])\d{4}/\d\d/\d\d[ T]")
COLON_FRACTION = re.compile(rb":(?<=\d:)(?<!\d\d\d:)\d\d:\d\d:\d{1,9}(?!\d|:)")
HALF_OF_THE_DAY = re.compile(rb"(?<=\d) (?=[AaPp]\.?[Mm])")
"""The blank between a time of day and AM or PM."""

DECIMALS_IN_QUOTES = re.compile(rb'"[^\d",]{0,3}(?![1-9]\d{0,2},\d{3}")\d*,\d+"')
"""A number with a comma that does not stand before a group of three digits."""

SECONDS = re.compile(rb"\d:\d\d:\d\d(?!\d|:)")
COMMA_FRACTION = re.compile(rb"(:\d\d),(\d{3}|\d{6})(?=,)")
"""Decimals of seconds behind a comma, as Python's logging writes them, between commas."""

COLON, COMMA, POINT, SLASH, HYPHEN = b":,./-"
TAB_TO_BLANK = bytes.maketrans(b"\t", b" ")
TAIL_LINES = 40
"""Last lines of the head by which the delimiter is judged."""

SURE_LINES = 6
"""With fewer lines to judge by, most columns must be numbers, and half of all lines must agree."""

SAMPLE_ROWS = 200
SURE_ROWS, LEAST_ROWS = 3, 10
"""Rows below which a layout is doubtful, and from which on it holds whatever lines are below."""

DEEPEST_BYTES = 1 << 24
"""Bytes of text in which rows of numbers must begin."""

DEEP_TRIALS = 9
"""Places with numbers that are tried; the steps between them double, so that they span all of it."""

NUMBERS = re.compile(
    rb"(?m)(?:[,;\t| ] ?[-+]?\d{0,20}[.,]?\d{1,20}(?:[eE][-+]?\d{1,3})?\"?){2}[,;\t| \"]{0,9}\r?$"
)
"""The end of a line: two numbers behind another column."""


@dataclass(frozen=True, slots=True)
class Normaliser:
    """Makes the changes that a block of lines needs before it is parsed.

    Attributes:
        delimiter: between the columns; a blank stands for any run of blanks and tabs.
        padded: blanks stand around the delimiter.
        split_date: date and time of day are separated by the delimiter itself.
        comma: what a comma alone in its numbers becomes.
        slash_dates: dates are written 2024/03/04.
        colon_fraction: a colon stands before the decimals of seconds.
        comma_fraction: a comma stands before them, and between the columns.
        date_order: of day, month and year, such as `dmy`, where dates do not begin with the year.
        thorough: look at every line for what differs from the others.
    """

    delimiter: str
    padded: bool = False
    split_date: bool = False
    comma: str = UNKNOWN
    slash_dates: bool = False
    colon_fraction: bool = False
    comma_fraction: bool = False
    date_order: str | None = None
    thorough: bool = False

    def __call__(self, block: bytes) -> bytes:
        """Return the block in pyarrow's terms, with the same lines in the same order."""
        if self.delimiter == " ":
            block = trimmed(collapsed(block.translate(TAB_TO_BLANK)), b"\n")
            block = HALF_OF_THE_DAY.sub(b"", block) if b"M" in block or b"m" in block else block
        elif self.padded or self.thorough:
            block = trimmed(trimmed(collapsed(block), self.delimiter.encode()), b"\n")
        block = self._with_times(block)
        return with_hyphens(block) if self.slash_dates else block

    def _with_times(self, block: bytes) -> bytes:
        """Return the block with dates, hours and fractions of seconds as in ISO 8601."""
        if self.comma_fraction:
            block = COMMA_FRACTION.sub(rb"\1.\2", block)
        if self.date_order is not None:
            block = year_first(block, self.date_order, self.thorough)
        if self.split_date:
            block = SPLIT_DATE.sub(rb"\1T", block)
        if self.colon_fraction:
            block = with_points(block, COLON)
        if self.comma == DECIMAL and self.delimiter != ",":
            block = with_points(block, COMMA)
        return block


def collapsed(block: bytes) -> bytes:
    """Replace runs of blanks by one blank."""
    while b"  " in block:
        block = block.replace(b"  ", b" ")
    return block


def with_points(block: bytes, mark: int) -> bytes:
    """Rewrite `12:34:56:789` or `12:34:56,789` as `12:34:56.789`."""
    if b":" not in block:
        return block
    text = np.frombuffer(block, np.uint8).copy()
    colon = text == COLON
    text[6:][(text[6:] == mark) & colon[3:-3] & colon[:-6]] = POINT
    return text.tobytes()


def with_hyphens(block: bytes) -> bytes:
    """Rewrite `2024/03/04` as `2024-03-04`."""
    text = np.frombuffer(block, np.uint8).copy()
    first = np.flatnonzero((text[:-3] == SLASH) & (text[3:] == SLASH))
    text[first] = text[first + 3] = HYPHEN
    return text.tobytes()


def trimmed(block: bytes, mark: bytes) -> bytes:
    """Remove single blanks before and after the mark, and at either end."""
    block = block.replace(b" \r\n", b"\n") if mark == b"\n" else block
    return block.replace(b" " + mark, mark).replace(mark + b" ", mark).strip(b" ")


@dataclass(frozen=True, slots=True)
class Dialect:
    """The layout of a text file, as its first 64 KiB show it.

    Attributes:
        normaliser: makes blocks of it readable for pyarrow.
        kinds: of each column.
        names: of the columns, None if no line names them.
        units: from a line of units below the names, None if there is none.
        names_line: that of the names, or of the first row if there are none; from 1.
        sample: cells of the first rows.
        lines: of the sample's rows.
        skipped: lines before the first row.
        offset: byte at which the first row begins.
        bare_returns: lines end with a carriage return alone.
        named: how many columns the line of names has, the rows of which may end sooner or later.
        widths: other numbers of cells that rows have.
    """

    normaliser: Normaliser
    kinds: tuple[Kind, ...]
    names: tuple[str, ...] | None
    units: tuple[str, ...] | None
    names_line: int
    sample: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    skipped: int
    offset: int
    bare_returns: bool
    named: int
    widths: frozenset[int]

    @property
    def columns(self) -> int:
        """The number of columns in every row."""
        return len(self.kinds)

    @property
    def quotes(self) -> Quotes:
        """The rule of quotes."""
        return Quotes(self.normaliser, self.normaliser.delimiter, self.columns)

    def is_whole(self, line: bytes) -> bool:
        """Return True if a line without its end has a cell in every column."""
        cells = self.normaliser(line + b"\n").rstrip(b"\n").split(self.normaliser.delimiter.encode())
        return len(cells) >= self.columns and bool(cells[-1].strip(b"\0 \r"))

    def is_row(self, line: bytes) -> bool:
        """Return True if a line without its end is a row that does not look as if it were cut off."""
        if not self.is_whole(line) or line.count(b'"') % 2:
            return False
        cells = self.cells_of(line)
        above = [row[-1].strip() for row in self.sample]
        decimals = [len(cell.replace(",", ".").partition(".")[2]) for cell in (cells[-1], *above)]
        longer = len(cells[-1]) >= min(map(len, above)) and decimals[0] >= min(decimals[1:])
        return longer and self.fits(line)

    def cells_of(self, line: bytes) -> list[str]:
        """Return the cells of a line without blanks around them."""
        text = decode(self.normaliser(line)).strip("\r\n")
        return [cell.strip() for cell in split_line(text, self.normaliser.delimiter)]

    def fits(self, line: bytes) -> bool:
        """Return True if a line has a cell for each column, of its kind."""
        cells = self.cells_of(line)
        return len(cells) == self.columns and have_kinds(cells, self.kinds)

    def cells(self, column: int) -> list[str]:
        """Return the sample's cells of one column."""
        return [self.cell(row, column) for row in self.sample]

    def cell(self, row: Sequence[str], column: int) -> str:
        """Return a cell of a row, numbers without the marks that people write in them."""
        is_number = self.kinds[column] is Kind.NUMBER
        return plain_number(row[column], self.normaliser.comma) if is_number else row[column]

    def fitted(self, lines: bytes) -> bytes:
        """Return lines with a cell for each column, those that rows may have more or fewer of."""
        if not self.widths:
            return lines
        return b"\n".join(map(self._fitted, lines.split(b"\n")))

    def _fitted(self, line: bytes) -> bytes:
        mark = self.normaliser.delimiter
        cells = split_line(decode(line), mark)
        if len(cells) not in self.widths:
            return line
        quoted = (
            one if mark not in one and '"' not in one else '"' + one.replace('"', '""') + '"'
            for one in fitted(cells, self.columns)
        )
        return mark.join(quoted).encode()


def fitted(cells: Sequence[str], columns: int) -> list[str]:
    """Return the cells of a row for these columns, from the left: those that it lacks are empty."""
    return [*cells[:columns], *[""] * (columns - len(cells))]


def have_kinds(cells: Sequence[str], kinds: Sequence[Kind]) -> bool:
    """Return True if cells hold a number or time, or nothing, wherever their columns have one."""
    return all(
        cell_kind(cell) in (kind, Kind.MISSING)
        for cell, kind in zip(cells, kinds, strict=True)
        if kind in (Kind.NUMBER, Kind.TIME)
    )


def find_dialect(head: bytes, preamble: int = 0) -> Dialect | None:
    """Return the layout of the file with this beginning, None if it shows no rows of 3 or more numbers.

    A last line without its end is used only where nothing else is there.

    Args:
        preamble: lines that are known to be neither rows nor names of columns.
    """
    head = head[:HEAD_BYTES]
    if not is_text(head):
        return None
    bare_returns = b"\n" not in head and b"\r" in head
    if bare_returns:
        head = head.replace(b"\r", b"\n")
    whole = head[: head.rfind(b"\n") + 1]
    found = _dialect_of(whole, preamble) or _dialect_of(head, preamble)
    if found is None or len(found.sample) < SURE_ROWS:  # the last lines of a short file may be others
        lines = whole.splitlines(keepends=True)
        above = (_dialect_of(b"".join(lines[:-left_out]), preamble) for left_out in (1, 2, 3, 4, 6, 8))
        found = next((one for one in above if one is not None and len(one.sample) >= LEAST_ROWS), found)
    return replace(found, bare_returns=bare_returns) if found else None


def find_deep_dialect(text: bytes, preamble: int = 0) -> Dialect | None:
    """Return the layout of a file whose numbers begin behind the first 64 KiB; None if none are found.

    What is looked at is the beginning, where the names may stand and rows without values, and the stretch in
    which lines of numbers begin.
    """
    if b"\n" not in text:
        text = text.replace(b"\r", b"\n")
    top = text[: text.rfind(b"\n", 0, HEAD_BYTES // 2) + 1]
    place = len(top)
    for trial in range(DEEP_TRIALS):
        found = next((one for one in NUMBERS.finditer(text, place) if not _is_comment(text, one)), None)
        if found is None:
            return None
        start = max(len(top), text.rfind(b"\n", 0, max(found.start() - HEAD_BYTES // 8, 0)) + 1)
        stretch = text[start : start + HEAD_BYTES // 2]
        stretch = stretch[: stretch.rfind(b"\n") + 1] or stretch
        if not (is_text(top) and is_text(stretch)):
            return None
        if (dialect := _dialect_of(top + stretch, preamble)) is not None:
            if dialect.offset < len(top):
                return dialect
            skipped = text.count(b"\n", len(top), start)
            return replace(
                dialect,
                offset=dialect.offset + start - len(top),
                lines=tuple(line + skipped for line in dialect.lines),
                skipped=dialect.skipped + skipped,
                names_line=dialect.names_line + skipped,
            )
        last, place = place, min(found.end() + (len(stretch) << trial), len(text) - len(stretch))
        if place <= last:
            return None
    return None


def _is_comment(text: bytes, found: re.Match[bytes]) -> bool:
    line = text[text.rfind(b"\n", 0, found.start()) + 1 : found.start()]
    return COMMENT.match(decode(line)) is not None


def _dialect_of(head: bytes, preamble: int) -> Dialect | None:
    mark = len(BYTE_ORDER_MARK) if head.startswith(BYTE_ORDER_MARK) else 0
    lines = head[mark:].splitlines(keepends=True)
    raw_lines, offset = lines[preamble:], mark + sum(map(len, lines[:preamble]))
    normalisers = _normalisers(b"".join(raw_lines))
    tails = [min(TAIL_LINES, len(raw_lines) // 2 or len(raw_lines))]
    while len(raw_lines) < 2 * TAIL_LINES and tails[-1] > 1:  # the beginning of a short file may be text
        tails.append(tails[-1] // 2)
    for tail in tails:
        layouts = [_DelimiterTrial.of(raw_lines, normaliser, tail) for normaliser in normalisers]
        best = max(layouts, key=lambda layout: layout.score)
        least = 0.0 if tail >= SURE_LINES else 0.5
        if best.score > least and (dialect := best.dialect(offset)):
            return replace(
                dialect, skipped=dialect.skipped + preamble, names_line=dialect.names_line + preamble
            )
    return None


@dataclass(frozen=True, slots=True)
class _DelimiterTrial:
    """One delimiter, tried on the last lines of a head.

    Attributes:
        kinds: of the columns; none where the lines have too few.
        is_sure: nearly all lines have as many cells; else a line has to name x, y and z.
    """

    raw_lines: list[bytes]
    normaliser: Normaliser
    kinds: tuple[Kind, ...]
    is_sure: bool

    @classmethod
    def of(cls, raw_lines: list[bytes], normaliser: Normaliser, tail: int) -> _DelimiterTrial:
        """Try a delimiter on the last lines that are not blank.

        A comma is treated as that of decimals where these say so, or are whole numbers throughout: a
        recording may begin with hours of zeros; only commas can then follow that are not understood.
        """
        delimiter, rows = normaliser.delimiter, _last_rows(raw_lines, normaliser, tail)
        width, is_sure = _width_of(rows)
        if width < 3:
            return cls(raw_lines, normaliser, (), False)
        rows = [row[:width] for row in rows if len(row) == width or (len(row) > width and not is_sure)]
        kinds = _column_kinds(rows, 0.9)
        if Kind.MISSING in kinds or tail < SURE_LINES:
            share = 0.5 if tail < SURE_LINES else 0.9
            everywhere = [row for row in _rows(raw_lines, normaliser) if len(row) == width]
            kinds = _column_kinds(everywhere, share)
        cells = [cell.strip() for row in rows for cell in row]
        if delimiter != ",":
            commas = any(map(COMMA_NUMBER.fullmatch, cells)) or not any(map(POINT_NUMBER.fullmatch, cells))
            normaliser = replace(normaliser, comma=DECIMAL if commas else UNKNOWN)
        return cls(raw_lines, normaliser, kinds, is_sure)

    @property
    def score(self) -> float:
        if self.kinds.count(Kind.NUMBER) < 3:
            return 0.0
        return sum(kind in (Kind.NUMBER, Kind.TIME) for kind in self.kinds) / len(self.kinds)

    def dialect(self, offset: int) -> Dialect | None:
        """Return the full layout of lines from this byte on, None if no run of rows begins anywhere."""
        first = self._first_row()
        if first is None:
            return None
        first = self._first_below_names(first)
        below = self.raw_lines[first : first + SAMPLE_ROWS]
        sample, columns = numbered_rows(below, self.normaliser, first + 1, len(self.kinds)), len(self.kinds)
        names, units, names_line = self._names(first, [row for _, row in sample if len(row) == columns])
        if names is not None:  # a line with a damaged cell does not hide the rows above it
            between = range(names_line + (units is not None), first)
            first = next(filter(self._is_row_line, between), first)
            below = self.raw_lines[first : first + SAMPLE_ROWS]
            sample = numbered_rows(below, self.normaliser, first + 1, columns)
        named = 0 if names is None else len(names)
        if not self.is_sure and named < columns:
            return None
        widths = self._widths([len(row) for _, row in sample], named)
        whole = [
            (line, tuple(fitted(row, columns)))
            for line, row in sample
            if len(row) == columns or len(row) in widths
        ]
        fitting = [(line, row) for line, row in whole if have_kinds(row, self.kinds)]
        lines, rows = zip(*(fitting or whole), strict=True)
        offset += sum(map(len, self.raw_lines[:first]))
        names, units = (None if one is None else tuple(fitted(one, columns)) for one in (names, units))
        return Dialect(
            normaliser=self.normaliser, kinds=self.kinds, names=names, units=units, names_line=names_line,
            sample=rows, lines=lines, skipped=first, offset=offset, bare_returns=False, named=named,
            widths=widths,
        )  # fmt: skip

    def _widths(self, found: Sequence[int], named: int) -> frozenset[int]:
        """Return other numbers of cells that rows have: up to that of the names, or those of many rows."""
        columns, numbers = len(self.kinds), Counter(found)
        least = max(2, 0.05 * len(found))  # one is damage
        shorter = {width for width in numbers if 3 <= width < columns and numbers[width] >= least}
        return frozenset({*range(columns + 1, named + 1), *(shorter if named else ())})

    def _first_row(self) -> int | None:
        """Return the first of three rows that follow each other, or of the last ones."""
        run: list[int] = []
        for number, line in enumerate(self.raw_lines):
            for row in _rows([line], self.normaliser):
                cells = row if self.is_sure else fitted(row, len(self.kinds))
                run = [*run, number] if self._is_row(cells) else []
            if len(run) == 3:
                break
        return run[0] if run else None

    def _first_below_names(self, first: int) -> int:
        """Return the line below that of the names, if only rows of more or fewer cells are between."""
        columns, number = len(self.kinds), first - 1
        while number >= 0:
            row = next(iter(_rows([self.raw_lines[number]], self.normaliser)), [])
            if not row or not self._is_row(fitted(row, columns)):
                break
            number -= 1
        names_axes = number >= 0 and names_all_axes(self._cells(number))
        return number + 1 if names_axes else first

    def _is_row_line(self, number: int) -> bool:
        rows = _rows([self.raw_lines[number]], self.normaliser)
        return any(self._is_row(row if self.is_sure else fitted(row, len(self.kinds))) for row in rows)

    def _is_row(self, row: list[str]) -> bool:
        if len(row) != len(self.kinds):
            return False
        pairs = zip(row, self.kinds, strict=True)
        found = {(kind, cell_kind(cell)) for cell, kind in pairs if kind in (Kind.NUMBER, Kind.TIME)}
        filled = any(kind is other for kind, other in found)
        return filled and all(other in (kind, Kind.MISSING) for kind, other in found if kind is Kind.NUMBER)

    def _names(
        self, first: int, sample: Sequence[list[str]]
    ) -> tuple[tuple[str, ...] | None, tuple[str, ...] | None, int]:
        """Return the names, the units if a second line below them gives these, and the line of the names.

        They are the last line above the rows that can be names; one with others below it names x, y and z.
        """
        above = [number for number in range(first) if self.raw_lines[number].strip()]
        for before, number in reversed([*pairwise([-1, *above])]):
            found = self._heading(number, sample)
            names = self._heading(before, sample) if found and before >= 0 and _are_units(found) else None
            if names is not None and (number == above[-1] or names_all_axes(names)):
                return names, found, before + 1
            if found is not None and (number == above[-1] or names_all_axes(found)):
                return found, None, number + 1
        return None, None, first + 1

    def _heading(self, number: int, sample: Sequence[list[str]]) -> tuple[str, ...] | None:
        """Return a line's cells if they can be names, none a number: of all columns but one, or of more.

        Names belong to columns from the left, except where the first one has none and counts the rows.
        """
        cells, columns = self._cells(number), len(self.kinds)
        if len(cells) == columns + 1 and LABEL.match(decode(self.raw_lines[number])):
            cells = cells[1:]
        if len(cells) == columns - 1 and _is_shifted(cells, sample, self.kinds):
            cells = ["", *cells]
        elif len(cells) < columns - 1 or (len(cells) > columns and not names_all_axes(cells)):
            return None
        kinds = {*map(cell_kind, cells)}
        words = Kind.TEXT in kinds and Kind.NUMBER not in kinds
        return tuple(cells) if words else None

    def _cells(self, number: int) -> list[str]:
        """Return the cells of a line above the rows."""
        text = COMMENT.sub("", decode(self.raw_lines[number])).strip("\r\n")
        if self.normaliser.delimiter == " ":
            text = " ".join(text.split())
        return [cell.strip() for cell in split_line(text, self.normaliser.delimiter)]


def _width_of(rows: Sequence[list[str]]) -> tuple[int, bool]:
    """Return how many cells nearly all rows have or exceed, 0 without such, and True if none exceeds."""
    widths = Counter(map(len, rows))
    width, number = widths.most_common(1)[0] if widths else (0, 0)
    least = least_of(len(rows), 0.9)
    if number >= least:
        return width, True
    usual = [width for width in widths if widths[width] >= 0.05 * len(rows)]
    width = min(usual, default=0)
    return (width, False) if sum(widths[one] for one in usual) >= least else (0, False)


def names_all_axes(cells: Sequence[str]) -> bool:
    """Return True if cells name x, y and z."""
    return {name_of(cell).axis for cell in cells} >= {*AXES}


def _are_units(cells: Sequence[str]) -> bool:
    """Return True if cells are units: all, or half of those that are filled with one of acceleration."""
    filled = [cell for cell in cells if cell]
    known = sum(map(is_unit_cell, filled))
    return known == len(filled) or (2 * known >= len(filled) and any(map(acceleration_unit, filled)))


def _is_shifted(names: Sequence[str], sample: Sequence[list[str]], kinds: Sequence[Kind]) -> bool:
    """Return True if the column without a name is the first one: it labels the rows, or counts them.

    Labels are texts where the first name is that of a time or an axis. Numbers rise by one, or before times.
    """
    if kinds[-1] is Kind.MISSING:
        return False
    if kinds[0] is Kind.TEXT:
        return name_of(names[0]).is_time or name_of(names[0]).axis is not None
    first, second = (_steps([number_of(row[column]) for row in sample]) for column in (0, 1))
    rises = bool(first) and all(step > 0 and step.is_integer() for step in first)
    timed = kinds[1] is Kind.TIME or (bool(second) and min(second) > 0)
    return rises and (timed or max(first) == 1)


def _steps(column: Sequence[float | None]) -> list[float]:
    """Return what each number is above the one before; none if a cell holds no number."""
    known = [number for number in column if number is not None]
    return [] if len(known) < len(column) else [after - before for before, after in pairwise(known)]


def _rows(raw_lines: list[bytes], normaliser: Normaliser) -> list[list[str]]:
    """Return the cells of all lines that are not blank, as they are written."""
    return [row for _, row in numbered_rows(raw_lines, normaliser, 1)]


def numbered_rows(
    raw_lines: list[bytes], normaliser: Normaliser, first: int, columns: int | None = None
) -> list[tuple[int, list[str]]]:
    """Return these cells, each row with its line number; `first` is that of the first.

    Args:
        columns: how many there are, if that is known: then a cell in quotes may reach over several lines.
    """
    plain = replace(normaliser, slash_dates=False)
    lines, numbers = [plain(line).rstrip(b"\r\n") for line in raw_lines], [*range(len(raw_lines))]
    if columns is not None:
        settled = Quotes(plain, normaliser.delimiter, columns).settled(b"\n".join(lines))
        lines, numbers = settled.text.split(b"\n"), settled.first_of(len(lines)).tolist()
    rows = [split_line(decode(line), normaliser.delimiter) for line in lines]
    return [(first + number, row) for number, row in zip(numbers, rows, strict=True) if row]


def _last_rows(raw_lines: list[bytes], normaliser: Normaliser, number: int) -> list[list[str]]:
    """Return the cells of the last lines that are not blank; none if no line has the delimiter."""
    marks = (b" ", b"\t") if normaliser.delimiter == " " else (normaliser.delimiter.encode(),)
    last = [*islice((line for line in reversed(raw_lines) if line.strip()), number)][::-1]
    return _rows(last, normaliser) if any(mark in line for line in last for mark in marks) else []


def _column_kinds(rows: list[list[str]], share: float) -> tuple[Kind, ...]:
    return tuple(column_kind(cells, share) for cells in zip(*rows, strict=True))


def _normalisers(head: bytes) -> list[Normaliser]:
    """Return what each delimiter would need; the times are looked for once."""
    split_date = b" " in head and SPLIT_DATE.search(head) is not None
    any_delimiter = Normaliser(
        "",
        slash_dates=b"/" in head and SLASH_DATE.search(head) is not None,
        colon_fraction=COLON_FRACTION.search(head) is not None,
        comma=DECIMAL if DECIMALS_IN_QUOTES.search(head) else BETWEEN_GROUPS,
    )
    return [
        replace(
            any_delimiter,
            delimiter=delimiter,
            comma_fraction=delimiter == "," and _has_comma_fractions(head),
            padded=delimiter != " "
            and (b" " + delimiter.encode() in head or delimiter.encode() + b" " in head),
            split_date=delimiter == " " and split_date,
        )
        for delimiter in DELIMITERS
    ]


def _has_comma_fractions(head: bytes) -> bool:
    """Return True if digits behind every second are its decimals: all as long, and some begin with 0."""
    found = [decimals for _, decimals in COMMA_FRACTION.findall(head)]
    alike = len(found) > 2 and len(set(map(len, found))) == 1 and len(found) == len(SECONDS.findall(head))
    return alike and any(decimals.startswith(b"0") for decimals in found)
