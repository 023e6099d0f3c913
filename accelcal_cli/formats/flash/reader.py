"""Reads a dump in the flash page format of docs/flash-format.md: header page and data pages."""

from __future__ import annotations

import struct
import zlib
from contextlib import closing
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, WIDEST_OFFSET_H, rate_fraction
from accelcal_cli.core.errors import COPY_AGAIN, UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.recording import Device, Problem, Reader, Recording
from accelcal_cli.formats._bytes import ByteSource
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages.files import PagedFile, RawBlock
from accelcal_cli.formats._pages.pages import Decoded, PageBlock
from accelcal_cli.formats._pages.reader import FixedPages, PageDecoder
from accelcal_cli.formats._pages.timeline import ExactTimeline, Spacing
from accelcal_cli.formats._rows import MISSING
from accelcal_cli.formats.flash import HEADER_MAGIC, PAGE_BYTES, PAGE_MAGIC, SAMPLES, recording_id_of

NOT_MEASURED, FLAG_FRESH, CRC_AT = -32768, 1, PAGE_BYTES - 4
PAGE = np.dtype(
    [
        *(("magic", "S4"), ("recording_id", "<u4"), ("sequence", "<u4"), ("seconds", "<u4")),
        *(("microseconds", "<u4"), ("temperature", "<i2"), ("samples", "<u2"), ("flags", "<u4")),
        *(("xyz", "<i2", (SAMPLES, 3)), ("crc", "<u4")),
    ]
)

VERSION, FLAG_TEMPERATURE, FLAG_CLOCK_NEVER_SET, ZONE_UNKNOWN = 1, 1, 2, -32768
LONGEST_ZONE_MINUTES = 60 * WIDEST_OFFSET_H
RATES_HZ = (Fraction(1, 1000), Fraction(100_000))

LAYOUT = struct.Struct("<8sHHIIIIIIIhH32s32s32s")

SEARCHED_PAGES = 512
"""Pages that are read at a time in search of a valid one."""

NO_START = "the device's clock was never set: times count from its start"


class FlashDecoder(PageDecoder[RawBlock]):
    """Decodes blocks of data pages; those with another number than `recording_id` are left out."""

    def __init__(self, recording_id: int, has_temperature: bool) -> None:
        self._recording_id, self._has_temperature = recording_id, has_temperature

    def decode(self, raw: RawBlock) -> Decoded:
        """See PageDecoder."""
        status = page_status(raw.pages, self._recording_id)
        pages = raw.pages if not status.any() else raw.pages[status == paged.GOOD]
        position = raw.first_position + np.flatnonzero(status == paged.GOOD)
        block = as_block(pages.view(PAGE)[:, 0], position, self._has_temperature)
        return Decoded(block, paged.bad_runs(status, raw.first_position), raw.tail)


def page_status(pages: NDArray[np.uint8], recording_id: int) -> NDArray[np.uint8]:
    """Return GOOD or a key of BAD_KINDS for each page, (p,)."""
    fields = pages.view(PAGE)[:, 0]
    status = np.full(len(pages), paged.GOOD, np.uint8)
    status[fields["recording_id"] != recording_id] = paged.FOREIGN
    status[~sensible(fields)] = paged.NONSENSE
    status[paged.crc32_pages(pages, 0, CRC_AT) != fields["crc"]] = paged.CHECKSUM
    status[paged.erased_pages(pages)] = paged.ERASED
    return status


def sensible(fields: NDArray[np.void]) -> NDArray[np.bool_]:
    """Mark the pages that are data pages with possible values, (p,)."""
    counted = (fields["samples"] >= 1) & (fields["samples"] <= SAMPLES)
    return np.asarray((fields["magic"] == PAGE_MAGIC) & counted & (fields["microseconds"] < MICROSECONDS))


def as_block(fields: NDArray[np.void], position: NDArray[np.int64], has_temperature: bool) -> PageBlock:
    """Return valid pages as columns."""
    rows = fields["samples"].astype(np.int64)
    slots, channels = fields["xyz"].astype(np.int16), {}
    full = bool((rows == SAMPLES).all())
    if has_temperature:
        raw = fields["temperature"].astype(np.int32)
        milli = np.where(raw == NOT_MEASURED, np.int32(MISSING), (raw * 1000 + 64) >> 7).astype(np.int32)
        channels["temperature_mc"] = np.repeat(milli, rows)
    return PageBlock(
        position=position,
        rows=rows,
        counts=slots.reshape(-1, 3) if full else slots[np.arange(SAMPLES) < rows[:, None]],
        sequence=fields["sequence"].astype(np.int64),
        time_us=fields["seconds"].astype(np.int64) * MICROSECONDS + fields["microseconds"],
        fresh=(fields["flags"] & FLAG_FRESH) != 0,
        channels=channels,
    )


@dataclass(frozen=True, slots=True)
class FlashHeader:
    """The header, page 0.

    Attributes:
        recording_id: number that stands in every data page of the recording.
        timezone: `UTC` or an offset such as `+01:00`; None if unknown.
        clock_set: False if the times count from power-on.
    """

    recording_id: int
    rate: Fraction
    lsb_per_g: Fraction
    range_g: float | None
    has_temperature: bool
    clock_set: bool
    timezone: str | None
    device: Device


class HeaderDamageError(Exception):
    """A page is not a usable header; the message says why."""


def parse_header(page: bytes) -> FlashHeader:
    """Decode page 0; raises HeaderDamageError if it is cut off, damaged, or says something impossible."""
    if len(page) < PAGE_BYTES:
        raise HeaderDamageError(f"it is cut off after {len(page)} of {PAGE_BYTES} bytes")
    fields = LAYOUT.unpack_from(page)
    if fields[0] != HEADER_MAGIC:
        raise HeaderDamageError("it does not begin with the format's signature")
    if zlib.crc32(page[:-4]) != int.from_bytes(page[-4:], "little"):
        raise HeaderDamageError("its checksum is wrong")
    if fields[1:3] != (VERSION, PAGE_BYTES):
        what = f"format version {fields[1]} with pages of {fields[2]} bytes"
        raise HeaderDamageError(f"{what} is not supported")
    rate, lsb_per_g = positive(fields[4:6], "sampling rate"), positive(fields[6:8], "number of counts per g")
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise HeaderDamageError(f"a sampling rate of {float(rate):g} Hz is impossible")
    texts = [fields[place].split(b"\0")[0] for place in (13, 12, 14)]
    return FlashHeader(
        recording_id=fields[3],
        rate=rate,
        lsb_per_g=lsb_per_g,
        range_g=fields[8] / 1000 or None,
        has_temperature=bool(fields[9] & FLAG_TEMPERATURE),
        clock_set=not fields[9] & FLAG_CLOCK_NEVER_SET,
        timezone=zone_name(fields[10]),
        device=Device(*(text.decode("ascii", "replace").strip() or None for text in texts)),
    )


def positive(pair: tuple[int, int], what: str) -> Fraction:
    """Return the exact fraction of numerator and denominator, both above 0."""
    if 0 in pair:
        raise HeaderDamageError(f"the {what} is {pair[0]}/{pair[1]}")
    return Fraction(*pair)


def zone_name(minutes: int) -> str | None:
    """Return the zone of an offset east of UTC [minutes], None if it is impossible."""
    if abs(minutes) > LONGEST_ZONE_MINUTES:
        return None
    hours, rest = divmod(abs(minutes), 60)
    return f"{'-' if minutes < 0 else '+'}{hours:02d}:{rest:02d}" if minutes else "UTC"


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a dump; `Format.open` says what is raised."""
    with ByteSource(path) as stream:
        page = stream.read_exact(PAGE_BYTES)
    file = PagedFile.at(path, PAGE_BYTES, PAGE_BYTES)
    try:
        header, problems = parse_header(page), []
    except HeaderDamageError as error:
        header = substitute(file, options, error)
        problems = [Problem("damaged_header", f"the header page is not usable: {error}", 0, 0)]
    if options.rate_hz is not None:
        header = replace(header, rate=rate_fraction(agreed_rate(options, float(header.rate), path)))
    if options.lsb_per_g is not None:
        header = replace(header, lsb_per_g=Fraction(options.lsb_per_g))
    spacing = Spacing(header.rate, SAMPLES)
    decoder = FlashDecoder(header.recording_id, header.has_temperature)
    scheme = FixedPages(file, spacing, lambda: decoder, lambda: ExactTimeline(spacing))
    opening = scheme.look_inside()
    if opening is None:
        raise UnreadableError("has no valid data page", path=path, byte_offset=PAGE_BYTES, hint=COPY_AGAIN)
    if not header.clock_set:
        problems.append(Problem("no_start_time", NO_START, 0, 0))
    about = Recording(
        path=path,
        format="flash",
        rate_hz=float(header.rate),
        lsb_per_g=float(header.lsb_per_g),
        total_bytes=file.size,
        device=header.device,
        range_g=header.range_g,
        timezone=header.timezone,
    )
    return scheme.reader(opening, about, problems, dated=header.clock_set)


def substitute(file: PagedFile, options: ReadOptions, error: HeaderDamageError) -> FlashHeader:
    """Return a header from the user's options, in place of a damaged one; raises UnreadableError without."""
    if options.rate_hz is None or options.lsb_per_g is None:
        what = f"the header page is not usable: {error}"
        hint = "give --rate and --lsb-per-g to read the data without it"
        raise UnreadableError(what, path=file.path, byte_offset=0, hint=hint)
    with closing(file.blocks(file.amount(SEARCHED_PAGES))) as blocks:
        numbers = (recording_id_of(page.tobytes()) for raw in blocks for page in raw.pages)
        number = next((number for number in numbers if number is not None), 0)
    return FlashHeader(
        recording_id=number,
        rate=rate_fraction(options.rate_hz),
        lsb_per_g=Fraction(options.lsb_per_g),
        range_g=None,
        has_temperature=True,
        clock_set=True,
        timezone=None,
        device=Device(),
    )
