"""Reads a raw dump: decodes its pages and frames as its layout says.

`FrameValues` takes counts and the other channels out of frames, `FrameDecoder` frames out of pages.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import (
    FLOAT_LSB_PER_G,
    Channels,
    Counts,
    Device,
    Problem,
    Reader,
    Recording,
    first_row,
)
from accelcal_cli.formats._pages import pages as paged
from accelcal_cli.formats._pages import timeline as timelines
from accelcal_cli.formats._pages.files import PagedFile, RawBlock
from accelcal_cli.formats._pages.pages import Decoded, PageBlock
from accelcal_cli.formats._pages.reader import FixedPages, PageDecoder, PagedReader
from accelcal_cli.formats._rows import MISSING, first_values
from accelcal_cli.formats.raw import find_layout, named_layout
from accelcal_cli.formats.raw.layout import (
    AXES,
    CHANNEL_FIELDS,
    GYRO,
    Checksum,
    Field,
    Layout,
    Stamp,
    load_layout,
    plain_layout,
)

LARGEST_G = 127.0
FLOAT_DPS_PER_LSB = 2.0**-16
LARGEST_DPS = 32_767.0

INT24 = "int24"
INT24_RANGE = (-(1 << 23), (1 << 23) - 1)
SMALL, WIDE = np.iinfo(np.int16), np.iinfo(np.int32)

UNUSED_FRAMES = 8
"""Least number of erased frames at the end of a page that are unused memory, not measurements."""

NO_START = "the layout gives no start time and no page time: times count from 1970-01-01"


def number_type(endian: str, kind: str) -> np.dtype[np.generic]:
    """Return the numpy type of a layout's number type."""
    return np.dtype(kind).newbyteorder("<" if endian == "little" else ">")


def whole_range(field: Field, zero: int) -> tuple[int, int]:
    """Return the smallest and largest count of a whole-number field after subtracting `zero`."""
    if field.type == INT24:
        low, high = INT24_RANGE
    else:
        info = np.iinfo(field.type)
        low, high = int(info.min), int(info.max)
    return low - zero, high - zero


class FrameValues:
    """Takes values out of frames.

    Whole-number accelerations stay counts. If any axis is float32, all become counts of
    FLOAT_LSB_PER_G; a gyroscope with float32 axes becomes counts of FLOAT_DPS_PER_LSB.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._axes = tuple(layout.fields[name] for name in AXES)
        self._rates = tuple(layout.fields[name] for name in GYRO if name in layout.fields)
        self._float_axes = any(field.type == "float32" for field in self._axes)
        self._float_rates = any(field.type == "float32" for field in self._rates)
        self._record = record_type(layout)
        self._axis_ranges = [] if self._float_axes else [whole_range(f, int(f.zero)) for f in self._axes]
        self._rate_ranges = [] if self._float_rates else [whole_range(f, -rate_zero(f)) for f in self._rates]

    @property
    def lsb_per_g(self) -> float:
        """Counts in one g."""
        return FLOAT_LSB_PER_G if self._float_axes else self._layout.lsb_per_g

    @property
    def zero_counts(self) -> tuple[int, int, int]:
        """Counts of a frame of zeros."""
        frames = np.zeros((1, self._layout.frame_bytes), np.uint8)
        return first_row(self.counts(self.records(frames), np.zeros(1, np.bool_)))

    @property
    def dps_per_lsb(self) -> tuple[float, float, float] | None:
        """deg/s in one count of each gyroscope axis, None without a gyroscope."""
        if not self._rates:
            return None
        x, y, z = (FLOAT_DPS_PER_LSB if self._float_rates else field.scale for field in self._rates)
        return x, y, z

    @property
    def may_fail(self) -> bool:
        """Return True if a row can hold something that is not a usable number."""
        ranges = [*self._axis_ranges, *self._rate_ranges]
        beyond = any(low < WIDE.min or high > WIDE.max for low, high in ranges)
        return self._float_axes or self._float_rates or beyond

    def records(self, frames: NDArray[np.uint8]) -> NDArray[np.void]:
        """Return frames (n, frame_bytes) as records (n,)."""
        return np.ascontiguousarray(frames).view(self._record)[:, 0]

    def counts(self, records: NDArray[np.void], faulty: NDArray[np.bool_]) -> Counts:
        """Return accelerations (n, 3), and mark rows without a usable one in `faulty` (n,)."""
        if not self._float_axes:
            zeros = [int(field.zero) for field in self._axes]
            return self._whole(records, AXES, zeros, self._axis_ranges, faulty)
        columns = [
            (self._raw_float(records, name) - field.zero) / self._layout.lsb_per_g
            for name, field in zip(AXES, self._axes, strict=True)
        ]
        return on_grid(columns, LARGEST_G, 1 / FLOAT_LSB_PER_G, faulty)

    def channels(self, records: NDArray[np.void], faulty: NDArray[np.bool_]) -> Channels:
        """Return the other channels, MISSING where not measured; `faulty` is as in `counts`."""
        single = [name for name in CHANNEL_FIELDS if name in self._layout.fields]
        channels: Channels = {CHANNEL_FIELDS[name][0]: self._single(records, name) for name in single}
        return channels | ({"gyro_counts": self._rotation(records, faulty)} if self._rates else {})

    def _rotation(self, records: NDArray[np.void], faulty: NDArray[np.bool_]) -> Counts:
        if not self._float_rates:
            zeros = [-rate_zero(field) for field in self._rates]
            return self._whole(records, GYRO, zeros, self._rate_ranges, faulty)
        columns = [
            self._raw_float(records, name) * field.scale + field.zero
            for name, field in zip(GYRO, self._rates, strict=True)
        ]
        return on_grid(columns, LARGEST_DPS, FLOAT_DPS_PER_LSB, faulty)

    def _single(self, records: NDArray[np.void], name: str) -> NDArray[np.int32]:
        """Return a field of CHANNEL_FIELDS as its channel, (n,)."""
        field, (_, per_unit, largest) = self._layout.fields[name], CHANNEL_FIELDS[name]
        raw = self._raw_float(records, name)
        values = (raw * field.scale + field.zero) * per_unit
        measured = np.abs(values) <= largest
        whole = np.rint(np.where(measured, values, 0))
        return np.where(measured, whole, MISSING).astype(np.int32)

    def _raw_float(self, records: NDArray[np.void], name: str) -> NDArray[np.float64]:
        """Return one field as floats, (n,)."""
        with np.errstate(invalid="ignore"):  # of some kinds of NaN, which stay NaN
            return self._raw(records, name).astype(np.float64)

    def _raw(self, records: NDArray[np.void], name: str) -> NDArray[Any]:
        """Return one field as numbers, (n,)."""
        if self._layout.fields[name].type != INT24:
            return np.asarray(records[name])
        order = slice(None) if self._layout.endian == "little" else slice(None, None, -1)
        low, middle, high = records[name][:, order].T.astype(np.int32)
        return np.asarray(low | middle << 8 | (high ^ 0x80) - 0x80 << 16)

    def _whole(
        self,
        records: NDArray[np.void],
        names: tuple[str, ...],
        zeros: list[int],
        ranges: list[tuple[int, int]],
        faulty: NDArray[np.bool_],
    ) -> Counts:
        small = all(SMALL.min <= low and high <= SMALL.max for low, high in ranges)
        counts = np.empty((len(records), 3), np.int16 if small else np.int32)
        for axis, (name, zero, (low, high)) in enumerate(zip(names, zeros, ranges, strict=True)):
            raw = self._raw(records, name)
            shifted = raw.astype(np.int64) - zero if zero else raw
            if low < WIDE.min or high > WIDE.max:
                faulty |= (shifted < WIDE.min) | (shifted > WIDE.max)
            counts[:, axis] = shifted
        return counts


def record_type(layout: Layout) -> np.dtype[np.void]:
    """Return the numpy record of a frame."""
    fields = layout.fields
    formats = [
        np.dtype((np.uint8, (3,))) if field.type == INT24 else number_type(layout.endian, field.type)
        for field in fields.values()
    ]
    offsets = [field.offset for field in fields.values()]
    return np.dtype(
        {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": layout.frame_bytes}
    )


def rate_zero(field: Field) -> int:
    """Return a gyroscope's `zero` in whole counts."""
    return round(field.zero / field.scale)


def on_grid(
    columns: list[NDArray[np.float64]], largest: float, step: float, faulty: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Return values as whole steps, (n, 3), and mark rows with one that is not a number or too large."""
    counts = np.zeros((len(faulty), 3), np.int32)
    for axis, column in enumerate(columns):
        usable = np.abs(column) <= largest
        faulty |= ~usable
        counts[usable, axis] = np.rint(column[usable] / step)
    return counts


class FrameDecoder(PageDecoder[RawBlock]):
    """Decodes blocks of pages; a stream is taken in stretches like pages."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._values = FrameValues(layout)

    def decode(self, raw: RawBlock) -> Decoded:
        """See PageDecoder."""
        pages, leftover, end_rows = self._with_tail(raw)
        limit = np.full(len(pages), self._layout.page_frames, np.int64)
        if end_rows:
            limit[-1] = end_rows
        status = self._status(pages)
        rows = self._used_rows(pages, limit, status)
        unused_end = bool((rows < limit)[-1:].any())
        good = status == paged.GOOD
        runs = paged.bad_runs(status, raw.first_position)
        if not good.all():
            pages, rows = pages[good], rows[good]
        block = self._block(pages, rows, raw.first_position + np.flatnonzero(good))
        return Decoded(block, runs, leftover, unused_end)

    def _with_tail(self, raw: RawBlock) -> tuple[NDArray[np.uint8], bytes, int]:
        """Return pages, bytes that fill no frame, and the frames of the last page if a stream ends in it."""
        frames = 0 if self._layout.page_bytes else len(raw.tail) // self._layout.frame_bytes
        if not frames:
            return raw.pages, raw.tail, 0
        used = frames * self._layout.frame_bytes
        # the end of a stream is treated as a page whose last frames are erased
        filled = raw.tail[:used].ljust(self._layout.block_bytes, b"\xff")
        last = np.frombuffer(filled, np.uint8)[None]
        return np.concatenate((raw.pages, last)), raw.tail[used:], frames

    def _status(self, pages: NDArray[np.uint8]) -> NDArray[np.uint8]:
        status = np.full(len(pages), paged.GOOD, np.uint8)
        if self._layout.checksum is not None:
            status[~self._intact(pages, self._layout.checksum)] = paged.CHECKSUM
        status[paged.erased_pages(pages)] = paged.ERASED
        return status

    def _intact(self, pages: NDArray[np.uint8], crc: Checksum) -> NDArray[np.bool_]:
        """Mark the pages whose checksum is right, (p,)."""
        if crc.type == "crc32":
            actual: NDArray[np.unsignedinteger] = paged.crc32_pages(pages, crc.start, crc.stop)
            return np.asarray(actual == self._page_value(pages, crc.offset, "uint32"))
        actual = paged.crc16_pages(pages, crc.start, crc.stop)
        return np.asarray(actual == self._page_value(pages, crc.offset, "uint16"))

    def _page_value(self, pages: NDArray[np.uint8], offset: int, kind: str) -> NDArray[np.int64]:
        """Return a whole number at one place of every page, (p,)."""
        code = number_type(self._layout.endian, kind)
        data = np.ascontiguousarray(pages[:, offset : offset + code.itemsize])
        return data.view(code)[:, 0].astype(np.int64)

    def _frames(self, pages: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the frames of each page, (p, frames, frame_bytes)."""
        layout = self._layout
        start = layout.page_header_bytes
        used = pages[:, start : start + layout.page_frames * layout.frame_bytes]
        return used.reshape(len(pages), layout.page_frames, layout.frame_bytes)

    def _used_rows(
        self, pages: NDArray[np.uint8], limit: NDArray[np.int64], status: NDArray[np.uint8]
    ) -> NDArray[np.int64]:
        """Return the number of frames in each page before erased ones at its end, (p,); mark empty pages."""
        frames = self._frames(pages)
        rows = limit.copy()
        ended = (frames[:, -UNUSED_FRAMES:] == 0xFF).all(axis=(1, 2)) & (status == paged.GOOD)
        for page in np.flatnonzero(ended).tolist():
            used = np.flatnonzero((frames[page] != 0xFF).any(axis=1))
            last = int(used[-1]) + 1 if len(used) else 0
            if rows[page] - last >= UNUSED_FRAMES:
                rows[page] = last
        status[(rows == 0) & (status == paged.GOOD)] = paged.NONSENSE
        return rows

    def _block(
        self, pages: NDArray[np.uint8], rows: NDArray[np.int64], position: NDArray[np.int64]
    ) -> PageBlock:
        layout, values = self._layout, self._values
        frames = self._frames(pages)
        if (rows == layout.page_frames).all():
            table = frames.reshape(-1, layout.frame_bytes)
        else:
            table = frames[np.arange(layout.page_frames) < rows[:, None]]
        records = values.records(table)
        faulty = np.zeros(len(table), np.bool_)
        sequence = layout.sequence
        return PageBlock(
            position=position,
            rows=rows,
            counts=values.counts(records, faulty),
            sequence=None if sequence is None else self._page_value(pages, sequence.offset, sequence.type),
            time_us=None if layout.stamp is None else self._stamps(pages, layout.stamp),
            channels=values.channels(records, faulty),
            faulty=faulty if values.may_fail else None,
        )

    def _stamps(self, pages: NDArray[np.uint8], stamp: Stamp) -> NDArray[np.int64]:
        """Return the time of each page [us since 1970], (p,)."""
        unit = unit_us(stamp)
        raw = self._page_value(pages, stamp.offset, stamp.type)
        whole, rest = np.divmod(raw, unit.denominator)
        return np.asarray(whole * unit.numerator + rest * unit.numerator // unit.denominator)


def unit_us(stamp: Stamp) -> Fraction:
    """Return the microseconds in one unit of a stamp."""
    return (Fraction(repr(stamp.per_unit)) * MICROSECONDS).limit_denominator(1 << 20)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a dump.

    Raises:
        UsageError: a faulty layout.
        UnreadableError: no layout (and not both rate and counts per g), or no page or frame is usable.
    """
    layout = layout_for(path, options)
    proved = layout.checksum is not None
    file = PagedFile.at(path, layout.header_bytes, layout.block_bytes, proved=proved)
    scheme = page_scheme(file, layout)
    opening = scheme.look_inside()
    if opening is None:
        raise nothing_usable(file, layout)
    timed = layout.start is not None or layout.stamp is not None
    problems = () if timed else (Problem("no_start_time", NO_START, None, 0),)
    scheme = replace(scheme, first_values=first_values(opening.channels), problems=problems)
    described = replace(recording(scheme, layout, opening), companion=find_layout(path, options))
    return PagedReader(described, scheme)


def layout_for(path: Path, options: ReadOptions) -> Layout:
    """Return the dump's layout; the user's rate and counts per g take precedence over it."""
    layout_path = find_layout(path, options)
    if layout_path is None:
        if options.rate_hz is None or options.lsb_per_g is None:
            raise UnreadableError(
                "a raw dump does not say what it holds",
                path=path,
                hint=f"describe it with --layout FILE or in {named_layout(path).name} next to it; "
                "for plain int16 x, y, z, --rate and --lsb-per-g are enough",
            )
        return plain_layout(options.rate_hz, options.lsb_per_g)
    layout = load_layout(layout_path)
    return replace(
        layout,
        rate_hz=options.rate_hz or layout.rate_hz,
        lsb_per_g=options.lsb_per_g or layout.lsb_per_g,
    )


def nothing_usable(file: PagedFile, layout: Layout) -> UnreadableError:
    """Return the error for a file without any usable sample, with the likeliest reason."""
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


def page_scheme(file: PagedFile, layout: Layout) -> FixedPages:
    """Return how this file's pages are read."""
    bits = 32 if layout.sequence is None else layout.sequence.bits
    spacing = timelines.Spacing(rate_fraction(layout.rate_hz), layout.page_frames, bits)
    decoder = FrameDecoder(layout)
    return FixedPages(file, spacing, lambda: decoder, lambda: timeline(layout, spacing))


def timeline(layout: Layout, spacing: timelines.Spacing) -> timelines.PageTimeline:
    """Return a timeline by page stamps, finer or coarser than a sample, or by counting if there are none."""
    if layout.stamp is None:
        return timelines.NominalTimeline(spacing, layout.start.start_us if layout.start else 0)
    unit = unit_us(layout.stamp)
    if unit <= float(spacing.rows_us(1)):
        return timelines.ExactTimeline(spacing)
    return timelines.CoarseTimeline(spacing, round(unit))


def recording(scheme: FixedPages, layout: Layout, opening: PageBlock) -> Recording:
    """Describe the recording."""
    values, (samples, duration_s) = FrameValues(layout), scheme.extent(opening)
    start, stamped = layout.start, layout.stamp is not None
    zone = "UTC" if stamped else None if start is None else start.timezone
    ignored = ("start_time of the layout is not used: the pages carry their own times",)
    return Recording(
        path=scheme.file.path,
        format="raw",
        rate_hz=layout.rate_hz,
        lsb_per_g=values.lsb_per_g,
        total_bytes=scheme.file.size,
        device=Device(layout.model, layout.serial, layout.firmware),
        range_g=layout.range_g,
        start_us=scheme.timeline().start(opening) if stamped or start else None,
        timezone=zone,
        has_offsets=not stamped and start is not None and start.had_offset,
        samples=samples,
        duration_s=duration_s,
        has_temperature=scheme.first_values.get("temperature_mc") is not None,
        gyro_dps_per_lsb=values.dps_per_lsb,
        zero_counts=values.zero_counts,
        notes=ignored if stamped and start else (),
    )
