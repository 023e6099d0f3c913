"""Opens a .cwa file: describes the recording, and makes chunks of its sectors.

Sectors are read a block at a time; their samples wait until the anchors that show their times are read.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, PageClock
from accelcal_cli.core.errors import COPY_AGAIN, UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.recording import Chunk, Device, Problem, Reader, Recording, joined_columns
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages.files import PagedFile, RawBlock, is_erased
from accelcal_cli.formats._pages.pages import bad_runs
from accelcal_cli.formats._pages.reader import BROKEN_OFF, Assembler, EventMaker, FileScheme, PagedReader
from accelcal_cli.formats._pages.timeline import Spacing
from accelcal_cli.formats._problems import Event, ProblemLog
from accelcal_cli.formats._rows import MISSING, HeldChannels, missing_kind
from accelcal_cli.formats.cwa import HEADER_BYTES, SECTOR_BYTES, sector
from accelcal_cli.formats.cwa.seconds import SecondsTimeline, stamp_unit
from accelcal_cli.formats.cwa.sector import SETTINGS, Header, SectorBlock, Settings
from accelcal_cli.formats.cwa.timeline import NO_SPANS, Linker, Links, Spans, Timeline, nominal_us

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

MISSING_SECTORS = ("sequence_gap", "data sectors missing by their sequence numbers")
RESTARTED = ("sequence_back", "restarts of the logging, where the sequence numbers begin again")
SESSION = ("session_change", "changes of the session number: the device was set up again")
OVERFLOW = ("device_overflow", "data sectors where the device says that it lost samples")
UNTIMED = (
    "missing_value",
    "data sectors without a valid time, placed by counting samples at the nominal rate",
)
AHEAD = ("clock_gap", "jumps of the device clock ahead")
BACK = ("clock_back", "jumps of the device clock back")
CUT_OFF = "an incomplete sector at the end of the file, bytes left out"

SEARCH_SECTORS = 2048
"""Sectors that are read at a time in search of the first intact one."""

LOOK_SECTORS = 256
"""Sectors at the beginning that show how exact the stamps are."""

LAST_SECTORS = 64
"""Sectors before the end of the data in which the last time is looked for."""

NO_HEADER = "the header at the start of the file is damaged; settings were taken from the data sectors"
HALF_HEADER = "the second half of the header is missing; the data sectors in its place are read"
WHOLE_SECONDS = "its stamps are whole seconds: samples are placed on lines through them"
NO_START = "the device's clock was not set: times count from the recording's start"


class SectorEvents(EventMaker):
    """Turns what a SectorAssembler finds into events."""

    def __init__(self) -> None:
        super().__init__(LEFT_OUT, DAMAGED)

    def links(self, block: SectorBlock, links: Links, sample: int) -> Iterator[Event]:
        """Report lost sectors, restarts and jumps of the clock between sectors."""
        if not (links.broken | links.overflow | links.untimed).any():
            return
        counted = {MISSING_SECTORS: links.missing, RESTARTED: links.restarted, SESSION: links.session}
        counted |= {OVERFLOW: links.overflow, UNTIMED: links.untimed}
        measured = {AHEAD: links.ahead_us, BACK: links.behind_us}
        samples = sample + np.cumsum(block.rows) - block.rows
        for kind, column in (counted | measured).items():
            for place in np.flatnonzero(column).tolist():
                amount, position = int(column[place]), int(block.position[place])
                if kind in measured:
                    yield replace(self.event(position, kind, int(samples[place])), amount_us=amount)
                else:
                    yield self.event(position, kind, int(samples[place]), amount)

    def channels(self, block: SectorBlock, sample: int) -> Iterator[Event]:
        """Report sectors that lack a value of a channel."""
        first_row = np.cumsum(block.rows) - block.rows
        for name, column in block.channels.items():
            if column.ndim == 1:
                for place in np.flatnonzero(column[first_row] == MISSING).tolist():
                    row, rows = sample + int(first_row[place]), int(block.rows[place])
                    yield self.event(int(block.position[place]), missing_kind(name), row, rows)

    def ending(self, raw: RawBlock, sample: int) -> Iterator[Event]:
        """Report an incomplete sector at the end, unless it is empty."""
        if not raw.broken and (is_erased(raw.tail) or not any(raw.tail)):
            return
        text = f"{BROKEN_OFF}; an incomplete sector, bytes left out" if raw.broken else CUT_OFF
        event = self.event(raw.next_position, ("truncated", text), sample, len(raw.tail))
        yield replace(event, lost_bytes=len(raw.tail) + raw.undecoded)


@dataclass(frozen=True, slots=True)
class SectorScheme(FileScheme[RawBlock]):
    """Describes how the sectors of one file are read.

    Attributes:
        unit_us: by how much stamps may be early [us], if they are whole seconds; None: they are finer.
    """

    file: PagedFile
    settings: Settings
    unit_us: int | None

    def assembler(self, sample: int = 0, *, whole: bool = True) -> SectorAssembler:
        """See FileScheme."""
        return SectorAssembler(self, sample, self.problems if whole else ())


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
    """Sectors whose times are not settled, and which of them (p,) begin again."""

    block: SectorBlock
    broken: NDArray[np.bool_]
    end_byte: int


class SectorAssembler(Assembler[RawBlock]):
    """Gives the chunks of blocks of sectors; a chunk waits until the times of its sectors are settled."""

    def __init__(self, scheme: SectorScheme, sample: int, problems: tuple[Problem, ...]) -> None:
        settings = self._settings = scheme.settings
        self._events = SectorEvents()
        self._linker = Linker(settings.rate, settings.rows, scheme.unit_us)
        unit = scheme.unit_us
        self._timeline = Timeline(settings.rate) if unit is None else SecondsTimeline(settings.rate, unit)
        self._log = ProblemLog(problems)
        self._channels = HeldChannels(scheme.first_values)
        self._waiting: deque[_Waiting] = deque()
        self._spans = NO_SPANS
        self._nothing, _ = sector.decode(np.empty((0, SECTOR_BYTES), np.uint8), 0, settings)
        self._rows_in = self._rows_out = sample

    def feed(self, raw: RawBlock) -> Iterator[Chunk]:
        """See Assembler."""
        self._events.block = raw
        block, status = sector.decode(raw.pages, raw.first_position, self._settings)
        bad = bad_runs(status, raw.first_position)
        events = list(self._events.bad_pages(block.position, block.rows, bad, self._rows_in))
        if len(block):
            self._place(block, raw.end_byte, events)
        if raw.last:
            self._add_spans(self._timeline.finish())
            events += self._events.ending(raw, self._rows_in)
        for event in sorted(events, key=lambda event: event.position):
            self._log.add(event)
        yield from self._ready(None if raw.last else raw.next_position, raw.end_byte)

    def _place(self, block: SectorBlock, end_byte: int, events: list[Event]) -> None:
        links = self._linker.link(block)
        events += self._events.links(block, links, self._rows_in)
        events += self._events.channels(block, self._rows_in)
        self._add_spans(self._timeline.feed(links))
        self._waiting.append(_Waiting(block, links.broken, end_byte))
        self._rows_in += int(block.rows.sum())

    def _add_spans(self, new: Spans) -> None:
        self._spans = Spans(**joined_columns((self._spans, new), Spans.__dataclass_fields__))

    def _ready(self, scanned: int | None, end_byte: int) -> Iterator[Chunk]:
        """Yield the chunks whose times are settled; problems left over go with an empty one."""
        problems = self._log.take(scanned)
        while self._waiting and len(self._waiting[0].block) <= len(self._spans):
            yield self._chunk(self._waiting.popleft(), problems)
            problems = ()
        if problems:
            reached = self._waiting[0].end_byte if self._waiting else end_byte
            nothing = _Waiting(self._nothing, np.empty(0, np.bool_), reached)
            yield self._chunk(nothing, problems)

    def _chunk(self, waiting: _Waiting, problems: tuple[Problem, ...]) -> Chunk:
        block, sectors = waiting.block, len(waiting.block)
        first_row = np.cumsum(block.rows) - block.rows
        spans = self._spans
        self._spans = Spans(spans.time_us[sectors:], spans.span_us[sectors:])
        clock = PageClock(first_row, spans.time_us[:sectors], block.rows, spans.span_us[:sectors])
        chunk = Chunk(
            first_sample=self._rows_out,
            counts=block.counts,
            clock=clock,
            end_byte=waiting.end_byte,
            breaks=first_row[waiting.broken],
            problems=problems,
            used_bytes=sectors * SECTOR_BYTES,
            **self._channels.fill(block.channels, first_row),
        )
        self._rows_out += len(chunk)
        return chunk


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording.

    Raises:
        UnreadableError: it is not of this format, or no data sector is intact.
    """
    with ByteSource(path) as stream:
        head = stream.read_exact(HEADER_BYTES)
    header = sector.parse_header(head)
    file = PagedFile.at(path, header.data_start, SECTOR_BYTES)
    first, position = first_sector(file, header)
    settings = sector.settings_of(first, header.hardware)
    problems = list(header_problems(header))
    clock_set = bool(sector.anchors(np.atleast_1d(first), settings).known[0])
    if not clock_set:
        problems.append(Problem("no_start_time", NO_START, file.offset(position), 0))
    scheme = SectorScheme(
        file,
        Spacing(settings.rate, settings.rows),
        settings,
        _unit_of(file, first, position, settings),
        first_values=sector.first_values(first, settings),
        problems=tuple(problems),
    )
    device = header.device if header.intact else sector.device_of_sector(settings, int(first["fraction"]))
    notes = _notes(scheme, header)
    return PagedReader(describe(scheme, device, options, clock_set, notes), scheme)


def _unit_of(file: PagedFile, first: Any, position: int, settings: Settings) -> int | None:
    """Return by how much stamps may be early [us]; None if they are finer than whole seconds."""
    if sector.anchors(np.atleast_1d(first), settings).time_us[0] % MICROSECONDS:
        return None
    with closing(file.blocks(file.amount(LOOK_SECTORS), position)) as blocks:
        block, _ = sector.decode(next(blocks).pages, position, settings)
    return stamp_unit(block, settings.rate, settings.rows)


def header_problems(header: Header) -> Iterator[Problem]:
    """Yield what is missing from the header."""
    if not header.intact:
        yield Problem("damaged_header", NO_HEADER, 0, 0)
    if header.halved:
        yield Problem("damaged_header", HALF_HEADER, SECTOR_BYTES, 0)


def first_sector(file: PagedFile, header: Header) -> tuple[Any, int]:
    """Return the first sector whose checksum is right (in the oldest files: that makes sense), and its place.

    Raises:
        UnreadableError: there is none in the whole file.
    """
    seen = 0
    with closing(file.blocks(file.amount(SEARCH_SECTORS))) as blocks:
        for raw in blocks:
            seen += len(raw.pages)
            for candidates in sector.plausible(raw.pages):
                if candidates.any():
                    place = int(np.argmax(candidates))
                    return sector.as_sectors(raw.pages)[place].copy(), raw.first_position + place
    what = "holds no intact data sector" if header.intact else "is not an Axivity .cwa recording"
    raise UnreadableError(
        f"{what} ({seen} sectors examined)", path=file.path, byte_offset=file.start_byte, hint=COPY_AGAIN
    )


def describe(
    scheme: SectorScheme, device: Device, options: ReadOptions, clock_set: bool, notes: tuple[str, ...]
) -> Recording:
    """Describe the recording."""
    settings, file = scheme.settings, scheme.file
    start_us = scheme.first_time_us()
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
        duration_s=lasted if clock_set else None,
        has_temperature=settings.thermometer is not None,
        gyro_dps_per_lsb=None if gyro is None else (gyro, gyro, gyro),
        thermometer=None if settings.thermometer is None else settings.thermometer.as_word,
        notes=notes,
    )


def last_time(scheme: SectorScheme) -> int | None:
    """Return the end of the last sample [us], by the last intact sector; None if that is not found."""
    if scheme.file.compressed:
        return None
    raw = scheme.file.last_block(LAST_SECTORS)
    block, _ = sector.decode(raw.pages, raw.first_position, scheme.settings)
    if not len(block) or not block.anchors.known[-1]:
        return None
    after = block.rows[-1:] - block.anchors.row[-1:]
    within = (scheme.unit_us or 0) // 2
    return within + int(block.anchors.time_us[-1] + nominal_us(after, scheme.settings.rate)[0])


def _notes(scheme: SectorScheme, header: Header) -> tuple[str, ...]:
    rate = scheme.settings.rate
    sensor = scheme.settings.thermometer
    notes = ([] if sensor is None else [sensor.note]) + [WHOLE_SECONDS] * bool(scheme.unit_us)
    if header.rate is not None and header.rate != rate:
        notes.append(f"the header says {float(header.rate):g} Hz, the data sectors {float(rate):g} Hz")
    return tuple(notes)
