"""The online segmenter: chunks in, still windows out, in bounded memory.

Windows are non-overlapping and start anew after every break, so that none spans a gap; what is
left of a run when it breaks is not used. The windows do not depend on how the rows are chunked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import Chunk, Counts, Validity
from accelcal_cli.core.windows import WindowCounts, Windows
from accelcal_cli.segment._exact import sums as exact_sums
from accelcal_cli.segment.rules import StillRule


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Consecutive rows without a break."""

    first_sample: int
    counts: Counts
    temperature_mc: NDArray[np.int32] | None
    validity: NDArray[np.uint8] | None

    def __len__(self) -> int:
        return len(self.counts)

    def part(self, start: int, stop: int) -> Rows:
        """Rows start..stop-1, as views."""
        warm = None if self.temperature_mc is None else self.temperature_mc[start:stop]
        valid = None if self.validity is None else self.validity[start:stop]
        return Rows(self.first_sample + start, self.counts[start:stop], warm, valid)


class Segmenter:
    """Feed it chunks; it yields the still windows that are complete so far."""

    def __init__(self, length: int, rule: StillRule) -> None:
        self.length = length
        self.rule = rule
        self.counts = WindowCounts()
        self._pending: Rows | None = None

    def feed(self, chunk: Chunk) -> Iterator[Windows]:
        """Still windows that end in this chunk, a batch for each run between breaks."""
        edges = [0, *(int(row) for row in chunk.breaks if row > 0), len(chunk)]
        whole = Rows(chunk.first_sample, chunk.counts, chunk.temperature_mc, chunk.validity)
        if len(chunk.breaks) and chunk.breaks[0] == 0:
            self._pending = None
        for index, (start, stop) in enumerate(pairwise(edges)):
            if index:
                self._pending = None
            if stop > start:
                yield from self._run(whole.part(start, stop))

    def _run(self, rows: Rows) -> Iterator[Windows]:
        if self._pending is not None:
            need = self.length - len(self._pending)
            joined = join(self._pending, rows.part(0, min(need, len(rows))))
            if len(joined) < self.length:
                self._pending = joined
                return
            yield self._windows(joined)
            rows = rows.part(need, len(rows))
        whole = len(rows) // self.length * self.length
        if whole:
            yield self._windows(rows.part(0, whole))
        rest = rows.part(whole, len(rows))
        self._pending = _copy(rest) if len(rest) else None

    def _windows(self, rows: Rows) -> Windows:
        number = len(rows) // self.length
        usable = self._usable(rows, number)
        columns = np.ascontiguousarray(rows.counts.T).reshape(3, number, self.length)
        spread = columns.max(axis=2).astype(np.int64) - columns.min(axis=2)
        sums = exact_sums(columns, self.length * (1 << 8 * columns.itemsize - 1))
        still = self.rule.still(columns, spread, sums)
        self.counts += WindowCounts(complete=number, moving=int(np.sum(usable & ~still)))
        still &= usable
        self.counts += WindowCounts(still=int(still.sum()))
        first = rows.first_sample + self.length * np.arange(number, dtype=np.int64)
        warm = None
        if rows.temperature_mc is not None:
            warm = rows.temperature_mc.reshape(number, self.length).sum(axis=1, dtype=np.int64)
        samples = np.full(number, self.length, np.int64)
        return Windows(samples, first, sums.T, spread.T, warm).select(still)

    def _usable(self, rows: Rows, number: int) -> NDArray[np.bool_]:
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


def join(first: Rows, second: Rows) -> Rows:
    """Two stretches of rows, one after the other."""
    counts: Counts = np.concatenate([first.counts, second.counts])
    warm = None
    if first.temperature_mc is not None and second.temperature_mc is not None:
        warm = np.concatenate([first.temperature_mc, second.temperature_mc])
    return Rows(first.first_sample, counts, warm, _joined_validity(first, second))


def _joined_validity(first: Rows, second: Rows) -> NDArray[np.uint8] | None:
    if first.validity is None and second.validity is None:
        return None
    parts = [np.zeros(len(r), np.uint8) if r.validity is None else r.validity for r in (first, second)]
    return np.concatenate(parts)


def _copy(rows: Rows) -> Rows:
    """Own memory, so that a few pending rows do not keep a whole chunk alive."""
    warm = None if rows.temperature_mc is None else rows.temperature_mc.copy()
    valid = None if rows.validity is None else rows.validity.copy()
    return Rows(rows.first_sample, rows.counts.copy(), warm, valid)
