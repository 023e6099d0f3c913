"""What a gyroscope did between two rests, and at rest, as it is collected; and what is judged of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.recording import Counts

EQUATION = "w = S (r - b - c (T - Tref))"
"""Angular rate [deg/s] of raw r; S and b as G 4.3 has them."""

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """The end of a rest, or its beginning: some seconds of it.

    Attributes:
        sample: number of the first sample within the recording.
        samples: how many there are.
        sums, gyro_sums: of their raw counts, (3,).
        temperature_sum: of thousandths of a degree C, None without temperature.
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
        before, after: what was measured at rest just before and after.
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
        samples: (b,) how many samples were at rest.
        gyro_sums: (b, 3) sums of their counts.
        temperature_sums: (b,) of thousandths of a degree C, or None.
    """

    samples: NDArray[np.int64]
    gyro_sums: NDArray[np.int64]
    temperature_sums: NDArray[np.int64] | None

    def __len__(self) -> int:
        return len(self.samples)


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """All that a recording says of its gyroscope.

    Attributes:
        turns: in the order of time.
        left_out: how many more there were than are kept.
        dps_per_lsb: deg/s in one count of each axis; lsb_per_g: counts of the accelerometer in 1 g.
        period_s: from one sample to the next, nominal [s].
    """

    turns: tuple[Turn, ...]
    rates: RestRates
    left_out: int
    dps_per_lsb: Triple
    lsb_per_g: float
    period_s: float


@dataclass(frozen=True, slots=True)
class TurnHoldout:
    """Angle between gravity as turned by the gyroscope and as measured, on pairs that took no part [deg].

    Attributes:
        before, after: median of the raw angular rate, and of the calibrated one; both less the mean rate of
            the two rests.
        ci95: of the median after calibration.
        mean_before, mean_after: means; rms_before, rms_after: root mean squares, in which a jolt counts most.
    """

    before: float
    after: float
    ci95: tuple[float, float]
    mean_before: float
    mean_after: float
    rms_before: float
    rms_after: float


@dataclass(frozen=True, slots=True)
class Bias:
    """What the gyroscope says at rest.

    Attributes:
        dps: b [deg/s], at `reference_c` where there is a slope.
        standard_errors: of b [deg/s]; None where one block of time cannot tell.
        slope_dps_per_c: c [deg/s per degree C], zero where it does not pay.
        reference_c: Tref; None without a slope.
        rest_s: how long it rested.
        raw_dps, constant_dps, slope_dps: mean error over blocks of time that took no part, of the raw
            rate, with a constant bias, and with a slope (None: not tried) [deg/s].
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
        message: one sentence: what was found, or why nothing was.
        scale: S, None if refused.
        standard_errors: of the entries of S.
        pairs: pairs of rests that were used; left_out: more than are kept in memory.
        bias: None if it never rested.
    """

    outcome: Literal["calibrated", "refused"]
    message: str
    pairs: int
    left_out: int = 0
    scale: tuple[Triple, Triple, Triple] | None = None
    standard_errors: tuple[Triple, Triple, Triple] | None = None
    holdout: TurnHoldout | None = None
    bias: Bias | None = None

    def calibrated(self, rates: list[Floats], celsius: Floats | None) -> list[Floats]:
        """Calibrated angular rate of raw x, y, z [deg/s], each (n,), elementwise.

        Args:
            celsius: (n,) temperatures, None where there are none: then the slope has no effect.
        """
        assert self.scale is not None and self.bias is not None
        bias, right = self.bias, []
        for axis, rate in enumerate(rates):
            shifted = rate - bias.dps[axis]
            if bias.reference_c is not None and celsius is not None:
                shifted -= bias.slope_dps_per_c[axis] * (celsius - bias.reference_c)
            right.append(shifted)
        return [row[0] * right[0] + row[1] * right[1] + row[2] * right[2] for row in self.scale]
