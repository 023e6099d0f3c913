"""Measures of activity by epoch, of calibrated samples as they pass.

Lengths are whole numbers of 2**-32 g, and sums of them are exact: the length of the chunks makes no
difference. An epoch is the consecutive rows whose times lie in the same multiple of its length; one of which
less than four fifths was measured has no value.

ENMO: mean of max(|a| - 1 g, 0) (van Hees et al. 2013, PLoS ONE 8(4): e61691).
MAD: mean of ||a| - its mean in the epoch| (Vaha-Ypya et al. 2015, Clin Physiol Funct Imaging 35: 64).
MVPA: epochs with an ENMO of 100 mg or more (Hildebrand et al. 2014, Med Sci Sports Exerc 46: 1816: 100.6 mg).
PIM: integral of ||a| - 1 g|, and ZCM: how often that crosses a threshold (Maczak et al. 2021, PLoS ONE
16(12): e0261718, of their UFNM; Farago, Maczak, Gingl 2024 name both as sensitive to calibration).
Inactivity: the arm's angle changes by no more than 5 degrees from one 5 s to the next, for 5 min or longer
(van Hees et al. 2015, PLoS ONE 10(11): e0142533; here of means of 5 s, there of rolling medians).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import atan2, degrees, hypot

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS

ONE_G = 1 << 32
LEAST_MEASURED = 0.8
"""Share of an epoch without which it has no value."""

MVPA_MG = 100.0
CROSSING_MG = 100.0
"""The threshold of ZCM; there it is chosen by the recording, here it is the same for all versions."""

ANGLE_S, STILL_DEGREES, INACTIVE_S = 5, 5.0, 300
LONGEST_EPOCH_S = 3600
MOST_ROWS = 2
"""Rows of one time, of a clock that stands, are cut after so many times an epoch's usual rows."""

Integers = NDArray[np.int64]
MG = 1000 / ONE_G


@dataclass(frozen=True, slots=True)
class Stretch:
    """Whole epochs of rows that were measured.

    Attributes:
        number: (m,) number of each epoch since 1970.
        start: (m,) its first row; rows: (m,) how many it has.
        columns: (n,) values of all rows, for each column that was fed.
    """

    number: Integers
    start: Integers
    rows: Integers
    columns: tuple[Integers, ...]


class Cutter:
    """Cuts a stream of rows into whole epochs; what is kept in between is less than one."""

    def __init__(self, epoch_us: int, most_rows: int) -> None:
        self._epoch_us, self._most = epoch_us, most_rows
        self._left: tuple[Integers, ...] = ()

    def feed(self, time_us: Integers, *columns: Integers) -> Iterator[Stretch]:
        """Take rows in; the epochs that they complete, if any."""
        rows = (time_us // self._epoch_us, *columns)
        if self._left:
            rows = tuple(np.concatenate(pair) for pair in zip(self._left, rows, strict=True))
        if not len(rows[0]):
            return
        start = self._starts(rows[0])
        self._left = tuple(column[start[-1] :].copy() for column in rows)
        if len(start) > 1:
            yield self._stretch(start[:-1], tuple(column[: start[-1]] for column in rows))

    def finish(self) -> Iterator[Stretch]:
        """The epoch that the stream ends in."""
        if self._left:
            yield self._stretch(self._starts(self._left[0]), self._left)

    def _starts(self, number: Integers) -> Integers:
        """Where epochs begin: where their number changes, and where one has too many rows."""
        start = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
        length = np.diff(start, append=len(number))
        if length.max() <= self._most:
            return start
        parts = [
            np.arange(first, first + size, self._most) for first, size in zip(start, length, strict=True)
        ]
        return np.concatenate(parts)

    def _stretch(self, start: Integers, rows: tuple[Integers, ...]) -> Stretch:
        number, *columns = rows
        return Stretch(number[start], start, np.diff(start, append=len(number)), tuple(columns))


@dataclass(frozen=True, slots=True)
class Epochs:
    """m epochs of one version of a recording, all but the last in units of 2**-32 g.

    Attributes:
        enmo, mad, pim: (m,) means; PIM is this one times the length of the epoch.
        zcm: (m,) number of crossings.
    """

    enmo: Integers
    mad: Integers
    pim: Integers
    zcm: Integers


def measures(length: Integers, stretch: Stretch) -> Epochs:
    """The measures of whole epochs.

    Args:
        length: (n,) |a| of all rows [2**-32 g].
    """
    start, rows = stretch.start, stretch.rows
    mean = _mean(np.add.reduceat(length, start), rows)
    off = np.abs(length - ONE_G)
    above = off > round(CROSSING_MG / MG)
    crossed = np.diff(above, prepend=above[0]).astype(np.int64)
    crossed[start] = 0
    return Epochs(
        enmo=_mean(np.add.reduceat(np.maximum(length - ONE_G, 0), start), rows),
        mad=_mean(np.add.reduceat(np.abs(length - np.repeat(mean, rows)), start), rows),
        pim=_mean(np.add.reduceat(off, start), rows),
        zcm=np.add.reduceat(crossed, start),
    )


def _mean(total: Integers, rows: Integers) -> Integers:
    """Rounded to the nearest unit, halves up."""
    return (2 * total + rows) // (2 * rows)


@dataclass(frozen=True, slots=True)
class Activity:
    """What a version of a recording says of activity.

    Attributes:
        enmo_mg, mad_mg: means over the epochs with a value; None if there is none.
        mvpa_min: minutes of moderate to vigorous physical activity.
        pim_mg_s, zcm: for a minute that was measured.
        inactive_min: minutes of sustained inactivity.
        enmo_differs_mg: mean over the epochs of |the difference of ENMO from the last version's|.
    """

    enmo_mg: float | None
    mad_mg: float | None
    mvpa_min: float
    pim_mg_s: float | None
    zcm: float | None
    inactive_min: float
    enmo_differs_mg: float | None


@dataclass(slots=True)
class _Sums:
    """Of one version, all exact."""

    enmo: int = 0
    mad: int = 0
    pim: int = 0
    zcm: int = 0
    active: int = 0
    differs: int = 0
    angle: float | None = None
    last: int = 0
    run: int = 0
    inactive: int = 0

    def add(self, epochs: Epochs, against: Epochs) -> None:
        self.enmo += int(epochs.enmo.sum())
        self.mad += int(epochs.mad.sum())
        self.pim += int(epochs.pim.sum())
        self.zcm += int(epochs.zcm.sum())
        self.active += int((epochs.enmo >= round(MVPA_MG / MG)).sum())
        self.differs += int(np.abs(epochs.enmo - against.enmo).sum())

    def turn(self, number: int, angle: float) -> None:
        """The arm's angle [degrees] in the 5 s of a number."""
        follows = self.angle is not None and number == self.last + 1
        if not follows or abs(angle - (self.angle or 0.0)) > STILL_DEGREES:
            self.rest()
        self.angle, self.last, self.run = angle, number, self.run + 1

    def rest(self) -> None:
        """The arm turned, or there is a gap: what was before counts if it is long."""
        if self.run * ANGLE_S >= INACTIVE_S:
            self.inactive += self.run
        self.run = 0


@dataclass(slots=True)
class Table:
    """The epochs with a value that one feeding completed.

    Attributes:
        start_us: (m,) when each begins; rows: (m,) rows of it that were measured.
        epochs: of each version.
    """

    start_us: Integers
    rows: Integers
    epochs: tuple[Epochs, ...]


@dataclass
class Measuring:
    """Measures several versions of one recording side by side.

    Args:
        versions: how many; differences are from the last one.
        epoch_s: length of an epoch, whole seconds.

    Attributes:
        epochs: how many had a value; short: how many had too few rows.
        rows: of the epochs that had a value.
    """

    versions: int
    epoch_s: int
    rate_hz: float
    epochs: int = 0
    short: int = 0
    rows: int = 0
    _sums: list[_Sums] = field(init=False)

    def __post_init__(self) -> None:
        self._sums = [_Sums() for _ in range(self.versions)]
        self._cut, self._cut_angles = (
            Cutter(seconds * MICROSECONDS, max(2, MOST_ROWS * round(seconds * self.rate_hz)))
            for seconds in (self.epoch_s, ANGLE_S)
        )

    def feed(self, time_us: Integers, versions: Sequence[Sequence[NDArray[np.float32]]]) -> list[Table]:
        """Take in measured rows, x, y and z of each version [g]; what they complete."""
        axes = [[fixed(axis) for axis in xyz] for xyz in versions]
        for stretch in self._cut_angles.feed(time_us, *(axis for xyz in axes for axis in xyz)):
            self._turn(stretch)
        norms = [lengths(xyz) for xyz in versions]
        return [self._measure(stretch) for stretch in self._cut.feed(time_us, *norms)]

    def finish(self) -> list[Table]:
        """The end of the recording: what its last rows complete."""
        for stretch in self._cut_angles.finish():
            self._turn(stretch)
        tables = [self._measure(stretch) for stretch in self._cut.finish()]
        for sums in self._sums:
            sums.rest()
        return tables

    def result(self) -> tuple[Activity, ...]:
        """Each version, after `finish`."""
        return tuple(self._activity(sums) for sums in self._sums)

    def _measure(self, stretch: Stretch) -> Table:
        whole = stretch.rows >= LEAST_MEASURED * self.epoch_s * self.rate_hz
        epochs = [_kept(measures(length, stretch), whole) for length in stretch.columns]
        for sums, own in zip(self._sums, epochs, strict=True):
            sums.add(own, epochs[-1])
        number, rows = stretch.number[whole], stretch.rows[whole]
        self.epochs, self.short = self.epochs + len(number), self.short + int((~whole).sum())
        self.rows += int(rows.sum())
        return Table(number * (self.epoch_s * MICROSECONDS), rows, tuple(epochs))

    def _turn(self, stretch: Stretch) -> None:
        whole = np.flatnonzero(stretch.rows >= LEAST_MEASURED * ANGLE_S * self.rate_hz)
        number = stretch.number[whole].tolist()
        sums = [np.add.reduceat(axis, stretch.start)[whole].tolist() for axis in stretch.columns]
        for version, found in enumerate(self._sums):
            for one, x, y, z in zip(number, *sums[3 * version : 3 * version + 3], strict=True):
                found.turn(one, degrees(atan2(z, hypot(x, y))))

    def _activity(self, sums: _Sums) -> Activity:
        def mean_mg(total: int) -> float | None:
            return total * MG / self.epochs if self.epochs else None

        pim = mean_mg(sums.pim)
        return Activity(
            mean_mg(sums.enmo),
            mean_mg(sums.mad),
            sums.active * self.epoch_s / 60,
            None if pim is None else pim * 60,
            60 * sums.zcm * self.rate_hz / self.rows if self.rows else None,
            sums.inactive * ANGLE_S / 60,
            mean_mg(sums.differs),
        )


def _kept(epochs: Epochs, which: NDArray[np.bool_]) -> Epochs:
    return Epochs(epochs.enmo[which], epochs.mad[which], epochs.pim[which], epochs.zcm[which])


def fixed(axis: NDArray[np.float32]) -> Integers:
    """An axis in units of 2**-32 g; exact, since the product is by a power of two."""
    return np.rint(axis.astype(np.float64) * ONE_G).astype(np.int64)


def lengths(xyz: Sequence[NDArray[np.float32]]) -> Integers:
    """|a| of rows in units of 2**-32 g."""
    x, y, z = (axis.astype(np.float64) for axis in xyz)
    return np.asarray(np.rint(np.sqrt(x * x + y * y + z * z) * ONE_G), np.int64)
