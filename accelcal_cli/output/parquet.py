"""The calibrated recording as Parquet: its columns, a sink that writes them, a source that reads them back.

Columns and metadata are described in docs/outputs.md. Files are streamed in row groups of fixed size,
which do not depend on how the rows were chunked, so that the file's bytes do not either.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError, lacking
from accelcal_cli.core.parallel import BackgroundWriter, OrderedCalls
from accelcal_cli.core.recording import METADATA_KEY, NOT_CALIBRATED, Chunk, Recording
from accelcal_cli.core.results import Facts
from accelcal_cli.core.rotations import Gyroscope
from accelcal_cli.core.zones import UNKNOWN, UTC
from accelcal_cli.output.files import output_error
from accelcal_cli.output.row_groups import MAGIC, EncodedGroup, Footer, encoded

ROW_GROUP_ROWS = 1 << 19
WRITE_BATCH_ROWS = 1 << 16

MOST_ENCODERS = 8
"""Row groups that are encoded side by side; each takes 11 MB, 17 with a gyroscope."""

TIME_ZONE_KEY = b"time_zone"
"""Of the schema's metadata: what `time` is in, UTC or unknown."""

BLOCK_ROWS = 1 << 14
"""Angular rates are calibrated so many at a time, which the processor's cache holds."""

SOURCE_ROWS = 1 << 17
"""Rows that are read back at a time."""

Axes = list[NDArray[np.float32]]
"""Calibrated x, y, z [g]."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a calibrated recording.

    Attributes:
        unit: of its values, for the field's metadata.
        values: of a chunk and its calibrated x, y, z [g]: one for each row.
        encoding: of Parquet.
    """

    name: str
    unit: str
    type: pa.DataType
    values: Callable[[Chunk, Axes], NDArray[Any]]
    encoding: str = "PLAIN"

    @property
    def field(self) -> pa.Field:
        """In the Arrow schema."""
        return pa.field(self.name, self.type, nullable=False, metadata={b"unit": self.unit.encode()})

    @property
    def dtype(self) -> Any:
        """Of its values in numpy; times are whole microseconds."""
        return np.int64 if pa.types.is_timestamp(self.type) else self.type.to_pandas_dtype()


def columns_of(
    recording: Recording, facts: Facts, fine_axes: str, gyroscope: Gyroscope | None = None
) -> list[Column]:
    """All columns of a calibrated recording: THE place for a new one.

    Args:
        fine_axes: those of x, y, z whose values hardly repeat while their high bytes do, so that bytes
            of one place compress better side by side.
        gyroscope: the verdict on it; without a scale matrix its values stay raw.
    """
    single, offset_s = pa.float32(), facts.utc_offset_s
    time = pa.timestamp("us", None if offset_s is None else UTC)
    columns = [Column("time", "us since 1970", time, partial(_times, offset_s or 0), "DELTA_BINARY_PACKED")]
    for axis, name in enumerate("xyz"):
        encoding = "BYTE_STREAM_SPLIT" if name in fine_axes else "PLAIN"
        columns.append(Column(name, "g", single, partial(_calibrated, axis), encoding))
    if facts.has_temperature:
        columns.append(Column("temperature", "degree Celsius", single, _temperature))
    if facts.has_gyroscope:
        known = gyroscope is not None and gyroscope.scale is not None
        rates = _Rates(recording.gyro_dps_per_lsb, gyroscope if known else None)
        encoding = "BYTE_STREAM_SPLIT" if known else "PLAIN"
        columns += [
            Column(f"g{name}", "deg/s", single, partial(rates.values, axis), encoding)
            for axis, name in enumerate("xyz")
        ]
    columns.append(Column("validity", "0 measured, 1 filled, 2 clipped, 3 recovered", pa.uint8(), _validity))
    return columns


def _times(offset_s: int, chunk: Chunk, _xyz: Axes) -> NDArray[np.int64]:
    """In UTC, by how many seconds the device's clock is ahead of it."""
    times = chunk.clock.times(0, len(chunk))
    return times - offset_s * MICROSECONDS if offset_s else times


def _calibrated(axis: int, _chunk: Chunk, xyz: Axes) -> NDArray[np.float32]:
    return xyz[axis]


def _temperature(chunk: Chunk, _xyz: Axes) -> NDArray[np.float32]:
    if chunk.temperature_mc is None:
        return np.full(len(chunk), np.nan, np.float32)
    return (chunk.temperature_mc / 1000.0).astype(np.float32)


class _Rates:
    """Angular rates of chunks, raw or calibrated; those of one chunk are kept until the next comes."""

    def __init__(self, dps_per_lsb: tuple[float, ...] | None, gyroscope: Gyroscope | None) -> None:
        self._dps_per_lsb, self._gyroscope = dps_per_lsb, gyroscope
        self._chunk: Chunk | None = None
        self._held: Axes = []

    def values(self, axis: int, chunk: Chunk, _xyz: Axes) -> NDArray[np.float32]:
        """Of one axis [deg/s]; NaN where a chunk has none."""
        if chunk.gyro_counts is None or self._dps_per_lsb is None:
            return np.full(len(chunk), np.nan, np.float32)
        if self._gyroscope is None:
            return (chunk.gyro_counts[:, axis] * self._dps_per_lsb[axis]).astype(np.float32)
        if self._chunk is not chunk:
            self._chunk, self._held = chunk, self._calibrated(chunk, self._gyroscope)
        return self._held[axis]

    def _calibrated(self, chunk: Chunk, gyroscope: Gyroscope) -> Axes:
        held = [np.empty(len(chunk), np.float32) for _ in range(3)]
        assert chunk.gyro_counts is not None and self._dps_per_lsb is not None
        for start in range(0, len(chunk), BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            raw = [
                np.multiply(chunk.gyro_counts[part, axis], scale, dtype=np.float64)
                for axis, scale in enumerate(self._dps_per_lsb)
            ]
            warm = None if chunk.temperature_mc is None else chunk.temperature_mc[part] / 1000.0
            for column, values in zip(held, gyroscope.calibrated(raw, warm), strict=True):
                column[part] = values
        return held


def _validity(chunk: Chunk, _xyz: Axes) -> NDArray[np.uint8]:
    return np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity


def not_calibrated(columns: Sequence[Column]) -> list[Column]:
    """The columns of a file of raw values: `validity` says so in each row."""
    unit = f"0 measured, 1 filled, 2 clipped, 3 recovered; plus {NOT_CALIBRATED}: not calibrated"

    def flagged(chunk: Chunk, xyz: Axes) -> NDArray[np.uint8]:
        return _validity(chunk, xyz) + np.uint8(NOT_CALIBRATED)

    return [replace(one, unit=unit, values=flagged) if one.name == "validity" else one for one in columns]


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


class ParquetSink:
    """Takes rows in any portions and writes them to a file that the caller made.

    Rows are collected in row groups of a fixed number of rows. A full one is encoded on a thread while others
    fill; they are written in their order, so that the bytes do not depend on how many threads there are.
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
            "compression_level": 1,
            "use_dictionary": False,
            "column_encoding": {column.name: column.encoding for column in columns},
            "write_batch_size": WRITE_BATCH_ROWS,
            "write_statistics": ["time"],
            "store_schema": True,
        }
        encoders = min(threads, MOST_ENCODERS)
        self._spare = [self._empty_group() for _ in range(encoders if threads < 2 else encoders + 1)]
        self._rows = 0
        self._footer = Footer()
        self._encoding = OrderedCalls(encoders, "parquet")
        try:
            file = path.open("wb")
            self._file = BackgroundWriter(file) if threads > 1 else file
            self._file.write(MAGIC)
        except OSError as error:
            raise output_error(error, shown) from error

    def _empty_group(self) -> list[NDArray[Any]]:
        """Memory for one row group, a column each."""
        return [np.empty(ROW_GROUP_ROWS, column.dtype) for column in self.columns]

    def write(self, arrays: list[NDArray[Any]]) -> None:
        """Take rows: one array a column, in the order of the columns.

        Raises:
            OutputError: the disk is full, or fails.
        """
        start, stop = 0, len(arrays[0])
        while start < stop:
            take = min(stop - start, ROW_GROUP_ROWS - self._rows)
            for column, array in zip(self._spare[-1], arrays, strict=True):
                column[self._rows : self._rows + take] = array[start : start + take]
            self._rows += take
            start += take
            if self._rows == ROW_GROUP_ROWS:
                self._flush()

    def _flush(self) -> None:
        """Hand the full group to a thread, and wait until another one can be filled."""
        self._encoding.submit(self._encoded, self._spare.pop(), self._rows)
        self._rows = 0
        while not self._spare:
            self._append()

    def _encoded(self, group: list[NDArray[Any]], rows: int) -> tuple[EncodedGroup, list[NDArray[Any]]]:
        """A row group, encoded from where its columns lie; `pa.array` would load pandas."""
        arrays = [
            pa.Array.from_buffers(column.type, rows, [None, pa.py_buffer(values)])
            for values, column in zip(group, self.columns, strict=True)
        ]
        return encoded(pa.record_batch(arrays, schema=self._schema), **self._options), group

    def _append(self) -> None:
        """Write the first of the groups that are being encoded; raises OutputError."""
        group, memory = self._encoding.first()
        self._spare.append(memory)
        try:
            self._footer.add(group, self._file.tell())
            self._file.write(group.body)
        except OSError as error:
            raise output_error(error, self.shown) from error

    def close(self) -> None:
        """Write what is left, and the footer; without it the file is not complete.

        Raises:
            OutputError: the disk is full, or fails.
        """
        if self._rows or not (self._footer.rows or self._encoding):
            self._encoding.submit(self._encoded, self._spare.pop(), self._rows)
            self._rows = 0
        while self._encoding:
            self._append()
        try:
            self._file.write(self._footer.tail())
            self._file.flush()
            self._file.close()
        except OSError as error:
            raise output_error(error, self.shown) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_failure: object) -> None:
        self._encoding.close()
        with contextlib.suppress(OSError):
            self._file.close()


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
