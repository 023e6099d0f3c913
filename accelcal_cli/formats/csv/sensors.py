"""The rows of one sensor in a text file of several, and the watch over columns that may show several.

The head of a file is looked at as a whole. Behind it, one line in every `LOOK_BYTES` is looked at, and a
block of lines as a whole only where these show that a column changes: most never do.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.formats import EVERY_ROW
from accelcal_cli.formats._tables.sensors import (
    WHOLE,
    CellTexts,
    Meaning,
    Watch,
    counted_texts,
    matched,
    meaning_of,
    no_such_sensor,
    note_of,
)
from accelcal_cli.formats.csv.cells import MISSING, CellKind, decode
from accelcal_cli.formats.csv.columns import Roles
from accelcal_cli.formats.csv.dialect import SAMPLE_ROWS, Dialect, numbered_rows
from accelcal_cli.formats.csv.lines import Block, LineFile, lone_block
from accelcal_cli.formats.csv.rows import ParsedTable, TableParser

LOOK_BYTES = 1 << 16
"""Bytes of the file among which one line is looked at."""

SEARCH_BYTES = 1 << 20
"""Bytes that are read at a time to find the first rows of a sensor."""


def dividing_columns(dialect: Dialect, roles: Roles) -> tuple[int, ...]:
    """Return the columns of texts or whole numbers that may tell whose each row is."""
    used = {*roles.xyz, roles.time, roles.date, *roles.channels.values(), *(roles.gyro or ())}
    return tuple(
        column for column in range(dialect.columns) if column not in used and _may_divide(dialect, column)
    )


def _may_divide(dialect: Dialect, column: int) -> bool:
    if dialect.names and meaning_of(dialect.names[column]) is Meaning.MEASURED:
        return False
    cells = {cell.strip() for cell in dialect.cells(column)} - {*MISSING}
    kind = dialect.kinds[column]
    return kind is CellKind.TEXT or (kind is CellKind.NUMBER and all(map(WHOLE.fullmatch, cells)))


def _names(dialect: Dialect, columns: Sequence[int]) -> list[str]:
    """Return the names of columns, each once; numbers where the file has none."""
    names = dialect.names or ()
    own = [names[column] if names else "" for column in columns]
    return [
        name if name and names.count(name) == 1 else str(column)
        for name, column in zip(own, columns, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class SensorRows:
    """The rows of a file that --sensor chooses.

    Attributes:
        block: the first lines of the file among which they are.
        texts: of columns, one of each of which they have.
    """

    block: Block
    texts: tuple[tuple[int, frozenset[str]], ...]

    def sample_of(self, dialect: Dialect) -> Dialect:
        """Return the layout with a sample of these rows."""
        lines = self.block.data.splitlines(keepends=True)
        rows = [
            (line, tuple(row))
            for line, row in numbered_rows(lines, dialect.normaliser, self.block.line)
            if len(row) == dialect.columns
            and all(row[column].strip() in texts for column, texts in self.texts)
        ][:SAMPLE_ROWS]
        numbers, cells = zip(*rows, strict=True) if rows else (dialect.lines, dialect.sample)
        return replace(dialect, sample=cells, lines=numbers)


def rows_of_sensor(
    wanted: str | None, dialect: Dialect, columns: Sequence[int], path: Path
) -> SensorRows | None:
    """Find the rows of a sensor, however far from the beginning; None if all rows are wanted.

    Args:
        columns: that may tell whose each row is.

    Raises:
        UsageError: no row is of that sensor.
    """
    if wanted is None or (wanted == EVERY_ROW and not columns):
        return None
    names = _names(dialect, columns)
    texts: dict[str, list[str]] = {name: [] for name in names}
    parser = TableParser(path, dialect, Roles((0, 0, 0), None, {}), None)
    for first, second in _pairs_of_blocks(dialect, path):
        for name, values in zip(names, _cells(parser, first, columns), strict=True):
            texts[name] += [text for text in values.texts if text not in texts[name]]
        if (found := matched(wanted, texts)) is not None:
            number_of = dict(zip(names, columns, strict=True))
            chosen = tuple((number_of[name], frozenset(some)) for name, some in found.items())
            return SensorRows(lone_block(first.data + second, first.line, first.offset), chosen)
        if wanted == EVERY_ROW:
            return None
    raise no_such_sensor(wanted, texts, path)


def _pairs_of_blocks(dialect: Dialect, path: Path) -> Iterator[tuple[Block, bytes]]:
    """Yield each block of a file with the lines of the next one."""
    before = None
    for block in _blocks(dialect, path):
        if before is not None:
            yield before, block.data
        before = block
    if before is not None:
        yield before, b""


def _blocks(dialect: Dialect, path: Path) -> Iterator[Block]:
    """Yield the blocks of a file."""
    with LineFile(path, dialect.bare_returns) as file:
        yield from file.blocks(dialect.offset, dialect.skipped + 1, SEARCH_BYTES)


def _cells(parser: TableParser, block: Block, columns: Sequence[int]) -> tuple[CellTexts, ...]:
    """Return columns of a block; only of its rows, where a line is not a row."""
    try:
        return parser.values(block, columns) if columns else ()
    except pa.ArrowException:
        lines, dialect = block.data.splitlines(keepends=True), parser.dialect
        rows = [row for _, row in numbered_rows(lines, dialect.normaliser, 0) if len(row) == dialect.columns]
        texts = [[row[column].strip() for row in rows] for column in columns]
        return tuple(_coded(["" if one in MISSING else one for one in column]) for column in texts)


def _coded(column: Sequence[str]) -> CellTexts:
    """Return texts with the number of each among those that there are, -1 if it is empty."""
    numbers = {text: number for number, text in enumerate(sorted({*column} - {""}))}
    return CellTexts([*numbers], np.array([numbers.get(text, -1) for text in column], np.int32))


class SensorWatch:
    """The watch over a file whose rows may turn out to be of several sensors: see `Watch`.

    Args:
        columns: that may tell whose each row is.
        wanted: what --sensor has chosen.
    """

    def __init__(self, parser: TableParser, columns: Sequence[int], wanted: str | None) -> None:
        self._parser, self.columns, self._wanted = parser, columns, wanted
        since_1970 = parser.time is not None and parser.time.since_1970
        names = _names(parser.dialect, columns)
        self._watch = Watch(names, since_1970, (parser.path, wanted), self._values)

    def _values(self, number: int) -> Counter[str]:
        """Return the values of a column in the rows that are read, with how many have each."""
        columns = (self.columns[number], *(column for column, _ in self._parser.sensor))
        rows = counted_texts(
            CellTexts(texts, codes[self._parser.wanted_rows(chosen)] if chosen else codes)
            for block in _blocks(self._parser.dialect, self._parser.path)
            for (texts, codes), *chosen in (_cells(self._parser, block, columns),)
        )
        for name in self._parser.dialect.names or ():  # which may stand again
            rows.pop(name, None)
        return rows

    def again(self) -> SensorWatch | None:
        """Return a watch from the beginning over the columns that are worth it; None if none is."""
        columns = [self.columns[number] for number in self._watch.worth_watching()]
        return SensorWatch(self._parser, columns, self._wanted) if columns else None

    @property
    def note(self) -> str:
        """Says which rows are read."""
        chosen = self._parser.sensor
        names = _names(self._parser.dialect, [column for column, _ in chosen])
        return note_of({name: texts for name, (_, texts) in zip(names, chosen, strict=True)})

    def look(self, block: Block, table: ParsedTable) -> tuple[CellTexts, ...]:
        """Return the columns of a block, as far as one line in many shows that they have to be read."""
        constant = self._constant_cells(block) if table.wanted is None else {}
        changing = [column for column in self.columns if column not in constant]
        read = dict(zip(changing, self._read(block, table, changing), strict=True)) if changing else {}
        rows = np.zeros(len(table.line), np.int32)
        alike = {column: CellTexts((text,), rows - (text in MISSING)) for column, text in constant.items()}
        return tuple((read | alike)[column] for column in self.columns)

    def all_of(self, block: Block, table: ParsedTable) -> tuple[CellTexts, ...]:
        """Return the columns of a block, all of them read."""
        return self._read(block, table, self.columns)

    def _read(self, block: Block, table: ParsedTable, columns: Sequence[int]) -> tuple[CellTexts, ...]:
        values = self._parser.values(block, columns)
        if table.wanted is None:
            return values
        return tuple(CellTexts(texts, codes[table.wanted]) for texts, codes in values)

    def see(self, seen: tuple[CellTexts, ...], times: NDArray[np.int64] | None) -> None:
        """Take the columns of the next block; raise UnreadableError if they show several sensors."""
        self._watch.see(seen, times)

    def _constant_cells(self, block: Block) -> dict[int, str]:
        """Return the cell of each column that is the same in all lines that are looked at."""
        first = -block.offset % LOOK_BYTES
        starts = [
            0,
            *(block.data.find(b"\n", place) + 1 for place in range(first, len(block.data), LOOK_BYTES)),
        ]
        starts.append(block.data.rfind(b"\n", 0, len(block.data) - 1) + 1)
        delimiter = self._parser.dialect.normaliser.delimiter.encode()
        found: list[set[bytes]] = [set() for _ in self.columns]
        for start in (start for start in starts if start < len(block.data)):
            line = block.data[start : block.data.find(b"\n", start)].rstrip(b"\r")
            cells = line.split(delimiter)
            if len(cells) != self._parser.dialect.columns or b'"' in line:
                return {}
            for column, cells_of in zip(self.columns, found, strict=True):
                cells_of.add(cells[column])
        pairs = zip(self.columns, found, strict=True)
        clean = self._parser.dialect.normaliser
        return {column: decode(clean(cells.pop())).strip() for column, cells in pairs if len(cells) == 1}
