"""Calibrated rows as a stream, for a program that reads them while they come: Arrow IPC or CSV.

Columns and units are those of the Parquet file (docs/outputs.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.csv as pa_csv

from accelcal_cli.core.clock import utc_offset_s
from accelcal_cli.core.recording import Chunk, Closing, Recording
from accelcal_cli.core.results import Facts, SampleCounts
from accelcal_cli.output.files import output_error
from accelcal_cli.output.parquet import Axes, Column, columns_of, schema_of, values_of

ARROW, CSV = "arrow", "csv"
KINDS = (ARROW, CSV)


class RowStream(Closing):
    """Writes rows as they come.

    Args:
        target: an open file; it is not closed.
        shown: what errors call it.
        kind: one of KINDS.
    """

    def __init__(self, target: BinaryIO, shown: Path, kind: str, recording: Recording) -> None:
        self._target, self._shown = target, shown
        self._columns = _columns(recording)
        schema = schema_of(self._columns, {})
        self._writer: Any = (pa.ipc.new_stream if kind == ARROW else pa_csv.CSVWriter)(target, schema)
        self._schema = schema

    def write(self, chunk: Chunk, xyz: Axes) -> None:
        """Write rows, and let the reader have them.

        Raises:
            OutputError: they cannot be written.
        """
        values = values_of(self._columns, chunk, xyz)
        arrays = [pa.array(each, column.type) for each, column in zip(values, self._columns, strict=True)]
        try:
            self._writer.write_batch(pa.record_batch(arrays, schema=self._schema))
            self._target.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            raise output_error(error, self._shown) from error

    def close(self) -> None:
        """Write what ends the stream."""
        try:
            self._writer.close()
            self._target.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            raise output_error(error, self._shown) from error


def _columns(recording: Recording) -> Sequence[Column]:
    """Of what is known before the rows come."""
    facts = Facts(
        samples=0,
        first_us=recording.start_us,
        last_us=None,
        rate_hz=None,
        gaps=(),
        gaps_omitted=0,
        problems=(),
        counts=SampleCounts(),
        has_temperature=recording.has_temperature,
        has_gyroscope=recording.gyro_dps_per_lsb is not None,
        utc_offset_s=None
        if recording.start_us is None
        else utc_offset_s(recording.timezone, recording.start_us),
    )
    return columns_of(recording, facts, "")
