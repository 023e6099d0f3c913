"""The columns of a calibrated recording: what each holds, its type and unit, and the schema of all.

They are described in docs/outputs.md.
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

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.gyroscope import Gyroscope
from accelcal_cli.core.local_time import UNKNOWN, UTC
from accelcal_cli.core.recording import METADATA_KEY, NOT_CALIBRATED, Chunk, Recording
from accelcal_cli.core.results import Facts
from accelcal_cli.parquet import Axes, Column, Numbers

TIME_ZONE_KEY = b"time_zone"
"""Of the schema's metadata: what `time` is in, UTC or unknown."""

BLOCK_ROWS = 1 << 14
"""Angular rates are calibrated so many at a time, which the processor's cache holds."""

TEMPERATURE = "temperature"
NO_TEMPERATURE_MC = int(np.iinfo(np.int32).min)
NO_RATE = int(np.iinfo(np.int64).min)
"""Of rows without a temperature and without angular rates, where numbers are stored."""

VALIDITY = "0 measured, 1 filled, 2 clipped, 3 recovered"


def columns_of(
    recording: Recording,
    facts: Facts,
    axes: Mapping[str, Numbers] = MappingProxyType({}),
    gyroscope: Gyroscope | None = None,
) -> list[Column]:
    """All columns of a calibrated recording: THE place for a new one.

    Args:
        axes: those of x, y, z that follow from whole numbers, and from which.
        gyroscope: the verdict on it; without a scale matrix its values stay raw.
    """
    single, offset_s = pa.float32(), facts.utc_offset_s
    time = pa.timestamp("us", None if offset_s is None else UTC)
    columns = [Column.timed("time", "us since 1970", time, (offset_s or 0) * MICROSECONDS)]
    for axis, name in enumerate("xyz"):
        columns.append(Column(name, "g", single, partial(_calibrated, axis), axes.get(name)))
    if facts.has_temperature:
        columns.append(
            Column.following(TEMPERATURE, "degree Celsius", single, Numbers(_temperature_mc, _degrees))
        )
    if facts.has_gyroscope:
        columns += _rate_columns(recording.gyro_dps_per_lsb, gyroscope)
    return [*columns, _validity_column(VALIDITY, 0)]


def _rate_columns(dps_per_lsb: tuple[float, ...] | None, gyroscope: Gyroscope | None) -> Iterator[Column]:
    """Angular rates: calibrated if a scale matrix is known, else raw."""
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


def _calibrated(axis: int, _chunk: Chunk, xyz: Axes) -> NDArray[np.float32]:
    return xyz[axis]


def _temperature_mc(chunk: Chunk, _xyz: Axes) -> NDArray[Any]:
    return _or_absent(chunk, chunk.temperature_mc, NO_TEMPERATURE_MC)


def _degrees(temperature_mc: NDArray[np.int32]) -> NDArray[np.float32]:
    return _or_nan(temperature_mc, NO_TEMPERATURE_MC, temperature_mc / 1000.0)


def _gyro_counts(axis: int, chunk: Chunk, _xyz: Axes) -> NDArray[Any]:
    counts = chunk.gyro_counts
    return _or_absent(chunk, None if counts is None else counts[:, axis], NO_RATE)


def _rates(dps_per_lsb: float, counts: NDArray[np.int64]) -> NDArray[np.float32]:
    return _or_nan(counts, NO_RATE, counts * dps_per_lsb)


def _or_absent(chunk: Chunk, numbers: NDArray[Any] | None, absent: int) -> NDArray[Any]:
    return np.full(len(chunk), absent, np.int64) if numbers is None else numbers


def _or_nan(numbers: NDArray[Any], absent: int, values: NDArray[Any]) -> NDArray[np.float32]:
    return np.where(numbers == absent, np.nan, values).astype(np.float32)


class _CalibratedRates:
    """Angular rates of chunks; those of the last chunk are kept for its other axes."""

    def __init__(self, dps_per_lsb: tuple[float, ...], gyroscope: Gyroscope) -> None:
        self._dps_per_lsb, self._gyroscope = dps_per_lsb, gyroscope
        self._chunk: Chunk | None = None
        self._rates: Axes = []

    def values(self, axis: int, chunk: Chunk, _xyz: Axes) -> NDArray[np.float32]:
        """Of one axis [deg/s]; NaN where a chunk has none."""
        if chunk.gyro_counts is None:
            return np.full(len(chunk), np.nan, np.float32)
        if self._chunk is not chunk:
            self._chunk, self._rates = chunk, self._calibrated(chunk, chunk.gyro_counts)
        return self._rates[axis]

    def _calibrated(self, chunk: Chunk, counts: NDArray[Any]) -> Axes:
        held = [np.empty(len(chunk), np.float32) for _ in range(3)]
        for start in range(0, len(chunk), BLOCK_ROWS):
            part = slice(start, start + BLOCK_ROWS)
            raw = [
                np.multiply(counts[part, axis], scale, dtype=np.float64)
                for axis, scale in enumerate(self._dps_per_lsb)
            ]
            warm = None if chunk.temperature_mc is None else chunk.temperature_mc[part] / 1000.0
            for column, values in zip(held, self._gyroscope.calibrated(raw, warm), strict=True):
                column[part] = values
        return held


def _validity_column(meaning: str, plus: int) -> Column:
    """`validity`, with something added in each row."""

    def numbers(chunk: Chunk, _xyz: Axes) -> NDArray[np.uint8]:
        held = np.zeros(len(chunk), np.uint8) if chunk.validity is None else chunk.validity
        return held + np.uint8(plus) if plus else held

    return Column.following("validity", meaning, pa.uint8(), Numbers(numbers, np.asarray, np.uint8))


def not_calibrated(columns: Sequence[Column]) -> list[Column]:
    """The columns of a file of raw values: `validity` says so in each row."""
    flagged = _validity_column(f"{VALIDITY}; plus {NOT_CALIBRATED}: not calibrated", NOT_CALIBRATED)
    return [flagged if column.name == flagged.name else column for column in columns]


def schema_of(columns: Sequence[Column], metadata: dict[str, Any]) -> pa.Schema:
    """The Arrow schema of a file with these columns and this metadata of ours."""
    text = json.dumps(metadata, sort_keys=True, allow_nan=False)
    times = next(column.type for column in columns if pa.types.is_timestamp(column.type))
    about = {METADATA_KEY: text, TIME_ZONE_KEY: times.tz or UNKNOWN}
    return pa.schema([column.field for column in columns], metadata=about)


def described(schema: pa.Schema) -> dict[str, Any]:
    """What a schema says beside our metadata, as JSON: what times are in, types and units of columns."""
    columns = {field.name: [str(field.type), _text(field.metadata, b"unit")] for field in schema}
    return {"time_zone": _text(schema.metadata, TIME_ZONE_KEY), "columns": columns}


def _text(metadata: dict[bytes, bytes] | None, key: bytes) -> str | None:
    value = (metadata or {}).get(key)
    return None if value is None else value.decode(errors="replace")


def values_of(columns: Sequence[Column], chunk: Chunk, xyz: Axes) -> list[NDArray[Any]]:
    """A chunk's rows: one array a column."""
    return [column.values(chunk, xyz) for column in columns]
