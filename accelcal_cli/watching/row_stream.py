"""Calibrated rows as a stream, for a program that reads them while they come: Arrow IPC or CSV.

Columns and units are those of the Parquet file (docs/outputs.md).
"""

from __future__ import annotations

import contextlib
import io
import os
import stat
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv as pa_csv

from accelcal_cli.core.clock import utc_offset_s
from accelcal_cli.core.errors import output_error
from accelcal_cli.core.recording import Chunk, Closing, Recording
from accelcal_cli.core.results import Facts, SampleCounts
from accelcal_cli.output.columns import recording_columns, schema_of, values_of
from accelcal_cli.output.files import discard
from accelcal_cli.parquet import Axes, Column


class RowStream(Closing):
    """Turns rows into the bytes of a stream as they come.

    Args:
        put: is called with each piece, which holds whole rows.
        kind: `arrow` or `csv`.
    """

    def __init__(self, put: Callable[[bytes], None], kind: str, recording: Recording) -> None:
        self._put, self._made = put, io.BytesIO()
        self._columns = _columns(recording)
        self._schema = schema_of(self._columns, {})
        begin = pa.ipc.new_stream if kind == "arrow" else pa_csv.CSVWriter
        self._writer: Any = begin(self._made, self._schema)

    def write(self, chunk: Chunk, xyz: Axes) -> None:
        """Write rows, which the reader of the stream can see at once."""
        values = values_of(self._columns, chunk, xyz)
        arrays = [pa.array(each, column.type) for each, column in zip(values, self._columns, strict=True)]
        self._writer.write_batch(pa.record_batch(arrays, schema=self._schema))
        self._pass_on()

    def close(self) -> None:
        """Write the end of the stream."""
        self._writer.close()
        self._pass_on()

    def _pass_on(self) -> None:
        piece = self._made.getvalue()
        self._made.seek(0)
        self._made.truncate()
        self._put(piece)


class RowFile(Closing):
    """A new file, pipe or device; a file holds each piece as a whole or not at all.

    Raises:
        OutputError: it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._bytes = path, 0
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise output_error(error, path) from error
        self._regular = stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)

    def put(self, piece: bytes) -> None:
        """Write a piece; raises OutputError if that fails, and BrokenPipeError if the reader is gone."""
        left = memoryview(piece)
        try:
            while left:
                left = left[self._file.write(left) :]
        except BrokenPipeError:
            raise
        except OSError as error:
            if self._regular:  # a part of a piece is removed, and a file without a row
                with contextlib.suppress(OSError):
                    self._file.truncate(self._bytes)
                    self._file.seek(self._bytes)
                if not self._bytes:
                    discard(self._path)
            raise output_error(error, self._path) from error
        self._bytes += len(piece)

    def close(self) -> None:
        """Bring what was written to the disk, and close the file; raises OutputError where that fails."""
        try:
            with self._file:
                if self._regular:
                    os.fsync(self._file.fileno())
        except OSError as error:
            raise output_error(error, self._path) from error


def _columns(recording: Recording) -> Sequence[Column]:
    """Return the columns, by what is known before the rows come."""
    start_us = recording.start_us
    facts = Facts(
        samples=0,
        first_us=start_us,
        last_us=None,
        rate_hz=None,
        gaps=(),
        gaps_omitted=0,
        problems=(),
        counts=SampleCounts(),
        has_temperature=recording.has_temperature,
        has_gyroscope=recording.gyro_dps_per_lsb is not None,
        utc_offset_s=None if start_us is None else utc_offset_s(recording.timezone, start_us),
    )
    return recording_columns(recording, facts)
