"""An open GENEA file: its header, the factory's calibration, and its rows.

g = (raw + offset) * gain / 8192 / 340 for each axis, with the header's offsets and gains. The values stay
whole numbers on one grid for all axes, gain * (raw + offset), until the calibration is applied. Source:
github.com/wadpac/GGIRread, R/readGenea.R.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce
from math import gcd
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import Chunk, Device, Intake, Problem, Reader, Recording, Validity
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages.pages import Decoded, PageCutter, PagedFile, RawBlock
from accelcal_cli.formats._pages.places import Part, PartPlaces
from accelcal_cli.formats._pages.reader import PageJoiner, first_time
from accelcal_cli.formats._pages.timeline import CoarseTimeline, Spacing
from accelcal_cli.formats.genea.slots import (
    PAGE_BYTES,
    SAMPLE,
    SLOT_BYTES,
    SLOTS,
    TIME,
    Grouper,
    kinds,
    page_slots,
    seconds,
    sound,
    tail_slots,
)

GAIN_UNIT = 8192
RAW_PER_G = 340
RAW_LIMIT = 1 << 11
GAINS = (GAIN_UNIT // 2, 2 * GAIN_UNIT)
RATES_HZ = (1.0, 1000.0)
AXES = 3

FIRST_PAGES = 256
LAST_PAGES = 32
COPY_AGAIN = "copy it again from the device"
NO_START = "no time is intact: times count from the beginning of the recording"
BROKEN_OFF = "the compressed data is damaged or ends early"
_END = re.compile(rb"\r?\n\r?\n")
_LINE = re.compile(rb"(?m)^([A-Za-z -]{1,40}):([^\r\n]*)")
_RATE = re.compile(r"(\d{1,4}(?:\.\d{1,3})?) ?Hz", re.IGNORECASE)
_TRIPLE = re.compile(r"\s*(-?\d{1,6})\s+(-?\d{1,6})\s+(-?\d{1,6})\s*")


@dataclass(frozen=True, slots=True)
class Header:
    """What the text before the first page says; None if it does not, or something impossible.

    Attributes:
        data_start: where the first page lies, bytes.
        gains, offsets: of x, y and z.
    """

    data_start: int
    rate_hz: float | None
    gains: tuple[int, ...] | None
    offsets: tuple[int, ...] | None
    device: Device


def parse_header(head: bytes) -> Header | None:
    """Read the lines of `key:value` up to an empty one; None without that one.

    Args:
        head: the file's first bytes.
    """
    end = _END.search(head)
    if end is None:
        return None
    found = _LINE.findall(head, 0, end.start())
    said = {key.decode("ascii"): value.decode("ascii", "replace").strip() for key, value in found}
    rate = _RATE.fullmatch(said.get("Sample-Rate", ""))
    rate_hz = float(rate[1]) if rate else 0.0
    gains, offsets = (_triple(said.get(f"Accel-{name}", "")) for name in ("Gains", "Offsets"))
    return Header(
        data_start=end.end(),
        rate_hz=rate_hz if RATES_HZ[0] <= rate_hz <= RATES_HZ[1] else None,
        gains=gains if gains and all(GAINS[0] <= gain <= GAINS[1] for gain in gains) else None,
        offsets=offsets if offsets and all(abs(offset) <= RAW_PER_G for offset in offsets) else None,
        device=Device("GENEA", said.get("Serial-Number") or None, said.get("Firmware-Version") or None),
    )


def _triple(text: str) -> tuple[int, ...] | None:
    match = _TRIPLE.fullmatch(text)
    return tuple(map(int, match.groups())) if match else None


@dataclass(frozen=True, slots=True)
class Scale:
    """From raw values to counts: slope * (raw + offset), and how many of these are 1 g."""

    lsb_per_g: float
    slopes: tuple[int, ...] = (1, 1, 1)
    offsets: tuple[int, ...] = (0, 0, 0)

    def applied(self, chunk: Chunk) -> Chunk:
        """Raw values as counts; rows at the end of what 12 bits can tell are marked."""
        raw = chunk.counts
        clipped = ((raw <= 1 - RAW_LIMIT) | (raw >= RAW_LIMIT - 1)).any(axis=1)
        validity = np.where(clipped, Validity.CLIPPED, Validity.MEASURED).astype(np.uint8)
        counts: NDArray[np.int16] | NDArray[np.int32] = raw
        if self.slopes != (1, 1, 1) or any(self.offsets):
            counts = (raw.astype(np.int32) + np.array(self.offsets, np.int32)) * np.array(
                self.slopes, np.int32
            )
        return replace(chunk, counts=counts, validity=validity if clipped.any() else None)


def scale_of(header: Header, options: ReadOptions, path: Path) -> Scale:
    """The user's counts per g for the raw values, else the factory's calibration.

    Raises:
        UnreadableError: there is neither.
    """
    if options.lsb_per_g is not None:
        return Scale(options.lsb_per_g)
    if header.gains is None or header.offsets is None:
        raise UnreadableError(
            "the factory's gains and offsets of x, y and z are missing from the header or impossible",
            path=path,
            byte_offset=0,
            hint=f"give --lsb-per-g to read the raw values (about {RAW_PER_G})",
        )
    common = reduce(gcd, header.gains)
    slopes = tuple(gain // common for gain in header.gains)
    return Scale(GAIN_UNIT * RAW_PER_G / common, slopes, header.offsets)


@dataclass(frozen=True, slots=True)
class Scheme:
    """How to read the pages of one file.

    Attributes:
        start_us: time of the first sample.
    """

    file: PagedFile
    spacing: Spacing
    scale: Scale
    start_us: int
    problems: tuple[Problem, ...] = ()

    def stream(self, chunk_samples: int, threads: int = 1) -> Generator[Chunk]:
        """All rows of the file, from one time to another, about so many at once.

        Args:
            threads: how many may work at a time on a gzip file.
        """
        assembler = Assembler(self, 0, self.problems)
        for raw in self.file.blocks(self.file.fitting(chunk_samples // SLOTS), threads=threads):
            chunk = assembler.feed_file(raw)
            if len(chunk) or chunk.problems:
                yield chunk

    def piece(self, position: int, pages: int) -> Chunk:
        """The rows of some pages, as if the recording were just these."""
        with closing(self.file.blocks(pages, position)) as blocks:
            raw = replace(next(blocks), last=True, tail=b"")
        return Assembler(self, position * SLOTS, ()).feed(raw)


class Assembler:
    """Takes the blocks of a file in order and gives a chunk for each."""

    def __init__(self, scheme: Scheme, sample: int, problems: tuple[Problem, ...]) -> None:
        self._scheme = scheme
        self._places = PartPlaces(SLOT_BYTES * scheme.spacing.rows)
        self._group = Grouper(scheme.spacing, scheme.file.start_byte, scheme.start_us)
        timeline = CoarseTimeline(scheme.spacing, MICROSECONDS)
        self._joiner = PageJoiner(self._places, scheme.spacing, timeline, sample, {}, problems)
        self._position = 0

    def feed(self, raw: RawBlock) -> Chunk:
        """Add a block; the last one releases everything."""
        found, block = self._group.feed(raw)
        end = self._scheme.file.offset(raw.next_position) + len(raw.tail)
        part = self._places.part = Part(self._position, found, end, raw.end_byte, raw.last)
        decoded = Decoded(block, paged.bad_runs(np.array(found.status, np.uint8), self._position), b"")
        self._position = part.next_position
        chunk = self._joiner.feed(part, decoded)
        return self._scheme.scale.applied(replace(chunk, used_bytes=len(chunk) * SLOT_BYTES))

    def feed_file(self, raw: RawBlock) -> Chunk:
        """The same of a whole file, whose end may be told."""
        chunk = self.feed(raw)
        return replace(chunk, problems=chunk.problems + self._ending(raw, chunk)) if raw.last else chunk

    def _ending(self, raw: RawBlock, chunk: Chunk) -> tuple[Problem, ...]:
        """What is missing at the end of the file."""
        offset, sample = self._scheme.file.offset(raw.next_position), chunk.first_sample + len(chunk)
        if raw.broken:
            return (Problem("truncated", BROKEN_OFF, offset, sample, 1, raw.undecoded),)
        if not raw.tail.strip(b"\0") or not raw.tail.strip(b"\xff"):
            return ()
        text = f"the file ends within a page, of which it has {len(raw.tail)} of {PAGE_BYTES} bytes"
        lost = len(raw.tail) % SLOT_BYTES if len(raw.tail) < SLOTS * SLOT_BYTES else 0
        return (Problem("truncated", text, offset, sample, 1, lost),)


class GeneaIntake(Intake):
    """Takes a recording as it grows."""

    def __init__(self, scheme: Scheme) -> None:
        self._cutter, self._assembler = PageCutter(scheme.file), Assembler(scheme, 0, scheme.problems)

    def take(self, data: bytes, *, last: bool) -> Iterator[Chunk]:
        """See `Intake`."""
        raw = self._cutter.cut(data, last=last)
        if len(raw.pages) or last:
            yield self._assembler.feed_file(raw)


class GeneaReader(Reader):
    """Streams the samples; each call of `chunks` reads the file from its beginning."""

    def __init__(self, recording: Recording, scheme: Scheme) -> None:
        self.recording = recording
        self._scheme = scheme

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, about `chunk_samples` at a time."""
        return self._scheme.stream(chunk_samples, self.threads)

    def intake(self) -> Intake:
        """See `Reader`."""
        return GeneaIntake(self._scheme)

    def preview(self, chunk_samples: int, pieces: int) -> Iterator[Chunk]:
        """Enter the file at evenly spread pages; a gzip file gives its first chunks."""
        file = self._scheme.file
        pages = max(1, chunk_samples // SLOTS)
        if file.compressed or file.whole_pages < pieces * pages:
            yield from super().preview(chunk_samples, pieces)
            return
        for piece in range(pieces):
            chunk = self._scheme.piece(piece * file.whole_pages // pieces, pages)
            if len(chunk) or chunk.problems:
                yield chunk


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording.

    Raises:
        UnreadableError: the header has no end, no sample is intact, or the factory's calibration is lost and
            `lsb_per_g` not given, or the rate is and `rate_hz` not given.
        UsageError: the user's rate contradicts the header's.
    """
    header = parse_header(probe_file(path, options).head)
    if header is None:
        what = "has no GENEA header, or one without an empty line at its end"
        raise UnreadableError(what, path=path, byte_offset=0, hint=COPY_AGAIN)
    rate_hz = options.rate_hz if header.rate_hz is None else agreed_rate(options, header.rate_hz, path)
    if rate_hz is None:
        what = "the sampling rate is missing from the header or impossible"
        raise UnreadableError(what, path=path, byte_offset=0, hint="give it with --rate")
    spacing = Spacing(Fraction(rate_hz).limit_denominator(1000), max(1, round(rate_hz)))
    file = paged.paged_file(path, header.data_start, PAGE_BYTES)
    before = rows_before_the_first_time(file)
    start_us = 0 if before is None else before[1] - round(float(spacing.rows_us(before[0])))
    problems = () if before else (Problem("no_start_time", NO_START, None, 0),)
    scheme = Scheme(file, spacing, scale_of(header, options, path), start_us, problems)
    return GeneaReader(describe(scheme, header, rate_hz, dated=before is not None), scheme)


def blocks_of_slots(file: PagedFile, first_position: int = 0) -> Generator[NDArray[np.uint8]]:
    """The slots of all pages from one on, (n, 6) at a time."""
    with closing(file.blocks(FIRST_PAGES, first_position)) as blocks:
        for raw in blocks:
            yield np.concatenate((page_slots(raw.pages), tail_slots(raw.tail)))


def rows_before_the_first_time(file: PagedFile) -> tuple[int, int] | None:
    """How many samples stand before the first time, and that time [us]; None if there is none."""
    rows = 0
    with closing(blocks_of_slots(file)) as blocks:
        for slots in blocks:
            good, kind = sound(slots), kinds(slots)
            times = np.flatnonzero(good & (kind == TIME))
            end = int(times[0]) if len(times) else len(slots)
            rows += int((~good | (kind == SAMPLE))[:end].sum())
            if len(times):
                return rows, int(seconds(slots[times[:1]])[0]) * MICROSECONDS
    return None


def describe(scheme: Scheme, header: Header, rate_hz: float, *, dated: bool) -> Recording:
    """What is known of the recording."""
    file = scheme.file
    try:
        start_us = first_time(scheme.stream(FIRST_PAGES * SLOTS))
    except StopIteration:
        what, at = "holds no intact sample", header.data_start
        raise UnreadableError(what, path=file.path, byte_offset=at, hint=COPY_AGAIN) from None
    return Recording(
        path=file.path,
        format="genea",
        rate_hz=rate_hz,
        lsb_per_g=scheme.scale.lsb_per_g,
        total_bytes=file.size,
        device=header.device,
        range_g=RAW_LIMIT / RAW_PER_G,
        start_us=start_us if dated else None,
        duration_s=duration_s(scheme, start_us) if dated else None,
    )


def duration_s(scheme: Scheme, start_us: int) -> float | None:
    """From the first sample to the last time in the file and the samples behind it [s], None if not found."""
    file = scheme.file
    if file.compressed:
        return None
    last = None
    with closing(blocks_of_slots(file, max(0, file.data_pages() - LAST_PAGES))) as blocks:
        for slots in blocks:
            good, kind = sound(slots), kinds(slots)
            for at in np.flatnonzero(good & (kind == TIME))[-1:].tolist():
                rows = int((good & (kind == SAMPLE))[at:].sum())
                last = int(seconds(slots[at : at + 1])[0]) * MICROSECONDS + float(
                    scheme.spacing.rows_us(rows)
                )
    return None if last is None or last <= start_us else (last - start_us) / MICROSECONDS
