"""Reads a GENEA file: its header, the factory's calibration, and its six-byte slots.

g = (raw + offset) * gain / 8192 / 340 for each axis, with the header's offsets and gains. The values stay
whole numbers on one grid for all axes, gain * (raw + offset), until the calibration is applied.

A page of 2048 bytes has 341 slots and two bytes more. A slot is a CRC-8 of the five bytes after it, the kind
in four bits, and its content: three times 12 bits of acceleration, or the time in whole seconds, big-endian.
A time stands before the samples of its second. Sources: github.com/wadpac/GGIRread, R/readGenea.R; the
checksum (polynomial 0x85, start 0, most significant bit first) was found from its sample file, where it holds
for all slots.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, reduce
from itertools import pairwise
from math import gcd
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import COPY_AGAIN, UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate, probe_file
from accelcal_cli.core.recording import Chunk, Device, Problem, Reader, Recording, clipped_at
from accelcal_cli.formats._pages.files import PagedFile, PageFile, ScannedPages
from accelcal_cli.formats._pages.pages import GOOD, NONSENSE, Decoded, PageBlock, bad_runs
from accelcal_cli.formats._pages.reader import BROKEN_OFF, PageDecoder, PagedReader, PageScheme
from accelcal_cli.formats._pages.timeline import CoarseTimeline, Spacing

GAIN_UNIT, RAW_PER_G = 8192, 340
RAW_LIMIT = 1 << 11
GAINS = (GAIN_UNIT // 2, 2 * GAIN_UNIT)
RATES_HZ = (1.0, 1000.0)

PAGE_BYTES, SLOT_BYTES = 2048, 6
SLOTS = PAGE_BYTES // SLOT_BYTES
SAMPLE, TIME = 0, 2
CRC8_POLYNOMIAL = 0x85
LONGEST_S = 8
"""Longest group [s]; a longer one is cut, so that lost times do not fill the memory."""

LOOKED_AT_PAGES, LAST_PAGES = 256, 32
"""Pages that are read at a time in search of the first time, and at the end in search of the last."""

NO_START = "no time is intact: times count from the beginning of the recording"
_END = re.compile(rb"\r?\n\r?\n")
_LINE = re.compile(rb"(?m)^([A-Za-z -]{1,40}):([^\r\n]*)")
_RATE = re.compile(r"(\d{1,4}(?:\.\d{1,3})?) ?Hz", re.IGNORECASE)
_TRIPLE = re.compile(r"\s*(-?\d{1,6})\s+(-?\d{1,6})\s+(-?\d{1,6})\s*")

Slots = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Header:
    """The text before the page at `data_start`; a field is None if it is missing or impossible."""

    data_start: int
    rate_hz: float | None
    gains: tuple[int, ...] | None
    offsets: tuple[int, ...] | None
    device: Device


def parse_header(head: bytes) -> Header | None:
    """Read the lines of `key:value` in a file's first bytes, up to an empty one; None if there is none."""
    end = _END.search(head)
    if end is None:
        return None
    found = _LINE.findall(head, 0, end.start())
    values = {key.decode("ascii"): value.decode("ascii", "replace").strip() for key, value in found}
    rate = _RATE.fullmatch(values.get("Sample-Rate", ""))
    rate_hz = float(rate[1]) if rate else 0.0
    gains, offsets = (_triple(values.get(f"Accel-{name}", "")) for name in ("Gains", "Offsets"))
    return Header(
        data_start=end.end(),
        rate_hz=rate_hz if RATES_HZ[0] <= rate_hz <= RATES_HZ[1] else None,
        gains=gains if gains and all(GAINS[0] <= gain <= GAINS[1] for gain in gains) else None,
        offsets=offsets if offsets and all(abs(offset) <= RAW_PER_G for offset in offsets) else None,
        device=Device("GENEA", values.get("Serial-Number") or None, values.get("Firmware-Version") or None),
    )


def _triple(text: str) -> tuple[int, ...] | None:
    match = _TRIPLE.fullmatch(text)
    return tuple(map(int, match.groups())) if match else None


@dataclass(frozen=True, slots=True)
class Scale:
    """Converts raw values to counts, slope * (raw + offset), of which `lsb_per_g` are 1 g."""

    lsb_per_g: float
    slopes: tuple[int, ...] = (1, 1, 1)
    offsets: tuple[int, ...] = (0, 0, 0)

    def applied(self, chunk: Chunk) -> Chunk:
        """Return raw values as counts, with rows marked that reach the end of 12 bits."""
        chunk = clipped_at(chunk, 1 - RAW_LIMIT, RAW_LIMIT - 1)
        if self.slopes == (1, 1, 1) and not any(self.offsets):
            return chunk
        offsets, slopes = np.array(self.offsets, np.int32), np.array(self.slopes, np.int32)
        return replace(chunk, counts=(chunk.counts.astype(np.int32) + offsets) * slopes)


def scale_of(header: Header, options: ReadOptions, path: Path) -> Scale:
    """Return the user's counts per g for the raw values, else the factory's calibration, if there is one."""
    if options.lsb_per_g is not None:
        return Scale(options.lsb_per_g)
    if header.gains is None or header.offsets is None:
        what = "the factory's gains and offsets of x, y and z are missing from the header or impossible"
        hint = f"give --lsb-per-g to read the raw values (about {RAW_PER_G})"
        raise UnreadableError(what, path=path, byte_offset=0, hint=hint)
    common = reduce(gcd, header.gains)
    slopes = tuple(gain // common for gain in header.gains)
    return Scale(GAIN_UNIT * RAW_PER_G / common, slopes, header.offsets)


@cache
def crc8_positions() -> NDArray[np.uint8]:
    """Return what value v at each of the five places adds to the checksum, (5, 256)."""
    state = np.arange(256)
    table = np.empty((SLOT_BYTES - 1, 256), np.uint8)
    for place in range(SLOT_BYTES - 2, -1, -1):
        for _ in range(8):
            state = (state << 1 ^ np.where(state & 0x80, CRC8_POLYNOMIAL, 0)) & 0xFF
        table[place] = state
    return table


def sound(slots: Slots) -> NDArray[np.bool_]:
    """Mark the slots (n, 6) whose checksum is right, (n,); empty slots, whose checksum is 0, are not."""
    total = np.zeros(len(slots), np.uint8)
    for place, table in enumerate(crc8_positions(), 1):
        total ^= table[slots[:, place]]
    return np.asarray((total == slots[:, 0]) & slots.any(axis=1))


def kinds(slots: Slots) -> NDArray[np.uint8]:
    """Return the kind of each slot, (n,)."""
    return np.asarray(slots[:, 1] >> 4)


def seconds(slots: Slots) -> NDArray[np.int64]:
    """Return the seconds since 1970 of slots that hold a time, (n,)."""
    return np.ascontiguousarray(slots[:, 2:]).view(">u4")[:, 0].astype(np.int64)


def raw_values(slots: Slots) -> NDArray[np.int16]:
    """Return raw x, y, z of slots that hold a sample, (n, 3); the signs of x and z are changed."""
    one, two, three, four, five = slots[:, 1:].T.astype(np.int16)
    x, y, z = (one & 15) << 8 | two, three << 4 | four >> 4, (four & 15) << 8 | five
    signed = (np.stack((x, y, z), axis=1) ^ 0x800) - 0x800
    return np.asarray(signed * np.array((-1, 1, -1), np.int16))


def page_slots(pages: NDArray[np.uint8]) -> Slots:
    """Return all slots of pages (p, 2048), (n, 6)."""
    return pages[:, : SLOTS * SLOT_BYTES].reshape(-1, SLOT_BYTES)


def empty_pages(pages: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Mark the pages that hold nothing but 0x00 or 0xFF, (p,)."""
    empty: NDArray[np.bool_] = np.isin(pages[:, 0], (0, 0xFF)) & (pages[:, 0] == pages[:, -1])
    candidates = np.flatnonzero(empty)
    empty[candidates] = (pages[candidates] == pages[candidates, :1]).all(axis=1)
    return empty


def tail_slots(tail: bytes) -> Slots:
    """Return the whole slots of an incomplete page, (n, 6)."""
    count = min(len(tail) // SLOT_BYTES, SLOTS)
    return np.frombuffer(tail, np.uint8, count * SLOT_BYTES).reshape(-1, SLOT_BYTES)


def used(slots: Slots) -> int:
    """Return the number of slots before those at the end that hold nothing but 0x00 or 0xFF."""
    written = np.flatnonzero(~((slots == 0).all(axis=1) | (slots == 0xFF).all(axis=1)))
    return int(written[-1]) + 1 if len(written) else 0


NO_SLOTS = np.empty((0, SLOT_BYTES), np.uint8)


@dataclass(slots=True)
class SampleGroups(ScannedPages):
    """Samples from one time to the next, each such group a page; and bytes of an incomplete page at the end.

    Groups are numbered from the first page of this stretch on, and their counts are raw values.
    """

    blocks: list[PageBlock] = field(default_factory=list)
    tail: bytes = b""


class Grouper:
    """Cuts the slots of a file into groups; a Scanner.

    Empty pages are damage only where others follow them. The first sample's time is by the first in the file.
    """

    def __init__(self, spacing: Spacing, start_byte: int, next_us: int) -> None:
        self._spacing, self._start_byte, self._next_us = spacing, start_byte, next_us
        self._longest = LONGEST_S * spacing.rows
        self._rest, self._open = b"", NO_SLOTS
        self._page = self._first = 0
        self._empty: list[int] = []

    def feed(self, data: bytes, *, last: bool) -> SampleGroups:
        """See Scanner."""
        data, groups = self._rest + data, SampleGroups()
        whole = len(data) // PAGE_BYTES
        pages = np.frombuffer(data, np.uint8, whole * PAGE_BYTES).reshape(whole, PAGE_BYTES)
        self._rest = data[whole * PAGE_BYTES :]
        erased = empty_pages(pages)
        edges = [0, *(np.flatnonzero(np.diff(erased)) + 1).tolist(), whole]
        for begin, end in pairwise(edges):
            if begin < end and erased[begin]:
                self._take(NO_SLOTS, 0, groups, last=True)
                self._empty += range(self._page + begin, self._page + end)
            elif begin < end:
                self._pass_over(groups)
                self._take(page_slots(pages[begin:end]), self._page + begin, groups, last=False)
        self._page += whole
        if last:
            groups.tail, tail = self._rest, tail_slots(self._rest)
            if used(tail):
                self._pass_over(groups)
            self._take(tail, self._page, groups, last=True)
        return groups

    def _pass_over(self, groups: SampleGroups) -> None:
        """Add empty pages, now that others follow them."""
        for page in self._empty:
            groups.add(NONSENSE, self._offset(page * SLOTS), self._offset((page + 1) * SLOTS))
        self._next_us += len(self._empty) * round(float(self._spacing.rows_us(SLOTS)))
        self._empty = []

    def _take(self, new: Slots, page: int, groups: SampleGroups, *, last: bool) -> None:
        """Add the groups that end within the open one and new slots; all but unused slots if none follow."""
        first = self._first if len(self._open) else page * SLOTS
        slots = np.concatenate((self._open, new))
        slots = slots[: used(slots)] if last else slots
        good, kind = sound(slots), kinds(slots)
        begins = good & (kind == TIME)
        edges = self._edges(begins)
        if not last:  # the last group stays open: its samples may continue in the next pages
            edges = edges[:-1] if len(slots) - edges[-2] <= self._longest else edges
        end = int(edges[-1])
        self._open, self._first = slots[end:].copy(), first + end
        is_row = ~good | (kind == SAMPLE)
        rows = np.diff(np.concatenate(([0], np.cumsum(is_row)))[edges])
        time_us = self._times(slots, begins, edges, rows)
        filled = np.flatnonzero(rows > 0)
        taken = slots[:end][is_row[:end]]
        block = PageBlock(len(groups.status) + np.arange(len(filled)), rows[filled], raw_values(taken))
        faulty = ~good[:end][is_row[:end]]
        groups.blocks.append(replace(block, time_us=time_us[filled], faulty=faulty))
        for group in filled.tolist():
            groups.add(GOOD, *(self._offset(first + int(edge)) for edge in edges[group : group + 2]))

    def _edges(self, begins: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return where groups begin, and the end of all slots; at least two numbers."""
        marks = np.unique(np.concatenate(([0], np.flatnonzero(begins))))
        sizes = np.diff(marks, append=len(begins))
        if sizes.max() > self._longest:
            ends = zip(marks.tolist(), (marks + np.maximum(sizes, 1)).tolist(), strict=True)
            marks = np.concatenate([np.arange(at, end, self._longest) for at, end in ends])
        return np.append(marks, len(begins))

    def _times(
        self, slots: Slots, begins: NDArray[np.bool_], edges: NDArray[np.int64], rows: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return each group's own time [us], else one by the next group, else one by the group before."""
        if not len(rows):
            return np.empty(0, np.int64)
        own = np.append(begins, False)[edges]
        known = np.concatenate((slots, np.zeros((1, SLOT_BYTES), np.uint8)))[edges]
        stamps = seconds(known) * MICROSECONDS
        lasted = np.rint(self._spacing.rows_us(rows)).astype(np.int64)
        time_us = stamps[:-1].copy()
        for group in np.flatnonzero(~own[:-1]).tolist():
            before = self._next_us if group == 0 else int(time_us[group - 1] + lasted[group - 1])
            time_us[group] = stamps[group + 1] - lasted[group] if own[group + 1] else before
        self._next_us = int(time_us[-1] + lasted[-1])
        return time_us

    def _offset(self, slot: int) -> int:
        """Return where a slot lies in the (uncompressed) file."""
        page, within = divmod(slot, SLOTS)
        return self._start_byte + page * PAGE_BYTES + within * SLOT_BYTES


NO_NUMBERS = np.empty(0, np.int64)
NO_GROUPS = PageBlock(
    NO_NUMBERS, NO_NUMBERS, np.empty((0, 3), np.int16), time_us=NO_NUMBERS, faulty=np.empty(0, np.bool_)
)


class GroupDecoder(PageDecoder[SampleGroups]):
    """Turns groups of raw values into counts."""

    def __init__(self, scale: Scale) -> None:
        self._scale = scale

    def decode(self, groups: SampleGroups) -> Decoded:
        """See PageDecoder."""
        block = reduce(PageBlock.followed_by, groups.blocks, NO_GROUPS)
        block = replace(block, position=groups.first_position + block.position)
        return Decoded(block, bad_runs(np.array(groups.status, np.uint8), groups.first_position))

    def finish(self, chunk: Chunk) -> Chunk:
        """See PageDecoder."""
        return self._scale.applied(replace(chunk, used_bytes=len(chunk) * SLOT_BYTES))

    def ending(self, groups: SampleGroups, sample: int) -> tuple[Problem, ...]:
        """See PageDecoder."""
        tail = groups.tail
        offset = groups.end - len(tail)
        if groups.broken:
            return (Problem("truncated", BROKEN_OFF, offset, sample, 1, groups.undecoded),)
        if not tail.strip(b"\0") or not tail.strip(b"\xff"):
            return ()
        text = f"the file ends within a page, of which it has {len(tail)} of {PAGE_BYTES} bytes"
        lost = len(tail) % SLOT_BYTES if len(tail) < SLOTS * SLOT_BYTES else 0
        return (Problem("truncated", text, offset, sample, 1, lost),)


@dataclass(frozen=True, slots=True)
class SlotScheme(PageScheme[SampleGroups]):
    """Describes how the slots of one file are read, which is also one of `pages` of 2048 bytes."""

    file: PageFile[SampleGroups]
    pages: PagedFile

    def amount(self, chunk_samples: int) -> int:
        """Return the bytes of whole pages of 2048 bytes."""
        return self.pages.amount(chunk_samples // SLOTS)

    def pieces(self, chunk_samples: int, pieces: int) -> Iterator[tuple[int, SampleGroups]]:
        """Enter at evenly spread pages of 2048 bytes."""
        pages, total = max(1, chunk_samples // SLOTS), self.pages.whole_pages
        if self.pages.compressed or total < pieces * pages:
            return
        for position in (piece * total // pieces for piece in range(pieces)):
            offset = self.pages.offset(position)
            data = self.file.read(offset, pages * PAGE_BYTES)
            groups = self.file.scanner(offset).feed(data, last=True)
            yield position * SLOTS, groups.alone(offset + len(data))


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a recording; `Format.open` says what is raised."""
    header = parse_header(probe_file(path, options).head)
    if header is None:
        what = "has no GENEA header, or one without an empty line at its end"
        raise UnreadableError(what, path=path, byte_offset=0, hint=COPY_AGAIN)
    rate_hz = options.rate_hz if header.rate_hz is None else agreed_rate(options, header.rate_hz, path)
    if rate_hz is None:
        what = "the sampling rate is missing from the header or impossible"
        raise UnreadableError(what, path=path, byte_offset=0, hint="give it with --rate")
    spacing = Spacing(Fraction(rate_hz).limit_denominator(1000), max(1, round(rate_hz)))
    pages = PagedFile.at(path, header.data_start, PAGE_BYTES)
    before = rows_before_the_first_time(pages)
    start_us = 0 if before is None else before[1] - round(float(spacing.rows_us(before[0])))
    scale = scale_of(header, options, path)
    scanner, group_bytes = (lambda start: Grouper(spacing, start, start_us)), SLOT_BYTES * spacing.rows
    scheme = SlotScheme(
        PageFile(path, header.data_start, group_bytes, pages.size, pages.compressed, scanner),
        spacing,
        decoder=lambda: GroupDecoder(scale),
        timeline=lambda: CoarseTimeline(spacing, MICROSECONDS),
        pages=pages,
        problems=() if before else (Problem("no_start_time", NO_START, None, 0),),
    )
    about = describe(scheme, header, rate_hz, scale.lsb_per_g)
    about = about if before else replace(about, start_us=None, duration_s=None)
    return PagedReader(about, scheme)


def blocks_of_slots(file: PagedFile, first_position: int = 0) -> Generator[Slots]:
    """Yield the slots of all pages from one on, (n, 6) at a time."""
    with closing(file.blocks(file.amount(LOOKED_AT_PAGES), first_position)) as blocks:
        for raw in blocks:
            yield np.concatenate((page_slots(raw.pages), tail_slots(raw.tail)))


def rows_before_the_first_time(file: PagedFile) -> tuple[int, int] | None:
    """Return the number of samples before the first time, and that time [us]; None if there is none."""
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


def describe(scheme: SlotScheme, header: Header, rate_hz: float, lsb_per_g: float) -> Recording:
    """Describe the recording, whose times may prove to have no date; there has to be a sample."""
    file = scheme.file
    try:
        start_us = scheme.first_time_us()
    except StopIteration:
        what, at = "holds no intact sample", header.data_start
        raise UnreadableError(what, path=file.path, byte_offset=at, hint=COPY_AGAIN) from None
    return Recording(
        path=file.path,
        format="genea",
        rate_hz=rate_hz,
        lsb_per_g=lsb_per_g,
        total_bytes=file.size,
        device=header.device,
        range_g=RAW_LIMIT / RAW_PER_G,
        start_us=start_us,
        duration_s=duration_s(scheme, start_us),
    )


def duration_s(scheme: SlotScheme, start_us: int) -> float | None:
    """Return the time from the first sample to the end of the last second [s], None if not found."""
    file = scheme.pages
    if file.compressed:
        return None
    last = None
    with closing(blocks_of_slots(file, max(0, file.data_pages() - LAST_PAGES))) as blocks:
        for slots in blocks:
            good, kind = sound(slots), kinds(slots)
            for at in np.flatnonzero(good & (kind == TIME))[-1:].tolist():
                lasted_us = float(scheme.spacing.rows_us(int((good & (kind == SAMPLE))[at:].sum())))
                last = int(seconds(slots[at : at + 1])[0]) * MICROSECONDS + lasted_us
    return None if last is None or last <= start_us else (last - start_us) / MICROSECONDS
