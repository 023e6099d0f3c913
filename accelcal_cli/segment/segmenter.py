"""Windows before the decision, and what every rule of stillness must do with them.

Exact integer sums at floating-point speed.

A float holds every integer up to 2**24 (single) or 2**53 (double); a sum of integers whose
absolute values add up to less than that is exact in any order, so that the fast matrix product
gives the same integers as a slow integer loop.

The online segmenter: chunks in, still windows out, in bounded memory.

Windows are non-overlapping and start anew after every break, so that none spans a gap; what is
left of a run when it breaks is not used. The windows do not depend on how the rows are chunked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from accelcal_cli.core.points import WindowCounts, Windows
from accelcal_cli.core.recording import Chunk, Counts, Validity


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """m complete windows of n samples, one after the other, without a break between them.

    Attributes:
        run: number of the unbroken stretch that they are part of, rising with time.
        first_sample: number of the first window's first sample in the recording.
        columns: (3, m, n) raw counts.
        low, high: (3, m) int64, smallest and largest count.
        sums: (3, m) int64, sums of counts.
        usable: (m,) whether every row was measured.
        temperature_sums: (m,) int64, sums of thousandths of a degree C, or None.
        rotation: (m n, 3) gyroscope counts, or None.
    """

    run: int
    first_sample: int
    columns: NDArray[Any]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    sums: NDArray[np.int64]
    usable: NDArray[np.bool_]
    temperature_sums: NDArray[np.int64] | None = None
    rotation: Counts | None = None

    def __len__(self) -> int:
        return len(self.usable)

    @property
    def length(self) -> int:
        """Samples in a window."""
        return int(self.columns.shape[2])

    def first_samples(self) -> NDArray[np.int64]:
        """(m,) number of each window's first sample."""
        return self.first_sample + self.length * np.arange(len(self), dtype=np.int64)

    def windows(self, which: NDArray[np.bool_]) -> Windows:
        """The windows of a mask."""
        samples = np.full(len(self), self.length, np.int64)
        spread = (self.high - self.low).T
        return Windows(samples, self.first_samples(), self.sums.T, spread, self.temperature_sums).select(
            which
        )


class Rule(Protocol):
    """Decides which windows are still; one object a recording, since it may remember.

    What it yields is in the order of time, each made of one or more whole windows of the blocks, none
    of them unusable, none in two; it must not depend on how a run was cut into blocks.
    """

    def take(self, blocks: Blocks) -> list[Windows]:
        """Take windows in; returns the still ones that are decided by now."""

    def rest(self) -> list[Windows]:
        """What was held back; called once, after the last block."""


_EXACT: tuple[tuple[int, DTypeLike], ...] = ((1 << 24, np.float32), (1 << 53, np.float64))


def exact_type(bound: int) -> DTypeLike:
    """The fastest type in which integers that add up to `bound` stay exact."""
    for limit, kind in _EXACT:
        if bound <= limit:
            return kind
    return np.int64


def exact_sums(blocks: NDArray[Any], bound: int) -> NDArray[np.int64]:
    """Sums over the last axis of integers whose absolute values add up to at most `bound`."""
    kind = exact_type(bound)
    if kind is np.int64:
        return np.asarray(blocks.sum(axis=-1, dtype=np.int64))
    return np.asarray(blocks.astype(kind) @ np.ones(blocks.shape[-1], kind)).astype(np.int64)


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
    squares = sums_of_squares(_from_first(blocks), largest * largest * length)
    q, r = np.divmod(sums - length * blocks[:, 0].astype(np.int64), length)
    return squares - length * q * q - 2 * q * r, r


def _from_first(blocks: NDArray[Any]) -> NDArray[Any]:
    """Counts of each window less its first one, in a type that holds every difference."""
    values = blocks.astype(exact_type(1 << 8 * blocks.itemsize))
    values -= blocks[:, :1]
    return values


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
