"""What came of one method's fits."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from statistics import median
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import Fit, Operations
from accelcal_cli.evaluate.simulated.cases import Case
from accelcal_cli.evaluate.simulated.optimizers import Method

Real = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Scores:
    """One method's errors over all cases that it could fit.

    Attributes:
        mean, sd: of the absolute errors of the nine parameters; None where not fitted.
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
    errors: list[Real] = field(default_factory=list)
    bounds: list[Real] = field(default_factory=list)
    fits: list[Fit] = field(default_factory=list)
    failures: Counter[str] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)

    def take(self, case: Case, bound: Real) -> None:
        """Fit a case; a fit that fails is counted."""
        began = perf_counter()
        try:
            found = self.method.fit(case.points)
        except DivergedError as error:
            self.failures[error.message] += 1
            return
        self.seconds.append(perf_counter() - began)
        self.fits.append(found)
        self.errors.append(np.subtract(found.parameters, case.truth)[:9] / ONE)
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
