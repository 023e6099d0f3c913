"""Measures of activity of the same epochs with each of many plausible calibrations, for their intervals.

Each row is measured once with every calibration drawn from the posterior, so that ENMO, which cuts off at
1 g, is as far from linear as it is. A drawn calibration is applied to the calibrated values: a' = M a + c +
p T. Values are of single precision, about 0.0002 mg; means by epoch are whole numbers of 2**-32 g, and their
sums exact.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import quotient
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.pipeline.epochs import CROSSING_MG, MG, MVPA_MG, ONE_G, EpochMeasures, Integers, WholeEpochs

DRAWS = 39
"""Number of plausible calibrations: in 38 of 40 cases one more lies between their lowest and highest."""

BLOCK_ROWS = 1 << 15
"""Rows that are measured at a time, so that intermediate values stay in the processor's cache."""

MICRODEGREES = 1e6

FIGURES = ("enmo_mg", "mad_mg", "mvpa_min", "pim_mg_s", "zcm", "angle_deg")
"""Figures that are given an interval."""

Singles = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Affine:
    """One drawn calibration, for values that another one calibrated: M a + c + p T.

    Attributes:
        mix: M, (3, 3) lower triangular; shift: c, (3,) [g]; per_c: p, (3,) [g per degree C].
    """

    mix: NDArray[np.float64]
    shift: NDArray[np.float64]
    per_c: NDArray[np.float64]

    @classmethod
    def between(cls, used: Calibration, drawn: Calibration) -> Affine:
        """Return what makes of values that one calibration gave those of another."""
        gain, slope = drawn.gain(), drawn.slope_g_per_c() - used.slope_g_per_c()
        mix = np.array(quotient(gain.tolist(), used.gain().tolist()))
        shift = drawn.offset_at(0.0) - used.offset_at(0.0)
        return cls(mix, (gain * shift).sum(axis=1), (gain * slope).sum(axis=1))

    def lengths(self, rows: Sequence[Singles], buffers: Singles) -> Singles:
        """Return |a'| - 1 g of x, y, z and T, each (n,), in the first buffer of four (4, n)."""
        total: Singles = buffers[0]
        value, product = buffers[1:3]
        total[:] = 0
        for row in range(3):
            np.multiply(rows[0], np.float32(self.mix[row, 0]), out=value)
            for column in range(1, row + 1):
                value += np.multiply(rows[column], np.float32(self.mix[row, column]), out=product)
            if self.per_c[row]:
                value += np.multiply(rows[3], np.float32(self.per_c[row]), out=product)
            value += np.float32(self.shift[row])
            total += np.multiply(value, value, out=product)
        np.sqrt(total, out=total)
        total -= np.float32(1)
        return total

    def vectors(self, xyz: NDArray[np.float64], celsius: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return x, y and z, each (m,), of mean values (m, 3) [g] and temperatures (m,).

        Elementwise, since a product of matrices gives other bits of one row than of many.
        """
        x, y, z = xyz.T
        products = (x * one + y * two + z * three for one, two, three in self.mix)
        heat = zip(products, self.shift, self.per_c, strict=True)
        return [product + shift + celsius * per_c for product, shift, per_c in heat]


@dataclass
class DrawnActivity:
    """Measures whole epochs with each of K drawn calibrations.

    Args:
        draws: K of them; empty where no posterior is known.
    """

    draws: Sequence[Affine]
    enmo: Integers = field(init=False)
    mad: Integers = field(init=False)
    pim: Integers = field(init=False)
    zcm: Integers = field(init=False)
    active: Integers = field(init=False)
    angle: Integers = field(init=False)

    def __post_init__(self) -> None:
        for name in ("enmo", "mad", "pim", "zcm", "active", "angle"):
            setattr(self, name, np.zeros(len(self.draws), np.int64))

    @classmethod
    def of(cls, used: Calibration | None, draws: Sequence[Calibration]) -> DrawnActivity:
        """Return it for values that a calibration gave."""
        return cls([] if used is None else [Affine.between(used, one) for one in draws])

    def add(self, epochs: WholeEpochs, columns: Sequence[Singles], valued: NDArray[np.bool_]) -> None:
        """Take in the measures of epochs with a value.

        Args:
            columns: x, y, z [g] and temperature [degrees C], each (n,).
        """
        names = ("enmo", "mad", "pim", "zcm")
        if not self.draws:
            return
        parts = [self._measured(epochs, columns, part) for part in _blocks(epochs.rows)]
        whole = (np.hstack([getattr(one, name) for one in parts]) for name in names)
        found = EpochMeasures(*whole).select(valued)
        for name in names:
            getattr(self, name)[:] += getattr(found, name).sum(axis=1)
        self.active += (found.enmo >= round(MVPA_MG / MG)).sum(axis=1)

    def totals(self) -> dict[str, Integers]:
        """Return the sums (K,) of each of FIGURES."""
        sums = (self.enmo, self.mad, self.active, self.pim, self.zcm, self.angle)
        return dict(zip(FIGURES, sums, strict=True))

    def turn(self, xyz: NDArray[np.float64], celsius: NDArray[np.float64]) -> None:
        """Take in mean values of 5 s, (m, 3) [g] and (m,), for the arm's angle."""
        for place, draw in enumerate(self.draws):
            x, y, z = draw.vectors(xyz, celsius)
            self.angle[place] += int(np.rint(MICRODEGREES * np.degrees(np.arctan2(z, np.hypot(x, y)))).sum())

    def _measured(self, epochs: WholeEpochs, columns: Sequence[Singles], part: slice) -> EpochMeasures:
        first = int(epochs.start[part][0])
        rows, start = epochs.rows[part], epochs.start[part] - first
        values = [column[first : first + int(rows.sum())] for column in columns]
        found = np.empty((4, len(self.draws), len(rows)), np.int64)
        buffers = np.empty((4, len(values[0])), np.float32)
        owner = np.repeat(np.arange(len(rows)), rows)
        for place, draw in enumerate(self.draws):
            length, spare = draw.lengths(values, buffers), buffers[3]
            mean = np.add.reduceat(length, start) / rows
            enmo = np.add.reduceat(np.maximum(length, np.float32(0), out=spare), start) / rows
            centre = np.repeat(mean.astype(np.float32), rows)
            above = np.add.reduceat(np.maximum(length, centre, out=spare), start) / rows
            np.abs(length, out=spare)
            measures = (enmo, 2 * (above - mean), 2 * enmo - mean)
            for row, one in enumerate(measures):
                found[row, place] = np.rint(one * ONE_G)
            found[3, place] = _crossings(spare > np.float32(CROSSING_MG / 1000), owner, len(rows))
        return EpochMeasures(*found)


def _crossings(above: NDArray[np.bool_], owner: Integers, number: int) -> Integers:
    """Return how often each epoch's rows cross a threshold; not between epochs."""
    at = np.flatnonzero(above[1:] != above[:-1])
    return np.bincount(owner[at][owner[at] == owner[at + 1]], minlength=number)


def _blocks(rows: Integers) -> Iterator[slice]:
    """Yield stretches of consecutive epochs with few rows."""
    if not len(rows):
        return
    block = (np.cumsum(rows) - rows) // BLOCK_ROWS
    edges = [0, *(np.flatnonzero(np.diff(block)) + 1).tolist(), len(rows)]
    yield from map(slice, edges[:-1], edges[1:])


def ends(values: NDArray[Any]) -> NDArray[Any]:
    """Return the ends (2, ...) of the 95 % interval of values of DRAWS calibrations, (DRAWS, ...)."""
    return np.stack([values.min(axis=0), values.max(axis=0)])
