"""An open GENEActiv .bin file: what is known of the recording, and its rows.

What most of the first pages have in common describes the recording; pages that differ are left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from accelcal_cli.core.clock import MICROSECONDS, iso_time
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import Chunk, Intake, Problem, Reader, Recording, clipped_at
from accelcal_cli.formats._pages.pages import GOOD, PageBlock
from accelcal_cli.formats._pages.places import Part, PartPlaces, PlaceCutter
from accelcal_cli.formats._pages.reader import PageJoiner, first_time
from accelcal_cli.formats._pages.timeline import CoarseTimeline, Spacing
from accelcal_cli.formats._rows import first_values
from accelcal_cli.formats.geneactiv import HEADER_MAGIC, scan
from accelcal_cli.formats.geneactiv.decode import (
    RAW_LIMIT,
    REMEMBERED_PAGES,
    Decoder,
    Scale,
    Settings,
    factory_scale,
    page_channels,
    raw_scale,
    unhexed,
)
from accelcal_cli.formats.geneactiv.header import RESET_DATE, Header, parse_header
from accelcal_cli.formats.geneactiv.scan import Found, Head, TextFile

PAGES = 64
PAGES_OF_A_STREAM = 256
"""Pages that a file which grows is known to repeat; a whole file may repeat any."""

UNITS_US = (1_000_000, 500_000)
"""Devices stamp their pages with whole seconds (model 1.2) or half ones (model 1.1)."""

FINEST_US = 1_000
AGREEING = 0.9
HALF_SECONDS = 600
RATE_ROUNDING = Fraction(1, 20)

BROKEN_OFF = "the compressed data is damaged or ends early"

START_SAMPLES = 8192
TAIL_BYTES = 1 << 16
USUAL_RANGE_G = 8.0
COPY_AGAIN = "copy it again from the device"
NO_START = "the device's clock was reset by an empty battery: its dates are not those of the recording"
HEADER_RESET = "the header's times are those of a device that was reset; the times are those of the pages"


@dataclass(frozen=True, slots=True)
class FirstPages:
    """What most of the first pages say.

    Attributes:
        serial: as it stands there.
        rate: samples per second.
        sequence: number of the first one.
        missing: pages before it that are not in the file, by that number.
        unit_us: how coarse their times are [us].
        first_values: of the channels that they tell, the first measured value; None where there is none.
    """

    serial: bytes
    rate: Fraction
    sequence: int
    missing: int
    unit_us: int
    first_values: dict[str, int | None]


def look_inside(file: TextFile) -> FirstPages | None:
    """Read on until a page is right; None if there is none in the whole file."""
    with closing(file.parts(PAGES)) as parts:
        for part in parts:
            right = _right_pages(part)
            if right:
                return _common(right)
    return None


def _right_pages(part: Part[Found]) -> list[tuple[int, Head]]:
    """Place and text of pages that make sense by themselves."""
    found = part.found
    places = [place for place, kind in enumerate(found.status, part.first_position) if kind == GOOD]
    known = scan.stamps_us([head[2] for head in found.heads]) != scan.NO_STAMP
    pages = zip(places, found.heads, found.bodies, known.tolist(), strict=True)
    return [
        (place, head)
        for place, head, body, dated in pages
        if dated and (scan.number(head[4]) or 0) > 0 and unhexed([body]) is not None
    ]


def _common(pages: Sequence[tuple[int, Head]]) -> FirstPages:
    stated = [(head[0], scan.number(head[4])) for _, head in pages]
    serial, rate = Counter(stated).most_common(1)[0][0]
    place, first = pages[stated.index((serial, rate))]
    return FirstPages(
        serial=serial,
        rate=rate or Fraction(1),
        sequence=int(first[1]),
        missing=max(0, int(first[1]) - place),
        unit_us=_unit_us([head[2] for _, head in pages]),
        first_values=first_values(page_channels([head for _, head in pages])),
    )


def _unit_us(stamps: Sequence[bytes]) -> int:
    """The coarsest unit of which nearly all stamps are multiples."""
    time_us = scan.stamps_us(stamps)
    fits = (unit for unit in UNITS_US if np.mean(time_us % unit == 0) >= AGREEING)
    return next(fits, FINEST_US)


def true_rate(rate: Fraction) -> Fraction:
    """The true rate, of which a page states a rounded figure.

    A page of 300 samples lasts a whole number of half seconds: 3.5 s at what is called 85.7 Hz
    (600/7), 4.5 s at 66.7 Hz (200/3).
    """
    exact = Fraction(HALF_SECONDS, max(1, round(HALF_SECONDS / rate)))
    return exact if abs(exact - rate) <= RATE_ROUNDING else rate


@dataclass(frozen=True, slots=True)
class Scheme:
    """How to read the pages of one file.

    Attributes:
        spacing: of the samples, at the device's true rate.
        announced: how many pages the header announces, None if it does not say.
        problems: what was found before any page.
    """

    file: TextFile
    settings: Settings
    spacing: Spacing
    first: FirstPages
    announced: int | None = None
    problems: tuple[Problem, ...] = ()

    def stream(self, chunk_samples: int, threads: int = 1) -> Generator[Chunk]:
        """All rows of the file, whole pages, at least one; so many threads may work on a gzip file."""
        assembler = Assembler(self, 0, self.problems)
        with closing(self.file.parts(max(1, chunk_samples // scan.SAMPLES), threads)) as parts:
            for part in parts:
                chunk = assembler.chunk(part)
                if len(chunk) or chunk.problems:
                    yield chunk

    def piece(self, offset: int, length: int) -> Chunk:
        """The pages that begin within `length` bytes, as if the recording were just these."""
        part = self.file.piece(offset, length)
        pages = max(0, int(part.found.heads[0][1]) - self.first.sequence) if part.found.heads else 0
        return Assembler(self, pages * scan.SAMPLES, ()).feed(part)

    def block(self, part: Part[Found]) -> PageBlock:
        """The pages of a part, decoded."""
        return Decoder(self.settings)(part.found, part.first_position).block


class Assembler:
    """Takes the parts of a file in order and gives a chunk for each."""

    def __init__(
        self, scheme: Scheme, sample: int, problems: tuple[Problem, ...], remembered: int = REMEMBERED_PAGES
    ) -> None:
        self._scheme = scheme
        self._places = PartPlaces(scan.USUAL_BYTES)
        self._decode = Decoder(scheme.settings, remembered)
        timeline = CoarseTimeline(scheme.spacing, scheme.first.unit_us)
        first = scheme.first.first_values
        self._joiner = PageJoiner(self._places, scheme.spacing, timeline, sample, first, problems)
        self._highest = self._last_position = -1

    def chunk(self, part: Part[Found]) -> Chunk:
        """Add a part; the last one releases everything, with what is missing at the end of the file."""
        chunk = self.feed(part)
        return replace(chunk, problems=chunk.problems + self.ending(part, chunk)) if part.last else chunk

    def feed(self, part: Part[Found]) -> Chunk:
        """Add a part; the last one releases everything."""
        self._places.part = part
        decoded = self._decode(part.found, part.first_position)
        block = decoded.block
        if len(block) and block.sequence is not None:
            self._highest = max(self._highest, int(block.sequence.max()))
            self._last_position = int(block.position[-1])
        chunk = clipped_at(self._joiner.feed(part, decoded), *self._scheme.settings.scale.clipped)
        self._places.part = replace(part, first_position=part.next_position, found=Found())
        return chunk

    def ending(self, part: Part[Found], chunk: Chunk) -> tuple[Problem, ...]:
        """What is missing at the end of the file."""
        sample, found = chunk.first_sample + len(chunk), part.found
        problems = [Problem("truncated", BROKEN_OFF, part.end, sample)] if part.broke_off else []
        if found.cut is not None:
            missing = scan.SAMPLES - found.cut_samples
            text = f"the file ends within a page: {missing} of its {scan.SAMPLES} samples are missing"
            problems.append(Problem("truncated", text, found.cut, sample, missing))
        lost = self._never_come(part)
        if lost > 0:
            text = f"pages that the header announces are missing at the end of the file: {lost}"
            problems.append(Problem("truncated", text, part.end, sample, lost))
        return tuple(problems)

    def _never_come(self, part: Part[Found]) -> int:
        """Pages that the header announces, without those that are reported in another way."""
        damaged = part.next_position - 1 - self._last_position
        cut = part.found.cut is not None and part.found.cut_samples == 0
        return (self._scheme.announced or 0) - (self._highest + 1) - damaged - cut


class GeneactivIntake(Intake):
    """Takes a recording as it grows."""

    def __init__(self, scheme: Scheme) -> None:
        self._assembler = Assembler(scheme, 0, scheme.problems, PAGES_OF_A_STREAM)
        start = scheme.file.start
        self._cutter = PlaceCutter(scan.Scanner(start), start)

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        yield self._assembler.chunk(self._cutter.cut(data, last=last))


class GeneactivReader(Reader):
    """Streams the pages; each call of `chunks` reads the file from its beginning."""

    def __init__(self, recording: Recording, scheme: Scheme) -> None:
        self.recording = recording
        self._scheme = scheme

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, whole pages, at least one."""
        return self._scheme.stream(chunk_samples, self.threads)

    def intake(self) -> Intake:
        """See `Reader`."""
        return GeneactivIntake(self._scheme)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Enter the file at evenly spread bytes, each time up to the next page.

        A gzip file gives its first chunks.
        """
        file = self._scheme.file
        if file.compressed:
            yield from super().preview(chunk_samples, pieces)
            return
        spread = max(scan.USUAL_BYTES, (file.size - file.start) // max(1, pieces))
        length = min(spread, max(1, chunk_samples // scan.SAMPLES) * scan.USUAL_BYTES)
        for piece in range(pieces):
            chunk = self._scheme.piece(file.start + piece * spread, length)
            if len(chunk) or chunk.problems:
                yield chunk


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording.

    Raises:
        UnreadableError: no page is intact, or the factory's calibration is lost and `lsb_per_g` not given.
        UsageError: the user's rate contradicts that of the pages.
    """
    probe = probe_file(path, options)
    header = parse_header(probe.head)
    file = TextFile(path, header.data_start, probe.size, probe.compressed)
    first = look_inside(file)
    if first is None:
        known = probe.head.startswith(HEADER_MAGIC)
        what = "holds no intact page of samples" if known else "is not a GENEActiv .bin recording"
        raise UnreadableError(what, path=path, byte_offset=header.data_start, hint=COPY_AGAIN)
    scheme = Scheme(
        file,
        Settings(first.serial, first.rate, scale_of(header, options, path)),
        Spacing(true_rate(first.rate), scan.SAMPLES),
        first,
        header.pages,
    )
    start_us = first_time(scheme.stream(START_SAMPLES))
    dated = not (iso_time(start_us, None) or "").startswith(RESET_DATE)
    scheme = replace(scheme, problems=problems_of(header, first, dated=dated))
    return GeneactivReader(describe(scheme, header, options, start_us if dated else None), scheme)


def problems_of(header: Header, first: FirstPages, *, dated: bool) -> tuple[Problem, ...]:
    """What is wrong before any page is read."""
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
    """The user's counts per g for the raw values, else the factory's calibration.

    Raises:
        UnreadableError: there is neither.
    """
    if options.lsb_per_g is not None:
        return raw_scale(options.lsb_per_g)
    if header.factory is None:
        usual = RAW_LIMIT / (header.range_g or USUAL_RANGE_G)
        raise UnreadableError(
            "the factory's calibration (gain and offset of x, y and z) is missing from the header or damaged",
            path=path,
            byte_offset=0,
            hint=f"give --lsb-per-g to read the raw values (about {usual:g} by the sensor's range)",
        )
    return factory_scale(header.factory)


def describe(scheme: Scheme, header: Header, options: ReadOptions, start_us: int | None) -> Recording:
    """What is known of the recording."""
    first, file = scheme.first, scheme.file
    serial = first.serial.decode("ascii", "replace").strip()
    return Recording(
        path=file.path,
        format="geneactiv",
        rate_hz=agreed_rate(options, float(first.rate), file.path),
        lsb_per_g=scheme.settings.scale.lsb_per_g,
        total_bytes=file.size,
        device=replace(header.device, serial=serial or header.device.serial),
        range_g=header.range_g,
        start_us=start_us,
        timezone=header.timezone,
        duration_s=duration_s(scheme, start_us),
        has_temperature=first.first_values["temperature_mc"] is not None,
        notes=notes(scheme, header, options),
    )


def notes(scheme: Scheme, header: Header, options: ReadOptions) -> tuple[str, ...]:
    """What a user should know of how the file was understood."""
    first, found = scheme.first, []
    serial = first.serial.decode("ascii", "replace").strip()
    if header.rate is not None and header.rate != first.rate:
        found.append(f"the header says {float(header.rate):g} Hz, the pages {float(first.rate):g} Hz")
    if header.device.serial not in (None, serial):
        found.append(f"the header names device {header.device.serial}, the pages {serial}")
    if options.lsb_per_g is not None:
        found.append("--lsb-per-g was given: the factory's gain and offset were not applied")
    if header.reset:
        found.append(HEADER_RESET)
    if header.drift_s is not None:
        found.append(f"the header notes a clock drift of {header.drift_s} s; the times are the device's own")
    return tuple(found)


def duration_s(scheme: Scheme, start_us: int | None) -> float | None:
    """From the first sample to the end of the last page [s], None if that is not found."""
    file = scheme.file
    if file.compressed or start_us is None:
        return None
    last = scheme.block(file.piece(max(file.start, file.size - TAIL_BYTES), TAIL_BYTES))
    if not len(last) or last.time_us is None:
        return None
    lasted_us = int(last.time_us[-1]) - start_us + float(scheme.spacing.rows_us(last.rows[-1]))
    return lasted_us / MICROSECONDS if lasted_us > 0 else None
