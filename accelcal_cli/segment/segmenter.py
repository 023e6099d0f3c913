"""The online segmenter: chunks in, still windows out, in bounded memory.

Windows are non-overlapping and start anew after every break, so that none spans a gap; what is
left of a run when it breaks is not used. The windows do not depend on how the rows are chunked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import Chunk, Counts, Validity
from accelcal_cli.core.windows import WindowCounts, Windows
from accelcal_cli.segment._exact import sums as exact_sums
from accelcal_cli.segment.blocks import Blocks, Rule


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Consecutive rows without a break."""

    first_sample: int
    counts: Counts
    temperature_mc: NDArray[np.int32] | None
    validity: NDArray[np.uint8] | None
    rotation: Counts | None = None

    def __len__(self) -> int:
        return len(self.counts)

    def part(self, start: int, stop: int) -> Rows:
        """Rows start..stop-1, as views."""
        warm = None if self.temperature_mc is None else self.temperature_mc[start:stop]
        valid = None if self.validity is None else self.validity[start:stop]
        turn = None if self.rotation is None else self.rotation[start:stop]
        return Rows(self.first_sample + start, self.counts[start:stop], warm, valid, turn)


class Segmenter:
    """Feed it chunks; it yields the still windows that are decided so far, the last from `finish`."""

    def __init__(self, length: int, rule: Rule) -> None:
        self.length = length
        self.rule = rule
        self.counts = WindowCounts()
        self._run_number = 0
        self._pending: Rows | None = None

    def feed(self, chunk: Chunk) -> Iterator[Windows]:
        """Still windows that are decided in this chunk, in batches."""
        edges = [0, *(int(row) for row in chunk.breaks if row > 0), len(chunk)]
        whole = Rows(
            chunk.first_sample, chunk.counts, chunk.temperature_mc, chunk.validity, chunk.gyro_counts
        )
        if len(chunk.breaks) and chunk.breaks[0] == 0:
            self._break()
        for index, (start, stop) in enumerate(pairwise(edges)):
            if index:
                self._break()
            if stop > start:
                yield from self._run(whole.part(start, stop))

    def finish(self) -> Iterator[Windows]:
        """Still windows that the rule held back; call once, after the last chunk."""
        for windows in self.rule.rest():
            self._count_still(windows)
            yield windows

    def _break(self) -> None:
        self._run_number += 1
        self._pending = None

    def _run(self, rows: Rows) -> Iterator[Windows]:
        if self._pending is not None:
            need = self.length - len(self._pending)
            joined = join(self._pending, rows.part(0, min(need, len(rows))))
            if len(joined) < self.length:
                self._pending = joined
                return
            yield from self._windows(joined)
            rows = rows.part(need, len(rows))
        whole = len(rows) // self.length * self.length
        if whole:
            yield from self._windows(rows.part(0, whole))
        rest = rows.part(whole, len(rows))
        self._pending = _copy(rest) if len(rest) else None

    def _windows(self, rows: Rows) -> Iterator[Windows]:
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

    def _blocks(self, rows: Rows) -> Blocks:
        number = len(rows) // self.length
        columns = np.ascontiguousarray(rows.counts.T).reshape(3, number, self.length)
        warm = None
        if rows.temperature_mc is not None:
            warm = rows.temperature_mc.reshape(number, self.length).sum(axis=1, dtype=np.int64)
        return Blocks(
            self._run_number,
            rows.first_sample,
            columns,
            columns.min(axis=2).astype(np.int64),
            columns.max(axis=2).astype(np.int64),
            exact_sums(columns, self.length * (1 << 8 * columns.itemsize - 1)),
            self._usable(rows, number),
            warm,
            rows.rotation,
        )

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
    warm = _joined(first.temperature_mc, second.temperature_mc)
    turn = _joined(first.rotation, second.rotation)
    return Rows(first.first_sample, counts, warm, _joined_validity(first, second), turn)


def _joined(first: NDArray[Any] | None, second: NDArray[Any] | None) -> NDArray[Any] | None:
    """Values of both stretches; None where one has none."""
    return None if first is None or second is None else np.concatenate([first, second])


def _joined_validity(first: Rows, second: Rows) -> NDArray[np.uint8] | None:
    if first.validity is None and second.validity is None:
        return None
    parts = [np.zeros(len(r), np.uint8) if r.validity is None else r.validity for r in (first, second)]
    return np.concatenate(parts)


def _copy(rows: Rows) -> Rows:
    """Own memory, so that a few pending rows do not keep a whole chunk alive."""
    warm = None if rows.temperature_mc is None else rows.temperature_mc.copy()
    valid = None if rows.validity is None else rows.validity.copy()
    turn = None if rows.rotation is None else rows.rotation.copy()
    return Rows(rows.first_sample, rows.counts.copy(), warm, valid, turn)
