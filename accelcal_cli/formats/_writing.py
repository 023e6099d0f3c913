"""Shared by the writers of formats: cuts chunks into pages, refuses what a device cannot record, opens files.

A writer takes chunks of any length and puts them together into pages of a fixed number of samples. A rate, a
scale or a gap that a vendor's device could not have recorded is refused with a hint.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import OutputError, UsageError
from accelcal_cli.core.recording import Chunk, Device, Recording, joined

OTHER_FORMAT = "choose another format, such as csv"


def page_runs(chunks: Iterable[Chunk], samples: int) -> Iterator[Chunk]:
    """Yield rows of whole pages; a single page is shorter only before a break and at the end."""
    kept: Chunk | None = None
    for chunk in chunks:
        cuts = sorted({0, len(chunk), *chunk.breaks.tolist()})
        for rows in (chunk.part(start, stop) for start, stop in pairwise(cuts)):
            if kept is not None and rows.is_fresh:
                yield kept
                kept = None
            run = rows if kept is None else joined((kept, rows))
            whole = len(run) // samples * samples
            if whole:
                yield run.part(0, whole)
            kept = run.part(whole, len(run)) if whole < len(run) else None
    if kept is not None:
        yield kept


def full_pages(path: Path, chunks: Iterable[Chunk], samples: int) -> Iterator[Chunk]:
    """Yield rows of whole pages; raises OutputError if the recording has a gap, or ends within a page."""
    for rows in page_runs(chunks, samples):
        if rows.is_fresh:
            raise OutputError("the recording has a gap", path=path, hint=OTHER_FORMAT)
        if len(rows) % samples:
            raise OutputError(f"the recording ends within {samples} samples", path=path, hint=OTHER_FORMAT)
        yield rows


def page_means_mc(rows: Chunk, samples: int) -> NDArray[np.float64] | None:
    """Return the mean temperature of each page of `samples` rows, (pages,); None without temperature."""
    if rows.temperature_mc is None:
        return None
    first = np.arange(0, len(rows), samples)
    sums = np.add.reduceat(rows.temperature_mc, first, dtype=np.int64)
    return np.asarray(sums / np.diff(first, append=len(rows)))


def check_bits(path: Path, rows: Chunk, bits: int) -> None:
    """Raise OutputError if a count needs more than `bits` bits, sign included."""
    limit = 1 << (bits - 1)
    if len(rows) and (rows.counts.min() < -limit or rows.counts.max() >= limit):
        raise OutputError(f"the recording's counts do not fit in {bits} bits", path=path, hint=OTHER_FORMAT)


def known_rate(recording: Recording, rates: Iterable[float], device: str, rounded_hz: float = 0.0) -> float:
    """Return the device's rate nearest to the recording's; raises UsageError if not within `rounded_hz`."""
    rate_hz = recording.rate_hz
    nearest = min(rates, key=lambda rate: abs(rate - rate_hz))
    if abs(nearest - rate_hz) > rounded_hz:
        raise UsageError(f"{device} does not record at {rate_hz:g} Hz", hint=f"use --rate {nearest:g}")
    return nearest


def known_scale(recording: Recording, scales: Collection[tuple[float, float]], device: str) -> None:
    """Raise UsageError unless the recording's counts per g and range [g] are a pair of the device's."""
    if any((recording.lsb_per_g, recording.range_g) == scale for scale in scales):
        return
    known = " or ".join(f"--lsb-per-g {lsb_per_g:g} --range-g {range_g:g}" for lsb_per_g, range_g in scales)
    over = "an unknown range" if recording.range_g is None else f"+-{recording.range_g:g} g"
    what = f"{device} does not record {recording.lsb_per_g:g} counts per g over {over}"
    raise UsageError(what, hint=f"use {known}")


def start_us(path: Path, recording: Recording) -> int:
    """Return the time of the first sample [us since 1970]; raises OutputError if it is unknown."""
    if recording.start_us is None:
        raise OutputError("the recording has no start time", path=path, hint=OTHER_FORMAT)
    return recording.start_us


def fixed_offset(timezone: str | None) -> str | None:
    """Return the zone as hours and minutes east of UTC, such as +01:00; None for any other zone."""
    offset = "+00:00" if timezone == "UTC" else timezone or ""
    return offset if re.fullmatch(r"[+-]\d\d:\d\d", offset) else None


def number_of(device: Device) -> int:
    """Return the last eight digits of the serial number, 0 if it has none."""
    return int("".join(re.findall(r"[0-9]", device.serial or ""))[-8:] or 0)


def remark(device: Device) -> str:
    """Return model and serial number in printable ASCII, for a field of remarks."""
    return re.sub(r"[^ -~]", "?", " ".join(text for text in (device.model, device.serial) if text))


@contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file to be written from its beginning; raises OutputError if that, or the writing, fails."""
    try:
        with path.open("wb") as file:
            yield file
    except OSError as error:
        what = f"cannot be written ({error.strerror or error})"
        raise OutputError(what, path=path, hint="check the disk") from error
