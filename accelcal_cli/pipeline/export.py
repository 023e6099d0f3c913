"""The second pass: raw counts to calibrated values, and these into Parquet, a chunk at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from math import ceil, frexp, log2
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.course import Course
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.parallel import prefetch
from accelcal_cli.core.points import Calibration
from accelcal_cli.core.recording import Chunk
from accelcal_cli.output.report import ReportInput
from accelcal_cli.pipeline.jobs import Progress

if TYPE_CHECKING:  # not every run writes Parquet, and pyarrow takes as long to load as all of accelcal
    from accelcal_cli.output.columns import Column, Numbers
    from accelcal_cli.output.parquet import ParquetSink
    from accelcal_cli.output.slots import Memory

BLOCK_ROWS = 1 << 14

FINEST = 1 << 20
"""Steps or counts of one g; more are too many values for a table, as those of a text are."""

NEGATIVE_ZERO = -1
"""Stands for a zero with a sign, which no whole number has, among halves of steps."""

ROUNDING = 1e-6
"""More than rounding, to double and to single, adds to any value."""

AXES = "xyz"
"""Names of the columns."""

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
    """a = K (v + o + s (T - Tref)) for v in counts: K v, and what K makes of the rest.

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

    def apply(self, chunk: Rows) -> Axes:
        """Calibrated x, y, z of a chunk [g], computed in double and rounded once to single."""
        xyz = [np.empty(len(chunk), np.float32) for _ in range(3)]
        self.apply_into(chunk, xyz)
        return xyz

    def apply_into(self, chunk: Rows, xyz: Axes) -> None:
        """The same, put into memory for (n,) values; that of an axis which is not wanted is empty."""
        wanted = [(self._row(axis, chunk), values) for axis, values in enumerate(xyz) if len(values)]
        buffers, warm = np.empty((6, min(len(chunk), BLOCK_ROWS))), chunk.temperature_mc
        for start in range(0, len(chunk), BLOCK_ROWS):
            part = slice(start, min(start + BLOCK_ROWS, len(chunk)))
            block = buffers[:, : part.stop - start]
            self._raw(chunk, part, block[:3])
            if warm is not None:
                block[3] = warm[part]
            for row, values in wanted:
                values[part] = row.calibrated(block[:3], block[3], block[4:])

    def reach_g(self, chunk: Rows) -> Floats:
        """What no calibrated value of a chunk of at least one row goes beyond, (3,) [g]."""
        if self.course is not None:
            return np.full(3, np.inf)
        warm, counts = chunk.temperature_mc, np.array([_largest(column) for column in chunk.counts.T])
        reach: Floats = np.abs(self.gain) @ counts / self.lsb_per_g
        reach += np.abs(self._constant(warm is not None))
        if warm is not None:
            reach += np.abs(self._per_mc()) * _largest(warm)
        return np.asarray(reach * (1 + ROUNDING))

    def of_one_count(self, axis: int) -> bool:
        """Whether calibrated values of an axis depend on its own counts, temperature, and nothing else."""
        return self.course is None and not self.gain[axis, self._others(axis)].any()

    def _raw(self, chunk: Rows, part: slice, v: Floats) -> None:
        """Raw values of rows: counts, or g where these are not counts times a power of two."""
        v[:] = chunk.counts[part].T
        if not self._in_counts:
            v /= self.lsb_per_g
        if self.course is not None:
            stretch, shift = self.course.values(chunk.first_sample + _numbers(part))
            v *= stretch.T
            v += shift.T

    @property
    def _in_counts(self) -> bool:
        """Whether the gain takes counts: no bit changes where a power of two of them is 1 g."""
        return self.course is None and frexp(self.lsb_per_g)[0] == 0.5

    def _row(self, axis: int, chunk: Rows) -> _Row:
        """What calibrates an axis of a chunk."""
        in_counts, fixed = self._in_counts, self.gain * ONE
        warm = chunk.temperature_mc is not None
        return _Row(
            axis=axis,
            gain=self.gain[axis] / self.lsb_per_g if in_counts else self.gain[axis],
            others=self._others(axis),
            exact=in_counts and chunk.counts.dtype == np.int16 and bool((fixed == np.rint(fixed)).all()),
            per_mc=float(self._per_mc()[axis]) if warm else 0.0,
            constant=float(self._constant(warm)[axis]),
            steps_per_g=self.steps_per_g,
        )

    def _others(self, row: int) -> list[int]:
        """Columns besides the diagonal; above it only where K is not lower triangular."""
        return [column for column in range(3) if column < row or (column > row and self.gain[row, column])]

    def _per_mc(self) -> Floats:
        """K s, for thousandths of a degree C."""
        return np.asarray(self.gain @ self.slope_g_per_c / 1000)

    def _constant(self, warm: bool) -> Floats:
        """K (o - s Tref) [g], or K o without temperatures; a zero has no sign, and so no sum with it has."""
        cold = self.slope_g_per_c * self.reference_c if warm else 0.0
        return np.asarray(self.gain @ (self.offset_g - cold) + 0.0)


@dataclass(frozen=True, slots=True)
class _Row:
    """One row of K, and what it makes of offsets and temperature.

    Attributes:
        exact: products of the gain, in fixed point, and counts of 16 bits are exact, and so are their sums:
            no bit depends on their order, which a library may choose.
    """

    axis: int
    gain: Floats
    others: list[int]
    exact: bool
    per_mc: float
    constant: float
    steps_per_g: float | None

    def calibrated(self, v: Floats, warmth: Floats, buffers: Floats) -> Floats:
        """Values [g] of raw ones (3, n) and thousandths of a degree C (n,), in the first of two buffers."""
        total: Floats = buffers[0]
        product: Floats = buffers[1]
        if self.exact:
            np.dot(self.gain, v, out=total)
        else:
            np.multiply(v[self.axis], self.gain[self.axis], out=total)
            for column in self.others:
                total += np.multiply(v[column], self.gain[column], out=product)
        if self.per_mc:
            np.multiply(warmth, self.per_mc, out=product)
            product += self.constant
            total += product
        else:
            total += self.constant
        if self.steps_per_g is not None:
            total *= self.steps_per_g
            np.rint(total, out=total)
            total /= self.steps_per_g
        return total


def _largest(values: NDArray[Any]) -> float:
    """The largest absolute value."""
    return max(-float(values.min()), float(values.max()))


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
    from accelcal_cli.output.columns import TEMPERATURE, Numbers

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
    transform.apply_into(_Counts(alone, temperature_mc), memory)
    return memory[axis]


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
