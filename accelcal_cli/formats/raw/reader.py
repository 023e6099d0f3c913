"""Reads a raw dump: decodes its pages and frames as its layout says.

`Axes` makes counts of a sensor's three fields, `FrameValues` takes these and the other channels out of
frames, and `FrameDecoder` takes frames out of pages.
"""

from __future__ import annotations

from collections.abc import Callable
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
from accelcal_cli.formats._pages.reader import FixedPages, PageDecoder
from accelcal_cli.formats._rows import MISSING
from accelcal_cli.formats.raw import find_layout, named_layout
from accelcal_cli.formats.raw.layout import (
    AXES,
    CHANNEL_FIELDS,
    GYRO,
    Field,
    Layout,
    load_layout,
    plain_layout,
)

LARGEST_G, FLOAT_DPS_PER_LSB, LARGEST_DPS = 127.0, 2.0**-16, 32_767.0
INT24 = "int24"
INT24_RANGE = (-(1 << 23), (1 << 23) - 1)
SMALL, WIDE = np.iinfo(np.int16), np.iinfo(np.int32)

UNUSED_FRAMES = 8
"""Least number of erased frames at the end of a page that are unused memory, not measurements."""

NO_START = "the layout gives no start time and no page time: times count from 1970-01-01"


def number_type(layout: Layout, kind: str) -> np.dtype[np.generic]:
    """Return the numpy type of a layout's number type."""
    return np.dtype(kind).newbyteorder("<" if layout.endian == "little" else ">")


Physical = Callable[[NDArray[np.float64], Field], NDArray[np.float64]]


def numbers(records: NDArray[np.void], name: str, layout: Layout) -> NDArray[Any]:
    """Return one field of records as the numbers that it holds, (n,)."""
    if layout.fields[name].type != INT24:
        return np.asarray(records[name])
    order = slice(None) if layout.endian == "little" else slice(None, None, -1)
    low, middle, high = records[name][:, order].T.astype(np.int32)
    return np.asarray(low | middle << 8 | (high ^ 0x80) - 0x80 << 16)


def floats(records: NDArray[np.void], name: str, layout: Layout) -> NDArray[np.float64]:
    """Return one field of records as floats, (n,)."""
    with np.errstate(invalid="ignore"):  # of some kinds of NaN, which stay NaN
        return numbers(records, name, layout).astype(np.float64)


class Axes:
    """Makes counts of the three fields of a sensor.

    Whole numbers stay counts, less their zeros. If any field is float32, all become counts of a fixed step.

    Args:
        zeros: counts of each whole number that stand for 0.
        physical, largest, step: makes physical values of float fields; the largest one that is possible; and
            the size of a count.
    """

    def __init__(
        self,
        layout: Layout,
        names: tuple[str, ...],
        zeros: Callable[[Field], int],
        physical: Physical,
        largest: float,
        step: float,
    ) -> None:
        self._layout, self._names = layout, names
        self._physical, self._largest, self._step = physical, largest, step
        self.fields = [layout.fields[name] for name in names]
        self.is_float = any(field.type == "float32" for field in self.fields)
        whole = [] if self.is_float else self.fields
        self._zeros = [zeros(field) for field in whole]
        limits = zip(map(type_range, whole), self._zeros, strict=True)
        self._ranges = [(low - zero, high - zero) for (low, high), zero in limits]

    @property
    def may_fail(self) -> bool:
        """Return True if a row can hold something that is not a usable number."""
        return self.is_float or any(low < WIDE.min or high > WIDE.max for low, high in self._ranges)

    def counts(self, records: NDArray[np.void], faulty: NDArray[np.bool_]) -> Counts:
        """Return counts (n, 3), and mark rows without a usable number in `faulty` (n,)."""
        if self.is_float:
            return self._on_grid(records, faulty)
        small = all(SMALL.min <= low and high <= SMALL.max for low, high in self._ranges)
        counts = np.empty((len(records), 3), np.int16 if small else np.int32)
        for axis, (name, zero) in enumerate(zip(self._names, self._zeros, strict=True)):
            raw, (low, high) = numbers(records, name, self._layout), self._ranges[axis]
            shifted = raw.astype(np.int64) - zero if zero else raw
            if low < WIDE.min or high > WIDE.max:
                faulty |= (shifted < WIDE.min) | (shifted > WIDE.max)
            counts[:, axis] = shifted
        return counts

    def _on_grid(self, records: NDArray[np.void], faulty: NDArray[np.bool_]) -> Counts:
        counts = np.zeros((len(records), 3), np.int32)
        for axis, (name, field) in enumerate(zip(self._names, self.fields, strict=True)):
            values = self._physical(floats(records, name, self._layout), field)
            usable = np.abs(values) <= self._largest
            faulty |= ~usable
            counts[usable, axis] = np.rint(values[usable] / self._step)
        return counts


class FrameValues:
    """Takes values out of frames; accelerations are in counts of FLOAT_LSB_PER_G if any is float32."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._record = record_type(layout)
        self.accel = Axes(
            layout,
            AXES,
            lambda field: int(field.zero),
            lambda raw, field: (raw - field.zero) / layout.lsb_per_g,
            LARGEST_G,
            1 / FLOAT_LSB_PER_G,
        )
        self.gyro = Axes(
            layout,
            tuple(name for name in GYRO if name in layout.fields),
            lambda field: -round(field.zero / field.scale),
            lambda raw, field: raw * field.scale + field.zero,
            LARGEST_DPS,
            FLOAT_DPS_PER_LSB,
        )

    @property
    def lsb_per_g(self) -> float:
        """Counts in one g."""
        return FLOAT_LSB_PER_G if self.accel.is_float else self._layout.lsb_per_g

    @property
    def zero_counts(self) -> tuple[int, int, int]:
        """Counts of a frame of zeros."""
        frames = np.zeros((1, self._layout.frame_bytes), np.uint8)
        return first_row(self.accel.counts(self.records(frames), np.zeros(1, np.bool_)))

    @property
    def dps_per_lsb(self) -> tuple[float, float, float] | None:
        """deg/s in one count of each gyroscope axis, None without a gyroscope."""
        if not self.gyro.fields:
            return None
        x, y, z = (FLOAT_DPS_PER_LSB if self.gyro.is_float else field.scale for field in self.gyro.fields)
        return x, y, z

    def records(self, frames: NDArray[np.uint8]) -> NDArray[np.void]:
        """Return frames (n, frame_bytes) as records (n,)."""
        return np.ascontiguousarray(frames).view(self._record)[:, 0]

    def channels(self, records: NDArray[np.void], faulty: NDArray[np.bool_]) -> Channels:
        """Return the other channels, MISSING where not measured; `faulty` is as in `Axes.counts`."""
        channels: Channels = {}
        for name, (channel, per_unit, largest) in CHANNEL_FIELDS.items():
            if (field := self._layout.fields.get(name)) is not None:
                raw = floats(records, name, self._layout)
                values = (raw * field.scale + field.zero) * per_unit
                measured = np.abs(values) <= largest
                whole = np.rint(np.where(measured, values, 0))
                channels[channel] = np.where(measured, whole, MISSING).astype(np.int32)
        if self.gyro.fields:
            channels["gyro_counts"] = self.gyro.counts(records, faulty)
        return channels


def type_range(field: Field) -> tuple[int, int]:
    """Return the smallest and the largest number of a whole type."""
    if field.type == INT24:
        return INT24_RANGE
    info = np.iinfo(field.type)
    return int(info.min), int(info.max)


def record_type(layout: Layout) -> np.dtype[np.void]:
    """Return the numpy record of a frame."""
    fields = layout.fields
    formats = [
        np.dtype((np.uint8, (3,))) if field.type == INT24 else number_type(layout, field.type)
        for field in fields.values()
    ]
    offsets = [field.offset for field in fields.values()]
    return np.dtype(
        {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": layout.frame_bytes}
    )


class FrameDecoder(PageDecoder[RawBlock]):
    """Decodes blocks of pages; a stream is taken in stretches like pages."""

    def __init__(self, layout: Layout) -> None:
        self._layout, self._values = layout, FrameValues(layout)

    def decode(self, raw: RawBlock) -> Decoded:
        """See PageDecoder."""
        pages, leftover, end_rows = self._with_tail(raw)
        limit = np.full(len(pages), self._layout.page_frames, np.int64)
        if end_rows:
            limit[-1] = end_rows
        status = np.full(len(pages), paged.GOOD, np.uint8)
        if (crc := self._layout.page.get("crc")) is not None:
            checksums = paged.crc32_pages if crc.type == "crc32" else paged.crc16_pages
            status[checksums(pages, *crc.covers) != self._page_value(pages, crc)] = paged.CHECKSUM
        status[paged.erased_pages(pages)] = paged.ERASED
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
        last = np.frombuffer(raw.tail[:used].ljust(self._layout.block_bytes, b"\xff"), np.uint8)[None]
        return np.concatenate((raw.pages, last)), raw.tail[used:], frames

    def _page_value(self, pages: NDArray[np.uint8], field: Field) -> NDArray[np.int64]:
        """Return a whole number at one place of every page, (p,)."""
        code = number_type(self._layout, f"uint{8 * field.bytes}")
        data = np.ascontiguousarray(pages[:, field.offset : field.offset + field.bytes])
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
        sequence, stamp, time_us = layout.page.get("sequence"), layout.page.get("time"), None
        if stamp is not None:
            unit = unit_us(stamp)
            whole, rest = np.divmod(self._page_value(pages, stamp), unit.denominator)
            time_us = np.asarray(whole * unit.numerator + rest * unit.numerator // unit.denominator)
        return PageBlock(
            position=position,
            rows=rows,
            counts=values.accel.counts(records, faulty),
            sequence=None if sequence is None else self._page_value(pages, sequence),
            time_us=time_us,
            channels=values.channels(records, faulty),
            faulty=faulty if values.accel.may_fail or values.gyro.may_fail else None,
        )


def unit_us(stamp: Field) -> Fraction:
    """Return the microseconds in one unit of a stamp."""
    return (Fraction(repr(stamp.scale)) * MICROSECONDS).limit_denominator(1 << 20)


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a dump; `Format.open` says what is raised."""
    layout = layout_for(path, options)
    file = PagedFile.at(path, layout.header_bytes, layout.block_bytes, proved="crc" in layout.page)
    scheme = page_scheme(file, layout)
    opening = scheme.look_inside()
    if opening is None:
        raise nothing_usable(file, layout)
    values, start, stamped = FrameValues(layout), layout.start, "time" in layout.page
    ignored = ("start_time of the layout is not used: the pages carry their own times",)
    about = Recording(
        path=path,
        format="raw",
        rate_hz=layout.rate_hz,
        lsb_per_g=values.lsb_per_g,
        total_bytes=file.size,
        device=Device(layout.model, layout.serial, layout.firmware),
        range_g=layout.range_g,
        timezone="UTC" if stamped else None if start is None else start.timezone,
        has_offsets=not stamped and start is not None and start.had_offset,
        gyro_dps_per_lsb=values.dps_per_lsb,
        companion=find_layout(path, options),
        zero_counts=values.zero_counts,
        notes=ignored if stamped and start else (),
    )
    timed = stamped or start is not None
    problems = () if timed else (Problem("no_start_time", NO_START, None, 0),)
    return scheme.reader(opening, about, problems, dated=timed)


def layout_for(path: Path, options: ReadOptions) -> Layout:
    """Return the dump's layout; the user's rate and counts per g take precedence over it."""
    layout_path = find_layout(path, options)
    if layout_path is None:
        if options.rate_hz is None or options.lsb_per_g is None:
            how = f"describe it with --layout FILE or in {named_layout(path).name} next to it; "
            hint = f"{how}for plain int16 x, y, z, --rate and --lsb-per-g are enough"
            raise UnreadableError("a raw dump does not say what it holds", path=path, hint=hint)
        return plain_layout(options.rate_hz, options.lsb_per_g)
    layout = load_layout(layout_path)
    rate_hz, lsb_per_g = options.rate_hz or layout.rate_hz, options.lsb_per_g or layout.lsb_per_g
    return replace(layout, rate_hz=rate_hz, lsb_per_g=lsb_per_g)


def nothing_usable(file: PagedFile, layout: Layout) -> UnreadableError:
    """Return the error for a file without any usable sample, with the likeliest reason."""
    crc = " and what page.crc covers" if "crc" in layout.page else ""
    hint = f"check the sizes{crc} in its layout, or copy the file again from the device"
    what = "holds no usable sample"
    if layout.page_bytes and file.whole_pages == 0 and not file.compressed:
        what = f"holds no whole page of {layout.page_bytes} bytes after its header"
        hint = "check header_bytes and page_bytes of its layout"
    return UnreadableError(what, path=file.path, byte_offset=layout.header_bytes, hint=hint)


def page_scheme(file: PagedFile, layout: Layout) -> FixedPages:
    """Return how pages are read: timed by their stamps, finer or coarser than a sample, or by counting."""
    sequence, stamp = layout.page.get("sequence"), layout.page.get("time")
    bits = 32 if sequence is None else 8 * sequence.bytes
    spacing = timelines.Spacing(rate_fraction(layout.rate_hz), layout.page_frames, bits)
    decoder = FrameDecoder(layout)

    def timeline() -> timelines.PageTimeline:
        if stamp is None:
            return timelines.NominalTimeline(spacing, layout.start.start_us if layout.start else 0)
        unit = unit_us(stamp)
        if unit <= float(spacing.rows_us(1)):
            return timelines.ExactTimeline(spacing)
        return timelines.CoarseTimeline(spacing, round(unit))

    return FixedPages(file, spacing, lambda: decoder, timeline)
