"""What is known of a recording before its samples are read: info.txt, and the beginning of log.bin.

info.txt is what the device's software wrote, one "key: value" a line. Scale, range and rate of a sensor come
from info.txt, else from the parameters in log.bin, else from the model. Source: info.txt.md of
github.com/actigraph/GT3X-File-Format and NHANES-GT3X-File-Format. Times are .NET ticks, 100 ns since the
year 1, on the device's clock.
"""

from __future__ import annotations

import re
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import numpy as np

from accelcal_cli.core.clock import WIDEST_OFFSET_H
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.factory import FactoryAcceleration, FactoryTemperature
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import LARGEST_LSB_PER_G, Device, Problem
from accelcal_cli.formats.gt3x import INFO, LOG, sensors
from accelcal_cli.formats.gt3x import records as log
from accelcal_cli.formats.gt3x.archive import Archive, MemberStream, small_part
from accelcal_cli.formats.gt3x.factory import temperatures
from accelcal_cli.formats.gt3x.records import Batch, Key, Span
from accelcal_cli.formats.gt3x.sensors import Imu, Primary, Schema, Sensor

TICKS_PER_US = 10
YEAR_1_TO_1970_US = 62_135_596_800 * 1_000_000
LATEST_US = (1 << 32) * 1_000_000
HIGHEST_RATE_HZ = 1000

ZONE = re.compile(r"([+-])?(\d\d):([0-5]\d):\d\d")
DAY_S = 86_400
LONGEST_S = 366 * DAY_S
NO_INFO = "info.txt is missing from the zip file"
BAD_INFO = "info.txt in the zip file is damaged and was not used"

LARGEST_G = 10_000.0
LEAST_SCALE = 10.0
"""Recordings whose info.txt says "Acceleration Scale: 1" hold counts of a scale that is given elsewhere."""

LISTENED = 16
"""Pieces of log.bin in which a first temperature is looked for: hours of samples."""

IMU_ZERO_C = 21.0
WARMEST_C = 1000.0
IMU_FULL_SCALE = 32_768
COPY_AGAIN = "copy it again from the device"
NO_IMU = "no second sensor (IMU) recorded in it"
TURNED = "firmware 1.6.0 of this device exchanged two axes; this was undone (x = y, y = -x of the file)"
HAS_IMU = "the second sensor (IMU) recorded too: --sensor imu reads it, with gyroscope and temperature"


@dataclass(frozen=True, slots=True)
class Info:
    """What info.txt says; None if it does not.

    Attributes:
        start_us, last_us: first and last sample, or planned start and stop, local time.
        scale: counts in one g.
        zone: offset of the local time from UTC, such as -05:00.
    """

    device: Device = field(default_factory=Device)
    rate_hz: int | None = None
    start_us: int | None = None
    last_us: int | None = None
    scale: float | None = None
    range_g: float | None = None
    zone: str | None = None


def parse_info(data: bytes) -> Info:
    """Read the bytes of info.txt; unusable values are taken for missing."""
    text = data.decode("utf-8-sig", "replace")
    pairs = [line.partition(":") for line in text.splitlines()]
    values = {key.strip(): value.strip() for key, _, value in pairs if value.strip()}
    low, high = _number(values.get("Acceleration Min")), _number(values.get("Acceleration Max"))
    rate = _number(values.get("Sample Rate"))
    return Info(
        Device(values.get("Device Type"), values.get("Serial Number"), values.get("Firmware")),
        int(rate) if rate and rate == int(rate) and 0 < rate <= HIGHEST_RATE_HZ else None,
        _time_us(values.get("Start Date")),
        _time_us(values.get("Last Sample Time")) or _time_us(values.get("Stop Date")),
        _positive(_number(values.get("Acceleration Scale")), LARGEST_LSB_PER_G),
        None if low is None or high is None else _positive(min(-low, high), LARGEST_G),
        _zone(values.get("TimeZone")),
    )


def _number(text: str | None) -> float | None:
    """A number, with a decimal comma in some countries."""
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        return None
    return value if isfinite(value) else None


def _positive(value: float | None, most: float) -> float | None:
    return value if value is not None and 0 < value <= most else None


def _time_us(text: str | None) -> int | None:
    """Microseconds since 1970 of ticks; None if it is no time of our days."""
    if text is None or not text.isascii() or not text.isdigit():
        return None
    time_us = int(text[:30]) // TICKS_PER_US - YEAR_1_TO_1970_US
    return time_us if 0 < time_us < LATEST_US else None


def _zone(text: str | None) -> str | None:
    """-05:00:00 as -05:00, 02:00:00 as +02:00, 00:00:00 as UTC; None if it is no zone."""
    match = ZONE.fullmatch(text or "")
    if match is None or int(match[2]) > WIDEST_OFFSET_H:
        return None
    return f"{match[1] or '+'}{match[2]}:{match[3]}" if match[2] + match[3] != "0000" else "UTC"


def read_info(archive: Archive) -> tuple[Info, tuple[Problem, ...]]:
    """info.txt, and what is wrong with it; a damaged one is not used at all."""
    if INFO not in archive.members:
        return Info(), (Problem("damaged_header", NO_INFO, None, 0),)
    data = small_part(archive, INFO)
    return (
        (Info(), (Problem("damaged_header", BAD_INFO, None, 0),)) if data is None else (parse_info(data), ())
    )


@dataclass(slots=True)
class Beginning:
    """What the first records of log.bin say, up to the first samples.

    Attributes:
        rate: samples that most records of the first piece with any hold; None without any.
        first_s: second of the first samples.
        imu: the device's second sensor recorded too.
        thermometer: what its readings mean, None if they are not wanted; first_mc: the first one.
    """

    parameters: dict[Key, int] = field(default_factory=dict)
    utc: bool = False
    schema: Schema | None = None
    rate: int | None = None
    first_s: int | None = None
    imu: bool = False
    thermometer: FactoryTemperature | None = None
    first_mc: int | None = None

    def take(self, batch: Batch) -> None:
        """Look at the next records."""
        self.parameters = log.parameters_in(batch) | self.parameters
        self.utc |= log.in_utc(batch)
        self.imu |= bool((batch.records.kind == log.SENSOR_DATA).any())
        if self.schema is None:
            schemas = [sensors.parse_schema(data) for data in log.payloads(batch, log.SENSOR_SCHEMA)]
            usable = [schema for schema in schemas if schema and schema.axes(sensors.ACCELEROMETER)]
            self.schema = usable[0] if usable else None
        self._take_samples(batch)
        if self.thermometer is not None and self.first_mc is None:
            found, _ = temperatures(batch, self.thermometer)
            self.first_mc = int(found[0]) if len(found) else None

    def _take_samples(self, batch: Batch) -> None:
        records = batch.records
        holds = np.isin(records.kind, sensors.KINDS) & (records.size > sensors.DOCKED_BYTES)
        with_samples = records.select(holds)
        rows = sensors.samples_in(with_samples)
        if self.rate is None and rows.any():
            self.rate = Counter(rows[rows > 0].tolist()).most_common(1)[0][0]
            self.first_s = int(with_samples.second[rows > 0][0])


def look_inside(archive: Archive, *, imu: bool, thermometer: FactoryTemperature | None = None) -> Beginning:
    """Read log.bin until there are samples, of the second sensor with its schema if that is requested.

    A temperature, where one is wanted, is waited for a while longer.

    Raises:
        UnreadableError: the disk fails, or log.bin is packed in an unusual way.
    """
    beginning = Beginning(thermometer=thermometer)
    with (
        MemberStream(archive, archive.members[LOG]) as stream,
        closing(log.batches(stream, log.ANY_TIME)) as batches,
    ):
        for number, batch in enumerate(batches):
            beginning.take(batch)
            waiting = thermometer is not None and beginning.first_mc is None and number < LISTENED
            if (beginning.imu and beginning.schema if imu else beginning.rate) and not waiting:
                break
    return beginning


def span_of(info: Info, beginning: Beginning) -> Span:
    """Between which times records are expected."""
    start_us = info.start_us
    start_s = beginning.parameters.get(log.START_TIME) if start_us is None else start_us // 1_000_000
    first_s = beginning.first_s if start_s is None else start_s
    return log.ANY_TIME if first_s is None else Span(first_s - DAY_S, first_s + LONGEST_S)


@dataclass(frozen=True, slots=True)
class Scale:
    """Counts in one g, and the range in g, None if unknown."""

    lsb_per_g: float
    range_g: float | None

    @property
    def limit(self) -> int | None:
        """The range in counts."""
        return None if self.range_g is None else int(self.range_g * self.lsb_per_g)


SIX_G, EIGHT_G = Scale(341.0, 6.0), Scale(256.0, 8.0)
"""Of the models (LogRecords/Activity.md; info.txt of a device of each)."""

BY_SERIAL = {"NEO": SIX_G, "CLE": SIX_G, "MRA": SIX_G, "MOS": EIGHT_G, "TAS": EIGHT_G}


@dataclass(frozen=True, slots=True)
class SensorDescription:
    """A sensor of the device, and what a recording states of it.

    Attributes:
        gyro_dps_per_lsb: degrees per second in one count of each axis, None without a gyroscope.
    """

    sensor: Sensor
    scale: Scale
    notes: tuple[str, ...] = ()
    has_temperature: bool = False
    gyro_dps_per_lsb: tuple[float, float, float] | None = None


def primary_of(
    info: Info, beginning: Beginning, bare: FactoryAcceleration | None, options: ReadOptions, path: Path
) -> SensorDescription:
    """The main accelerometer.

    Args:
        bare: what its counts still need, None where they are calibrated.

    Raises:
        UnreadableError: it recorded nothing, or nothing says its scale.
    """
    if beginning.rate is None:
        hint = "--sensor imu reads the second sensor" if beginning.imu else COPY_AGAIN
        raise UnreadableError("holds no acceleration in log.bin", path=path, hint=hint)
    parameter = log.number_of(beginning.parameters, log.ACCEL_SCALE)
    scale = scale_of(info, parameter, bare, options, path)
    turned = (info.device.serial or "").startswith("MOS") and info.device.firmware == "1.6.0"
    notes = [TURNED] if turned else []
    notes += [HAS_IMU] if beginning.imu or beginning.parameters.get(log.SENSOR_CONFIGURATION) else []
    named = info.rate_hz or beginning.parameters.get(log.SAMPLE_RATE)
    if named not in (None, beginning.rate):
        notes.append(f"the header says {named} Hz, the records hold {beginning.rate} samples a second")
    return SensorDescription(Primary(beginning.rate, turned), scale, tuple(notes))


def scale_of(
    info: Info, parameter: float | None, bare: FactoryAcceleration | None, options: ReadOptions, path: Path
) -> Scale:
    """The main accelerometer's scale; of a bare sensor about what its counts are.

    Raises:
        UnreadableError: nothing says it.
    """
    stated = (_positive(value, LARGEST_LSB_PER_G) for value in (info.scale, parameter))
    scales = [value for value in stated if value is not None and value >= LEAST_SCALE]
    model = BY_SERIAL.get((info.device.serial or "")[:3]) if info.scale is None else None
    lsb_per_g = scales[0] if scales else model.lsb_per_g if model else options.lsb_per_g
    if bare is not None:
        return Scale(lsb_per_g or 1 / bare.g_per_count[0][0], info.range_g)
    if lsb_per_g is None:
        raise UnreadableError(
            "does not say how many counts are one g", path=path, hint="give --lsb-per-g, such as 256 or 341"
        )
    usual = {scale.lsb_per_g: scale.range_g for scale in (SIX_G, EIGHT_G)}
    return Scale(options.lsb_per_g or lsb_per_g, info.range_g or usual.get(lsb_per_g))


def imu_of(beginning: Beginning, options: ReadOptions, path: Path) -> SensorDescription:
    """The second sensor of a device that has one; its 16 bits are its range.

    Raises:
        UsageError: it recorded nothing.
    """
    if beginning.schema is None or not beginning.imu:
        raise UsageError(NO_IMU, path=path, hint="omit --sensor")
    offset_c = log.number_of(beginning.parameters, log.IMU_TEMPERATURE_OFFSET)
    zero_c = offset_c if offset_c is not None and abs(offset_c) <= WARMEST_C else IMU_ZERO_C
    schema = beginning.schema
    per_g = schema.axes(sensors.ACCELEROMETER)[0].scale
    turns = [1 / column.scale for column in schema.axes(sensors.GYROSCOPE)]
    return SensorDescription(
        Imu(schema, zero_c),
        Scale(options.lsb_per_g or per_g, IMU_FULL_SCALE / per_g),
        has_temperature=sensors.TEMPERATURE in schema.columns,
        gyro_dps_per_lsb=(turns[0], turns[1], turns[2]) if turns else None,
    )


def activity_bin_scale(info: Info) -> Scale:
    """Of the older kind; all devices of it are of one model."""
    if info.scale is None or info.scale < LEAST_SCALE:
        return SIX_G
    return Scale(info.scale, info.range_g)
