"""Opens .gt3x files of either kind: describes the recording, and streams its rows.

info.txt is written by the device's software, one "key: value" a line. Scale, range and rate of a sensor come
from info.txt, else from the parameters in log.bin, else from the model. Source: info.txt.md of
github.com/actigraph/GT3X-File-Format and NHANES-GT3X-File-Format. Times are .NET ticks, 100 ns since the
year 1, on the device's clock.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import COPY_AGAIN, UnreadableError, UsageError, listed, printable
from accelcal_cli.core.formats import ReadOptions, agreed_rate, as_utf8
from accelcal_cli.core.recording import (
    FLOAT_LSB_PER_G,
    LARGEST_LSB_PER_G,
    Chunk,
    Device,
    FactoryAcceleration,
    FactoryTemperature,
    Problem,
    Reader,
    Recording,
    first_row,
)
from accelcal_cli.core.written_times import header_zone
from accelcal_cli.formats._bytes import refuse_packed
from accelcal_cli.formats._problems import ProblemLog
from accelcal_cli.formats.gt3x import records as log
from accelcal_cli.formats.gt3x import sensors, unzipped
from accelcal_cli.formats.gt3x.archive import (
    ABOUT,
    ACTIVITY,
    INFO,
    LOG,
    Archive,
    Member,
    MemberStream,
    open_archive,
    small_part,
)
from accelcal_cli.formats.gt3x.records import Key, RecordBatch, Span, batches
from accelcal_cli.formats.gt3x.sensors import (
    OLDER_KIND,
    ActivityFile,
    AppliedCalibration,
    CalibrationFiles,
    Imu,
    Primary,
    Reading,
    Schema,
    Sensor,
    acceleration_of,
    calibrated_counts,
    has_samples,
    is_open,
    temperature_of,
    temperatures,
)
from accelcal_cli.formats.gt3x.timeline import PlacedReadings, Timeline, chunk_of, cut, groups

ZEROS = np.zeros((1, 3), np.int16)
IMU = "imu"
SENSORS = ("accelerometer", IMU)
TICKS_PER_US, HIGHEST_RATE_HZ, START_SAMPLES = 10, 1000, 1
NO_START = "info.txt does not tell when the recording began: times count from its start"

MOST_ROWS = 1 << 20
NOTHING = AppliedCalibration()
YEAR_1_TO_1970_US = 62_135_596_800 * 1_000_000
LATEST_US = (1 << 32) * 1_000_000
CENTREPOINT = "times are UTC, as CentrePoint writes them; the wearer's zone is {0}: -R worn_zone={0} shows it"
DAY_S = 86_400
LONGEST_S = 366 * DAY_S
NO_INFO = "info.txt is missing from the zip file"
BAD_INFO = "info.txt in the zip file is damaged and was not used"

LARGEST_G = 10_000.0
LEAST_SCALE, PIECES_FOR_TEMPERATURE = 10.0, 16
"""Smallest scale that is believed (info.txt may say 1); pieces of log.bin with a first temperature."""

IMU_ZERO_C, WARMEST_C, IMU_FULL_SCALE = 21.0, 1000.0, 32_768
NO_IMU = "no second sensor (IMU) recorded in it"
TURNED = "firmware 1.6.0 of this device exchanged two axes; this was undone (x = y, y = -x of the file)"
HAS_IMU = "the second sensor (IMU) recorded too: --sensor imu reads it, with gyroscope and temperature"


@dataclass(frozen=True, slots=True)
class Info:
    """The content of info.txt; None for what it lacks.

    Attributes:
        start_us, last_us: first and last sample, or planned start and stop, local time.
        scale: counts in one g.
        zone: offset of the local time from UTC, such as -05:00.
        notes: that a zone is there and is not understood.
    """

    device: Device = field(default_factory=Device)
    rate_hz: int | None = None
    start_us: int | None = None
    last_us: int | None = None
    scale: float | None = None
    range_g: float | None = None
    zone: str | None = None
    notes: tuple[str, ...] = ()


def parse_info(data: bytes) -> Info:
    """Parse the bytes of info.txt; unusable values count as missing."""
    text = as_utf8(data).decode("utf-8-sig", "replace").removeprefix("\ufeff")
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
        *header_zone(values.get("TimeZone", "")),
    )


def _number(text: str | None) -> float | None:
    """Return a number, which some countries write with a decimal comma."""
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        return None
    return value if isfinite(value) else None


def _positive(value: float | None, most: float) -> float | None:
    return value if value is not None and 0 < value <= most else None


def _time_us(text: str | None) -> int | None:
    """Return ticks as microseconds since 1970; None for a time that is not of our days."""
    if text is None or not text.isascii() or not text.isdigit():
        return None
    time_us = int(text[:30]) // TICKS_PER_US - YEAR_1_TO_1970_US
    return time_us if 0 < time_us < LATEST_US else None


@dataclass(slots=True)
class LogBeginning:
    """The content of the first records of log.bin, up to the first samples.

    Attributes:
        rate: samples that most records of the first piece with any hold; None without any.
        first_s: second of the first samples.
        kinds: of its records.
        imu: the device's second sensor recorded too.
        thermometer: the meaning of its readings, None if they are not wanted; first_mc: the first one.
    """

    parameters: dict[Key, int] = field(default_factory=dict)
    utc: bool = False
    schema: Schema | None = None
    rate: int | None = None
    first_s: int | None = None
    kinds: set[int] = field(default_factory=set)
    imu: bool = False
    thermometer: FactoryTemperature | None = None
    first_mc: int | None = None

    def take(self, batch: RecordBatch) -> None:
        """Take in the next records."""
        self.parameters = log.parameters_in(batch) | self.parameters
        self.utc |= log.in_utc(batch)
        self.kinds |= set(batch.records.kind.tolist())
        self.imu = log.SENSOR_DATA in self.kinds
        if self.schema is None:
            schemas = [sensors.parse_schema(data) for data in log.payloads(batch, log.SENSOR_SCHEMA)]
            usable = [schema for schema in schemas if schema and schema.axes(sensors.ACCELEROMETER)]
            self.schema = usable[0] if usable else None
        if self.thermometer is not None and self.first_mc is None:
            found, _ = temperatures(batch, self.thermometer)
            self.first_mc = int(found[0]) if len(found) else None
        holds = np.isin(batch.records.kind, sensors.KINDS) & (batch.records.size > sensors.DOCKED_BYTES)
        with_samples = batch.records.select(holds)
        rows = sensors.samples_in(with_samples)
        if self.rate is None and rows.any():
            self.rate = Counter(rows[rows > 0].tolist()).most_common(1)[0][0]
            self.first_s = int(with_samples.second[rows > 0][0])


def look_inside(
    archive: Archive, *, imu: bool, thermometer: FactoryTemperature | None = None
) -> LogBeginning:
    """Read log.bin up to the first samples, of the second sensor with its schema if that is requested.

    If a temperature is wanted, a while longer is read for it. Raises UnreadableError if the disk fails, or
    log.bin is packed in an unusual way.
    """
    beginning = LogBeginning(thermometer=thermometer)
    with (
        MemberStream(archive, archive.members[LOG]) as stream,
        closing(log.batches(stream, log.ANY_TIME)) as batches,
    ):
        for number, batch in enumerate(batches):
            beginning.take(batch)
            waiting = beginning.thermometer and beginning.first_mc is None and number < PIECES_FOR_TEMPERATURE
            if (beginning.imu and beginning.schema if imu else beginning.rate) and not waiting:
                break
    return beginning


def span_of(info: Info, beginning: LogBeginning) -> Span:
    """Return the times between which records are expected."""
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
"""Scales of the models (LogRecords/Activity.md; info.txt of a device of each)."""

BY_SERIAL = {"NEO": SIX_G, "CLE": SIX_G, "MRA": SIX_G, "MOS": EIGHT_G, "TAS": EIGHT_G}


@dataclass(frozen=True, slots=True)
class SensorDescription:
    """A sensor of the device, as a recording describes it."""

    sensor: Sensor
    scale: Scale
    notes: tuple[str, ...] = ()
    has_temperature: bool = False
    gyro_dps_per_lsb: tuple[float, float, float] | None = None


def primary_of(
    info: Info,
    beginning: LogBeginning,
    uncalibrated: FactoryAcceleration | None,
    options: ReadOptions,
    path: Path,
) -> SensorDescription:
    """Return the main accelerometer; `uncalibrated` is the calibration that its counts still need."""
    if beginning.rate is None:
        hint = "--sensor imu reads the second sensor" if beginning.imu else COPY_AGAIN
        raise UnreadableError("holds no acceleration in log.bin", path=path, hint=hint)
    parameter = log.number_of(beginning.parameters, log.ACCEL_SCALE)
    scale = scale_of(info, parameter, uncalibrated, options, path)
    turned = (info.device.serial or "").startswith("MOS") and info.device.firmware == "1.6.0"
    notes = [TURNED] if turned else []
    notes += [HAS_IMU] if beginning.imu or beginning.parameters.get(log.SENSOR_CONFIGURATION) else []
    stated_hz = info.rate_hz or beginning.parameters.get(log.SAMPLE_RATE)
    if stated_hz not in (None, beginning.rate):
        notes.append(f"the header says {stated_hz} Hz, the records hold {beginning.rate} samples a second")
    return SensorDescription(Primary(beginning.rate, turned), scale, tuple(notes))


def scale_of(
    info: Info,
    parameter: float | None,
    uncalibrated: FactoryAcceleration | None,
    options: ReadOptions,
    path: Path,
) -> Scale:
    """Return the main accelerometer's scale, which has to be known; an approximate one if uncalibrated."""
    stated = (_positive(value, LARGEST_LSB_PER_G) for value in (info.scale, parameter))
    scales = [value for value in stated if value is not None and value >= LEAST_SCALE]
    model = BY_SERIAL.get((info.device.serial or "")[:3]) if info.scale is None else None
    lsb_per_g = scales[0] if scales else model.lsb_per_g if model else options.lsb_per_g
    if uncalibrated is not None:
        return Scale(lsb_per_g or 1 / uncalibrated.g_per_count[0][0], info.range_g)
    if lsb_per_g is None:
        hint = "give --lsb-per-g, such as 256 or 341"
        raise UnreadableError("does not say how many counts are one g", path=path, hint=hint)
    usual = {scale.lsb_per_g: scale.range_g for scale in (SIX_G, EIGHT_G)}
    return Scale(options.lsb_per_g or lsb_per_g, info.range_g or usual.get(lsb_per_g))


def imu_of(beginning: LogBeginning, options: ReadOptions, path: Path) -> SensorDescription:
    """Return the second sensor, whose 16 bits are its range; raises UsageError if it recorded nothing."""
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


class Gt3xReader(Reader):
    """Streams a recording; each call of `chunks` reads the zip file from its beginning."""

    def __init__(self, recording: Recording, file: LogFile | ActivityFile) -> None:
        self.recording, self._file = recording, file

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order."""
        file = self._file
        if isinstance(file, LogFile) and not self.with_others:
            file = replace(file, readings=())
        return file.stream(chunk_samples, self.threads)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording; `Format.open` says what is raised."""
    if options.sensor not in (None, *SENSORS):
        hint = f"use one of {', '.join(SENSORS)}"
        raise UsageError(f"no sensor {options.sensor!r} in it", path=path, hint=hint)
    if parts := unzipped(path):
        names, zipped = listed([part.name for part in parts]), f"{path.absolute().parent.name}.gt3x"
        command = shlex.join(["zip", "-j", printable(zipped), *(printable(part) for part in parts)])
        what = f"is a part of an unzipped .gt3x ({names})"
        raise UnreadableError(what, path=path, hint=f"zip the parts and give that: {command}")
    refuse_packed(path, "a .gt3x file, itself a zip file,")
    archive = open_archive(path)
    info, problems = Info(), archive.problems
    if INFO not in archive.members:
        problems += (Problem("damaged_header", NO_INFO, None, 0),)
    elif (data := small_part(archive, INFO)) is None:
        problems += (Problem("damaged_header", BAD_INFO, None, 0),)
    else:
        info = parse_info(data)
    if LOG in archive.members:
        return open_log(archive, info, options, problems)
    if ACTIVITY in archive.members:
        return open_activity_bin(archive, info, options, problems)
    raise UnreadableError("holds neither log.bin nor activity.bin", path=path, byte_offset=0, hint=COPY_AGAIN)


def open_log(archive: Archive, info: Info, options: ReadOptions, problems: tuple[Problem, ...]) -> Reader:
    """Open a file of the newer kind; raises what `open_recording` raises."""
    imu = options.sensor == IMU
    calibration_files = CalibrationFiles() if imu else CalibrationFiles.of(archive)
    line = temperature_of(calibration_files.temperature)
    beginning = look_inside(archive, imu=imu, thermometer=line)
    uncalibrated = None
    if imu:
        description = imu_of(beginning, options, archive.path)
    else:
        if options.lsb_per_g is None and beginning.rate is not None:
            rate = info.rate_hz or beginning.rate
            uncalibrated = acceleration_of(calibration_files.acceleration, rate, archive.path)
        description = primary_of(info, beginning, uncalibrated, options, archive.path)
    applied = AppliedCalibration(uncalibrated, description.scale.limit, line, beginning.first_mc)
    member, span = archive.members[LOG], span_of(info, beginning)
    problems += calibration_files.problems
    readings = tuple(one for one in sensors.READINGS if one.kind in beginning.kinds)
    file = LogFile(archive, member, description.sensor, span, problems, applied, readings)
    start_us = first_time(file)
    centrepoint = ABOUT in archive.members or archive.path.name.lower().removesuffix(".zip").endswith(".agdc")
    notes = [CENTREPOINT.format(info.zone)] if centrepoint and info.zone else []
    recording = Recording(
        path=archive.path,
        format="gt3x",
        rate_hz=agreed_rate(options, float(description.sensor.rate), archive.path),
        lsb_per_g=description.scale.lsb_per_g if uncalibrated is None else FLOAT_LSB_PER_G,
        total_bytes=archive.size,
        device=info.device,
        range_g=description.scale.range_g,
        start_us=start_us,
        timezone="UTC" if beginning.utc or centrepoint else info.zone,
        duration_s=lasted_s(info, start_us),
        has_temperature=description.has_temperature or beginning.first_mc is not None,
        gyro_dps_per_lsb=description.gyro_dps_per_lsb,
        others=tuple(one.column for one in readings),
        factory=applied.factory,
        zero_counts=first_row(ZEROS if uncalibrated is None else calibrated_counts(ZEROS, uncalibrated)),
        notes=(*description.notes, *calibration_files.notes(applied), *info.notes, *notes),
    )
    return Gt3xReader(recording, file)


def open_activity_bin(
    archive: Archive, info: Info, options: ReadOptions, problems: tuple[Problem, ...]
) -> Reader:
    """Open a file of the older kind, whose devices are of one model; raises what `open_recording` raises."""
    if options.sensor == IMU:
        raise UsageError(NO_IMU, path=archive.path, hint="omit --sensor")
    stated = info.rate_hz or options.rate_hz
    if stated is None or stated != int(stated):
        what = "does not say its rate: info.txt is missing or damaged"
        raise UnreadableError(what, path=archive.path, hint="give --rate, such as 30")
    rate = int(stated)
    if info.start_us is None:
        problems += (Problem("no_start_time", NO_START, None, 0),)
    file = ActivityFile(archive, archive.members[ACTIVITY], rate, info.start_us or 0, problems)
    if not has_samples(file):
        raise UnreadableError("holds no acceleration in activity.bin", path=archive.path, hint=COPY_AGAIN)
    scale = SIX_G if (info.scale or 0.0) < LEAST_SCALE else Scale(info.scale or 0.0, info.range_g)
    recording = Recording(
        path=archive.path,
        format="gt3x",
        rate_hz=agreed_rate(options, float(rate), archive.path),
        lsb_per_g=options.lsb_per_g or scale.lsb_per_g,
        total_bytes=archive.size,
        device=info.device,
        range_g=scale.range_g,
        start_us=info.start_us,
        timezone=info.zone,
        samples=file.samples,
        duration_s=None if file.samples is None else file.samples / rate,
        notes=(*((OLDER_KIND,) if is_open(CalibrationFiles.of(archive).acceleration) else ()), *info.notes),
    )
    return Gt3xReader(recording, file)


def lasted_s(info: Info, start_us: int) -> float | None:
    """Return the length by the time of the last sample in info.txt; None if it makes no sense."""
    last_us = info.last_us or 0
    return (last_us - start_us) / MICROSECONDS if last_us > start_us else None


def first_time(file: LogFile) -> int:
    """Return the time of the first sample [us], as `chunks` gives it; raises UnreadableError without one."""
    with closing(file.stream(START_SAMPLES)) as chunks:
        for chunk in chunks:
            if len(chunk):
                return int(chunk.clock.times(0, 1)[0])
    raise UnreadableError("holds no acceleration in log.bin", path=file.archive.path, hint=COPY_AGAIN)


@dataclass(frozen=True, slots=True)
class LogFile:
    """A log.bin whose settings are known, with problems found before any sample.

    Attributes:
        readings: what other sensors record, by the kinds of its first records.
    """

    archive: Archive
    member: Member
    sensor: Sensor
    span: Span
    problems: tuple[Problem, ...] = ()
    applied: AppliedCalibration = NOTHING
    readings: tuple[Reading, ...] = ()

    def stream(self, chunk_samples: int, threads: int = 1) -> Generator[Chunk, None, None]:
        """Yield all chunks, of at least a second."""
        most = max(chunk_samples, self.sensor.rate)
        timeline = Timeline(self.sensor, self.span, self.applied.thermometer())
        found, rows = ProblemLog(self.problems), 0
        others = PlacedReadings(self.readings) if self.readings else None
        with (
            MemberStream(self.archive, self.member) as source,
            closing(batches(source, self.span, threads)) as parts,
        ):
            for batch in parts:
                spans, samples, events = timeline.feed(batch)
                if others is not None:
                    others.take(batch)
                for event in events:
                    found.add(event)
                problems = found.take(None if batch.page.last else timeline.position)
                if batch.page.last and (fault := source.problem(timeline.rows)) is not None:
                    problems += (fault,)
                used = int(batch.records.size.sum()) + log.FRAME_BYTES * len(batch.records)
                # problems and bytes go with the first chunk, which may be empty
                for part in list(groups(spans, MOST_ROWS)) or ([[]] if problems or used else []):
                    chunk = chunk_of(part, samples, rows, batch.page.end_byte)
                    chunk = replace(chunk, problems=problems, used_bytes=used)
                    chunk = chunk if others is None else replace(chunk, others=others.of(part))
                    problems, used, rows = (), 0, rows + len(chunk)
                    yield from cut(self.applied.apply(chunk), most)
