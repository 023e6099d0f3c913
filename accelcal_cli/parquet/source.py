"""Parquet files read back: a calibrated recording in portions of any number of rows, or only its schema."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError, missing_resource

BATCH_ROWS = 1 << 17
"""Rows that pyarrow decodes at a time."""


def read_schema(path: Path) -> pa.Schema | None:
    """Read the schema of a file; None if it is not a Parquet file, or a damaged one.

    Raises:
        OSError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return pq.read_schema(file)
    except (OSError, pa.ArrowException) as error:
        if getattr(error, "errno", None) is None:  # Arrow's errors for damage, one of which is an OSError
            return None
        raise


class ParquetSource:
    """Reads a calibrated recording back, in portions of any number of rows.

    pyarrow neither reads ahead, since it would keep all of that to the end, nor starts threads, since it may
    end the process where one cannot start.
    """

    def __init__(self, path: Path, columns: Sequence[str] | None = None) -> None:
        """Open a file.

        Args:
            columns: names of the columns to read, in this order, all of which the file has; None: all.

        Raises:
            UnreadableError: it is not a Parquet file, or cannot be read.
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
        self._batches = self._file.iter_batches(BATCH_ROWS, columns=self.names, use_threads=False)
        self._rest = [_values(pa.array([], schema.field(name).type)) for name in self.names]

    def other_column(self, schema: pa.Schema) -> str | None:
        """Return the first column whose name or type differs from a schema; None if none does."""
        for found, wanted in zip_longest(self._file.schema_arrow, schema):
            if found is None or wanted is None or (found.name, found.type) != (wanted.name, wanted.type):
                return str((found or wanted).name)
        return None

    def take(self, number: int) -> list[NDArray[Any]]:
        """Return the next `number` rows, fewer at the end: one array for each column, times as int64.

        Raises:
            UnreadableError: the file is damaged.
        """
        parts, need = [self._rest], number - len(self._rest[0])
        while need > 0 and (batch := self._next_batch()) is not None:
            parts.append(batch)
            need -= len(batch[0])
        joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
        self._rest = [column[number:] for column in joined]
        return [column[:number] for column in joined]

    def _next_batch(self) -> list[NDArray[Any]] | None:
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
    """Return a column as numpy values, times as int64."""
    plain = column.cast(pa.int64()) if pa.types.is_timestamp(column.type) else column
    return np.asarray(plain.to_numpy(zero_copy_only=False))
