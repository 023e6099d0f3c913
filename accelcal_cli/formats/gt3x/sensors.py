"""The sensors of a device: which records of log.bin hold their samples, and how; and activity.bin.

The main accelerometer has records of one second of samples, packed or of 16 bits. Packed samples are three
values of twelve bits, two samples in nine bytes. Sources: github.com/actigraph/GT3X-File-Format,
LogRecords/Activity.md and Activity2.md. Kind 27 is packed in the order x, y, z (the vendor's pygt3x).

The second sensor of the GT9X (`Imu`) has accelerometer, gyroscope and temperature in one record, whose
columns a schema record lists; a record holds 100 or 101 samples for a second. Source:
LogRecords/SensorSchema.md and SensorData.md.

The older kind of .gt3x has an activity.bin: nothing but packed samples, without times or checksums. Source:
github.com/actigraph/NHANES-GT3X-File-Format, README.md and fileformats/activity.bin.md (GT3X+ and ActiSleep+
with firmware up to 2.5.0).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from math import isfinite
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import (
    FLOAT_LSB_PER_G,
    Channels,
    Chunk,
    Counts,
    FactoryAcceleration,
    FactoryCalibration,
    FactoryTemperature,
    OtherColumn,
    Problem,
    Validity,
    clipped_at,
)
from accelcal_cli.formats.gt3x import records as log
from accelcal_cli.formats.gt3x.archive import (
    CALIBRATION,
    TEMPERATURE_CALIBRATION,
    Archive,
    Fault,
    Member,
    MemberStream,
    small_part,
)
from accelcal_cli.formats.gt3x.records import RecordBatch, Records

# The maker's calibration next to log.bin: calibration.json and temperature_calibration.json, and its
# use.
#
# `isCalibrated` false says that the records hold counts of the bare sensor. Method 2 of
# calibration.json has, for each sampling rate, offsets in counts, sensitivities of the axes in
# hundredths of a count per g, and those across the axes, which are alike both ways: 1 / (250 + s /
# 100) - 1 / 250 g per count. Method 1 of temperature_calibration.json is a line through two points of
# each thermometer. Source: the vendor's reader, github.com/actigraph/pygt3x 0.7.1, reader.py and
# calibration.py.
#
# Calibrated values are rounded to the grid of decimal fractions (`FLOAT_LSB_PER_G`). They are
# computed number by number, in one order, so that every machine gives the same.

MATRIX, LINE, IN_DEGREES = 2, 1, 0
"""Known methods: of the acceleration, of the temperature, and our own for a temperature in degrees."""

LEAST_PER_G, MOST_PER_G = 10.0, 1e6
"""Smallest and largest number of counts per g of an axis."""

FARTHEST_OFFSET = 32_768.0
LARGEST_G = 127.0
MOST_COUNTS = int(LARGEST_G * FLOAT_LSB_PER_G)
"""Largest calibrated value [g] on the grid; larger ones are cut off there, and marked as clipped."""

COLDEST_C, WARMEST_C = -100.0, 200.0
READING_BYTES, ACCELEROMETER_SENSOR = 3, 1
"""Length of a temperature reading, of a thermometer's number and 16 bits, and the number that is used."""

Values = dict[str, Any]
READ_AS_COUNTS = "--lsb-per-g, such as 256, reads the counts as they are"
DAMAGED = "{} in the zip file is damaged: its values for the sensor were not applied"
NOT_APPLIED = "the maker's calibration (calibration.json) was not applied, as --lsb-per-g is given"
OLDER_KIND = "the maker's calibration (calibration.json) was not applied: it is not for activity.bin"
NO_TEMPERATURE = (
    "no temperatures were read: there are none, or temperature_calibration.json does not say what they are"
)


def is_open(values: Values | None) -> bool:
    """Return True if the calibration in one of the two parts is still to be applied."""
    return values is not None and not values.get("isCalibrated", True)


@dataclass(frozen=True, slots=True)
class CalibrationFiles:
    """The content of both parts, None for one that is missing or damaged; and the problem of the latter."""

    acceleration: Values | None = None
    temperature: Values | None = None
    problems: tuple[Problem, ...] = ()

    @classmethod
    def of(cls, archive: Archive) -> CalibrationFiles:
        """Read both parts."""
        names = [name for name in (CALIBRATION, TEMPERATURE_CALIBRATION) if name in archive.members]
        parts: dict[str, Any] = {}
        for name in names:
            with suppress(ValueError, RecursionError):
                parts[name] = json.loads(small_part(archive, name) or b"")
        found = {name: values for name, values in parts.items() if isinstance(values, dict)}
        damaged = [DAMAGED.format(name) for name in names if name not in found]
        problems = tuple(Problem("damaged_header", text, None, 0) for text in damaged)
        return cls(found.get(CALIBRATION), found.get(TEMPERATURE_CALIBRATION), problems)

    def notes(self, done: AppliedCalibration) -> tuple[str, ...]:
        """Return notes on how the parts are used."""
        notes = () if done.factory is None else done.factory.notes()
        if is_open(self.acceleration) and done.acceleration is None:
            notes += (NOT_APPLIED,)
        if self.temperature is not None and done.first_mc is None:
            notes += (NO_TEMPERATURE,)
        return notes


@dataclass(frozen=True, slots=True)
class AppliedCalibration:
    """The maker's calibration as it is applied to the samples of a recording.

    Attributes:
        acceleration: the calibration of counts; None if they are calibrated.
        limit: raw counts from which on a row is marked as clipped; None if unknown.
        temperature: how the thermometer's counts are read; first_mc: its first reading. None without any.
    """

    acceleration: FactoryAcceleration | None = None
    limit: int | None = None
    temperature: FactoryTemperature | None = None
    first_mc: int | None = None

    @property
    def factory(self) -> FactoryCalibration | None:
        """The maker's calibration, as far as there was something to apply."""
        used = self.first_mc is not None and self.temperature is not None and self.temperature.method
        line = self.temperature if used else None
        return FactoryCalibration(self.acceleration, line) if self.acceleration or line else None

    def thermometer(self) -> Thermometer | None:
        """Return a new thermometer, for one pass over the recording."""
        if self.temperature is None or self.first_mc is None:
            return None
        return Thermometer(self.temperature, self.first_mc)

    def apply(self, chunk: Chunk) -> Chunk:
        """Return a chunk of raw counts with calibrated ones, and rows at the limit marked as clipped."""
        if self.acceleration is None:
            return chunk
        if self.limit is not None:
            chunk = clipped_at(chunk, -self.limit, self.limit - 1)
        counts = calibrated_counts(chunk.counts, self.acceleration)
        return clipped_at(replace(chunk, counts=counts), -MOST_COUNTS, MOST_COUNTS)


def acceleration_of(values: Values | None, rate: int, path: Path) -> FactoryAcceleration | None:
    """Return the calibration, which has to be usable, for a sampling rate; None if the counts need none."""
    if values is None or not is_open(values):
        return None
    method = values.get("calibrationMethod")
    if method != MATRIX or isinstance(method, bool):
        raise _unusable(f"is of the unknown method {str(method)[:40]!r}", path)
    pairs = [a + b for a, b in combinations_with_replacement("XYZ", 2)]
    offset = [_number(values.get(f"offset{axis}_{rate}")) for axis in "XYZ"]
    found = {pair: _number(values.get(f"sensitivity{pair}_{rate}")) for pair in pairs}
    if None in offset or None in found.values():
        raise _unusable(f"does not say what {rate} Hz needs", path)
    return _sensible(rate, [value or 0.0 for value in offset], {k: v or 0.0 for k, v in found.items()}, path)


def _sensible(
    rate: int, offset: list[float], sensitivity: dict[str, float], path: Path
) -> FactoryAcceleration:
    along = [sensitivity[axis + axis] * 0.01 for axis in "XYZ"]
    across = [sensitivity[pair] * 0.01 + 250 for pair in ("XY", "XZ", "YZ")]
    possible = all(LEAST_PER_G <= value <= MOST_PER_G for value in along + across)
    if not possible or any(abs(value) > FARTHEST_OFFSET for value in offset):
        raise _unusable("makes no sense", path)
    x, y, z = (1.0 / value for value in along)
    xy, xz, yz = (1.0 / value - 0.004 for value in across)
    matrix = ((x, xy, xz), (xy, y, yz), (xz, yz, z))
    return FactoryAcceleration(CALIBRATION, MATRIX, rate, (offset[0], offset[1], offset[2]), matrix)


def _unusable(what: str, path: Path) -> UnreadableError:
    text = f"calibration.json in it, which its counts need, {what}"
    return UnreadableError(text, path=path, hint=READ_AS_COUNTS)


def _number(value: Any) -> float | None:
    """Return a number, from a JSON number or text; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if isfinite(number) else None


def calibrated_counts(raw: Counts, factory: FactoryAcceleration) -> NDArray[np.int32]:
    """Return raw counts (n, 3) as calibrated ones, `FLOAT_LSB_PER_G` in one g."""
    x, y, z = (raw[:, axis] - factory.offset_counts[axis] for axis in range(3))
    rows = [[value * FLOAT_LSB_PER_G for value in row] for row in factory.g_per_count]
    steps = [np.rint(x * row[0] + y * row[1] + z * row[2]) for row in rows]
    return np.stack([value.clip(-MOST_COUNTS, MOST_COUNTS) for value in steps], axis=1).astype(np.int32)


def temperature_of(values: Values | None) -> FactoryTemperature | None:
    """Return how counts of the accelerometer's thermometer become degrees; None if nothing says it.

    Calibrated values are in degrees, as the vendor's reader takes them.
    """
    if values is None or "isCalibrated" not in values:
        return None
    if not is_open(values):
        return FactoryTemperature(TEMPERATURE_CALIBRATION, IN_DEGREES, (0.0, 1.0), (0.0, 1.0))
    names = ("adxlTempLow", "adxlTempHigh", "tempLow", "tempHigh")
    low, high, cold, warm = (_number(values.get(name)) for name in names)
    if values.get("calibrationMethod") != LINE or low is None or high is None or cold is None or warm is None:
        return None
    if low == high or not COLDEST_C <= min(cold, warm) <= max(cold, warm) <= WARMEST_C:
        return None
    return FactoryTemperature(TEMPERATURE_CALIBRATION, LINE, (low, high), (cold, warm))


def temperatures(
    batch: RecordBatch, factory: FactoryTemperature
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return temperatures, (k,) thousandths of a degree C, and where their records begin.

    They are those of the accelerometer's thermometer; readings that are not temperatures are left out.
    """
    found: list[tuple[int, int]] = []
    for number in np.flatnonzero(batch.records.kind == log.TEMPERATURE).tolist():
        data, begins = log.payload(batch, number), int(batch.records.start[number])
        places = range(0, len(data) - READING_BYTES + 1, READING_BYTES)
        for at in [at for at in places if data[at] == ACCELEROMETER_SENSOR][-1:]:
            value = int.from_bytes(data[at + 1 : at + READING_BYTES], "little", signed=True)
            found.append((value, begins))
    counts, starts = np.array(found, np.int64).reshape(-1, 2).T
    (low, high), (cold, warm) = factory.counts, factory.celsius
    celsius = (counts - low) * ((warm - cold) / (high - low)) + cold
    usable = (celsius >= COLDEST_C) & (celsius <= WARMEST_C)
    return np.rint(1000 * celsius[usable]).astype(np.int32), starts[usable]


class Thermometer:
    """Gives samples the last temperature recorded before them, `first_mc` before the first reading."""

    def __init__(self, factory: FactoryTemperature, first_mc: int) -> None:
        self._factory, self._last = factory, first_mc

    def temperatures_of(
        self, batch: RecordBatch, records: Records, rows: NDArray[np.int64]
    ) -> NDArray[np.int32]:
        """Return the temperatures of records with `rows` samples each; batches in file order."""
        found, places = temperatures(batch, self._factory)
        known = np.concatenate((np.array([self._last], np.int32), found))
        self._last = int(known[-1])
        return np.asarray(np.repeat(known[np.searchsorted(places, records.start)], rows))


# What other sensors record, with a second as its time: README.md of GT3X-File-Format, "Log Record Types",
# and LogRecords/Capsense.md.


@dataclass(frozen=True, slots=True)
class Reading:
    """A whole number in records of a kind: its place and type, and how many make one of the column's unit."""

    kind: int
    column: OtherColumn
    offset: int
    dtype: str
    per_unit: int = 1

    @property
    def least_bytes(self) -> int:
        """Bytes of payload of a record that holds it."""
        return self.offset + np.dtype(self.dtype).itemsize

    def values(self, buffer: NDArray[np.uint8], records: Records) -> NDArray[np.float64]:
        """Return the values of records of this kind that are large enough, (k,)."""
        data = payloads_of(buffer, records.start + self.offset, np.dtype(self.dtype).itemsize)
        return data.view(self.dtype)[:, 0] / self.per_unit


READINGS = (
    Reading(log.LUX, OtherColumn("light", "lux"), 0, "<u2"),
    Reading(log.BATTERY, OtherColumn("battery", "V"), 0, "<u2", per_unit=1000),
    Reading(log.HEART_RATE, OtherColumn("heart_rate", "bpm"), 0, "u1"),
    Reading(log.CAPSENSE, OtherColumn("capsense", "counts"), 0, "<u2"),
    Reading(log.CAPSENSE, OtherColumn("capsense_reference", "counts"), 2, "<u2"),
    Reading(log.CAPSENSE, OtherColumn("worn", "1 while it touches skin"), 4, "u1"),
)


# The sensors of a device.

USUAL_RATE, UNEVEN = 100, 0.1
"""Samples in a second if a schema says 0, and the deviation of the IMU's own clock as a part of its rate."""

ID_BYTES, PAIR_BYTES, SAMPLE_BYTES, KIND_BITS = 2, 9, 6, 8
LEAST_SCALE, LARGEST_SCALE = 0.1, 1e6
"""Smallest and largest number of counts in one g, degree or degree per second that make sense."""

_HEAD = struct.Struct("<HHH")
_COLUMN = struct.Struct("<BBBI16s")
_BIG_ENDIAN, _SIGNED = 1, 2
_AXES = " X", " Y", " Z"
ACCELEROMETER, GYROSCOPE, TEMPERATURE = "Accelerometer", "Gyroscope", "Temperature"

YXZ, XYZ = (1, 0, 2), (0, 1, 2)
"""Axes of the values of a sample, in the order of the file."""

KINDS = (log.ACTIVITY, log.ACTIVITY2, log.ACTIVITY3)
DOCKED_BYTES = 1
"""Length of a payload that says that the device was connected to a computer."""

ACTIVITY_PIECE_BYTES = PAIR_BYTES << 16
ASLEEP = "samples that repeat the one before for a second or longer, treated as idle sleep of the device"
CUT_SAMPLE = "an incomplete sample at the end of activity.bin, bytes left out"


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of k records in file order, n in all.

    Attributes:
        rows: (k,) samples of each record.
        counts: (n, 3).
        channels: n rows each.
    """

    rows: NDArray[np.int64]
    counts: NDArray[np.int16]
    channels: Channels = field(default_factory=dict)

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """Counts and channels by their names in Chunk."""
        return {"counts": self.counts, **self.channels}


class Sensor(Protocol):
    """One of the device's sensors."""

    @property
    def rate(self) -> int:
        """Samples in a second."""

    @property
    def fills(self) -> bool:
        """True if the device repeats its last sample while it sleeps."""

    def holds(self, batch: RecordBatch) -> NDArray[np.bool_]:
        """Return which records of a batch hold its samples, (m,)."""

    def decode(self, batch: RecordBatch, records: Records) -> Samples:
        """Return the samples of those records of a batch for which `holds` is True."""

    def whole(self, records: Records) -> NDArray[np.bool_]:
        """Return which of these records are one second of samples and nothing else, (k,)."""


def payloads_of(buffer: NDArray[np.uint8], start: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
    """Return the payloads of records of one size that begin at `start` (k,), (k, size)."""
    if not size:
        return np.empty((len(start), 0), np.uint8)
    every = np.lib.stride_tricks.sliding_window_view(buffer, size)
    return np.ascontiguousarray(every[start + log.HEADER_BYTES])


def first_rows(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of the first sample of each record, (k,)."""
    return np.cumsum(rows) - rows


@dataclass(frozen=True, slots=True)
class SchemaColumn:
    """A 16-bit value of each sample: its place, byte order, and counts in one unit."""

    offset: int
    order: str
    scale: float


@dataclass(frozen=True, slots=True)
class Schema:
    """The content of sensor records, which begin with its number.

    Attributes:
        rate: samples in a second.
        row_bytes: bytes of a sample.
        columns: by label; only those of signed 16 bits.
    """

    number: int
    rate: int
    row_bytes: int
    columns: dict[str, SchemaColumn]

    def axes(self, label: str) -> tuple[SchemaColumn, ...]:
        """Return the columns of a sensor's three axes; none if one is missing."""
        axes = [self.columns.get(label + axis) for axis in _AXES]
        return tuple(column for column in axes if column) if all(axes) else ()


def parse_schema(data: bytes) -> Schema | None:
    """Parse a schema record's payload; None if it makes no sense."""
    if len(data) < _HEAD.size:
        return None
    number, column_count, samples = _HEAD.unpack_from(data)
    if column_count * _COLUMN.size != len(data) - _HEAD.size:
        return None
    columns, row_bytes = dict[str, SchemaColumn](), 0
    for flags, offset, bits, scale, label in _COLUMN.iter_unpack(data[_HEAD.size :]):
        row_bytes += bits // 8
        per_unit = log.float_of(scale)
        plain = bits == 16 and flags & _SIGNED and offset % 8 == 0
        if plain and LEAST_SCALE <= per_unit <= LARGEST_SCALE:
            order = ">i2" if flags & _BIG_ENDIAN else "<i2"
            columns[label.decode("ascii", "replace").strip()] = SchemaColumn(offset // 8, order, per_unit)
    fitting = {name: column for name, column in columns.items() if column.offset + 2 <= row_bytes}
    return Schema(number, samples or USUAL_RATE, row_bytes, fitting) if row_bytes else None


@dataclass(frozen=True, slots=True)
class Imu:
    """The second sensor as the schema describes it, with its temperature at 0 counts."""

    schema: Schema
    zero_c: float
    fills: bool = False

    @property
    def rate(self) -> int:
        """Nominal samples in a second."""
        return self.schema.rate

    def holds(self, batch: RecordBatch) -> NDArray[np.bool_]:
        """Return which records hold samples by this schema, (m,)."""
        records = batch.records
        data = (records.kind == log.SENSOR_DATA) & (records.size >= ID_BYTES + self.schema.row_bytes)
        number = payloads_of(batch.page.buffer, records.start[data], ID_BYTES).view("<u2")[:, 0]
        data[data] = number == self.schema.number
        return np.asarray(data)

    def whole(self, records: Records) -> NDArray[np.bool_]:
        """Return which records hold about as many samples as the rate says, without further bytes, (k,)."""
        rows = self._rows(records)
        exact = records.size == ID_BYTES + rows * self.schema.row_bytes
        return np.asarray(exact & (np.abs(rows - self.rate) <= UNEVEN * self.rate))

    def decode(self, batch: RecordBatch, records: Records) -> Samples:
        """Return the samples of records, decoding those of one size at once."""
        rows = self._rows(records)
        table = np.empty((int(rows.sum()), self.schema.row_bytes), np.uint8)
        first = first_rows(rows)
        for size in np.unique(records.size).tolist():
            chosen = records.size == size
            data = payloads_of(batch.page.buffer, records.start[chosen], size)[:, ID_BYTES:]
            whole = data[:, : data.shape[1] // self.schema.row_bytes * self.schema.row_bytes]
            values = whole.reshape(len(data), -1, self.schema.row_bytes)
            table[first[chosen, None] + np.arange(values.shape[1])] = values
        channels: Channels = {}
        if gyro := self.schema.axes(GYROSCOPE):
            channels["gyro_counts"] = vectors(table, gyro)
        if column := self.schema.columns.get(TEMPERATURE):
            celsius = value_of(table, column) / column.scale + self.zero_c
            channels["temperature_mc"] = np.rint(1000 * celsius).astype(np.int32)
        return Samples(rows, vectors(table, self.schema.axes(ACCELEROMETER)), channels)

    def _rows(self, records: Records) -> NDArray[np.int64]:
        return (records.size - ID_BYTES) // self.schema.row_bytes


def vectors(table: NDArray[np.uint8], columns: tuple[SchemaColumn, ...]) -> NDArray[np.int16]:
    """Return three columns of samples (n, bytes) as (n, 3)."""
    return np.stack([value_of(table, column) for column in columns], axis=1)


def value_of(table: NDArray[np.uint8], column: SchemaColumn) -> NDArray[np.int16]:
    """Return a column of samples (n, bytes), (n,)."""
    data = np.ascontiguousarray(table[:, column.offset : column.offset + 2])
    return data.view(column.order)[:, 0].astype(np.int16)


def packed_samples(size: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many whole samples `size` bytes hold, (k,)."""
    return 2 * size // PAIR_BYTES


def packed_bytes(samples: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many bytes samples take, the last half byte unused if their number is odd, (k,)."""
    return (samples * PAIR_BYTES + 1) // 2


def unpacked(payload: NDArray[np.uint8], samples: int, order: tuple[int, int, int]) -> NDArray[np.int16]:
    """Return the samples of payloads (k, bytes), whose rows are contiguous, (k, samples, 3)."""
    pairs = -(-samples // 2)
    missing = pairs * PAIR_BYTES - payload.shape[1]
    padded = np.pad(payload, ((0, 0), (0, missing))) if missing > 0 else payload[:, : pairs * PAIR_BYTES]
    triples = padded.reshape(len(payload), pairs, 3, 3).astype(np.int16)
    values = np.empty((len(payload), pairs, 2, 3), np.int16)
    first, second, third = (triples[:, :, :, column] for column in range(3))
    even, odd = (first << 8 | second) >> 4, (second << 12 | third << 4) >> 4
    # Each three bytes hold a value of the pair's even sample and one of its odd one.
    in_turn = [column for triple in range(3) for column in (even[:, :, triple], odd[:, :, triple])]
    for place, value in enumerate(in_turn):
        values[:, :, place // 3, order[place % 3]] = value
    return values.reshape(len(payload), 2 * pairs, 3)[:, :samples]


@dataclass(frozen=True, slots=True)
class Primary:
    """The main accelerometer.

    Firmware 1.6.0 of the wGT3X-BT turned the axes of packed samples: the vendor's document says x = y of the
    file, y = -x of the file.
    """

    rate: int
    turned: bool = False
    fills: bool = True

    def holds(self, batch: RecordBatch) -> NDArray[np.bool_]:
        """Return which records hold samples, (m,)."""
        return np.isin(batch.records.kind, KINDS) & (batch.records.size > DOCKED_BYTES)

    def decode(self, batch: RecordBatch, records: Records) -> Samples:
        """Return the samples of records, decoding those of one kind and size at once."""
        buffer = batch.page.buffer
        rows = samples_in(records)
        like = records.size << KIND_BITS | records.kind
        groups = [divmod(value, 1 << KIND_BITS) for value in set(like.tolist())]
        if len(groups) == 1:
            return Samples(rows, self._group(buffer, records, *groups[0]).reshape(-1, 3))
        counts, first = np.empty((int(rows.sum()), 3), np.int16), first_rows(rows)
        for size, kind in groups:
            chosen = like == (size << KIND_BITS | kind)
            values = self._group(buffer, records.select(chosen), size, kind)
            counts[first[chosen, None] + np.arange(values.shape[1])] = values
        return Samples(rows, counts)

    def whole(self, records: Records) -> NDArray[np.bool_]:
        """Return which records hold as many samples as the rate says, without further bytes, (k,)."""
        rows = samples_in(records)
        bytes_of = np.where(records.kind == log.ACTIVITY2, SAMPLE_BYTES * rows, packed_bytes(rows))
        return np.asarray((rows == self.rate) & (records.size == bytes_of))

    def _group(self, buffer: NDArray[np.uint8], records: Records, size: int, kind: int) -> NDArray[np.int16]:
        """Return the samples of records of one kind and size, (k, rows, 3)."""
        data = payloads_of(buffer, records.start, size)
        if kind == log.ACTIVITY2:
            whole = data[:, : size // SAMPLE_BYTES * SAMPLE_BYTES]
            values = np.ascontiguousarray(whole).view("<i2").astype(np.int16, copy=False)
            return values.reshape(len(data), -1, 3)
        samples = int(packed_samples(np.array(size)))
        values = unpacked(data, samples, YXZ if kind == log.ACTIVITY else XYZ)
        if self.turned and kind == log.ACTIVITY:  # the exchange of the axes is undone
            values = np.stack((values[:, :, 1], -values[:, :, 0], values[:, :, 2]), axis=2)
        return values


def samples_in(records: Records) -> NDArray[np.int64]:
    """Return how many samples activity records hold, (k,)."""
    return np.where(records.kind == log.ACTIVITY2, records.size // SAMPLE_BYTES, packed_samples(records.size))


@dataclass(frozen=True, slots=True)
class ActivityFile:
    """An activity.bin whose settings are known.

    Attributes:
        start_us: time of the first sample.
        problems: those found before any sample.
    """

    archive: Archive
    member: Member
    rate: int
    start_us: int
    problems: tuple[Problem, ...] = ()

    @property
    def samples(self) -> int | None:
        """Number of samples, None if the zip file is damaged or does not say."""
        size = None if self.archive.problems else self.member.unpacked_bytes
        return None if size is None else int(packed_samples(np.array(size)))

    def stream(self, chunk_samples: int, threads: int = 1) -> Generator[Chunk, None, None]:
        """Yield all chunks; raises UnreadableError if the disk fails, or the part is damaged.

        Without checksums of their own, any of the values may then be wrong.
        """
        from accelcal_cli.formats._rows import RepeatedSamples  # log.bin marks idle sleep itself

        repeats, rows, problems = RepeatedSamples(self.rate), 0, self.problems
        waiting = np.empty((0, 3), np.int16)
        asleep: list[int] = []
        with (
            MemberStream(self.archive, self.member) as source,
            closing(source.pieces(ACTIVITY_PIECE_BYTES, threads)) as pieces,
        ):
            for piece in pieces:
                waiting = np.concatenate((waiting, samples_of(piece.data)))
                filled = repeats.mark(waiting, last=piece.last)
                counts, waiting = waiting[: len(filled)], waiting[len(filled) :]
                asleep += [rows + int(np.argmax(filled)), int(filled.sum())] if filled.any() else []
                if piece.last:
                    problems += tuple(self._ending(source, rows + len(counts), asleep))
                for start in range(0, len(counts) or bool(problems), chunk_samples):
                    part, first = counts[start : start + chunk_samples], rows + start
                    idle = filled[start : start + chunk_samples]
                    validity = None
                    if idle.any():
                        validity = np.where(idle, Validity.FILLED, Validity.MEASURED).astype(np.uint8)
                    yield Chunk(
                        first_sample=first,
                        counts=part,
                        clock=UniformClock(self.start_us, first, rate_fraction(self.rate)),
                        end_byte=piece.end_byte,
                        validity=validity,
                        problems=problems,
                        used_bytes=int(np.diff(packed_bytes(np.array((first, first + len(part)))))[0]),
                    )
                    problems = ()
                rows += len(counts)

    def _ending(self, source: MemberStream, rows: int, asleep: list[int]) -> Iterator[Problem]:
        """Yield a problem for all filled samples, given pairs of a first one and a number, and of the end."""
        if asleep:
            first, count = asleep[0], sum(asleep[1::2])
            place = int(packed_bytes(np.array(first)))
            yield Problem("idle_sleep", f"{ASLEEP}: {count}", place, first, count)
        if source.fault in (Fault.DAMAGED, Fault.WRONG_CHECKSUM):
            what = "activity.bin in it is damaged: some of its values are not what was recorded"
            raise UnreadableError(what, path=self.archive.path, hint="copy it again from its source")
        if left := source.size - int(packed_bytes(packed_samples(np.array(source.size)))):
            yield Problem("truncated", f"{CUT_SAMPLE}: {left}", source.size - left, rows, left, left)
        if (fault := source.problem(rows)) is not None:
            yield fault


def samples_of(data: bytes) -> NDArray[np.int16]:
    """Return the samples of a piece of activity.bin, (n, 3)."""
    whole = int(packed_samples(np.array(len(data))))
    return np.asarray(unpacked(np.frombuffer(data, np.uint8)[None], whole, YXZ)[0])


def has_samples(file: ActivityFile) -> bool:
    """Return True if there is a sample; raises UnreadableError if activity.bin cannot be read."""
    with MemberStream(file.archive, file.member) as source:
        return len(samples_of(source.read(PAIR_BYTES))) > 0
