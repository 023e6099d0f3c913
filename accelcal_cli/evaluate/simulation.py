"""Table 2 of Farago, Maczak, Gingl 2024, section III.A: errors of parameters that are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from accelcal_cli.evaluate.simulated.bound import expected_errors
from accelcal_cli.evaluate.simulated.cases import Plan, Selection, make_case
from accelcal_cli.evaluate.simulated.optimizers import Method
from accelcal_cli.evaluate.simulated.published import TABLE_2, Published
from accelcal_cli.evaluate.simulated.tally import Scores, Tally

MG = 1e-3


@dataclass(frozen=True, slots=True)
class Protocol:
    """What is simulated.

    Attributes:
        cases: number of sensors, each with its own points.
        seed: of everything random.
        points: numbers of points, a table for each.
        noise_mg: standard deviations of the noise on each axis, a table for each.
        selection: `subsets`: F's collector takes the points from a stream; `random`: any.
    """

    cases: int = 500
    seed: int = 1
    points: tuple[int, ...] = (18, 144, 432)
    noise_mg: tuple[float, ...] = (1.0, 5.0)
    selection: Selection = "subsets"

    def plans(self) -> list[Plan]:
        """A plan for each table; raises UsageError where nine subsets cannot share the points."""
        plans = [
            Plan(number, noise * MG, self.selection) for number in self.points for noise in self.noise_mg
        ]
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
        """The largest ratio of a mean error to the paper's; None where either has none."""
        if self.published is None or not scores.fitted:
            return None
        pairs = zip(scores.mean, self.published.mean, strict=True)
        return max(mean / paper for mean, paper in pairs if mean is not None)


Step = Callable[[int], None]
"""Called with the number of cases done."""


def run(
    protocol: Protocol, methods: tuple[Method, ...], progress: Callable[[str, int], Step]
) -> tuple[Table, ...]:
    """A table for each number of points and size of noise; raises UsageError."""
    return tuple(
        _table(protocol, plan, methods, progress(f"{plan.number} points", protocol.cases))
        for plan in protocol.plans()
    )


def _table(protocol: Protocol, plan: Plan, methods: tuple[Method, ...], step: Step) -> Table:
    tallies, bounds = [Tally(method) for method in methods], []
    for index in range(protocol.cases):
        case = make_case(plan, protocol.seed, index)
        bounds.append(expected_errors(case.still_g, case.truth, plan.noise_g))
        for tally in tallies:
            tally.take(case, bounds[-1])
        step(index + 1)
    bound = tuple(np.mean(bounds, axis=0).tolist())
    scores = tuple(tally.scores() for tally in tallies)
    noise_mg = round(plan.noise_g / MG, 9)
    return Table(plan.number, noise_mg, bound, TABLE_2.get(noise_mg), scores)
