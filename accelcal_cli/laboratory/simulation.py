"""`accelcal evaluate simulation`: how well each optimizer finds known errors of sensors (Table 2).

Table 2 of Farago, Maczak, Gingl 2024 (section III.A) has the absolute errors of the nine parameters.
Next to them stands the Cramer-Rao bound: how well nine parameters can be known at best. The true
orientation of each point is unknown too. Eliminating it leaves one equation for a point, |K (v + o)|^2 -
1 = 0, whose left side has variance |2 K^T a|^2 sigma^2 under noise sigma on each axis of v. Its
derivatives, divided by that standard deviation, give the Fisher information.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import product
from statistics import median
from time import perf_counter
from typing import Any, Literal, get_args

import click
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.cli import exit_codes
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.options import METHOD, Listed, OneOf
from accelcal_cli.cli.output import aligned, progress_bars
from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import PARAMETER_NAMES
from accelcal_cli.core.errors import DivergedError, UsageError, significant
from accelcal_cli.core.identity import identity
from accelcal_cli.core.points import MICROCONTROLLERS, Fit, Operations, predicted_charge_mc, predicted_seconds
from accelcal_cli.judge.errors import jacobian
from accelcal_cli.laboratory.cases import (
    NAME,
    USUAL,
    Case,
    CasePlan,
    Convergence,
    DescentNumbers,
    Method,
    Objective,
    Selection,
    convergence,
    convergence_json,
    descent,
    make_case,
    methods,
)
from accelcal_cli.output.files import csv_text
from accelcal_cli.output.numbers import figure, formatted

Real = NDArray[np.float64]
Step = Callable[[int], None]
"""Callback with the number of cases done."""

MG = 1e-3
"""One mg in g."""

MEAN_OF_ABSOLUTE = float(np.sqrt(2 / np.pi))
"""Mean |x| of a standard normal distribution."""
NINE = PARAMETER_NAMES[:9]
ROWS, COLUMNS_OF_K = [0, 1, 2, 1, 2, 2], [0, 1, 2, 0, 0, 1]
"""Rows and columns of the first six parameters in K, or in S."""

STEP = 1e-6
"""Step of the central differences between gauges."""

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


@dataclass(frozen=True, slots=True)
class Scores:
    """One method's errors over all cases that it could fit.

    Attributes:
        mean, sd: mean and standard deviation of the absolute errors of the nine parameters; None if not
            fitted.
        bias: mean of the errors with their signs.
        ratio_to_bound: mean over the fitted parameters of `mean` divided by the bound of the same cases.
        fitted: number of fitted cases.
        failures: reasons why other cases have no fit, with their numbers.
        iterations: median number of iterations.
        operations: median numbers; zeros if not counted.
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
    """Collects the errors of one method, case by case."""

    method: Method
    gauge: Gauge = "lower"
    errors: list[Real] = field(default_factory=list)
    bounds: list[Real] = field(default_factory=list)
    fits: list[Fit] = field(default_factory=list)
    failures: Counter[str] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)

    def take(self, case: Case, bound: Real) -> None:
        """Fit a case, or count its failure."""
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
        """Return the statistics over the cases."""
        fitted = len(self.fits)
        if not fitted:
            none, failed = (None,) * 9, dict(self.failures)
            return Scores(self.method, none, none, none, None, 0, failed, None, Operations(), None)
        counted = [fit.operations for fit in self.fits]
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
            operations=Operations(
                round(median(item.additions for item in counted)),
                round(median(item.multiplications for item in counted)),
            ),
            seconds=median(self.seconds),
        )

    def _of_fitted(self, values: Real) -> tuple[float | None, ...]:
        free = self.method.model.free
        return tuple(float(value) if index in free else None for index, value in enumerate(values))


def fisher_information(still_g: Real, truth: tuple[int, ...], noise_g: float) -> Real:
    """Return the information (9, 9) that points at (n, 3) have on a sensor's nine parameters."""
    rows = jacobian(still_g, None, truth)[:, :9]
    spread = noise_g * np.linalg.norm(rows[:, 6:], axis=1, keepdims=True)
    return np.asarray((rows / spread).T @ (rows / spread))


def in_gauge(nine: Real, gauge: Gauge) -> Real:
    """Convert F's nine parameters (9,) to a gauge: K, or G's symmetric S with S^T S = K^T K."""
    if gauge == "lower":
        return nine
    k = np.zeros((3, 3))
    k[ROWS, COLUMNS_OF_K] = nine[:6]
    squares, axes = np.linalg.eigh(k.T @ k)
    s = axes * np.sqrt(squares) @ axes.T
    return np.concatenate([s[ROWS, COLUMNS_OF_K], nine[6:]])


def expected_errors(still_g: Real, truth: tuple[int, ...], noise_g: float, gauge: Gauge = "lower") -> Real:
    """Return the least mean |error| (9,) of an unbiased estimate with normal errors."""
    covariance = np.linalg.inv(fisher_information(still_g, truth, noise_g))
    if gauge != "lower":
        nine, steps = np.array(truth[:9]) / ONE, STEP * np.eye(9)
        ends = [(in_gauge(nine + step, gauge) - in_gauge(nine - step, gauge)) / (2 * STEP) for step in steps]
        slopes = np.array(ends).T  # of the gauge's parameters with respect to F's
        covariance = slopes @ covariance @ slopes.T
    return np.asarray(MEAN_OF_ABSOLUTE * np.sqrt(np.diag(covariance)))


@dataclass(frozen=True, slots=True)
class Protocol:
    """Settings of a simulation.

    Attributes:
        cases: number of sensors, each with its own points.
        seed: seed of all random numbers.
        points: numbers of points, a table for each.
        noise_mg: standard deviations of the noise on each axis, a table for each.
        selection: `subsets`: F's collector takes the points from a stream; `random`: any.
        gauge: parameters that are compared: those of F's lower triangular K, or of G's symmetric S.
    """

    cases: int = 500
    seed: int = 1
    points: tuple[int, ...] = (18, 144, 432)
    noise_mg: tuple[float, ...] = (1.0, 5.0)
    selection: Selection = "subsets"
    gauge: Gauge = "lower"

    def plans(self) -> list[CasePlan]:
        """Return a plan for each table; raises UsageError if nine subsets cannot share the points."""
        pairs = product(self.points, self.noise_mg)
        plans = [CasePlan(number, noise * MG, self.selection) for number, noise in pairs]
        for plan in plans:
            plan.check()
        return plans


@dataclass(frozen=True, slots=True)
class ErrorTable:
    """Results for one number of points and one size of noise.

    Attributes:
        bound: least mean absolute error of the nine parameters (Cramer-Rao), mean over the cases.
        published: the paper's figures for this noise, if it has any.
    """

    points: int
    noise_mg: float
    bound: tuple[float, ...]
    published: Published | None
    scores: tuple[Scores, ...]

    def worst_against_paper(self, scores: Scores) -> float | None:
        """Return the largest ratio of a mean error to the paper's; None if either has none."""
        if self.published is None or not scores.fitted:
            return None
        pairs = zip(scores.mean, self.published.mean, strict=True)
        return max(mean / paper for mean, paper in pairs if mean is not None)


def run(
    protocol: Protocol, methods: tuple[Method, ...], progress: Callable[[str, int], Step]
) -> tuple[ErrorTable, ...]:
    """Make a table for each number of points and size of noise; raises UsageError."""
    return tuple(
        _table(protocol, plan, methods, progress(f"{plan.number} points", protocol.cases))
        for plan in protocol.plans()
    )


def _table(protocol: Protocol, plan: CasePlan, methods: tuple[Method, ...], step: Step) -> ErrorTable:
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
    return ErrorTable(plan.number, noise_mg, bound, published, scores)


def as_json(protocol: Protocol, tables: Sequence[ErrorTable]) -> dict[str, Any]:
    """Return all results as JSON, errors of offsets in g; only `seconds_per_fit` varies by run."""
    shown = [
        {
            "points": table.points,
            "noise_mg": table.noise_mg,
            "published": table.published and _pair_json(table.published.mean, table.published.sd),
            "bound": _by_parameter(table.bound),
            "methods": [_method(table, scores) for scores in table.scores],
        }
        for table in tables
    ]
    return {**identity("simulation"), "protocol": asdict(protocol), "tables": shown}


def _method(table: ErrorTable, scores: Scores) -> dict[str, Any]:
    method = scores.method
    counted = asdict(scores.operations) if scores.operations.additions else None
    spent = scores.operations, method.optimizer.arithmetic
    predicted, charge = predicted_seconds(*spent), predicted_charge_mc(*spent)
    return {
        "method": method.label,
        "optimizer": method.optimizer.name,
        "profile": method.profile,
        "model": method.model.name,
        **_pair_json(scores.mean, scores.sd),
        "bias": _by_parameter(scores.bias),
        "ratio_to_bound": _short(scores.ratio_to_bound),
        "largest_ratio_to_published": _short(table.worst_against_paper(scores)),
        "cases": scores.fitted,
        "failed": sum(scores.failures.values()),
        "failures": scores.failures,
        "iterations": scores.iterations,
        "operations": counted,
        "predicted_seconds": predicted and {name: significant(value) for name, value in predicted.items()},
        "predicted_charge_mc": charge and {name: significant(value) for name, value in charge.items()},
        "seconds_per_fit": _short(scores.seconds),
    }


def _pair_json(mean: Sequence[float | None], sd: Sequence[float | None]) -> dict[str, Any]:
    return {"mean_abs_error": _by_parameter(mean), "sd_abs_error": _by_parameter(sd)}


def _by_parameter(values: Sequence[float | None]) -> dict[str, float | None]:
    return dict(zip(NINE, map(_short, values), strict=True))


def _short(value: float | None) -> float | None:
    return None if value is None else significant(value)


def rows(tables: tuple[ErrorTable, ...]) -> list[tuple[object, ...]]:
    """Return rows of COLUMNS, for each table, source (the paper, the bound, a method) and parameter."""
    found: list[tuple[object, ...]] = []
    for table in tables:
        known, none = table.published, (None,) * 9
        sources: list[tuple[Any, ...]] = [("bound", "9", table.bound, none, None, None)]
        if known is not None:
            sources.insert(0, ("paper", "9", known.mean, known.sd, None, None))
        for one in table.scores:
            counts = one.fitted, sum(one.failures.values())
            sources.append((one.method.label, one.method.model.name, one.mean, one.sd, *counts))
        for source, model, means, sds, *numbers in sources:
            found += [
                (table.points, f"{table.noise_mg:g}", source, model, name, _short(mean), _short(sd), *numbers)
                for name, mean, sd in zip(NINE, means, sds, strict=True)
            ]
    return found


NONE = "-"
UNIT = 1e-4
"""Unit of the errors in the table for people."""

SIX = " (six)"
ERRORS = ("", *NINE, "/bound", "/paper", "failed")
COUNTED = ("", "iterations", "added", "multiplied", "ms here")
COSTS = (
    *COUNTED,
    *(head for item in MICROCONTROLLERS for head in (f"{item.name.removeprefix('ARM ')} s", "mC")),
)


def _lines(protocol: Protocol, tables: tuple[ErrorTable, ...]) -> Iterator[str]:
    """Yield the lines of all tables, then of the costs of each method."""
    chosen = "chosen by nine subsets" if protocol.selection == "subsets" else "at random"
    yield f"{protocol.cases} cases (seed {protocol.seed}), points uniform on the sphere, {chosen}."
    yield "Absolute errors in units of 1e-4 (offsets 1e-4 g): mean, and below it SD. bound: Cramer-Rao."
    yield "/bound: mean over the parameters. /paper: the largest ratio to Table 2."
    for table in tables:
        yield from ("", f"{table.points} points, noise {table.noise_mg:g} mg")
        yield aligned(ERRORS, list(_errors(table)))
    for table in tables[:: len(protocol.noise_mg)]:
        yield from ("", f"Cost of a fit with {table.points} points, noise {table.noise_mg:g} mg (medians)")
        yield aligned(COSTS, [_cost(scores) for scores in table.scores])
    yield from _notes(tables)


def _errors(table: ErrorTable) -> Iterator[tuple[str, ...]]:
    if table.published is not None:
        yield from _mean_and_sd("paper, Table 2", table.published.mean, table.published.sd, (NONE, "1", NONE))
    yield ("bound", *_scaled(table.bound), "1", NONE, NONE)
    for scores in table.scores:
        label = scores.method.label + ("" if scores.method.model.name == "9" else SIX)
        ratios = figure(scores.ratio_to_bound), figure(table.worst_against_paper(scores))
        yield from _mean_and_sd(label, scores.mean, scores.sd, (*ratios, str(sum(scores.failures.values()))))


def _mean_and_sd(
    label: str, mean: Sequence[float | None], sd: Sequence[float | None], end: tuple[str, str, str]
) -> Iterator[tuple[str, ...]]:
    yield (label, *_scaled(mean), *end)
    yield ("  SD", *_scaled(sd), "", "", "")


def _scaled(values: Sequence[float | None]) -> list[str]:
    return [figure(None if value is None else value / UNIT) for value in values]


def _cost(scores: Scores) -> tuple[str, ...]:
    done = scores.operations
    arithmetic = scores.method.optimizer.arithmetic
    seconds, charge = predicted_seconds(done, arithmetic) or {}, predicted_charge_mc(done, arithmetic) or {}
    return (
        scores.method.label,
        formatted(scores.iterations, ".0f"),
        formatted(done.additions or None, "d"),
        formatted(done.multiplications or None, "d"),
        figure(None if scores.seconds is None else 1e3 * scores.seconds),
        *(figure(of.get(item.name)) for item in MICROCONTROLLERS for of in (seconds, charge)),
    )


def _notes(tables: tuple[ErrorTable, ...]) -> Iterator[str]:
    every = [scores for table in tables for scores in table.scores]
    if any(scores.method.model.name == "6" for scores in every):
        yield from (
            "",
            "six: fits only scale and offset, which the misalignment biases; the bound is for all nine.",
        )
    if any(scores.failures for scores in every):
        yield from ("", "Failed fits (excluded from their row and its bound):")
    for table in tables:
        for scores in table.scores:
            for reason, times in scores.failures.items():
                where = f"{table.points} points, {table.noise_mg:g} mg, {scores.method.label}"
                yield f"{where}: {times} x {reason}"


@click.command(
    "simulation",
    cls=Command,
    examples=("evaluate simulation --cases 100", "evaluate simulation --cases 100 --optimizer all --csv"),
)
@click.option("--cases", type=click.IntRange(1), metavar="N", default=500, show_default=True,
              help="How many sensors to simulate.")  # fmt: skip
@click.option("--points", type=Listed(int, 9, 8192), default="18,144,432", show_default=True,
              metavar="N[,N...]", help="Numbers of calibration points.")  # fmt: skip
@click.option("--noise-mg", type=Listed(float, 1e-3, 100), default="1,5", show_default=True,
              metavar="MG[,MG...]", help="Noise on each axis, standard deviation.")  # fmt: skip
@click.option("--selection", type=OneOf(get_args(Selection)), default="subsets", show_default=True,
              help="subsets: chosen by the paper's collector; random: any points.")  # fmt: skip
@click.option("--gauge", type=OneOf(get_args(Gauge)), default="lower", show_default=True,
              help="Compare the paper's triangular K, or the symmetric S of Grammenos et al.")  # fmt: skip
@click.option("--optimizer", "labels", multiple=True, type=METHOD, metavar="NAME[:paper]",
              help=f"May be repeated; `all` for all optimizers.  [default: {' '.join(USUAL)}]")  # fmt: skip
@click.option("--rates", type=Listed(float, 0, 10), metavar="SCALE,MISALIGNMENT,OFFSET",
              help="Learning rates of one more method, `descent`.  [default: 0.3,0.8,0.2]")  # fmt: skip
@click.option("--iterations", type=click.IntRange(1, 10_000), metavar="N",
              help="Iterations of `descent`.  [default: 50]")  # fmt: skip
@click.option("--objective", type=OneOf(get_args(Objective)),
              help="What `descent` minimises: mean or sum of (|a|^2 - 1)^2, or mean of (|a| - 1)^2 (root).  "
                   "[default: mean]")  # fmt: skip
@click.option("--convergence", is_flag=True, help="Also show how `descent` converges (Fig. 9).")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), metavar="N", default=1, show_default=True,
              help="Seed for all random numbers.")  # fmt: skip
@click.option("--json", "as_what", flag_value="json", help="Print a JSON object.")
@click.option("--csv", "as_what", flag_value="csv", help="Print CSV, a row for each parameter.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def command(**values: Any) -> None:
    """Simulate sensors with known errors and compare what each optimizer finds.

    Table 2 of Farago, Maczak, Gingl 2024 (section III.A), with the paper's figures and the
    Cramer-Rao bound next to them. With --rates, --iterations, --objective or --convergence there is one
    more method, the paper's descent in double precision with these numbers.
    """
    numbers = _numbers(values)
    protocol = Protocol(**{name: values[name] for name in Protocol.__dataclass_fields__})
    with progress_bars("simulation", quiet=values["quiet"], unit="cases") as bars:
        more: tuple[Method, ...] = () if numbers is None else (descent(numbers),)
        tables = run(protocol, (*methods(values["labels"]), *more), bars)
        convergences = [
            convergence(plan, numbers, protocol.cases, protocol.seed, bars("convergence", protocol.cases))
            for plan in protocol.plans()
            if numbers is not None and values["convergence"]
        ]
    exit_codes.show(_shown(values["as_what"], protocol, tables, convergences))


def _numbers(values: dict[str, Any]) -> DescentNumbers | None:
    """Return the numbers of the descent, if it is asked for; raises UsageError unless rates are three."""
    names = ("rates", "iterations", "objective")
    stated = {name: values[name] for name in names if values[name] is not None}
    if len(stated.get("rates", (0, 0, 0))) != 3:
        hint = "give three: --rates 0.3,0.8,0.2"
        raise UsageError("--rates are those of scale, misalignment and offset", hint=hint)
    return DescentNumbers(**stated) if stated or values["convergence"] else None


def _shown(
    as_what: str | None, protocol: Protocol, tables: tuple[ErrorTable, ...], convergences: list[Convergence]
) -> str:
    if as_what == "json":
        found = as_json(protocol, tables)
        if convergences:
            found["convergence"] = list(map(convergence_json, convergences))
        return json.dumps(found, allow_nan=False)
    if as_what == "csv":
        return csv_text(COLUMNS, rows(tables)).rstrip("\n")
    return "\n".join(
        [*_lines(protocol, tables), *(line for one in convergences for line in _convergence_lines(one))]
    )


def _convergence_lines(found: Convergence) -> Iterator[str]:
    """Yield the lines of a table of convergence."""
    yield from ("", f"Convergence of {NAME} with {found.points} points, noise {found.noise_mg:g} mg")
    if not found.cases:
        yield "It diverges in all cases."
        return
    yield "Largest distance from the last iteration's in units of 1e-4: median, 90th percentile"
    groups = next(iter(found.left.values()), {})
    head = ("iteration", *(f"{name}{end}" for name in groups for end in ("", " p90")))
    yield aligned(
        head,
        [
            (str(number), *_scaled([value for one in row.values() for value in one.values()]))
            for number, row in found.left.items()
        ],
    )
    for limit, one in found.within.items():
        after = " and ".join(formatted(value, ".0f") for value in one.values())
        yield f"All nine stay within {limit:g} of it after {after} iterations (median, 90th percentile)."
    if found.diverged:
        yield f"It diverges in {found.diverged} more cases."
