"""What rest measures in a recording, before anything is made of it: sums and histograms of whole numbers.

Still windows of any length count, so that what a wrong unit, scale or field makes of gravity can be seen. The
result does not depend on how the windows and samples come.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import Histogram, norms_g
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, Validity
from accelcal_cli.core.results import Rest

PLAUSIBLE_ERROR_G = 0.5
"""Windows that are farther than this from 1 g, such as zeros, are not rest under gravity."""

SAMPLE_STEP = 997
"""So many samples lie between those that are looked at; a prime, so that no rhythm of a device hides."""

PAIRS = (("x", "y"), ("x", "z"), ("y", "z"))
FARTHEST_MG = 1 << 40


class RestSums:
    """Collects what rest measures.

    Args:
        rest_lsb: raw counts that rest should measure.
    """

    def __init__(self, rest_lsb: float) -> None:
        self._rest_lsb = rest_lsb
        self._lengths_mg, self._samples_mg = Histogram(), Histogram()
        self._windows = self._plausible = self._error_ng = 0
        self._differ = [False] * len(PAIRS)
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)

    def add_samples(self, chunk: Chunk) -> None:
        """Take a chunk's samples in."""
        rows = slice(-chunk.first_sample % SAMPLE_STEP, None, SAMPLE_STEP)
        counts = chunk.counts[rows].astype(np.float64)
        if chunk.validity is not None:
            counts = counts[chunk.validity[rows] != Validity.FILLED]
        if len(counts):
            squares = counts * counts
            self._samples_mg.add(_mg(np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2]) / self._rest_lsb))

    def add_windows(self, windows: Windows) -> None:
        """Take still windows in."""
        lengths = norms_g(windows, self._rest_lsb)
        self._windows += len(windows)
        self._lengths_mg.add(_mg(lengths))
        error_g = np.abs(lengths - 1)
        plausible = np.rint(error_g[error_g < PLAUSIBLE_ERROR_G] * 1e9).astype(np.int64)
        self._error_ng += int(plausible.sum())
        self._plausible += len(plausible)
        means = windows.sums / (windows.samples[:, np.newaxis] * self._rest_lsb)
        self._low = np.minimum(self._low, means.min(axis=0, initial=np.inf))
        self._high = np.maximum(self._high, means.max(axis=0, initial=-np.inf))
        for index, (one, other) in enumerate(PAIRS):
            columns = windows.sums[:, "xyz".index(one)], windows.sums[:, "xyz".index(other)]
            self._differ[index] |= bool((columns[0] != columns[1]).any())

    def result(self) -> Rest:
        """What was found."""
        samples_g = _g(self._samples_mg, 50)
        if not self._windows:
            return Rest(samples_median_g=samples_g)
        same = {axis for pair, differ in zip(PAIRS, self._differ, strict=True) if not differ for axis in pair}
        return Rest(
            windows=self._windows,
            median_g=_g(self._lengths_mg, 50) or 0.0,
            p5_g=_g(self._lengths_mg, 5) or 0.0,
            p95_g=_g(self._lengths_mg, 95) or 0.0,
            axis_min_g=tuple(self._low.tolist()),
            axis_max_g=tuple(self._high.tolist()),
            alike=tuple(sorted(same)),
            error_mg=self._error_ng / self._plausible / 1e6 if self._plausible else None,
            samples_median_g=samples_g,
        )


def _mg(lengths_g: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.minimum(np.rint(lengths_g * 1000), FARTHEST_MG).astype(np.int64)


def _g(histogram: Histogram, percent: int) -> float | None:
    value = histogram.quantile(percent)
    return None if value is None else value / 1000
