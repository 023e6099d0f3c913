"""Writes the flash page format of docs/flash-format.md.

A page ends where it is full and where the recording has a break. Each page is stamped with the
time of its first sample; its temperature is the mean of its samples.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, rate_fraction
from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.formats import Encoder
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.formats._writing import (
    OTHER_FORMAT,
    check_bits,
    fixed_offset,
    new_file,
    page_means_mc,
    page_runs,
)
from accelcal_cli.formats.flash import HEADER_MAGIC, PAGE_BYTES, PAGE_MAGIC, SAMPLES
from accelcal_cli.formats.flash import reader as flash

RECORDING_ID, LARGEST = 1, (1 << 32) - 1
INT16 = np.iinfo(np.int16)


def write(path: Path, recording: Recording, chunks: Iterable[Chunk]) -> None:
    """Write all chunks to `path`; raises OutputError for a count or a time that does not fit."""
    with new_file(path) as file:
        file.write(header_page(path, recording))
        sequence = 0
        for rows in page_runs(chunks, SAMPLES):
            pages = data_pages(path, rows, sequence)
            file.write(pages.data)
            sequence += len(pages)


def header_page(path: Path, recording: Recording) -> bytes:
    """Return page 0."""
    flags = flash.FLAG_TEMPERATURE * recording.has_temperature
    flags |= flash.FLAG_CLOCK_NEVER_SET * (recording.start_us is None)
    device = recording.device
    page = flash.LAYOUT.pack(
        HEADER_MAGIC,
        flash.VERSION,
        PAGE_BYTES,
        RECORDING_ID,
        *exact(path, recording.rate_hz, "sampling rate"),
        *exact(path, recording.lsb_per_g, "number of counts per g"),
        round((recording.range_g or 0) * 1000),
        flags,
        zone_minutes(recording.timezone),
        0,
        *(
            (one or "").encode("ascii", "replace")[:32]
            for one in (device.serial, device.model, device.firmware)
        ),
    ).ljust(flash.CRC_AT, b"\0")
    return page + zlib.crc32(page).to_bytes(4, "little")


def exact(path: Path, value: float, what: str) -> tuple[int, int]:
    """Return numerator and denominator, each below 2**32, of a fraction that gives `value` back exactly."""
    for fraction in (Fraction(repr(value)), rate_fraction(value), Fraction(value)):
        if max(fraction.numerator, fraction.denominator) <= LARGEST and float(fraction) == value:
            return fraction.numerator, fraction.denominator
    message = f"the {what} {value!r} is not a fraction of 32-bit numbers"
    raise OutputError(message, path=path, hint=OTHER_FORMAT)


def zone_minutes(timezone: str | None) -> int:
    """Return the minutes east of UTC of a fixed offset, ZONE_UNKNOWN for any other zone."""
    offset = fixed_offset(timezone)
    if offset is None:
        return flash.ZONE_UNKNOWN
    return int(f"{offset[0]}1") * (60 * int(offset[1:3]) + int(offset[4:]))


def data_pages(path: Path, rows: Chunk, sequence: int) -> NDArray[np.void]:
    """Return whole pages, or a single one that is not full, numbered from `sequence`."""
    count, time_us = len(rows), rows.time_us
    check_bits(path, rows, 16)
    if time_us.min() < 0 or time_us.max() > LARGEST * MICROSECONDS:
        raise OutputError("a time lies before 1970 or after 2106", path=path, hint=OTHER_FORMAT)
    first = np.arange(0, count, SAMPLES)
    pages = np.zeros(len(first), flash.PAGE)
    pages["magic"] = PAGE_MAGIC
    pages["recording_id"] = RECORDING_ID
    pages["sequence"] = sequence + np.arange(len(first))
    pages["seconds"], pages["microseconds"] = np.divmod(time_us[first], MICROSECONDS)
    means_mc = page_means_mc(rows, SAMPLES)
    pages["temperature"] = flash.NOT_MEASURED
    if means_mc is not None:  # in units of 1/128 C
        pages["temperature"] = np.clip(np.rint(means_mc * (128 / 1000)), -INT16.max, INT16.max)
    pages["samples"] = np.minimum(count - first, SAMPLES)
    pages["flags"][0] = flash.FLAG_FRESH * rows.is_fresh
    pages["xyz"] = -1
    whole = count // SAMPLES
    pages["xyz"][:whole] = rows.counts[: whole * SAMPLES].reshape(whole, SAMPLES, 3)
    if count % SAMPLES:
        pages["xyz"][whole, : count % SAMPLES] = rows.counts[whole * SAMPLES :]
    data = pages.data.cast("B")
    starts = range(0, len(data), PAGE_BYTES)
    pages["crc"] = [zlib.crc32(data[start : start + flash.CRC_AT]) for start in starts]
    return pages


ENCODER = Encoder("flash", ".bin", write)
