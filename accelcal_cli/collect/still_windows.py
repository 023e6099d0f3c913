"""Still windows before they are collected: stretches that are held twice, and what rest measures.

A recording that was joined or copied wrongly holds a stretch twice, exactly; each is passed on once. What is
measured again never repeats: two still windows may agree in all sums and spreads by chance, but not many, one
after the other, at the same distances as the earlier ones. Windows that never change tell nothing: a device
that sleeps repeats one value. A copy is found if its windows begin at the same samples: a whole number of
windows later, or after a break.

What rest measures is summed over still windows of any length, so that the effect of a wrong unit, scale or
field can be seen. It consists of sums and histograms of whole numbers, which do not depend on how windows and
samples are portioned.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.collect.cells import Histogram, norms_g
from accelcal_cli.core.points import Windows, joined_windows
from accelcal_cli.core.recording import Chunk, Validity
from accelcal_cli.core.results import Rest

PLAUSIBLE_ERROR_G = 0.5
"""Distance from 1 g [g] beyond which a window, such as one of zeros, is not rest under gravity."""

SAMPLE_STEP = 997
"""Distance of the samples that are looked at; a prime, so that no rhythm of a device hides."""

PAIRS = (("x", "y"), ("x", "z"), ("y", "z"))
FARTHEST_MG = 1 << 40

LEAST_WINDOWS = 24
"""Windows in a row that make a repetition: two minutes of rest in windows of 5 s."""

NEVER = -1
"""Place of a key that was not seen before."""

_SEED, _PRIME = np.uint64(0xCBF29CE484222325), np.uint64(0x100000001B3)
"""Constants of the hash by Fowler, Noll and Vo (FNV-1a, 64 bits), here of whole numbers instead of bytes."""


class Repetitions:
    """Leaves out stretches of still windows that were there before; keeps 32 bytes of each window.

    Attributes:
        windows: number of windows that were left out.
    """

    def __init__(self) -> None:
        self.windows = 0
        # of each window that changes: its key and its first sample, and where a key was last
        self._keys, self._samples = array("Q"), array("q")
        self._places = _LastPlaces()
        # the place of the window that the last one repeats, and how many in a row have done so
        self._like, self._run = NEVER, 0

    def once(self, batches: Iterable[Windows]) -> Iterator[Windows]:
        """Yield windows, in the order of time, without repetitions; undecided ones are held back."""
        waiting: Windows | None = None
        for batch in batches:
            if waiting is not None and (waiting.temperature_sums is None) != (batch.temperature_sums is None):
                yield waiting
                waiting = None
            windows = batch if waiting is None else joined_windows((waiting, batch))
            kept, until = self._decided(windows, len(windows) - len(batch))
            yield windows.select(np.flatnonzero(kept[:until]))
            waiting = windows.select(np.arange(until, len(windows))) if until < len(windows) else None
        if waiting is not None:
            yield waiting

    def _decided(self, windows: Windows, known: int) -> tuple[NDArray[np.bool_], int]:
        """Return a mask of the windows to keep, and up to where it is decided.

        Args:
            known: number of windows at the beginning that were held back before.
        """
        kept, begun = np.ones(len(windows), np.bool_), 0
        changing = np.flatnonzero(windows.spread[known:].max(axis=1, initial=0) > 0) + known
        first, next_one = len(self._keys), 0
        keys = _keys(windows)[changing]
        before = self._places.seen(keys, first)
        self._keys.frombytes(keys.tobytes())
        self._samples.frombytes(windows.first_sample[changing].astype(np.int64).tobytes())
        for number in np.flatnonzero(before != NEVER).tolist():
            if number > next_one:
                self._run = 0
            next_one, index = number + 1, int(changing[number])
            # continue the present repetition, or begin one with the last window that is like this one
            place, after, samples = first + number, self._like + 1, self._samples
            goes_on = self._run and self._keys[after] == self._keys[place]
            if goes_on and samples[after] - samples[after - 1] == samples[place] - samples[place - 1]:
                self._like, self._run = after, self._run + 1
            else:
                self._like, self._run = int(before[number]), 1
            if self._run <= 1:
                begun = index
            if self._run >= LEAST_WINDOWS:
                kept[begun : index + 1] = False
                begun = index + 1
        if next_one < len(changing):
            self._run = 0
        self.windows += int((~kept).sum())
        return kept, begun if self._run else len(windows)


class _LastPlaces:
    """Finds where keys that come in batches were seen last.

    They are kept in sorted parts, each more than twice as long as the next, later one, so that there are few.
    """

    def __init__(self) -> None:
        # sorted keys, and their places
        self._parts: list[tuple[NDArray[np.uint64], NDArray[np.int64]]] = []

    def seen(self, keys: NDArray[np.uint64], first: int) -> NDArray[np.int64]:
        """Return the last place of each key before its own, (m,), or NEVER.

        Args:
            keys: (m,) those at the places from `first` on.
        """
        order = np.argsort(keys, kind="stable")
        ordered, places = keys[order], first + order
        before = np.full(len(keys), NEVER, np.int64)
        for earlier, where in self._parts:
            at = np.searchsorted(earlier, ordered, side="right") - 1
            found = (at >= 0) & (earlier[at] == ordered)
            before[order[found]] = where[at[found]]
        again = np.flatnonzero(ordered[1:] == ordered[:-1]) + 1
        before[order[again]] = places[again - 1]
        # the new part is later than all others
        while self._parts and len(self._parts[-1][0]) <= 2 * len(ordered):
            earlier, where = self._parts.pop()
            at = np.searchsorted(earlier, ordered, side="right")
            ordered, places = np.insert(earlier, at, ordered), np.insert(where, at, places)
        if len(ordered):
            self._parts.append((ordered, places))
        return before


def _keys(windows: Windows) -> NDArray[np.uint64]:
    """Return a hash of 64 bits for each window, (m,)."""
    columns = [windows.samples, *windows.sums.T, *windows.spread.T]
    if windows.temperature_sums is not None:
        columns.append(windows.temperature_sums)
    key = np.full(len(windows), _SEED)
    for column in columns:
        key = (key ^ column.astype(np.uint64)) * _PRIME
    return key


class RestSums:
    """Sums what rest measures.

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
        """Add the samples of a chunk."""
        rows = slice(-chunk.first_sample % SAMPLE_STEP, None, SAMPLE_STEP)
        counts = chunk.counts[rows].astype(np.float64)
        if chunk.validity is not None:
            counts = counts[chunk.validity[rows] != Validity.FILLED]
        if len(counts):
            squares = counts * counts
            self._samples_mg.add(_mg(np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2]) / self._rest_lsb))

    def add_windows(self, windows: Windows) -> None:
        """Add still windows."""
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
        """Return what rest measures."""
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
