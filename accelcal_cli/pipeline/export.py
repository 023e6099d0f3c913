"""The second pass: raw counts to calibrated values.

Calibrated rows into Parquet: which columns, and a chunk at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import ceil, log2
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.points import Calibration
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.jobs import Progress

if TYPE_CHECKING:  # not every run writes Parquet, and pyarrow takes as long to load as all of accelcal
    from accelcal_cli.output.parquet import Columns, ParquetSink

BLOCK_ROWS = 1 << 14


@dataclass(frozen=True, slots=True)
class Applier:
    """a = K (v + o + s (T - Tref)) for v in counts: K / lsb_per_g on counts plus a constant.

    Attributes:
        steps_per_g: a power of two; calibrated values are rounded to 1 / steps_per_g. None: they are not.
    """

    gain: NDArray[np.float64]
    offset_g: NDArray[np.float64]
    slope_g_per_c: NDArray[np.float64]
    reference_c: float
    lsb_per_g: float
    steps_per_g: float | None = None

    def apply(self, chunk: Chunk) -> list[NDArray[np.float32]]:
        """Calibrated x, y, z of a chunk [g], computed in double and rounded once to single."""
        made = [np.empty(len(chunk), np.float32) for _ in range(3)]
        room = np.empty((5, BLOCK_ROWS))
        for start in range(0, len(chunk), BLOCK_ROWS):
            part = slice(start, min(start + BLOCK_ROWS, len(chunk)))
            self._block(chunk, part, room[:, : part.stop - start], made)
        return made

    def _block(
        self, chunk: Chunk, part: slice, room: NDArray[np.float64], made: list[NDArray[np.float32]]
    ) -> None:
        """Rows that the processor's cache holds, in memory that is used again."""
        shifted, total, product = room[:3], room[3], room[4]
        for axis in range(3):
            self._shift(chunk, part, axis, (shifted[axis], product))
        for row in range(3):
            np.multiply(shifted[row], self.gain[row, row], out=total)
            for column in self._others(row):
                np.multiply(shifted[column], self.gain[row, column], out=product)
                total += product
            if self.steps_per_g is not None:
                total *= self.steps_per_g
                np.rint(total, out=total)
                total /= self.steps_per_g
            made[row][part] = total

    def _others(self, row: int) -> list[int]:
        """Columns besides the diagonal; above it only where K is not lower triangular."""
        return [column for column in range(3) if column < row or (column > row and self.gain[row, column])]

    def _shift(
        self, chunk: Chunk, part: slice, axis: int, room: tuple[NDArray[np.float64], NDArray[np.float64]]
    ) -> None:
        """v + o + s (T - Tref) of one axis."""
        values, warmth = room
        np.divide(chunk.counts[part, axis], self.lsb_per_g, out=values)
        values += self.offset_g[axis]
        if self.slope_g_per_c[axis] and chunk.temperature_mc is not None:
            np.divide(chunk.temperature_mc[part], 1000.0, out=warmth)
            warmth -= self.reference_c
            warmth *= self.slope_g_per_c[axis]
            values += warmth


def steps_per_g(precision_mg: float | None) -> float | None:
    """The smallest power of two whose steps are no longer than the precision."""
    return None if precision_mg is None else 2.0 ** ceil(log2(1000 / precision_mg))


def applier(calibration: Calibration, lsb_per_g: float, precision_mg: float | None = None) -> Applier:
    """The applier of a calibration for a recording with so many counts per g."""
    return Applier(
        calibration.gain(),
        calibration.offset_g(),
        calibration.slope_g_per_c(),
        calibration.reference_c(),
        lsb_per_g,
        steps_per_g(precision_mg),
    )


def calibrated(
    chunks: Iterable[Chunk], apply: Applier, progress: Progress
) -> Iterator[tuple[Chunk, list[NDArray[np.float32]]]]:
    """A recording's chunks, none of them empty, each with its calibrated x, y, z [g]."""
    for chunk in chunks:
        if len(chunk):
            yield chunk, apply.apply(chunk)
        progress(chunk.end_byte)


def beyond(xyz: list[NDArray[np.float32]], range_g: float | None) -> int:
    """How many calibrated samples lie beyond the sensor's range."""
    if range_g is None or all(-range_g <= v.min() and v.max() <= range_g for v in xyz):
        return 0
    over = [np.abs(value) > range_g for value in xyz]
    return int((over[0] | over[1] | over[2]).sum())


def rows(
    chunk: Chunk, xyz: list[NDArray[np.float32]], recording: Recording, names: list[str], offset_s: int
) -> list[NDArray[Any]]:
    """One array a column, in the order of the schema's names; times in UTC by the clock's offset."""
    times = chunk.clock.times(0, len(chunk))
    if offset_s:
        times = times - offset_s * MICROSECONDS
    columns: list[NDArray[Any]] = [times, *xyz]
    if "temperature" in names:
        columns.append(_temperature(chunk))
    if "gx" in names:
        columns += _gyroscope(chunk, recording)
    validity = chunk.validity
    columns.append(np.zeros(len(chunk), np.uint8) if validity is None else validity)
    return columns


def _temperature(chunk: Chunk) -> NDArray[np.float32]:
    if chunk.temperature_mc is None:
        return np.full(len(chunk), np.nan, np.float32)
    return (chunk.temperature_mc / 1000.0).astype(np.float32)


def _gyroscope(chunk: Chunk, recording: Recording) -> list[NDArray[np.float32]]:
    if chunk.gyro_counts is None or recording.gyro_dps_per_lsb is None:
        return [np.full(len(chunk), np.nan, np.float32)] * 3
    return [
        (chunk.gyro_counts[:, axis] * recording.gyro_dps_per_lsb[axis]).astype(np.float32)
        for axis in range(3)
    ]


def columns_of(data: ReportInput) -> Columns:
    """The columns of a result's Parquet file."""
    from accelcal_cli.output.parquet import Columns

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
    for chunk, xyz in prefetch(calibrated(chunks, target.apply, progress), target.threads):
        total += beyond(xyz, recording.range_g)
        target.sink.write(rows(chunk, xyz, recording, names, target.offset_s))
    return total
