"""The descent of F with any numbers, and its convergence (Farago, Maczak, Gingl 2024, section II.C, Fig. 9).

It runs in double precision, with forward differences, from the ideal sensor. The paper writes its objective
as a sum; with the rates that it prints, only the mean converges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import LIMIT, ONE
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.points import Fit, Model, Operations, Optimizer, PointSet
from accelcal_cli.laboratory.cases import CasePlan, Method, make_case

Real = NDArray[np.float64]
Objective = Literal["mean", "root", "sum"]
Spread = dict[str, float | None]

NAME = "descent"
STEP = 1e-5
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
    v, probes = points.xyz_g(), np.vstack([np.zeros(9), STEP * np.eye(9)])
    rates = np.repeat(numbers.rates, 3)
    path = [np.array(IDENTITY[:9]) / ONE]
    for _ in range(numbers.iterations):
        base, *probed = _costs(v, path[-1] + probes, numbers.objective)
        path.append(path[-1] - rates * (np.array(probed) - base) / STEP)
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


def as_json(found: Convergence) -> dict[str, Any]:
    """Return the table as JSON, with iterations and tolerances as text."""
    shown = asdict(found)
    return shown | {
        name: {f"{key:g}": value for key, value in shown[name].items()} for name in ("left", "within")
    }
