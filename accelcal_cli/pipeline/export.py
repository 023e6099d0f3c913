"""The second pass: raw counts to calibrated values, and these into Parquet, a chunk at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, frexp, log2
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.course import Course
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.points import Calibration
from accelcal_cli.core.recording import Chunk
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.jobs import Progress

if TYPE_CHECKING:  # not every run writes Parquet, and pyarrow takes as long to load as all of accelcal
    from accelcal_cli.output.parquet import Column, Numbers, ParquetSink

BLOCK_ROWS = 1 << 14

FINEST = 1 << 20
"""Steps or counts of one g; more are too many values for a table, as those of a text are."""

NEGATIVE_ZERO = -1
"""Stands for a zero with a sign, which no whole number has, among halves of steps."""

Floats = NDArray[np.float64]

Axes = list[NDArray[np.float32]]
"""Calibrated x, y, z [g]."""


class Rows(Protocol):
    """What is calibrated: a chunk, or rows of another program."""

    @property
    def first_sample(self) -> int:
        """Number of the first row within the recording."""

    @property
    def counts(self) -> NDArray[Any]:
        """(n, 3) raw values, `Transform.lsb_per_g` of which are 1 g."""

    @property
    def temperature_mc(self) -> NDArray[np.int32] | None:
        """(n,) thousandths of a degree C, or None."""

    def __len__(self) -> int: ...


@dataclass(frozen=True, slots=True)
class Transform:
    """a = K (v + o + s (T - Tref)) for v in counts: K / lsb_per_g on counts plus a constant.

    Attributes:
        steps_per_g: a power of two; calibrated values are rounded to 1 / steps_per_g. None: they are not.
        course: what takes the place of v where the sensor changed.
    """

    gain: Floats
    offset_g: Floats
    slope_g_per_c: Floats
    reference_c: float
    lsb_per_g: float
    steps_per_g: float | None = None
    course: Course | None = None

    def apply(self, chunk: Rows, into: Axes | None = None) -> Axes:
        """Calibrated x, y, z of a chunk [g], computed in double and rounded once to single.

        Args:
            into: takes them, (n,) each; None: memory of their own.
        """
        xyz = [np.empty(len(chunk), np.float32) for _ in range(3)] if into is None else into
        buffers, same = np.empty((6, BLOCK_ROWS)), self._in_counts()
        for start in range(0, len(chunk), BLOCK_ROWS):
            part = slice(start, min(start + BLOCK_ROWS, len(chunk)))
            same._block(chunk, part, buffers[:, : part.stop - start], xyz)
        return xyz

    def _in_counts(self) -> Transform:
        """The same for counts that are not divided: of a power of two in 1 g no bit changes."""
        if frexp(self.lsb_per_g)[0] != 0.5 or self.course is not None:
            return self
        offset, slope = self.offset_g * self.lsb_per_g, self.slope_g_per_c * self.lsb_per_g
        gain = self.gain / self.lsb_per_g
        return replace(self, gain=gain, offset_g=offset, slope_g_per_c=slope, lsb_per_g=1.0)

    def of_one_count(self, axis: int) -> bool:
        """Whether calibrated values of an axis depend on its own counts, temperature, and nothing else.

        A negative scale makes zeros with a sign, which the products of the other axes take from them.
        """
        others, scale = self.gain[axis, self._others(axis)], self.gain[axis, axis]
        return bool(self.course is None and scale > 0 and not others.any())

    def _block(self, chunk: Rows, part: slice, buffers: Floats, xyz: Axes) -> None:
        """Rows that the processor's cache holds, in memory that is used again."""
        shifted, total, product, warmth = buffers[:3], buffers[3], buffers[4], buffers[5]
        warm = self._warmer(chunk, part, warmth)
        right = None if self.course is None else self.course.values(chunk.first_sample + _numbers(part))
        for axis in range(3):
            shifted[axis] = chunk.counts[part, axis]
            if self.lsb_per_g != 1:
                shifted[axis] /= self.lsb_per_g
            if right is not None:
                shifted[axis] *= right[0][:, axis]
                shifted[axis] += right[1][:, axis]
            shifted[axis] += self.offset_g[axis]
            if warm and self.slope_g_per_c[axis]:
                shifted[axis] += np.multiply(warmth, self.slope_g_per_c[axis], out=product)
        for row in range(3):
            np.multiply(shifted[row], self.gain[row, row], out=total)
            for column in self._others(row):
                np.multiply(shifted[column], self.gain[row, column], out=product)
                total += product
            if self.steps_per_g is not None:
                total *= self.steps_per_g
                np.rint(total, out=total)
                total /= self.steps_per_g
            xyz[row][part] = total

    def _others(self, row: int) -> list[int]:
        """Columns besides the diagonal; above it only where K is not lower triangular."""
        return [column for column in range(3) if column < row or (column > row and self.gain[row, column])]

    def _warmer(self, chunk: Rows, part: slice, warmth: Floats) -> bool:
        """T - Tref, if an offset depends on it and it was measured."""
        if chunk.temperature_mc is None or not self.slope_g_per_c.any():
            return False
        np.divide(chunk.temperature_mc[part], 1000.0, out=warmth)
        warmth -= self.reference_c
        return True


def _numbers(part: slice) -> NDArray[np.int64]:
    return np.arange(part.start, part.stop, dtype=np.int64)


def steps_per_g(precision_mg: float | None) -> float | None:
    """The smallest power of two whose steps are no longer than the precision."""
    return None if precision_mg is None else 2.0 ** ceil(log2(1000 / precision_mg))


def transform(
    calibration: Calibration | None, lsb_per_g: float, precision_mg: float | None = None
) -> Transform:
    """What applies a calibration to counts; without one, raw values stay as they are."""
    if calibration is None:
        return Transform(np.eye(3), np.zeros(3), np.zeros(3), 0.0, lsb_per_g)
    return Transform(
        calibration.gain(),
        calibration.offset_g(),
        calibration.slope_g_per_c(),
        calibration.reference_c(),
        lsb_per_g,
        steps_per_g(precision_mg),
        calibration.course,
    )


def transform_of(data: ReportInput) -> Transform:
    """What applies a result's calibration to its recording."""
    return transform(data.judgement.calibration, data.recording.lsb_per_g, data.settings.precision_mg)


def calibrated(
    chunks: Iterable[Chunk], transform: Transform, progress: Progress
) -> Iterator[tuple[Chunk, Axes]]:
    """A recording's chunks, none of them empty, each with its calibrated x, y, z [g]."""
    for chunk in chunks:
        if len(chunk):
            yield chunk, transform.apply(chunk)
        progress(chunk.end_byte)


def beyond(xyz: Axes, range_g: float | None) -> int:
    """How many calibrated samples lie beyond the sensor's range."""
    if range_g is None or all(-range_g <= v.min() and v.max() <= range_g for v in xyz):
        return 0
    over = [np.abs(value) > range_g for value in xyz]
    return int((over[0] | over[1] | over[2]).sum())


def columns_of(data: ReportInput) -> list[Column]:
    """The columns of a result's Parquet file."""
    from accelcal_cli.output import parquet

    applied = transform_of(data)
    axes = numbers_of_axes(applied, data.facts.has_temperature)
    columns = parquet.columns_of(data.recording, data.facts, axes, data.gyroscope)
    return columns if data.judgement.calibration is not None else parquet.not_calibrated(columns)


def numbers_of_axes(transform: Transform, has_temperature: bool) -> dict[str, Numbers]:
    """The whole numbers that calibrated values follow from: steps, or the counts of one axis."""
    from accelcal_cli.output.parquet import TEMPERATURE, Numbers

    steps = transform.steps_per_g
    if steps is not None and steps <= FINEST:
        return {
            name: Numbers(partial(_half_steps, axis, steps), partial(_of_half_steps, steps), np.float32)
            for axis, name in enumerate("xyz")
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
        for axis, name in enumerate("xyz")
        if transform.of_one_count(axis)
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
    from accelcal_cli.output.parquet import NO_TEMPERATURE_MC

    alone = np.zeros((len(counts), 3), np.int32)
    alone[:, axis] = counts
    if temperature_mc is None:
        return transform.apply(_Counts(alone))[axis]
    warm = transform.apply(_Counts(alone, temperature_mc))[axis]
    absent = temperature_mc == NO_TEMPERATURE_MC
    return np.where(absent, transform.apply(_Counts(alone))[axis], warm) if absent.any() else warm


@dataclass(frozen=True, slots=True)
class _Counts:
    """Rows of which nothing else is known."""

    counts: NDArray[np.int32]
    temperature_mc: NDArray[np.int32] | None = None
    first_sample: int = 0

    def __len__(self) -> int:
        return len(self.counts)


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
    for chunk in prefetch(iter(chunks), threads - 1):  # of two threads this one reads, too
        for rows, columns in sink.room(len(chunk)):
            total += beyond(_fill(columns, chunk.part(rows.start, rows.stop), applied), range_g)
        progress(chunk.end_byte)
    return total


def _fill(columns: Sequence[tuple[Column, NDArray[Any]]], rows: Chunk, transform: Transform) -> Axes:
    """Put rows where a sink wants them: an axis that is stored as it is, there at once; returns all three."""
    held = {column.name: memory for column, memory in columns if column.numbers is None}
    xyz = transform.apply(rows, [held.get(name, np.empty(len(rows), np.float32)) for name in "xyz"])
    for column, memory in columns:
        stored = column.stored(rows, xyz)
        if stored is not memory:
            memory[:] = stored
    return xyz
