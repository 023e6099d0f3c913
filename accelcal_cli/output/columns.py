"""The columns of a calibrated recording: what each holds, its type and unit, and the schema of all.

They are described in docs/outputs.md; `recording_columns` is THE place for a new one.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.calibration import RawRows, Transform
from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.gyroscope import Gyroscope
from accelcal_cli.core.local_time import UNKNOWN, UTC
from accelcal_cli.core.recording import METADATA_KEY, NOT_CALIBRATED, Chunk, Recording
from accelcal_cli.core.results import Facts
from accelcal_cli.parquet import Axes, Column, Numbers

TIME_ZONE_KEY = b"time_zone"
"""Key of the schema's metadata for the zone of `time`, UTC or unknown."""

BLOCK_ROWS = 1 << 14
"""Rows whose angular rates are calibrated at a time: the processor's cache holds them."""

TEMPERATURE = "temperature"
NO_TEMPERATURE_MC = int(np.iinfo(np.int32).min)
NO_RATE = int(np.iinfo(np.int64).min)
"""Numbers that stand for no temperature and for no angular rate."""

VALIDITY = "0 measured, 1 filled, 2 clipped, 3 recovered"

FINEST = 1 << 20
"""Most steps or counts in one g for which a table of values is tried; those of a text are too many."""

NEGATIVE_ZERO = -1
"""Stands for a zero with a sign, which no whole number has, among halves of steps."""


def recording_columns(
    recording: Recording,
    facts: Facts,
    axes: Mapping[str, Numbers] = MappingProxyType({}),
    gyroscope: Gyroscope | None = None,
    *,
    others: bool = False,
) -> list[Column]:
    """Return all columns of a calibrated recording.

    Args:
        axes: the whole numbers that x, y or z follow from, by name (`numbers_of_axes`).
        gyroscope: its calibration; without a scale matrix its values stay raw.
        others: with all further quantities that it recorded.
    """
    single, offset_s = pa.float32(), facts.utc_offset_s
    time = pa.timestamp("us", None if offset_s is None else UTC)
    columns = [Column.timed("time", "us since 1970", time, (offset_s or 0) * MICROSECONDS)]
    for axis, name in enumerate("xyz"):
        columns.append(Column(name, "g", single, partial(_calibrated, axis), axes.get(name)))
    if facts.has_temperature:
        numbers = Numbers(_temperature_mc, _degrees)
        columns.append(Column.following(TEMPERATURE, "degree Celsius", single, numbers))
    if facts.has_gyroscope:
        columns += _rate_columns(recording.gyro_dps_per_lsb, gyroscope)
    for number, other in enumerate(recording.others if others else ()):
        bits = Numbers(partial(_other_bits, number), _of_bits, np.uint32)
        columns.append(Column.following(other.name, other.unit, single, bits))
    return [*columns, _validity_column(VALIDITY, 0)]


def uncalibrated(columns: Sequence[Column]) -> list[Column]:
    """Return the columns of a file of raw values, in which `validity` marks each row as not calibrated."""
    marked = _validity_column(f"{VALIDITY}; plus {NOT_CALIBRATED}: not calibrated", NOT_CALIBRATED)
    return [marked if column.name == marked.name else column for column in columns]


def schema_of(columns: Sequence[Column], metadata: dict[str, Any]) -> pa.Schema:
    """Return the Arrow schema of a file with these columns and this metadata of ours."""
    text = json.dumps(metadata, sort_keys=True, allow_nan=False)
    times = next(column.type for column in columns if pa.types.is_timestamp(column.type))
    about = {METADATA_KEY: text, TIME_ZONE_KEY: times.tz or UNKNOWN}
    return pa.schema([column.field for column in columns], metadata=about)


def described(schema: pa.Schema) -> dict[str, Any]:
    """Return the zone of times, and the types and units of columns that a schema states, as JSON."""
    columns = {field.name: [str(field.type), _text(field.metadata, b"unit")] for field in schema}
    return {"time_zone": _text(schema.metadata, TIME_ZONE_KEY), "columns": columns}


def _text(metadata: dict[bytes, bytes] | None, key: bytes) -> str | None:
    value = (metadata or {}).get(key)
    return None if value is None else value.decode(errors="replace")


def values_of(columns: Sequence[Column], chunk: Chunk, xyz: Axes) -> list[NDArray[Any]]:
    """Return a chunk's rows: one array for each column."""
    return [column.values(chunk, xyz) for column in columns]


# --- acceleration


def numbers_of_axes(transform: Transform, has_temperature: bool) -> dict[str, Numbers]:
    """Return the whole numbers that calibrated values follow from: steps, or the counts of one axis."""
    steps = transform.steps_per_g
    if steps is not None and steps <= FINEST:
        values = partial(_of_half_steps, steps)
        return {
            name: Numbers(partial(_half_steps, axis, steps), values, np.float32, calibrated=True)
            for axis, name in enumerate("xyz")
        }
    if transform.lsb_per_g > FINEST:
        return {}
    warm = has_temperature & (transform.slope_g_per_c != 0)
    return {
        name: Numbers(
            partial(_counts, axis),
            partial(_of_counts, transform, axis),
            paired_with=TEMPERATURE if warm[axis] else None,
        )
        for axis, name in enumerate("xyz")
        if transform.depends_on_one_axis(axis)
    }


def _calibrated(axis: int, _chunk: Chunk, xyz: Axes) -> NDArray[np.float32]:
    return xyz[axis]


def _half_steps(axis: int, steps_per_g: float, _chunk: Chunk, xyz: Axes) -> NDArray[np.float32]:
    """Return halves of steps, of which only whole steps occur, and NEGATIVE_ZERO."""
    values = xyz[axis]
    halves = values * np.float32(2 * steps_per_g)  # a power of two, which rounds nothing
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
    """Return the calibrated values of counts of one axis, which do not depend on the other axes."""

    def values(temperature_mc: NDArray[np.int32] | None) -> NDArray[np.float32]:
        rows = RawRows(np.zeros((len(counts), 3), np.int32), temperature_mc)
        rows.counts[:, axis] = counts
        memory = [np.empty(len(counts) * (place == axis), np.float32) for place in range(3)]
        transform.apply_into(rows, memory)
        return memory[axis]

    if temperature_mc is None:
        return values(None)
    absent = temperature_mc == NO_TEMPERATURE_MC
    return np.where(absent, values(None), values(temperature_mc)) if absent.any() else values(temperature_mc)


# --- temperature, angular rates, validity


def _temperature_mc(chunk: Chunk, _xyz: Axes) -> NDArray[Any]:
    return _or_absent(chunk, chunk.temperature_mc, NO_TEMPERATURE_MC)


def _degrees(temperature_mc: NDArray[np.int32]) -> NDArray[np.float32]:
    return _or_nan(temperature_mc, NO_TEMPERATURE_MC, temperature_mc / 1000.0)


def _rate_columns(dps_per_lsb: tuple[float, ...] | None, gyroscope: Gyroscope | None) -> Iterator[Column]:
    """Yield the angular rates: calibrated if a scale matrix is known, else raw."""
    rates = None
    if dps_per_lsb is not None and gyroscope is not None and gyroscope.scale is not None:
        rates = _CalibratedRates(dps_per_lsb, gyroscope)
    for axis, name in enumerate("xyz"):
        if rates is not None:
            yield Column(f"g{name}", "deg/s", pa.float32(), partial(rates.values, axis))
        else:
            scale = dps_per_lsb[axis] if dps_per_lsb else np.nan
            numbers = Numbers(partial(_gyro_counts, axis), partial(_rates, scale), np.int64)
            yield Column.following(f"g{name}", "deg/s", pa.float32(), numbers)


def _gyro_counts(axis: int, chunk: Chunk, _xyz: Axes) -> NDArray[Any]:
    counts = chunk.gyro_counts
    return _or_absent(chunk, None if counts is None else counts[:, axis], NO_RATE)


def _rates(dps_per_lsb: float, counts: NDArray[np.int64]) -> NDArray[np.float32]:
    return _or_nan(counts, NO_RATE, counts * dps_per_lsb)


def _or_absent(chunk: Chunk, numbers: NDArray[Any] | None, absent: int) -> NDArray[Any]:
    return np.full(len(chunk), absent, np.int64) if numbers is None else numbers


def _or_nan(numbers: NDArray[Any], absent: int, values: NDArray[Any]) -> NDArray[np.float32]:
    return np.where(numbers == absent, np.nan, values).astype(np.float32)


def _other_bits(number: int, chunk: Chunk, _xyz: Axes) -> NDArray[np.uint32]:
    """Return values of another quantity as whole numbers, which hold a value each, and NaN."""
    values = np.full(len(chunk), np.nan, np.float32) if chunk.others is None else chunk.others[:, number]
    return values.view(np.uint32)


def _of_bits(bits: NDArray[np.uint32]) -> NDArray[np.float32]:
    return bits.view(np.float32)


class _CalibratedRates:
    """Calibrates angular rates; those of the last chunk are kept for its other axes."""

    def __init__(self, dps_per_lsb: tuple[float, ...], gyroscope: Gyroscope) -> None:
        self._dps_per_lsb, self._gyroscope = dps_per_lsb, gyroscope
        self._chunk: Chunk | None = None
        self._rates: Axes = []

    def values(self, axis: int, chunk: Chunk, _xyz: Axes) -> NDArray[np.float32]:
        """Return the rates of one axis [deg/s]; NaN where a chunk has none."""
        if chunk.gyro_counts is None:
            return np.full(len(chunk), np.nan, np.float32)
        if self._chunk is not chunk:
            self._chunk, self._rates = chunk, self._calibrated(chunk, chunk.gyro_counts)
        return self._rates[axis]

    def _calibrated(self, chunk: Chunk, counts: NDArray[Any]) -> Axes:
        rates = [np.empty(len(chunk), np.float32) for _ in range(3)]
        for start in range(0, len(chunk), BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            raw = [
                np.multiply(counts[part, axis], scale, dtype=np.float64)
                for axis, scale in enumerate(self._dps_per_lsb)
            ]
            celsius = None if chunk.temperature_mc is None else chunk.temperature_mc[part] / 1000.0
            for column, values in zip(rates, self._gyroscope.calibrated(raw, celsius), strict=True):
                column[part] = values
        return rates


def _validity_column(meaning: str, added: int) -> Column:
    """Return `validity`, with `added` to the number of each row."""

    def numbers(chunk: Chunk, _xyz: Axes) -> NDArray[np.uint8]:
        validity = np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity
        return validity + np.uint8(added) if added else validity

    return Column.following("validity", meaning, pa.uint8(), Numbers(numbers, np.asarray, np.uint8))
