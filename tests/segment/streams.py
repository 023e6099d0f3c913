"""Recordings as arrays, ways to cut them into chunks, and a segmenter in plain Python."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np

from accelcal_cli.core.clock import Clock, StampClock, UniformClock
from accelcal_cli.core.points import WindowCounts, Windows
from accelcal_cli.core.recording import Chunk, Validity
from accelcal_cli.segment import StillRule
from accelcal_cli.segment.segmenter import NO_GAPS, Rule, Segmenter, ShortGaps

Row = tuple[int, tuple[int, ...], tuple[int, ...], int | None]
"""A still window: first sample, sums, spreads, temperature sum."""


@dataclass(frozen=True)
class Stream:
    """A whole recording; `breaks` are the rows before which it is not continuous.

    `jumps` are rows before which only the clock jumps, `times_us` the times; None: evenly spaced.
    """

    counts: np.ndarray
    breaks: tuple[int, ...] = ()
    temperature_mc: np.ndarray | None = None
    validity: np.ndarray | None = None
    gyro: np.ndarray | None = None
    jumps: tuple[int, ...] = ()
    times_us: np.ndarray | None = None

    def chunks(self, cuts: Iterable[int] = ()) -> Iterator[Chunk]:
        """The recording cut at the given rows; a row named twice gives an empty chunk."""
        for low, high in pairwise([0, *sorted(cuts), len(self.counts)]):
            yield self._chunk(low, high)

    def _chunk(self, low: int, high: int) -> Chunk:
        breaks = [row - low for row in sorted({*self.breaks, *self.jumps}) if low <= row < high]
        jumps = [row - low for row in sorted(set(self.jumps) - set(self.breaks)) if low <= row < high]
        clock: Clock = UniformClock(0, low, Fraction(100))
        if self.times_us is not None:
            clock = StampClock(self.times_us[low:high])
        warm = None if self.temperature_mc is None else self.temperature_mc[low:high]
        valid = None if self.validity is None else self.validity[low:high]
        if valid is not None and not valid.any():
            valid = None
        return Chunk(
            low,
            self.counts[low:high],
            clock,
            0,
            breaks=np.array(breaks, np.int64),
            clock_jumps=np.array(jumps, np.int64),
            temperature_mc=warm,
            gyro_counts=None if self.gyro is None else self.gyro[low:high],
            validity=valid,
        )


def segmented(
    stream: Stream, length: int, rule: StillRule, cuts: Iterable[int] = (), gaps: ShortGaps = NO_GAPS
) -> tuple[list[Row], WindowCounts]:
    """What the segmenter makes of a stream cut into chunks."""
    batches, counts = batched(stream, length, rule, cuts, gaps)
    return [row for windows in batches for row in rows(windows)], counts


def batched(
    stream: Stream, length: int, rule: Rule, cuts: Iterable[int] = (), gaps: ShortGaps = NO_GAPS
) -> tuple[list[Windows], WindowCounts]:
    """All that the segmenter yields for a stream cut into chunks."""
    segmenter = Segmenter(length, rule, gaps)
    found = [windows for chunk in stream.chunks(cuts) for windows in segmenter.feed(chunk)]
    found += segmenter.finish()
    return found, segmenter.counts


def rows(windows: Windows) -> list[Row]:
    """Windows as plain tuples."""
    warm = windows.temperature_sums
    temperatures = [None] * len(windows) if warm is None else warm.tolist()
    columns = (windows.first_sample.tolist(), windows.sums.tolist(), windows.spread.tolist(), temperatures)
    return [
        (first, tuple(sums), tuple(spread), heat) for first, sums, spread, heat in zip(*columns, strict=True)
    ]


def run_starts(stream: Stream, length: int, gaps: ShortGaps) -> list[int]:
    """Where runs begin, by the definition, row by row: a short jump within a window ends it only if there
    were too many."""
    starts, rows_in_window, gone_over_us = [0], 0, 0
    for row in range(1, len(stream.counts)):
        rows_in_window += 1
        if rows_in_window == length:
            rows_in_window = gone_over_us = 0
        if row not in stream.breaks + stream.jumps:
            continue
        jump_us = gaps.longest_us + 1
        if row in stream.jumps and row not in stream.breaks and stream.times_us is not None:
            jump_us = abs(int(stream.times_us[row]) - int(stream.times_us[row - 1]))
        if rows_in_window:
            gone_over_us += jump_us
        if jump_us > gaps.longest_us or gone_over_us > gaps.together_us:
            starts.append(row)
            rows_in_window = gone_over_us = 0
    return starts


def naive(
    stream: Stream, length: int, rule: StillRule, gaps: ShortGaps = NO_GAPS
) -> tuple[list[Row], WindowCounts]:
    """The same by the definition: runs between breaks, windows from each run's start."""
    found: list[Row] = []
    fates = dict.fromkeys(WindowCounts.__dataclass_fields__, 0)
    edges = [*run_starts(stream, length, gaps), len(stream.counts)]
    for low, high in pairwise(edges):
        for first in range(low, high - length + 1, length):
            fate = _fate(stream, first, first + length, rule)
            fates["complete"] += 1
            fates[fate] += 1
            if fate == "still":
                found.append(_row(stream, first, first + length))
    return found, WindowCounts(**fates)


def _fate(stream: Stream, low: int, high: int, rule: StillRule) -> str:
    flags = [] if stream.validity is None else stream.validity[low:high].tolist()
    for flag in (Validity.FILLED, Validity.CLIPPED, Validity.RECOVERED):
        if flag in flags:
            return flag.name.lower()
    return "still" if naive_still(stream.counts[low:high].tolist(), rule) else "moving"


def naive_still(block: list[list[int]], rule: StillRule) -> bool:
    """F's rule and the rule of the standard deviation, in Fractions."""
    columns = list(zip(*block, strict=True))
    if any(max(columns[axis]) - min(columns[axis]) >= rule.spread_limit for axis in rule.axes):
        return False
    if rule.variance_limit is None:
        return True
    return all(variance(column) < rule.variance_limit for column in columns)


def variance(column: Iterable[int]) -> Fraction:
    """Mean square minus squared mean, exact."""
    values = [int(value) for value in column]
    mean = Fraction(sum(values), len(values))
    return Fraction(sum(value * value for value in values), len(values)) - mean * mean


def _row(stream: Stream, low: int, high: int) -> Row:
    columns = list(zip(*stream.counts[low:high].tolist(), strict=True))
    heat = None if stream.temperature_mc is None else sum(stream.temperature_mc[low:high].tolist())
    return (
        low,
        tuple(sum(column) for column in columns),
        tuple(max(column) - min(column) for column in columns),
        heat,
    )
