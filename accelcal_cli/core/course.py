"""How a sensor that changes while it records is put right, before its calibration is applied."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import ONE, rounded_quotient

Knot = tuple[int, int, int]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Course:
    """r v + d takes the place of raw v, axis by axis.

    From each knot to the next, r and d stay as they are or go on straight lines; behind the last they stay.

    Attributes:
        samples: number of each knot's first sample in the recording; the first is 0, and they ascend.
        stretch: fixed-point r of x, y, z at each knot.
        shift: fixed-point d of x, y, z at each knot [g].
        lines: whether there are straight lines between knots.
    """

    samples: tuple[int, ...]
    stretch: tuple[Knot, ...]
    shift: tuple[Knot, ...]
    lines: bool

    def at(self, sample: int) -> tuple[Knot, Knot]:
        """r and d of a sample, in fixed point."""
        after = bisect_right(self.samples, sample)
        if not self.lines or after == len(self.samples):
            return self.stretch[after - 1], self.shift[after - 1]
        into, apart = sample - self.samples[after - 1], self.samples[after] - self.samples[after - 1]
        stretch, shift = (
            _between(knots[after - 1], knots[after], into, apart) for knots in (self.stretch, self.shift)
        )
        return stretch, shift

    def values(self, samples: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """r and d [g] of samples (n,) that ascend, each (n, 3); (1, 3) where it is the same for all."""
        knots = np.array(self.samples, np.int64)
        first, last = np.searchsorted(knots, samples[[0, -1]], side="right") - 1
        left = np.array([first]) if first == last else np.searchsorted(knots, samples, side="right") - 1
        right = np.minimum(left + self.lines, len(knots) - 1)
        share = (samples - knots[left]) / np.maximum(1, knots[right] - knots[left])

        def along(column: tuple[Knot, ...]) -> Floats:
            ends = np.array(column) / ONE
            rise = ends[right] - ends[left]
            return np.asarray(ends[left] + rise * share[:, np.newaxis] if rise.any() else ends[left])

        return along(self.stretch), along(self.shift)

    def in_standard_g(self, local_g: Fraction) -> Course:
        """The same for points in standard g, of one for points in units of local gravity."""
        return replace(self, shift=tuple(_times(knot, local_g) for knot in self.shift))

    def in_local_g(self, local_g: Fraction) -> Course:
        """The same for points in units of local gravity, of one for points in standard g."""
        return replace(self, shift=tuple(_times(knot, 1 / local_g) for knot in self.shift))


def _between(left: Knot, right: Knot, into: int, apart: int) -> Knot:
    x, y, z = (a + rounded_quotient((b - a) * into, apart) for a, b in zip(left, right, strict=True))
    return x, y, z


def _times(knot: Knot, factor: Fraction) -> Knot:
    x, y, z = (rounded_quotient(value * factor.numerator, factor.denominator) for value in knot)
    return x, y, z
