"""The second sensor of the GT9X: accelerometer, gyroscope and temperature in one record.

A schema record lists the columns of the sensor records. Source: github.com/actigraph/GT3X-File-
Format, LogRecords/SensorSchema.md and SensorData.md. Records hold 100 or 101 samples for a second.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.readers._gt3x.layout import SENSOR_DATA, Records
from accelcal_cli.readers._gt3x.parameters import float_of
from accelcal_cli.readers._gt3x.sensor import Samples, first_rows, payloads_of

USUAL_RATE = 100
"""What a schema that says 0 samples means, as in the vendor's example code."""

ID_BYTES = 2
UNEVEN = 0.1
"""The IMU's own clock is off by so much at most, as a part of its rate."""

LEAST_SCALE, LARGEST_SCALE = 0.1, 1e6
"""Counts in one g, degree or degree per second that make sense."""

_HEAD = struct.Struct("<HHH")
_COLUMN = struct.Struct("<BBBI16s")
_BIG_ENDIAN, _SIGNED = 1, 2
_AXES = " X", " Y", " Z"
ACCELEROMETER, GYROSCOPE, TEMPERATURE = "Accelerometer", "Gyroscope", "Temperature"


@dataclass(frozen=True, slots=True)
class Column:
    """A 16-bit value of each sample: where it lies, and how many counts are one unit."""

    offset: int
    order: str
    scale: float


@dataclass(frozen=True, slots=True)
class Schema:
    """What sensor records hold.

    Attributes:
        number: they begin with it.
        rate: samples in a second.
        row_bytes: bytes of a sample.
        columns: by label; only those of signed 16 bits.
    """

    number: int
    rate: int
    row_bytes: int
    columns: dict[str, Column]

    def axes(self, label: str) -> tuple[Column, ...]:
        """The columns of a sensor's three axes; none where one is missing."""
        found = [self.columns.get(label + axis) for axis in _AXES]
        return tuple(column for column in found if column) if all(found) else ()


def parse_schema(data: bytes) -> Schema | None:
    """A schema record's payload; None where it makes no sense."""
    if len(data) < _HEAD.size:
        return None
    number, columns, samples = _HEAD.unpack_from(data)
    if columns * _COLUMN.size != len(data) - _HEAD.size:
        return None
    found: dict[str, Column] = {}
    row_bytes = 0
    for flags, offset, bits, scale, label in _COLUMN.iter_unpack(data[_HEAD.size :]):
        row_bytes += bits // 8
        per_unit = float_of(scale)
        plain = bits == 16 and flags & _SIGNED and offset % 8 == 0
        if plain and LEAST_SCALE <= per_unit <= LARGEST_SCALE:
            order = ">i2" if flags & _BIG_ENDIAN else "<i2"
            found[label.decode("ascii", "replace").strip()] = Column(offset // 8, order, per_unit)
    fitting = {name: column for name, column in found.items() if column.offset + 2 <= row_bytes}
    return Schema(number, samples or USUAL_RATE, row_bytes, fitting) if row_bytes else None


@dataclass(frozen=True, slots=True)
class Imu:
    """The second sensor as the schema describes it.

    Attributes:
        zero_c: temperature at 0 counts.
    """

    schema: Schema
    zero_c: float
    fills: bool = False

    @property
    def rate(self) -> int:
        """Samples in a second, nominally."""
        return self.schema.rate

    def holds(self, buffer: NDArray[np.uint8], records: Records) -> NDArray[np.bool_]:
        """Which records hold samples by this schema, (m,)."""
        data = (records.kind == SENSOR_DATA) & (records.size >= ID_BYTES + self.schema.row_bytes)
        number = payloads_of(buffer, records.start[data], ID_BYTES).view("<u2")[:, 0]
        data[data] = number == self.schema.number
        return np.asarray(data)

    def whole(self, records: Records) -> NDArray[np.bool_]:
        """Which records hold about as many samples as the rate says, without further bytes, (k,)."""
        rows = self._rows(records)
        exact = records.size == ID_BYTES + rows * self.schema.row_bytes
        return np.asarray(exact & (np.abs(rows - self.rate) <= UNEVEN * self.rate))

    def decode(self, buffer: NDArray[np.uint8], records: Records) -> Samples:
        """Samples of records, those of one size at once."""
        rows = self._rows(records)
        table = np.empty((int(rows.sum()), self.schema.row_bytes), np.uint8)
        first = first_rows(rows)
        for size in np.unique(records.size).tolist():
            chosen = records.size == size
            data = payloads_of(buffer, records.start[chosen], size)[:, ID_BYTES:]
            whole = data[:, : data.shape[1] // self.schema.row_bytes * self.schema.row_bytes]
            values = whole.reshape(len(data), -1, self.schema.row_bytes)
            table[first[chosen, None] + np.arange(values.shape[1])] = values
        gyro = self.schema.axes(GYROSCOPE)
        return Samples(
            rows,
            vectors(table, self.schema.axes(ACCELEROMETER)),
            self._temperature(table),
            vectors(table, gyro) if gyro else None,
        )

    def _rows(self, records: Records) -> NDArray[np.int64]:
        return (records.size - ID_BYTES) // self.schema.row_bytes

    def _temperature(self, table: NDArray[np.uint8]) -> NDArray[np.int32] | None:
        column = self.schema.columns.get(TEMPERATURE)
        if column is None:
            return None
        celsius = value_of(table, column) / column.scale + self.zero_c
        return np.rint(1000 * celsius).astype(np.int32)


def vectors(table: NDArray[np.uint8], columns: tuple[Column, ...]) -> NDArray[np.int16]:
    """Three columns of samples (n, bytes) as (n, 3)."""
    return np.stack([value_of(table, column) for column in columns], axis=1)


def value_of(table: NDArray[np.uint8], column: Column) -> NDArray[np.int16]:
    """A column of samples (n, bytes), (n,)."""
    data = np.ascontiguousarray(table[:, column.offset : column.offset + 2])
    return data.view(column.order)[:, 0].astype(np.int16)
