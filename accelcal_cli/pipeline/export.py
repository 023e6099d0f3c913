"""The second pass: raw counts to calibrated values, and these into Parquet, a chunk at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np

from accelcal_cli.core.calibration import Axes, Transform
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.recording import Chunk
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.jobs import Progress

if TYPE_CHECKING:  # not every run writes Parquet, and pyarrow takes as long to load as all of accelcal
    from accelcal_cli.parquet import Column, Memory, ParquetSink

AXES = "xyz"
"""Names of the columns of acceleration."""


def transform_of(data: ReportInput) -> Transform:
    """Return the transform that applies a result's calibration to its recording."""
    return Transform.of(data.judgement.calibration, data.recording.lsb_per_g, data.settings.precision_mg)


def calibrated(
    chunks: Iterable[Chunk], transform: Transform, progress: Progress
) -> Iterator[tuple[Chunk, Axes]]:
    """Yield a recording's chunks except empty ones, each with its calibrated x, y, z [g]."""
    for chunk in chunks:
        if len(chunk):
            yield chunk, transform.apply(chunk)
        progress(chunk.end_byte)


def beyond(chunk: Chunk, transform: Transform, range_g: float | None) -> int:
    """Return how many samples of a chunk lie beyond the sensor's range once they are calibrated."""
    if range_g is None or not len(chunk) or (transform.reach_g(chunk) <= range_g).all():
        return 0
    over = [np.abs(values) > range_g for values in transform.apply(chunk)]
    return int((over[0] | over[1] | over[2]).sum())


def columns_of(data: ReportInput) -> list[Column]:
    """Return the columns of a result's Parquet file."""
    from accelcal_cli.output.columns import numbers_of_axes, recording_columns, uncalibrated

    axes = numbers_of_axes(transform_of(data), data.facts.has_temperature)
    columns = recording_columns(data.recording, data.facts, axes, data.gyroscope, others=True)
    return columns if data.judgement.calibration is not None else uncalibrated(columns)


def write_calibrated(
    data: ReportInput, chunks: Iterator[Chunk], sink: ParquetSink, threads: int, progress: Progress
) -> int:
    """Write a recording's chunks calibrated, or as they are without a calibration.

    Args:
        threads: how many may work at a time.

    Returns:
        how many calibrated samples lie beyond the sensor's range.

    Raises:
        OutputError: the output cannot be written.
    """
    applied, range_g, total = transform_of(data), data.recording.range_g, 0

    def fill(rows: Chunk, memory: Memory) -> tuple[int, int]:
        _fill(memory, rows, applied)
        return beyond(rows, applied, range_g), rows.end_byte

    read = chunks if threads < 3 else prefetch(chunks, threads)  # of two threads the second encodes
    with closing(sink.write(read, fill)) as groups:
        for filled in groups:
            total += sum(over for over, _ in filled)
            progress(filled[-1][1] if filled else 0)
    return total


def _fill(memory: Memory, rows: Chunk, transform: Transform) -> None:
    """Calibrate rows into a sink's memory; axes that are stored as float32 are written there at once."""
    xyz = [np.empty(0, np.float32)] * 3
    for column, values in memory:
        if column.name in AXES and column.numbers is None:
            xyz[AXES.index(column.name)] = values
        elif column.numbers is not None and column.numbers.calibrated:
            xyz[AXES.index(column.name)] = np.empty(len(rows), np.float32)
    transform.apply_into(rows, xyz)
    for column, values in memory:
        stored = column.stored(rows, xyz)
        if stored is not values:
            values[:] = stored
