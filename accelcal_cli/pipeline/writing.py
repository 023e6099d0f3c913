"""Calibrated rows into Parquet: which columns, and a chunk at a time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.output.parquet import Columns, ParquetSink
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.ahead import ahead
from accelcal_cli.pipeline.applying import Applier, beyond, calibrated, rows
from accelcal_cli.pipeline.request import Progress


def columns_of(data: ReportInput) -> Columns:
    """The columns of a result's Parquet file."""
    facts, utc = data.facts, data.facts.utc_offset_s is not None
    return Columns(facts.has_temperature, facts.has_gyroscope, utc, split_columns(data))


def split_columns(data: ReportInput) -> tuple[str, ...]:
    """Axes whose values are finer than one count, or lie on a coarse grid whose low bytes are zero.

    An axis of one count, or two, has values that come again and again; one of all three has not.
    """
    if data.settings["precision_mg"] is not None:
        return ("x", "y", "z")
    assert data.judgement.calibration is not None
    mixed = np.count_nonzero(data.judgement.calibration.gain(), axis=1) == 3
    return tuple(name for name, all_three in zip("xyz", mixed, strict=True) if all_three)


@dataclass(frozen=True, slots=True)
class Target:
    """Where calibrated rows go.

    Attributes:
        offset_s: seconds that the device's clock is ahead of the times to write.
        threads: how many may work at a time.
    """

    apply: Applier
    sink: ParquetSink
    offset_s: int
    threads: int


def write_calibrated(
    recording: Recording, chunks: Iterable[Chunk], target: Target, progress: Progress
) -> int:
    """Write a recording's chunks calibrated.

    Returns:
        how many calibrated samples lie beyond the sensor's range.

    Raises:
        OutputError: the output cannot be written.
    """
    total, names = 0, target.sink.schema.names
    for chunk, xyz in ahead(calibrated(recording, chunks, target.apply, progress), target.threads):
        total += beyond(xyz, recording.range_g)
        target.sink.write(rows(chunk, xyz, recording, names, target.offset_s))
    return total
