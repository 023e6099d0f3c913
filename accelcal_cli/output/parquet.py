"""The calibrated recording as Parquet: its columns, a sink that writes them, a source that reads them back.

Columns and metadata are described in docs/outputs.md. Files are streamed in row groups of fixed size,
which do not depend on how the rows were chunked, so that the file's bytes do not either.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import os
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from pathlib import Path
from threading import local
from types import MappingProxyType
from typing import Any, Protocol, Self, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError, lacking
from accelcal_cli.core.parallel import BackgroundCalls, parallel_pull
from accelcal_cli.core.recording import METADATA_KEY, NOT_CALIBRATED, Chunk, Recording
from accelcal_cli.core.results import Facts
from accelcal_cli.core.rotations import Gyroscope
from accelcal_cli.core.zones import UNKNOWN, UTC
from accelcal_cli.output.delta_pages import delta_chunk
from accelcal_cli.output.dictionary_pages import Places, dictionary_chunk, paired, places
from accelcal_cli.output.files import output_error
from accelcal_cli.output.row_groups import MAGIC, ColumnChunk, EncodedGroup, Footer, encoded

ROW_GROUP_ROWS = 1 << 19

PAGE_ROWS = 1 << 16
"""Of single precision 256 kB, up to which zstd looks for shorter repetitions (zstd, clevels.h)."""

LEVEL = 1
"""Of zstd."""

SAMPLED, MOST_DIFFERENT = 64, 0.7
"""Of how many rows one is looked at, and the share of different values up to which they repeat."""

FLUSHED_BYTES = 1 << 25
"""After so many the disk begins to write."""

MOST_ENCODERS = 8
"""Row groups that are encoded side by side; each takes 11 MB, up to 26 with temperature and a gyroscope."""

TIME_ZONE_KEY = b"time_zone"
"""Of the schema's metadata: what `time` is in, UTC or unknown."""

BLOCK_ROWS = 1 << 14
"""Angular rates are calibrated so many at a time, which the processor's cache holds."""

SOURCE_ROWS = 1 << 17
"""Rows that are read back at a time."""

TEMPERATURE = "temperature"
NO_TEMPERATURE_MC = int(np.iinfo(np.int32).min)
NO_RATE = int(np.iinfo(np.int64).min)
"""Of rows without a temperature and without angular rates, where numbers are stored."""

VALIDITY = "0 measured, 1 filled, 2 clipped, 3 recovered"

Axes = list[NDArray[np.float32]]
"""Calibrated x, y, z [g]."""


Rows = Callable[[Chunk, Axes], NDArray[Any]]
"""One number for each row, of a chunk and its calibrated x, y, z [g]."""

P = TypeVar("P", bound="Portion")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Numbers:
    """Whole numbers that the values of a column follow from, where the file should hold these and a table.

    Attributes:
        values: of numbers, each for itself, and those of the column beside.
        dtype: of the numbers.
        beside: another column that is stored as numbers, where the values follow from these too.
        calibrated: they are made of calibrated values, not of what a chunk holds.
    """

    of: Rows
    values: Callable[..., NDArray[Any]]
    dtype: Any = np.int32
    beside: str | None = None
    calibrated: bool = False


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a calibrated recording.

    Attributes:
        unit: of its values, for the field's metadata.
        values: for each row.
        numbers: that the values follow from, if they do.
    """

    name: str
    unit: str
    type: pa.DataType
    values: Rows
    numbers: Numbers | None = None

    @classmethod
    def following(cls, name: str, unit: str, kind: pa.DataType, numbers: Numbers) -> Self:
        """A column whose values are only known by its numbers."""

        def values(chunk: Chunk, xyz: Axes) -> NDArray[Any]:
            return numbers.values(numbers.of(chunk, xyz))

        return cls(name, unit, kind, values, numbers=numbers)

    @property
    def field(self) -> pa.Field:
        """In the Arrow schema."""
        return pa.field(self.name, self.type, nullable=False, metadata={b"unit": self.unit.encode()})

    @property
    def stored(self) -> Rows:
        """What a sink takes: the numbers, or else the values."""
        return self.values if self.numbers is None else self.numbers.of

    @property
    def dtype(self) -> Any:
        """Of what a sink takes; times are whole microseconds."""
        if self.numbers is not None:
            return self.numbers.dtype
        return np.int64 if pa.types.is_timestamp(self.type) else self.type.to_pandas_dtype()


def columns_of(
    recording: Recording,
    facts: Facts,
    axes: Mapping[str, Numbers] = MappingProxyType({}),
    gyroscope: Gyroscope | None = None,
) -> list[Column]:
    """All columns of a calibrated recording: THE place for a new one.

    Args:
        axes: those of x, y, z that follow from whole numbers, and from which.
        gyroscope: the verdict on it; without a scale matrix its values stay raw.
    """
    single, offset_s = pa.float32(), facts.utc_offset_s
    time = pa.timestamp("us", None if offset_s is None else UTC)
    columns = [Column("time", "us since 1970", time, partial(_times, offset_s or 0))]
    for axis, name in enumerate("xyz"):
        columns.append(Column(name, "g", single, partial(_calibrated, axis), axes.get(name)))
    if facts.has_temperature:
        columns.append(
            Column.following(TEMPERATURE, "degree Celsius", single, Numbers(_temperature_mc, _degrees))
        )
    if facts.has_gyroscope:
        columns += _rate_columns(recording.gyro_dps_per_lsb, gyroscope)
    return [*columns, _validity_column(VALIDITY, 0)]


def _rate_columns(dps_per_lsb: tuple[float, ...] | None, gyroscope: Gyroscope | None) -> Iterator[Column]:
    """Angular rates: calibrated if a scale matrix is known, else raw."""
    rates = None
    if dps_per_lsb is not None and gyroscope is not None and gyroscope.scale is not None:
        rates = _CalibratedRates(dps_per_lsb, gyroscope)
    for axis, name in enumerate("xyz"):
        if rates is not None:
            yield Column(f"g{name}", "deg/s", pa.float32(), partial(rates.values, axis))
        else:
            scale = dps_per_lsb[axis] if dps_per_lsb else np.nan
            numbers = Numbers(partial(_gyro_counts, axis), partial(_rates, scale), np.int64)
            yield Column.following(f"g{name}", "deg/s", pa.float32(), numbers)


def _times(offset_s: int, chunk: Chunk, _xyz: Axes) -> NDArray[np.int64]:
    """In UTC, by how many seconds the device's clock is ahead of it."""
    times = chunk.clock.times(0, len(chunk))
    return times - offset_s * MICROSECONDS if offset_s else times


def _calibrated(axis: int, _chunk: Chunk, xyz: Axes) -> NDArray[np.float32]:
    return xyz[axis]


def _temperature_mc(chunk: Chunk, _xyz: Axes) -> NDArray[Any]:
    return _or_absent(chunk, chunk.temperature_mc, NO_TEMPERATURE_MC)


def _degrees(temperature_mc: NDArray[np.int32]) -> NDArray[np.float32]:
    return _or_nan(temperature_mc, NO_TEMPERATURE_MC, temperature_mc / 1000.0)


def _gyro_counts(axis: int, chunk: Chunk, _xyz: Axes) -> NDArray[Any]:
    counts = chunk.gyro_counts
    return _or_absent(chunk, None if counts is None else counts[:, axis], NO_RATE)


def _rates(dps_per_lsb: float, counts: NDArray[np.int64]) -> NDArray[np.float32]:
    return _or_nan(counts, NO_RATE, counts * dps_per_lsb)


def _or_absent(chunk: Chunk, numbers: NDArray[Any] | None, absent: int) -> NDArray[Any]:
    return np.full(len(chunk), absent, np.int64) if numbers is None else numbers


def _or_nan(numbers: NDArray[Any], absent: int, values: NDArray[Any]) -> NDArray[np.float32]:
    return np.where(numbers == absent, np.nan, values).astype(np.float32)


class _CalibratedRates:
    """Angular rates of chunks; of each thread's last chunk they are kept for its other axes."""

    def __init__(self, dps_per_lsb: tuple[float, ...], gyroscope: Gyroscope) -> None:
        self._dps_per_lsb, self._gyroscope = dps_per_lsb, gyroscope
        self._last = local()

    def values(self, axis: int, chunk: Chunk, _xyz: Axes) -> NDArray[np.float32]:
        """Of one axis [deg/s]; NaN where a chunk has none."""
        if chunk.gyro_counts is None:
            return np.full(len(chunk), np.nan, np.float32)
        if getattr(self._last, "chunk", None) is not chunk:
            self._last.rates = self._calibrated(chunk, chunk.gyro_counts)
            self._last.chunk = chunk
        rates: Axes = self._last.rates
        return rates[axis]

    def _calibrated(self, chunk: Chunk, counts: NDArray[Any]) -> Axes:
        held = [np.empty(len(chunk), np.float32) for _ in range(3)]
        for start in range(0, len(chunk), BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            raw = [
                np.multiply(counts[part, axis], scale, dtype=np.float64)
                for axis, scale in enumerate(self._dps_per_lsb)
            ]
            warm = None if chunk.temperature_mc is None else chunk.temperature_mc[part] / 1000.0
            for column, values in zip(held, self._gyroscope.calibrated(raw, warm), strict=True):
                column[part] = values
        return held


def _validity_column(meaning: str, plus: int) -> Column:
    """`validity`, with something added in each row."""

    def numbers(chunk: Chunk, _xyz: Axes) -> NDArray[np.uint8]:
        held = np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity
        return held + np.uint8(plus) if plus else held

    return Column.following("validity", meaning, pa.uint8(), Numbers(numbers, np.asarray, np.uint8))


def not_calibrated(columns: Sequence[Column]) -> list[Column]:
    """The columns of a file of raw values: `validity` says so in each row."""
    flagged = _validity_column(f"{VALIDITY}; plus {NOT_CALIBRATED}: not calibrated", NOT_CALIBRATED)
    return [flagged if column.name == flagged.name else column for column in columns]


def schema_of(columns: Sequence[Column], metadata: dict[str, Any]) -> pa.Schema:
    """The Arrow schema of a file with these columns and this metadata of ours."""
    text = json.dumps(metadata, sort_keys=True, allow_nan=False)
    times = next(column.type for column in columns if pa.types.is_timestamp(column.type))
    about = {METADATA_KEY: text, TIME_ZONE_KEY: times.tz or UNKNOWN}
    return pa.schema([column.field for column in columns], metadata=about)


def described(schema: pa.Schema) -> dict[str, Any]:
    """What a schema says beside our metadata, as JSON: what times are in, types and units of columns."""
    columns = {field.name: [str(field.type), _text(field.metadata, b"unit")] for field in schema}
    return {"time_zone": _text(schema.metadata, TIME_ZONE_KEY), "columns": columns}


def _text(metadata: dict[bytes, bytes] | None, key: bytes) -> str | None:
    value = (metadata or {}).get(key)
    return None if value is None else value.decode(errors="replace")


def stored_schema(path: Path) -> pa.Schema | None:
    """The schema of a file; None if it is no Parquet file. Raises UnreadableError if it cannot be read."""
    try:
        with path.open("rb") as file:
            return pq.read_schema(file)
    except (OSError, pa.ArrowException) as error:
        if getattr(error, "errno", None) is None:
            return None
        raise UnreadableError(f"cannot be read ({error.strerror})", path=path) from error


def values_of(columns: Sequence[Column], chunk: Chunk, xyz: Axes) -> list[NDArray[Any]]:
    """A chunk's rows: one array a column."""
    return [column.values(chunk, xyz) for column in columns]


Memory = list[tuple[Column, NDArray[Any]]]
"""Where rows go, column by column."""


class Portion(Protocol):
    """Some consecutive rows."""

    def __len__(self) -> int: ...

    def part(self, start: int, stop: int) -> Self:
        """Rows start..stop-1."""


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """Rows as a sink stores them: one array a column, its values or the numbers that they follow from."""

    arrays: Sequence[NDArray[Any]]

    def __len__(self) -> int:
        return len(self.arrays[0])

    def part(self, start: int, stop: int) -> Stored:
        """Rows start..stop-1."""
        return Stored([array[start:stop] for array in self.arrays])


def copied(rows: Stored, memory: Memory) -> None:
    """Fills memory with rows that are stored already."""
    for (_, free), array in zip(memory, rows.arrays, strict=True):
        free[:] = array


class ParquetSink:
    """Takes rows in any portions and writes them to a file that the caller made.

    Rows are collected in row groups of a fixed number of rows. Each thread fills one and encodes it; they are
    written in their order, so that the bytes do not depend on how many threads there are.
    """

    def __init__(
        self, path: Path, shown: Path, columns: Sequence[Column], metadata: dict[str, Any], threads: int = 1
    ) -> None:
        """Open `path` for writing; errors speak of `shown`.

        Args:
            threads: how many may work at a time.

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
            **_page_options(),
        }
        self._threads = min(threads, MOST_ENCODERS)
        self._spare = [self._empty_group() for _ in range(self._threads)]
        self._footer = Footer(self._schema, **self._options)
        self._flushed, self._flushes = 0, BackgroundCalls("flush")
        try:
            self._file = path.open("wb")
            self._file.write(MAGIC)
        except OSError as error:
            raise output_error(error, shown) from error

    def _empty_group(self) -> list[NDArray[Any]]:
        """Memory for one row group, a column each."""
        return [np.empty(ROW_GROUP_ROWS, column.dtype) for column in self.columns]

    def write(self, portions: Iterator[P], fill: Callable[[P, Memory], R]) -> Generator[list[R]]:
        """Write all rows of a file; group by group, what filling it gave, once it is written.

        Args:
            portions: rows; they are taken by the threads that encode, by one at a time.
            fill: puts a portion into memory for so many rows of each column.

        Raises:
            OutputError: the disk is full, or fails.
        """
        work = partial(self._encoded, fill)
        with contextlib.closing(parallel_pull(work, _groups(portions), self._threads)) as groups:
            for group, filled in groups:
                self._append(group)
                yield filled

    def _encoded(self, fill: Callable[[P, Memory], R], portions: list[P]) -> tuple[EncodedGroup, list[R]]:
        """A row group of portions, which are let go of once it is filled, and what filling it gave."""
        memory, filled, rows = self._spare.pop(), [], 0
        for portion in portions:
            here = slice(rows, rows + len(portion))
            free = [(column, held[here]) for column, held in zip(self.columns, memory, strict=True)]
            filled.append(fill(portion, free))
            rows = here.stop
        portions.clear()
        group = self._group({c.name: held[:rows] for c, held in zip(self.columns, memory, strict=True)}, rows)
        self._spare.append(memory)
        return group, filled

    def _group(self, stored: Mapping[str, NDArray[Any]], rows: int) -> EncodedGroup:
        """A row group, encoded from where its columns lie; `pa.array` would load pandas."""
        found = _places(self.columns, stored)
        made, arrays, encodings = {}, [], {}
        for at, column in enumerate(self.columns):
            chunk = _made(column, found.get(column.name), stored[column.name])
            if chunk is not None:
                made[at] = chunk
            else:
                values = _values_of_stored(column, stored)
                arrays.append(pa.Array.from_buffers(column.type, rows, [None, pa.py_buffer(values)]))
                encodings[column.name] = _encoding(values)
        schema = pa.schema([self._schema.field(name) for name in encodings])
        batch = pa.record_batch(arrays, schema=schema)
        return encoded(batch, rows, made, **self._options, column_encoding=encodings)

    def _append(self, group: EncodedGroup) -> None:
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


def _page_options() -> dict[str, int]:
    """What lets pyarrow end a page after PAGE_ROWS rows of single precision; newer ones limit rows, too."""
    options = {"write_batch_size": PAGE_ROWS, "data_page_size": 4 * PAGE_ROWS}
    known = "max_rows_per_page" in inspect.signature(pq.ParquetWriter.__init__).parameters
    return options | ({"max_rows_per_page": PAGE_ROWS} if known else {})


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


def _made(column: Column, place: Places | None, stored: NDArray[Any]) -> ColumnChunk | None:
    """A column of a row group whose pages are not pyarrow's; None where they are."""
    if place is not None and column.numbers is not None:
        return dictionary_chunk(column.name, place.of_rows, column.numbers.values(*place.present), LEVEL)
    return delta_chunk(column.name, stored, LEVEL) if pa.types.is_timestamp(column.type) else None


def _values_of_stored(column: Column, stored: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """The values of a column of a row group."""
    held, numbers = stored[column.name], column.numbers
    if numbers is None:
        return held
    return numbers.values(held, *([] if numbers.beside is None else [stored[numbers.beside]]))


def _encoding(values: NDArray[Any]) -> str:
    """Of a column of a row group: what makes it small.

    Fractions that repeat are found by the codec as they are; of others only the high bytes are alike, and
    compress better side by side.
    """
    if values.dtype != np.float32:
        return "DELTA_BINARY_PACKED" if values.dtype == np.int64 else "PLAIN"
    sample = np.sort(values.view(np.uint32)[::SAMPLED])  # several times faster than np.unique
    different = 1 + np.count_nonzero(sample[1:] != sample[:-1])
    return "PLAIN" if different <= MOST_DIFFERENT * len(sample) else "BYTE_STREAM_SPLIT"


class ParquetSource:
    """Reads a calibrated recording back, in portions of any number of rows."""

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
                self._file = pq.ParquetFile(stack.enter_context(path.open("rb")))
            except (OSError, pa.ArrowException) as error:
                raise self._unreadable(error) from error
            self._open = stack.pop_all()
        schema = self._file.schema_arrow
        self.names: list[str] = schema.names if columns is None else list(columns)
        self.rows: int = self._file.metadata.num_rows
        self._batches = self._file.iter_batches(SOURCE_ROWS, columns=self.names)
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
            if lacking(error) is not None:
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
