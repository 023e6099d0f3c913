"""Opens a GENEActiv .bin file: reads its header, and describes the recording.

The properties that most of the first pages share describe the recording; pages that differ are left out.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS, iso_time
from accelcal_cli.core.errors import COPY_AGAIN, UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import Device, Problem, Reader, Recording, first_row
from accelcal_cli.core.written_times import header_zone
from accelcal_cli.formats._pages.files import PageFile
from accelcal_cli.formats._pages.pages import GOOD
from accelcal_cli.formats._pages.reader import PagedReader, PageScheme
from accelcal_cli.formats._pages.timeline import CoarseTimeline, Spacing
from accelcal_cli.formats._rows import first_values
from accelcal_cli.formats.geneactiv import HEADER_MAGIC, MARK
from accelcal_cli.formats.geneactiv.decode import (
    LONGEST_BYTES,
    NO_STAMP,
    RAW_LIMIT,
    SAMPLES,
    USUAL_BYTES,
    Factory,
    Head,
    Scale,
    Settings,
    TextDecoder,
    TextPages,
    TextScanner,
    factory_of,
    factory_scale,
    number,
    page_channels,
    raw_scale,
    stamps_us,
    unhexed,
    whole_number,
)

PAGES, AGREEING = 64, 0.9
"""Pages that describe the recording, and share of them whose times must be multiples of a unit."""

UNITS_US = (1_000_000, 500_000)
"""Units of the pages' times [us]: whole seconds (model 1.2) or half seconds (model 1.1)."""

FINEST_US = 1_000
HALF_SECONDS, RATE_ROUNDING = 600, Fraction(1, 20)
"""At R Hz, a page lasts 600 / R half seconds; most by which its rate [Hz] is rounded."""

TAIL_BYTES = 1 << 16
"""Bytes at the end of the file in which the last page is looked for."""

USUAL_RANGE_G = 8.0
NO_START = "the device's clock was reset by an empty battery: its dates are not those of the recording"
HEADER_RESET = "the header's times are those of a device that was reset; the times are those of the pages"

CALIBRATION = "Calibration Data"
RESET_DATE = "2010-09-16"
"""Date to which an empty battery resets a device's clock; the header then has lost its times."""

NO_DEVICE = Device()
_PAGE_LINE = re.compile(
    MARK + rb"[ \t]*(?:[\r\n]|\Z)|(?:^|(?<=\r))(?:Sequence Number:|Page Time:|[0-9A-Fa-f]{256})", re.MULTILINE
)
"""The beginning of a page, or a line of one, whichever comes first. A damaged page is not a part of the
header, even if its lines end in carriage returns alone, or the end of the line before it is lost."""

_RANGE = re.compile(r"-\s*(\d+(?:\.\d+)?)\s*to\s*(\d+(?:\.\d+)?)")
_DRIFT = re.compile(r"clock drift (-?\d+(?:\.\d+)?) ?s")


@dataclass(frozen=True, slots=True)
class Header:
    """The header; a field is None if it is missing or impossible.

    Attributes:
        data_start: where the first page lies, bytes.
        rate: configured rate [Hz].
        range_g: the sensor clips at +- this.
        timezone: of the device's clock, `UTC` or such as `+01:00`; zone_notes: that it is not understood.
        factory: the calibration block.
        pages: the number that it announces.
        reset: its times are those of a device that was reset.
        drift_s: error of the device's clock that was noted at the download.
        missing: names of required fields that are None, for people.
    """

    data_start: int
    device: Device = NO_DEVICE
    rate: Fraction | None = None
    range_g: float | None = None
    timezone: str | None = None
    zone_notes: tuple[str, ...] = ()
    factory: Factory | None = None
    pages: int | None = None
    reset: bool = False
    drift_s: str | None = None
    missing: tuple[str, ...] = ()


def parse_header(head: bytes) -> Header:
    """Read the header from the file's first bytes."""
    match = _PAGE_LINE.search(head)
    end = match.start() if match else 0
    text = head[:end].decode("ascii", "replace")
    about, measured = _values(text), _values(text.rpartition(CALIBRATION)[2])
    factory = factory_of(measured)
    rate = number(about.get("Measurement Frequency", "").encode("ascii", "replace"))
    ends = _RANGE.search(about.get("Accelerometer Range", ""))  # such as -8 to 8, symmetric
    range_g = float(ends[2]) if ends and float(ends[1]) == float(ends[2]) > 0 else None
    serial = about.get("Device Unique Serial Code")
    zone, zone_notes = header_zone(about.get("Time Zone", ""))
    model = " ".join(about[key] for key in ("Device Type", "Device Model") if key in about)
    drift = _DRIFT.search(about.get("Extract Notes", ""))
    needed = {
        "serial number": serial,
        "measurement frequency": rate,
        "range": range_g,
        "calibration": factory,
    }
    return Header(
        data_start=end,
        device=Device(model or None, serial, about.get("Device Firmware Version")),
        rate=rate,
        range_g=range_g,
        timezone=zone,
        zone_notes=zone_notes,
        factory=factory,
        pages=whole_number(measured.get("Number of Pages", "")),
        reset=any(about.get(key, "").startswith(RESET_DATE) for key in ("Config Time", "Start Time")),
        drift_s=drift[1] if drift else None,
        missing=tuple(name for name, value in needed.items() if value is None),
    )


def _values(text: str) -> dict[str, str]:
    """Return the first value of each key; empty values are left out."""
    values: dict[str, str] = {}
    for line in text.splitlines():
        key, _, value = line.partition(":")
        shown = "".join(letter for letter in value if letter.isprintable()).strip()
        if shown:
            values.setdefault(key.strip(), shown)
    return values


@dataclass(frozen=True, slots=True)
class FirstPages:
    """Properties that most of the first pages share.

    Attributes:
        serial: as in their text.
        rate: samples per second.
        sequence: number of the first page.
        missing: pages before it that are not in the file, by that number.
        unit_us: the coarsest unit [us] of which nearly all their times are multiples.
        first_values: first measured value of each channel, None if there is none.
    """

    serial: bytes
    rate: Fraction
    sequence: int
    missing: int
    unit_us: int
    first_values: dict[str, int | None]


def look_inside(file: PageFile[TextPages]) -> FirstPages | None:
    """Read on until a page is right; return None if there is none in the whole file."""
    with closing(file.blocks(file.amount(PAGES))) as blocks:
        for block in blocks:
            right = _right_pages(block)
            if right:
                return _common(right)
    return None


def _right_pages(found: TextPages) -> list[tuple[int, Head]]:
    """Return position and text of pages that make sense by themselves."""
    places = [place for place, kind in enumerate(found.status, found.first_position) if kind == GOOD]
    known = stamps_us([head[2] for head in found.heads]) != NO_STAMP
    pages = zip(places, found.heads, found.bodies, known.tolist(), strict=True)
    return [
        (place, head)
        for place, head, body, dated in pages
        if dated and (number(head[4]) or 0) > 0 and unhexed([body]) is not None
    ]


def _common(pages: Sequence[tuple[int, Head]]) -> FirstPages:
    stated = [(head[0], number(head[4])) for _, head in pages]
    serial, rate = Counter(stated).most_common(1)[0][0]
    place, first = pages[stated.index((serial, rate))]
    time_us = stamps_us([head[2] for _, head in pages])
    units = (unit for unit in UNITS_US if np.mean(time_us % unit == 0) >= AGREEING)
    return FirstPages(
        serial=serial,
        rate=rate or Fraction(1),
        sequence=int(first[1]),
        missing=max(0, int(first[1]) - place),
        unit_us=next(units, FINEST_US),
        first_values=first_values(page_channels([head for _, head in pages])),
    )


def true_rate(rate: Fraction) -> Fraction:
    """Return the true rate for the rounded figure in a page.

    A page of 300 samples lasts a whole number of half seconds: 3.5 s at what is called 85.7 Hz
    (600/7), 4.5 s at 66.7 Hz (200/3).
    """
    exact = Fraction(HALF_SECONDS, max(1, round(HALF_SECONDS / rate)))
    return exact if abs(exact - rate) <= RATE_ROUNDING else rate


@dataclass(frozen=True, slots=True)
class TextScheme(PageScheme[TextPages]):
    """Describes how the pages of one file are read, which have `settings` in common."""

    file: PageFile[TextPages]
    settings: Settings
    first_sequence: int

    def pieces(self, chunk_samples: int, pieces: int) -> Iterator[tuple[int, TextPages]]:
        """Enter at evenly spread bytes, each time up to the next page."""
        file = self.file
        if file.compressed:
            return
        spread = max(USUAL_BYTES, (file.size - file.start_byte) // max(1, pieces))
        length = min(spread, max(1, chunk_samples // SAMPLES) * USUAL_BYTES)
        for piece in range(pieces):
            block = piece_of(file, file.start_byte + piece * spread, length)
            page = max(0, int(block.heads[0][1]) - self.first_sequence) if block.heads else 0
            yield page * SAMPLES, block


def piece_of(file: PageFile[TextPages], offset: int, length: int) -> TextPages:
    """Return the pages that begin within `length` bytes from `offset` on, in an uncompressed file."""
    data = file.read(offset, length + LONGEST_BYTES)
    return TextScanner(offset, inside=True).feed(data, last=True, stop=length).alone(offset + len(data))


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording; `Format.open` says what is raised."""
    probe = probe_file(path, options)
    header = parse_header(probe.head)
    start, packed = header.data_start, probe.compressed
    file = PageFile(path, start, USUAL_BYTES, probe.size, packed, TextScanner, proved=False)
    first = look_inside(file)
    if first is None:
        known = probe.head.startswith(HEADER_MAGIC)
        what = "holds no intact page of samples" if known else "is not a GENEActiv .bin recording"
        raise UnreadableError(what, path=path, byte_offset=start, hint=COPY_AGAIN)
    settings = Settings(first.serial, first.rate, scale_of(header, options, path))
    spacing = Spacing(true_rate(first.rate), SAMPLES)
    scheme = TextScheme(
        file,
        spacing,
        decoder=lambda: TextDecoder(settings, header.pages or 0),
        timeline=lambda: CoarseTimeline(spacing, first.unit_us),
        settings=settings,
        first_sequence=first.sequence,
        first_values=first.first_values,
    )
    start_us = scheme.first_time_us()
    dated = not (iso_time(start_us, None) or "").startswith(RESET_DATE)
    scheme = replace(scheme, problems=problems_of(header, first, dated=dated))
    recording = describe(scheme, header, options, start_us if dated else None)
    return PagedReader(replace(recording, notes=notes(first, header, options)), scheme)


def problems_of(header: Header, first: FirstPages, *, dated: bool) -> tuple[Problem, ...]:
    """Return what is wrong before any page is read."""
    problems, start = [], header.data_start
    if header.missing:
        text = f"the header does not tell the device's {', '.join(header.missing)}"
        problems.append(Problem("damaged_header", text, 0, 0))
    if not dated:
        problems.append(Problem("no_start_time", NO_START, start, 0))
    if first.missing:
        text = f"pages missing before the first one by its sequence number: {first.missing}"
        problems.append(Problem("sequence_gap", text, start, 0, first.missing))
    return tuple(problems)


def scale_of(header: Header, options: ReadOptions, path: Path) -> Scale:
    """Return the user's counts per g for the raw values, else the factory's calibration, if there is one."""
    if options.lsb_per_g is not None:
        return raw_scale(options.lsb_per_g)
    if header.factory is None:
        usual = RAW_LIMIT / (header.range_g or USUAL_RANGE_G)
        hint = f"give --lsb-per-g to read the raw values (about {usual:g} by the sensor's range)"
        what = (
            "the factory's calibration (gain and offset of x, y and z) is missing from the header or damaged"
        )
        raise UnreadableError(what, path=path, byte_offset=0, hint=hint)
    return factory_scale(header.factory)


def describe(scheme: TextScheme, header: Header, options: ReadOptions, start_us: int | None) -> Recording:
    """Describe the recording, still without notes."""
    settings, file = scheme.settings, scheme.file
    serial = settings.serial.decode("ascii", "replace").strip()
    return Recording(
        path=file.path,
        format="geneactiv",
        rate_hz=agreed_rate(options, float(settings.rate), file.path),
        lsb_per_g=settings.scale.lsb_per_g,
        total_bytes=file.size,
        device=replace(header.device, serial=serial or header.device.serial),
        range_g=header.range_g,
        start_us=start_us,
        timezone=header.timezone,
        duration_s=duration_s(scheme, start_us),
        has_temperature=scheme.first_values["temperature_mc"] is not None,
        zero_counts=first_row(settings.scale.table.T),
    )


def notes(first: FirstPages, header: Header, options: ReadOptions) -> tuple[str, ...]:
    """Return notes for the user on how the file was understood."""
    texts = []
    serial = first.serial.decode("ascii", "replace").strip()
    if header.rate is not None and header.rate != first.rate:
        texts.append(f"the header says {float(header.rate):g} Hz, the pages {float(first.rate):g} Hz")
    if header.device.serial not in (None, serial):
        texts.append(f"the header names device {header.device.serial}, the pages {serial}")
    if options.lsb_per_g is not None:
        texts.append("--lsb-per-g was given: the factory's gain and offset were not applied")
    if header.reset:
        texts.append(HEADER_RESET)
    if header.drift_s is not None:
        texts.append(f"the header notes a clock drift of {header.drift_s} s; the times are the device's own")
    return (*texts, *header.zone_notes)


def duration_s(scheme: TextScheme, start_us: int | None) -> float | None:
    """Return the time from the first sample to the end of the last page [s], None if not found."""
    file = scheme.file
    if file.compressed or start_us is None:
        return None
    piece = piece_of(file, max(file.start_byte, file.size - TAIL_BYTES), TAIL_BYTES)
    last = TextDecoder(scheme.settings).decode(piece).block
    if not len(last) or last.time_us is None:
        return None
    lasted_us = int(last.time_us[-1]) - start_us + float(scheme.spacing.rows_us(last.rows[-1]))
    return lasted_us / MICROSECONDS if lasted_us > 0 else None
