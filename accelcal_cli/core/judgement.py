"""What the judge says of a calibration: errors in mg, coverage, verdict."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import fsum

from accelcal_cli.core.points import Calibration, Fit


class Outcome(StrEnum):
    """The report's `outcome`."""

    CALIBRATED = "calibrated"
    REDUCED_MODEL = "reduced_model"
    ALREADY_GOOD = "already_good"
    BORROWED = "borrowed"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """mean | |a| - 1 g | over postures, their median and 95th percentile [mg]."""

    mean: float
    median: float
    p95: float


@dataclass(frozen=True, slots=True)
class Holdout:
    """Error on data that took no part in the fit.

    Attributes:
        method: how it was held out.
        ci95: confidence interval of the mean after calibration [mg], Student's t over postures.
        per_posture: (before, after) [mg] of each posture, in the order of the postures.
        blocks: (posture, after [mg]) of each block by which models are compared: a posture, or
            where there is temperature a posture within a narrow range of it.
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
        """Mean over the blocks after calibration: what the model ladder compares [mg]."""
        return fsum(after for _, after in self.blocks) / len(self.blocks)

    def improvement_percent(self) -> float:
        """R of F eq. 21: error before over error after, in percent."""
        return 100 * self.before.mean / self.after.mean if self.after.mean else float("inf")


@dataclass(frozen=True, slots=True)
class Coverage:
    """Where the points lie.

    Attributes:
        subsets: points in F's nine subsets (eq. 10), rows n, 0, p and columns x, y, z; a point
            counts on every axis.
        axis_min_g, axis_max_g: extreme raw values of x, y, z.
        cells: number of orientation cells with points (split by temperature where it is used).
        condition_number: of the fit's Jacobian with columns of unit length; None if not fitted.
        worst_direction_mg: standard error of |a| in the least certain of 162 directions.
    """

    subsets: tuple[tuple[int, int, int], ...]
    axis_min_g: tuple[float, float, float]
    axis_max_g: tuple[float, float, float]
    cells: int
    condition_number: float | None = None
    worst_direction_mg: float | None = None


@dataclass(frozen=True, slots=True)
class Trial:
    """One model of the ladder.

    Attributes:
        holdout: its held-out error, None where it could not be fitted.
        reason: why it was not eligible, None where it was.
    """

    model: str
    holdout: Holdout | None
    reason: str | None


@dataclass(frozen=True, slots=True)
class FitErrors:
    """Errors on the very points that were fitted; not the number to quote."""

    points: int
    postures: int
    before_mg: float
    after_mg: float


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict on a recording, with all that supports it; calibration is None if refused."""

    outcome: Outcome
    message: str
    coverage: Coverage
    trials: tuple[Trial, ...]
    calibration: Calibration | None = None
    fit: Fit | None = None
    holdout: Holdout | None = None
    fit_errors: FitErrors | None = None
    standard_errors: tuple[float, ...] | None = None
