"""Writes the flash page format of docs/flash-format.md.

A page ends where it is full and where the recording has a break. Each page is stamped with the
time of its first sample; its temperature is the mean of its samples.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import rate_fraction
from accelcal_cli.core.encoding import Encoder
from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.recording import Chunk, Counts, Recording

PAGE_BYTES = 512
SAMPLES = 80
HEADER = struct.Struct("<8sHHIIIIIIIhH32s32s32s")
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
HEADER_MAGIC, PAGE_MAGIC = b"\x89ACL\r\n\x1a\n", b"ACLP"
VERSION = 1
NOT_MEASURED = ZONE_UNKNOWN = -32768
HAS_TEMPERATURE, CLOCK_NEVER_SET = 1, 2
FRESH = 1
RECORDING_ID = 1
LARGEST = (1 << 32) - 1
INT16 = np.iinfo(np.int16)
OTHER_FORMAT = "choose another format, such as csv"


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows that continue each other: counts (n, 3), times [us] (n,), temperatures (n,) or None.

    `fresh`: the first row does not continue what came before.
    """

    counts: Counts
    time_us: NDArray[np.int64]
    temperature_mc: NDArray[np.int32] | None
    fresh: bool

    def cut(self, row: int) -> tuple[Rows, Rows]:
        """Rows before `row`, and from it on."""
        heat = self.temperature_mc
        above, below = (None, None) if heat is None else (heat[:row], heat[row:])
        return (
            Rows(self.counts[:row], self.time_us[:row], above, self.fresh),
            Rows(self.counts[row:], self.time_us[row:], below, self.fresh and row == 0),
        )


def write(path: Path, recording: Recording, chunks: Iterable[Chunk]) -> None:
    """Write all chunks to `path`.

    Raises:
        OutputError: a count or a time does not fit, or the file cannot be written.
    """
    try:
        with path.open("wb") as file:
            file.write(header_page(path, recording))
            sequence = 0
            for rows in page_runs(chunks):
                pages = data_pages(path, rows, sequence)
                file.write(pages.data)
                sequence += len(pages)
    except OSError as error:
        raise OutputError(
            f"cannot be written ({error.strerror or error})", path=path, hint="check the disk"
        ) from error


def header_page(path: Path, recording: Recording) -> bytes:
    """Page 0."""
    flags = HAS_TEMPERATURE * recording.has_temperature
    flags |= CLOCK_NEVER_SET * (recording.start_us is None)
    device = recording.device
    page = HEADER.pack(
        HEADER_MAGIC,
        VERSION,
        PAGE_BYTES,
        RECORDING_ID,
        *exact(path, recording.rate_hz, "sampling rate"),
        *exact(path, recording.lsb_per_g, "number of counts per g"),
        round((recording.range_g or 0) * 1000),
        flags,
        zone_minutes(recording.timezone),
        0,
        *(ascii_field(text) for text in (device.serial, device.model, device.firmware)),
    ).ljust(PAGE_BYTES - 4, b"\0")
    return page + zlib.crc32(page).to_bytes(4, "little")


def exact(path: Path, value: float, what: str) -> tuple[int, int]:
    """Numerator and denominator, each below 2**32, of a fraction that gives `value` back exactly."""
    for fraction in (Fraction(repr(value)), rate_fraction(value), Fraction(value)):
        if max(fraction.numerator, fraction.denominator) <= LARGEST and float(fraction) == value:
            return fraction.numerator, fraction.denominator
    message = f"the {what} {value!r} is not a fraction of 32-bit numbers"
    raise OutputError(message, path=path, hint=OTHER_FORMAT)


def ascii_field(text: str | None) -> bytes:
    """Up to 32 bytes of ASCII, the rest zeros; other characters become question marks."""
    return (text or "").encode("ascii", "replace")[:32]


def zone_minutes(timezone: str | None) -> int:
    """Minutes east of UTC where the zone is a fixed offset."""
    if timezone == "UTC":
        return 0
    found = re.fullmatch(r"([+-])(\d\d):(\d\d)", timezone or "")
    if found is None:
        return ZONE_UNKNOWN
    return int(found[1] + "1") * (60 * int(found[2]) + int(found[3]))


def page_runs(chunks: Iterable[Chunk]) -> Iterator[Rows]:
    """Rows in whole pages; fewer than a page only before a break and at the end."""
    kept: Rows | None = None
    for chunk in chunks:
        for rows in stretches(chunk):
            if kept is not None and rows.fresh:
                yield kept
                kept = None
            joined = rows if kept is None else joined_rows(kept, rows)
            ready, kept = joined.cut(len(joined.counts) // SAMPLES * SAMPLES)
            if len(ready.counts):
                yield ready
            kept = kept if len(kept.counts) else None
    if kept is not None:
        yield kept


def stretches(chunk: Chunk) -> Iterator[Rows]:
    """The chunk, cut at its breaks."""
    cuts = sorted({0, len(chunk), *chunk.breaks.tolist()})
    broken = set(chunk.breaks.tolist())
    for start, stop in pairwise(cuts):
        heat = None if chunk.temperature_mc is None else chunk.temperature_mc[start:stop]
        yield Rows(chunk.counts[start:stop], chunk.clock.times(start, stop), heat, start in broken)


def joined_rows(first: Rows, second: Rows) -> Rows:
    """The rows of both."""
    heat = None
    if first.temperature_mc is not None and second.temperature_mc is not None:
        heat = np.concatenate((first.temperature_mc, second.temperature_mc))
    counts: Any = np.concatenate((first.counts, second.counts))
    return Rows(counts, np.concatenate((first.time_us, second.time_us)), heat, first.fresh)


def data_pages(path: Path, rows: Rows, sequence: int) -> NDArray[np.void]:
    """Whole pages, or a single one that is not full, numbered from `sequence`."""
    check_fit(path, rows)
    count = len(rows.counts)
    first = np.arange(0, count, SAMPLES)
    pages = np.zeros(len(first), PAGE)
    pages["magic"] = PAGE_MAGIC
    pages["recording_id"] = RECORDING_ID
    pages["sequence"] = sequence + np.arange(len(first))
    pages["seconds"], pages["microseconds"] = np.divmod(rows.time_us[first], 1_000_000)
    pages["temperature"] = page_temperatures(rows.temperature_mc, first)
    pages["samples"] = np.minimum(count - first, SAMPLES)
    pages["flags"][0] = FRESH * rows.fresh
    pages["xyz"] = -1
    whole = count // SAMPLES
    pages["xyz"][:whole] = rows.counts[: whole * SAMPLES].reshape(whole, SAMPLES, 3)
    if count % SAMPLES:
        pages["xyz"][whole, : count % SAMPLES] = rows.counts[whole * SAMPLES :]
    data = pages.data.cast("B")
    starts = range(0, len(data), PAGE_BYTES)
    pages["crc"] = [zlib.crc32(data[start : start + PAGE_BYTES - 4]) for start in starts]
    return pages


def check_fit(path: Path, rows: Rows) -> None:
    """Refuse counts beyond 16 bits and times that a page cannot hold."""
    if rows.counts.min() < INT16.min or rows.counts.max() > INT16.max:
        raise OutputError("the recording's counts do not fit in 16 bits", path=path, hint=OTHER_FORMAT)
    if rows.time_us.min() < 0 or rows.time_us.max() > LARGEST * 1_000_000:
        raise OutputError("a time lies before 1970 or after 2106", path=path, hint=OTHER_FORMAT)


def page_temperatures(heat_mc: NDArray[np.int32] | None, first: NDArray[np.int64]) -> NDArray[np.int16]:
    """Mean temperature of each page [1/128 C]."""
    if heat_mc is None:
        return np.full(len(first), NOT_MEASURED, np.int16)
    sums = np.add.reduceat(heat_mc, first, dtype=np.int64)
    means = sums / np.diff(first, append=len(heat_mc)) * (128 / 1000)
    return np.clip(np.rint(means), -INT16.max, INT16.max).astype(np.int16)


ENCODER = Encoder("flash", ".bin", write)
