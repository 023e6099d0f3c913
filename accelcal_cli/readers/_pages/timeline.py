"""When each page of a dump began, and where one page does not continue the page before.

A timeline takes pages in file order, the last page of one call being the first of the next, so
that the times do not depend on how many pages a call brings. Between two pages that continue
each other the samples are spread evenly; a page before a break runs at the nominal rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.readers._pages.pages import PageBlock

RATE_TOLERANCE = 0.1
"""Sensors run up to 6 % off their nominal rate; a page may last this much more or less."""

STAMP_TOLERANCE_SAMPLES = 1.5
"""And a stamp may be this many sample intervals early or late."""

LONGEST_GAP_S = 365 * 86_400
"""A sequence number that jumps further is taken for a new numbering."""

LATEST_US = 1 << 61


@dataclass(frozen=True, slots=True)
class Spacing:
    """What is known of a recording's pages before reading them.

    Attributes:
        rate: samples per second.
        rows: samples in a full page.
        sequence_bits: width of the sequence number, after which it starts from 0 again.
    """

    rate: Fraction
    rows: int
    sequence_bits: int = 32

    def rows_us(self, rows: NDArray[np.int64] | int) -> NDArray[np.float64]:
        """How long so many samples last [us]."""
        return np.asarray(rows * (MICROSECONDS * self.rate.denominator) / self.rate.numerator)


@dataclass(frozen=True, slots=True)
class Steps:
    """From each page to the next, (m - 1,).

    Attributes:
        pages: by how many pages the recording went on, at least 1.
        missing: how many of these are not in the file at all.
        back: the sequence number did not rise.
    """

    pages: NDArray[np.int64]
    missing: NDArray[np.int64]
    back: NDArray[np.bool_]


def steps(block: PageBlock, spacing: Spacing) -> Steps:
    """Compare positions and sequence numbers of neighbouring pages."""
    across = np.diff(block.position)
    if block.sequence is None:
        return Steps(across, np.zeros_like(across), np.zeros(len(across), np.bool_))
    rise = np.diff(block.sequence) % (1 << spacing.sequence_bits)
    longest = int(LONGEST_GAP_S * spacing.rate / spacing.rows) + 1
    back = (rise == 0) | (rise > min(longest, 1 << (spacing.sequence_bits - 1)))
    forward = np.where(back, across, rise)
    return Steps(np.maximum(forward, across), np.maximum(forward - across, 0), back)


@dataclass(frozen=True, slots=True)
class Links:
    """Times of m pages and how each of the first m - 1 goes on.

    Attributes:
        time_us: (m,) int64, first sample of each page.
        broken: (m - 1,) bool, the next page does not continue this one.
        ahead_us, behind_us: (m - 1,) int64, by how much the clock jumps before the next page
            beyond what the samples explain; 0 where it does not.
    """

    time_us: NDArray[np.int64]
    broken: NDArray[np.bool_]
    ahead_us: NDArray[np.int64]
    behind_us: NDArray[np.int64]


class Timeline(Protocol):
    """Gives pages their times. `start` once, then `link` with overlapping stretches of pages."""

    def start(self, block: PageBlock) -> int:
        """Time of the block's first page [us]."""
        ...

    def link(self, block: PageBlock, step: Steps, start_us: int) -> Links:
        """Times of all pages of a block whose first page begins at `start_us`."""
        ...


def fresh_pages(block: PageBlock) -> NDArray[np.bool_]:
    """Which pages but the first say that they do not continue the one before, (m - 1,)."""
    return np.zeros(len(block) - 1, np.bool_) if block.fresh is None else block.fresh[1:]


class NominalTimeline:
    """Pages without a stamp: they follow each other at the nominal rate, lost ones included."""

    def __init__(self, spacing: Spacing, origin_us: int) -> None:
        self._spacing = spacing
        self._origin_us = origin_us
        self._slot = 0
        self._latest = int(LATEST_US // MICROSECONDS * spacing.rate / spacing.rows)

    def start(self, block: PageBlock) -> int:
        """The file's page 0 begins at the origin."""
        self._slot = int(block.position[0])
        return self._times([self._slot])[0]

    def link(self, block: PageBlock, step: Steps, start_us: int) -> Links:
        """Count pages, by sequence number where there is one."""
        slots = self._slot + np.cumsum(np.concatenate(([0], step.pages)))
        slots = np.minimum(slots, self._latest)
        self._slot = int(slots[-1])
        time_us = np.array(self._times(slots.tolist()), np.int64)
        short = block.rows[:-1] < self._spacing.rows
        none = np.zeros(len(short), np.int64)
        broken = short | (step.pages > 1) | step.back | fresh_pages(block)
        return Links(time_us, broken, none, none)

    def _times(self, slots: list[int]) -> list[int]:
        samples_per_s = self._spacing.rate.numerator
        step = self._spacing.rows * MICROSECONDS * self._spacing.rate.denominator
        half = samples_per_s // 2
        return [self._origin_us + (slot * step + half) // samples_per_s for slot in slots]


class ExactTimeline:
    """Pages with stamps finer than a sample: each page begins at its stamp."""

    def __init__(self, spacing: Spacing) -> None:
        self._spacing = spacing

    def start(self, block: PageBlock) -> int:
        """The first stamp."""
        return int(stamps(block)[0])

    def link(self, block: PageBlock, step: Steps, start_us: int) -> Links:
        """A jump of the clock is what neither the samples nor `tolerance_us` explain."""
        time_us = stamps(block)
        lasted = np.diff(time_us)
        expected = self._spacing.rows_us(block.rows[:-1])
        allowed = tolerance_us(expected, self._spacing)
        ahead = (lasted > expected + allowed) & (step.pages == 1)
        behind = lasted < expected - np.minimum(allowed, expected / 2)
        off = np.rint(lasted - expected).astype(np.int64)
        broken = ahead | behind | (step.pages > 1) | step.back | fresh_pages(block)
        return Links(time_us, broken, np.where(ahead, off, 0), np.where(behind, -off, 0))


def stamps(block: PageBlock) -> NDArray[np.int64]:
    """The pages' stamps, which a timeline by stamps needs."""
    assert block.time_us is not None
    return block.time_us


def tolerance_us(expected_us: NDArray[np.float64], spacing: Spacing) -> NDArray[np.float64]:
    """How far the length of a page may differ from the nominal one before the clock has jumped."""
    return RATE_TOLERANCE * expected_us + STAMP_TOLERANCE_SAMPLES * float(spacing.rows_us(1))
