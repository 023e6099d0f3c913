"""The rules with fixed limits, and the choice of the rule that the settings name.

A window is still by its max - min, its standard deviation, or both; all comparisons are of integers.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.points import Windows
from accelcal_cli.core.settings import PoseSettings, Settings
from accelcal_cli.segment.adaptive import AdaptiveRule
from accelcal_cli.segment.segmenter import Blocks, Rule, ShortGaps, centred_squares

MOST_SQUARES = 1 << 62
"""Above any sum of squares that int64 holds exactly: a limit beyond it leaves every window still."""


@dataclass(frozen=True, slots=True)
class StillRule:
    """max - min below a threshold on some axes, and standard deviation below another on all.

    The first is F's rule (section II.B.1: one axis, 0.12 g); the second is the field's (van Hees
    2014: 13 mg). All comparisons are of integers.

    Attributes:
        axes: which axes the max - min rule looks at; it may be none.
        spread_limit: counts; a window is moving if max - min on one of these axes reaches it.
        variance_limit: counts squared; exclusive bound of the variance of every axis, or None.
    """

    axes: tuple[int, ...]
    spread_limit: int
    variance_limit: Fraction | None

    def take(self, blocks: Blocks) -> list[Windows]:
        """The still windows, decided at once."""
        still = self.still(blocks.columns, blocks.high - blocks.low, blocks.sums)
        return [blocks.windows(still & blocks.usable)]

    def rest(self) -> list[Windows]:
        """Nothing is held back."""
        return []

    def still(
        self, columns: NDArray[Any], spread: NDArray[np.int64], sums: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Which of m windows are still.

        Args:
            columns: (3, m, length) raw counts.
            spread: (3, m) max - min.
            sums: (3, m) sums of counts.

        Returns:
            (m,) bool.

        Two of n values d apart make a variance of at least d^2 / 2n, so that wide windows are
        moving without a look at their squares.
        """
        still = np.asarray((spread[list(self.axes)] < self.spread_limit).all(axis=0))
        if self.variance_limit is not None:
            widest = isqrt(int(2 * columns.shape[2] * self.variance_limit))
            still &= (spread <= widest).all(axis=0)
            for axis in range(3):
                index = np.flatnonzero(still)
                still[index] = self._quiet(columns[axis][index], spread[axis][index], sums[axis][index])
        return still

    def _quiet(
        self, blocks: NDArray[Any], spread: NDArray[np.int64], sums: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Variance below the limit, for (m, n) counts of one axis."""
        assert self.variance_limit is not None
        if not len(blocks):
            return np.empty(0, np.bool_)
        length = blocks.shape[1]
        centred, r = centred_squares(blocks, spread, sums)
        limit = self.variance_limit * length**2
        whole, rest = divmod(-(-limit.numerator // limit.denominator), length)
        whole = min(whole, MOST_SQUARES)
        return np.asarray(centred < whole + (rest + r * r + length - 1) // length)


def still_rule(
    axes: tuple[int, ...], threshold_g: float | None, deviation_g: float | None, lsb_per_g: float
) -> StillRule:
    """A rule in g as a rule in counts; None: not looked at.

    max - min < threshold in g is max - min < ceil(threshold * lsb_per_g) in whole counts.
    """
    limit = Fraction(str(threshold_g or 0)) * Fraction(lsb_per_g)
    variance = None if deviation_g is None else (Fraction(str(deviation_g)) * Fraction(lsb_per_g)) ** 2
    looked_at = () if threshold_g is None else axes
    return StillRule(looked_at, -(-limit.numerator // limit.denominator), variance)


def chosen_rule(settings: Settings, lsb_per_g: float, length: int) -> Rule:
    """A rule for windows of so many samples of counts."""
    if settings.adaptive is not None:
        return AdaptiveRule(length, lsb_per_g, settings.adaptive)
    return still_rule(
        settings.stillness_axes, settings.stillness_threshold_g, settings.stillness_deviation_g, lsb_per_g
    )


def window_length(settings: Settings, rate_hz: float) -> int:
    """Samples in a window."""
    fewest = 1 if settings.adaptive is None else settings.adaptive.min_samples
    return max(fewest, round(settings.segment_seconds * rate_hz))


def short_gaps(settings: Settings | PoseSettings, length: int, rate_hz: float) -> ShortGaps:
    """What windows of so many samples go on over: together their own length at most."""
    longest_us = round(settings.longest_gap_s * MICROSECONDS)
    return ShortGaps(longest_us, round(length * MICROSECONDS / rate_hz))
