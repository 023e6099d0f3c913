"""Rows of chunks, put together to pages of a fixed number of samples.

What a recording must be like so that a vendor's device could have made it.

Files whose failures are told in a user's words.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import OutputError, UsageError
from accelcal_cli.core.recording import Chunk, Counts, Device, Recording

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

    def __len__(self) -> int:
        return len(self.counts)

    def cut(self, row: int) -> tuple[Rows, Rows]:
        """Rows before `row`, and from it on."""
        heat = self.temperature_mc
        above, below = (None, None) if heat is None else (heat[:row], heat[row:])
        return (
            Rows(self.counts[:row], self.time_us[:row], above, self.fresh),
            Rows(self.counts[row:], self.time_us[row:], below, self.fresh and row == 0),
        )

    def mean_mc(self, samples: int) -> NDArray[np.float64] | None:
        """Mean temperature of each page of so many rows, (pages,); None without temperature."""
        if self.temperature_mc is None:
            return None
        first = np.arange(0, len(self), samples)
        sums = np.add.reduceat(self.temperature_mc, first, dtype=np.int64)
        return np.asarray(sums / np.diff(first, append=len(self)))


def page_runs(chunks: Iterable[Chunk], samples: int) -> Iterator[Rows]:
    """Rows of whole pages; a single page is shorter only before a break and at the end."""
    kept: Rows | None = None
    for chunk in chunks:
        for rows in stretches(chunk):
            if kept is not None and rows.fresh:
                yield kept
                kept = None
            joined = rows if kept is None else joined_rows(kept, rows)
            ready, kept = joined.cut(len(joined) // samples * samples)
            if len(ready):
                yield ready
            kept = kept if len(kept) else None
    if kept is not None:
        yield kept


def full_pages(path: Path, chunks: Iterable[Chunk], samples: int) -> Iterator[Rows]:
    """Rows of whole pages only.

    Raises:
        OutputError: the recording has a gap, or ends within a page.
    """
    for rows in page_runs(chunks, samples):
        if rows.fresh:
            raise OutputError("the recording has a gap", path=path, hint=OTHER_FORMAT)
        if len(rows) % samples:
            raise OutputError(f"the recording ends within {samples} samples", path=path, hint=OTHER_FORMAT)
        yield rows


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


def check_bits(path: Path, rows: Rows, bits: int) -> None:
    """Refuse counts that do not fit.

    Raises:
        OutputError: a count is beyond so many bits, sign included.
    """
    limit = 1 << (bits - 1)
    if len(rows) and (rows.counts.min() < -limit or rows.counts.max() >= limit):
        raise OutputError(f"the recording's counts do not fit in {bits} bits", path=path, hint=OTHER_FORMAT)


def known_rate(recording: Recording, rates: Iterable[float], device: str, rounded_hz: float = 0.0) -> float:
    """The device's rate that the recording has, or that it is rounded from by so much at most.

    Raises:
        UsageError: it has no such rate; the hint names the nearest one.
    """
    rate_hz = recording.rate_hz
    nearest = min(rates, key=lambda rate: abs(rate - rate_hz))
    if abs(nearest - rate_hz) > rounded_hz:
        raise UsageError(f"{device} does not record at {rate_hz:g} Hz", hint=f"use --rate {nearest:g}")
    return nearest


def known_scale(recording: Recording, scales: Collection[tuple[float, float]], device: str) -> None:
    """Make sure that the device has the recording's counts per g and range.

    Args:
        scales: the device's pairs of counts per g and range [g].

    Raises:
        UsageError: it has no such pair; the hint names them.
    """
    if any((recording.lsb_per_g, recording.range_g) == scale for scale in scales):
        return
    known = " or ".join(f"--lsb-per-g {lsb_per_g:g} --range-g {range_g:g}" for lsb_per_g, range_g in scales)
    over = "an unknown range" if recording.range_g is None else f"+-{recording.range_g:g} g"
    raise UsageError(
        f"{device} does not record {recording.lsb_per_g:g} counts per g over {over}", hint=f"use {known}"
    )


def start_us(path: Path, recording: Recording) -> int:
    """Time of the first sample [us since 1970].

    Raises:
        OutputError: the recording does not tell; a vendor's file has no way to say so.
    """
    if recording.start_us is None:
        raise OutputError("the recording has no start time", path=path, hint=OTHER_FORMAT)
    return recording.start_us


def fixed_offset(timezone: str | None) -> str | None:
    """The zone as hours and minutes east of UTC, such as +01:00; None where it is not known so."""
    offset = "+00:00" if timezone == "UTC" else timezone or ""
    return offset if re.fullmatch(r"[+-]\d\d:\d\d", offset) else None


def number_of(device: Device) -> int:
    """The last eight digits of the serial number, for formats that hold a number only; 0 without any."""
    return int("".join(re.findall(r"[0-9]", device.serial or ""))[-8:] or 0)


def remark(device: Device) -> str:
    """Model and serial number as given, in printable ASCII, for a field of remarks."""
    told = " ".join(text for text in (device.model, device.serial) if text)
    return re.sub(r"[^ -~]", "?", told)


@contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """A file to be written from its beginning.

    Raises:
        OutputError: it cannot be written, or the block fails to.
    """
    try:
        with path.open("wb") as file:
            yield file
    except OSError as error:
        raise OutputError(
            f"cannot be written ({error.strerror or error})", path=path, hint="check the disk"
        ) from error
