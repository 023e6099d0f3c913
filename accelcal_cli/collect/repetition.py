"""Stretches that a recording holds twice, exactly: joined or copied wrongly. Each is passed on once.

What is measured anew never repeats: two still windows may agree in all sums and spreads by chance, but
not so many, one after the other, as far apart as the earlier ones. Windows that never change say
nothing: a device that sleeps repeats one value. A copy is seen if its windows begin at the same samples: a
whole number of windows later, or after a break.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.points import Windows, joined_windows

LEAST_WINDOWS = 24
"""Two minutes of rest in windows of 5 s."""

NEVER = -1
"""Stands for no place."""

_SEED, _PRIME = np.uint64(0xCBF29CE484222325), np.uint64(0x100000001B3)
"""Of the hash by Fowler, Noll and Vo (FNV-1a, 64 bits), here of whole numbers instead of bytes."""


class Repetitions:
    """Takes still windows in the order of time; keeps 32 bytes of each that changes.

    Attributes:
        windows: how many were left out.
    """

    def __init__(self) -> None:
        self.windows = 0
        self._keys, self._samples = array("Q"), array("q")
        """Of each window that changes, and its first sample."""
        self._places = _LastPlaces()
        """Of keys, by the two above."""
        self._like, self._run = NEVER, 0
        """The last window is like that one, and so many up to it follow each other as their likes do."""

    def once(self, batches: Iterable[Windows]) -> Iterator[Windows]:
        """The windows without exact repetitions; what may be one is held back until that is clear."""
        held: Windows | None = None
        for batch in batches:
            if held is not None and (held.temperature_sums is None) != (batch.temperature_sums is None):
                yield held
                held = None
            windows = batch if held is None else joined_windows((held, batch))
            kept, until = self._decided(windows, len(windows) - len(batch))
            yield windows.select(np.flatnonzero(kept[:until]))
            held = windows.select(np.arange(until, len(windows))) if until < len(windows) else None
        if held is not None:
            yield held

    def _decided(self, windows: Windows, known: int) -> tuple[NDArray[np.bool_], int]:
        """Which windows are kept, and up to where this is certain.

        Args:
            known: so many at the beginning were held back: the present run up to now, or what follows it.
        """
        kept, begun = np.ones(len(windows), np.bool_), 0
        changing = np.flatnonzero(windows.spread[known:].max(axis=1, initial=0) > 0) + known
        first, next_one = len(self._keys), 0
        before = self._remembered(_keys(windows)[changing], windows.first_sample[changing])
        for number in np.flatnonzero(before != NEVER).tolist():
            if number > next_one:
                self._run = 0
            next_one, index = number + 1, int(changing[number])
            self._take(first + number, int(before[number]))
            if self._run <= 1:
                begun = index
            if self._run >= LEAST_WINDOWS:
                kept[begun : index + 1] = False
                begun = index + 1
        if next_one < len(changing):
            self._run = 0
        self.windows += int((~kept).sum())
        return kept, begun if self._run else len(windows)

    def _remembered(self, keys: NDArray[np.uint64], samples: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where the key of each further window was seen last, NEVER for nearly all of them."""
        before = self._places.seen(keys, len(self._keys))
        self._keys.frombytes(keys.tobytes())
        self._samples.frombytes(samples.astype(np.int64).tobytes())
        return before

    def _take(self, place: int, before: int) -> None:
        """See whether the window at a place goes on with the present repetition, or may begin one.

        Args:
            before: where the last one like it is.
        """
        after, keys, samples = self._like + 1, self._keys, self._samples
        goes_on = self._run and keys[after] == keys[place]
        if goes_on and samples[after] - samples[after - 1] == samples[place] - samples[place - 1]:
            self._like, self._run = after, self._run + 1
        else:
            self._like, self._run = before, 1


class _LastPlaces:
    """Where keys were seen last: numbers that come in batches, of which each is looked for among the earlier.

    They lie in sorted parts, each more than twice as long as the next, later one, so that there are few.
    """

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[np.uint64], NDArray[np.int64]]] = []
        """Keys in their order, equal ones in that of their places, and these."""

    def seen(self, keys: NDArray[np.uint64], first: int) -> NDArray[np.int64]:
        """The last place of each key before its own, (m,); NEVER where there is none.

        Args:
            keys: (m,) those at the places from `first` on.
        """
        order = np.argsort(keys, kind="stable")
        held, places = keys[order], first + order
        before = np.full(len(keys), NEVER, np.int64)
        for earlier, where in self._parts:
            at = np.searchsorted(earlier, held, side="right") - 1
            found = (at >= 0) & (earlier[at] == held)
            before[order[found]] = where[at[found]]
        again = np.flatnonzero(held[1:] == held[:-1]) + 1
        before[order[again]] = places[again - 1]
        self._add(held, places)
        return before

    def _add(self, keys: NDArray[np.uint64], places: NDArray[np.int64]) -> None:
        """Take in a sorted part that is later than all others."""
        while self._parts and len(self._parts[-1][0]) <= 2 * len(keys):
            earlier, where = self._parts.pop()
            at = np.searchsorted(earlier, keys, side="right")
            keys, places = np.insert(earlier, at, keys), np.insert(where, at, places)
        if len(keys):
            self._parts.append((keys, places))


def _keys(windows: Windows) -> NDArray[np.uint64]:
    """A number for each window, (m,): that of another one differs, but for one in 2**64."""
    columns = [windows.samples, *windows.sums.T, *windows.spread.T]
    if windows.temperature_sums is not None:
        columns.append(windows.temperature_sums)
    key = np.full(len(windows), _SEED)
    for column in columns:
        key = (key ^ column.astype(np.uint64)) * _PRIME
    return key
