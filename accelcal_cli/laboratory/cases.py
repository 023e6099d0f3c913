"""Artificial calibration points (Farago, Maczak, Gingl 2024, section III.A, eq. 17-20) and methods.

Each case has a stream of random numbers of its own, from the seed and its index. The sensor comes first:
it is the same for any number of points, any noise and either selection. A `Method` is an optimizer with
the settings of one profile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from fractions import Fraction
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from accelcal_cli.collect.subsets import SubsetCollector
from accelcal_cli.core.arithmetic import LIMIT, ONE, three, to_fixed
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError, UsageError
from accelcal_cli.core.points import MODELS, WEIGHT_ONE, Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.optimize import all_optimizers, named_optimizer

SCALE_ERROR, MISALIGNMENT, OFFSET_G = 0.1, 0.05, 0.1
"""Largest errors to either side of the ideal (eq. 17); offsets in g."""

USUAL = ("fixed32", "fixed32:paper", "float64:paper", "fixed16", "gauss-newton")
"""Methods that are compared by default."""

ALL = "all"
"""Label of every method whose packages are installed."""

SUBSETS = 9
"""Number of subsets of F's collector."""

Selection = Literal["subsets", "random"]
Real = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CasePlan:
    """How points are drawn, with orientations uniform on the sphere.

    Attributes:
        number: number of points.
        noise_g: standard deviation of the noise on each axis [g].
        selection: `random` takes the points as they come; `subsets` lets F's collector choose equally many
            for each of its nine subsets.
        rest_g: acceleration at rest [standard g].
    """

    number: int
    noise_g: float
    selection: Selection = "subsets"
    rest_g: Fraction = Fraction(1)

    def check(self) -> None:
        """Raise UsageError if nine subsets cannot share the points."""
        if self.selection == "subsets" and self.number % SUBSETS:
            raise UsageError(
                f"{self.number} points cannot be divided equally among nine subsets",
                hint="use a multiple of 9, or --selection random",
            )


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A sensor with known errors and its points at rest.

    Attributes:
        truth: the twelve true parameters, fixed-point integers.
        still_g: (n, 3) measured accelerations without noise [g].
        points: measured points.
    """

    truth: tuple[int, ...]
    still_g: Real
    points: PointSet


def make_case(plan: CasePlan, seed: int, index: int) -> Case:
    """Draw a sensor and its points, which depend on plan, seed and index alone."""
    random = RandomState([seed, index])
    truth = draw_truth(random)
    draw = _drawn if plan.selection == "random" else _collected
    still, noisy = draw(plan, random, truth)
    return Case(truth, still, as_points(noisy))


def draw_truth(random: RandomState) -> tuple[int, ...]:
    """Draw errors (eq. 17) and return the parameters (eq. 18) as twelve integers without slopes."""
    draw = random.uniform(-1, 1, 9)
    scale, turn, offset = 1 + SCALE_ERROR * draw[:3], MISALIGNMENT * draw[3:6], OFFSET_G * draw[6:]
    crossed = scale[[1, 2, 2]] * turn
    return (*(to_fixed(float(value)) for value in (*scale, *crossed, *offset)), 0, 0, 0)


def measured(truth: tuple[int, ...], acceleration_g: Real) -> Real:
    """Return the measured values [g] of (n, 3) true accelerations: the inverse of eq. 7-9.

    Eq. 19 as printed is not that inverse: its second line subtracts the offset that it should add.
    """
    kxx, kyy, kzz, kxy, kxz, kyz, *offset = (value / ONE for value in truth[:9])
    x = acceleration_g[:, 0] / kxx
    y = (acceleration_g[:, 1] - kxy * x) / kyy
    z = (acceleration_g[:, 2] - kxz * x - kyz * y) / kzz
    return np.stack([x, y, z], axis=1) - offset


def directions(random: RandomState, number: int) -> Real:
    """Draw unit vectors, uniform on the sphere, (number, 3)."""
    drawn = random.standard_normal((number, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def as_points(xyz_g: Real) -> PointSet:
    """Return positions (n, 3) [g] as points of equal weight."""
    number = len(xyz_g)
    ones = np.ones(number, np.int64)
    return PointSet(np.rint(xyz_g * ONE).astype(np.int64), ones * WEIGHT_ONE, ones)


def _drawn(plan: CasePlan, random: RandomState, truth: tuple[int, ...]) -> tuple[Real, Real]:
    still = measured(truth, float(plan.rest_g) * directions(random, plan.number))
    return still, still + plan.noise_g * random.standard_normal(still.shape)


def _collected(plan: CasePlan, random: RandomState, truth: tuple[int, ...]) -> tuple[Real, Real]:
    """Return the points that F's collector takes from a stream, in the order of the stream."""
    collector = SubsetCollector(float(ONE), plan.number // SUBSETS)
    taken: list[tuple[Real, Real]] = []
    while len(taken) < plan.number:
        for still, noisy in zip(*_drawn(plan, random, truth), strict=True):
            if collector.offer(1, three(np.rint(noisy * ONE).astype(int).tolist())):
                taken.append((still, noisy))
    return np.array([still for still, _ in taken]), np.array([noisy for _, noisy in taken])


@dataclass(frozen=True, slots=True)
class Method:
    """An optimizer with the settings of one profile."""

    optimizer: Optimizer
    profile: str = "default"

    @property
    def label(self) -> str:
        """NAME, or NAME:PROFILE of another profile than the default."""
        return self.optimizer.name + ("" if self.profile == "default" else f":{self.profile}")

    @property
    def model(self) -> Model:
        """Model 9 if the optimizer can fit it, else model 6."""
        return MODELS["9" if "9" in self.optimizer.models else "6"]

    @property
    def settings(self) -> Any:
        """Settings of the optimizer in this profile."""
        return self.optimizer.settings[self.profile]

    def fit(self, points: PointSet) -> Fit:
        """Fit the model to points; raises DivergedError."""
        return self.optimizer.fit(points, self.model, self.settings)


def methods(labels: tuple[str, ...]) -> tuple[Method, ...]:
    """Return methods by label, each once; `all` stands for every one whose packages are installed.

    Raises:
        UsageError: no such optimizer, or it has no such profile.
    """
    chosen: dict[str, Method] = {}
    for label in labels or USUAL:
        if label == ALL:
            chosen |= {method.label: method for method in _installed() if method.label not in chosen}
            continue
        name, _, profile = label.partition(":")
        method = Method(named_optimizer(name), profile or "default")
        if method.profile not in method.optimizer.settings:
            raise UsageError(
                f"optimizer {name} has no settings of profile {profile!r}",
                hint=f"use one of {', '.join(sorted(method.optimizer.settings))}",
            )
        chosen.setdefault(method.label, method)
    return tuple(chosen.values())


def _installed() -> Iterator[Method]:
    """Yield every installed optimizer, and also with profile `paper` if its settings differ."""
    for optimizer in all_optimizers():
        if optimizer.needs is not None and find_spec(optimizer.needs) is None:
            continue
        yield Method(optimizer)
        if optimizer.settings.get("paper", optimizer.settings["default"]) != optimizer.settings["default"]:
            yield Method(optimizer, "paper")


# The descent of F with any numbers, and its convergence (Farago, Maczak, Gingl 2024, section II.C,
# Fig. 9).
#
# It runs in double precision, with forward differences, from the ideal sensor. The paper writes its
# objective as a sum; with the rates that it prints, only the mean converges.

Objective = Literal["mean", "root", "sum"]
Spread = dict[str, float | None]

NAME = "descent"
PROBE_STEP = 1e-5
"""Step of the forward differences."""

PLACES = (0, 4, 8, 3, 6, 7)
"""Indices of the first six parameters in K by rows."""

SHOWN = (1, 2, 3, 5, 7, 10, 15, 20, 25, 30, 35, 40, 45, 50, 75, 100, 150, 200, 300, 500, 700, 1000)
"""Iterations after which the distance to the end is shown."""

TOLERANCES = (5e-3, 1e-3)
"""Distances from the end for which the first iteration that stays within is found."""

GROUPS = {"scale": slice(0, 3), "misalignment": slice(3, 6), "offset": slice(6, 9)}


@dataclass(frozen=True, slots=True)
class DescentNumbers:
    """Numbers of the descent; by default the paper's.

    Attributes:
        objective: `mean` or `sum` over the points of (|a|^2 - 1)^2, or mean of (|a| - 1)^2 (`root`).
        rates: learning rates of scale, misalignment and offset.
    """

    objective: Objective = "mean"
    rates: tuple[float, float, float] = (0.3, 0.8, 0.2)
    iterations: int = 50


def trace(points: PointSet, numbers: DescentNumbers) -> Real:
    """Return the nine parameters at the start and after each iteration, (iterations + 1, 9).

    Raises:
        DivergedError: they leave the range of 32-bit fixed point.
    """
    v, probes = points.xyz_g(), np.vstack([np.zeros(9), PROBE_STEP * np.eye(9)])
    rates = np.repeat(numbers.rates, 3)
    path = [np.array(IDENTITY[:9]) / ONE]
    for _ in range(numbers.iterations):
        base, *probed = _costs(v, path[-1] + probes, numbers.objective)
        path.append(path[-1] - rates * (np.array(probed) - base) / PROBE_STEP)
        if not np.abs(path[-1]).max() * ONE < LIMIT:
            raise DivergedError("a parameter leaves the fixed-point range")
    return np.array(path)


def _costs(v: Real, sets: Real, objective: Objective) -> Real:
    """Return the objective at (k, 9) parameters, (k,)."""
    gain = np.zeros((len(sets), 9))
    gain[:, PLACES] = sets[:, :6]
    a = (v + sets[:, np.newaxis, 6:]) @ np.swapaxes(gain.reshape(-1, 3, 3), 1, 2)
    square = (a**2).sum(axis=2)
    off = (np.sqrt(square) if objective == "root" else square) - 1
    return np.asarray((off**2).sum(axis=1) if objective == "sum" else (off**2).mean(axis=1))


def descent(numbers: DescentNumbers) -> Method:
    """Return the descent as a method to compare with others."""

    def fit(points: PointSet, _model: Model, settings: Any) -> Fit:
        end = trace(points, settings)[-1]
        if end[:3].min() <= 0:
            raise DivergedError("the fit turns an axis round")
        each = settings.iterations * (100 * len(points) + 3)
        counted = Operations() if settings.objective == "root" else Operations(each, each)
        nine = tuple(round(value * ONE) for value in end.tolist())
        return Fit((*nine, *IDENTITY[9:]), settings.iterations, "iterations", counted)

    title = "gradient descent with given numbers (Farago, Maczak, Gingl 2024)"
    return Method(Optimizer(NAME, title, fit, {"default": numbers}, ("9",)))


@dataclass(frozen=True, slots=True)
class Convergence:
    """Convergence of the descent over all cases in which it did not diverge.

    Attributes:
        left: largest distance from the last iteration, by iteration and group of parameters.
        within: iterations after which all nine parameters stay within a tolerance of the last one.

    Both as `median` and 90th percentile, `p90`, over the cases; None without any.
    """

    points: int
    noise_mg: float
    cases: int
    diverged: int
    left: dict[int, dict[str, Spread]]
    within: dict[float, Spread]


def convergence(
    plan: CasePlan, numbers: DescentNumbers, cases: int, seed: int, step: Callable[[int], None]
) -> Convergence:
    """Make the table behind Fig. 9; raises UsageError if nine subsets cannot share the points."""
    plan.check()
    paths = []
    for index in range(cases):
        with suppress(DivergedError):
            paths.append(trace(make_case(plan, seed, index).points, numbers))
        step(index + 1)
    far = np.array([np.abs(path - path[-1]) for path in paths])
    shown = [number for number in SHOWN if number < numbers.iterations]
    left = {
        number: {name: _spread(far[:, number, part].max(axis=1)) for name, part in GROUPS.items()}
        for number in (shown if paths else [])
    }
    within = {limit: _spread([_arrival(one, limit) for one in far]) for limit in TOLERANCES}
    noise_mg = round(1000 * plan.noise_g, 9)
    return Convergence(plan.number, noise_mg, len(paths), cases - len(paths), left, within)


def _arrival(far: Real, limit: float) -> int:
    """Return the iteration after which all parameters stay within a limit."""
    outside = np.flatnonzero(far.max(axis=1) > limit)
    return int(outside[-1]) + 1 if len(outside) else 0


def _spread(values: Sequence[float] | Real) -> Spread:
    percentiles = np.percentile(values, (50, 90)).tolist() if len(values) else (None, None)
    return dict(zip(("median", "p90"), percentiles, strict=True))


def convergence_json(found: Convergence) -> dict[str, Any]:
    """Return the table as JSON, with iterations and tolerances as text."""
    shown = asdict(found)
    return shown | {
        name: {f"{key:g}": value for key, value in shown[name].items()} for name in ("left", "within")
    }
