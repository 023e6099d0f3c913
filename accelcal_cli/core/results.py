"""Facts that one pass over a recording finds, and the judgement of its calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import fsum
from typing import Annotated, Literal, Protocol

from accelcal_cli.core.arithmetic import ratio_uncertainty95
from accelcal_cli.core.calibration import Calibration, Correction
from accelcal_cli.core.clock import ClockReset
from accelcal_cli.core.declared import Key
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.local_time import ZoneChange
from accelcal_cli.core.points import Fit, Penalty, Quietest, Saturated
from accelcal_cli.core.recording import Problem


class Outcome(StrEnum):
    """The report's `outcome`."""

    CALIBRATED = "calibrated"
    PROVISIONAL = "provisional"
    REDUCED_MODEL = "reduced_model"
    ALREADY_GOOD = "already_good"
    BORROWED = "borrowed"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Mean, median and 95th percentile of | |a| - 1 g | over postures [mg]."""

    mean: Annotated[float, Key("Mean", digits=4, least=0)]
    median: Annotated[float, Key("Median", digits=4, least=0)]
    p95: Annotated[float, Key("95th percentile", digits=4, least=0)]


@dataclass(frozen=True, slots=True)
class Holdout:
    """Errors on data that took no part in the fit.

    Attributes:
        method: how the data were held out.
        ci95: confidence interval of the mean after calibration [mg], Student's t over postures.
        per_posture: (before, after) [mg] of each posture, in the order of the postures.
        blocks: (posture, after [mg]) of each block by which models are compared: a posture, or with
            temperatures a posture within a narrow range of them.
    """

    method: str
    points: int
    postures: int
    before: ErrorSummary
    after: ErrorSummary
    ci95: tuple[float, float]
    per_posture: tuple[tuple[float, float], ...]
    blocks: tuple[tuple[int, float], ...] = ()

    def compared_mg(self) -> float:
        """Return the mean over the blocks after calibration [mg], which the model ladder compares."""
        return fsum(after for _, after in self.blocks) / len(self.blocks)

    def improvement_factor(self) -> float:
        """Return the error before calibration over that after it."""
        return self.before.mean / self.after.mean if self.after.mean else float("inf")

    def improvement_ci95(self) -> tuple[float, float] | None:
        """Return the confidence interval of the factor; None for fewer than two postures."""
        by = ratio_uncertainty95(self.per_posture)
        factor = self.improvement_factor()
        return None if by is None else (factor / by, factor * by)

    def improvement_percent(self) -> float:
        """Return R of F eq. 21: the factor in percent, so that 100 means no change."""
        return 100 * self.before.mean / self.after.mean if self.after.mean else float("inf")


@dataclass(frozen=True, slots=True)
class Coverage:
    """Where the points lie.

    Attributes:
        subsets: points in F's nine subsets (eq. 10), rows n, 0, p and columns x, y, z; a point
            counts on every axis.
        axis_min_g, axis_max_g: extreme raw values of x, y, z.
        cells: number of orientation cells with points (split by temperature where it is used).
        distinct_orientations: number of postures with points.
        condition_number: that of the fit's Jacobian with columns of unit length; None if not fitted.
        worst_direction_mg: standard error of |a| in the least certain of 162 directions.
        saturated: axes that measure nothing beyond a value, in raw g; no point is near it.
        subsets_full_after_h: hours of samples until each of F's nine subsets held two still windows, well
            apart; None if they never did, or if this was not looked for (`watch` and profile `paper` do).
    """

    subsets: tuple[tuple[int, int, int], ...]
    axis_min_g: tuple[float, float, float]
    axis_max_g: tuple[float, float, float]
    cells: int
    distinct_orientations: int
    condition_number: float | None = None
    worst_direction_mg: float | None = None
    saturated: Saturated = ()
    subsets_full_after_h: float | None = None


def sides_not_up(low_g: Sequence[float], high_g: Sequence[float], reach_g: float) -> list[str]:
    """Return directions of axes, such as `-z`, that no point comes near, by the extreme values of x, y, z."""
    return [
        f"{sign}{axis}"
        for axis, low, high in zip("xyz", low_g, high_g, strict=True)
        for sign, there in (("-", low <= -reach_g), ("+", high >= reach_g))
        if not there
    ]


@dataclass(frozen=True, slots=True)
class SphereError:
    """Mean | |a| - 1 g | over all directions, also those where the wrist has not been [mg].

    It is the error of the coefficients, without the scatter of rests.

    Attributes:
        mean: the expected error; ci95: it lies there in 95 of 100 cases.
        worst_direction: the expected error in the direction where it is largest.
        worst_direction_at: that direction, a unit vector of the true acceleration.
        better_everywhere, better_where_worn: probability that the error is lower than that of the raw
            values, over all directions and in the postures that were seen.
        below_limit: probability that it is within the limit.
    """

    mean: float
    ci95: tuple[float, float]
    worst_direction: float
    worst_direction_at: tuple[float, float, float]
    better_everywhere: float = 0.0
    better_where_worn: float = 0.0
    below_limit: float = 0.0

    def probably_better(self) -> float:
        """Return the lower of the two probabilities."""
        return min(self.better_everywhere, self.better_where_worn)


PROBABLE = 0.5
"""Probability of a change of the sensor from which it is said, and rests are not blamed for it."""


def whole_percent(probability: float) -> float:
    """Return a probability in whole percent, none more certain than a thousand draws can tell."""
    return float(min(99, int(100 * probability)))


@dataclass(frozen=True, slots=True)
class Trial:
    """One model of the ladder.

    Attributes:
        holdout: its held-out error, None if it could not be fitted.
        reason: why it was not eligible, None if it was.
        fit: the fit to all points, if there is one.
        prior: name of the prior that it was fitted with, or None.
    """

    model: str
    holdout: Holdout | None
    reason: Reason | None
    fit: Fit | None = None
    prior: str | None = None


ChangeKind = Literal["none", "drift", "step", "gain", "device", "walk"]
"""How a sensor changes: not at all; its offsets in proportion to time; its offsets at once; its scales and
offsets at once; all its parameters at once, as if by another device; its offsets from knot to knot."""


@dataclass(frozen=True, slots=True)
class TimeHoldout:
    """Mean errors [mg] on stretches of time, each judged by a fit of the others.

    Attributes:
        constant_mg: error of a constant sensor.
        changing_mg: error of a changing sensor; None if none is clearly better.
        standard_error_mg: that of their difference.
    """

    stretches: Annotated[int, Key("Number of stretches of time")]
    constant_mg: Annotated[float, Key("Error of a constant sensor", "mg", significant=True)]
    changing_mg: Annotated[float | None, Key("Error of a changing sensor", "mg", significant=True)] = None
    standard_error_mg: Annotated[
        float | None, Key("Standard error of their difference", "mg", significant=True)
    ] = None


@dataclass(frozen=True, slots=True)
class Change:
    """How the sensor changed while it recorded.

    Attributes:
        unchecked: code of why a change could not be looked for, or None.
        at_block: number of the block of time at which a sudden change took place.
        at_us: beginning of that block on the device's clock.
        correction: what corrects the sensor, in standard g; None if one calibration cannot follow.
        size_mg: the largest change of |a|, over all directions.
        offset_mg, scale_percent: change of those of raw x, y, z from beginning to end.
        probability: that the sensor changed, beyond what is followed; None if this was not looked for.
    """

    kind: ChangeKind
    unchecked: str | None = None
    holdout: TimeHoldout | None = None
    at_block: int | None = None
    at_us: int | None = None
    correction: Correction | None = None
    size_mg: float | None = None
    offset_mg: tuple[float, float, float] | None = None
    scale_percent: tuple[float, float, float] | None = None
    probability: float | None = None


MisfitKind = Literal["cubic", "gain by temperature", "curved by temperature", "previous posture"]
"""Behaviour of a sensor that the parameters do not describe: its response is bent, with the cube of the
acceleration; its scales change with temperature; its offsets do so on a curve; its offsets depend
on the posture before."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """A behaviour that the parameters do not describe, and how much of it the points show.

    Attributes:
        size, standard_errors: those of x, y, z, in `unit`.
        before_mg, after_mg: mean error on held-out postures without it and with it.
        largest_mg: its largest effect on |a|.
        found: True if the error falls so clearly that it is believed.
    """

    kind: Annotated[MisfitKind, Key("Kind of behaviour")]
    unit: Annotated[str, Key("Unit of its size")]
    size: Annotated[tuple[float, float, float], Key("Size on x, y and z", significant=True)]
    standard_errors: Annotated[
        tuple[float, float, float], Key("Standard errors of the sizes", significant=True)
    ]
    before_mg: Annotated[float, Key("Held-out error without it", "mg", digits=4)]
    after_mg: Annotated[float, Key("Held-out error with it", "mg", digits=4)]
    largest_mg: Annotated[float, Key("Largest error that it makes at 1 g", "mg", significant=True)]
    found: Annotated[bool, Key("True if it was found")]


UncertaintySource = Literal["rests", "bend", "change", "gravity"]
"""Where the uncertainty of |a| at rest comes from: few rests that scatter, with what is known of sensors
beforehand; a bend of the response; a change during the recording; the gravity of an unknown place."""


@dataclass(frozen=True, slots=True)
class UncertaintyPart:
    """A part of the standard uncertainty of |a| at rest (GUM, JCGM 100:2008, 5.1): their squares add up.

    Attributes:
        mg: root of the mean square over all directions; axes_mg: with x, y or z up or down.
        worst_mg: in the direction where all parts together are largest.
    """

    source: Annotated[UncertaintySource, Key("Where it comes from")]
    mg: Annotated[float, Key("Standard uncertainty, over all orientations", "mg", significant=True)]
    axes_mg: Annotated[
        tuple[float, float, float], Key("The same with x, y or z up or down", "mg", significant=True)
    ]
    worst_mg: Annotated[float, Key("The same where all parts together are largest", "mg", significant=True)]
    share_percent: Annotated[float, Key("Share of the variance over all orientations", digits=1)]


@dataclass(frozen=True, slots=True)
class FitErrors:
    """Errors on the points that were fitted; not the number to quote."""

    points: int
    postures: int
    before_mg: float
    after_mg: float


@dataclass(frozen=True, slots=True)
class WithoutMisalignment:
    """The same points fitted without misalignment, for tools whose formula has none.

    Cutting a calibration down to the diagonal of its K is not a substitute: scales and offsets have to make
    up for what is left out.

    Attributes:
        calibration: of model 6, or 6T if slopes were fitted.
        holdout: its error on the data on which the calibration itself was held out; None if they are too few.
        sphere: its error over all directions; None if unknown.
    """

    calibration: Calibration
    holdout: Holdout | None
    sphere: SphereError | None = None


class PlausibleSensors(Protocol):
    """The sensors that the points of a recording allow."""

    def draws(self, number: int, seed: int) -> list[Calibration]:
        """Return calibrations drawn from the posterior; the first of many are those of few.

        Args:
            seed: from 0 to 2**32 - 1; equal ones give equal draws.
        """


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict on a recording, with all that supports it; calibration is None if refused.

    Attributes:
        reason: why the outcome is what it is.
        notes: what else is to be known of it; cautions: what speaks against trusting it; advice: what to do.
        candidate: the fit with a prior, also if it is not good enough to be the calibration.
        covariance: that of the parameters, in standard g and per degree, then of the bend; None without one.
        penalty: the prior as the fit used it; None without one.
        sphere: error of the calibration over all directions; sphere_before: that of the raw values.
        rest_scatter_mg: mean | |a| - 1 g | that the scatter of rests makes; None without a posterior.
        change: how the sensor changed during the recording; None if this was not looked for.
        misfits: kinds of behaviour that were tested; None if none were.
        changed: probability that the sensor changed during the recording, beyond what is followed, and the
            share of the time after which it most probably did; None without a posterior.
        uncertainty: parts of that of |a| at rest; None without a posterior.
        unlike: True if the points speak against a prior that was learnt from other recordings.
        without_misalignment: for a calibration with misalignment; None if that cannot be fitted.
        plausible: sensors by the posterior; None without one.
    """

    outcome: Outcome
    reason: Reason
    coverage: Coverage
    trials: tuple[Trial, ...]
    calibration: Calibration | None = None
    notes: tuple[Reason, ...] = ()
    cautions: tuple[Reason, ...] = ()
    advice: tuple[Reason, ...] = ()
    fit: Fit | None = None
    holdout: Holdout | None = None
    fit_errors: FitErrors | None = None
    standard_errors: tuple[float, ...] | None = None
    covariance: tuple[tuple[float, ...], ...] | None = None
    candidate: Calibration | None = None
    penalty: Penalty | None = None
    sphere: SphereError | None = None
    sphere_before: SphereError | None = None
    rest_scatter_mg: float | None = None
    change: Change | None = None
    misfits: tuple[Misfit, ...] | None = None
    changed: tuple[float, float] | None = None
    uncertainty: tuple[UncertaintyPart, ...] | None = None
    unlike: bool = False
    without_misalignment: WithoutMisalignment | None = None
    plausible: PlausibleSensors | None = field(default=None, compare=False)

    def probably_changed(self) -> bool:
        """Return True if the sensor probably changed, beyond what is followed."""
        return self.changed is not None and self.changed[0] >= PROBABLE

    def draws(self, number: int, sha256: str) -> list[Calibration]:
        """Return plausible calibrations instead of this one, with its correction; none without a posterior.

        Args:
            sha256: of the recording, which seeds the draws: those of two recordings are independent.
        """
        if self.calibration is None or self.plausible is None:
            return []
        drawn = self.plausible.draws(number, int(sha256[:8], 16))
        return [replace(one, correction=self.calibration.correction) for one in drawn]


@dataclass(frozen=True, slots=True)
class Gap:
    """Time that is missing between two consecutive rows.

    Attributes:
        sample: number of the first sample after the gap.
        start_us: time of the last sample before it.
        seconds: time from that sample to the next.
    """

    sample: int
    start_us: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Jumps:
    """Jumps of the times from row to row.

    Attributes:
        gaps, gap_us: number of gaps, and the time that is missing in all [us]; no reset of a clock is one.
        back: number of stamps that repeat the one before or go back.
    """

    gaps: int = 0
    gap_us: int = 0
    back: int = 0


@dataclass(frozen=True, slots=True)
class TimeRows:
    """A recording along time: one number for each of its blocks, in the order of time.

    Attributes:
        block_samples: samples of a block; the last one may have fewer.
        samples: number of samples.
        still: number of still windows that begin there, near 1 g or not.
        moving: number of windows that the other measured samples make.
        filled, clipped, recovered: samples of the device's idle sleep, at the sensor's range, and from
            damaged blocks.
        lost_bytes: bytes of the (uncompressed) file that damage took there, or that are missing.
        gap_us: time that is missing before its samples.
        temperature_mc: mean [thousandths of a degree C]; None without thermometer.
        worn: True if the device was worn, None if too little was measured to tell.
    """

    block_samples: int
    samples: tuple[int, ...]
    still: tuple[int, ...]
    moving: tuple[int, ...]
    filled: tuple[int, ...]
    clipped: tuple[int, ...]
    recovered: tuple[int, ...]
    lost_bytes: tuple[int, ...]
    gap_us: tuple[int, ...]
    temperature_mc: tuple[float | None, ...]
    worn: tuple[bool | None, ...]

    def __len__(self) -> int:
        return len(self.samples)


@dataclass(frozen=True, slots=True)
class SampleCounts:
    """Numbers of special samples, under their names in the report's `file_health`.

    Attributes:
        filled_samples: those of idle sleep, when the device measured nothing.
        clipped_samples_before: those at the sensor's range as measured, before calibration.
    """

    filled_samples: int = 0
    clipped_samples_before: int = 0


NEAR_ONE_G = (0.7, 1.4)
"""Bounds of the median of |a| at rest [g] for any sensor whose unit and counts per g are right."""


@dataclass(frozen=True, slots=True)
class Rest:
    """Figures of still windows before calibration, near 1 g or not, in units of local gravity.

    Attributes:
        windows: their number; without any, only the last attribute has a meaning.
        median_g, p5_g, p95_g: percentiles of |a|, to half a percent.
        axis_min_g, axis_max_g: extreme means of x, y, z.
        alike: axes whose values are the same in all windows, such as ("x", "y").
        error_mg: mean | |a| - 1 g | of the windows of 0.5 to 1.5 g; None without any.
        samples_median_g: median of |a| over every 997th sample that was measured; None without any.
    """

    windows: int = 0
    median_g: float = 0.0
    p5_g: float = 0.0
    p95_g: float = 0.0
    axis_min_g: tuple[float, ...] = ()
    axis_max_g: tuple[float, ...] = ()
    alike: tuple[str, ...] = ()
    error_mg: float | None = None
    samples_median_g: float | None = None


@dataclass(frozen=True, slots=True)
class Facts:
    """A recording as it was found.

    Attributes:
        first_us, last_us: times of the first and last sample; None without samples.
        rate_hz: measured rate, samples over time within unbroken stretches; None if unknown.
        gaps_omitted: number of gaps beyond those that are listed.
        rest: what its still windows measure.
        utc_offset_s: seconds that the device's clock is ahead of UTC; None if its zone or the time of the
            start is unknown.
        damaged_bytes, missing_bytes, used_bytes: bytes of the (uncompressed) file that damage took, those
            that are known to be missing from it, and those that the samples were made of.
        empty_rows: rows of a table without values, which are missing time.
        cut_short: the file breaks off, whether or not it is known how much is missing.
        span_us: time from the first sample to the last [us], the sum of the stretches of its clock.
        resets: jumps at which its clock was reset.
        zone_change: change of the zone's offset from UTC during the recording; None if there is none, or
            unknown.
        gone_over: number of short jumps of its times that did not end a window.
        windows: number of complete windows, still or not.
        quietest: the window that moves least; None if none was measured.
    """

    samples: int
    first_us: int | None
    last_us: int | None
    rate_hz: float | None
    gaps: tuple[Gap, ...]
    gaps_omitted: int
    problems: tuple[Problem, ...]
    counts: SampleCounts
    has_temperature: bool
    has_gyroscope: bool
    rest: Rest = Rest()
    utc_offset_s: int | None = None
    damaged_bytes: int = 0
    missing_bytes: int = 0
    used_bytes: int = 0
    empty_rows: int = 0
    cut_short: bool = False
    jumps: Jumps = Jumps()
    span_us: int = 0
    resets: tuple[ClockReset, ...] = ()
    zone_change: ZoneChange | None = None
    gone_over: int = 0
    windows: int = 0
    quietest: Quietest | None = None

    @property
    def lost_bytes(self) -> int:
        """Bytes that are damaged or missing."""
        return self.damaged_bytes + self.missing_bytes

    @property
    def missing_if_known(self) -> int | None:
        """Bytes that are known to be missing; None for a file that breaks off by an unknown amount."""
        return None if self.cut_short and not self.missing_bytes else self.missing_bytes

    def lost_percent(self) -> float:
        """Return the share of the recording's bytes that is damaged or known to be missing [%]."""
        return _percent(self.lost_bytes, self.used_bytes)

    def damaged_percent(self) -> float:
        """Return the share of the bytes in the file that damage took [%]."""
        return _percent(self.damaged_bytes, self.used_bytes)


def _percent(part: int, rest: int) -> float:
    return 100 * part / max(1, part + rest)
