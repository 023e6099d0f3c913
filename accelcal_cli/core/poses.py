"""Known orientations: what flows from the finding of poses to the report.

Bragge et al. write z = K a + O for what a sensor shows of an acceleration a. In this house that K is
the inverse of the gain and that O the negative offset; both are in the report.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.judgement import ErrorSummary
from accelcal_cli.core.points import Calibration
from accelcal_cli.core.windows import Windows

FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""The six faces, each named by the axis that shows about +1 g or -1 g on it."""

Integers3 = tuple[int, int, int]
Floats3 = tuple[float, float, float]
Matrix3 = tuple[Floats3, Floats3, Floats3]


@dataclass(frozen=True, slots=True, eq=False)
class TimedWindows:
    """m still windows in the order of time, with their times on the device's clock.

    Attributes:
        start_us, end_us: (m,) int64, time of the first sample, and one period after the last [us].
    """

    windows: Windows
    start_us: NDArray[np.int64]
    end_us: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.windows)

    def select(self, which: NDArray[np.bool_]) -> TimedWindows:
        """The windows of a mask."""
        return TimedWindows(self.windows.select(which), self.start_us[which], self.end_us[which])


@dataclass(frozen=True, slots=True)
class State:
    """A still stretch.

    Attributes:
        start_us, end_us: on the device's clock [us].
        windows: number of still windows that were averaged.
        raw: mean of the raw values, fixed-point g.
    """

    start_us: int
    end_us: int
    windows: int
    raw: Integers3


@dataclass(frozen=True, slots=True)
class Pose:
    """A state whose true acceleration is known.

    Attributes:
        face: one of FACES, or `listed` for another direction.
        number: states of one orientation have the same number; it is held out as a whole.
        reference: the true acceleration, fixed-point standard g.
    """

    face: str
    number: int
    state: State
    reference: Integers3


@dataclass(frozen=True, slots=True)
class Session:
    """What the stillness of a recording holds.

    Attributes:
        between: still states that lie on no face; they are not fitted.
        short: still states that are too short to count.
        first_us: time of the recording's first sample on the device's clock.
    """

    first_us: int
    poses: tuple[Pose, ...]
    between: tuple[State, ...] = ()
    short: int = 0

    @property
    def missing(self) -> tuple[str, ...]:
        """Faces without a state; none are missed where other orientations are listed."""
        seen = {pose.face for pose in self.poses}
        return () if seen - set(FACES) else tuple(face for face in FACES if face not in seen)

    @property
    def orientations(self) -> int:
        """How many different orientations there are."""
        return len({pose.number for pose in self.poses})


@dataclass(frozen=True, slots=True)
class PoseError:
    """Errors of one state [mg]; those held out are None where the others do not determine a fit.

    Attributes:
        raw, raw_norm: |v - reference| and | |v| - |reference| | of the raw mean v.
        residual, norm: the same of the calibrated mean, by the fit of all states.
        held_out, held_out_norm: the same by a fit of the other orientations.
        tilt_degrees: angle between the held-out estimate and the reference.
        repeat: distance from the mean of all states of this orientation; None for a single one.
    """

    raw: float
    raw_norm: float
    residual: float
    norm: float
    held_out: float | None
    held_out_norm: float | None
    tilt_degrees: float | None
    repeat: float | None


@dataclass(frozen=True, slots=True)
class KnownFit:
    """Twelve parameters from known orientations, and how well they are known.

    Attributes:
        k, o: z = K a + O, in raw g per g and raw g.
        k_errors, o_errors: their standard errors.
        standard_errors: of kxx .. oz, three slopes (0) and kyx, kzx, kzy.
        condition_number: of the matrix [a 1], a in g.
        worst_direction_mg: largest standard error of |a| over 26 directions.
        errors: one for each pose.
        between_norm_mg: mean | |a| - local g | of the states between faces, None without any.
    """

    calibration: Calibration
    k: Matrix3
    o: Floats3
    k_errors: Matrix3
    o_errors: Floats3
    standard_errors: tuple[float, ...]
    condition_number: float
    worst_direction_mg: float
    errors: tuple[PoseError, ...]
    between_norm_mg: float | None


@dataclass(frozen=True, slots=True)
class VectorErrors:
    """|a - reference| of orientations held out [mg], and the largest spread of repeated ones."""

    before: ErrorSummary
    after: ErrorSummary
    repeat_spread: float | None
