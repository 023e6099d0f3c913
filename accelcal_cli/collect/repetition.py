"""Stretches that a recording holds twice, exactly: joined or copied wrongly. Each is passed on once.

What is measured anew never repeats: two still windows may agree in all sums and spreads by chance, but
not so many, one after the other, as far apart as the earlier ones. Windows that never change say
nothing: a device that sleeps repeats one value. A copy is seen if its windows begin at the same samples: a
whole number of windows later, or after a break.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.points import Windows, joined_windows

LEAST_WINDOWS = 24
"""Two minutes of rest in windows of 5 s."""

_SEED, _PRIME = np.uint64(0xCBF29CE484222325), np.uint64(0x100000001B3)
"""Of the hash by Fowler, Noll and Vo (FNV-1a, 64 bits), here of whole numbers instead of bytes."""


class Repetitions:
    """Takes still windows in the order of time.

    Attributes:
        windows: how many were left out.
    """

    def __init__(self) -> None:
        self.windows = 0
        self._place: dict[int, int] = {}
        """Where a key was seen last, by the two lists."""
        self._keys: list[int] = []
        self._samples: list[int] = []
        """First samples."""
        self._like, self._run = -1, 0
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
        keys = _keys(windows)[changing].tolist()
        samples = windows.first_sample[changing].tolist()
        new = 0
        for place in self._seen(keys):
            self._remember(keys[new:place], samples[new:place])
            self._take(keys[place], samples[place])
            index, new = int(changing[place]), place + 1
            if self._run <= 1:
                begun = index
            if self._run >= LEAST_WINDOWS:
                kept[begun : index + 1] = False
                begun = index + 1
        self._remember(keys[new:], samples[new:])
        self.windows += int((~kept).sum())
        return kept, begun if self._run else len(windows)

    def _seen(self, keys: list[int]) -> list[int]:
        """Places of keys that were seen before, here or earlier; hardly any."""
        seen, here = [], set[int]()
        for place, key in enumerate(keys):
            if key in self._place or key in here:
                seen.append(place)
            here.add(key)
        return seen

    def _remember(self, keys: list[int], samples: list[int]) -> None:
        """Windows that are like none before: no repetition goes on with them, or begins."""
        if keys:
            self._place.update(zip(keys, range(len(self._keys), len(self._keys) + len(keys)), strict=True))
            self._keys += keys
            self._samples += samples
            self._like, self._run = -1, 0

    def _take(self, key: int, first_sample: int) -> None:
        """See whether a window goes on with the present repetition, or may begin one; remember it."""
        after, last = self._like + 1, len(self._keys) - 1
        goes_on = self._run and self._keys[after] == key
        if goes_on and self._samples[after] - self._samples[after - 1] == first_sample - self._samples[last]:
            self._like, self._run = after, self._run + 1
        else:
            self._like = self._place.get(key, -1)
            self._run = int(self._like >= 0)
        self._place[key] = len(self._keys)
        self._keys.append(key)
        self._samples.append(first_sample)


def _keys(windows: Windows) -> NDArray[np.uint64]:
    """A number for each window, (m,): that of another one differs, but for one in 2**64."""
    columns = [windows.samples, *windows.sums.T, *windows.spread.T]
    if windows.temperature_sums is not None:
        columns.append(windows.temperature_sums)
    key = np.full(len(windows), _SEED)
    for column in columns:
        key = (key ^ column.astype(np.uint64)) * _PRIME
    return key
