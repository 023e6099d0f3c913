"""The data pages of the flash page format: see docs/flash-format.md."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.readers._crc import crc32_pages
from accelcal_cli.readers._flash.signature import PAGE_BYTES, PAGE_MAGIC
from accelcal_cli.readers._pages.blocks import RawBlock, erased_pages
from accelcal_cli.readers._pages.pages import (
    CHECKSUM,
    ERASED,
    FOREIGN,
    GOOD,
    NO_TEMPERATURE,
    NONSENSE,
    Decoded,
    PageBlock,
    bad_runs,
)

SAMPLES = 80
NOT_MEASURED = -32768
FLAG_FRESH = 1
CRC_AT = PAGE_BYTES - 4

PAGE = np.dtype(
    [
        ("magic", "S4"),
        ("recording_id", "<u4"),
        ("sequence", "<u4"),
        ("seconds", "<u4"),
        ("microseconds", "<u4"),
        ("temperature", "<i2"),
        ("samples", "<u2"),
        ("flags", "<u4"),
        ("xyz", "<i2", (SAMPLES, 3)),
        ("crc", "<u4"),
    ]
)


class FlashDecoder:
    """Decodes blocks of data pages.

    Args:
        recording_id: pages with another number are left out.
    """

    def __init__(self, recording_id: int, has_temperature: bool) -> None:
        self._recording_id = recording_id
        self._has_temperature = has_temperature

    def __call__(self, raw: RawBlock) -> Decoded:
        """The valid pages of a block; an incomplete page at its end is left over."""
        status = page_status(raw.pages, self._recording_id)
        pages = raw.pages if not status.any() else raw.pages[status == GOOD]
        position = raw.first_position + np.flatnonzero(status == GOOD)
        block = as_block(pages.view(PAGE)[:, 0], position, self._has_temperature)
        return Decoded(block, bad_runs(status, raw.first_position), raw.tail)


def page_status(pages: NDArray[np.uint8], recording_id: int) -> NDArray[np.uint8]:
    """GOOD or a key of BAD_KINDS for each page, (p,)."""
    fields = pages.view(PAGE)[:, 0]
    status = np.full(len(pages), GOOD, np.uint8)
    status[fields["recording_id"] != recording_id] = FOREIGN
    status[~sensible(fields)] = NONSENSE
    status[crc32_pages(pages, 0, CRC_AT) != fields["crc"]] = CHECKSUM
    status[erased_pages(pages)] = ERASED
    return status


def sensible(fields: NDArray[np.void]) -> NDArray[np.bool_]:
    """Which pages are data pages with possible values, (p,)."""
    counted = (fields["samples"] >= 1) & (fields["samples"] <= SAMPLES)
    return np.asarray((fields["magic"] == PAGE_MAGIC) & counted & (fields["microseconds"] < MICROSECONDS))


def as_block(fields: NDArray[np.void], position: NDArray[np.int64], has_temperature: bool) -> PageBlock:
    """Columns of valid pages."""
    rows = fields["samples"].astype(np.int64)
    slots = fields["xyz"].astype(np.int16)
    full = bool((rows == SAMPLES).all())
    return PageBlock(
        position=position,
        rows=rows,
        counts=slots.reshape(-1, 3) if full else slots[np.arange(SAMPLES) < rows[:, None]],
        sequence=fields["sequence"].astype(np.int64),
        time_us=fields["seconds"].astype(np.int64) * MICROSECONDS + fields["microseconds"],
        fresh=(fields["flags"] & FLAG_FRESH) != 0,
        temperature_mc=temperature_mc(fields, rows) if has_temperature else None,
    )


def temperature_mc(fields: NDArray[np.void], rows: NDArray[np.int64]) -> NDArray[np.int32]:
    """Each sample's temperature, that of its page [thousandths of a degree C], (n,)."""
    raw = fields["temperature"].astype(np.int32)
    milli = np.where(raw == NOT_MEASURED, np.int32(NO_TEMPERATURE), (raw * 1000 + 64) >> 7)
    return np.repeat(milli.astype(np.int32), rows)


def first_recording_id(pages: NDArray[np.uint8]) -> int | None:
    """Recording number of the first page whose checksum is right; None without one."""
    fields = pages.view(PAGE)[:, 0]
    good = sensible(fields)
    good[good] = crc32_pages(pages[good], 0, CRC_AT) == fields["crc"][good]
    return int(fields["recording_id"][good][0]) if good.any() else None


def recording_id_in(data: bytes) -> int | None:
    """Recording number of the first valid data page among whole pages."""
    whole = len(data) // PAGE_BYTES
    pages = np.frombuffer(data, np.uint8, whole * PAGE_BYTES).reshape(whole, PAGE_BYTES)
    return first_recording_id(pages) if whole else None
