"""A sink that writes columns of rows as a Parquet file, in row groups of a fixed number of rows.

The row groups depend neither on how the rows were chunked nor on the number of threads, and so the bytes of
the file do not either.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.clock import Clock, TimeSteps, joined_steps
from accelcal_cli.core.errors import output_error
from accelcal_cli.core.parallel import BackgroundCalls, parallel_map
from accelcal_cli.core.recording import Chunk
from accelcal_cli.core.system import flush_data
from accelcal_cli.parquet.pages import (
    LEVEL,
    MAGIC,
    ColumnChunk,
    Footer,
    Places,
    RowGroup,
    delta_chunk,
    dictionary_chunk,
    encode_by_pyarrow,
    float_chunk,
    paired,
    places,
)

ROW_GROUP_ROWS = 1 << 19

FLUSHED_BYTES = 1 << 25
"""Bytes written after which the system is asked to begin writing to disk."""

FEWEST_GROUPS, MOST_GROUPS, GROUPS_BYTES = 2, 6, 1 << 26
"""Row groups in memory at a time where several threads encode them: as many as take GROUPS_BYTES."""

WRITER_OPTIONS = {
    "compression": "zstd",
    "compression_level": LEVEL,
    "use_dictionary": False,
    "write_statistics": ["time"],
    "store_schema": True,
}

Axes = list[NDArray[np.float32]]
"""Calibrated x, y, z [g]."""

ColumnValues = Callable[[Chunk, Axes], NDArray[Any]]
"""Returns one number for each row of a chunk with its calibrated x, y, z [g]."""


class Portion(Protocol):
    """Some consecutive rows."""

    @property
    def clock(self) -> Clock:
        """The times of the rows."""

    def __len__(self) -> int: ...

    def part(self, start: int, stop: int) -> Self:
        """Return rows start..stop-1."""


@dataclass(frozen=True, slots=True)
class Numbers:
    """Whole numbers that the values of a column follow from; the file holds these and a table of the values.

    Attributes:
        of: returns the number of each row.
        values: returns the value of each number, given also those of `paired_with`.
        dtype: type of the numbers.
        paired_with: another column that is stored as numbers, if the values follow from these too.
        calibrated: the numbers are made of calibrated values, not of what a chunk holds.
    """

    of: ColumnValues
    values: Callable[..., NDArray[Any]]
    dtype: Any = np.int32
    paired_with: str | None = None
    calibrated: bool = False


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a Parquet file.

    Attributes:
        unit: unit of the values, for the field's metadata.
        values: returns the value of each row.
        numbers: whole numbers that the values follow from, if they do.
        clock: returns the clock of rows, if the column holds times.
    """

    name: str
    unit: str
    type: pa.DataType
    values: ColumnValues
    numbers: Numbers | None = None
    clock: Callable[[Portion], Clock] | None = None

    @classmethod
    def timed(cls, name: str, unit: str, kind: pa.DataType, ahead_us: int = 0) -> Self:
        """Make a column of times, from clocks that are `ahead_us` ahead."""

        def clock(rows: Portion) -> Clock:
            return rows.clock.shifted(-ahead_us) if ahead_us else rows.clock

        def values(chunk: Chunk, _xyz: Axes) -> NDArray[np.int64]:
            return clock(chunk).times(0, len(chunk))

        return cls(name, unit, kind, values, clock=clock)

    @classmethod
    def following(cls, name: str, unit: str, kind: pa.DataType, numbers: Numbers) -> Self:
        """Make a column whose values are known by its numbers alone."""

        def values(chunk: Chunk, xyz: Axes) -> NDArray[Any]:
            return numbers.values(numbers.of(chunk, xyz))

        return cls(name, unit, kind, values, numbers=numbers)

    @property
    def field(self) -> pa.Field:
        """The column's field of the Arrow schema."""
        return pa.field(self.name, self.type, nullable=False, metadata={b"unit": self.unit.encode()})

    @property
    def stored(self) -> ColumnValues:
        """Returns what the file stores: the numbers if there are any, else the values."""
        return self.values if self.numbers is None else self.numbers.of

    @property
    def dtype(self) -> Any:
        """The type of what the file stores."""
        return self.type.to_pandas_dtype() if self.numbers is None else self.numbers.dtype


Memory = list[tuple[Column, NDArray[Any]]]
"""Columns but that of times, each with (n,) memory that rows are put into."""

P = TypeVar("P", bound="Portion")
R = TypeVar("R")


class _FilledGroup(Generic[R]):
    """A row group that is not encoded yet.

    Attributes:
        rows: how many are in memory.
        results: what `fill` returned for each portion.
        steps: times of each portion.
    """

    def __init__(self, columns: Sequence[Column]) -> None:
        self.rows, self.results, self.steps = 0, list[R](), list[TimeSteps]()
        self.memory: Memory = [(column, np.empty(ROW_GROUP_ROWS, column.dtype)) for column in columns]


class ParquetSink:
    """Takes rows in any portions and writes them to a file that the caller made.

    The caller's thread fills one row group after the other; further threads, if any, encode them, and they
    are written in their order.
    """

    def __init__(
        self, path: Path, shown: Path, columns: Sequence[Column], schema: pa.Schema, threads: int = 1
    ) -> None:
        """Open `path` for writing; errors name `shown`.

        Args:
            columns: exactly one of them holds times.
            schema: that of the columns, with the metadata of the file.
            threads: how many may work at a time.

        Raises:
            OutputError: the file cannot be written.
        """
        self.shown = shown
        self._columns, self._schema, self._threads = columns, schema, threads
        (self._time,) = (column for column in columns if column.clock is not None)
        self._others = [column for column in columns if column.clock is None]
        self._footer = Footer(schema, **WRITER_OPTIONS)
        self._flushed, self._flushes = 0, BackgroundCalls("flush")
        try:
            self._file = path.open("wb")
            self._file.write(MAGIC)
        except OSError as error:
            raise output_error(error, shown) from error

    def write(self, portions: Iterator[P], fill: Callable[[P, Memory], R]) -> Generator[list[R]]:
        """Write all rows of a file; yield, for each row group that is written, what filling it returned.

        Args:
            fill: puts the rows of a portion into memory for them.

        Raises:
            OutputError: the disk is full, or fails.
        """
        group_bytes = ROW_GROUP_ROWS * sum(np.dtype(column.dtype).itemsize for column in self._others)
        most = min(max(FEWEST_GROUPS, GROUPS_BYTES // max(1, group_bytes)), MOST_GROUPS)
        groups = self._filled(portions, fill)
        with contextlib.closing(parallel_map(self._encoded, groups, self._threads, most)) as encoded:
            for group, results in encoded:
                self._append(group)
                yield results

    def _filled(self, portions: Iterator[P], fill: Callable[[P, Memory], R]) -> Iterator[_FilledGroup[R]]:
        """Put portions into memory, cut at the ends of row groups; yield one empty group for no rows."""
        assert self._time.clock is not None
        group, none = _FilledGroup[R](self._others), True
        for portion in portions:
            start = 0
            while start < len(portion):
                part = portion.part(start, min(len(portion), start + ROW_GROUP_ROWS - group.rows))
                stop = group.rows + len(part)
                memory = [(column, array[group.rows : stop]) for column, array in group.memory]
                group.results.append(fill(part, memory))
                group.steps.append(self._time.clock(part).steps(0, len(part)))
                start, group.rows = start + len(part), stop
                if stop == ROW_GROUP_ROWS:
                    yield group
                    group, none = _FilledGroup[R](self._others), False
        if group.rows or none:
            yield group

    def _encoded(self, group: _FilledGroup[R]) -> tuple[RowGroup, list[R]]:
        """Encode a row group; runs on any thread."""
        arrays = {column.name: array[: group.rows] for column, array in group.memory}
        chunks = _dictionary_chunks(self._others, arrays)
        chunks[self._time.name] = self._time_chunk(joined_steps(group.steps) if group.steps else None)
        for column in self._others:
            if column.name not in chunks:
                values, numbers = arrays[column.name], column.numbers
                if numbers is not None:
                    with_others = [] if numbers.paired_with is None else [arrays[numbers.paired_with]]
                    values = numbers.values(values, *with_others)
                single = values.dtype == np.float32
                encode = float_chunk if single else self._pyarrow_chunk
                chunks[column.name] = encode(column.name, values)
        return RowGroup([chunks[column.name] for column in self._columns], group.rows), group.results

    def _time_chunk(self, steps: TimeSteps | None) -> ColumnChunk:
        """Encode the times of a row group; None if there are no rows."""
        if steps is not None and (chunk := delta_chunk(self._time.name, steps)) is not None:
            return chunk
        return self._pyarrow_chunk(self._time.name, np.empty(0, np.int64) if steps is None else steps.times())

    def _pyarrow_chunk(self, name: str, values: NDArray[Any]) -> ColumnChunk:
        """Encode a column that `pages` does not; `pa.array` would load pandas."""
        field = self._schema.field(name)
        array = pa.Array.from_buffers(field.type, len(values), [None, pa.py_buffer(values)])
        encoding = {name: "DELTA_BINARY_PACKED" if values.dtype == np.int64 else "PLAIN"}
        table = pa.record_batch([array], schema=pa.schema([field]))
        (chunk,) = encode_by_pyarrow(table, **WRITER_OPTIONS, column_encoding=encoding)
        return chunk

    def _append(self, group: RowGroup) -> None:
        """Write a group behind the others, and let the disk begin with what it was given."""
        try:
            self._footer.add(group, self._file.tell())
            self._file.writelines(group.parts)
            at = self._file.tell()
            if self._threads > 1 and at - self._flushed >= FLUSHED_BYTES:
                self._flushed = at
                self._flushes.wait(1)
                self._flushes.submit(flush_data, self._file.fileno())
        except OSError as error:
            raise output_error(error, self.shown) from error

    def close(self) -> None:
        """Write the footer; without it the file is not complete.

        Raises:
            OutputError: the disk is full, or fails.
        """
        try:
            self._file.write(self._footer.tail())
            self._file.flush()
            self._flushes.wait()
            self._file.close()
        except OSError as error:
            raise output_error(error, self.shown) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_failure: object) -> None:
        self._flushes.close()
        with contextlib.suppress(OSError):
            self._file.close()


def _dictionary_chunks(
    columns: Sequence[Column], arrays: Mapping[str, NDArray[Any]]
) -> dict[str, ColumnChunk]:
    """Encode the columns of a row group that are stored as numbers, where these are few enough, by name."""
    numbers = {column.name: column.numbers for column in columns if column.numbers is not None}
    found: dict[str, Places | None] = {
        name: places(arrays[name]) for name, one in numbers.items() if one.paired_with is None
    }
    for name, one in numbers.items():
        if one.paired_with is not None:
            slow = found[one.paired_with]
            found[name] = None if slow is None else paired(arrays[name], slow)
    return {
        name: dictionary_chunk(name, where.of_rows, numbers[name].values(*where.present))
        for name, where in found.items()
        if where is not None
    }
