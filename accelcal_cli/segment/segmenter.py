"""The online segmenter: chunks in, still windows out, in bounded memory.

Windows do not overlap and start again after every break, so that none spans lost data; the rest of a run
before a break is not used. A window may only span short gaps of a clock that jitters (`ShortGaps`). The
windows do not depend on how the rows are chunked. A `Rule` decides which windows, given to it as `Blocks`,
are still.

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
"""Largest integer up to which each type is exact."""


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """m complete windows of n samples, one after the other, with no breaks between them except short gaps.

    Attributes:
        run: number of the unbroken stretch to which they belong, rising with time.
        rows: the m n rows.
        columns: (3, m, n) their counts.
        low, high: (3, m) int64, smallest and largest count.
        sums: (3, m) int64, sums of counts.
        usable: (m,) True where every row was measured.
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
        """Number of samples in a window."""
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
        """Return the windows of a mask."""
        samples = np.full(len(self), self.length, np.int64)
        spread = (self.high - self.low).T
        return Windows(samples, self.first_samples, self.sums.T, spread, self.temperature_sums).select(which)


@dataclass(frozen=True, slots=True)
class ShortGaps:
    """Jumps of the clock, ahead or back, that a window may span: its mean needs rest, not even spacing.

    Attributes:
        longest_us: longest jump that a window may span [us]; 0: none.
        together_us: longest sum of jumps within one window [us], so that it stays bounded in time.
    """

    longest_us: int = 0
    together_us: int = 0


NO_GAPS = ShortGaps()
"""Every jump ends a window."""


class Rule(Protocol):
    """Decides which windows are still; a recording has its own object, which may keep a state.

    Still windows are returned in the order of time, each made of one or more whole windows of the blocks,
    none of them unusable, none in two. The result must not depend on how a run was cut into blocks.
    """

    def take(self, blocks: Blocks) -> list[Windows]:
        """Take further windows and return the still ones that are decided by now."""

    def rest(self) -> list[Windows]:
        """Return the still windows that were held back; called once, after the last block."""


def exact_type(bound: int) -> DTypeLike:
    """Return the fastest type in which integers that add up to `bound` stay exact."""
    for limit, kind in _EXACT:
        if bound <= limit:
            return kind
    return np.int64


def exact_sums(blocks: NDArray[Any], bound: int) -> NDArray[np.int64]:
    """Return sums over the last axis of integers whose absolute values add up to at most `bound`."""
    kind = np.int32 if bound <= np.iinfo(np.int32).max else np.int64
    return np.asarray(blocks.sum(axis=-1, dtype=kind), np.int64)


def sums_of_squares(blocks: NDArray[Any], bound: int) -> NDArray[np.int64]:
    """Return sums over the last axis of squares that add up to at most `bound`; blocks is (m, n)."""
    values = blocks.astype(exact_type(bound), copy=False)
    return np.asarray(np.einsum("mn,mn->m", values, values)).astype(np.int64)


def centred_squares(
    blocks: NDArray[Any], spread: NDArray[np.int64], sums: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return c and r, both (m,), with n^2 times the variance of a window of n counts = n c - r^2, r < n.

    With d = counts - first count and sum(d) = q n + r, c is sum(d^2) - n q^2 - 2 q r; all terms
    stay small.

    Args:
        blocks: (m, n) counts, m > 0.
        spread: (m,) max - min.
        sums: (m,) sums of counts.
    """
    length = blocks.shape[1]
    largest = int(spread.max())
    wide = blocks.astype(np.int64) if largest > np.iinfo(blocks.dtype).max else blocks
    squares = sums_of_squares(np.asarray(wide - wide[:, :1]), largest * largest * length)
    q, r = np.divmod(sums - length * blocks[:, 0].astype(np.int64), length)
    return squares - length * q * q - 2 * q * r, r


class Segmenter:
    """Cuts chunks into windows and yields the still ones as they are decided, the last from `finish`.

    Attributes:
        counts: numbers of windows so far.
        quietest: the window that moves least, of all that were measured throughout; None before the first.
        gone_over: number of jumps of the clock within windows.
    """

    def __init__(self, length: int, rule: Rule, gaps: ShortGaps = NO_GAPS) -> None:
        self.length = length
        self.rule = rule
        self.gaps = gaps
        self.counts = WindowCounts()
        self.quietest: Quietest | None = None
        self.gone_over = 0
        self._run_number = 0
        self._pending: Chunk | None = None
        self._run_first = 0
        self._last_us = 0
        # the window (its number within its run) that spans the last jump, and the sum of its jumps [us]
        self._window, self._window_us = -1, 0

    def feed(self, chunk: Chunk) -> Iterator[Windows]:
        """Yield the still windows that are decided with this chunk, in batches."""
        breaks = self._run_ends(chunk)
        edges = np.concatenate(([0], breaks[breaks > 0], [len(chunk)]))
        if len(breaks) and not breaks[0]:
            self._run_number += 1
            self._pending = None
        first = self._run_number
        rows = np.diff(edges)
        # runs that may make a window: damaged files have many more
        whole = rows >= self.length
        whole[0] |= self._pending is not None
        whole[-1] = True
        for index in np.flatnonzero(whole & (rows > 0)).tolist():
            if index:
                self._run_number = first + index
                self._pending = None
            yield from self._run(chunk.part(int(edges[index]), int(edges[index + 1])))
        if self._pending is not None:
            self._pending = self._pending.copy()

    def finish(self) -> Iterator[Windows]:
        """Yield the still windows that the rule held back; call once, after the last chunk."""
        for windows in self.rule.rest():
            self._count_still(windows)
            yield windows

    def _run_ends(self, chunk: Chunk) -> NDArray[np.int64]:
        """Return the breaks that end a run; short clock jumps that a window may span are left out."""
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
        """Return the breaks that end a run of a chunk in which the clock jumps."""
        rows, times_us = chunk.breaks, chunk.time_us
        steps_us = np.abs(times_us[rows] - np.where(rows > 0, times_us[rows - 1], self._last_us))
        short = np.isin(rows, chunk.clock_jumps) & (steps_us <= self.gaps.longest_us)
        ends = np.ones(len(rows), np.bool_)
        for index, sample in enumerate((chunk.first_sample + rows).tolist()):
            if short[index] and self._may_span(sample, int(steps_us[index])):
                ends[index] = False
            else:
                self._begin_run(sample)
        return rows[ends]

    def _begin_run(self, sample: int) -> None:
        self._run_first, self._window = sample, -1

    def _may_span(self, sample: int, step_us: int) -> bool:
        """Return True if the window that holds a sample may span a short jump before it."""
        window, row = divmod(sample - self._run_first, self.length)
        if not row:
            return True
        so_far_us = self._window_us if window == self._window else 0
        if so_far_us + step_us > self.gaps.together_us:
            return False
        self._window, self._window_us = window, so_far_us + step_us
        self.gone_over += 1
        return True

    def _run(self, rows: Chunk) -> Iterator[Windows]:
        """Yield the still windows of rows within one run."""
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
        # until they are found still, windows count as moving
        number = int(windows.samples.sum()) // self.length
        still = len(windows)
        self.counts += WindowCounts(moving=-number, still=still, joined=number - still)

    def _blocks(self, rows: Chunk) -> Blocks:
        number = len(rows) // self.length
        columns = rows.counts.T.reshape(3, number, self.length)
        low, high = columns.min(axis=2).astype(np.int64), columns.max(axis=2).astype(np.int64)
        sums = exact_sums(columns, self.length * (1 << 8 * columns.itemsize - 1))
        usable = self._usable(rows, number)
        if usable.any():  # the first window with the least max - min
            spread = (high - low).max(axis=0)
            index = int(np.where(usable, spread, spread.max() + 1).argmin())
            if self.quietest is None or spread[index] < self.quietest.spread:
                deviation = float(columns[:, index].astype(np.float64).std(axis=1).max())
                self.quietest = Quietest(int(spread[index]), deviation)
        return Blocks(self._run_number, rows, columns, low, high, sums, usable)

    def _usable(self, rows: Chunk, number: int) -> NDArray[np.bool_]:
        """Return a mask of windows that were measured throughout; count the others by their worst row."""
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
    """A segmenter whose windows have times."""

    def __init__(self, length: int, rule: Rule, rate_hz: float, gaps: ShortGaps = NO_GAPS) -> None:
        super().__init__(length, rule, gaps)
        self._period_us = round(1e6 / rate_hz)
        # first sample and times of the first and last one [us] of all windows that are still undecided
        self._times = np.empty((3, 0), np.int64)

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
