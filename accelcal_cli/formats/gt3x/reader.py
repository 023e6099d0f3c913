"""An open .gt3x file of either kind: what is known of the recording, and its rows.

log.bin is read here as a stream of chunks; activity.bin, of the older kind, in a file of its own.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Chunk, Problem, Reader, Recording
from accelcal_cli.formats._problems import ProblemLog
from accelcal_cli.formats.gt3x import ACTIVITY, LOG, header
from accelcal_cli.formats.gt3x.archive import Archive, Member, MemberStream, open_archive
from accelcal_cli.formats.gt3x.factory import OLDER_KIND, Applied, Beside, acceleration_of, temperature_of
from accelcal_cli.formats.gt3x.header import COPY_AGAIN, Info
from accelcal_cli.formats.gt3x.records import Span, batches
from accelcal_cli.formats.gt3x.sensors import Samples, Sensor
from accelcal_cli.formats.gt3x.timeline import (
    ChunkPlace,
    RowSpan,
    Timeline,
    chunk_of,
    cut,
    fault_problem,
    groups,
)

if TYPE_CHECKING:
    from accelcal_cli.formats.gt3x.activity import ActivityFile

IMU = "imu"
SENSORS = ("accelerometer", IMU)
START_SAMPLES = 1
UNPACK = "unpack the .gz; a .gt3x is a zip file already"
NO_START = "info.txt does not tell when the recording began: times count from its start"

MOST_ROWS = 1 << 20
NOTHING = Applied()


class Gt3xReader(Reader):
    """Streams a recording; each call of `chunks` reads the zip file from its beginning."""

    def __init__(self, recording: Recording, file: LogFile | ActivityFile) -> None:
        self.recording = recording
        self._file = file

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order."""
        return self._file.stream(chunk_samples, self.threads)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording.

    Raises:
        UnreadableError: it is not of this format, or holds no samples.
        UsageError: the rates contradict each other, or there is no such sensor.
    """
    if options.sensor not in (None, *SENSORS):
        hint = f"use one of {', '.join(SENSORS)}"
        raise UsageError(f"no sensor {options.sensor!r} in it", path=path, hint=hint)
    if probe_file(path, options).compressed:
        raise UnreadableError("is compressed twice", path=path, hint=UNPACK)
    archive = open_archive(path)
    info, problems = header.read_info(archive)
    if LOG in archive.members:
        return open_log(archive, info, options, archive.problems + problems)
    if ACTIVITY in archive.members:
        return open_activity_bin(archive, info, options, archive.problems + problems)
    raise UnreadableError("holds neither log.bin nor activity.bin", path=path, byte_offset=0, hint=COPY_AGAIN)


def open_log(archive: Archive, info: Info, options: ReadOptions, problems: tuple[Problem, ...]) -> Reader:
    """Open the newer kind.

    Raises:
        UnreadableError: it holds no samples, or nothing says their scale.
        UsageError: the rates contradict each other, or the requested sensor did not record.
    """
    imu = options.sensor == IMU
    beside = Beside() if imu else Beside.of(archive)
    line = temperature_of(beside.temperature)
    beginning = header.look_inside(archive, imu=imu, thermometer=line)
    bare = None
    if imu:
        description = header.imu_of(beginning, options, archive.path)
    else:
        if options.lsb_per_g is None and beginning.rate is not None:
            bare = acceleration_of(beside.acceleration, info.rate_hz or beginning.rate, archive.path)
        description = header.primary_of(info, beginning, bare, options, archive.path)
    applied = Applied(bare, description.scale.limit, line, beginning.first_mc)
    member, span = archive.members[LOG], header.span_of(info, beginning)
    file = LogFile(archive, member, description.sensor, span, problems + beside.problems, applied)
    start_us = first_time(file)
    recording = Recording(
        path=archive.path,
        format="gt3x",
        rate_hz=agreed_rate(options, float(description.sensor.rate), archive.path),
        lsb_per_g=description.scale.lsb_per_g if bare is None else FLOAT_LSB_PER_G,
        total_bytes=archive.size,
        device=info.device,
        range_g=description.scale.range_g,
        start_us=start_us,
        timezone="UTC" if beginning.utc else info.zone,
        duration_s=lasted_s(info, start_us),
        has_temperature=description.has_temperature or beginning.first_mc is not None,
        gyro_dps_per_lsb=description.gyro_dps_per_lsb,
        factory=applied.factory,
        notes=description.notes + beside.notes(applied),
    )
    return Gt3xReader(recording, file)


def open_activity_bin(
    archive: Archive, info: Info, options: ReadOptions, problems: tuple[Problem, ...]
) -> Reader:
    """Open the older kind.

    Raises:
        UnreadableError: it holds no sample, or nothing says the rate.
        UsageError: the rates contradict each other, or the requested sensor is not in such devices.
    """
    from accelcal_cli.formats.gt3x.activity import ActivityFile, has_samples  # few files are of this kind

    if options.sensor == IMU:
        raise UsageError(header.NO_IMU, path=archive.path, hint="omit --sensor")
    rate = activity_bin_rate(info, options, archive.path)
    if info.start_us is None:
        problems += (Problem("no_start_time", NO_START, None, 0),)
    file = ActivityFile(archive, archive.members[ACTIVITY], rate, info.start_us or 0, problems)
    if not has_samples(file):
        raise UnreadableError("holds no acceleration in activity.bin", path=archive.path, hint=COPY_AGAIN)
    scale = header.activity_bin_scale(info)
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
        notes=(OLDER_KIND,) if Beside.of(archive).acceleration.is_open else (),
    )
    return Gt3xReader(recording, file)


def activity_bin_rate(info: Info, options: ReadOptions, path: Path) -> int:
    """Samples in a second of the older kind, which only info.txt states."""
    rate = info.rate_hz or options.rate_hz
    if rate is None or rate != int(rate):
        raise UnreadableError(
            "does not say its rate: info.txt is missing or damaged", path=path, hint="give --rate, such as 30"
        )
    return int(rate)


def first_time(file: LogFile) -> int:
    """Time of the first sample [us], as `chunks` gives it.

    Raises:
        UnreadableError: there is no sample.
    """
    with closing(file.stream(START_SAMPLES)) as chunks:
        for chunk in chunks:
            if len(chunk):
                return int(chunk.clock.times(0, 1)[0])
    raise UnreadableError("holds no acceleration in log.bin", path=file.archive.path, hint=COPY_AGAIN)


def lasted_s(info: Info, start_us: int) -> float | None:
    """Length by the time of the last sample in info.txt, None if it makes no sense."""
    if info.last_us is None or info.last_us <= start_us:
        return None
    return (info.last_us - start_us) / MICROSECONDS


@dataclass(frozen=True, slots=True)
class LogFile:
    """A log.bin whose settings are known.

    Attributes:
        problems: what was found before any sample.
        applied: the maker's calibration.
    """

    archive: Archive
    member: Member
    sensor: Sensor
    span: Span
    problems: tuple[Problem, ...] = ()
    applied: Applied = NOTHING

    def stream(self, chunk_samples: int, threads: int = 1) -> Generator[Chunk, None, None]:
        """All chunks, of at least a second.

        Args:
            threads: how many may work at a time.

        Raises:
            UnreadableError: the disk fails.
        """
        most = max(chunk_samples, self.sensor.rate)
        timeline = Timeline(self.sensor, self.span, self.applied.thermometer())
        log = ProblemLog(self.problems)
        rows = 0
        with (
            MemberStream(self.archive, self.member) as source,
            closing(batches(source, self.span, threads)) as parts,
        ):
            for batch in parts:
                spans, samples, events = timeline.feed(batch)
                for event in events:
                    log.add(event)
                problems = log.take(None if batch.page.last else timeline.position)
                if batch.page.last and (fault := fault_problem(source, timeline.rows)) is not None:
                    problems += (fault,)
                place = ChunkPlace(rows, batch.page.end_byte, batch.records.framed_bytes())
                for chunk in chunks_of(spans, samples, place, problems):
                    rows += len(chunk)
                    yield from cut(self.applied.to(chunk), most)


def chunks_of(
    spans: list[RowSpan], samples: Samples, place: ChunkPlace, problems: tuple[Problem, ...]
) -> Iterator[Chunk]:
    """Chunks of a batch's spans; problems and bytes go with the first, which may be empty."""
    parts = list(groups(spans, MOST_ROWS)) or ([[]] if problems or place.used_bytes else [])
    rows, used = place.first_sample, place.used_bytes
    for part in parts:
        chunk = chunk_of(part, samples, ChunkPlace(rows, place.end_byte, used), problems)
        problems, used, rows = (), 0, rows + len(chunk)
        yield chunk
