"""Rules of stillness with fixed limits, and the choice of the rule that the settings name.

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
from accelcal_cli.core.errors import UsageError
from accelcal_cli.core.points import Windows
from accelcal_cli.core.settings import PoseSettings, Settings
from accelcal_cli.segment.adaptive import AdaptiveRule
from accelcal_cli.segment.segmenter import Blocks, Rule, ShortGaps, centred_squares

FEWEST_SAMPLES, SHORT_S = 2, 1.0
"""Samples in a window at least: a single one never moves. Only a user asks for shorter windows [s]."""
MOST_SQUARES = 1 << 62
"""Larger than any sum of squares that int64 holds exactly: with a larger limit, every window is still."""


@dataclass(frozen=True, slots=True)
class StillRule:
    """A rule by max - min on some axes and the standard deviation on all.

    The first is F's rule (section II.B.1: one axis, 0.12 g); the second is the field's (van Hees
    2014: 13 mg).

    Attributes:
        axes: axes of the max - min rule; there may be none.
        spread_limit: max - min [counts] at which a window is moving.
        variance_limit: variance [counts squared] at which a window is moving, or None.
    """

    axes: tuple[int, ...]
    spread_limit: int
    variance_limit: Fraction | None

    def take(self, blocks: Blocks) -> list[Windows]:
        """Return the still windows, decided at once."""
        still = self.still(blocks.columns, blocks.high - blocks.low, blocks.sums)
        return [blocks.windows(still & blocks.usable)]

    def rest(self) -> list[Windows]:
        """Return nothing, since no window is held back."""
        return []

    def still(
        self, columns: NDArray[Any], spread: NDArray[np.int64], sums: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Return a mask (m,) of the windows that are still.

        Args:
            columns: (3, m, length) raw counts.
            spread: (3, m) max - min.
            sums: (3, m) sums of counts.
        """
        still = np.asarray((spread[list(self.axes)] < self.spread_limit).all(axis=0))
        if self.variance_limit is not None:
            # two of n values d apart make a variance of at least d^2 / 2n: wide windows need no squares
            widest = isqrt(int(2 * columns.shape[2] * self.variance_limit))
            still &= (spread <= widest).all(axis=0)
            for axis in range(3):
                index = np.flatnonzero(still)
                still[index] = self._quiet(columns[axis][index], spread[axis][index], sums[axis][index])
        return still

    def _quiet(
        self, blocks: NDArray[Any], spread: NDArray[np.int64], sums: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Return a mask (m,) of windows whose variance is below the limit, of counts (m, n) of one axis."""
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
    """Convert a rule in g to a rule in counts; None: no limit.

    max - min < threshold in g is max - min < ceil(threshold * lsb_per_g) in whole counts.
    """
    limit = Fraction(str(threshold_g or 0)) * Fraction(lsb_per_g)
    variance = None if deviation_g is None else (Fraction(str(deviation_g)) * Fraction(lsb_per_g)) ** 2
    return StillRule(() if threshold_g is None else axes, -(-limit.numerator // limit.denominator), variance)


def chosen_rule(settings: Settings, lsb_per_g: float, length: int) -> Rule:
    """Return the rule that the settings name, for windows of `length` samples."""
    if settings.adaptive is not None:
        return AdaptiveRule(length, lsb_per_g, settings.adaptive)
    return still_rule(
        settings.stillness_axes, settings.stillness_threshold_g, settings.stillness_deviation_g, lsb_per_g
    )


def window_length(settings: Settings, rate_hz: float) -> int:
    """Return the number of samples in a window; raises UsageError for a short one of a single sample."""
    fewest = 1 if settings.adaptive is None else settings.adaptive.min_samples
    length = max(fewest, round(settings.segment_seconds * rate_hz))
    if length < FEWEST_SAMPLES and settings.segment_seconds < SHORT_S:
        text = f"--segment-seconds {settings.segment_seconds:g} is less than two samples at {rate_hz:g} Hz"
        raise UsageError(text, hint=f"use --segment-seconds {FEWEST_SAMPLES / rate_hz:.2g} or more")
    return length


def short_gaps(settings: Settings | PoseSettings, length: int, rate_hz: float) -> ShortGaps:
    """Return the gaps that windows of `length` samples may span: together at most their own length."""
    longest_us = round(settings.longest_gap_s * MICROSECONDS)
    return ShortGaps(longest_us, round(length * MICROSECONDS / rate_hz))
