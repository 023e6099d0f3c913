"""Misfits: behaviour of a sensor that the twelve parameters cannot describe, found on held-out postures.

A response that is bent with the cube of the acceleration, scales that change with temperature, offsets that
do so on a curve, or that depend on the posture before: the fit absorbs the part that looks like its own
parameters, and the rest looks like scatter of the postures. Each misfit is added to the fit in turn, linearly
about the calibration, and believed if it is significant in enough postures, if held-out postures confirm it,
and if parts of the postures show it, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE, mean, standard_error, student_t_probability, three
from accelcal_cli.core.points import WEIGHT_ONE, PointSet
from accelcal_cli.core.results import Misfit, MisfitKind
from accelcal_cli.judge.errors import jacobian, residuals
from accelcal_cli.judge.model_ladder import folds
from accelcal_cli.judge.posterior import Posterior, columns, noise

LEAST_MG = 3.0
"""Size [mg] that a misfit must reach in some direction to be believed."""

LEAST_FALL = 0.15
"""Share by which the error on held-out postures must fall."""

CHANCE = 0.02
"""Probability of such a fall by chance (Student's t, of either sign) above which it is not believed: four
kinds are looked for in each recording."""

FEWEST_POSTURES = 12
"""Postures that a misfit needs to be believed: fewer hardly determine parameters and misfit together."""

SURE = 2.0
"""Standard errors that a misfit must exceed on some axis."""

SURE_WITHOUT_A_FOLD, SURE_OF_A_HALF = 1.25, 0.5
"""Standard errors that it must exceed on the same side of that axis by four folds of five, and by each half
of the postures; chosen by simulation (docs/change.md)."""

WIDTH_BEND, WIDTH_GAIN_PER_C, WIDTH_CURVE_G_PER_C2, WIDTH_PREVIOUS = 0.01, 5e-4, 2e-4, 0.01
"""Usual sizes, as scale parameters of priors; those of bends and of the previous posture are for 1 g."""

ROUNDS = 3
"""Rounds in which the noise is estimated again, together with a misfit."""

_OFFSETS = slice(6, 9)

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MisfitHypothesis:
    """A misfit that a sensor may have, corrected by c on x, y, z.

    Attributes:
        columns: (n, 3) d(|a|^2 - 1)/dc at each point.
        width: scale parameter of the prior of each c.
        unit, factor: the misfit itself is -c times the factor, in this unit.
    """

    kind: MisfitKind
    columns: Floats
    width: float
    unit: str
    factor: float


class MisfitSearch:
    """Looks for misfits in the points of a recording.

    Args:
        label: (n,) posture number of each point.
        known: the fit to these points.
        number: number of folds.
    """

    def __init__(self, points: PointSet, label: NDArray[np.int64], known: Posterior, number: int) -> None:
        self._points, self._label, self._known = points, label, known
        self._fold = folds(label, number)
        self._tau = None if points.tau is None else points.tau / ONE
        fit, straight = known.found.fit, points.straightened(known.found.fit.bend).xyz_g()
        self._all = jacobian(straight, self._tau, fit.parameters)
        self._rows = columns(points.xyz_g(), known, self._tau)
        self._error = -residuals(straight, self._tau, fit.parameters)
        self._weights = points.weights / WEIGHT_ONE
        self._postures = int(label.max()) + 1
        self._centre = -known.from_centre()
        self._still = self._held_out(None)

    def misfits(self) -> tuple[Misfit, ...]:
        """Return all kinds of misfits that the points allow to be tested, found or not."""
        return tuple(self._misfit(hypothesis) for hypothesis in self._hypotheses())

    def _hypotheses(self) -> Iterator[MisfitHypothesis]:
        offsets, points = self._all[:, _OFFSETS], self._points
        g = points.xyz_g()
        yield MisfitHypothesis("cubic", offsets * g**3, WIDTH_BEND, "percent at 1 g", 100)
        if self._known.model.has_temperature and self._tau is not None and points.temperature is not None:
            tau, span = self._tau[:, np.newaxis], points.temperature.span_c
            by_gain = offsets * g * tau
            yield MisfitHypothesis(
                "gain by temperature", by_gain, WIDTH_GAIN_PER_C * span, "percent per degree C", 100 / span
            )
            curve, width = offsets * tau * tau, WIDTH_CURVE_G_PER_C2 * span * span
            yield MisfitHypothesis(
                "curved by temperature", curve, width, "mg per square degree C", 1000 / (span * span)
            )
        if points.previous is not None:
            before = offsets * (points.previous / ONE)
            yield MisfitHypothesis("previous posture", before, WIDTH_PREVIOUS, "mg per g", 1000)

    def _misfit(self, hypothesis: MisfitHypothesis) -> Misfit:
        after = self._held_out(hypothesis)
        c, errors, noise_g = self._together(hypothesis)
        largest = float(500 * np.abs(hypothesis.columns @ c).max())
        significant = self._postures >= FEWEST_POSTURES and self._lasts(hypothesis, noise_g, c, errors)
        return Misfit(
            hypothesis.kind,
            hypothesis.unit,
            three((-hypothesis.factor * c).tolist()),
            three((hypothesis.factor * errors).tolist()),
            mean(self._still),
            mean(after),
            largest,
            significant and largest >= LEAST_MG and _falls(self._still, after),
        )

    def _lasts(self, hypothesis: MisfitHypothesis, noise_g: float, c: Floats, errors: Floats) -> bool:
        """Return True if some axis is far from 0 by all postures, and on the same side by parts of them."""
        side, far = np.sign(c), np.abs(c) > SURE * errors
        parts = [(self._fold != fold, SURE_WITHOUT_A_FOLD) for fold in sorted(set(self._fold.tolist()))]
        parts += [(self._label % 2 == half, SURE_OF_A_HALF) for half in (0, 1)]
        for which, times in parts:
            moved, around = self._fit(hypothesis, which, noise_g)
            own = np.sqrt(self._unit(noise_g) * np.diag(np.linalg.inv(around))[-3:])
            far &= side * moved[-3:] > times * own
        return bool(far.any())

    def _together(self, hypothesis: MisfitHypothesis) -> tuple[Floats, Floats, float]:
        """Fit parameters and misfit together; return c, its standard errors, and the noise that is left."""
        noise_g, everything = self._known.noise_g, np.ones(len(self._label), np.bool_)
        full = np.column_stack([self._rows, hypothesis.columns])
        for _ in range(ROUNDS):
            moved, around = self._fit(hypothesis, everything, noise_g)
            left = self._error - full @ moved
            squares = float((self._weights * left * left).sum()) / float(self._weights.sum())
            curvature = (full * self._weights[:, np.newaxis]).T @ full
            used = float(np.trace(np.linalg.solve(around, curvature)))
            noise_g = noise(used, squares, self._postures, self._known.prior)
        errors = np.sqrt(self._unit(noise_g) * np.diag(np.linalg.inv(around))[-3:])
        return np.asarray(moved[-3:]), errors, noise_g

    def _unit(self, noise_g: float) -> float:
        """Return the variance of |a|^2 of a point of weight 1: each posture is one observation."""
        return 4 * noise_g * noise_g / self._postures * float(self._weights.sum())

    def _held_out(self, hypothesis: MisfitHypothesis | None) -> list[float]:
        """Return the mean error of each posture [mg] by a fit of the other folds."""
        full = self._rows if hypothesis is None else np.column_stack([self._rows, hypothesis.columns])
        left = np.empty(len(self._label))
        for fold in sorted(set(self._fold.tolist())):
            out = self._fold == fold
            moved, _ = self._fit(hypothesis, ~out, self._known.noise_g)
            left[out] = self._error[out] - full[out] @ moved
        errors = np.bincount(self._label, 500 * np.abs(left) * self._weights)
        by_posture: list[float] = (errors / np.bincount(self._label, self._weights)).tolist()
        return by_posture

    def _fit(
        self, hypothesis: MisfitHypothesis | None, which: NDArray[np.bool_], noise_g: float
    ) -> tuple[Floats, Floats]:
        """Return the change of the parameters and c, and the curvature with their priors."""
        known, full, centre = self._known, self._rows, self._centre
        strength = known.precision() * self._unit(noise_g)
        if hypothesis is not None:
            full = np.column_stack([full, hypothesis.columns])
            own = self._unit(noise_g) / (hypothesis.width * hypothesis.width)
            strength, centre = np.append(strength, [own] * 3), np.append(centre, [0.0] * 3)
        weighted = full[which] * self._weights[which, np.newaxis]
        around = weighted.T @ full[which] + np.diag(strength)
        moved = np.linalg.solve(around, weighted.T @ self._error[which] + strength * centre)
        return np.asarray(moved), np.asarray(around)


def _falls(before: list[float], after: list[float]) -> bool:
    """Return True if the errors of postures [mg] fall clearly, and by a share of LEAST_FALL or more."""
    fall = [one - other for one, other in zip(before, after, strict=True)]
    by_chance = student_t_probability(mean(fall) / max(standard_error(fall), 1e-9), len(fall) - 1)
    return by_chance <= CHANCE and mean(fall) >= LEAST_FALL * mean(before)
