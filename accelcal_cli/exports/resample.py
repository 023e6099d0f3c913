"""Samples at a fixed rate, a stretch at a time: gaps stay gaps, and nothing is made up beyond its ends.

The filter is that of `scipy.signal.resample_poly` by default: a sinc with its cutoff at the lower of the two
Nyquist frequencies, ten zero crossings to each side, in a Kaiser window of beta 5. It is evaluated where the
samples' own times say that an output lies, since a device's clock is hardly ever at its nominal rate: at a
ratio of nominal rates, times would be wrong by minutes after a week. Its weights are scaled to a sum of 1,
so that a device at rest measures the same as before, also at the ends of a stretch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from math import ceil

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.exports.rows import Floats, Rows, joined_rows

CROSSINGS = 10
BETA = 5.0
PHASES = 2048
"""Positions between two samples for which the filter is tabulated; linear between them it is within 1e-6."""

LONGEST_STEP = 1.5
"""A stretch ends where the next sample comes more than so many periods later, or not later at all."""

BLOCK_ROWS = 1 << 13
LAST = 1 << 62
LEAST_RATIO, LARGEST_RATIO = 0.01, 100.0
"""Output rate over input rate; beyond, one output would need thousands of samples."""


def breaks(time_us: NDArray[np.int64], rate_hz: float) -> NDArray[np.int64]:
    """Numbers of the rows that begin a new stretch; the first row is none of them."""
    steps = np.diff(time_us)
    return np.flatnonzero((steps <= 0) | (steps > LONGEST_STEP * MICROSECONDS / rate_hz)) + 1


def resampled(portions: Iterable[Rows], rate_hz: float, wanted_hz: float) -> Iterator[Rows]:
    """Rows at a fixed rate within each unbroken stretch, whatever the portions are.

    Times are those of a stretch's first sample and exact multiples of 1 / wanted_hz after it, to the
    nearest us, up to its last sample. Temperature is linear between samples.
    """
    sampler = _Resampler(rate_hz, wanted_hz)
    for rows in portions:
        last = sampler.last_us
        time_us = rows.time_us if last is None else np.concatenate([[last], rows.time_us])
        starts = (breaks(time_us, rate_hz) - (last is not None)).tolist()
        for start, stop in zip([0, *starts], [*starts, len(rows)], strict=True):
            if start in starts:
                yield from sampler.made(finish=True)
            if stop > start:
                sampler.add(rows.part(start, stop))
        yield from sampler.made(finish=False)
    yield from sampler.made(finish=True)


class _Resampler:
    """The stretch at hand: the samples that outputs still need, and how many outputs there were."""

    def __init__(self, rate_hz: float, wanted_hz: float) -> None:
        self._period_us = Fraction(MICROSECONDS) / Fraction(str(wanted_hz))
        cutoff = min(1.0, wanted_hz / rate_hz)
        self._half = ceil(CROSSINGS / cutoff)
        self._table = _table(cutoff, self._half)
        self._parts: list[Rows] = []
        self._first_us: int | None = None
        self._done = 0

    @property
    def last_us(self) -> int | None:
        """Time of the last sample of the stretch; None before the first."""
        return int(self._parts[-1].time_us[-1]) if self._parts else None

    def add(self, rows: Rows) -> None:
        """Take in samples that continue the stretch."""
        if self._first_us is None:
            self._first_us = int(rows.time_us[0])
        self._parts.append(rows)

    def made(self, *, finish: bool) -> Iterator[Rows]:
        """Outputs that can be made now; with `finish` all, and the next sample begins a new stretch."""
        if not self._parts or self._first_us is None:
            return
        rows = joined_rows(self._parts)
        since_us = rows.time_us - self._first_us
        known = len(rows) - 1 if finish else len(rows) - 2 - self._half
        if known >= 0:
            stop = self._number_up_to(int(since_us[known]))
            for start in range(self._done, stop, BLOCK_ROWS):
                yield self._block(rows, since_us, start, min(start + BLOCK_ROWS, stop))
            self._done = max(self._done, stop)
        if finish:
            self._parts, self._first_us, self._done = [], None, 0
        else:
            needed = int(np.searchsorted(since_us, float(self._done * self._period_us), "right"))
            self._parts = [rows.part(min(max(0, needed - 1 - self._half), len(rows) - 1), len(rows))]

    def _number_up_to(self, since_us: int) -> int:
        """How many outputs lie at or before a time after the first sample."""
        return int(since_us // self._period_us) + 1

    def _block(self, rows: Rows, since_us: NDArray[np.int64], start: int, stop: int) -> Rows:
        """Outputs start..stop-1 of the stretch."""
        period, number = self._period_us, np.arange(start, stop)
        at_us = number * float(period)
        before = np.minimum(np.searchsorted(since_us, at_us, "right") - 1, len(rows) - 1)
        after = np.minimum(before + 1, len(rows) - 1)
        step = np.maximum(since_us[after] - since_us[before], 1)
        between = np.minimum((at_us - since_us[before]) / step, 1.0)
        xyz = self._filtered(rows.xyz, before, between)
        celsius = rows.celsius
        if celsius is not None:
            celsius = (celsius[before] + between * (celsius[after] - celsius[before])).astype(np.float32)
        return Rows(self._times_us(start, stop), xyz, celsius)

    def _times_us(self, start: int, stop: int) -> NDArray[np.int64]:
        """Times of outputs, from whole numbers alone."""
        top, below = self._period_us.as_integer_ratio()
        assert self._first_us is not None
        numbers = np.arange(start, stop, dtype=np.int64 if 2 * stop * top < LAST else object)
        return (self._first_us + (2 * numbers * top + below) // (2 * below)).astype(np.int64)

    def _filtered(
        self, xyz: NDArray[np.float32], before: NDArray[np.int64], between: Floats
    ) -> NDArray[np.float32]:
        """Tap by tap, so that an output does not depend on those that are made along with it."""
        phases = self._table.shape[1] - 1
        phase = between * phases
        row = np.minimum(phase.astype(np.int64), phases - 1)
        rest = phase - row
        total, weights = np.zeros((len(before), 3)), np.zeros(len(before))
        for tap, values in enumerate(self._table):
            place = before + (tap - self._half + 1)
            weight = values[row] + rest * (values[row + 1] - values[row])
            weight[(place < 0) | (place >= len(xyz))] = 0.0
            weights += weight
            total += weight[:, np.newaxis] * xyz[np.clip(place, 0, len(xyz) - 1)]
        return np.asarray(total / weights[:, np.newaxis], np.float32)


def _table(cutoff: float, half: int) -> Floats:
    """The filter at each of 2 half samples, for outputs at each position after the sample before them.

    Returns:
        (2 half, phases + 1); fewer phases the lower the cutoff, since the filter is as much smoother.
    """
    phases = ceil(PHASES * cutoff)
    distance = np.arange(1 - half, half + 1)[:, np.newaxis] - np.arange(phases + 1) / phases
    inside = np.sqrt(np.maximum(0.0, 1 - (distance * cutoff / CROSSINGS) ** 2))
    window = np.where(np.abs(distance * cutoff) <= CROSSINGS, np.i0(BETA * inside), 0.0)
    return np.asarray(np.sinc(cutoff * distance) * window)
