"""Sample times in whole microseconds, computed only where they are wanted.

Every clock answers `times(start, stop)` for rows of one chunk. All arithmetic is integer, so
that the time of a sample does not depend on where the chunk that holds it begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

MICROSECONDS = 1_000_000


class Clock(Protocol):
    """Times of the rows of a chunk."""

    def times(self, start: int, stop: int) -> NDArray[np.int64]:
        """Times of rows start..stop-1 [us since 1970, device clock], shape (stop - start,)."""
        ...


def rate_fraction(rate_hz: float) -> Fraction:
    """The sampling rate as a fraction small enough for exact 64-bit time arithmetic."""
    return Fraction(rate_hz).limit_denominator(10_000)


@dataclass(frozen=True, slots=True)
class UniformClock:
    """Sample number k of the recording lies at start_us + k / rate, rounded to the nearest us.

    `first_index` is the sample number of the chunk's row 0, counted from `start_us`.
    """

    start_us: int
    first_index: int
    rate: Fraction

    def times(self, start: int, stop: int) -> NDArray[np.int64]:
        """Times of rows start..stop-1 [us], shape (stop - start,)."""
        step = MICROSECONDS * self.rate.denominator
        base = (self.first_index + start) * step + self.rate.numerator // 2
        whole, rest = divmod(base, self.rate.numerator)
        rows = np.arange(stop - start, dtype=np.int64)
        return self.start_us + whole + (rest + rows * step) // self.rate.numerator


@dataclass(frozen=True, slots=True)
class StampClock:
    """Every row carries its own time: `time_us` (n,) int64."""

    time_us: NDArray[np.int64]

    def times(self, start: int, stop: int) -> NDArray[np.int64]:
        """Times of rows start..stop-1 [us], shape (stop - start,)."""
        return self.time_us[start:stop]


@dataclass(frozen=True, slots=True)
class PageClock:
    """Rows between page stamps, evenly spread.

    Page j starts at row `first_row[j]` and at `time_us[j]`; `span_rows[j]` rows take
    `span_us[j]`. All are int64 arrays of shape (pages,); first_row ascends from 0 or below.
    """

    first_row: NDArray[np.int64]
    time_us: NDArray[np.int64]
    span_rows: NDArray[np.int64]
    span_us: NDArray[np.int64]

    def times(self, start: int, stop: int) -> NDArray[np.int64]:
        """Times of rows start..stop-1 [us], shape (stop - start,)."""
        if stop <= start:
            return np.empty(0, np.int64)
        low, last = np.searchsorted(self.first_row, (start, stop - 1), side="right") - 1
        pages = slice(int(low), int(last) + 1)
        edges = np.append(self.first_row[pages], stop)
        rows = np.diff(edges)
        longest = int(rows.max())
        if (rows[:-1] == longest).all() and (self.span_rows[pages] == longest).all():
            return self._even(pages, longest)[start - int(edges[0]) : stop - int(edges[0])]
        skipped = start - int(edges[0])
        rows[0] -= skipped
        return self._uneven(pages, rows, skipped)

    def _even(self, pages: slice, rows: int) -> NDArray[np.int64]:
        """Times of all rows of pages that hold `rows` rows each, one page after the other.

        Pages short enough for it are computed in 32 bits, in half the time.
        """
        span = self.span_us[pages]
        short = 2 * rows * (int(np.abs(span).max()) + 1) < 1 << 31
        kind = np.dtype(np.int32 if short else np.int64)
        into: NDArray[Any] = np.outer(span.astype(kind), 2 * np.arange(rows, dtype=kind))
        into += rows
        into //= 2 * rows
        return np.asarray(into + self.time_us[pages, np.newaxis]).reshape(-1)

    def _uneven(self, pages: slice, rows: NDArray[np.int64], skipped: int) -> NDArray[np.int64]:
        """Times of the first `rows[j]` rows of each page j, in the first one after `skipped` others."""
        span = np.repeat(self.span_rows[pages], rows)
        first = np.repeat(np.cumsum(rows) - rows, rows)
        into = np.arange(len(first), dtype=np.int64) - first
        into[: rows[0]] += skipped
        into *= np.repeat(self.span_us[pages], rows)
        return np.repeat(self.time_us[pages], rows) + (2 * into + span) // (2 * span)
