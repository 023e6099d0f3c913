"""Records that flow from the segmenter to the judge: still windows as integer sums, points, and fits.

The cost of a fit on small processors is predicted from counted additions and multiplications alone, as in
Farago, Maczak, Gingl 2024, Table 1: 0.70 s for 90 150 of each on an ATmega328. Loads, stores, narrowing and
range checks come on top.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE, Fixed, checked, narrow
from accelcal_cli.core.calibration import NO_BEND, Bend, Correction, TemperatureScale
from accelcal_cli.core.recording import cut_columns, joined_columns

WEIGHT_ONE = 1 << 15
"""Weight of one whole point."""

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
        """Return the windows that a mask, an array of numbers or a slice selects."""
        return Windows(**cut_columns(self, self.__dataclass_fields__, which))


_EMPTY, _NO_ROWS = np.empty(0, np.int64), np.empty((0, 3), np.int64)
NO_WINDOWS = Windows(_EMPTY, _EMPTY, _NO_ROWS, _NO_ROWS, _EMPTY, _EMPTY, _EMPTY)


def joined_windows(parts: Sequence[Windows]) -> Windows:
    """Join windows; an optional column that one of the parts lacks is left out."""
    return Windows(**joined_columns((NO_WINDOWS, *parts), NO_WINDOWS.__dataclass_fields__))


@dataclass(frozen=True, slots=True, eq=False)
class TimedMeans:
    """n observations along a recording: means of the still windows of one orientation in a block of time.

    Attributes:
        block: (n,) number of each one's block, from 0, ascending.
        mean_g: (n, 3) raw mean [standard g].
        celsius: (n,) mean temperature [degrees C], or None.
        block_samples, block_h: length of a block in samples and in hours.
        windows: (n,) number of still windows behind each, where that matters.
    """

    block: NDArray[np.int64]
    mean_g: NDArray[np.float64]
    celsius: NDArray[np.float64] | None
    block_samples: int
    block_h: float
    windows: NDArray[np.int64] | None = None

    def blocks(self) -> int:
        """Return the number of blocks, up to the last one with stillness."""
        return int(self.block.max(initial=-1)) + 1

    def hours(self) -> float:
        """Return the length of all blocks [h]."""
        return self.blocks() * self.block_h

    def corrected(self, correction: Correction) -> TimedMeans:
        """Return the observations with the correction that holds in the middle of each block."""
        middle = self.block * self.block_samples + self.block_samples // 2
        return replace(self, mean_g=correction.applied(self.mean_g, middle))


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """Numbers of windows that were used, and of those that were not, by reason; chunks add up by +.

    complete = moving + filled + clipped + recovered + joined + repeated + still. A still window that several
    were joined to counts once as still, the others as joined; repeated windows belong to a stretch that the
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
        spread: max - min of the axis where it is largest.
        deviation: standard deviation of the axis where it is largest.
    """

    spread: int
    deviation: float


class Role(IntEnum):
    """Use that was made of a still window."""

    FIT = 0
    """It is part of a point that is fitted."""

    CONTROL = 1
    """It is part of a point of F's second set."""

    NOT_TAKEN = 2
    """None of F's subsets needed it."""

    IMPLAUSIBLE = 3
    """Its mean is not near 1 g."""

    CONSTANT = 4
    """Its values never changed."""

    TEMPERATURE = 5
    """Its temperature is impossible."""

    SATURATED = 6
    """An axis is close to where it saturates."""


Saturated = tuple[tuple[int, float], ...]
"""Axes (0, 1, 2) that measure nothing beyond a raw value [g], whose sign tells the side."""


@dataclass(frozen=True, slots=True, eq=False)
class WindowUses:
    """Uses that were made of m still windows.

    Attributes:
        role: (m,) `Role` of each.
        point: (m,) number of the calibration point that each is part of, -1 for none.
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
        """True if the offsets may depend on temperature."""
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
"""The model ladder: identity, offset, scale + offset, full; T adds a temperature slope per axis."""


@dataclass(frozen=True, slots=True, eq=False)
class PointSet:
    """Means of still windows, n of them, as integers.

    Attributes:
        xyz: (n, 3) raw means, fixed-point g.
        weights: (n,) integers; WEIGHT_ONE is one whole point.
        windows: (n,) number of still windows behind each point.
        tau: (n,) scaled temperatures in fixed point, or None.
        temperature: how tau was scaled, None without temperatures.
        previous: (n, 3) raw means of the postures before, fixed-point g, or None.
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
        """Return the points that a mask or an array of numbers selects."""
        tau, previous = (None if part is None else part[which] for part in (self.tau, self.previous))
        return PointSet(
            self.xyz[which], self.weights[which], self.windows[which], tau, self.temperature, previous
        )

    def joined(self, other: PointSet) -> PointSet:
        """Return these points and others; neither may have temperatures."""
        xyz, weights = np.concatenate([self.xyz, other.xyz]), np.concatenate([self.weights, other.weights])
        return PointSet(xyz, weights, np.concatenate([self.windows, other.windows]))

    def straightened(self, bend: Bend) -> PointSet:
        """Return the points with v + q v^2 instead of v; raises FixedPointOverflowError beyond the range."""
        if not any(bend):
            return self
        squares = (self.xyz * self.xyz) >> FRACTION_BITS
        return replace(self, xyz=checked(self.xyz + narrow(squares * np.array(bend)), "a straightened point"))

    def xyz_g(self) -> NDArray[np.float64]:
        """Return the raw means [g], (n, 3) float64, exact."""
        return self.xyz / float(ONE)


@dataclass(frozen=True, slots=True)
class Operations:
    """Scalar additions and multiplications, as F counts them (its 32-bit operations)."""

    additions: int = 0
    multiplications: int = 0


@dataclass(frozen=True, slots=True)
class Fit:
    """The result of an optimizer.

    Attributes:
        parameters: twelve fixed-point integers, in the order of PARAMETER_NAMES; the slopes are
            per `TemperatureScale.span_c` degrees.
        stop: why it stopped.
        history: parameters after each iteration, if asked for; with a penalty always, and the start before
            them.
        converged: False if the number of iterations ended it, short of the minimum.
        bend: of the response, by which the points were straightened.
    """

    parameters: tuple[int, ...]
    iterations: int
    stop: str
    operations: Operations
    history: tuple[tuple[int, ...], ...] = ()
    converged: bool = True
    bend: Bend = NO_BEND


@dataclass(frozen=True, slots=True)
class Penalty:
    """A prior as integers: the sum of strength_j (p_j - centre_j)^2, added to that of (|a|^2 - 1)^2.

    Attributes:
        centre: twelve fixed-point parameters.
        strength: twelve integers in units of 2**-PENALTY_BITS of a weight of 1.
    """

    centre: tuple[int, ...]
    strength: tuple[int, ...]


PENALTY_BITS = 40
"""Fraction bits of a penalty's strength."""


@dataclass(frozen=True, slots=True)
class PenalizedFit:
    """The minimum of the objective with a penalty, and the curvature there.

    Attributes:
        mean_square: weighted mean of (|a|^2 - 1)^2 there.
        curvature: weighted mean of J^T J, where J is d(|a|^2 - 1)/dp of the model's free parameters, and of
            the bend if that was fitted.
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
        fit_each: fits several sets of points, all with temperatures or none, with the same results as one
            by one; None if it would not be faster.
        fit_penalized: (points, model, penalty, start) -> PenalizedFit; None if it fits only without a prior.
        settings: the optimizer's own numbers by profile name.
        models: names of the models that it can fit.
        arithmetic: determines what its operations cost on a microcontroller.
        needs: a package that it imports and that is not always installed.
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
        """Fit each set; raises what `fit` raises for any of them."""
        if self.fit_each is not None:
            return self.fit_each(sets, model, settings)
        return [self.fit(points, model, settings) for points in sets]


@dataclass(frozen=True, slots=True)
class Microcontroller:
    """A processor of F's Table 1.

    Attributes:
        name: as in the table.
        clock_hz: the clock to which the times in section II.C refer.
        current_ma: typical current at that clock, by the same section; the Cortex-M3, which it does not give,
            is taken to draw as much as the M4.
        cycles: clock cycles of an addition and of a multiplication, by kind of number.
    """

    name: str
    clock_hz: int
    current_ma: float
    cycles: dict[Arithmetic, tuple[int, int]]


MICROCONTROLLERS = (
    Microcontroller("ATmega328", 16_000_000, 9.2, {"integer": (28, 97), "float": (123, 160)}),
    Microcontroller("ARM Cortex-M3", 80_000_000, 8.45, {"integer": (14, 14), "float": (96, 68)}),
    Microcontroller("ARM Cortex-M4", 80_000_000, 8.45, {"integer": (7, 6), "float": (11, 11)}),
)


def predicted_seconds(operations: Operations, arithmetic: Arithmetic) -> dict[str, float] | None:
    """Return predicted times by processor [s]; None if no operations were counted."""
    if operations == Operations():
        return None
    costs = [(item, *item.cycles[arithmetic]) for item in MICROCONTROLLERS]
    return {
        item.name: (operations.additions * addition + operations.multiplications * multiplication)
        / item.clock_hz
        for item, addition, multiplication in costs
    }


def predicted_charge_mc(operations: Operations, arithmetic: Arithmetic) -> dict[str, float] | None:
    """Return the charge by processor, time times current [mC = mA s]; None if no operations were counted."""
    seconds = predicted_seconds(operations, arithmetic)
    return seconds and {item.name: seconds[item.name] * item.current_ma for item in MICROCONTROLLERS}
