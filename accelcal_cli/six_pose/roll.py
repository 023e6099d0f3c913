"""A roll with one axis level, by which a calibration is checked without any pose (Bragge et al., results).

The device is rolled along a level surface about one of its axes. That axis then measures nothing, whatever
the angle, and the others turn through +-1 g: what the level axis shows is the error that is left, its mean
that of the offset, its standard deviation that of the axes' directions (and of noise and shaking).

The rows of a roll become exact sums of their counts and of the products of these, from which follows what
any calibration makes of them, without a third reading, and the same bits however the rows were cut.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.errors import DivergedError, UsageError, printable
from accelcal_cli.core.points import Windows
from accelcal_cli.core.recording import Chunk, Validity
from accelcal_cli.six_pose.listing import Listed, Place, moment
from accelcal_cli.six_pose.spans import Origin, Span, span_of

AXES = "xyz"
LEAST_TURN_G = 0.3
"""Standard deviation of what the two other axes measure, in the direction where it is least: 0.31 g for half
a turn, 0.71 g for whole ones."""

MOST_LEVEL_G = 0.25
"""Standard deviation of a level axis: no sensor is so skew."""

HOW = "write --roll AXIS,START,END, such as z,80,95, or AXIS,FILE where the session is in several files"
_SPLIT = 14

Level = tuple[Fraction, Fraction, Fraction]
Products = tuple[Level, Level, Level]


@dataclass(frozen=True, slots=True)
class Roll:
    """Where the device was rolled.

    Attributes:
        axis: number of the axis that was level.
        rest: what follows the axis, as it was given.
    """

    axis: int
    rest: str

    @property
    def text(self) -> str:
        """As it was given."""
        return f"--roll {AXES[self.axis]},{self.rest}"


@dataclass(frozen=True, slots=True)
class Figures:
    """What is measured along a roll [g].

    Attributes:
        mean_g, sd_g: of the level axis.
        length_g: root of the mean square of |a|; 1 where the device rolls evenly.
        turn_g: see LEAST_TURN_G.
    """

    mean_g: float
    sd_g: float
    length_g: float
    turn_g: float


@dataclass(frozen=True, slots=True)
class Rolled:
    """What came of a roll.

    Attributes:
        file: number of its file.
        ends_us: times of its first and last row, on the device's clock.
        samples: how many rows were measured there.
        before, after: of the raw values, and with the calibration, if there is one.
    """

    axis: int
    file: int
    ends_us: tuple[int, int]
    samples: int
    before: Figures
    after: Figures | None


def rolls_of(texts: Iterable[str]) -> tuple[Roll, ...]:
    """What `--roll` says; raises UsageError if it names no axis, or nothing behind it."""
    found = []
    for text in texts:
        axis, comma, rest = text.partition(",")
        if axis.strip().lower() not in tuple(AXES) or not comma or not rest.strip():
            raise UsageError(f"--roll {printable(text[:80])!r} names no axis and place", hint=HOW)
        found.append(Roll(AXES.index(axis.strip().lower()), rest.strip()))
    return tuple(found)


def span_of_roll(roll: Roll, origins: Sequence[Origin]) -> Span:
    """Place a roll: START,END, or FILE, or FILE,START,END.

    Raises:
        UsageError: see `spans.span_of`; or a time is none.
    """
    place = _Option(Path(roll.text), 0)
    names = [origin.name for origin in origins if origin.name is not None]
    file, times = roll.rest if names else None, roll.rest.split(",")
    if names and roll.rest not in names and len(times) > 2:
        file, times = ",".join(times[:-2]), times[-2:]
    elif names:
        times = []
    if len(times) not in (0, 2):
        raise place.wrong("has no start and end", HOW)
    start, end = [moment(one.strip(), place) for one in times] or (None, None)
    return span_of(Listed(place, start, end, _LEVEL, file=file), origins)


_LEVEL = (Fraction(0),) * 3


class _Option(Place):
    """The option, in the place of a line."""

    def wrong(self, message: str, hint: str | None = None) -> UsageError:
        """An error that names the option."""
        return UsageError(f"{printable(str(self.path))}: {message}", hint=hint)


class Sums:
    """Exact sums of the counts of rows, and of their products."""

    def __init__(self) -> None:
        self.samples = 0
        self.ends_us = (0, 0)
        self._first = [0, 0, 0]
        self._second = [[0] * 3 for _ in range(3)]

    def add(self, counts: NDArray[Any], time_us: NDArray[np.int64]) -> None:
        """Take rows in, (n, 3) and (n,): by halves of 32 bits, so that no sum of products overflows."""
        self.ends_us = (self.ends_us[0] if self.samples else int(time_us[0]), int(time_us[-1]))
        wide = counts.astype(np.int64)
        high, low = wide >> _SPLIT, wide & ((1 << _SPLIT) - 1)
        self.samples += len(wide)
        for i in range(3):
            self._first[i] += int(wide[:, i].sum())
            for j in range(3):
                both = int((high[:, i] * high[:, j]).sum())
                cross = int((high[:, i] * low[:, j]).sum()) + int((low[:, i] * high[:, j]).sum())
                least = int((low[:, i] * low[:, j]).sum())
                self._second[i][j] += (both << 2 * _SPLIT) + (cross << _SPLIT) + least

    def mean_g(self, lsb_per_g: float) -> Level:
        """Mean of each axis [g]."""
        x, y, z = (Fraction(value, self.samples) / Fraction(lsb_per_g) for value in self._first)
        return x, y, z

    def products_g2(self, lsb_per_g: float) -> Products:
        """Mean products of two axes, less those of the means [g^2]."""
        mean, scale = self.mean_g(lsb_per_g), self.samples * Fraction(lsb_per_g) ** 2
        rows = [[self._second[i][j] / scale - mean[i] * mean[j] for j in range(3)] for i in range(3)]
        first, second, third = ((x, y, z) for x, y, z in rows)
        return first, second, third


def within(still: Windows, span: Span, origin: Origin) -> NDArray[np.bool_]:
    """Which windows a roll reaches into."""
    assert still.start_us is not None and still.end_us is not None
    inside = (still.end_us > span.start_us) & (still.start_us < span.end_us)
    return np.asarray(inside & origin.holds(still.first_sample))


def sums_of(chunks: Iterable[Chunk], span: Span, origin: Origin) -> Sums:
    """Sums of the rows that were measured within a span."""
    sums = Sums()
    for chunk in chunks:
        number = np.arange(chunk.first_sample, chunk.first_sample + len(chunk))
        time_us = chunk.time_us
        inside = origin.holds(number) & (time_us >= span.start_us) & (time_us < span.end_us)
        if chunk.validity is not None:
            inside &= chunk.validity == Validity.MEASURED
        if inside.any():
            sums.add(chunk.counts[inside], time_us[inside])
    return sums


def rolled(roll: Roll, span: Span, sums: Sums, lsb_per_g: float, calibration: Calibration | None) -> Rolled:
    """What a calibration makes of a roll.

    Raises:
        DivergedError: nothing was measured there, or the device did not roll about this axis.
    """
    if not sums.samples:
        raise DivergedError(f"{printable(roll.text)}: nothing was measured there", hint="check the times")
    raw = _figures(roll.axis, sums.mean_g(lsb_per_g), sums.products_g2(lsb_per_g))
    after = None if calibration is None else _calibrated(roll.axis, sums, lsb_per_g, calibration)
    best = after or raw
    if best.turn_g < LEAST_TURN_G or best.sd_g > MOST_LEVEL_G:
        raise DivergedError(
            f"{printable(roll.text)}: the device does not roll there by half a turn, with "
            f"{AXES[roll.axis]} level",
            hint="check the axis and the times",
        )
    return Rolled(roll.axis, span.file, sums.ends_us, sums.samples, raw, after)


def _calibrated(axis: int, sums: Sums, lsb_per_g: float, calibration: Calibration) -> Figures:
    """The same of a = K (v + o): means and products follow from those of v."""
    gain, offset = _exact(calibration)
    shifted = [value + o for value, o in zip(sums.mean_g(lsb_per_g), offset, strict=True)]
    products = sums.products_g2(lsb_per_g)
    x, y, z = (sum((k * v for k, v in zip(row, shifted, strict=True)), Fraction(0)) for row in gain)
    half = [[_dot(row, [products[i][j] for i in range(3)]) for j in range(3)] for row in gain]
    rows = [[_dot(half[i], gain[j]) for j in range(3)] for i in range(3)]
    first, second, third = ((a, b, c) for a, b, c in rows)
    return _figures(axis, (x, y, z), (first, second, third))


def _dot(one: Sequence[Fraction], other: Sequence[Fraction]) -> Fraction:
    return sum((a * b for a, b in zip(one, other, strict=True)), Fraction(0))


def _exact(calibration: Calibration) -> tuple[list[list[Fraction]], list[Fraction]]:
    """K and o, as their fixed-point integers say."""
    p = [Fraction(value, ONE) for value in calibration.parameters]
    yx, zx, zy = (Fraction(value, ONE) for value in calibration.upper)
    return [[p[0], yx, zx], [p[3], p[1], zy], [p[4], p[5], p[2]]], p[6:9]


def _figures(axis: int, mean: Level, products: Products) -> Figures:
    one, two = (other for other in range(3) if other != axis)
    length2 = sum((products[i][i] + mean[i] ** 2 for i in range(3)), Fraction(0))
    half = (products[one][one] + products[two][two]) / 2
    apart2 = ((products[one][one] - products[two][two]) / 2) ** 2 + products[one][two] ** 2
    turn2 = max(0.0, float(half) - sqrt(apart2))
    return Figures(float(mean[axis]), sqrt(products[axis][axis]), sqrt(length2), sqrt(turn2))


def told(one: Rolled) -> str:
    """A roll in words, for the message of a report."""
    axis = AXES[one.axis]
    text = f"rolled with {axis} level, {axis} shows {_shown(one.before)}"
    return text if one.after is None else f"{text} before, {_shown(one.after)} after"


def _shown(figures: Figures) -> str:
    return f"{1000 * figures.mean_g:.1f} mg (SD {1000 * figures.sd_g:.1f})"
