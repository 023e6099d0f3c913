"""Epochs of a recording, exactly: a stream of rows is cut into them, and lengths are whole numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

ONE_G = 1 << 32
MG = 1000 / ONE_G

MVPA_MG = 100.0
CROSSING_MG = 100.0
"""Threshold [mg] of ZCM; there it is chosen by the recording, here it is the same for all versions."""


@dataclass(frozen=True, slots=True)
class WholeEpochs:
    """Rows of m whole epochs.

    Attributes:
        number: (m,) number of each epoch since 1970.
        start: (m,) its first row; rows: (m,) how many it has.
        columns: (n,) values of all rows, for each column that was fed.
    """

    number: Integers
    start: Integers
    rows: Integers
    columns: tuple[NDArray[Any], ...]


class EpochCutter:
    """Cuts a stream of rows into whole epochs; between calls it keeps less than one."""

    def __init__(self, epoch_us: int, most_rows: int) -> None:
        self._epoch_us, self._most = epoch_us, most_rows
        self._left: tuple[NDArray[Any], ...] = ()

    def feed(self, time_us: Integers, *columns: NDArray[Any]) -> Iterator[WholeEpochs]:
        """Take rows in, and yield the epochs that they complete, if any."""
        rows = (time_us // self._epoch_us, *columns)
        if self._left:
            rows = tuple(np.concatenate(pair) for pair in zip(self._left, rows, strict=True))
        if not len(rows[0]):
            return
        start = self._starts(rows[0])
        self._left = tuple(column[start[-1] :].copy() for column in rows)
        if len(start) > 1:
            yield self._whole(start[:-1], tuple(column[: start[-1]] for column in rows))

    def finish(self) -> Iterator[WholeEpochs]:
        """Yield the epoch that the stream ends in."""
        if self._left:
            yield self._whole(self._starts(self._left[0]), self._left)

    def _starts(self, number: Integers) -> Integers:
        """Return the rows at which the epoch's number changes, or an epoch has too many rows."""
        start = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
        length = np.diff(start, append=len(number))
        if length.max() <= self._most:
            return start
        parts = [
            np.arange(first, first + size, self._most) for first, size in zip(start, length, strict=True)
        ]
        return np.concatenate(parts)

    def _whole(self, start: Integers, rows: tuple[NDArray[Any], ...]) -> WholeEpochs:
        number, *columns = rows
        return WholeEpochs(number[start], start, np.diff(start, append=len(number)), tuple(columns))


@dataclass(frozen=True, slots=True)
class EpochMeasures:
    """Measures of m epochs of one version of a recording, all but the last in units of 2**-32 g.

    Attributes:
        enmo, mad, pim: (m,) means; PIM is this one times the length of the epoch.
        zcm: (m,) number of crossings.
    """

    enmo: Integers
    mad: Integers
    pim: Integers
    zcm: Integers

    @classmethod
    def of(cls, length: Integers, epochs: WholeEpochs) -> EpochMeasures:
        """Measure whole epochs; `length` (n,) is |a| of all rows [2**-32 g]."""
        start, rows = epochs.start, epochs.rows
        mean = _rounded_mean(np.add.reduceat(length, start), rows)
        off = np.abs(length - ONE_G)
        above = off > round(CROSSING_MG / MG)
        crossed = np.diff(above, prepend=above[0]).astype(np.int64)
        crossed[start] = 0
        return cls(
            enmo=_rounded_mean(np.add.reduceat(np.maximum(length - ONE_G, 0), start), rows),
            mad=_rounded_mean(np.add.reduceat(np.abs(length - np.repeat(mean, rows)), start), rows),
            pim=_rounded_mean(np.add.reduceat(off, start), rows),
            zcm=np.add.reduceat(crossed, start),
        )

    def select(self, which: NDArray[np.bool_]) -> EpochMeasures:
        """Return the measures of some of the epochs."""
        columns = (self.enmo, self.mad, self.pim, self.zcm)
        return EpochMeasures(*(column[..., which] for column in columns))


def _rounded_mean(total: Integers, rows: Integers) -> Integers:
    """Return means rounded to the nearest unit, halves up."""
    return (2 * total + rows) // (2 * rows)


def fixed(axis: NDArray[np.float32]) -> Integers:
    """Return an axis in units of 2**-32 g; exact, since the product is by a power of two."""
    return np.rint(axis.astype(np.float64) * ONE_G).astype(np.int64)


def lengths(xyz: Sequence[NDArray[np.float32]]) -> Integers:
    """Return |a| of rows in units of 2**-32 g."""
    x, y, z = (axis.astype(np.float64) for axis in xyz)
    return np.asarray(np.rint(np.sqrt(x * x + y * y + z * z) * ONE_G), np.int64)
