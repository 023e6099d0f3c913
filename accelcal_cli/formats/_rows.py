"""Treats rows alike wherever blocks end: repeats held values, leaves out faulty rows, marks repeated samples.

Each class remembers what it needs of the rows before, so that its result does not depend on where blocks end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import Channels, Chunk

MISSING = int(np.iinfo(np.int32).min)
"""Marks a row where a channel of single values was not measured, until the last known value replaces it."""

CHANNEL_NOUNS = {"temperature_mc": "a temperature"}
"""Channel names for problems; a channel that is not listed goes by its name in Chunk."""


def missing_kind(channel: str) -> tuple[str, str]:
    """Return code and text of the problem that samples lack a value of a channel."""
    noun = CHANNEL_NOUNS.get(channel, channel)
    return "missing_value", f"samples without {noun}, given the last one measured"


def first_values(channels: Channels) -> dict[str, int | None]:
    """Return the first measured value of each channel of single values, None where there is none."""
    columns = {name: column[column != MISSING] for name, column in channels.items() if column.ndim == 1}
    return {name: int(known[0]) if len(known) else None for name, known in columns.items()}


class HeldChannels:
    """Repeats the last measured value of a channel where there is none.

    Args:
        first: for each channel that may hold MISSING, the value for rows before the first measured one; None
            for a channel without any measured value, which is left out.
    """

    def __init__(self, first: Mapping[str, int | None]) -> None:
        self._never = [name for name, value in first.items() if value is None]
        self._last = {name: value for name, value in first.items() if value is not None}

    def fill(self, channels: Channels) -> Channels:
        """Return the channels of the next rows with all gaps filled."""
        return {
            name: self._filled(name, column) if name in self._last and len(column) else column
            for name, column in channels.items()
            if name not in self._never
        }

    def _filled(self, name: str, measured: NDArray[Any]) -> NDArray[Any]:
        if measured.min() <= MISSING:
            source = np.maximum.accumulate(np.where(measured != MISSING, np.arange(len(measured)), -1))
            last = measured.dtype.type(self._last[name])
            measured = np.where(source < 0, last, measured[source])
        self._last[name] = int(measured[-1])
        return measured


class RowFilter:
    """Takes faulty rows out of chunks; the row after them does not continue the one before."""

    def __init__(self) -> None:
        self._started = self._broken = False

    def apply(self, chunk: Chunk, faulty: NDArray[np.bool_] | None) -> Chunk:
        """Return the chunk without the rows marked in `faulty` (n,)."""
        if faulty is None or not len(chunk):
            return chunk
        kept = chunk.keep(~faulty) if faulty.any() else chunk
        if len(kept):
            inside = kept.breaks[int(kept.is_fresh) :]
            fresh = self._started and (self._broken or kept.is_fresh)
            kept = replace(kept, breaks=np.append(0, inside) if fresh else inside)
        self._started |= len(kept) > 0
        self._broken = bool(faulty[-1])
        return kept


class RepeatedSamples:
    """Marks idle sleep that a file does not mark: long runs of equal samples.

    "While in sleep mode, the last sampled accelerometer value is written into memory at the device's preset
    sample rate" (ActiGraph, "Idle Sleep Mode Explained"). No measured sample repeats itself for a second: the
    longest such run among 980 000 measured samples of seven devices at 30 and 100 Hz is 8 samples.

    Args:
        least: number of equal samples in a row that counts as sleep; the first of them was measured.
    """

    def __init__(self, least: int) -> None:
        self._least = max(least, 2)
        self._asleep: NDArray[Any] | None = None

    def mark(
        self, counts: NDArray[Any], usable: NDArray[np.bool_] | None = None, *, last: bool
    ) -> NDArray[np.bool_]:
        """Mark the next samples (n, 3) that only repeat the one before; unusable ones (n,) repeat nothing.

        Returns:
            Marks of the first m samples. Unless these are the `last`, a run at the end that may still become
            long enough is left over: its n - m samples belong at the beginning of the next call.
        """
        if not len(counts):
            return np.empty(0, np.bool_)
        repeats = np.ones(len(counts), np.bool_) if usable is None else usable.copy()
        repeats[0] &= self._asleep is not None and np.array_equal(counts[0], self._asleep)
        for axis in counts.T:
            repeats[1:] &= axis[1:] == axis[:-1]
        begins = ~repeats
        begins[0] = True
        starts = np.flatnonzero(begins)
        sizes = np.diff(starts, append=len(counts))
        long = sizes >= self._least
        long[0] |= repeats[0]
        self._asleep = counts[-1].copy() if long[-1] else None
        settled = len(counts) if last or long[-1] else int(starts[-1])
        return np.asarray(np.repeat(long, sizes) & repeats)[:settled]
