"""Measures of activity by epoch, and what a calibration changes in them, in one pass.

The same rows are measured raw, calibrated without misalignment, and calibrated. Lengths are whole numbers of
2**-32 g, and sums of them are exact: the length of the chunks makes no difference. An epoch is the
consecutive rows whose times lie in the same multiple of its length; it has no value if less than four fifths
of it was measured.

ENMO: mean of max(|a| - 1 g, 0) (van Hees et al. 2013, PLoS ONE 8(4): e61691).
MAD: mean of ||a| - its mean in the epoch| (Vaha-Ypya et al. 2015, Clin Physiol Funct Imaging 35: 64).
MVPA: epochs with an ENMO of 100 mg or more (Hildebrand et al. 2014, Med Sci Sports Exerc 46: 1816: 100.6 mg).
PIM: integral of ||a| - 1 g|, and ZCM: how often that crosses a threshold (Maczak et al. 2021, PLoS ONE
16(12): e0261718, of their UFNM; Farago, Maczak, Gingl 2024 name both as sensitive to calibration).
Inactivity: the arm's angle changes by no more than 5 degrees from one 5 s to the next, for 5 min or longer
(van Hees et al. 2015, PLoS ONE 10(11): e0142533; here of means of 5 s, there of rolling medians).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import atan2, degrees, hypot
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import quotient
from accelcal_cli.core.calibration import Axes, Calibration, Transform
from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.declared import as_json
from accelcal_cli.core.recording import Chunk, Recording, Validity
from accelcal_cli.output.report import ReportInput
from accelcal_cli.output.sections import ActivitySection, EffectSection, Excess, LeftOutSamples

# Epochs of a recording, exactly: a stream of rows is cut into them, and lengths are whole numbers.

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

    @classmethod
    def of(cls, epoch_s: int, rate_hz: float) -> EpochCutter:
        """Return one for epochs of whole seconds."""
        return cls(epoch_s * MICROSECONDS, max(2, MOST_ROWS * round(epoch_s * rate_hz)))

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


# Measures of activity of the same epochs with each of many plausible calibrations, for their
# intervals.
#
# Each row is measured once with every calibration drawn from the posterior, so that ENMO, which cuts
# off at 1 g, is as far from linear as it is. A drawn calibration is applied to the calibrated values:
# a' = M a + c + p T. Values are of single precision, about 0.0002 mg; means by epoch are whole
# numbers of 2**-32 g, and their sums exact.

DRAWS = 39
"""Number of plausible calibrations: in 38 of 40 cases one more lies between their lowest and highest."""

BLOCK_ROWS = 1 << 15
"""Rows that are measured at a time, so that intermediate values stay in the processor's cache."""

MICRODEGREES = 1e6

FIGURES = ("enmo_mg", "mad_mg", "mvpa_min", "pim_mg_s", "zcm", "angle_deg")
"""Figures that are given an interval."""

MEASURES = ("enmo", "mad", "pim", "zcm")
"""Measures of an epoch."""

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
        if not self.draws:
            return
        found = self.measured(epochs, columns).select(valued)
        for name in MEASURES:
            getattr(self, name)[:] += getattr(found, name).sum(axis=1)
        self.active += (found.enmo >= round(MVPA_MG / MG)).sum(axis=1)

    def measured(self, epochs: WholeEpochs, columns: Sequence[Singles]) -> EpochMeasures:
        """Return the measures (K, m) of whole epochs; `columns` as in `add`."""
        parts = [self._measured(epochs, columns, part) for part in _blocks(epochs.rows)]
        return EpochMeasures(*(np.hstack([getattr(one, name) for one in parts]) for name in MEASURES))

    def angles(self, xyz: NDArray[np.float64], celsius: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the arm's angles (K, m) [degrees] of mean values, (m, 3) [g] and (m,)."""
        turned = (draw.vectors(xyz, celsius) for draw in self.draws)
        return np.stack([np.degrees(np.arctan2(z, np.hypot(x, y))) for x, y, z in turned])

    def totals(self) -> dict[str, Integers]:
        """Return the sums (K,) of each of FIGURES."""
        sums = (self.enmo, self.mad, self.active, self.pim, self.zcm, self.angle)
        return dict(zip(FIGURES, sums, strict=True))

    def turn(self, xyz: NDArray[np.float64], celsius: NDArray[np.float64]) -> None:
        """Take in mean values of 5 s, (m, 3) [g] and (m,), for the arm's angle."""
        self.angle += np.rint(MICRODEGREES * self.angles(xyz, celsius)).astype(np.int64).sum(axis=1)

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


# Measures of activity by epoch, and what a calibration changes in them, in one pass.

EPOCH_S = 5
"""Default length [s] of an epoch, as in GGIR and in most of the sources."""

LONGEST_EPOCH_S = 3600
LEAST_MEASURED = 0.8
"""Share of an epoch that must have been measured for it to have a value."""

MOST_ROWS = 2
"""Rows with the same time, from a clock that stands, are cut after this multiple of an epoch's usual rows."""

ANGLE_S, STILL_DEGREES, INACTIVE_S = 5, 5.0, 300

RAW, SIMPLER, CALIBRATED, TRUE = "raw", "without_misalignment", "calibrated", "true"
LEFT_OUT = {"filled": Validity.FILLED, "clipped": Validity.CLIPPED, "recovered": Validity.RECOVERED}
"""Names of the rows that are left out, as they are not measurements or not whole ones."""

DIGITS = 4
"""Decimals of measures in reports and tables."""


@dataclass(frozen=True, slots=True)
class Activity:
    """Activity that one version of a recording shows.

    Attributes:
        enmo_mg, mad_mg: means over the epochs with a value; None if there is none.
        mvpa_min: minutes of moderate to vigorous physical activity.
        pim_mg_s, zcm: for a minute that was measured.
        angle_deg: mean angle of the arm.
        inactive_min: minutes of sustained inactivity.
        enmo_differs_mg: mean over the epochs of |the difference of ENMO from the last version's|.
    """

    enmo_mg: float | None
    mad_mg: float | None
    mvpa_min: float
    pim_mg_s: float | None
    zcm: float | None
    angle_deg: float | None
    inactive_min: float
    enmo_differs_mg: float | None


@dataclass(slots=True)
class _ActivitySums:
    """Sums of one version, all exact."""

    enmo: int = 0
    mad: int = 0
    pim: int = 0
    zcm: int = 0
    active: int = 0
    differs: int = 0
    angle: float | None = None
    angles: int = 0
    last: int = 0
    run: int = 0
    inactive: int = 0

    def add(self, epochs: EpochMeasures, against: EpochMeasures) -> None:
        self.enmo += int(epochs.enmo.sum())
        self.mad += int(epochs.mad.sum())
        self.pim += int(epochs.pim.sum())
        self.zcm += int(epochs.zcm.sum())
        self.active += int((epochs.enmo >= round(MVPA_MG / MG)).sum())
        self.differs += int(np.abs(epochs.enmo - against.enmo).sum())

    def totals(self) -> dict[str, int]:
        """Return the sums that plausible calibrations have as well, by the names of their figures."""
        return dict(
            zip(FIGURES, (self.enmo, self.mad, self.active, self.pim, self.zcm, self.angles), strict=True)
        )

    def turn(self, number: int, angle: float) -> None:
        """Take in the arm's angle [degrees] in the 5 s of a number."""
        follows = self.angle is not None and number == self.last + 1
        if not follows or abs(angle - (self.angle or 0.0)) > STILL_DEGREES:
            self.rest()
        self.angle, self.last, self.run = angle, number, self.run + 1
        self.angles += round(MICRODEGREES * angle)

    def rest(self) -> None:
        """End a run of equal angles, at a turn of the arm or a gap; a long run counts."""
        if self.run * ANGLE_S >= INACTIVE_S:
            self.inactive += self.run
        self.run = 0


@dataclass
class ActivityMeter:
    """Measures several versions of one recording side by side.

    Args:
        versions: how many; differences are from the last one.
        epoch_s: length of an epoch, whole seconds.
        drawn: also measures with plausible calibrations; about: number of the version that they replace.

    Attributes:
        epochs: number of epochs with a value; short: number with too few rows.
        rows: number of rows in the epochs with a value; angles: number of 5 s with an angle.
    """

    versions: int
    epoch_s: int
    rate_hz: float
    drawn: DrawnActivity = field(default_factory=lambda: DrawnActivity([]))
    about: int = 0
    epochs: int = 0
    short: int = 0
    rows: int = 0
    angles: int = 0
    _sums: list[_ActivitySums] = field(init=False)

    def __post_init__(self) -> None:
        self._sums = [_ActivitySums() for _ in range(self.versions)]
        self._cut, self._cut_angles = (EpochCutter.of(one, self.rate_hz) for one in (self.epoch_s, ANGLE_S))

    def feed(
        self, time_us: Integers, versions: Sequence[Axes], temperature_mc: NDArray[np.int32] | None = None
    ) -> None:
        """Take in measured rows, x, y and z of each version [g]."""
        axes = [fixed(axis) for xyz in versions for axis in xyz]
        if self.drawn.draws:
            warm = np.zeros(len(time_us), np.int32) if temperature_mc is None else temperature_mc
            axes.append(warm.astype(np.int64))
        for epochs in self._cut_angles.feed(time_us, *axes):
            self._turn(epochs)
        columns: list[NDArray[Any]] = [lengths(xyz) for xyz in versions]
        if self.drawn.draws:
            columns += [*versions[self.about], (warm / 1000).astype(np.float32)]
        for epochs in self._cut.feed(time_us, *columns):
            self._measure(epochs)

    def finish(self) -> None:
        """End the recording."""
        for epochs in self._cut_angles.finish():
            self._turn(epochs)
        for epochs in self._cut.finish():
            self._measure(epochs)
        for sums in self._sums:
            sums.rest()

    def result(self) -> tuple[Activity, ...]:
        """Return the activity of each version, after `finish`."""
        return tuple(self._activity(sums) for sums in self._sums)

    def _measure(self, epochs: WholeEpochs) -> None:
        valued = epochs.rows >= LEAST_MEASURED * self.epoch_s * self.rate_hz
        norms, values = epochs.columns[: self.versions], epochs.columns[self.versions :]
        measured = [EpochMeasures.of(length, epochs).select(valued) for length in norms]
        for sums, own in zip(self._sums, measured, strict=True):
            sums.add(own, measured[-1])
        self.epochs, self.short = self.epochs + int(valued.sum()), self.short + int((~valued).sum())
        self.rows += int(epochs.rows[valued].sum())
        self.drawn.add(epochs, values, valued)

    def _turn(self, epochs: WholeEpochs) -> None:
        valued = np.flatnonzero(epochs.rows >= LEAST_MEASURED * ANGLE_S * self.rate_hz)
        number = epochs.number[valued].tolist()
        sums = [np.add.reduceat(axis, epochs.start)[valued] for axis in epochs.columns]
        axes = [column.tolist() for column in sums]
        for version, own in enumerate(self._sums):
            for one, x, y, z in zip(number, *axes[3 * version : 3 * version + 3], strict=True):
                own.turn(one, degrees(atan2(z, hypot(x, y))))
        self.angles += len(number)
        if self.drawn.draws:
            means = np.stack(sums, axis=1) / epochs.rows[valued, np.newaxis]
            first = 3 * self.about
            self.drawn.turn(means[:, first : first + 3] / ONE_G, means[:, -1] / 1000)

    def _activity(self, sums: _ActivitySums) -> Activity:
        return Activity(
            **{name: self._scaled(name, total) for name, total in sums.totals().items()},
            inactive_min=sums.inactive * ANGLE_S / 60,
            enmo_differs_mg=self._scaled("enmo_mg", sums.differs),
        )

    def _scaled(self, name: str, total: Any) -> Any:
        """Return a figure by its sum, or the figures of K sums (K,); None without any epoch."""
        if name == "mvpa_min":
            return total * self.epoch_s / 60
        number = {"zcm": self.rows, "angle_deg": self.angles}.get(name, self.epochs)
        unit = {"zcm": 60 * self.rate_hz, "angle_deg": 1 / MICRODEGREES, "pim_mg_s": 60 * MG}.get(name, MG)
        return total * unit / number if number else None

    def intervals(self) -> dict[str, tuple[float, float]] | None:
        """Return the 95 % interval of each figure that the plausible calibrations give; None without them.

        It holds the figure of the calibration itself: at rest, ENMO is lowest with that.
        """
        if not self.drawn.draws or not self.epochs:
            return None
        best = self._sums[self.about].totals()
        found = {}
        for name, totals in self.drawn.totals().items():
            if (own := self._scaled(name, best[name])) is not None:
                low, high = ends(self._scaled(name, totals)).tolist()
                found[name] = min(low, own), max(high, own)
        return found


@dataclass(frozen=True, slots=True)
class Version:
    """One way to read the counts of a recording.

    Attributes:
        name: its name in reports.
        model: name of its model; None where nothing was fitted.
    """

    name: str
    model: str | None
    transform: Transform


def versions(
    recording: Recording,
    calibration: Calibration | None,
    simpler: Calibration | None,
    precision_mg: float | None = None,
) -> list[Version]:
    """Return the raw version, and those of the calibrations; the full one comes last."""
    scale = recording.lsb_per_g
    made = [
        Version(name, one.model, Transform.of(one, scale, precision_mg))
        for name, one in ((SIMPLER, simpler), (CALIBRATED, calibration))
        if one is not None
    ]
    return [Version(RAW, None, Transform.of(None, scale)), *made]


def versions_of(data: ReportInput) -> list[Version]:
    """Return the versions of a result."""
    simpler = data.judgement.without_misalignment
    made = None if simpler is None else simpler.calibration
    return versions(data.recording, data.judgement.calibration, made, data.settings.precision_mg)


class EffectMeter:
    """Measures versions of a recording as its chunks pass."""

    def __init__(
        self, made: list[Version], recording: Recording, epoch_s: int, drawn: DrawnActivity | None = None
    ) -> None:
        self.versions = made
        names, drawn = [one.name for one in made], drawn or DrawnActivity([])
        about = names.index(CALIBRATED) if CALIBRATED in names else 0
        self._meter = ActivityMeter(len(made), epoch_s, recording.rate_hz, drawn, about)
        self._left_out = dict.fromkeys(LEFT_OUT, 0)
        self._rows = 0

    def _see(self, chunk: Chunk) -> None:
        if not len(chunk):
            return
        self._rows += len(chunk)
        xyz, times = [one.transform.apply(chunk) for one in self.versions], chunk.time_us
        warm = chunk.temperature_mc
        if chunk.validity is not None and chunk.validity.any():
            for name, value in LEFT_OUT.items():
                self._left_out[name] += int((chunk.validity == value).sum())
            kept = chunk.validity == Validity.MEASURED
            xyz, times = [[axis[kept] for axis in one] for one in xyz], times[kept]
            warm = None if warm is None else warm[kept]
        self._meter.feed(times, xyz, warm)

    def watch(self, chunks: Iterable[Chunk]) -> Iterator[Chunk]:
        """Pass chunks on, and take them in."""
        for chunk in chunks:
            self._see(chunk)
            yield chunk

    def finish(self) -> None:
        """End the recording."""
        self._meter.finish()

    def result(self) -> dict[str, Any]:
        """Return the report's `effect` object, after `finish`."""
        meter = self._meter
        found = {
            one.name: ActivitySection(one.model, **_rounded(asdict(activity)))
            for one, activity in zip(self.versions, meter.result(), strict=True)
        }
        intervals, bias = _uncertainty(meter.intervals(), found)
        section = EffectSection(
            epoch_s=meter.epoch_s,
            epochs=meter.epochs,
            short_epochs=meter.short,
            left_out=LeftOutSamples(**self._left_out),
            left_out_percent=100 * sum(self._left_out.values()) / max(1, self._rows),
            versions=found,
            ci95=intervals,
            raw_bias=bias,
        )
        return as_json(section)


def drawn_of(data: ReportInput) -> DrawnActivity:
    """Return what measures with the plausible calibrations of a result."""
    verdict = data.judgement
    return DrawnActivity.of(verdict.calibration, verdict.draws(DRAWS, data.sha256))


def _uncertainty(
    intervals: dict[str, tuple[float, float]] | None, versions: Mapping[str, ActivitySection]
) -> tuple[dict[str, tuple[float, float]] | None, dict[str, Excess] | None]:
    """Return `ci95` and `raw_bias`: how uncertain figures are, and how far off raw ones."""
    if intervals is None:
        return None, None
    ends_of = {name: (round(low, DIGITS), round(high, DIGITS)) for name, (low, high) in intervals.items()}
    bias = {}
    for name, (low, high) in ends_of.items():
        raw, calibrated = (getattr(versions[version], name) for version in (RAW, CALIBRATED))
        bias[name] = Excess(raw - calibrated, (raw - high, raw - low))
    return ends_of, bias


def _rounded(figures: dict[str, Any]) -> dict[str, Any]:
    return {name: None if value is None else round(value, DIGITS) for name, value in figures.items()}
