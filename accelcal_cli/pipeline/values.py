"""The calibrated Parquet file beside a report, against the report and against its recording, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UsageError
from accelcal_cli.output.document import Document
from accelcal_cli.output.parquet_metadata import metadata_of
from accelcal_cli.output.parquet_source import ParquetSource
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.applying import calibrated, rows
from accelcal_cli.pipeline.compare import differing
from accelcal_cli.pipeline.passes import Passes, applier_of
from accelcal_cli.pipeline.plan import PARQUET_SUFFIX, REPORT_SUFFIX
from accelcal_cli.pipeline.writing import columns_of


@dataclass(frozen=True, slots=True)
class Values:
    """What the comparison found: the first row that differs and its column, None where none does."""

    rows: int
    first_row: int | None = None
    column: str | None = None


@dataclass(frozen=True, slots=True)
class ParquetCheck:
    """The Parquet file beside a report.

    Attributes:
        differs: keys of its metadata that are not the report's.
        values: None where they were not asked for.
    """

    path: Path
    differs: tuple[str, ...]
    values: Values | None

    @property
    def differing(self) -> tuple[str, ...]:
        """Keys of the metadata that differ, and `values` where these do."""
        apart = self.values is not None and self.values.first_row is not None
        return (*self.differs, *(("values",) if apart else ()))


def check_parquet(
    made: tuple[Passes, ReportInput] | None, document: Document, *, values: bool
) -> ParquetCheck | None:
    """Compare the Parquet file beside a report with the report, and with its recording.

    Args:
        made: the recording's passes and result; None where the result has no calibrated data.
        values: compare every value too.

    Returns:
        None where no such file lies there.

    Raises:
        UsageError: values are to be compared, but there are none.
    """
    path = None if made is None else _parquet_beside(document.path)
    if path is None or made is None:
        if values:
            raise UsageError(
                "no calibrated Parquet file lies beside it", path=document.path, hint="leave --values out"
            )
        return None
    held, named = metadata_of(path), ("accelcal_version", "calibration", "recording")
    said = {name: document.report.get(name) for name in named}
    keys = tuple(differing({name: held.get(name) for name in named}, said))
    return ParquetCheck(path, keys, compare_values(*made, path) if values else None)


def _parquet_beside(report: Path) -> Path | None:
    stem = report.name.removesuffix(REPORT_SUFFIX)
    names = (stem + PARQUET_SUFFIX, stem + ".parquet", stem)
    found = (report.with_name(name) for name in names if name != report.name)
    return next((path for path in found if path.is_file()), None)


def compare_values(passes: Passes, data: ReportInput, path: Path) -> Values:
    """Compare every value of every column.

    Raises:
        UnreadableError: the Parquet file or the recording cannot be read.
    """
    columns = columns_of(data)
    with ParquetSource(path) as source:
        wrong = source.other_column(columns.schema({}))
        if wrong is not None:
            return Values(0, 0, wrong)
        done = 0
        for held, made in _pairs(passes, data, source):
            found = _first_difference(held, made)
            if found is not None:
                return Values(done + found[0], done + found[0], source.names[found[1]])
            done += len(made[0])
        return Values(done) if source.rows == done else Values(done, done, source.names[0])


def _pairs(
    passes: Passes, data: ReportInput, source: ParquetSource
) -> Iterator[tuple[list[NDArray[Any]], list[NDArray[Any]]]]:
    """Columns as they are in the file and as they should be, some rows at a time."""
    shown = passes.progress("comparing", data.recording.total_bytes)
    chunks = passes.reader.chunks(passes.request.chunk_samples)
    offset_s = data.facts.utc_offset_s or 0
    for chunk, xyz in calibrated(data.recording, chunks, applier_of(data), shown):
        yield source.take(len(chunk)), rows(chunk, xyz, data.recording, source.names, offset_s)


def _first_difference(held: list[NDArray[Any]], made: list[NDArray[Any]]) -> tuple[int, int] | None:
    """Row and column of the first bits that differ; rows that the file lacks differ."""
    places = [_row(a, b) for a, b in zip(held, made, strict=True)]
    found = [(row, column) for column, row in enumerate(places) if row is not None]
    return min(found) if found else None


def _row(held: NDArray[Any], made: NDArray[Any]) -> int | None:
    common = min(len(held), len(made))
    same = _bits(held[:common]) == _bits(made[:common])
    if not same.all():
        return int(np.argmin(same))
    return common if len(held) != len(made) else None


def _bits(values: NDArray[Any]) -> NDArray[Any]:
    """Values as integers, so that a NaN equals itself and the two zeros differ."""
    held = np.ascontiguousarray(values)
    return held.view(f"i{held.dtype.itemsize}")
