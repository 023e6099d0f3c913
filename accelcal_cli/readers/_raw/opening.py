"""An open raw dump: what its layout and its pages tell of the recording, and its rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from accelcal_cli.core.clock import rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Device, Problem, Reader, Recording
from accelcal_cli.readers._layout.find import find_layout, named_layout
from accelcal_cli.readers._layout.load import load_layout, plain_layout
from accelcal_cli.readers._layout.model import Layout
from accelcal_cli.readers._pages.blocks import PagedFile, paged_file
from accelcal_cli.readers._pages.coarse import CoarseTimeline
from accelcal_cli.readers._pages.pages import NO_TEMPERATURE
from accelcal_cli.readers._pages.reader import Opening, PagedReader, PageScheme, extent, look_inside
from accelcal_cli.readers._pages.timeline import (
    ExactTimeline,
    NominalTimeline,
    Spacing,
    Timeline,
)
from accelcal_cli.readers._raw.frames import FrameDecoder, unit_us
from accelcal_cli.readers._raw.values import FrameValues

NO_START = "the layout gives no start time and no page time: times count from 1970-01-01"


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a dump.

    Raises:
        UsageError: a faulty layout.
        UnreadableError: no layout (and not both rate and counts per g), or no page or frame is usable.
    """
    layout = layout_for(path, options)
    proved = layout.checksum is not None
    file = paged_file(path, layout.header_bytes, layout.block_bytes, proved=proved)
    scheme = page_scheme(file, layout)
    opening = look_inside(scheme)
    if opening is None:
        raise nothing_usable(file, layout)
    timed = layout.start is not None or layout.stamp is not None
    problems = () if timed else (Problem("no_start_time", NO_START, None, 0),)
    described = replace(recording(scheme, layout, opening, options), companion=find_layout(path, options))
    return PagedReader(described, scheme, opening, problems)


def layout_for(path: Path, options: ReadOptions) -> Layout:
    """The dump's layout, with the user's rate and counts per g before the file's."""
    found = find_layout(path, options)
    if found is None:
        if options.rate_hz is None or options.lsb_per_g is None:
            raise UnreadableError(
                "a raw dump does not say what it holds",
                path=path,
                hint=f"describe it with --layout FILE or in {named_layout(path).name} beside it; "
                "for plain int16 x, y, z, --rate and --lsb-per-g are enough",
            )
        return plain_layout(options.rate_hz, options.lsb_per_g)
    layout = load_layout(found)
    return replace(
        layout,
        rate_hz=options.rate_hz or layout.rate_hz,
        lsb_per_g=options.lsb_per_g or layout.lsb_per_g,
    )


def nothing_usable(file: PagedFile, layout: Layout) -> UnreadableError:
    """The error for a file without one usable sample, with the likeliest reason."""
    if layout.page_bytes and file.whole_pages == 0 and not file.compressed:
        return UnreadableError(
            f"holds no whole page of {layout.page_bytes} bytes after its header",
            path=file.path,
            byte_offset=layout.header_bytes,
            hint="check header_bytes and page_bytes of its layout",
        )
    crc = " and what page.crc covers" if layout.checksum else ""
    return UnreadableError(
        "holds no usable sample",
        path=file.path,
        byte_offset=layout.header_bytes,
        hint=f"check the sizes{crc} in its layout, or copy the file again from the device",
    )


def page_scheme(file: PagedFile, layout: Layout) -> PageScheme:
    """How this file's pages are read."""
    bits = 32 if layout.sequence is None else layout.sequence.bits
    spacing = Spacing(rate_fraction(layout.rate_hz), layout.page_frames, bits)
    return PageScheme(file, spacing, FrameDecoder(layout), lambda: timeline(layout, spacing))


def timeline(layout: Layout, spacing: Spacing) -> Timeline:
    """By page stamps where there are any, finer or coarser than a sample, else by counting."""
    if layout.stamp is None:
        return NominalTimeline(spacing, layout.start.start_us if layout.start else 0)
    unit = unit_us(layout.stamp)
    if unit <= float(spacing.rows_us(1)):
        return ExactTimeline(spacing)
    return CoarseTimeline(spacing, round(unit))


def recording(scheme: PageScheme, layout: Layout, opening: Opening, options: ReadOptions) -> Recording:
    """The file's description."""
    values, length = FrameValues(layout), extent(scheme, opening)
    start, stamped = layout.start, layout.stamp is not None
    zone = None if stamped or start is None else start.timezone
    ignored = ("start_time of the layout is not used: the pages carry their own times",)
    return Recording(
        path=scheme.file.path,
        format="raw",
        rate_hz=layout.rate_hz,
        lsb_per_g=values.lsb_per_g,
        total_bytes=scheme.file.size,
        device=Device(layout.model, layout.serial, layout.firmware),
        range_g=layout.range_g,
        start_us=opening.start_us if stamped or start else None,
        timezone=options.timezone or zone,
        samples=length.samples,
        duration_s=length.duration_s,
        has_temperature=opening.temperature_mc != NO_TEMPERATURE,
        gyro_dps_per_lsb=values.dps_per_lsb,
        notes=ignored if stamped and start else (),
    )
