"""Times of rows as the steps between them: those of a steady clock differ by less than a byte holds.

So they take an eighth of the memory, and clocks often know them without computing the time of any row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

CACHED = 1 << 14
"""Steps are looked at so many at a time, which the processor's cache holds."""

WIDEST = int(np.iinfo(np.uint8).max)
"""Steps that differ by no more take a byte each."""


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Times of n rows, at least one.

    Attributes:
        first_us, last_us: times of the first row and of the last [us since 1970].
        least_us: the shortest step from a row to the next, negative where time goes back; 0 of one row.
        above: (n - 1,) by how much each step is longer: uint8, or int64 where they differ by more than
            WIDEST.
    """

    first_us: int
    last_us: int
    least_us: int
    above: NDArray[Any]

    def __len__(self) -> int:
        return len(self.above) + 1

    def times(self) -> NDArray[np.int64]:
        """Times of all rows [us since 1970], (n,)."""
        times = np.empty(len(self), np.int64)
        times[0] = self.first_us
        np.add(self.above, self.least_us, out=times[1:], dtype=np.int64)
        return np.cumsum(times, out=times)


def steps_of(times_us: NDArray[np.int64]) -> Steps:
    """The steps between (n,) times of at least one row."""
    last = len(times_us) - 1
    ends = [(start, min(start + CACHED, last)) for start in range(0, last, CACHED)]
    bounds = [_bounds(np.diff(times_us[start : stop + 1])) for start, stop in ends]
    least, most = min((low for low, _ in bounds), default=0), max((high for _, high in bounds), default=0)
    above: NDArray[Any] = np.empty(last, _kind(least, most))
    for start, stop in ends:
        np.subtract(np.diff(times_us[start : stop + 1]), least, out=above[start:stop], casting="unsafe")
    return Steps(int(times_us[0]), int(times_us[-1]), least, above)


def joined_steps(parts: Sequence[Steps]) -> Steps:
    """Those of rows, at least one, that follow one another."""
    if len(parts) == 1:
        return parts[0]
    first, last = (np.array([getattr(part, end) for part in parts]) for end in ("first_us", "last_us"))
    between = first[1:] - last[:-1]
    least, most = _bounds(between)
    several = [part for part in parts if len(part.above)]
    least = min([least, *(part.least_us for part in several)])
    most = max([most, *(part.least_us + int(part.above.max()) for part in several)])
    if _kind(least, most) is np.int64 or any(part.above.dtype == np.int64 for part in several):
        return steps_of(np.concatenate([part.times() for part in parts]))
    above, at = np.empty(sum(map(len, parts)) - 1, np.uint8), 0
    for part, step in zip(parts, [*between.tolist(), least], strict=True):
        if len(part.above):
            np.add(part.above, np.uint8(part.least_us - least), out=above[at : at + len(part.above)])
        at += len(part)
        above[at - 1 : at] = step - least  # nothing behind the last part
    return Steps(parts[0].first_us, parts[-1].last_us, least, above)


def _bounds(steps: NDArray[np.int64]) -> tuple[int, int]:
    return int(steps.min()), int(steps.max())


def _kind(least: int, most: int) -> type:
    """What holds by how much steps are longer than the shortest."""
    return np.uint8 if most - least <= WIDEST else np.int64
