"""Reads Avro files of an Empatica EmbracePlus: half an hour of acceleration, and what was measured with it.

An Avro object container file has a header with schema, codec and marker, then blocks of records, each
followed by the marker; numbers are zigzag varints (Apache Avro specification 1.11). The first record is
decoded by the schema that the file carries. Arrays of numbers become numpy arrays, all else plain Python.
Nothing that a file claims takes more memory than a few times LARGEST_BYTES.

Counts are whole numbers for x, y and z. Their scale in g is in `imuParams`: from schema 6.5.0 on as
`conversionFactor`, before that by the physical range over the digital one (Empatica, "How to access Avro
files with Python", support.empatica.com). Times are microseconds since 1970 in UTC.
"""

from __future__ import annotations

import bz2
import json
import math
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import FIRST_US, LAST_US, MICROSECONDS, UniformClock, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.recording import (
    LARGEST_LSB_PER_G,
    Channels,
    Chunk,
    Counts,
    Device,
    OtherColumn,
    Others,
    Problem,
    Reader,
    Recording,
    cut_channels,
    no_others,
)
from accelcal_cli.formats._bytes import ByteSource

BY_FACTOR = (6, 5, 0)
"""First version of the schema in which `conversionFactor` is the scale."""

RATES_HZ = (1.0, 10_000.0)
COLDEST, HOTTEST = -273_150, 1_000_000
MOST_COUNTS = (1 << 31) - 1
LONGEST_ZONE_S = 14 * 3600

LARGEST_BYTES = 1 << 26
"""Most bytes of a file, and of an unpacked block; half an hour of all sensors has 5 MB."""

DEEPEST = 32
MOST_ITEMS, MOST_VALUES = 100_000, 1_000_000
"""Most items of a list that is not of numbers, and values that are decoded one by one: some take no bytes."""

VARINT_BYTES, PIECE, MARKER_BYTES, MAGIC_BYTES = 10, 1 << 16, 16, 4
DOWNLOAD_AGAIN = "download it again"
NUMBERS, WHOLE = {"float": "<f4", "double": "<f8"}, ("int", "long")
HEADER = {"type": "map", "values": "bytes"}
OTHERS = {
    "eda": OtherColumn("eda", "uS"),
    "bvp": OtherColumn("bvp", "nW"),
    "steps": OtherColumn("steps", "steps"),
}
"""Further fields of `rawData` (Empatica, as above)."""

BUTTON = OtherColumn("button", "1 where it was pressed")
PRIMITIVES = ("null", "boolean", "bytes", "string", *WHOLE, *NUMBERS)


class DamageError(Exception):
    """The data cannot be decoded; the message says why."""


@dataclass(frozen=True, slots=True)
class FirstRecord:
    """The first record of a file; its block ends at a byte of the (uncompressed) file.

    The marker after its block may be right, and there may be `more` records or bytes.
    """

    fields: dict[str, Any]
    end: int
    marked: bool
    more: int


class ByteReader:
    """Reads bytes from their beginning."""

    def __init__(self, data: bytes) -> None:
        self.data, self.place = data, 0

    def take(self, size: int) -> bytes:
        """Return the next bytes; DamageError if there are too few."""
        if not 0 <= size <= len(self.data) - self.place:
            raise DamageError(f"it ends early, after {len(self.data)} bytes")
        self.place += size
        return self.data[self.place - size : self.place]

    def long(self) -> int:
        """Return the next whole number."""
        value = 0
        for shift in range(0, 7 * VARINT_BYTES, 7):
            byte = self.take(1)[0]
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return (value >> 1) ^ -(value & 1)
        raise DamageError(f"a number at byte {self.place} has no end")

    def longs(self, count: int) -> NDArray[np.int64]:
        """Return the next `count` whole numbers (n,)."""
        parts, left = [np.empty(0, np.int64)], count
        while left:
            number = min(left, PIECE)
            view = np.frombuffer(self.data, np.uint8, offset=self.place)[: VARINT_BYTES * number]
            ends = np.flatnonzero(view < 0x80)[:number] + 1
            if len(ends) < number:
                raise DamageError(f"it ends early, after {len(self.data)} bytes")
            starts = np.concatenate(([0], ends[:-1]))
            sizes = ends - starts
            if sizes.max() > VARINT_BYTES:
                raise DamageError(f"a number after byte {self.place} has no end")
            shift = np.arange(ends[-1]) - np.repeat(starts, sizes)
            bits = (view[: ends[-1]] & 0x7F).astype(np.uint64) << (7 * shift).astype(np.uint64)
            value = np.bitwise_or.reduceat(bits, starts)
            parts.append((value >> np.uint64(1)).astype(np.int64) ^ -(value & np.uint64(1)).astype(np.int64))
            self.place += int(ends[-1])
            left -= number
        return np.concatenate(parts)

    def counts(self) -> Iterator[int]:
        """Yield the numbers of items in the blocks of an array or a map."""
        while number := self.long():
            if number < 0:
                self.long()
            yield abs(number)


class SchemaDecoder:
    """Decodes values by a schema, which is as JSON."""

    def __init__(self, schema: Any) -> None:
        self._schema, self._values = schema, 0
        self._types_by_name: dict[str, Any] = {}

    def record(self, data: ByteReader) -> dict[str, Any]:
        """Return the record, or map, that the data begin with."""
        value = self._value(self._schema, data, 0)
        if not isinstance(value, dict):
            raise DamageError("its schema is not that of a record")
        return value

    def _value(self, schema: Any, data: ByteReader, depth: int) -> Any:
        self._values += 1
        if depth > DEEPEST or self._values > MOST_VALUES:
            raise DamageError("its schema is nested too deep")
        if isinstance(schema, list):
            branch = data.long()
            if not 0 <= branch < len(schema):
                raise DamageError(f"a value before byte {data.place} is of no known type")
            return self._value(schema[branch], data, depth + 1)
        if isinstance(schema, str):
            if schema in PRIMITIVES:
                return _primitive(schema, data)
            if schema.rpartition(".")[2] not in self._types_by_name:
                raise DamageError(f"its schema does not say what {schema[:40]!r} is")
            return self._value(self._types_by_name[schema.rpartition(".")[2]], data, depth + 1)
        if not isinstance(schema, Mapping):
            raise DamageError("its schema is damaged")
        return self._complex(schema, data, depth)

    def _complex(self, schema: Mapping[str, Any], data: ByteReader, depth: int) -> Any:
        kind = schema.get("type")
        if isinstance(name := schema.get("name"), str):
            self._types_by_name[name.rpartition(".")[2]] = schema
        if kind == "record":
            return {key: self._value(item, data, depth + 1) for key, item in _fields(schema)}
        if kind == "array":
            return self._array(schema.get("items"), data, depth)
        if kind == "map":
            return self._map(schema.get("values"), data, depth)
        if kind == "enum":
            return data.long()
        if kind == "fixed":
            size = schema.get("size")
            return data.take(size if isinstance(size, int) else -1)
        return self._value(kind, data, depth + 1)

    def _array(self, items: Any, data: ByteReader, depth: int) -> Any:
        plain = items.get("type") if isinstance(items, Mapping) else items
        if plain in WHOLE:
            parts = [data.longs(_fitting(count, data, 1)) for count in data.counts()]
            return np.concatenate([np.empty(0, np.int64), *parts])
        if isinstance(plain, str) and plain in NUMBERS:
            kind = np.dtype(NUMBERS[plain])
            raw = [data.take(_fitting(count, data, kind.itemsize) * kind.itemsize) for count in data.counts()]
            return np.frombuffer(b"".join(raw), kind)
        values: list[Any] = []
        for count in data.counts():
            if len(values) + count > MOST_ITEMS:
                raise DamageError(f"a list claims {count} items")
            values += [self._value(items, data, depth + 1) for _ in range(count)]
        return values

    def _map(self, values: Any, data: ByteReader, depth: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for count in data.counts():
            if len(found) + count > MOST_ITEMS:
                raise DamageError(f"a map claims {count} items")
            for _ in range(count):
                key = _primitive("string", data)
                found[str(key)] = self._value(values, data, depth + 1)
        return found


def _fitting(count: int, data: ByteReader, least: int) -> int:
    """Return a number of items of at least `least` bytes each; DamageError if they cannot be there."""
    if count * least > len(data.data) - data.place:
        raise DamageError(f"an array claims {count} numbers, more than there are bytes")
    return count


def _primitive(kind: str, data: ByteReader) -> Any:
    if kind == "null":
        return None
    if kind == "boolean":
        return data.take(1) != b"\0"
    if kind in WHOLE:
        return data.long()
    if kind in NUMBERS:
        size = np.dtype(NUMBERS[kind]).itemsize
        return float(struct.unpack("<f" if kind == "float" else "<d", data.take(size))[0])
    raw = data.take(data.long())
    return raw.decode("utf-8", "replace") if kind == "string" else raw


def _fields(schema: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    fields = schema.get("fields")
    for field in fields if isinstance(fields, list) else []:
        if not isinstance(field, Mapping) or not isinstance(field.get("name"), str) or "type" not in field:
            raise DamageError("its schema is damaged")
        yield field["name"], field["type"]


def read_first(path: Path) -> FirstRecord:
    """Decode the first record; raises UnreadableError if it is damaged, too large or oddly packed."""
    with ByteSource(path) as source:
        data = ByteReader(source.read_exact(LARGEST_BYTES + 1))
        source.refuse_damaged()
    if len(data.data) > LARGEST_BYTES:
        what = f"has more than {LARGEST_BYTES >> 20} MB, which no half hour of an EmbracePlus takes"
        hint = "give it as the files of half an hour that Empatica writes"
        raise UnreadableError(what, path=path, hint=hint)
    try:
        return _first_record(data)
    except DamageError as error:
        what = f"cannot be decoded: {error}"
        raise UnreadableError(what, path=path, byte_offset=data.place, hint=DOWNLOAD_AGAIN) from error


def _first_record(data: ByteReader) -> FirstRecord:
    data.take(MAGIC_BYTES)
    about: dict[str, bytes] = SchemaDecoder(HEADER).record(data)
    marker = data.take(MARKER_BYTES)
    try:
        schema = json.loads(about.get("avro.schema", b""))
    except (ValueError, RecursionError) as error:
        raise DamageError("its schema is damaged") from error
    records = data.long()
    if records < 1:
        raise DamageError("it holds no record")
    block = data.take(data.long())
    marked = data.take(min(MARKER_BYTES, len(data.data) - data.place)) == marker
    unpacked = ByteReader(_unpacked(block, about.get("avro.codec", b"null")))
    fields = SchemaDecoder(schema).record(unpacked)
    more = records - 1 or len(unpacked.data) - unpacked.place or len(data.data) - data.place
    return FirstRecord(fields, data.place, marked, more)


def _unpacked(block: bytes, codec: bytes) -> bytes:
    try:
        if codec == b"null":
            return block
        if codec == b"deflate":
            whole = zlib.decompressobj(-15).decompress(block, LARGEST_BYTES + 1)
        elif codec == b"bzip2":
            whole = bz2.BZ2Decompressor().decompress(block, LARGEST_BYTES + 1)
        else:
            name = codec[:20].decode("ascii", "replace")
            raise DamageError(f"it is packed with {name}, which is not known")
    except (zlib.error, OSError, EOFError) as error:
        raise DamageError(f"its packed data are damaged ({error})") from error
    if len(whole) > LARGEST_BYTES:
        raise DamageError(f"it unpacks to more than {LARGEST_BYTES >> 20} MB")
    return whole


@dataclass(frozen=True, slots=True)
class Sensor:
    """Three axes of a sensor.

    Attributes:
        counts: (n, 3) int32.
        step: size of one count, in g or in deg/s.
        largest: largest physical value that it can measure, None if the file does not say.
        spare: how many values the longest axis has more than the shortest.
    """

    counts: NDArray[np.int32]
    step: float
    largest: float | None
    start_us: int
    rate_hz: float
    spare: int


def subrecord(fields: Any, *names: str) -> dict[str, Any]:
    """Return a record within a record; empty if it is missing."""
    for name in names:
        fields = fields.get(name) if isinstance(fields, Mapping) else None
    return dict(fields) if isinstance(fields, Mapping) else {}


def number(value: Any) -> float:
    """Return a number; NaN for anything else."""
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if plain and abs(value) < 1e300 else math.nan


def read_sensor(fields: Mapping[str, Any], version: tuple[int, ...]) -> Sensor | None:
    """Return a sensor's data; None if it has none that can be used."""
    axes = map(fields.get, "xyz")
    columns = [axis for axis in axes if isinstance(axis, np.ndarray) and axis.dtype == np.int64 and len(axis)]
    if len(columns) < 3 or any(not -MOST_COUNTS <= one.min() <= one.max() <= MOST_COUNTS for one in columns):
        return None
    rows = min(map(len, columns))
    start = number(fields.get("timestampStart"))
    return Sensor(
        np.stack([column[:rows] for column in columns], axis=1).astype(np.int32),
        *scale_of(subrecord(fields, "imuParams"), version),
        int(start) if FIRST_US <= start <= LAST_US else 0,
        number(fields.get("samplingFrequency")),
        max(map(len, columns)) - rows,
    )


def scale_of(params: Mapping[str, Any], version: tuple[int, ...]) -> tuple[float, float | None]:
    """Return the size of one count, NaN if unknown; and the largest value that can be measured, or None."""
    names = ("physicalMin", "physicalMax", "digitalMin", "digitalMax")
    low, high, first, last = (number(params.get(name)) for name in names)
    ranged = (high - low) / (last - first) if last > first else math.nan
    factor = number(params.get("conversionFactor"))
    steps = [factor, ranged] if version >= BY_FACTOR else [ranged, factor]
    step = next((value for value in steps if 0 < value < math.inf), math.nan)
    return step, min(-low, high) if low < 0 < high else None


def temperature_of(fields: Mapping[str, Any], sensor: Sensor, rate_hz: float) -> NDArray[np.int32] | None:
    """Return for each row the last value measured, (n,) thousandths of a degree C; None if there is none."""
    values, rate = fields.get("values"), number(fields.get("samplingFrequency"))
    start = number(fields.get("timestampStart"))
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f" or not 0 < rate <= RATES_HZ[1]:
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        milli = np.rint(values.astype(np.float64) * 1000)
        known = np.flatnonzero((milli >= COLDEST) & (milli <= HOTTEST))
    if not len(known) or not abs(start - sensor.start_us) < 3600 * MICROSECONDS:
        return None
    after_s = np.arange(len(sensor.counts)) / rate_hz + (sensor.start_us - start) / MICROSECONDS
    place = np.floor(after_s * rate + 1e-6).astype(np.int64)
    latest = np.maximum(np.searchsorted(known, place, side="right") - 1, 0)
    return np.asarray(milli[known[latest]].astype(np.int32))


@dataclass(frozen=True, slots=True)
class Track:
    """Values of another quantity, (n,), each with the row that was measured then or next."""

    column: OtherColumn
    row: NDArray[np.int64]
    values: NDArray[np.float64]


def other_tracks(fields: Mapping[str, Any], sensor: Sensor, rate_hz: float) -> Iterator[Track]:
    """Yield what was sampled besides motion and temperature, at most as often, and presses of the button."""
    raw = subrecord(fields, "rawData")
    for name, column in OTHERS.items():
        about = subrecord(raw, name)
        values, rate = about.get("values"), number(about.get("samplingFrequency"))
        start = number(about.get("timestampStart"))
        near = abs(start - sensor.start_us) < 3600 * MICROSECONDS
        if isinstance(values, np.ndarray) and len(values) and near and 1e-3 <= rate <= rate_hz * (1 + 1e-6):
            after_s = np.arange(len(values)) / rate + (start - sensor.start_us) / MICROSECONDS
            yield Track(column, np.ceil(after_s * rate_hz - 1e-6).astype(np.int64), values.astype(np.float64))
    pressed = subrecord(raw, "tags").get("tagsTimeMicros")
    if isinstance(pressed, np.ndarray) and len(pressed) and sensor.start_us:
        after = (pressed - sensor.start_us) * (rate_hz / MICROSECONDS)
        yield Track(BUTTON, np.ceil(after - 1e-6).astype(np.int64), np.ones(len(pressed)))


class EmbracePlusReader(Reader):
    """Gives the rows of a file, which are all in memory: no more than LARGEST_BYTES can claim."""

    def __init__(
        self,
        recording: Recording,
        counts: Counts,
        channels: Channels,
        problems: Iterable[Problem],
        tracks: Sequence[Track] = (),
    ) -> None:
        self.recording, self._problems = recording, tuple(problems)
        self._counts, self._channels, self._tracks = counts, channels, tracks

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, at most `chunk_samples` at a time."""
        about, rows = self.recording, len(self._counts)
        rate = rate_fraction(about.rate_hz)
        for start, stop in pairwise([*range(0, rows, chunk_samples), rows]):
            first, end = (about.total_bytes * row // rows for row in (start, stop))
            yield Chunk(
                start,
                self._counts[start:stop],
                UniformClock(about.start_us or 0, start, rate),
                end,
                problems=() if start else self._problems,
                used_bytes=end - first,
                others=self._others(start, stop) if self.with_others else None,
                **cut_channels(self._channels, slice(start, stop)),
            )

    def _others(self, start: int, stop: int) -> Others:
        others = no_others(stop - start, len(self._tracks))
        for number, track in enumerate(self._tracks):
            here = (track.row >= start) & (track.row < stop)
            with np.errstate(over="ignore"):
                others[track.row[here] - start, number] = track.values[here]
        return others


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a file of an EmbracePlus; `Format.open` says what is raised."""
    record = read_first(path)
    fields = record.fields
    version = tuple(one if isinstance(one, int) else 0 for one in version_numbers(fields, "schemaVersion"))
    accel = read_sensor(subrecord(fields, "rawData", "accelerometer"), version)
    if accel is None:
        raise UnreadableError("holds no acceleration", path=path, hint=DOWNLOAD_AGAIN)
    if not 1 <= 1 / accel.step <= LARGEST_LSB_PER_G:
        what = "does not say how many counts make one g"
        raise UnreadableError(what, path=path, hint="its imuParams are damaged; download it again")
    rate_hz = accel.rate_hz if RATES_HZ[0] <= accel.rate_hz <= RATES_HZ[1] else options.rate_hz
    if rate_hz is None:
        what = "does not state its sampling rate"
        raise UnreadableError(what, path=path, hint="give it with --rate (an EmbracePlus samples at 64 Hz)")
    rate_hz = agreed_rate(options, rate_hz, path)
    channels, gyro_step, notes = channels_of(fields, accel, rate_hz, version)
    tracks = [*other_tracks(fields, accel, rate_hz)]
    about = Recording(
        path=path,
        format="embraceplus",
        rate_hz=rate_hz,
        lsb_per_g=1 / accel.step,
        total_bytes=path.stat().st_size,
        device=device_of(fields),
        range_g=accel.largest,
        start_us=accel.start_us or None,
        timezone="UTC" if accel.start_us else None,
        samples=len(accel.counts),
        duration_s=len(accel.counts) / rate_hz,
        has_temperature="temperature_mc" in channels,
        gyro_dps_per_lsb=None if gyro_step is None else (gyro_step,) * 3,
        others=tuple(track.column for track in tracks),
        notes=(*zone_note(fields), *notes),
    )
    return EmbracePlusReader(about, accel.counts, channels, problems_of(record, accel), tracks)


def version_numbers(fields: Mapping[str, Any], name: str) -> list[Any]:
    """Return the parts of a version, such as [6, 5, 0]; None for one that is missing."""
    version = subrecord(fields, name)
    return [version.get(part) for part in ("major", "minor", "patch")]


def device_of(fields: Mapping[str, Any]) -> Device:
    """Return the device with serial number and firmware."""
    serial, numbers = fields.get("deviceSn"), version_numbers(fields, "fwVersion")
    firmware = ".".join(map(str, numbers)) if all(isinstance(item, int) for item in numbers) else None
    return Device("EmbracePlus", serial if isinstance(serial, str) and serial else None, firmware)


def zone_note(fields: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a note on the wearer's time zone; times are UTC all the same."""
    ahead = fields.get("timezone")
    if not isinstance(ahead, int) or abs(ahead) > LONGEST_ZONE_S:
        return ()
    hours, minutes = divmod(abs(ahead) // 60, 60)
    return (f"the wearer's clock was UTC{'-' if ahead < 0 else '+'}{hours:02d}:{minutes:02d}; times are UTC",)


def channels_of(
    fields: Mapping[str, Any], accel: Sensor, rate_hz: float, version: tuple[int, ...]
) -> tuple[Channels, float | None, tuple[str, ...]]:
    """Return gyroscope and temperature, deg/s in one count, and why a gyroscope is not used."""
    channels: Channels = {}
    gyro = read_sensor(subrecord(fields, "rawData", "gyroscope"), version)
    step: float | None = None
    notes: tuple[str, ...] = ()
    if gyro is not None:
        apart_us = abs(gyro.start_us - accel.start_us)
        if len(gyro.counts) == len(accel.counts) and gyro.step > 0 and apart_us * rate_hz <= MICROSECONDS / 2:
            channels["gyro_counts"], step = gyro.counts, gyro.step
        else:
            notes = ("the gyroscope is not used: its samples are not those of the accelerometer",)
    temperature = temperature_of(subrecord(fields, "rawData", "temperature"), accel, rate_hz)
    if temperature is not None:
        channels["temperature_mc"] = temperature
    return channels, step, notes


def problems_of(record: FirstRecord, accel: Sensor) -> Iterator[Problem]:
    """Yield what is wrong with the file."""
    rows = len(accel.counts)
    if not accel.start_us:
        yield Problem("no_start_time", "it has no start time; times count from 1970-01-01", None, 0)
    if accel.spare:
        text = f"x, y and z are not equally long; {accel.spare} values of the longest are left out"
        yield Problem("unequal_lengths", text, None, rows, accel.spare)
    if not record.marked:
        text = "the marker behind the data is wrong or missing: some values may not be what was written"
        yield Problem("checksum", text, record.end, rows)
    if record.more:
        text = "more follows the first record, which is all that is read"
        yield Problem("bad_page", text, record.end, rows)
