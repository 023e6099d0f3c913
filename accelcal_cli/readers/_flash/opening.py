"""An open dump of flash pages: what is known of the recording, and its rows."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from accelcal_cli.core.clock import rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.recording import Device, Problem, Reader, Recording
from accelcal_cli.readers._flash.header import FlashHeader, HeaderDamageError, parse_header
from accelcal_cli.readers._flash.pages import SAMPLES, FlashDecoder, first_recording_id
from accelcal_cli.readers._flash.signature import PAGE_BYTES
from accelcal_cli.readers._pages.blocks import PagedFile, paged_file
from accelcal_cli.readers._pages.pages import NO_TEMPERATURE
from accelcal_cli.readers._pages.reader import Opening, PagedReader, PageScheme, extent, look_inside
from accelcal_cli.readers._pages.timeline import ExactTimeline, Spacing
from accelcal_cli.readers._stream import ByteSource

SEARCHED_PAGES = 512
COPY_AGAIN = "copy it again from the device"
NO_START = "the device's clock was never set: times count from its start"


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a dump.

    Raises:
        UnreadableError: the header is damaged and rate or counts per g are not given, or no data
            page is valid.
        UsageError: the rates contradict each other.
    """
    with ByteSource(path) as stream:
        page = stream.read_exact(PAGE_BYTES)
    file = paged_file(path, PAGE_BYTES, PAGE_BYTES)
    try:
        header, problems = parse_header(page), []
    except HeaderDamageError as error:
        header = substitute(file, options, error)
        problems = [Problem("damaged_header", f"the header page is not usable: {error}", 0, 0)]
    header = overridden(header, options, path)
    scheme = page_scheme(file, header)
    opening = look_inside(scheme)
    if opening is None:
        raise UnreadableError("has no valid data page", path=path, byte_offset=PAGE_BYTES, hint=COPY_AGAIN)
    if not header.clock_set:
        problems.append(Problem("no_start_time", NO_START, 0, 0))
    return PagedReader(recording(scheme, header, opening), scheme, opening, tuple(problems))


def substitute(file: PagedFile, options: ReadOptions, error: HeaderDamageError) -> FlashHeader:
    """A header from what the user said, where the file's own is damaged."""
    if options.rate_hz is None or options.lsb_per_g is None:
        raise UnreadableError(
            f"the header page is not usable: {error}",
            path=file.path,
            byte_offset=0,
            hint="give --rate and --lsb-per-g to read the data without it",
        )
    with closing(file.blocks(SEARCHED_PAGES)) as blocks:
        found = (first_recording_id(raw.pages) for raw in blocks)
        number = next((number for number in found if number is not None), 0)
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


def overridden(header: FlashHeader, options: ReadOptions, path: Path) -> FlashHeader:
    """What the user says goes before what the file says.

    Raises:
        UsageError: the rates contradict each other.
    """
    if options.rate_hz is not None:
        header = replace(header, rate=rate_fraction(agreed_rate(options, float(header.rate), path)))
    if options.lsb_per_g is not None:
        header = replace(header, lsb_per_g=Fraction(options.lsb_per_g))
    return replace(header, timezone=options.timezone or header.timezone)


def page_scheme(file: PagedFile, header: FlashHeader) -> PageScheme:
    """How this file's pages are read."""
    spacing = Spacing(header.rate, SAMPLES)
    decoder = FlashDecoder(header.recording_id, header.has_temperature)
    return PageScheme(file, spacing, decoder, lambda: ExactTimeline(spacing))


def recording(scheme: PageScheme, header: FlashHeader, opening: Opening) -> Recording:
    """The file's description."""
    length = extent(scheme, opening)
    return Recording(
        path=scheme.file.path,
        format="flash",
        rate_hz=float(header.rate),
        lsb_per_g=float(header.lsb_per_g),
        total_bytes=scheme.file.size,
        device=header.device,
        range_g=header.range_g,
        start_us=opening.start_us if header.clock_set else None,
        timezone=header.timezone,
        samples=length.samples,
        duration_s=length.duration_s,
        has_temperature=opening.temperature_mc != NO_TEMPERATURE,
    )
