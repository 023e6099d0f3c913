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

import struct
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import Channels, Chunk, Problem, Validity
from accelcal_cli.formats.gt3x import records as log
from accelcal_cli.formats.gt3x.archive import Archive, Fault, Member, MemberStream
from accelcal_cli.formats.gt3x.records import RecordBatch, Records

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
    """Samples of k records with `rows` samples each, in file order; n in all."""

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
    """The content of sensor records, which begin with its number; its columns of 16 bits by label."""

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
    """An activity.bin whose settings are known, with problems found before any sample."""

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
                    validity = np.where(idle, Validity.FILLED, Validity.MEASURED).astype(np.uint8)
                    yield Chunk(
                        first_sample=first,
                        counts=part,
                        clock=UniformClock(self.start_us, first, rate_fraction(self.rate)),
                        end_byte=piece.end_byte,
                        validity=validity if idle.any() else None,
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
