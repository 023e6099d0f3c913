"""The online segmenter: chunks in, still windows out, in bounded memory.

Windows do not overlap and start again after every break, so that none spans lost data; what is left of a
run when it breaks is not used. Only over short gaps of a clock that jitters may a window go on
(`ShortGaps`). The windows do not depend on how the rows are chunked. A `Rule` decides which windows,
handed to it as `Blocks`, are still.

Sums of squares are computed at floating-point speed: a float holds every integer up to 2**24 (single) or
2**53 (double), and a sum of integers whose absolute values add up to less than that is exact in any
order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from accelcal_cli.core.points import Quietest, WindowCounts, Windows
from accelcal_cli.core.recording import Chunk, Validity, joined

_EXACT: tuple[tuple[int, DTypeLike], ...] = ((1 << 24, np.float32), (1 << 53, np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """m complete windows of n samples, one after the other, without a break between them but short gaps.

    Attributes:
        run: number of the unbroken stretch that they are part of, rising with time.
        rows: the m n rows.
        columns: (3, m, n) their counts.
        low, high: (3, m) int64, smallest and largest count.
        sums: (3, m) int64, sums of counts.
        usable: (m,) whether every row was measured.
    """

    run: int
    rows: Chunk
    columns: NDArray[Any]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    sums: NDArray[np.int64]
    usable: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.usable)

    @property
    def length(self) -> int:
        """Samples in a window."""
        return int(self.columns.shape[2])

    @property
    def first_samples(self) -> NDArray[np.int64]:
        """(m,) number of each window's first sample in the recording."""
        return self.rows.first_sample + self.length * np.arange(len(self), dtype=np.int64)

    @property
    def temperature_sums(self) -> NDArray[np.int64] | None:
        """(m,) sums of thousandths of a degree C, or None."""
        temperature_mc = self.rows.temperature_mc
        if temperature_mc is None:
            return None
        largest = max(-int(temperature_mc.min()), int(temperature_mc.max()))
        return exact_sums(temperature_mc.reshape(len(self), -1), self.length * largest)

    def windows(self, which: NDArray[np.bool_]) -> Windows:
        """The windows of a mask."""
        samples = np.full(len(self), self.length, np.int64)
        spread = (self.high - self.low).T
        return Windows(samples, self.first_samples, self.sums.T, spread, self.temperature_sums).select(which)


@dataclass(frozen=True, slots=True)
class ShortGaps:
    """Jumps of the clock, ahead or back, that do not end a window: its mean needs rest, not even spacing.

    Attributes:
        longest_us: one that is longer ends the window [us]; 0: all do.
        together_us: so much at most within one window [us], so that it stays bounded in time.
    """

    longest_us: int = 0
    together_us: int = 0


NO_GAPS = ShortGaps()
"""Every jump ends a window."""


class Rule(Protocol):
    """Decides which windows are still; one object a recording, since it may remember.

    What it yields is in the order of time, each made of one or more whole windows of the blocks, none
    of them unusable, none in two; it must not depend on how a run was cut into blocks.
    """

    def take(self, blocks: Blocks) -> list[Windows]:
        """Take windows in; returns the still ones that are decided by now."""

    def rest(self) -> list[Windows]:
        """What was held back; called once, after the last block."""


def exact_type(bound: int) -> DTypeLike:
    """The fastest type in which integers that add up to `bound` stay exact."""
    for limit, kind in _EXACT:
        if bound <= limit:
            return kind
    return np.int64


def exact_sums(blocks: NDArray[Any], bound: int) -> NDArray[np.int64]:
    """Sums over the last axis of integers whose absolute values add up to at most `bound`."""
    kind = np.int32 if bound <= np.iinfo(np.int32).max else np.int64
    return np.asarray(blocks.sum(axis=-1, dtype=kind), np.int64)


def sums_of_squares(blocks: NDArray[Any], bound: int) -> NDArray[np.int64]:
    """Sums over the last axis of squares that add up to at most `bound`; blocks is (m, n)."""
    values = blocks.astype(exact_type(bound), copy=False)
    return np.asarray(np.einsum("mn,mn->m", values, values)).astype(np.int64)


def centred_squares(
    blocks: NDArray[Any], spread: NDArray[np.int64], sums: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(c, r), both (m,), with n^2 times the variance of a window of n counts = n c - r^2, r < n.

    With d = counts - first count and sum(d) = q n + r, c is sum(d^2) - n q^2 - 2 q r; all terms
    stay small.

    Args:
        blocks: (m, n) counts, m > 0.
        spread: (m,) max - min.
        sums: (m,) sums of counts.
    """
    length = blocks.shape[1]
    largest = int(spread.max())
    squares = sums_of_squares(_from_first(blocks, largest), largest * largest * length)
    q, r = np.divmod(sums - length * blocks[:, 0].astype(np.int64), length)
    return squares - length * q * q - 2 * q * r, r


def _from_first(blocks: NDArray[Any], largest: int) -> NDArray[Any]:
    """Counts of each window less its first one, at most `largest`; in their own type where it holds that."""
    if largest > np.iinfo(blocks.dtype).max:
        blocks = blocks.astype(np.int64)
    return np.asarray(blocks - blocks[:, :1])


class Segmenter:
    """Feed it chunks; it yields the still windows that are decided so far, the last from `finish`."""

    def __init__(self, length: int, rule: Rule, gaps: ShortGaps = NO_GAPS) -> None:
        self.length = length
        self.rule = rule
        self.gaps = gaps
        self.counts = WindowCounts()
        self.quietest: Quietest | None = None
        """Of all windows that were measured throughout, still or not."""
        self.gone_over = 0
        """Jumps of the clock within windows that these went on over."""
        self._run_number = 0
        self._pending: Chunk | None = None
        self._run_first = 0
        self._last_us = 0
        self._window, self._window_us = -1, 0
        """The number within its run of the window that went on over the last jump, and over how much [us]."""

    def feed(self, chunk: Chunk) -> Iterator[Windows]:
        """Still windows that are decided in this chunk, in batches."""
        breaks = self._run_ends(chunk)
        edges = np.concatenate(([0], breaks[breaks > 0], [len(chunk)]))
        if len(breaks) and not breaks[0]:
            self._run_number += 1
            self._pending = None
        first = self._run_number
        for index in self._mattering(np.diff(edges)).tolist():
            if index:
                self._run_number = first + index
                self._pending = None
            yield from self._run(chunk.part(int(edges[index]), int(edges[index + 1])))
        if self._pending is not None:
            self._pending = self._pending.copy()

    def finish(self) -> Iterator[Windows]:
        """Still windows that the rule held back; call once, after the last chunk."""
        for windows in self.rule.rest():
            self._count_still(windows)
            yield windows

    def _run_ends(self, chunk: Chunk) -> NDArray[np.int64]:
        """The breaks of a chunk but those that windows go on over."""
        if not self.gaps.longest_us or not len(chunk):
            return chunk.breaks
        if len(chunk.clock_jumps):
            breaks = self._without_short(chunk)
        else:
            breaks = chunk.breaks
            if len(breaks):
                self._begin_run(chunk.first_sample + int(breaks[-1]))
        self._last_us = int(chunk.clock.times(len(chunk) - 1, len(chunk))[0])
        return breaks

    def _without_short(self, chunk: Chunk) -> NDArray[np.int64]:
        """The same for a chunk in which the clock jumps."""
        rows, times_us = chunk.breaks, chunk.time_us
        steps_us = np.abs(times_us[rows] - np.where(rows > 0, times_us[rows - 1], self._last_us))
        short = np.isin(rows, chunk.clock_jumps) & (steps_us <= self.gaps.longest_us)
        ends = np.ones(len(rows), np.bool_)
        for index, sample in enumerate((chunk.first_sample + rows).tolist()):
            if short[index] and self._goes_on(sample, int(steps_us[index])):
                ends[index] = False
            else:
                self._begin_run(sample)
        return rows[ends]

    def _begin_run(self, sample: int) -> None:
        self._run_first, self._window = sample, -1

    def _goes_on(self, sample: int, step_us: int) -> bool:
        """Whether the window that holds a sample may go on over a short jump before it."""
        window, row = divmod(sample - self._run_first, self.length)
        if not row:
            return True
        so_far_us = self._window_us if window == self._window else 0
        if so_far_us + step_us > self.gaps.together_us:
            return False
        self._window, self._window_us = window, so_far_us + step_us
        self.gone_over += 1
        return True

    def _mattering(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """Which of a chunk's runs, of so many rows each, may make a window; damaged files have many more."""
        whole = rows >= self.length
        whole[0] |= self._pending is not None
        whole[-1] = True
        return np.flatnonzero(whole & (rows > 0))

    def _run(self, rows: Chunk) -> Iterator[Windows]:
        """The windows in rows without a break that ends one inside."""
        if self._pending is not None:
            need = self.length - len(self._pending)
            window = joined((self._pending, rows.part(0, min(need, len(rows)))))
            if len(window) < self.length:
                self._pending = window
                return
            yield from self._windows(window)
            rows = rows.part(need, len(rows))
        whole = len(rows) // self.length * self.length
        if whole:
            yield from self._windows(rows.part(0, whole))
        self._pending = rows.part(whole, len(rows)) if whole < len(rows) else None

    def _windows(self, rows: Chunk) -> Iterator[Windows]:
        blocks = self._blocks(rows)
        self.counts += WindowCounts(complete=len(blocks), moving=int(blocks.usable.sum()))
        for windows in self.rule.take(blocks):
            self._count_still(windows)
            yield windows

    def _count_still(self, windows: Windows) -> None:
        """Until they are found still, windows count as moving."""
        number = int(windows.samples.sum()) // self.length
        still = len(windows)
        self.counts += WindowCounts(moving=-number, still=still, joined=number - still)

    def _blocks(self, rows: Chunk) -> Blocks:
        number = len(rows) // self.length
        columns = rows.counts.T.reshape(3, number, self.length)
        low, high = columns.min(axis=2).astype(np.int64), columns.max(axis=2).astype(np.int64)
        sums = exact_sums(columns, self.length * (1 << 8 * columns.itemsize - 1))
        usable = self._usable(rows, number)
        self._note_quietest(columns, (high - low).max(axis=0), usable)
        return Blocks(self._run_number, rows, columns, low, high, sums, usable)

    def _note_quietest(
        self, columns: NDArray[Any], spread: NDArray[np.int64], usable: NDArray[np.bool_]
    ) -> None:
        """Keep the first of the windows with the least max - min."""
        if not usable.any():
            return
        index = int(np.where(usable, spread, spread.max() + 1).argmin())
        if self.quietest is None or spread[index] < self.quietest.spread:
            deviation = float(columns[:, index].astype(np.float64).std(axis=1).max())
            self.quietest = Quietest(int(spread[index]), deviation)

    def _usable(self, rows: Chunk, number: int) -> NDArray[np.bool_]:
        """Windows that the device measured throughout; the others are counted by their worst row."""
        if rows.validity is None:
            return np.ones(number, np.bool_)
        flags = rows.validity.reshape(number, self.length)
        filled = (flags == Validity.FILLED).any(axis=1)
        clipped = (flags == Validity.CLIPPED).any(axis=1) & ~filled
        recovered = (flags == Validity.RECOVERED).any(axis=1) & ~filled & ~clipped
        self.counts += WindowCounts(
            filled=int(filled.sum()), clipped=int(clipped.sum()), recovered=int(recovered.sum())
        )
        return np.asarray(~(filled | clipped | recovered))


class TimedSegmenter(Segmenter):
    """A segmenter whose windows carry their times, whenever its rule decides on them."""

    def __init__(self, length: int, rule: Rule, rate_hz: float, gaps: ShortGaps = NO_GAPS) -> None:
        super().__init__(length, rule, gaps)
        self._period_us = round(1e6 / rate_hz)
        self._times = np.empty((3, 0), np.int64)
        """Of all windows that may still be decided on: first sample, times of the first and last one [us]."""

    def feed(self, chunk: Chunk) -> Iterator[Windows]:
        """See `Segmenter`."""
        return map(self._timed, super().feed(chunk))

    def finish(self) -> Iterator[Windows]:
        """See `Segmenter`."""
        return map(self._timed, super().finish())

    def _blocks(self, rows: Chunk) -> Blocks:
        blocks = super()._blocks(rows)
        times_us = rows.time_us.reshape(len(blocks), self.length)
        last_us = np.maximum(times_us[:, 0], times_us[:, -1])
        known = np.stack([blocks.first_samples, times_us[:, 0], last_us])
        self._times = np.concatenate([self._times, known], axis=1)
        return blocks

    def _timed(self, windows: Windows) -> Windows:
        if not len(windows):
            return replace(windows, start_us=windows.first_sample, end_us=windows.first_sample)
        samples, start_us, last_us = self._times
        first = np.searchsorted(samples, windows.first_sample)
        last = np.searchsorted(samples, windows.first_sample + windows.samples - self.length)
        self._times = self._times[:, int(last[-1]) + 1 :]
        return replace(windows, start_us=start_us[first], end_us=last_us[last] + self._period_us)
