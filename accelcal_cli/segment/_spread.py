"""How much a window varies, and the least that was ever seen; exact in integers.

Variances are compared as `n times the variance, rounded up`: equal windows have equal integers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.segment._exact import centred_squares

MOVING = 1 << 62
"""Instead of a variance, of a window that varies too much to look at."""
NEVER = 1 << 52
"""Instead of a minimum, before there is one: up to 30^2 times it is below MOVING."""
NORM_BITS = 17


def norm_bits(lsb_per_g: float) -> int:
    """b, so that one g has between 2^16 and 2^17 units of 2^-b counts."""
    return NORM_BITS - int(np.frexp(lsb_per_g)[1])


def norms(columns: NDArray[Any], bits: int) -> NDArray[np.int64]:
    """|a| in units of 2^-bits counts, of (3, ...) counts.

    Products, sums, roots and powers of two are each rounded correctly (IEEE 754) in a fixed order,
    so that the integers are the same on every machine.
    """
    x, y, z = columns.astype(np.float64)
    return np.asarray(np.rint(np.ldexp(np.sqrt(x * x + y * y + z * z), bits)).astype(np.int64))


def squares(blocks: NDArray[Any], widest: int) -> NDArray[np.int64]:
    """n times the variance of (m, n) values, rounded up; MOVING where max - min reaches `widest`."""
    spread = blocks.max(axis=1).astype(np.int64) - blocks.min(axis=1)
    found = np.full(len(blocks), MOVING, np.int64)
    at = np.flatnonzero(spread < widest)
    if len(at):
        near = blocks[at].astype(np.int64)
        centred, r = centred_squares(near, spread[at], near.sum(axis=1))
        found[at] = centred - r * r // blocks.shape[1]
    return found


def steps(columns: NDArray[Any], widest: int) -> NDArray[np.int64]:
    """(m,) smallest difference of two consecutive values of (axes, m, n), 0 apart; or `widest`."""
    jumps = np.abs(np.diff(columns.astype(np.int64), axis=2))
    jumps[jumps == 0] = widest
    return np.asarray(jumps.min(axis=(0, 2), initial=widest))


class LeastSpread:
    """The smallest n times the variance so far, but never less than what the sensor's step allows.

    Readings in steps of d have a standard deviation of d / sqrt(12) from rounding alone; where a
    window has less, the value happened to lie between two steps. The step is the smallest difference
    of two consecutive readings so far, at first `widest` counts.
    """

    def __init__(self, length: int, axes: int, widest: int, bits: int = 0) -> None:
        """For n = `length` samples, variances summed over so many axes in units of 2^-bits counts."""
        self.length = length
        self.axes = axes
        self.widest = widest
        self.bits = bits
        self.step = widest
        self._least = NEVER

    def now(self) -> int:
        """The minimum after all windows so far."""
        return max(self._least, self._floor(self.step))

    def follow(
        self, found: NDArray[np.int64], columns: NDArray[Any], at: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """The minimum after each of m windows, (m,).

        Args:
            found: (m,) n times the variance of each; 0 and MOVING are no minimum.
            columns: (axes, k, n) the readings, in counts, of the k windows that have a part in it.
            at: (k,) their numbers.
        """
        counted = np.full(len(found), NEVER)
        counted[at] = np.where((found[at] > 0) & (found[at] < NEVER), found[at], NEVER)
        least = np.minimum(np.minimum.accumulate(counted), self._least)
        step = self._steps(columns, at, len(found))
        floors = {value: self._floor(value) for value in set(step.tolist())}
        held = np.array([floors[value] for value in step.tolist()], np.int64)
        self._least, self.step = int(least[-1]), int(step[-1])
        return np.maximum(least, held)

    def _steps(self, columns: NDArray[Any], at: NDArray[np.int64], number: int) -> NDArray[np.int64]:
        """The sensor's step after each window, (m,); it cannot be less than a count."""
        found = np.full(number, self.step)
        if self.step > 1:
            found[at] = steps(columns, self.widest)
        return np.minimum(np.minimum.accumulate(found), self.step)

    def _floor(self, step: int) -> int:
        """n times the variance of rounding to steps, at least 1, at most NEVER."""
        whole = self.axes * self.length * step * step
        scaled = whole << 2 * self.bits if self.bits >= 0 else whole >> -2 * self.bits
        return max(1, min(NEVER, scaled // 12))
