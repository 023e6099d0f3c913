"""Calibrated Parquet files read back, as streams."""

from __future__ import annotations

import contextlib
from itertools import zip_longest
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError

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
