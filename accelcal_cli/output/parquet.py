"""The calibrated recording as Parquet, streamed in row groups of fixed size.

Columns and metadata: see docs/outputs.md. Row groups do not depend on how the rows were chunked,
so that the file's bytes do not either.

Calibrated Parquet files read back, as streams.
"""

from __future__ import annotations

import contextlib
import json
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.parallel import BackgroundWriter
from accelcal_cli.output.files import METADATA_KEY, output_error

ROW_GROUP_ROWS = 1 << 20
WRITE_BATCH_ROWS = 1 << 16
PORTION_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Columns:
    """Which columns a recording has.

    Attributes:
        utc: times are UTC.
        split: those whose values hardly repeat while their high bytes do, so that bytes of one place
            compress better side by side.
    """

    temperature: bool
    gyroscope: bool
    utc: bool
    split: tuple[str, ...] = ()

    def schema(self, metadata: dict[str, Any]) -> pa.Schema:
        """Arrow schema with units in the fields' metadata."""
        fields = [_field("time", pa.timestamp("us", "UTC" if self.utc else None), "us since 1970")]
        fields += [_field(name, pa.float32(), "g") for name in "xyz"]
        if self.temperature:
            fields.append(_field("temperature", pa.float32(), "degree Celsius"))
        if self.gyroscope:
            fields += [_field(name, pa.float32(), "deg/s") for name in ("gx", "gy", "gz")]
        fields.append(_field("validity", pa.uint8(), "0 measured, 1 filled, 2 clipped, 3 recovered"))
        text = json.dumps(metadata, sort_keys=True, allow_nan=False)
        return pa.schema(fields, metadata={METADATA_KEY: text.encode()})


def _field(name: str, kind: pa.DataType, unit: str) -> pa.Field:
    return pa.field(name, kind, nullable=False, metadata={b"unit": unit.encode()})


class ParquetSink:
    """Takes rows in any portions and writes them to a file that the caller made.

    Rows are collected in one of two row groups that are used in turn; a full one is encoded on a
    thread of its own while the other fills. With one thread there is one row group.
    """

    def __init__(
        self, path: Path, shown: Path, columns: Columns, metadata: dict[str, Any], threads: int = 1
    ) -> None:
        """Open `path` for writing; errors speak of `shown`.

        It is opened here because pyarrow takes names as UTF-8 alone.

        Args:
            threads: how many may work at a time.

        Raises:
            OutputError: the file cannot be written.
        """
        self.shown = shown
        self.schema = columns.schema(metadata)
        self._groups = [self._empty_group() for _ in range(min(threads, 2))]
        self._rows = 0
        self._encoding: Future[None] | None = None
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="parquet")
        self._thread.submit(int).result()
        encodings = dict.fromkeys(self.schema.names, "PLAIN") | {"time": "DELTA_BINARY_PACKED"}
        encodings |= dict.fromkeys(columns.split, "BYTE_STREAM_SPLIT")
        try:
            self._file = _opened(path, threads)
            self._writer = pq.ParquetWriter(
                self._file,
                self.schema,
                compression="zstd",
                compression_level=1,
                use_dictionary=False,
                column_encoding=encodings,
                write_batch_size=WRITE_BATCH_ROWS,
                write_statistics=["time"],
                store_schema=True,
            )
        except OSError as error:
            raise output_error(error, shown) from error

    def _empty_group(self) -> list[NDArray[Any]]:
        """Room for one row group, a column each; times as whole microseconds."""
        kinds = [np.int64 if name == "time" else kind.to_pandas_dtype() for name, kind in self._kinds()]
        return [np.empty(ROW_GROUP_ROWS, kind) for kind in kinds]

    def _kinds(self) -> list[tuple[str, pa.DataType]]:
        return [(field.name, field.type) for field in self.schema]

    def write(self, arrays: list[NDArray[Any]]) -> None:
        """Take rows: one array a column, in the order of the schema.

        Raises:
            OutputError: the disk is full, or fails.
        """
        start, stop = 0, len(arrays[0])
        while start < stop:
            take = min(stop - start, ROW_GROUP_ROWS - self._rows)
            for column, array in zip(self._groups[0], arrays, strict=True):
                column[self._rows : self._rows + take] = array[start : start + take]
            self._rows += take
            start += take
            if self._rows == ROW_GROUP_ROWS:
                self._flush()

    def _flush(self) -> None:
        """Hand the full group to the thread, once it is done with the one before."""
        self._wait()
        self._encoding = self._thread.submit(self._encode, self._groups[0], self._rows)
        self._groups.reverse()
        self._rows = 0
        if len(self._groups) == 1:
            self._wait()

    def _encode(self, group: list[NDArray[Any]], rows: int) -> None:
        """Write a row group from where its columns lie; `pa.array` would load pandas."""
        columns = [
            pa.Array.from_buffers(kind, rows, [None, pa.py_buffer(values)])
            for values, (_, kind) in zip(group, self._kinds(), strict=True)
        ]
        self._writer.write_batch(pa.record_batch(columns, schema=self.schema), ROW_GROUP_ROWS)

    def _wait(self) -> None:
        """Raises OutputError if the thread could not write."""
        encoding, self._encoding = self._encoding, None
        try:
            if encoding is not None:
                encoding.result()
        except OSError as error:
            raise output_error(error, self.shown) from error

    def close(self) -> None:
        """Write what is left, and the footer; without it the file is not complete.

        Raises:
            OutputError: the disk is full, or fails.
        """
        if self._rows:
            self._flush()
        self._wait()
        try:
            self._writer.close()
            self._file.close()
        except OSError as error:
            raise output_error(error, self.shown) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._thread.shutdown()
        with contextlib.suppress(OSError):
            self._writer.close()
        with contextlib.suppress(OSError):
            self._file.close()


def _opened(path: Path, threads: int) -> pa.NativeFile:
    """A new file; what is encoded gathers first, since every portion takes Python's lock."""
    file = path.open("wb")
    return pa.BufferedOutputStream(
        pa.PythonFile(BackgroundWriter(file) if threads > 1 else file, "w"), PORTION_BYTES
    )


SOURCE_ROWS = 1 << 17


class ParquetSource:
    """Reads a calibrated recording back, in portions of any number of rows."""

    def __init__(self, path: Path) -> None:
        """Open a file.

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
        self.names: list[str] = self._file.schema_arrow.names
        self.rows: int = self._file.metadata.num_rows
        self._batches = self._file.iter_batches(SOURCE_ROWS)
        self._held = [_values(pa.array([], field.type)) for field in self._file.schema_arrow]

    def other_column(self, schema: pa.Schema) -> str | None:
        """The first column that is not as in a schema, in name or type; None if all are."""
        pairs = zip_longest(self._file.schema_arrow, schema)
        for held, wanted in pairs:
            if held is None or wanted is None or (held.name, held.type) != (wanted.name, wanted.type):
                return str((held or wanted).name)
        return None

    def take(self, number: int) -> list[NDArray[Any]]:
        """The next rows, fewer at the end: one array a column, times as int64.

        Raises:
            UnreadableError: the file is damaged.
        """
        parts, need = [self._held], number - len(self._held[0])
        while need > 0 and (batch := self._next()) is not None:
            parts.append(batch)
            need -= len(batch[0])
        joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
        self._held = [column[number:] for column in joined]
        return [column[:number] for column in joined]

    def _next(self) -> list[NDArray[Any]] | None:
        try:
            batch = next(self._batches, None)
        except (OSError, pa.ArrowException) as error:
            raise self._unreadable(error) from error
        return None if batch is None else [_values(column) for column in batch.columns]

    def _unreadable(self, error: Exception) -> UnreadableError:
        return UnreadableError(f"cannot be read as Parquet ({error})", path=self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
        self._open.close()


def _values(column: pa.Array) -> NDArray[Any]:
    """A column as numpy values, times as int64."""
    plain = column.cast(pa.int64()) if pa.types.is_timestamp(column.type) else column
    return np.asarray(plain.to_numpy(zero_copy_only=False))
