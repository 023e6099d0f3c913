"""The second pass: raw counts to calibrated values, and these into Parquet, a chunk at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.calibration import Axes, RawRows, Transform
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.recording import Chunk
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.jobs import Progress

if TYPE_CHECKING:  # not every run writes Parquet, and pyarrow takes as long to load as all of accelcal
    from accelcal_cli.parquet import Column, Memory, Numbers, ParquetSink

FINEST = 1 << 20
"""Steps or counts of one g; more are too many values for a table, as those of a text are."""

NEGATIVE_ZERO = -1
"""Stands for a zero with a sign, which no whole number has, among halves of steps."""


AXES = "xyz"
"""Names of the columns."""


def transform_of(data: ReportInput) -> Transform:
    """What applies a result's calibration to its recording."""
    return Transform.of(data.judgement.calibration, data.recording.lsb_per_g, data.settings.precision_mg)


def calibrated(
    chunks: Iterable[Chunk], transform: Transform, progress: Progress
) -> Iterator[tuple[Chunk, Axes]]:
    """A recording's chunks, none of them empty, each with its calibrated x, y, z [g]."""
    for chunk in chunks:
        if len(chunk):
            yield chunk, transform.apply(chunk)
        progress(chunk.end_byte)


def beyond(chunk: Chunk, transform: Transform, range_g: float | None) -> int:
    """How many samples of a chunk lie beyond the sensor's range once they are calibrated."""
    if range_g is None or not len(chunk) or (transform.reach_g(chunk) <= range_g).all():
        return 0
    over = [np.abs(values) > range_g for values in transform.apply(chunk)]
    return int((over[0] | over[1] | over[2]).sum())


def columns_of(data: ReportInput) -> list[Column]:
    """The columns of a result's Parquet file."""
    from accelcal_cli.output import columns

    applied = transform_of(data)
    axes = numbers_of_axes(applied, data.facts.has_temperature)
    found = columns.columns_of(data.recording, data.facts, axes, data.gyroscope)
    return found if data.judgement.calibration is not None else columns.not_calibrated(found)


def numbers_of_axes(transform: Transform, has_temperature: bool) -> dict[str, Numbers]:
    """The whole numbers that calibrated values follow from: steps, or the counts of one axis."""
    from accelcal_cli.output.columns import TEMPERATURE
    from accelcal_cli.parquet import Numbers

    steps = transform.steps_per_g
    if steps is not None and steps <= FINEST:
        return {
            name: Numbers(
                partial(_half_steps, axis, steps),
                partial(_of_half_steps, steps),
                np.float32,
                calibrated=True,
            )
            for axis, name in enumerate(AXES)
        }
    if transform.lsb_per_g > FINEST:
        return {}
    warm = has_temperature & (transform.slope_g_per_c != 0)
    return {
        name: Numbers(
            partial(_counts, axis),
            partial(_of_counts, transform, axis),
            beside=TEMPERATURE if warm[axis] else None,
        )
        for axis, name in enumerate(AXES)
        if transform.depends_on_one_axis(axis)
    }


def _half_steps(axis: int, steps_per_g: float, _chunk: Chunk, xyz: Axes) -> NDArray[np.float32]:
    """Halves of steps, of which only whole steps occur, and NEGATIVE_ZERO; powers of two round nothing."""
    values = xyz[axis]
    halves = values * np.float32(2 * steps_per_g)
    halves[(values == 0) & np.signbit(values)] = NEGATIVE_ZERO
    return halves


def _of_half_steps(steps_per_g: float, halves: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.where(halves == NEGATIVE_ZERO, np.float32(-0.0), halves / np.float32(2 * steps_per_g))


def _counts(axis: int, chunk: Chunk, _xyz: Axes) -> NDArray[Any]:
    return chunk.counts[:, axis]


def _of_counts(
    transform: Transform,
    axis: int,
    counts: NDArray[np.int32],
    temperature_mc: NDArray[np.int32] | None = None,
) -> NDArray[np.float32]:
    """Calibrated values of counts of one axis, whatever the others are."""
    from accelcal_cli.output.columns import NO_TEMPERATURE_MC

    if temperature_mc is None:
        return _of_axis(transform, axis, counts)
    warm = _of_axis(transform, axis, counts, temperature_mc)
    absent = temperature_mc == NO_TEMPERATURE_MC
    return np.where(absent, _of_axis(transform, axis, counts), warm) if absent.any() else warm


def _of_axis(
    transform: Transform,
    axis: int,
    counts: NDArray[np.int32],
    temperature_mc: NDArray[np.int32] | None = None,
) -> NDArray[np.float32]:
    """Calibrated values of one axis where the others have no counts."""
    alone, memory = np.zeros((len(counts), 3), np.int32), [np.empty(0, np.float32)] * 3
    alone[:, axis] = counts
    memory[axis] = np.empty(len(counts), np.float32)
    transform.apply_into(RawRows(alone, temperature_mc), memory)
    return memory[axis]


def write_calibrated(
    data: ReportInput, chunks: Iterable[Chunk], sink: ParquetSink, threads: int, progress: Progress
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

    read = prefetch(iter(chunks), threads - 1)  # with two, the second encodes
    with closing(sink.write(read, fill)) as groups:
        for filled in groups:
            total += sum(over for over, _ in filled)
            progress(filled[-1][1] if filled else 0)
    return total


def _fill(columns: Memory, rows: Chunk, transform: Transform) -> None:
    """Put rows where a sink wants them: an axis that is stored as it is, there at once."""
    xyz = [np.empty(0, np.float32)] * 3
    for column, memory in columns:
        if column.name in AXES and column.numbers is None:
            xyz[AXES.index(column.name)] = memory
        elif column.numbers is not None and column.numbers.calibrated:
            xyz[AXES.index(column.name)] = np.empty(len(rows), np.float32)
    transform.apply_into(rows, xyz)
    for column, memory in columns:
        stored = column.stored(rows, xyz)
        if stored is not memory:
            memory[:] = stored
