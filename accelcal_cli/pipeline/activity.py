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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from math import atan2, degrees, hypot
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.calibration import Calibration, Transform
from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import Chunk, Recording, Validity
from accelcal_cli.output.report import ReportInput

Integers = NDArray[np.int64]

ONE_G = 1 << 32
MG = 1000 / ONE_G

EPOCH_S = 5
"""Default length [s] of an epoch, as in GGIR and in most of the sources."""

LONGEST_EPOCH_S = 3600
LEAST_MEASURED = 0.8
"""Share of an epoch that must have been measured for it to have a value."""

MOST_ROWS = 2
"""Rows with the same time, from a clock that stands, are cut after this multiple of an epoch's usual rows."""

MVPA_MG = 100.0
CROSSING_MG = 100.0
"""Threshold [mg] of ZCM; there it is chosen by the recording, here it is the same for all versions."""

ANGLE_S, STILL_DEGREES, INACTIVE_S = 5, 5.0, 300

RAW, SIMPLER, CALIBRATED, TRUE = "raw", "without_misalignment", "calibrated", "true"
LEFT_OUT = {"filled": Validity.FILLED, "clipped": Validity.CLIPPED, "recovered": Validity.RECOVERED}
"""Names of the rows that are left out, as they are not measurements or not whole ones."""

DIGITS = 4
"""Decimals of measures in reports and tables."""


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
    columns: tuple[Integers, ...]


class EpochCutter:
    """Cuts a stream of rows into whole epochs; between calls it keeps less than one."""

    def __init__(self, epoch_us: int, most_rows: int) -> None:
        self._epoch_us, self._most = epoch_us, most_rows
        self._left: tuple[Integers, ...] = ()

    def feed(self, time_us: Integers, *columns: Integers) -> Iterator[WholeEpochs]:
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

    def _whole(self, start: Integers, rows: tuple[Integers, ...]) -> WholeEpochs:
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
        return EpochMeasures(self.enmo[which], self.mad[which], self.pim[which], self.zcm[which])


def _rounded_mean(total: Integers, rows: Integers) -> Integers:
    """Return means rounded to the nearest unit, halves up."""
    return (2 * total + rows) // (2 * rows)


@dataclass(frozen=True, slots=True)
class Activity:
    """Activity that one version of a recording shows.

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
class _ActivitySums:
    """Sums of one version, all exact."""

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

    def add(self, epochs: EpochMeasures, against: EpochMeasures) -> None:
        self.enmo += int(epochs.enmo.sum())
        self.mad += int(epochs.mad.sum())
        self.pim += int(epochs.pim.sum())
        self.zcm += int(epochs.zcm.sum())
        self.active += int((epochs.enmo >= round(MVPA_MG / MG)).sum())
        self.differs += int(np.abs(epochs.enmo - against.enmo).sum())

    def turn(self, number: int, angle: float) -> None:
        """Take in the arm's angle [degrees] in the 5 s of a number."""
        follows = self.angle is not None and number == self.last + 1
        if not follows or abs(angle - (self.angle or 0.0)) > STILL_DEGREES:
            self.rest()
        self.angle, self.last, self.run = angle, number, self.run + 1

    def rest(self) -> None:
        """End a run of equal angles, at a turn of the arm or a gap; a long run counts."""
        if self.run * ANGLE_S >= INACTIVE_S:
            self.inactive += self.run
        self.run = 0


@dataclass(slots=True)
class EpochTable:
    """The epochs with a value that one feeding completed.

    Attributes:
        start_us: (m,) when each begins; rows: (m,) rows of it that were measured.
        epochs: measures of each version.
    """

    start_us: Integers
    rows: Integers
    epochs: tuple[EpochMeasures, ...]


@dataclass
class ActivityMeter:
    """Measures several versions of one recording side by side.

    Args:
        versions: how many; differences are from the last one.
        epoch_s: length of an epoch, whole seconds.

    Attributes:
        epochs: number of epochs with a value; short: number with too few rows.
        rows: number of rows in the epochs with a value.
    """

    versions: int
    epoch_s: int
    rate_hz: float
    epochs: int = 0
    short: int = 0
    rows: int = 0
    _sums: list[_ActivitySums] = field(init=False)

    def __post_init__(self) -> None:
        self._sums = [_ActivitySums() for _ in range(self.versions)]
        self._cut, self._cut_angles = (
            EpochCutter(seconds * MICROSECONDS, max(2, MOST_ROWS * round(seconds * self.rate_hz)))
            for seconds in (self.epoch_s, ANGLE_S)
        )

    def feed(self, time_us: Integers, versions: Sequence[Sequence[NDArray[np.float32]]]) -> list[EpochTable]:
        """Take in measured rows, x, y and z of each version [g], and return the epochs that they complete."""
        axes = [[fixed(axis) for axis in xyz] for xyz in versions]
        for epochs in self._cut_angles.feed(time_us, *(axis for xyz in axes for axis in xyz)):
            self._turn(epochs)
        norms = [lengths(xyz) for xyz in versions]
        return [self._measure(epochs) for epochs in self._cut.feed(time_us, *norms)]

    def finish(self) -> list[EpochTable]:
        """End the recording, and return the epochs that this completes."""
        for epochs in self._cut_angles.finish():
            self._turn(epochs)
        tables = [self._measure(epochs) for epochs in self._cut.finish()]
        for sums in self._sums:
            sums.rest()
        return tables

    def result(self) -> tuple[Activity, ...]:
        """Return the activity of each version, after `finish`."""
        return tuple(self._activity(sums) for sums in self._sums)

    def _measure(self, epochs: WholeEpochs) -> EpochTable:
        valued = epochs.rows >= LEAST_MEASURED * self.epoch_s * self.rate_hz
        measured = [EpochMeasures.of(length, epochs).select(valued) for length in epochs.columns]
        for sums, own in zip(self._sums, measured, strict=True):
            sums.add(own, measured[-1])
        number, rows = epochs.number[valued], epochs.rows[valued]
        self.epochs, self.short = self.epochs + len(number), self.short + int((~valued).sum())
        self.rows += int(rows.sum())
        return EpochTable(number * (self.epoch_s * MICROSECONDS), rows, tuple(measured))

    def _turn(self, epochs: WholeEpochs) -> None:
        valued = np.flatnonzero(epochs.rows >= LEAST_MEASURED * ANGLE_S * self.rate_hz)
        number = epochs.number[valued].tolist()
        axes = [np.add.reduceat(axis, epochs.start)[valued].tolist() for axis in epochs.columns]
        for version, sums in enumerate(self._sums):
            for one, x, y, z in zip(number, *axes[3 * version : 3 * version + 3], strict=True):
                sums.turn(one, degrees(atan2(z, hypot(x, y))))

    def _activity(self, sums: _ActivitySums) -> Activity:
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


def fixed(axis: NDArray[np.float32]) -> Integers:
    """Return an axis in units of 2**-32 g; exact, since the product is by a power of two."""
    return np.rint(axis.astype(np.float64) * ONE_G).astype(np.int64)


def lengths(xyz: Sequence[NDArray[np.float32]]) -> Integers:
    """Return |a| of rows in units of 2**-32 g."""
    x, y, z = (axis.astype(np.float64) for axis in xyz)
    return np.asarray(np.rint(np.sqrt(x * x + y * y + z * z) * ONE_G), np.int64)


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

    def __init__(self, made: list[Version], recording: Recording, epoch_s: int) -> None:
        self.versions = made
        self._meter = ActivityMeter(len(made), epoch_s, recording.rate_hz)
        self._left_out = dict.fromkeys(LEFT_OUT, 0)
        self._rows = 0

    def see(self, chunk: Chunk) -> list[EpochTable]:
        """Take a chunk in, and return the epochs that it completes."""
        if not len(chunk):
            return []
        self._rows += len(chunk)
        xyz, times = [one.transform.apply(chunk) for one in self.versions], chunk.time_us
        if chunk.validity is not None and chunk.validity.any():
            for name, value in LEFT_OUT.items():
                self._left_out[name] += int((chunk.validity == value).sum())
            kept = chunk.validity == Validity.MEASURED
            xyz, times = [[axis[kept] for axis in one] for one in xyz], times[kept]
        return self._meter.feed(times, xyz)

    def watch(self, chunks: Iterable[Chunk]) -> Iterator[Chunk]:
        """Pass chunks on, and take them in."""
        for chunk in chunks:
            self.see(chunk)
            yield chunk

    def finish(self) -> list[EpochTable]:
        """End the recording, and return the epochs that this completes."""
        return self._meter.finish()

    def result(self) -> dict[str, Any]:
        """Return the report's `effect` object, after `finish`."""
        meter = self._meter
        pairs = zip(self.versions, meter.result(), strict=True)
        return {
            "epoch_s": meter.epoch_s,
            "epochs": meter.epochs,
            "short_epochs": meter.short,
            "left_out": dict(self._left_out),
            "left_out_percent": round(100 * sum(self._left_out.values()) / max(1, self._rows), DIGITS),
            "versions": {one.name: {"model": one.model, **_rounded(activity)} for one, activity in pairs},
        }


def _rounded(activity: Activity) -> dict[str, float | None]:
    return {name: None if value is None else round(value, DIGITS) for name, value in asdict(activity).items()}
