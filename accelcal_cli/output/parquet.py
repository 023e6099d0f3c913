"""The calibrated recording as Parquet: a sink that writes its columns, a source that reads them back.

Columns and metadata are described in docs/outputs.md. Files are streamed in row groups of fixed size,
which do not depend on how the rows were chunked, so that the file's bytes do not either.
"""

from __future__ import annotations

import contextlib
import os
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from accelcal_cli.core.clock import Clock, Steps, joined_steps
from accelcal_cli.core.errors import UnreadableError, missing_resource
from accelcal_cli.core.helpers import Helper, helpers
from accelcal_cli.core.parallel import BackgroundCalls
from accelcal_cli.output.column_chunks import MAGIC, ColumnChunk
from accelcal_cli.output.columns import Column, Portion, schema_of
from accelcal_cli.output.delta_pages import delta_chunk
from accelcal_cli.output.dictionary_pages import Places, dictionary_chunk, paired, places
from accelcal_cli.output.files import output_error
from accelcal_cli.output.float_pages import float_chunk
from accelcal_cli.output.row_groups import Footer, RowGroup, by_pyarrow
from accelcal_cli.output.slots import Memory, Placed, Slot

ROW_GROUP_ROWS = 1 << 19

LEVEL = 1
"""Of zstd, but for bytes side by side (`float_pages`)."""

FLUSHED_BYTES = 1 << 25
"""After so many the disk begins to write."""

MOST_HELPERS = 3
"""Beside the caller, who fills row groups about as fast as three encode them."""

QUEUED = 3
"""Row groups that one helper has at most, so that it need not wait while the caller encodes one itself; near
the end at most one more than come after them, so that the caller waits little for the last ones."""

SLOT_BYTES = 1 << 26
"""Of memory for the rows of all row groups that are in work; two there are always."""

SOURCE_ROWS = 1 << 17
"""Rows that are read back at a time."""

P = TypeVar("P", bound="Portion")
R = TypeVar("R")


def stored_schema(path: Path) -> pa.Schema | None:
    """The schema of a file; None if it is no Parquet file. Raises UnreadableError if it cannot be read."""
    try:
        with path.open("rb") as file:
            return pq.read_schema(file)
    except (OSError, pa.ArrowException) as error:
        if getattr(error, "errno", None) is None:
            return None
        raise UnreadableError(f"cannot be read ({error.strerror})", path=path) from error


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """Rows as a sink stores them.

    Attributes:
        arrays: one for each column but that of times, its values or the numbers that they follow from.
    """

    clock: Clock
    arrays: Sequence[NDArray[Any]]

    def __len__(self) -> int:
        return len(self.arrays[0])

    def part(self, start: int, stop: int) -> Stored:
        """Rows start..stop-1."""
        return Stored(self.clock.part(start, stop), [array[start:stop] for array in self.arrays])


def copied(rows: Stored, memory: Memory) -> None:
    """Fills memory with rows that are stored already."""
    for (_, free), array in zip(memory, rows.arrays, strict=True):
        free[:] = array


@dataclass(slots=True, eq=False)
class _Group(Generic[R]):
    """A row group in work.

    Attributes:
        filled: what filling it gave.
        timed: its times, encoded.
        slot: where its other columns lie.
        helper: that encodes these; None: they are `encoded`.
    """

    rows: int
    filled: list[R]
    timed: ColumnChunk
    slot: Slot
    helper: Helper[tuple[int, int], list[Placed]] | None = None
    encoded: Mapping[str, ColumnChunk] = field(default_factory=dict)

    def ready(self) -> bool:
        """Whether it can be written at once."""
        return self.helper is None or self.helper.ready()


class ParquetSink:
    """Takes rows in any portions and writes them to a file that the caller made.

    Rows are collected in row groups of a fixed number of rows. The caller fills one after another; helpers
    encode them, and the caller, too, while they are busy. They are written in their order, so that the bytes
    do not depend on how many helpers there are.
    """

    def __init__(
        self,
        path: Path,
        shown: Path,
        columns: Sequence[Column],
        metadata: dict[str, Any],
        threads: int = 1,
        rows: int = 0,
    ) -> None:
        """Open `path` for writing; errors speak of `shown`.

        Args:
            threads: how many may work at a time; helpers are processes where they can be.
            rows: about how many there will be; those of one row group need no helper.

        Raises:
            OutputError: the file cannot be written.
        """
        self.shown = shown
        self.columns = columns
        self._schema = schema_of(columns, metadata)
        self._options = {
            "compression": "zstd",
            "compression_level": LEVEL,
            "use_dictionary": False,
            "write_statistics": ["time"],
            "store_schema": True,
        }
        ((self._time, self._clock),) = ((c.name, c.clock) for c in columns if c.clock is not None)
        self._others = [column for column in columns if column.clock is None]
        self._threads, self._rows_left = threads, rows
        self._helpers = min(threads - 1, MOST_HELPERS, rows // ROW_GROUP_ROWS)
        self._footer = Footer(self._schema, **self._options)
        self._flushed, self._flushes = 0, BackgroundCalls("flush")
        try:
            self._file = path.open("wb")
            self._file.write(MAGIC)
        except OSError as error:
            raise output_error(error, shown) from error

    def write(self, portions: Iterator[P], fill: Callable[[P, Memory], R]) -> Generator[list[R]]:
        """Write all rows of a file; group by group, what filling it gave, once it is written.

        Args:
            fill: puts a portion into memory for so many rows of each column.

        Raises:
            OutputError: the disk is full, or fails.
        """
        slots = self._slots()
        free, line = [*slots], deque[_Group[R]]()

        def encode(job: tuple[int, int]) -> list[Placed]:
            place, rows = job
            return slots[place].put(self._encoded(slots[place].stored(rows)))

        with helpers(encode, self._helpers) as helping:
            for group in _groups(portions):
                line.append(self._begun(group, fill, free, helping))
                while len(line) > len(slots) or (line and line[0].ready()):
                    yield self._written(line.popleft(), free)
            while line:
                yield self._written(line.popleft(), free)

    def _slots(self) -> list[Slot]:
        """Memory for row groups: for that of the caller, and for those that helpers have."""
        bytes_of = ROW_GROUP_ROWS * sum(np.dtype(column.dtype).itemsize for column in self._others)
        most = max(2, min(2 * self._helpers + 2, SLOT_BYTES // bytes_of)) if self._helpers else 1
        shared = self._helpers > 0
        return [Slot(number, self._others, ROW_GROUP_ROWS, shared=shared) for number in range(most)]

    def _begun(
        self,
        portions: list[P],
        fill: Callable[[P, Memory], R],
        free: list[Slot],
        helping: Sequence[Helper[tuple[int, int], list[Placed]]],
    ) -> _Group[R]:
        """A row group of portions, which are let go of once it is filled: given to a helper, or encoded."""
        slot, filled, steps, rows = free.pop(), [], [], 0
        for portion in portions:
            start, rows = rows, rows + len(portion)
            filled.append(fill(portion, slot.memory(start, rows)))
            steps.append(self._clock(portion).steps(0, len(portion)))
        portions.clear()
        group = _Group(rows, filled, self._timed(joined_steps(steps) if steps else None), slot)
        self._rows_left -= rows
        most = min(QUEUED, 1 + max(0, self._rows_left) / ROW_GROUP_ROWS)
        sound = (helper for helper in helping if not helper.lost)
        helper = min(sound, key=lambda one: one.waiting, default=None)
        if helper is not None and helper.waiting < most and free:
            helper.give((slot.number, rows))
            group.helper = helper
        else:
            group.encoded = self._encoded(slot.stored(rows))
            free.append(slot)
        return group

    def _written(self, group: _Group[R], free: list[Slot]) -> list[R]:
        """Write a group behind the others, once it is encoded, and let go of its slot; raises OutputError."""
        if group.helper is not None:
            group.encoded = group.slot.chunks(group.helper.take())
        chunks = {**group.encoded, self._time: group.timed}
        self._append(RowGroup([chunks[column.name] for column in self.columns], group.rows))
        if group.helper is not None:
            free.append(group.slot)
        return group.filled

    def _timed(self, steps: Steps | None) -> ColumnChunk:
        """The times of a row group, encoded; None: there are no rows."""
        if steps is not None and (timed := delta_chunk(self._time, steps, LEVEL)) is not None:
            return timed
        return self._by_pyarrow(self._time, np.empty(0, np.int64) if steps is None else steps.times())

    def _encoded(self, stored: Mapping[str, NDArray[Any]]) -> dict[str, ColumnChunk]:
        """The other columns of a row group, encoded from where they lie."""
        chunks = _chunks(self._others, stored)
        values = {c.name: _values_of_stored(c, stored) for c in self._others if c.name not in chunks}
        for name, held in values.items():
            single = held.dtype == np.float32
            chunks[name] = float_chunk(name, held, LEVEL) if single else self._by_pyarrow(name, held)
        return chunks

    def _by_pyarrow(self, name: str, values: NDArray[Any]) -> ColumnChunk:
        """A column of a row group that no other module makes; `pa.array` would load pandas."""
        field = self._schema.field(name)
        array = pa.Array.from_buffers(field.type, len(values), [None, pa.py_buffer(values)])
        encoding = {name: "DELTA_BINARY_PACKED" if values.dtype == np.int64 else "PLAIN"}
        table = pa.record_batch([array], schema=pa.schema([field]))
        (chunk,) = by_pyarrow(table, **self._options, column_encoding=encoding)
        return chunk

    def _append(self, group: RowGroup) -> None:
        """Write a group behind the others; raises OutputError."""
        try:
            self._footer.add(group, self._file.tell())
            self._file.writelines(group.parts)
            self._flush_ahead()
        except OSError as error:
            raise output_error(error, self.shown) from error

    def _flush_ahead(self) -> None:
        """Let the disk begin with what it was given, so that it has little left to do at the end."""
        at = self._file.tell()
        if self._threads > 1 and at - self._flushed >= FLUSHED_BYTES and hasattr(os, "fdatasync"):
            self._flushed = at
            self._flushes.wait(1)
            self._flushes.submit(os.fdatasync, self._file.fileno())

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


def _groups(portions: Iterator[P]) -> Iterator[list[P]]:
    """The portions of each row group; those of an empty one where there are no rows at all."""
    group: list[P] = []
    left, none = ROW_GROUP_ROWS, True
    for portion in portions:
        start = 0
        while start < len(portion):
            stop = min(len(portion), start + left)
            group.append(portion.part(start, stop))
            left, start = left - (stop - start), stop
            if not left:
                yield group
                group, left, none = [], ROW_GROUP_ROWS, False
    if group or none:
        yield group


def _places(columns: Sequence[Column], stored: Mapping[str, NDArray[Any]]) -> dict[str, Places | None]:
    """Where the rows of columns that are stored as numbers find these; None where they are too many."""
    numbers = {column.name: column.numbers for column in columns if column.numbers is not None}
    found = {name: places(stored[name]) for name, one in numbers.items() if one.beside is None}
    for name, one in numbers.items():
        if one.beside is not None:
            slow = found[one.beside]
            found[name] = None if slow is None else paired(stored[name], slow)
    return found


def _chunks(columns: Sequence[Column], stored: Mapping[str, NDArray[Any]]) -> dict[str, ColumnChunk]:
    """The columns of a row group whose pages are not pyarrow's, by name."""
    found = _places(columns, stored)
    chunks = {}
    for column in columns:
        place, numbers = found.get(column.name), column.numbers
        if place is not None and numbers is not None:
            kept = numbers.values(*place.present)
            chunks[column.name] = dictionary_chunk(column.name, place.of_rows, kept, LEVEL)
    return chunks


def _values_of_stored(column: Column, stored: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """The values of a column of a row group."""
    held, numbers = stored[column.name], column.numbers
    if numbers is None:
        return held
    return numbers.values(held, *([] if numbers.beside is None else [stored[numbers.beside]]))


class ParquetSource:
    """Reads a calibrated recording back, in portions of any number of rows.

    pyarrow neither reads ahead, since it would keep all of that to the end, nor starts threads, since it may
    end the process where one cannot start.
    """

    def __init__(self, path: Path, columns: Sequence[str] | None = None) -> None:
        """Open a file.

        Args:
            columns: names of those that are wanted, in this order; None: all. They are there.

        Raises:
            UnreadableError: it is no Parquet file, or cannot be read.
        """
        self.path = path
        with contextlib.ExitStack() as stack:
            try:
                self._file = pq.ParquetFile(stack.enter_context(path.open("rb")), pre_buffer=False)
            except (OSError, pa.ArrowException) as error:
                raise self._unreadable(error) from error
            self._open = stack.pop_all()
        schema = self._file.schema_arrow
        self.names: list[str] = schema.names if columns is None else list(columns)
        self.rows: int = self._file.metadata.num_rows
        self._batches = self._file.iter_batches(SOURCE_ROWS, columns=self.names, use_threads=False)
        self._rest = [_values(pa.array([], schema.field(name).type)) for name in self.names]

    def other_column(self, schema: pa.Schema) -> str | None:
        """The first column that is not as in a schema, in name or type; None if all are."""
        pairs = zip_longest(self._file.schema_arrow, schema)
        for found, wanted in pairs:
            if found is None or wanted is None or (found.name, found.type) != (wanted.name, wanted.type):
                return str((found or wanted).name)
        return None

    def take(self, number: int) -> list[NDArray[Any]]:
        """The next rows, fewer at the end: one array a column, times as int64.

        Raises:
            UnreadableError: the file is damaged.
        """
        parts, need = [self._rest], number - len(self._rest[0])
        while need > 0 and (batch := self._next()) is not None:
            parts.append(batch)
            need -= len(batch[0])
        joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
        self._rest = [column[number:] for column in joined]
        return [column[:number] for column in joined]

    def _next(self) -> list[NDArray[Any]] | None:
        try:
            batch = next(self._batches, None)
        except (OSError, pa.ArrowException) as error:
            if missing_resource(error) is not None:
                raise
            raise self._unreadable(error) from error
        return None if batch is None else [_values(batch.column(name)) for name in self.names]

    def _unreadable(self, error: Exception) -> UnreadableError:
        return UnreadableError(f"cannot be read as Parquet ({error})", path=self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_failure: object) -> None:
        with contextlib.suppress(OSError):  # what was read is not less true
            self._file.close()
            self._open.close()


def _values(column: pa.Array) -> NDArray[Any]:
    """A column as numpy values, times as int64."""
    plain = column.cast(pa.int64()) if pa.types.is_timestamp(column.type) else column
    return np.asarray(plain.to_numpy(zero_copy_only=False))
