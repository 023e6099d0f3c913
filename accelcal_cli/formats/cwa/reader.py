"""Opens a .cwa file: describes the recording, and says how its sectors are read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import COPY_AGAIN, UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.recording import Device, Problem, Reader, Recording, ThermometerWord
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages.files import PagedFile, RawBlock, is_erased
from accelcal_cli.formats._pages.pages import Decoded, PageBlock, bad_runs
from accelcal_cli.formats._pages.reader import PageDecoder, PagedReader, PageEvents, PageScheme
from accelcal_cli.formats._pages.timeline import NO_SPANS, Findings, Placed, Spacing
from accelcal_cli.formats._problems import Event
from accelcal_cli.formats._rows import MISSING, missing_kind
from accelcal_cli.formats.cwa import HEADER_BYTES, SECTOR_BYTES, sector
from accelcal_cli.formats.cwa.sector import SETTINGS, Header, SectorBlock, Settings
from accelcal_cli.formats.cwa.timeline import Linker, SecondsTimeline, Timeline, nominal_us, stamp_unit

LEFT_OUT = {
    sector.EMPTY: ("bad_page", "empty sectors between sectors with data, left out"),
    paged.FOREIGN: ("bad_page", "sectors that are not Axivity data, left out"),
    paged.CHECKSUM: ("checksum", "data sectors with a wrong checksum, left out"),
    paged.NONSENSE: ("bad_page", "data sectors with an impossible number or layout of samples, left out"),
    paged.RATE: ("rate_change", "data sectors recorded at another rate than the first, left out"),
    SETTINGS: ("settings_change", "data sectors with another range, scale or axes than the first, left out"),
}
DAMAGED = (sector.EMPTY, paged.FOREIGN, paged.CHECKSUM, paged.NONSENSE)
"""Kinds whose bytes are lost; sectors recorded with other settings are sound."""

SEARCH_SECTORS, LOOK_SECTORS, LAST_SECTORS = 2048, 256, 64
"""Sectors in which the first intact one, how exact the stamps are, and the last time are looked for."""

NO_HEADER = "the header at the start of the file is damaged; settings were taken from the data sectors"
HALF_HEADER = "the second half of the header is missing; the data sectors in its place are read"
WHOLE_SECONDS = "its stamps are whole seconds: samples are placed on lines through them"
NO_START = "the device's clock was not set: times count from the recording's start"


class SectorEvents(PageEvents):
    """Turns what is found in sectors into events."""

    kinds, damaged, unit = LEFT_OUT, DAMAGED, "sector"

    def findings(self, block: PageBlock, found: Findings, rows_in: int) -> Iterator[Event]:
        """See PageEvents; a value of a channel that a sector lacks is reported with its first sample."""
        yield from self.links(block, found, rows_in)
        first_row = np.cumsum(block.rows) - block.rows
        for name in self.channels:
            for place in np.flatnonzero(block.channels[name][first_row] == MISSING).tolist():
                row, rows = rows_in + int(first_row[place]), int(block.rows[place])
                yield self.event(int(block.position[place]), missing_kind(name), row, rows)


class SectorDecoder(PageDecoder[RawBlock]):
    """Decodes blocks of sectors."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings

    def decode(self, raw: RawBlock) -> Decoded:
        """See PageDecoder."""
        block, status = sector.decode(
            raw.pages, raw.first_position, self._settings, with_others=self.with_others
        )
        unwritten = not raw.broken and (is_erased(raw.tail) or not any(raw.tail))
        return Decoded(block, bad_runs(status, raw.first_position), b"" if unwritten else raw.tail)


class SectorTimeline:
    """Gives sectors their times, as soon as the anchors that show them are read."""

    def __init__(self, settings: Settings, unit_us: int | None) -> None:
        rate = settings.rate
        self._linker = Linker(rate, settings.rows, unit_us)
        self._times = Timeline(rate) if unit_us is None else SecondsTimeline(rate, unit_us)

    def feed(self, block: PageBlock, *, last: bool) -> Placed:
        """See the Timeline of pages."""
        assert isinstance(block, SectorBlock)
        placed = Placed(np.empty(0, np.bool_), NO_SPANS)
        if len(block):
            links, broken, found = self._linker.link(block)
            placed = Placed(broken, self._times.feed(links), found)
        return replace(placed, spans=placed.spans.followed_by(self._times.finish())) if last else placed


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording; `Format.open` says what is raised."""
    with ByteSource(path) as stream:
        head = stream.read_exact(HEADER_BYTES)
    header = sector.parse_header(head)
    file = PagedFile.at(path, header.data_start, SECTOR_BYTES)
    first, position = first_sector(file, header)
    settings = sector.settings_of(first, header.hardware)
    problems = [] if header.intact else [Problem("damaged_header", NO_HEADER, 0, 0)]
    problems += [Problem("damaged_header", HALF_HEADER, SECTOR_BYTES, 0)] if header.halved else []
    clock_set = bool(sector.anchors(np.atleast_1d(first), settings).known[0])
    if not clock_set:
        problems.append(Problem("no_start_time", NO_START, file.offset(position), 0))
    unit_us = _unit_of(file, first, position, settings)
    scheme = PageScheme(
        file,
        Spacing(settings.rate, settings.rows),
        decoder=lambda: SectorDecoder(settings),
        timeline=lambda: SectorTimeline(settings, unit_us),
        events=SectorEvents,
        first_values=sector.first_values(first, settings),
        problems=tuple(problems),
    )
    device = header.device if header.intact else sector.device_of_sector(settings, int(first["fraction"]))
    about = describe(scheme, settings, device, options)
    end_us = last_time(file, settings, unit_us)
    if not clock_set:
        about = replace(about, start_us=None)
    elif end_us is not None and about.start_us is not None and end_us > about.start_us:
        about = replace(about, duration_s=(end_us - about.start_us) / MICROSECONDS)
    return PagedReader(replace(about, notes=_notes(settings, unit_us, header)), scheme)


def _unit_of(file: PagedFile, first: Any, position: int, settings: Settings) -> int | None:
    """Return by how much stamps may be early [us]; None if they are finer than whole seconds."""
    if sector.anchors(np.atleast_1d(first), settings).time_us[0] % MICROSECONDS:
        return None
    with closing(file.blocks(file.amount(LOOK_SECTORS), position)) as blocks:
        block, _ = sector.decode(next(blocks).pages, position, settings)
    return stamp_unit(block, settings.rate, settings.rows)


def first_sector(file: PagedFile, header: Header) -> tuple[Any, int]:
    """Return the first sector with a right checksum (the oldest files: that makes sense), and its place."""
    seen = 0
    with closing(file.blocks(file.amount(SEARCH_SECTORS))) as blocks:
        for raw in blocks:
            seen += len(raw.pages)
            for candidates in sector.plausible(raw.pages):
                if candidates.any():
                    place = int(np.argmax(candidates))
                    return sector.as_sectors(raw.pages)[place].copy(), raw.first_position + place
    what = "holds no intact data sector" if header.intact else "is not an Axivity .cwa recording"
    text, at = f"{what} ({seen} sectors examined)", file.start_byte
    raise UnreadableError(text, path=file.path, byte_offset=at, hint=COPY_AGAIN)


def describe(
    scheme: PageScheme[RawBlock], settings: Settings, device: Device, options: ReadOptions
) -> Recording:
    """Describe the recording, still without length and notes; its times may prove to have no date."""
    file, gyro, sensor = scheme.file, settings.gyro_dps_per_lsb, settings.thermometer
    slope, zero = (0.0, 0) if sensor is None else (sensor.slope / sensor.divisor / 1000, sensor.zero)
    return Recording(
        path=file.path,
        format="cwa",
        rate_hz=agreed_rate(options, float(settings.rate), file.path),
        lsb_per_g=options.lsb_per_g or settings.lsb_per_g,
        total_bytes=file.size,
        device=device,
        range_g=settings.range_g,
        start_us=scheme.first_time_us(),
        has_temperature=sensor is not None,
        gyro_dps_per_lsb=None if gyro is None else (gyro, gyro, gyro),
        others=sector.OTHERS,
        thermometer=None if sensor is None else ThermometerWord(slope, -zero / 1000),
    )


def last_time(file: PagedFile, settings: Settings, unit_us: int | None) -> int | None:
    """Return the end of the last sample [us], by the last intact sector; None if that is not found."""
    if file.compressed:
        return None
    raw = file.last_block(LAST_SECTORS)
    block, _ = sector.decode(raw.pages, raw.first_position, settings)
    if not len(block) or not block.anchors.known[-1]:
        return None
    after = block.rows[-1:] - block.anchors.row[-1:]
    return (unit_us or 0) // 2 + int(block.anchors.time_us[-1] + nominal_us(after, settings.rate)[0])


def _notes(settings: Settings, unit_us: int | None, header: Header) -> tuple[str, ...]:
    rate, sensor = settings.rate, settings.thermometer
    notes = ([] if sensor is None else [sensor.note]) + [WHOLE_SECONDS] * bool(unit_us)
    if header.rate is not None and header.rate != rate:
        notes.append(f"the header says {float(header.rate):g} Hz, the data sectors {float(rate):g} Hz")
    return tuple(notes)
