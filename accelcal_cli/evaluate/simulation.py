"""Sensors with known errors: how well each optimizer does (Table 2), what a wrong gravity does (Table 8).

Table 2 of Farago, Maczak, Gingl 2024 (section III.A) has the absolute errors of the nine parameters.
Beside them stands the Cramer-Rao bound: how well nine parameters can be known at best. The true
orientation of each point is unknown too. Eliminating it leaves one equation for a point, |K (v + o)|^2 -
1 = 0, whose left side has variance |2 K^T a|^2 sigma^2 under noise sigma on each axis of v. Its
derivatives, divided by that standard deviation, give the Fisher information.

Table 8 of Grammenos, Mascolo, Crowcroft 2018: the points rest at local gravity and are fitted twice, as
if rest measured standard gravity, and knowing the local one, as with `calibrate --latitude`. The paper
reports "the calibration residual error in cost function E" and does not say against which gravity: nine
parameters absorb a wrong one in the scale, so that the residual against the assumed gravity does not
show it. Both are reported here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from itertools import product
from statistics import median
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.gravity import STANDARD_GRAVITY
from accelcal_cli.core.operations import predicted_charge_mc, predicted_seconds
from accelcal_cli.core.points import PARAMETER_NAMES, Calibration, Fit, Operations, in_standard_g
from accelcal_cli.core.version import __version__
from accelcal_cli.evaluate.cases import Case, Method, Plan, Selection, as_points, make_case, measured
from accelcal_cli.judge.errors import directions, jacobian
from accelcal_cli.output.report import significant

Real = NDArray[np.float64]
Step = Callable[[int], None]
"""Called with the number of cases done."""

MG = 1e-3
MEAN_OF_ABSOLUTE = float(np.sqrt(2 / np.pi))
"""Mean |x| of a normal distribution with standard deviation 1."""
NINE = PARAMETER_NAMES[:9]
ROWS, COLUMNS_OF_K = [0, 1, 2, 1, 2, 2], [0, 1, 2, 0, 0, 1]
"""Where the first six parameters stand in K, or in S."""
STEP = 1e-6
Gauge = Literal["lower", "symmetric"]
COLUMNS = (
    "points", "noise_mg", "source", "model", "parameter", "mean_abs_error", "sd_abs_error", "cases", "failed",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Published:
    """Mean and standard deviation of the absolute errors, in the order of PARAMETER_NAMES."""

    mean: tuple[float, ...]
    sd: tuple[float, ...]


TABLE_2 = {
    1.0: Published(
        mean=(2.98e-4, 3.18e-4, 2.47e-4, 1.49e-3, 1.42e-3, 1.45e-3, 2.39e-4, 2.54e-4, 2.04e-4),
        sd=(2.37e-4, 2.27e-4, 1.68e-4, 1.22e-3, 1.23e-3, 1.26e-3, 1.88e-4, 1.91e-4, 1.5e-4),
    ),
    5.0: Published(
        mean=(1.39e-3, 1.64e-3, 1.07e-3, 2.61e-3, 2.67e-3, 3.3e-3, 1.05e-3, 1.18e-3, 1.08e-3),
        sd=(1.07e-3, 1.22e-3, 8.98e-4, 2.24e-3, 2.07e-3, 2.53e-3, 9.2e-4, 8.35e-4, 7.76e-4),
    ),
}
"""Farago, Maczak, Gingl 2024, Table 2, by noise [mg]."""

TABLE_8 = (0.6015, 0.0090)
"""Residuals with default and with local gravity, accelerometer, without a unit (Grammenos, Mascolo,
Crowcroft 2018, Table 8)."""

TABLE_8_GRAVITY = 9.81676
"""Local gravity of Table 8 [m/s2]."""


@dataclass(frozen=True, slots=True)
class Scores:
    """One method's errors over all cases that it could fit.

    Attributes:
        mean, sd: of the absolute errors of the nine parameters; None if not fitted.
        bias: mean of the errors with their signs.
        ratio_to_bound: mean over the fitted parameters of `mean` over the bound of the same cases.
        fitted: number of cases.
        failures: reasons why other cases have no fit, with their numbers.
        iterations: median.
        operations: medians; zeros where not counted.
        seconds: median time of a fit on this machine.
    """

    method: Method
    mean: tuple[float | None, ...]
    sd: tuple[float | None, ...]
    bias: tuple[float | None, ...]
    ratio_to_bound: float | None
    fitted: int
    failures: dict[str, int]
    iterations: float | None
    operations: Operations
    seconds: float | None


@dataclass(slots=True)
class Tally:
    """Takes cases in, one by one."""

    method: Method
    gauge: Gauge = "lower"
    errors: list[Real] = field(default_factory=list)
    bounds: list[Real] = field(default_factory=list)
    fits: list[Fit] = field(default_factory=list)
    failures: Counter[str] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)

    def take(self, case: Case, bound: Real) -> None:
        """Fit a case; a fit that fails is counted."""
        began = perf_counter()
        try:
            fit = self.method.fit(case.points)
        except DivergedError as error:
            self.failures[error.message] += 1
            return
        self.seconds.append(perf_counter() - began)
        self.fits.append(fit)
        found, true = (
            in_gauge(np.array(nine[:9]) / ONE, self.gauge) for nine in (fit.parameters, case.truth)
        )
        self.errors.append(found - true)
        self.bounds.append(bound)

    def scores(self) -> Scores:
        """What the cases amount to."""
        fitted = len(self.fits)
        if not fitted:
            none = (None,) * 9
            return Scores(
                self.method, none, none, none, None, 0, dict(self.failures), None, Operations(), None
            )
        absolute = np.abs(self.errors)
        mean = np.mean(absolute, axis=0)
        free = list(self.method.model.free)
        return Scores(
            self.method,
            mean=self._of_fitted(mean),
            sd=self._of_fitted(np.std(absolute, axis=0, ddof=1)) if fitted > 1 else (None,) * 9,
            bias=self._of_fitted(np.mean(self.errors, axis=0)),
            ratio_to_bound=float(np.mean((mean / np.mean(self.bounds, axis=0))[free])),
            fitted=fitted,
            failures=dict(self.failures),
            iterations=median(fit.iterations for fit in self.fits),
            operations=self._operations(),
            seconds=median(self.seconds),
        )

    def _of_fitted(self, values: Real) -> tuple[float | None, ...]:
        free = self.method.model.free
        return tuple(float(value) if index in free else None for index, value in enumerate(values))

    def _operations(self) -> Operations:
        counted = [fit.operations for fit in self.fits]
        return Operations(
            round(median(item.additions for item in counted)),
            round(median(item.multiplications for item in counted)),
        )


def fisher_information(still_g: Real, truth: tuple[int, ...], noise_g: float) -> Real:
    """Information (9, 9) that points at (n, 3) carry on a sensor's nine parameters."""
    rows = jacobian(still_g, None, truth)[:, :9]
    spread = noise_g * np.linalg.norm(rows[:, 6:], axis=1, keepdims=True)
    return np.asarray((rows / spread).T @ (rows / spread))


def in_gauge(nine: Real, gauge: Gauge) -> Real:
    """Nine parameters (9,) of F as those of a gauge: of K, or of G's symmetric S with S^T S = K^T K."""
    if gauge == "lower":
        return nine
    k = np.zeros((3, 3))
    k[ROWS, COLUMNS_OF_K] = nine[:6]
    squares, axes = np.linalg.eigh(k.T @ k)
    s = axes * np.sqrt(squares) @ axes.T
    return np.concatenate([s[ROWS, COLUMNS_OF_K], nine[6:]])


def _slopes(nine: Real, gauge: Gauge) -> Real:
    """Derivatives (9, 9) of a gauge's parameters with respect to F's, by central differences."""
    steps = STEP * np.eye(9)
    ends = [(in_gauge(nine + step, gauge) - in_gauge(nine - step, gauge)) / (2 * STEP) for step in steps]
    return np.array(ends).T


def expected_errors(still_g: Real, truth: tuple[int, ...], noise_g: float, gauge: Gauge = "lower") -> Real:
    """Least mean |error| (9,) of an unbiased estimate, were its errors normal."""
    covariance = np.linalg.inv(fisher_information(still_g, truth, noise_g))
    if gauge != "lower":
        slopes = _slopes(np.array(truth[:9]) / ONE, gauge)
        covariance = slopes @ covariance @ slopes.T
    return np.asarray(MEAN_OF_ABSOLUTE * np.sqrt(np.diag(covariance)))


@dataclass(frozen=True, slots=True)
class Protocol:
    """What is simulated.

    Attributes:
        cases: number of sensors, each with its own points.
        seed: of everything random.
        points: numbers of points, a table for each.
        noise_mg: standard deviations of the noise on each axis, a table for each.
        selection: `subsets`: F's collector takes the points from a stream; `random`: any.
        gauge: whose parameters are compared: F's lower triangular K, or G's symmetric S.
    """

    cases: int = 500
    seed: int = 1
    points: tuple[int, ...] = (18, 144, 432)
    noise_mg: tuple[float, ...] = (1.0, 5.0)
    selection: Selection = "subsets"
    gauge: Gauge = "lower"

    def plans(self) -> list[Plan]:
        """A plan for each table; raises UsageError if nine subsets cannot share the points."""
        pairs = product(self.points, self.noise_mg)
        plans = [Plan(number, noise * MG, self.selection) for number, noise in pairs]
        for plan in plans:
            plan.check()
        return plans


@dataclass(frozen=True, slots=True)
class Table:
    """Results for one number of points and one size of noise.

    Attributes:
        bound: least mean absolute error of the nine parameters (Cramer-Rao), mean over the cases.
        published: the paper's figures for this noise, where it has any.
    """

    points: int
    noise_mg: float
    bound: tuple[float, ...]
    published: Published | None
    scores: tuple[Scores, ...]

    def worst_against_paper(self, scores: Scores) -> float | None:
        """The largest ratio of a mean error to the paper's; None if either has none."""
        if self.published is None or not scores.fitted:
            return None
        pairs = zip(scores.mean, self.published.mean, strict=True)
        return max(mean / paper for mean, paper in pairs if mean is not None)


def run(
    protocol: Protocol, methods: tuple[Method, ...], progress: Callable[[str, int], Step]
) -> tuple[Table, ...]:
    """A table for each number of points and size of noise; raises UsageError."""
    return tuple(
        _table(protocol, plan, methods, progress(f"{plan.number} points", protocol.cases))
        for plan in protocol.plans()
    )


def _table(protocol: Protocol, plan: Plan, methods: tuple[Method, ...], step: Step) -> Table:
    tallies, bounds = [Tally(method, protocol.gauge) for method in methods], []
    for index in range(protocol.cases):
        case = make_case(plan, protocol.seed, index)
        bounds.append(expected_errors(case.still_g, case.truth, plan.noise_g, protocol.gauge))
        for tally in tallies:
            tally.take(case, bounds[-1])
        step(index + 1)
    bound = tuple(np.mean(bounds, axis=0).tolist())
    scores = tuple(tally.scores() for tally in tallies)
    noise_mg = round(plan.noise_g / MG, 9)
    published = TABLE_2.get(noise_mg) if protocol.gauge == "lower" else None
    return Table(plan.number, noise_mg, bound, published, scores)


def as_json(protocol: Protocol, tables: Sequence[Table]) -> dict[str, Any]:
    """Everything; errors are plain numbers, of offsets in g. `seconds_per_fit` alone varies by run."""
    return {
        "accelcal_version": __version__,
        "protocol": asdict(protocol),
        "tables": [_table_json(table) for table in tables],
    }


def _table_json(table: Table) -> dict[str, Any]:
    published = table.published
    return {
        "points": table.points,
        "noise_mg": table.noise_mg,
        "published": None if published is None else _pair(published.mean, published.sd),
        "bound": _named(table.bound),
        "methods": [_method(table, scores) for scores in table.scores],
    }


def _method(table: Table, scores: Scores) -> dict[str, Any]:
    method, seconds = scores.method, scores.seconds
    counted = asdict(scores.operations) if scores.operations.additions else None
    spent = scores.operations, method.optimizer.arithmetic
    predicted, charge = predicted_seconds(*spent), predicted_charge_mc(*spent)
    return {
        "method": method.label,
        "optimizer": method.optimizer.name,
        "profile": method.profile,
        "model": method.model.name,
        **_pair(scores.mean, scores.sd),
        "bias": _named(scores.bias),
        "ratio_to_bound": _short(scores.ratio_to_bound),
        "largest_ratio_to_published": _short(table.worst_against_paper(scores)),
        "cases": scores.fitted,
        "failed": sum(scores.failures.values()),
        "failures": scores.failures,
        "iterations": scores.iterations,
        "operations": counted,
        "predicted_seconds": predicted and {name: significant(value) for name, value in predicted.items()},
        "predicted_charge_mc": charge and {name: significant(value) for name, value in charge.items()},
        "seconds_per_fit": _short(seconds),
    }


def _pair(mean: Sequence[float | None], sd: Sequence[float | None]) -> dict[str, Any]:
    return {"mean_abs_error": _named(mean), "sd_abs_error": _named(sd)}


def _named(values: Sequence[float | None]) -> dict[str, float | None]:
    return dict(zip(NINE, map(_short, values), strict=True))


def _short(value: float | None) -> float | None:
    return None if value is None else significant(value)


def rows(tables: tuple[Table, ...]) -> list[tuple[object, ...]]:
    """Of COLUMNS: one for each table, source (the paper, the bound, a method) and parameter."""
    return [
        (table.points, f"{table.noise_mg:g}", *row)
        for table in tables
        for source in _sources(table)
        for row in source
    ]


def _sources(table: Table) -> Iterator[Iterator[tuple[object, ...]]]:
    none: tuple[None, ...] = (None,) * 9
    if table.published is not None:
        yield _rows("paper", "9", (table.published.mean, table.published.sd), (None, None))
    yield _rows("bound", "9", (table.bound, none), (None, None))
    for scores in table.scores:
        counts = (scores.fitted, sum(scores.failures.values()))
        yield _rows(scores.method.label, scores.method.model.name, (scores.mean, scores.sd), counts)


def _rows(
    source: str,
    model: str,
    errors: tuple[Sequence[float | None], Sequence[float | None]],
    counts: tuple[int | None, int | None],
) -> Iterator[tuple[object, ...]]:
    for name, mean, sd in zip(NINE, *errors, strict=True):
        yield (source, model, name, _short(mean), _short(sd), *counts)


@dataclass(frozen=True, slots=True)
class Residuals:
    """What is left after fits that assume one gravity, means over the cases.

    Attributes:
        assumed_m_s2: gravity that the fit assumes.
        against_assumed, against_true: E = mean of (|A|^2 - g^2)^2 over the fitted points [m4/s8].
        norm_error_mg: mean error of |a| over directions of the sphere, without noise [mg].
        fitted: number of cases.
    """

    assumed_m_s2: float
    against_assumed: float
    against_true: float
    norm_error_mg: float
    fitted: int


def gravity_residuals(
    plan: Plan, method: Method, cases: int, seed: int, progress: Callable[[int], None]
) -> tuple[Residuals, ...]:
    """Residuals with standard and with local gravity; `plan.rest_g` is the local one.

    Raises:
        UsageError: nine subsets cannot share the plan's points.
        DivergedError: no case can be fitted.
    """
    plan.check()
    kept: list[tuple[Fraction, list[Real]]] = [(Fraction(1), []), (plan.rest_g, [])]
    for index in range(cases):
        case = make_case(plan, seed, index)
        for assumed_g, rows in kept:
            rows.extend(_residuals(method, case, assumed_g, float(plan.rest_g)))
        progress(index + 1)
    return tuple(_mean_residuals(assumed_g, rows) for assumed_g, rows in kept)


def _residuals(method: Method, case: Case, assumed_g: Fraction, true_g: float) -> list[Real]:
    """One row of figures, none where the fit fails."""
    try:
        fit = method.fit(as_points(case.points.xyz_g() / float(assumed_g)))
    except DivergedError:
        return []
    calibration = Calibration(method.model.name, in_standard_g(fit.parameters, assumed_g))
    fitted = _norms(calibration, case.points.xyz_g())
    exact = _norms(calibration, measured(case.truth, true_g * directions()))
    mg = 1e3 * float(np.abs(exact - true_g).mean())
    return [np.array([_gravity_cost(fitted, float(assumed_g)), _gravity_cost(fitted, true_g), mg])]


def _norms(calibration: Calibration, raw_g: Real) -> Real:
    return np.asarray(np.linalg.norm((raw_g + calibration.offset_g()) @ calibration.gain().T, axis=1))


def _gravity_cost(norms_g: Real, gravity_g: float) -> float:
    """E of G eq. 5, of norms and gravity in standard g, in m4/s8."""
    return float(((norms_g**2 - gravity_g**2) ** 2).mean()) * STANDARD_GRAVITY**4


def _mean_residuals(assumed_g: Fraction, rows: list[Real]) -> Residuals:
    if not rows:
        raise DivergedError("no case could be fitted")
    assumed, true, mg = np.mean(rows, axis=0).tolist()
    return Residuals(round(float(assumed_g) * STANDARD_GRAVITY, 6), assumed, true, mg, len(rows))
