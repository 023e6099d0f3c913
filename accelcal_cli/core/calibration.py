"""A calibration, a = K (v + q v^2 + o + s (T - Tref)), and how it is applied.

q is the bend of the response, axis by axis. `calibrated` is the equation for a few vectors in double
precision, `Transform` for the rows of a recording. Where a sensor changed while it recorded, a `Correction`
puts its raw values right first.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, frexp, log2
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE, rounded_quotient, three, to_float
from accelcal_cli.core.gravity import STANDARD, Gravity

PARAMETER_NAMES = ("k_xx", "k_yy", "k_zz", "k_yx", "k_zx", "k_zy", "ox", "oy", "oz", "sx", "sy", "sz")
"""K (lower triangular), offsets [g], temperature slopes of the offsets [g per degree C].

k_RC is the entry of K in row R, column C: what multiplies C in the equation of R. F writes kxy for k_yx,
kxz for k_zx, kyz for k_zy.
"""

UPPER_NAMES = ("k_xy", "k_xz", "k_yz")
"""Entries of K above its diagonal: only known orientations determine them."""

IDENTITY: tuple[int, ...] = (ONE, ONE, ONE) + (0,) * 9
"""Parameters that change nothing."""

Bend = tuple[int, int, int]
"""q of x, y, z [per g], in fixed point: v + q v^2 straightens the response of a sensor."""

NO_BEND: Bend = (0, 0, 0)

BEND_ROUNDS = 4
"""Iterations that invert a bend of a few percent to 1e-7 g."""

BLOCK_ROWS = 1 << 14
"""Rows that are calibrated at a time, so that intermediate values stay in the processor's cache."""

ROUNDING = 1e-6
"""Upper bound of the relative error that rounding to double and to single adds to a value."""

Floats = NDArray[np.float64]
Knot = tuple[int, int, int]

Axes = list[NDArray[np.float32]]
"""Calibrated x, y, z [g]."""


@dataclass(frozen=True, slots=True)
class Correction:
    """Corrects raw values of a sensor that changed while it recorded: r v + d replaces v.

    Between knots, r and d are constant or interpolated linearly; after the last knot they are constant.

    Attributes:
        samples: sample number of each knot, ascending; the first is 0.
        stretch: r of x, y, z at each knot, in fixed point.
        shift: d of x, y, z at each knot [g], in fixed point.
        lines: True if r and d are interpolated between knots.
    """

    samples: tuple[int, ...]
    stretch: tuple[Knot, ...]
    shift: tuple[Knot, ...]
    lines: bool

    def at(self, sample: int) -> tuple[Knot, Knot]:
        """Return r and d of one sample, in fixed point."""
        after = bisect_right(self.samples, sample)
        if not self.lines or after == len(self.samples):
            return self.stretch[after - 1], self.shift[after - 1]
        into, apart = sample - self.samples[after - 1], self.samples[after] - self.samples[after - 1]
        stretch, shift = (
            _interpolated(knots[after - 1], knots[after], into, apart) for knots in (self.stretch, self.shift)
        )
        return stretch, shift

    def values(self, samples: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Return r and d [g] of ascending samples (n,), each (n, 3); (1, 3) where all rows are equal."""
        knots = np.array(self.samples, np.int64)
        first, last = np.searchsorted(knots, samples[[0, -1]], side="right") - 1
        left = np.array([first]) if first == last else np.searchsorted(knots, samples, side="right") - 1
        right = np.minimum(left + self.lines, len(knots) - 1)
        share = (samples - knots[left]) / np.maximum(1, knots[right] - knots[left])

        def interpolated(column: tuple[Knot, ...]) -> Floats:
            ends = np.array(column) / ONE
            rise = ends[right] - ends[left]
            return np.asarray(ends[left] + rise * share[:, np.newaxis] if rise.any() else ends[left])

        return interpolated(self.stretch), interpolated(self.shift)

    def applied(self, raw: Floats, samples: NDArray[np.int64]) -> Floats:
        """Return raw vectors (n, 3) [g] of ascending samples (n,), corrected."""
        stretch, shift = self.values(samples)
        return np.asarray(stretch * raw + shift)

    def in_standard_g(self, local_g: Fraction) -> Correction:
        """Convert a correction of values in units of local gravity to one of values in standard g."""
        return replace(self, shift=tuple(_times(knot, local_g) for knot in self.shift))

    def in_local_g(self, local_g: Fraction) -> Correction:
        """Convert a correction of values in standard g to one of values in units of local gravity."""
        return replace(self, shift=tuple(_times(knot, 1 / local_g) for knot in self.shift))


def _interpolated(left: Knot, right: Knot, into: int, apart: int) -> Knot:
    return three(a + rounded_quotient((b - a) * into, apart) for a, b in zip(left, right, strict=True))


def _times(knot: Knot, factor: Fraction) -> Knot:
    return three(scaled(value, factor) for value in knot)


@dataclass(frozen=True, slots=True)
class TemperatureScale:
    """How temperatures become fixed-point numbers: (T - reference) / span.

    Attributes:
        reference_mc: reference temperature [thousandths of a degree C].
        span_c: a power of two [degrees C], so that the scaled values lie within +-2.
    """

    reference_mc: int
    span_c: float


@dataclass(frozen=True, slots=True)
class Calibration:
    """a = K (v + q v^2 + o + s (T - Tref)), v in raw g (F eq. 7-9, with a bend and slopes).

    Attributes:
        model: name of the model that was fitted.
        parameters: twelve fixed-point integers, offsets in standard g.
        temperature: scale of the slopes, None if the model has none.
        gravity: what rest measures.
        upper: entries of K above its diagonal, in the order of UPPER_NAMES.
        correction: applied to v first, if the sensor changed while it recorded.
        bend: q; zeros for a response that was taken to be straight.
    """

    model: str
    parameters: tuple[int, ...]
    temperature: TemperatureScale | None = None
    gravity: Gravity = STANDARD
    upper: tuple[int, int, int] = (0, 0, 0)
    correction: Correction | None = None
    bend: Bend = NO_BEND

    def gain(self) -> Floats:
        """K, (3, 3); lower triangular unless orientations were known."""
        k = [to_float(value) for value in self.parameters[:6]]
        xy, xz, yz = (to_float(value) for value in self.upper)
        return np.array([[k[0], xy, xz], [k[3], k[1], yz], [k[4], k[5], k[2]]])

    def offset_g(self) -> Floats:
        """o, (3,) in g."""
        return np.array([to_float(value) for value in self.parameters[6:9]])

    def bend_per_g(self) -> Floats:
        """q, (3,) per g."""
        return np.array([to_float(value) for value in self.bend])

    def straight(self, raw_g: Floats) -> Floats:
        """Return v + q v^2 of raw vectors (n, 3) [g]."""
        return np.asarray(raw_g + self.bend_per_g() * raw_g * raw_g)

    def bent(self, straight_g: Floats) -> Floats:
        """Return the raw vectors (n, 3) [g] of which others are the straight ones."""
        raw = straight_g
        for _ in range(BEND_ROUNDS if any(self.bend) else 0):
            raw = straight_g - self.bend_per_g() * raw * raw
        return raw

    def slope_g_per_c(self) -> Floats:
        """s, (3,) in g per degree C; zeros without temperature."""
        if self.temperature is None:
            return np.zeros(3)
        return np.array([to_float(value) / self.temperature.span_c for value in self.parameters[9:]])

    def reference_c(self) -> float:
        """Tref in degrees C; 0 without temperature."""
        return 0.0 if self.temperature is None else self.temperature.reference_mc / 1000

    def offset_at(self, celsius: float) -> Floats:
        """Offsets at a temperature, (3,) in g."""
        return self.offset_g() + self.slope_g_per_c() * (celsius - self.reference_c())

    def applied(self, raw: Sequence[Floats], celsius: Floats | None) -> list[Floats]:
        """Return calibrated x, y, z [standard g], each (n,), of raw ones; the correction is not applied.

        Args:
            raw: x, y, z [standard g], each (n,).
            celsius: temperatures (n,), needed if there are slopes.
        """
        if any(self.bend):
            raw = [v + q * (v * v) for v, q in zip(raw, self.bend_per_g().tolist(), strict=True)]
        if self.temperature is None:
            return calibrated(raw, self.gain(), self.offset_g())
        assert celsius is not None
        heat = (self.slope_g_per_c(), celsius - self.reference_c())
        return calibrated(raw, self.gain(), self.offset_g(), heat)


def calibrated(
    raw: Sequence[Floats], gain: Floats, offset: Floats, heat: tuple[Floats, Floats] | None = None
) -> list[Floats]:
    """Return x, y, z of K (v + o + s w), each (n,), elementwise: the same bits on every machine.

    Args:
        raw: x, y, z of v, each (n,).
        gain: K, (3, 3); offset: o, (3,).
        heat: s (3,) and the temperatures w (n,), less their reference.
    """
    u = [value + offset[axis] for axis, value in enumerate(raw)]
    if heat is not None:
        slope, warmth = heat
        u = [value + slope[axis] * warmth for axis, value in enumerate(u)]
    return [gain[row, 0] * u[0] + gain[row, 1] * u[1] + gain[row, 2] * u[2] for row in range(3)]


def in_standard_g(parameters: tuple[int, ...], local_g: Fraction) -> tuple[int, ...]:
    """Convert parameters that were fitted to points in units of local gravity to standard g.

    With v = u g: K (v + o g) = g K (u + o); K stays as it is, offsets and slopes grow with g.
    """
    return (*parameters[:6], *(scaled(value, local_g) for value in parameters[6:]))


def scaled(value: int, factor: Fraction) -> int:
    """Return an integer times a fraction, rounded."""
    return rounded_quotient(value * factor.numerator, factor.denominator)


class Rows(Protocol):
    """Rows to calibrate: a chunk, or values of another program."""

    @property
    def first_sample(self) -> int:
        """Number of the first row within the recording."""

    @property
    def counts(self) -> NDArray[Any]:
        """(n, 3) raw values, `Transform.lsb_per_g` of which are 1 g."""

    @property
    def temperature_mc(self) -> NDArray[np.int32] | None:
        """(n,) thousandths of a degree C, or None."""

    def __len__(self) -> int: ...


@dataclass(frozen=True, slots=True, eq=False)
class RawRows:
    """Rows of which only their raw values and temperatures are known; see `Rows`."""

    counts: NDArray[Any]
    temperature_mc: NDArray[np.int32] | None = None
    first_sample: int = 0

    def __len__(self) -> int:
        return len(self.counts)


@dataclass(frozen=True, slots=True)
class Transform:
    """a = K (v + q v^2 + o + s (T - Tref)) for the rows of a recording, v in counts.

    Attributes:
        steps_per_g: a power of two; calibrated values are rounded to 1 / steps_per_g. None: they are not.
        correction: applied to v first, if the sensor changed while it recorded.
        bend_per_g: q; None for a straight response.
    """

    gain: Floats
    offset_g: Floats
    slope_g_per_c: Floats
    reference_c: float
    lsb_per_g: float
    steps_per_g: float | None = None
    correction: Correction | None = None
    bend_per_g: Floats | None = None

    @classmethod
    def of(
        cls, calibration: Calibration | None, lsb_per_g: float, precision_mg: float | None = None
    ) -> Transform:
        """Return what applies a calibration to counts; without one, counts are only scaled to g."""
        if calibration is None:
            return cls(np.eye(3), np.zeros(3), np.zeros(3), 0.0, lsb_per_g)
        return cls(
            calibration.gain(),
            calibration.offset_g(),
            calibration.slope_g_per_c(),
            calibration.reference_c(),
            lsb_per_g,
            steps_per_g(precision_mg),
            calibration.correction,
            calibration.bend_per_g() if any(calibration.bend) else None,
        )

    def apply(self, rows: Rows) -> Axes:
        """Return calibrated x, y, z [g], computed in double and rounded once to single."""
        xyz = [np.empty(len(rows), np.float32) for _ in range(3)]
        self.apply_into(rows, xyz)
        return xyz

    def apply_into(self, rows: Rows, xyz: Axes) -> None:
        """Write calibrated values into arrays (n,); an axis whose array is empty is left out."""
        wanted = [(self._gain_row(axis, rows), values) for axis, values in enumerate(xyz) if len(values)]
        buffers, warm = np.empty((6, min(len(rows), BLOCK_ROWS))), rows.temperature_mc
        for start in range(0, len(rows), BLOCK_ROWS):
            part = slice(start, min(start + BLOCK_ROWS, len(rows)))
            block = buffers[:, : part.stop - start]
            self._raw(rows, part, block[:3])
            if warm is not None:
                block[3] = warm[part]
            for row, values in wanted:
                values[part] = row.calibrated(block[:3], block[3], block[4:])

    def reach_g(self, rows: Rows) -> Floats:
        """Return bounds (3,) [g] of the absolute calibrated values of at least one row."""
        if self.correction is not None:
            return np.full(3, np.inf)
        warm, counts = rows.temperature_mc, np.array([_largest(column) for column in rows.counts.T])
        raw_g = counts / self.lsb_per_g
        if self.bend_per_g is not None:
            raw_g = raw_g + np.abs(self.bend_per_g) * raw_g * raw_g
        reach: Floats = np.abs(self.gain) @ raw_g
        reach += np.abs(self._constant(warm is not None))
        if warm is not None:
            reach += np.abs(self._per_mc()) * _largest(warm)
        return np.asarray(reach * (1 + ROUNDING))

    def depends_on_one_axis(self, axis: int) -> bool:
        """Return True if an axis's calibrated values follow from its own counts and the temperature alone."""
        return self.correction is None and not self.gain[axis, self._others(axis)].any()

    def _raw(self, rows: Rows, part: slice, v: Floats) -> None:
        """Write raw values into `v` (3, n): counts where `_in_counts`, else g."""
        v[:] = rows.counts[part].T
        if not self._in_counts:
            v /= self.lsb_per_g
        if self.correction is not None:
            numbers = rows.first_sample + np.arange(part.start, part.stop, dtype=np.int64)
            stretch, shift = self.correction.values(numbers)
            v *= stretch.T
            v += shift.T
        if self.bend_per_g is not None:
            v += self.bend_per_g[:, np.newaxis] * v * v

    @property
    def _in_counts(self) -> bool:
        # a division by a power of two changes no bit, so it may be done once, to the gain
        power = frexp(self.lsb_per_g)[0] == 0.5
        return self.correction is None and self.bend_per_g is None and power

    def _gain_row(self, axis: int, rows: Rows) -> _GainRow:
        in_counts, fixed = self._in_counts, self.gain * ONE
        warm = rows.temperature_mc is not None
        return _GainRow(
            axis=axis,
            gain=self.gain[axis] / self.lsb_per_g if in_counts else self.gain[axis],
            others=self._others(axis),
            exact=in_counts and rows.counts.dtype == np.int16 and bool((fixed == np.rint(fixed)).all()),
            per_mc=float(self._per_mc()[axis]) if warm else 0.0,
            constant=float(self._constant(warm)[axis]),
            steps_per_g=self.steps_per_g,
        )

    def _others(self, row: int) -> list[int]:
        """Columns besides the diagonal; above it only where K is not lower triangular."""
        return [column for column in range(3) if column < row or (column > row and self.gain[row, column])]

    def _per_mc(self) -> Floats:
        """K s, for thousandths of a degree C."""
        return np.asarray(self.gain @ self.slope_g_per_c / 1000)

    def _constant(self, warm: bool) -> Floats:
        """K (o - s Tref) [g], or K o without temperatures; + 0.0 takes the sign off a zero."""
        cold = self.slope_g_per_c * self.reference_c if warm else 0.0
        return np.asarray(self.gain @ (self.offset_g - cold) + 0.0)


@dataclass(frozen=True, slots=True)
class _GainRow:
    """One row of K, with the constant and the temperature term that belong to it.

    Attributes:
        exact: True if products of the gain, in fixed point, and counts of 16 bits are exact, and their sums,
            too: then no bit depends on the order of summing, which a library may choose.
    """

    axis: int
    gain: Floats
    others: list[int]
    exact: bool
    per_mc: float
    constant: float
    steps_per_g: float | None

    def calibrated(self, v: Floats, warmth: Floats, buffers: Floats) -> Floats:
        """Return values [g] of raw ones (3, n) and thousandths of a degree C (n,), in the first buffer."""
        total: Floats = buffers[0]
        product: Floats = buffers[1]
        if self.exact:
            np.dot(self.gain, v, out=total)
        else:
            np.multiply(v[self.axis], self.gain[self.axis], out=total)
            for column in self.others:
                total += np.multiply(v[column], self.gain[column], out=product)
        if self.per_mc:
            np.multiply(warmth, self.per_mc, out=product)
            product += self.constant
            total += product
        else:
            total += self.constant
        if self.steps_per_g is not None:
            total *= self.steps_per_g
            np.rint(total, out=total)
            total /= self.steps_per_g
        return total


def _largest(values: NDArray[Any]) -> float:
    """Return the largest absolute value."""
    return max(-float(values.min()), float(values.max()))


def steps_per_g(precision_mg: float | None) -> float | None:
    """Return the smallest power of two whose steps are no longer than the precision."""
    return None if precision_mg is None else 2.0 ** ceil(log2(1000 / precision_mg))
