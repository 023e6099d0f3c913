"""What flows from the segmenter to the judge: still windows as integer sums, calibration points, fits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.calibration import Correction, TemperatureScale
from accelcal_cli.core.fixed import ONE, Fixed
from accelcal_cli.core.recording import cut_columns, joined_columns

PARAMETER_NAMES = ("k_xx", "k_yy", "k_zz", "k_yx", "k_zx", "k_zy", "ox", "oy", "oz", "sx", "sy", "sz")
"""K (lower triangular), offsets [g], temperature slopes of the offsets [g per degree C].

k_RC is the entry of K in row R, column C: what multiplies C in the equation of R. F writes kxy for k_yx,
kxz for k_zx, kyz for k_zy, and so did reports of schema version 1.
"""

FIRST_NAMES = {f"k{column}{row}": f"k_{row}{column}" for row in "xyz" for column in "xyz"}
"""Names of the entries of K now, by F's, which reports of schema version 1 have."""

UPPER_NAMES = ("k_xy", "k_xz", "k_yz")
"""Entries of K above its diagonal: only known orientations determine them."""

WEIGHT_ONE = 1 << 15
IDENTITY: tuple[int, ...] = (ONE, ONE, ONE) + (0,) * 9

_SCALE = (0, 1, 2)
_MISALIGNMENT = (3, 4, 5)
_OFFSET = (6, 7, 8)
_SLOPE = (9, 10, 11)

Arithmetic = Literal["integer", "float"]
"""Kind of number that an optimizer computes with."""


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """m still windows, in the order of time.

    Attributes:
        samples: (m,) int64, number of samples in each.
        first_sample: (m,) number of each window's first sample in the recording.
        sums: (m, 3) int64, sums of the raw counts.
        spread: (m, 3) int64, max - min of the raw counts.
        temperature_sums: (m,) int64, sums of thousandths of a degree C, or None.
        start_us, end_us: (m,) int64, time of the first sample, and one period after the last, on the
            device's clock [us]; None if the segmenter was not asked for times.
    """

    samples: NDArray[np.int64]
    first_sample: NDArray[np.int64]
    sums: NDArray[np.int64]
    spread: NDArray[np.int64]
    temperature_sums: NDArray[np.int64] | None = None
    start_us: NDArray[np.int64] | None = None
    end_us: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.first_sample)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64] | slice) -> Windows:
        """The windows of a mask, of these numbers, or of a slice."""
        return Windows(**cut_columns(self, self.__dataclass_fields__, which))


_EMPTY, _NO_ROWS = np.empty(0, np.int64), np.empty((0, 3), np.int64)
NO_WINDOWS = Windows(_EMPTY, _EMPTY, _NO_ROWS, _NO_ROWS, _EMPTY, _EMPTY, _EMPTY)


def joined_windows(parts: Sequence[Windows]) -> Windows:
    """Windows one after another; an optional column that some of them lack is left out."""
    return Windows(**joined_columns((NO_WINDOWS, *parts), NO_WINDOWS.__dataclass_fields__))


@dataclass(frozen=True, slots=True, eq=False)
class TimedMeans:
    """n observations along a recording: the mean of the still windows of one orientation in a block of time.

    Attributes:
        block: (n,) number of the block that each is in, from 0; they ascend.
        mean_g: (n, 3) raw mean [standard g].
        celsius: (n,) mean temperature [degrees C], or None.
        block_samples: samples in a row that make a block; block_h: the hours that they take.
        windows: (n,) how many still windows are behind each, where that matters.
    """

    block: NDArray[np.int64]
    mean_g: NDArray[np.float64]
    celsius: NDArray[np.float64] | None
    block_samples: int
    block_h: float
    windows: NDArray[np.int64] | None = None

    def blocks(self) -> int:
        """Number of blocks, up to the last one with stillness."""
        return int(self.block.max(initial=-1)) + 1

    def hours(self) -> float:
        """Length of all blocks."""
        return self.blocks() * self.block_h

    def corrected(self, correction: Correction) -> TimedMeans:
        """Return these with a correction applied, as in the middle of each block."""
        middle = self.block * self.block_samples + self.block_samples // 2
        return replace(self, mean_g=correction.applied(self.mean_g, middle))


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """How many windows there were and why some were not used; sums over chunks by +.

    complete = moving + filled + clipped + recovered + joined + repeated + still, where a still window made of
    several counts once as still, and its others as joined to it; repeated is one of a stretch that the
    recording holds twice.
    """

    complete: int = 0
    moving: int = 0
    filled: int = 0
    clipped: int = 0
    recovered: int = 0
    still: int = 0
    joined: int = 0
    repeated: int = 0

    def __add__(self, other: WindowCounts) -> WindowCounts:
        return WindowCounts(
            *(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__)
        )


@dataclass(frozen=True, slots=True)
class Quietest:
    """The window of a recording that moves least, in counts.

    Attributes:
        spread: max - min on the axis where it is largest; deviation: the same of the standard deviation.
    """

    spread: int
    deviation: float


class Role(IntEnum):
    """What became of a still window.

    It is part of a point that is fitted, or that F's second set holds; no set of F's had use for it; it is
    not near 1 g; it never changed; its temperature cannot be; an axis is near where it saturates.
    """

    FIT = 0
    CONTROL = 1
    NOT_TAKEN = 2
    IMPLAUSIBLE = 3
    CONSTANT = 4
    TEMPERATURE = 5
    SATURATED = 6


Saturated = tuple[tuple[int, float], ...]
"""Axes (0, 1, 2) that measure nothing beyond a value in raw g; its sign tells the side."""


@dataclass(frozen=True, slots=True, eq=False)
class Fates:
    """What became of m still windows.

    Attributes:
        role: (m,) each one's `Role`.
        point: (m,) number of the calibration point that it is part of, -1 for none.
    """

    role: NDArray[np.int64]
    point: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Model:
    """Which of the twelve parameters are free; the others keep their ideal value."""

    name: str
    free: tuple[int, ...]

    @property
    def has_temperature(self) -> bool:
        """Whether the offsets may depend on temperature."""
        return any(index >= 9 for index in self.free)


MODELS: dict[str, Model] = {
    name: Model(name, tuple(sorted(free)))
    for name, free in {
        "0": (),
        "3": _OFFSET,
        "6": _SCALE + _OFFSET,
        "9": _SCALE + _MISALIGNMENT + _OFFSET,
        "3T": _OFFSET + _SLOPE,
        "6T": _SCALE + _OFFSET + _SLOPE,
        "9T": _SCALE + _MISALIGNMENT + _OFFSET + _SLOPE,
    }.items()
}
"""The model ladder: identity, offset, scale + offset, full; T adds a slope per axis."""


@dataclass(frozen=True, slots=True, eq=False)
class PointSet:
    """Means of still windows, n of them, as integers.

    Attributes:
        xyz: (n, 3) fixed-point g, raw (not calibrated).
        weights: (n,) integers, WEIGHT_ONE is one whole point.
        windows: (n,) number of still windows behind each point.
        tau: (n,) scaled temperatures in fixed point, or None.
        temperature: how tau was scaled, None without temperatures.
        previous: (n, 3) fixed-point g, mean of what was measured in the postures before, or None.
    """

    xyz: Fixed
    weights: NDArray[np.int64]
    windows: NDArray[np.int64]
    tau: Fixed | None = None
    temperature: TemperatureScale | None = None
    previous: Fixed | None = None

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, which: NDArray[Any]) -> PointSet:
        """The points of a mask or an index array."""
        tau, previous = (None if part is None else part[which] for part in (self.tau, self.previous))
        return PointSet(
            self.xyz[which], self.weights[which], self.windows[which], tau, self.temperature, previous
        )

    def xyz_g(self) -> NDArray[np.float64]:
        """Raw positions in g, (n, 3) float64, exact."""
        return self.xyz / float(ONE)


@dataclass(frozen=True, slots=True)
class Operations:
    """Scalar additions and multiplications, as F counts them (its 32-bit operations)."""

    additions: int = 0
    multiplications: int = 0


@dataclass(frozen=True, slots=True)
class Fit:
    """What an optimizer found.

    Attributes:
        parameters: twelve fixed-point integers, in the order of PARAMETER_NAMES; the slopes are
            per `TemperatureScale.span_c` degrees.
        stop: why it stopped.
        history: parameters after each iteration, where asked for; with a penalty always, and those at the
            start before them.
    """

    parameters: tuple[int, ...]
    iterations: int
    stop: str
    operations: Operations
    history: tuple[tuple[int, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class Penalty:
    """What is added to the weighted sum of (|a|^2 - 1)^2: sum over j of strength_j (p_j - centre_j)^2.

    Attributes:
        centre: twelve fixed-point parameters.
        strength: twelve integers in units of 2**-PENALTY_BITS of a weight of 1.
    """

    centre: tuple[int, ...]
    strength: tuple[int, ...]


PENALTY_BITS = 40


@dataclass(frozen=True, slots=True)
class PenalizedFit:
    """The minimum of the objective with a penalty, and what lies around it.

    Attributes:
        mean_square: weighted mean of (|a|^2 - 1)^2 there.
        curvature: weighted mean of J^T J, where J is d(|a|^2 - 1)/dp of the model's free parameters.
    """

    model: Model
    fit: Fit
    mean_square: float
    curvature: tuple[tuple[float, ...], ...]


PenalizedFitter = Callable[[PointSet, Model, Penalty, tuple[int, ...]], PenalizedFit]


@dataclass(frozen=True, slots=True)
class Optimizer:
    """One optimizer, bound as OPTIMIZER in each file of `optimize/`.

    Attributes:
        name: as in `--optimizer`.
        fit: (points, model, settings) -> Fit; `settings` are the optimizer's own numbers.
        fit_each: the same of several sets of points at a time, all with temperatures or none, with the
            same results as one by one; None if it would not be faster.
        fit_penalized: (points, model, penalty, start) -> PenalizedFit; None if it fits without a prior only.
        settings: profile name -> those numbers.
        models: names of the models it can fit.
        arithmetic: what its operations cost on a microcontroller depends on it.
        needs: a package that it imports beyond those that are always installed.
    """

    name: str
    title: str
    fit: Callable[[PointSet, Model, Any], Fit]
    settings: dict[str, Any]
    models: tuple[str, ...] = tuple(MODELS)
    arithmetic: Arithmetic = "float"
    needs: str | None = None
    fit_each: Callable[[Sequence[PointSet], Model, Any], list[Fit]] | None = None
    fit_penalized: PenalizedFitter | None = None

    def fits(self, sets: Sequence[PointSet], model: Model, settings: Any) -> list[Fit]:
        """A fit of each set; raises what `fit` raises for one of them."""
        if self.fit_each is not None:
            return self.fit_each(sets, model, settings)
        return [self.fit(points, model, settings) for points in sets]
