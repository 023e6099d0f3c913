"""An open .cwa file: what is known of the recording, and its rows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.recording import Chunk, Device, Problem, Reader, Recording
from accelcal_cli.readers._cwa.blocks import sector_blocks
from accelcal_cli.readers._cwa.decode import decode
from accelcal_cli.readers._cwa.header import Header, device_of_sector, parse_header
from accelcal_cli.readers._cwa.links import nominal_us
from accelcal_cli.readers._cwa.sector import as_sectors, plausible, settings_of
from accelcal_cli.readers._cwa.signature import HEADER_BYTES, SECTOR_BYTES
from accelcal_cli.readers._cwa.stamps import anchors
from accelcal_cli.readers._cwa.stream import Scheme
from accelcal_cli.readers._cwa.temperature import NO_SENSOR, TEMPERATURE_MASK, thermometer
from accelcal_cli.readers._pages.blocks import PagedFile, paged_file
from accelcal_cli.readers._stream import ByteSource

SEARCH_SECTORS = 2048
LAST_SECTORS = 64
START_SAMPLES = 8192
COPY_AGAIN = "copy it again from the device"
NO_HEADER = "the header at the start of the file is damaged; settings were taken from the data sectors"
NO_START = "the device's clock was not set: times count from the recording's start"


@dataclass(frozen=True, slots=True)
class Sample:
    """The first believable sector: a scalar of SECTOR and its place."""

    sector: Any
    position: int


class CwaReader(Reader):
    """Streams the sectors; each call of `chunks` reads the file from its beginning."""

    def __init__(self, recording: Recording, scheme: Scheme) -> None:
        self.recording = recording
        self._scheme = scheme

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, whole sectors, at least one."""
        return self._scheme.stream(chunk_samples)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Enter the file at evenly spread sectors; a gzip file gives its first chunks."""
        file = self._scheme.file
        if file.compressed:
            yield from super().preview(chunk_samples, pieces)
            return
        total = max(1, file.data_pages())
        sectors = min(self._scheme.sectors(chunk_samples), max(1, total // max(1, pieces)))
        for piece in range(min(pieces, total)):
            chunks = self._scheme.piece(piece * total // pieces, sectors)
            yield from (chunk for chunk in chunks if len(chunk) or chunk.problems)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording.

    Raises:
        UnreadableError: it is not of this format, or no data sector is intact.
    """
    with ByteSource(path) as stream:
        head = stream.read_exact(HEADER_BYTES)
    header = parse_header(head)
    file = paged_file(path, header.data_start, SECTOR_BYTES)
    first = first_sector(file, header)
    settings = settings_of(first.sector)
    raw_temperature = int(first.sector["temperature"]) & TEMPERATURE_MASK
    problems = [] if header.intact else [Problem("damaged_header", NO_HEADER, 0, 0)]
    clock_set = bool(anchors(np.atleast_1d(first.sector), settings).known[0])
    if not clock_set:
        problems.append(Problem("no_start_time", NO_START, file.offset(first.position), 0))
    sensor = None if raw_temperature in NO_SENSOR else thermometer(header.hardware)
    scheme = Scheme(file, settings, sensor, tuple(problems))
    device = header.device if header.intact else device_of_sector(settings, int(first.sector["fraction"]))
    notes = _notes(scheme, header)
    return CwaReader(describe(scheme, device, options, clock_set, notes), scheme)


def first_sector(file: PagedFile, header: Header) -> Sample:
    """The first sector whose checksum is right; in the oldest files, which have none, that makes sense.

    Raises:
        UnreadableError: there is none in the whole file.
    """
    seen = 0
    with closing(sector_blocks(file, SEARCH_SECTORS)) as blocks:
        for raw in blocks:
            seen += len(raw.pages)
            for candidates in plausible(raw.pages):
                if candidates.any():
                    place = int(np.argmax(candidates))
                    return Sample(as_sectors(raw.pages)[place].copy(), raw.first_position + place)
    what = "holds no intact data sector" if header.intact else "is not an Axivity .cwa recording"
    raise UnreadableError(
        f"{what} ({seen} sectors looked at)", path=file.path, byte_offset=file.start_byte, hint=COPY_AGAIN
    )


def describe(
    scheme: Scheme, device: Device, options: ReadOptions, clock_set: bool, notes: tuple[str, ...]
) -> Recording:
    """What is known of the recording."""
    settings, file = scheme.settings, scheme.file
    start_us = first_time(scheme)
    end_us = last_time(scheme)
    lasted = None if end_us is None or end_us <= start_us else (end_us - start_us) / MICROSECONDS
    gyro = settings.gyro_dps_per_lsb
    return Recording(
        path=file.path,
        format="cwa",
        rate_hz=agreed_rate(options, float(settings.rate), file.path),
        lsb_per_g=options.lsb_per_g or settings.lsb_per_g,
        total_bytes=file.size,
        device=device,
        range_g=settings.range_g,
        start_us=start_us if clock_set else None,
        timezone=options.timezone,
        duration_s=lasted if clock_set else None,
        has_temperature=scheme.thermometer is not None,
        gyro_dps_per_lsb=None if gyro is None else (gyro, gyro, gyro),
        notes=notes,
    )


def first_time(scheme: Scheme) -> int:
    """Time of the first sample [us], as `chunks` gives it."""
    with closing(scheme.stream(START_SAMPLES)) as chunks:
        return int(next(chunk for chunk in chunks if len(chunk)).clock.times(0, 1)[0])


def last_time(scheme: Scheme) -> int | None:
    """When the last sample ended [us], by the last intact sector; None where that is not found."""
    if scheme.file.compressed:
        return None
    first = max(0, scheme.file.data_pages() - LAST_SECTORS)
    with closing(sector_blocks(scheme.file, LAST_SECTORS + 1, first)) as blocks:
        block, _ = decode(next(blocks).pages, first, scheme.settings)
    if not len(block) or not block.anchors.known[-1]:
        return None
    after = block.rows[-1:] - block.anchors.row[-1:]
    return int(block.anchors.time_us[-1] + nominal_us(after, scheme.settings.rate)[0])


def _notes(scheme: Scheme, header: Header) -> tuple[str, ...]:
    rate = scheme.settings.rate
    notes = [] if scheme.thermometer is None else [scheme.thermometer.note]
    if header.rate is not None and header.rate != rate:
        notes.append(f"the header says {float(header.rate):g} Hz, the data sectors {float(rate):g} Hz")
    return tuple(notes)
