"""A text file as it was understood at opening: layout, columns, units, pace."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from numpy.typing import NDArray

from accelcal_cli.readers._csv.arrays import floats
from accelcal_cli.readers._csv.blocks import Block
from accelcal_cli.readers._csv.cells import MISSING
from accelcal_cli.readers._csv.columns import Roles
from accelcal_cli.readers._csv.dialect import Dialect
from accelcal_cli.readers._csv.faults import LineCheck, blank_lines_apart
from accelcal_cli.readers._csv.time import TimeFormat

PARSER_BYTES = 1 << 20
"""What is parsed at a time."""

PADDING = frozenset(b" \t\r\n")


@dataclass(frozen=True, slots=True)
class Cells:
    """The columns of a block that are used, one entry a row.

    line: (n,) number in the file. values: (n, 3) float64 in the file's unit, NaN where empty.
    time_us: (n,), or None without a time column. temperature: (n,) float64 C or None.
    """

    line: NDArray[np.int64]
    values: NDArray[np.float64]
    time_us: NDArray[np.int64] | None
    temperature: NDArray[np.float64] | None


@dataclass(frozen=True)
class Sheet:
    """What is needed to turn a block of lines into columns."""

    path: Path
    dialect: Dialect
    roles: Roles
    time: TimeFormat | None
    options: tuple[Any, Any] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "options", (self._parse_options(), self._convert_options()))

    @property
    def used(self) -> list[int]:
        """The numbers of the columns that are read."""
        extra = [column for column in (self.roles.time, self.roles.temperature) if column is not None]
        return [*self.roles.xyz, *extra]

    @property
    def _check(self) -> LineCheck:
        return LineCheck(self.dialect, tuple(self.used), self.roles.time)

    def _parse_options(self) -> Any:
        return pa_csv.ParseOptions(delimiter=self.dialect.cleaner.delimiter, newlines_in_values=False)

    def _convert_options(self) -> Any:
        types = {str(column): pa.float64() for column in self.used}
        if self.time is not None:
            types[str(self.roles.time)] = self.time.arrow_type
        return pa_csv.ConvertOptions(
            column_types=types,
            include_columns=list(types),
            null_values=list(MISSING),
            quoted_strings_can_be_null=True,
        )

    def cells(self, block: Block) -> Cells:
        """The rows of a block's whole lines.

        Raises:
            UnreadableError: a line has a wrong number of columns, or a text where a number belongs.
        """
        data = self.dialect.cleaner(block.data)
        table, data = self._table(data, block)
        line = block.line + np.arange(table.num_rows, dtype=np.int64)
        if block.lines != table.num_rows:
            line = block.line + blank_lines_apart(data)
        values = np.empty((table.num_rows, 3))
        for axis, column in enumerate(self.roles.xyz):
            values[:, axis] = floats(table[str(column)])
        stamps = None if self.time is None else self.time.microseconds(table[str(self.roles.time)])
        spare = self.roles.temperature
        return Cells(line, values, stamps, None if spare is None else floats(table[str(spare)]))

    def _table(self, data: bytes, block: Block) -> tuple[Any, bytes]:
        """The parsed columns, and the text that they come from, which has the same lines."""
        try:
            return self._parsed(data), data
        except pa.ArrowException:
            thorough = replace(self.dialect.cleaner, thorough=True)(block.data)
        try:
            return self._parsed(thorough), thorough
        except pa.ArrowException as error:
            raise self._check.bad_line(thorough, block.line, self.path) from error

    def _parsed(self, data: bytes) -> Any:
        """A table, in the C library's memory: Arrow's own keeps an eighth more of what was freed."""
        parsing, converting = self.options
        if PADDING.issuperset(data):
            types = converting.column_types
            return pa.table({name: pa.array([], kind) for name, kind in types.items()})
        names = [str(column) for column in range(self.dialect.columns)]
        reading = pa_csv.ReadOptions(column_names=names, block_size=PARSER_BYTES, use_threads=False)
        room = pa.system_memory_pool()
        return pa_csv.read_csv(pa.BufferReader(data), reading, parsing, converting, memory_pool=room)
