"""Decodes the pages of a raw dump as its layout says."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.readers._crc import crc16_pages, crc32_pages
from accelcal_cli.readers._layout.model import Checksum, Layout, Stamp
from accelcal_cli.readers._pages.blocks import RawBlock, erased_pages
from accelcal_cli.readers._pages.pages import (
    CHECKSUM,
    ERASED,
    GOOD,
    NONSENSE,
    Decoded,
    PageBlock,
    bad_runs,
)
from accelcal_cli.readers._raw.values import FrameValues, number_type

UNUSED_FRAMES = 8
"""So many erased frames in a row at the end of a page are unused memory, not measurements."""


class FrameDecoder:
    """Decodes blocks of pages; makes no difference between pages and stretches of a stream."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._values = FrameValues(layout)

    def __call__(self, raw: RawBlock) -> Decoded:
        """The valid pages of a block."""
        pages, leftover, end_rows = self._with_tail(raw)
        limit = np.full(len(pages), self._layout.page_frames, np.int64)
        if end_rows:
            limit[-1] = end_rows
        status = self._status(pages)
        rows = self._used_rows(pages, limit, status)
        unused_end = bool((rows < limit)[-1:].any())
        good = status == GOOD
        runs = bad_runs(status, raw.first_position)
        if not good.all():
            pages, rows = pages[good], rows[good]
        block = self._block(pages, rows, raw.first_position + np.flatnonzero(good))
        return Decoded(block, runs, leftover, unused_end)

    def _with_tail(self, raw: RawBlock) -> tuple[NDArray[np.uint8], bytes, int]:
        """Pages, bytes that fill no frame, and the frames of the last page if a stream ends in it."""
        frames = 0 if self._layout.page_bytes else len(raw.tail) // self._layout.frame_bytes
        if not frames:
            return raw.pages, raw.tail, 0
        used = frames * self._layout.frame_bytes
        filled = raw.tail[:used].ljust(self._layout.block_bytes, b"\xff")
        last = np.frombuffer(filled, np.uint8)[None]
        return np.concatenate((raw.pages, last)), raw.tail[used:], frames

    def _status(self, pages: NDArray[np.uint8]) -> NDArray[np.uint8]:
        status = np.full(len(pages), GOOD, np.uint8)
        if self._layout.checksum is not None:
            status[~self._intact(pages, self._layout.checksum)] = CHECKSUM
        status[erased_pages(pages)] = ERASED
        return status

    def _intact(self, pages: NDArray[np.uint8], crc: Checksum) -> NDArray[np.bool_]:
        """Which pages have the right checksum."""
        if crc.type == "crc32":
            found: NDArray[np.unsignedinteger] = crc32_pages(pages, crc.start, crc.stop)
            return np.asarray(found == self._page_value(pages, crc.offset, "uint32"))
        found = crc16_pages(pages, crc.start, crc.stop)
        return np.asarray(found == self._page_value(pages, crc.offset, "uint16"))

    def _page_value(self, pages: NDArray[np.uint8], offset: int, kind: str) -> NDArray[np.int64]:
        """A whole number at one place of every page, (p,)."""
        code = number_type(self._layout.endian, kind)
        data = np.ascontiguousarray(pages[:, offset : offset + code.itemsize])
        return data.view(code)[:, 0].astype(np.int64)

    def _frames(self, pages: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The frames of each page, (p, frames, frame_bytes)."""
        layout = self._layout
        start = layout.page_header_bytes
        used = pages[:, start : start + layout.page_frames * layout.frame_bytes]
        return used.reshape(len(pages), layout.page_frames, layout.frame_bytes)

    def _used_rows(
        self, pages: NDArray[np.uint8], limit: NDArray[np.int64], status: NDArray[np.uint8]
    ) -> NDArray[np.int64]:
        """Frames of each page without the erased ones at its end, (p,); marks pages without any."""
        frames = self._frames(pages)
        rows = limit.copy()
        ended = (frames[:, -UNUSED_FRAMES:] == 0xFF).all(axis=(1, 2)) & (status == GOOD)
        for page in np.flatnonzero(ended).tolist():
            used = np.flatnonzero((frames[page] != 0xFF).any(axis=1))
            last = int(used[-1]) + 1 if len(used) else 0
            if rows[page] - last >= UNUSED_FRAMES:
                rows[page] = last
        status[(rows == 0) & (status == GOOD)] = NONSENSE
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
            temperature_mc=values.temperature_mc(records),
            gyro=values.gyro(records, faulty),
            faulty=faulty if values.may_fail else None,
        )

    def _stamps(self, pages: NDArray[np.uint8], stamp: Stamp) -> NDArray[np.int64]:
        """Time of each page [us since 1970], (p,)."""
        unit = unit_us(stamp)
        raw = self._page_value(pages, stamp.offset, stamp.type)
        whole, rest = np.divmod(raw, unit.denominator)
        return np.asarray(whole * unit.numerator + rest * unit.numerator // unit.denominator)


def unit_us(stamp: Stamp) -> Fraction:
    """Microseconds in one unit of a stamp."""
    return (Fraction(repr(stamp.per_unit)) * MICROSECONDS).limit_denominator(1 << 20)
