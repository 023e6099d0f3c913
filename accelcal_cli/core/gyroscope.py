"""Records of a gyroscope: its turns and rests as they are collected, and the verdict on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.declared import Key
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.recording import Counts

EQUATION = "w = S (r - b - c (T - Tref))"
"""Calibrated angular rate [deg/s] of a raw rate r; S and b as in G 4.3."""

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """Some seconds at the beginning or end of a rest.

    Attributes:
        sample: number of the first sample within the recording.
        samples: number of samples.
        sums, gyro_sums: sums of the raw counts of both sensors, (3,).
        temperature_sum: sum of thousandths of a degree C, None without temperature.
    """

    sample: int
    samples: int
    sums: tuple[int, ...]
    gyro_sums: tuple[int, ...]
    temperature_sum: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """A movement from one rest to the next.

    Attributes:
        before, after: the rests just before and after.
        counts: (n, 3) raw counts of the gyroscope in between.
        period_us: mean time from one sample to the next [us].
    """

    before: Rest
    after: Rest
    counts: Counts
    period_us: float

    def __len__(self) -> int:
        return len(self.counts)


@dataclass(frozen=True, slots=True, eq=False)
class RestRates:
    """b blocks of time in which the gyroscope rested.

    Attributes:
        samples: (b,) number of samples at rest.
        gyro_sums: (b, 3) sums of their counts.
        temperature_sums: (b,) sums of thousandths of a degree C, or None.
    """

    samples: NDArray[np.int64]
    gyro_sums: NDArray[np.int64]
    temperature_sums: NDArray[np.int64] | None

    def __len__(self) -> int:
        return len(self.samples)


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """Turns and rests of a recording.

    Attributes:
        turns: those that were kept, in the order of time.
        left_out: number of turns that were not kept.
        dps_per_lsb: deg/s in one count of each axis; lsb_per_g: counts of the accelerometer in 1 g.
        period_s: nominal time from one sample to the next [s].
    """

    turns: tuple[Turn, ...]
    rates: RestRates
    left_out: int
    dps_per_lsb: Triple
    lsb_per_g: float
    period_s: float


@dataclass(frozen=True, slots=True)
class TurnHoldout:
    """Angle between gravity as turned by the gyroscope and as measured, on held-out pairs of rests [deg].

    Attributes:
        before, after: medians by the raw angular rate and by the calibrated one, both less the mean rate of
            the two rests.
        ci95: confidence interval of the median after calibration.
        mean_before, mean_after: means; rms_before, rms_after: root mean squares, in which a jolt counts most.
    """

    before: Annotated[float, Key("Median before calibration", significant=True, least=0)]
    after: Annotated[float, Key("Median after calibration", significant=True, least=0)]
    ci95: Annotated[tuple[float, float], Key("95 % interval of the latter", significant=True, least=0)]
    mean_before: Annotated[float, Key("Mean before", significant=True, least=0)]
    mean_after: Annotated[float, Key("Mean after", significant=True, least=0)]
    rms_before: Annotated[float, Key("Root mean square before", significant=True, least=0)]
    rms_after: Annotated[float, Key("Root mean square after", significant=True, least=0)]


@dataclass(frozen=True, slots=True)
class Bias:
    """The gyroscope's rate at rest.

    Attributes:
        dps: b [deg/s], at `reference_c` if there is a slope.
        standard_errors: those of b [deg/s]; None for a single block of time.
        slope_dps_per_c: c [deg/s per degree C], zero if it does not reduce the error.
        reference_c: Tref; None without a slope.
        rest_s: time at rest [s].
        raw_dps, constant_dps, slope_dps: mean error over held-out blocks of time of the raw rate, with a
            constant bias, and with a slope (None: not tried) [deg/s].
    """

    dps: Triple
    standard_errors: Triple | None
    slope_dps_per_c: Triple
    reference_c: float | None
    rest_s: float
    raw_dps: float
    constant_dps: float | None
    slope_dps: float | None


@dataclass(frozen=True, slots=True)
class Gyroscope:
    """The verdict on a gyroscope: w = S (r - b - c (T - Tref)).

    Attributes:
        reason: why there is a result, or none.
        scale: S, None if refused.
        standard_errors: those of the entries of S.
        pairs: number of pairs of rests that were used; left_out: number of those that were not kept.
        bias: None if it never rested.
    """

    outcome: Literal["calibrated", "refused"]
    reason: Reason
    pairs: int
    left_out: int = 0
    scale: tuple[Triple, Triple, Triple] | None = None
    standard_errors: tuple[Triple, Triple, Triple] | None = None
    holdout: TurnHoldout | None = None
    bias: Bias | None = None

    def calibrated(self, rates: list[Floats], celsius: Floats | None) -> list[Floats]:
        """Return the calibrated angular rates of raw x, y, z [deg/s], each (n,), elementwise.

        Args:
            celsius: (n,) temperatures; None: the slope has no effect.
        """
        assert self.scale is not None and self.bias is not None
        bias, right = self.bias, []
        for axis, rate in enumerate(rates):
            shifted = rate - bias.dps[axis]
            if bias.reference_c is not None and celsius is not None:
                shifted -= bias.slope_dps_per_c[axis] * (celsius - bias.reference_c)
            right.append(shifted)
        return [row[0] * right[0] + row[1] * right[1] + row[2] * right[2] for row in self.scale]
