"""Turns between rests, for the gyroscope: collected window by window, in bounded memory, as exact integers.

A turn lies between two rests of at least LEAST_WINDOWS windows, lasts at most LONGEST_S without a break, and
gravity has another direction after it (G 4.3 compares gravity from one still state to the next). In long
recordings not all turns are kept (`_KeptTurns`). The sums at rest are kept by blocks of time, which become
longer as there are more.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import cos, radians, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.gyroscope import Rest, RestRates, Triple, Turn, Turns
from accelcal_cli.core.recording import Counts

LEAST_WINDOWS = 2
"""Fewest windows of a rest: a shorter quiet moment may be part of a slow turn."""

END_WINDOWS = 5
"""Windows of a rest, nearest to the turn, from which gravity's direction and the bias are taken."""

LONGEST_S = 30.0
"""Longest turn that is used [s]: errors of noise and bias add up."""

ROUGH_TURN_DEG = 15.0
"""Smallest turn [degrees] by raw values, so that all turns of 20 degrees by calibrated ones are included."""

REVOLUTION_DEG = 180.0
"""Raw angle [degrees] about an axis above which a turn that ends as it began may be a whole revolution."""

MOST_DEG = 180.0
"""Turn [degrees] from one sample to the next beyond which the direction is ambiguous."""

MAX_ROWS = 1 << 19
"""Most samples of all turns that are kept: 87 minutes of turning at 100 Hz, five days of a wrist; 3 MB."""

MAX_BLOCKS, BLOCK_S = 1024, 60
"""Most blocks of time for the sums at rest, and their length at first [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroWindows:
    """m windows that follow one another without a break, of n samples each.

    Attributes:
        fresh: True if the first window does not continue the one before.
        first_sample: number of the first sample.
        time_us: (m,) time of each window's first sample.
        resting: (m,) True where accelerometer and gyroscope rested.
        usable: (m,) True where the gyroscope measured throughout.
        sums, gyro_sums: (m, 3) sums of the counts of accelerometer and gyroscope.
        counts: (m n, 3) the gyroscope's counts.
        temperature_sums: (m,) sums of thousandths of a degree C, or None.
    """

    fresh: bool
    first_sample: int
    time_us: NDArray[np.int64]
    resting: NDArray[np.bool_]
    usable: NDArray[np.bool_]
    sums: NDArray[np.int64]
    gyro_sums: NDArray[np.int64]
    counts: Counts
    temperature_sums: NDArray[np.int64] | None

    @property
    def length(self) -> int:
        """Samples in a window."""
        return len(self.counts) // len(self.resting)


class _Resting:
    """A rest in progress: its first and last windows, a row of `_columns` each.

    Attributes:
        counts: those of the gyroscope while it is too short to be a rest: then they are part of a turn.
    """

    def __init__(self, rows: NDArray[np.int64], counts: Counts) -> None:
        self.windows = len(rows)
        self.head, self.tail = rows[:END_WINDOWS].copy(), rows[-END_WINDOWS:].copy()
        self.counts = counts[:0] if self.is_rest else counts.copy()

    def go_on(self, rows: NDArray[np.int64], counts: Counts) -> None:
        """Add further windows."""
        self.windows += len(rows)
        self.counts = counts[:0] if self.is_rest else np.concatenate([self.counts, counts])
        self.head = np.concatenate([self.head, rows])[:END_WINDOWS]
        self.tail = np.concatenate([self.tail, rows])[-END_WINDOWS:]

    @property
    def is_rest(self) -> bool:
        """True if it lasts long enough."""
        return self.windows >= LEAST_WINDOWS


_SAMPLE, _TIME, _SUMS, _GYRO, _HEAT, _WARM = 0, 1, slice(2, 5), slice(5, 8), 8, 9
"""Columns of a row: first sample and its time, sums of both sensors and of temperature, 1 if there is one."""


def _columns(windows: GyroWindows) -> NDArray[np.int64]:
    """Return a row (10,) of each window."""
    number = len(windows.resting)
    sample = windows.first_sample + windows.length * np.arange(number, dtype=np.int64)
    heat = windows.temperature_sums
    warm = np.full(number, heat is not None, np.int64)
    heat = np.zeros(number, np.int64) if heat is None else heat
    return np.column_stack([sample, windows.time_us, windows.sums, windows.gyro_sums, heat, warm])


def _rest(rows: NDArray[np.int64], length: int) -> Rest:
    total = rows.sum(axis=0)
    return Rest(
        sample=int(rows[0, _SAMPLE]),
        samples=len(rows) * length,
        sums=tuple(total[_SUMS].tolist()),
        gyro_sums=tuple(total[_GYRO].tolist()),
        temperature_sum=int(total[_HEAT]) if rows[:, _WARM].all() else None,
    )


class TurnCollector:
    """Collects turns from windows in the order of time; call `result` after the last.

    Args:
        length: number of samples of a window.
        revolutions: also keep turns that bring gravity back to where it was, as in a session.
    """

    def __init__(
        self, length: int, rate_hz: float, dps_per_lsb: Triple, lsb_per_g: float, *, revolutions: bool = False
    ) -> None:
        self._length, self._revolutions = length, revolutions
        self._dps_per_lsb, self._lsb_per_g = dps_per_lsb, lsb_per_g
        self._period_s = 1 / rate_hz
        self._longest = round(LONGEST_S * rate_hz)
        self._rates = _RatesAtRest(max(length, round(BLOCK_S * rate_hz)))
        self._kept = _KeptTurns(MAX_ROWS)
        self._before: _Resting | None = None
        self._now: _Resting | None = None
        self._path: list[Counts] = []

    def add(self, windows: GyroWindows) -> None:
        """Take further windows."""
        if windows.fresh:
            self._break()
        rows, length = _columns(windows), self._length
        self._rates.add(rows[windows.resting], length)
        kind = np.where(windows.usable, windows.resting.astype(np.int64), -1)
        edges = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
        for low, high in pairwise(edges):
            counts = windows.counts[low * length : high * length]
            if kind[low] < 0:
                self._break()
            elif kind[low]:
                if self._now is None:
                    self._now = _Resting(rows[low:high], counts)
                else:
                    self._now.go_on(rows[low:high], counts)
            else:
                self._add_movement(counts)

    def result(self) -> Turns:
        """Return the turns, and the rates at rest."""
        self._break()
        turns, left_out = self._kept.result()
        rates = self._rates.result()
        return Turns(turns, rates, left_out, self._dps_per_lsb, self._lsb_per_g, self._period_s)

    def _break(self) -> None:
        """End rest and turn, since the next window does not continue them."""
        self._end_rest()
        self._before, self._now, self._path = None, None, []

    def _add_movement(self, counts: Counts) -> None:
        self._end_rest()
        if self._before is None:
            return
        self._path.append(counts[: self._longest + 1].copy())
        if sum(map(len, self._path)) > self._longest:
            self._before, self._path = None, []

    def _end_rest(self) -> None:
        """End the present rest: a turn ends with it, or it was too short and is part of the movement."""
        now, self._now = self._now, None
        if now is None:
            return
        if now.is_rest:
            if self._before is not None and self._path:
                self._note_turn(self._before, now)
            self._before, self._path = now, []
        elif self._before is not None:
            self._path.append(now.counts)

    def _note_turn(self, before: _Resting, after: _Resting) -> None:
        counts: Any = np.concatenate(self._path)
        start, end = before.tail[0], after.head[0]
        period_us = int(end[_TIME] - start[_TIME]) / int(end[_SAMPLE] - start[_SAMPLE])
        turn = Turn(_rest(before.tail, self._length), _rest(after.head, self._length), counts, period_us)
        limits = np.iinfo(np.int16)  # devices use them up to their range
        saturated = counts.dtype == np.int16 and (counts.min() == limits.min or counts.max() == limits.max)
        turned = _turned(turn)
        if period_us <= 0 or saturated or not (turned or self._revolutions):
            return
        degrees = np.abs(self._dps_per_lsb) * (period_us / 1e6)  # in one count
        revolved = (np.abs(counts.sum(axis=0, dtype=np.int64)) * degrees).max() > REVOLUTION_DEG
        largest = np.abs(counts.astype(np.int64)).max(axis=0) * degrees
        if (turned or revolved) and (largest < MOST_DEG).all():
            self._kept.add(turn)


def _turned(turn: Turn) -> bool:
    """Return True if gravity's direction changed, by the raw values."""
    u, v = turn.before.sums, turn.after.sums
    across = sum(a * b for a, b in zip(u, v, strict=True))
    lengths = sqrt(sum(a * a for a in u)) * sqrt(sum(b * b for b in v))
    return across < cos(radians(ROUGH_TURN_DEG)) * lengths


class _KeptTurns:
    """Turns with a limited number of samples in all.

    Beyond the limit, the longest turn about the axis and in the direction with most samples is dropped: a
    short one says as much, with less noise. A turn that the recording holds twice is kept once.
    """

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self._turns: dict[int, Turn] = {}
        self._kinds: dict[int, int] = {}
        self._sizes = dict.fromkeys(range(6), 0)
        self._seen: set[tuple[int, ...]] = set()
        self._number = self._left_out = 0

    def add(self, turn: Turn) -> None:
        """Add a turn."""
        key = (len(turn), *turn.before.sums, *turn.before.gyro_sums, *turn.after.sums, *turn.after.gyro_sums)
        if key in self._seen:
            return
        self._seen.add(key)
        self._turns[self._number], self._kinds[self._number] = turn, _kind(turn)
        self._sizes[self._kinds[self._number]] += len(turn)
        self._number += 1
        while sum(self._sizes.values()) > self._rows:
            fullest = max(self._sizes, key=lambda kind: (self._sizes[kind], kind))
            numbers = [number for number, kind in self._kinds.items() if kind == fullest]
            longest = max(numbers, key=lambda number: (len(self._turns[number]), number))
            self._sizes[fullest] -= len(self._turns.pop(longest))
            del self._kinds[longest]
            self._left_out += 1

    def result(self) -> tuple[tuple[Turn, ...], int]:
        """Return the turns, and how many were dropped."""
        return tuple(self._turns.values()), self._left_out


def _kind(turn: Turn) -> int:
    """Return the axis of most turning and its direction as 0 to 5, exactly."""
    before, after, n = turn.before, turn.after, len(turn)
    rests = before.samples + after.samples
    sums = turn.counts.sum(axis=0, dtype=np.int64).tolist()
    still = zip(before.gyro_sums, after.gyro_sums, strict=True)
    turned = [total * rests - (one + other) * n for total, (one, other) in zip(sums, still, strict=True)]
    axis = max(range(3), key=lambda index: abs(turned[index]))
    return 2 * axis + int(turned[axis] > 0)


class _RatesAtRest:
    """Sums at rest by blocks of time; pairs of blocks are joined when there are too many."""

    def __init__(self, block_samples: int) -> None:
        self._block_samples = block_samples
        self._sums = np.zeros((MAX_BLOCKS, 6), np.int64)

    def add(self, rows: NDArray[np.int64], length: int) -> None:
        """Add windows at rest."""
        if not len(rows):
            return
        while rows[-1, _SAMPLE] // self._block_samples >= MAX_BLOCKS:
            pairs = self._sums.reshape(MAX_BLOCKS // 2, 2, -1).sum(axis=1)
            self._sums = np.concatenate([pairs, np.zeros_like(pairs)])
            self._block_samples *= 2
        block = rows[:, _SAMPLE] // self._block_samples
        number = np.full(len(rows), length, np.int64)
        values = np.column_stack([number, rows[:, _GYRO], rows[:, _HEAT], number * rows[:, _WARM]])
        np.add.at(self._sums, block, values)

    def result(self) -> RestRates:
        """Return the blocks with rest; without temperature if one of them lacks it."""
        blocks = self._sums[self._sums[:, 0] > 0]
        warm = bool(len(blocks)) and bool((blocks[:, 0] == blocks[:, 5]).all())
        return RestRates(blocks[:, 0], blocks[:, 1:4], blocks[:, 4] if warm else None)
