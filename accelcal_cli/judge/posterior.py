"""The most probable calibration of a recording, given what sensors are like, and how uncertain it is.

A few hours of wear determine some combinations of the parameters well and others hardly at all. A prior says
how far sensors are off: what the points determine, they determine; what they leave open stays near the ideal
sensor, and how wrong that may be is known. Noise is the scatter of whole postures (breathing, soft tissue,
hysteresis), estimated together with the parameters.

The fit is integers; what steers it (noise, penalties) is made of them by additions, multiplications,
divisions and roots in a fixed order, so that it is the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.linear import inverse
from accelcal_cli.core.points import (
    IDENTITY,
    PENALTY_BITS,
    WEIGHT_ONE,
    Fit,
    Model,
    PenalizedFit,
    PenalizedFitter,
    Penalty,
    PointSet,
)
from accelcal_cli.judge.errors import worst_direction_mg
from accelcal_cli.judge.model_ladder import FitFunction

ROUNDS = 60
"""Bound on the rounds of noise and penalties; about ten settle them."""

PENALTY_DIGITS = 10
"""Leading bits of a penalty: with fewer it settles sooner, and nothing depends on its last bits."""

MG = 1e-3

NOISE_RANGE = 50
"""Noise is sought within so many times the usual one, and its inverse."""


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of sensors before any point is seen.

    Each parameter has a Student's t distribution: heavy tails, since some sensors are far off.

    Attributes:
        scale, misalignment: scale parameter of the distribution, of entries of K about the ideal ones.
        offset_g: of the offsets, about 0 [g].
        slope_g_per_c: of their slopes, about 0 [g per degree C].
        freedom: degrees of freedom.
        noise_g: usual scatter of postures [g].
        noise_spread: scale parameter of the distribution of its logarithm, which has heavy tails, too.
        noise_freedom: that distribution's degrees of freedom.
    """

    scale: float
    misalignment: float
    offset_g: float
    slope_g_per_c: float
    freedom: float
    noise_g: float
    noise_spread: float
    noise_freedom: float


POPULATION = Prior(
    scale=0.018,
    misalignment=0.013,
    offset_g=0.035,
    slope_g_per_c=0.001,
    freedom=4.0,
    noise_g=1.5 * MG,
    noise_spread=0.3,
    noise_freedom=2.0,
)
"""Wrist and body-worn accelerometers at large; docs/prior.md says how it was chosen."""


@dataclass(frozen=True, slots=True)
class Bend:
    """What straightens the response of a sensor that is not a straight line: v + c v^power, axis by axis.

    Attributes:
        c: of raw x, y, z, in g.
    """

    power: int
    c: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Posterior:
    """The most probable parameters and what is known of them.

    Attributes:
        found: the fit, and what lies around it.
        penalty: the prior at its parameters, as the fit had it; that of a part of the points is the same.
        noise_g: standard deviation of |a| from posture to posture [g].
        freedom: degrees of freedom of that noise.
        covariance: of the free parameters (slopes per scaled degree), and of the bend where there is one.
        bend: of a sensor whose response is bent; None of one that is as the model says.
    """

    model: Model
    found: PenalizedFit
    penalty: Penalty
    noise_g: float
    freedom: float
    covariance: tuple[tuple[float, ...], ...]
    bend: Bend | None = None

    def fitter(self, penalized: PenalizedFitter) -> FitFunction:
        """A fit of parts of the points, with the same noise and prior."""

        def fits(sets: Sequence[PointSet], model: Model) -> list[Fit]:
            return [penalized(points, model, self.penalty, IDENTITY).fit for points in sets]

        return fits

    def standard_errors(self) -> tuple[float, ...]:
        """Of the twelve parameters, 0 where not free; slopes per scaled degree."""
        errors = [0.0] * len(IDENTITY)
        for place, index in enumerate(self.model.free):
            errors[index] = sqrt(self.covariance[place][place])
        return tuple(errors)

    def worst_direction_mg(self) -> float:
        """Largest standard error of |a| over directions of the sphere."""
        free = list(self.model.free)
        return worst_direction_mg(self.found.fit.parameters, free, np.array(self.covariance))


def posterior(
    points: PointSet, postures: int, model: Model, prior: Prior, fitter: PenalizedFitter
) -> Posterior:
    """The most probable parameters of a model.

    The result is that of the last penalty from the ideal sensor: points and penalty give its bits again.
    Parameters, noise and the weight of each parameter's prior (the usual way to fit with Student's t:
    Lange, Little, Taylor 1989) are found in turn until none changes.

    Args:
        postures: how many there are; each counts as one independent observation.

    Raises:
        DivergedError, FixedPointOverflowError: the fit does.
    """
    widths = _widths(prior, points)
    noise_g, start, before = 2 * prior.noise_g, IDENTITY, None
    for _ in range(ROUNDS):
        penalty = _penalty(points, postures, widths, prior.freedom, noise_g, start)
        if penalty == before:
            break
        found, before = fitter(points, model, penalty, start), penalty
        start = found.fit.parameters
        used = _used(found, _inverse(points, found, penalty))
        noise_g, freedom = noise(used, found.mean_square, postures, prior)
    found = fitter(points, model, penalty, IDENTITY)
    unit = 4 * noise_g * noise_g / postures
    covariance = tuple(tuple(unit * value for value in row) for row in _inverse(points, found, penalty))
    return Posterior(model, found, penalty, noise_g, freedom, covariance)


def _widths(prior: Prior, points: PointSet) -> list[float]:
    """Scale parameter of each of the twelve parameters; slopes per scaled degree."""
    span = 1.0 if points.temperature is None else points.temperature.span_c
    kinds = (prior.scale, prior.misalignment, prior.offset_g, prior.slope_g_per_c * span)
    return [width for width in kinds for _ in range(3)]


def _penalty(
    points: PointSet,
    postures: int,
    widths: list[float],
    freedom: float,
    noise_g: float,
    parameters: tuple[int, ...],
) -> Penalty:
    """The prior as a penalty on the weighted sum of (|a|^2 - 1)^2, whose residuals are twice those of |a|."""
    total = sum(points.weights.tolist()) / WEIGHT_ONE
    unit = 4 * noise_g * noise_g / postures * total
    strength = []
    for value, ideal, width in zip(parameters, IDENTITY, widths, strict=True):
        away = (value - ideal) / ONE / width
        weight = (freedom + 1) / (freedom + away * away)
        strength.append(_short(unit * weight / (width * width)))
    return Penalty(IDENTITY, tuple(strength))


def _short(value: float) -> int:
    """In units of 2**-PENALTY_BITS, with few leading bits; at least one."""
    whole = round(value * (1 << PENALTY_BITS))
    drop = max(0, whole.bit_length() - PENALTY_DIGITS)
    return max(1, whole >> drop << drop)


def _inverse(points: PointSet, found: PenalizedFit, penalty: Penalty) -> list[list[float]]:
    """Inverse of the curvature with the prior: the free parameters' covariance but for its scale."""
    total = sum(points.weights.tolist()) / WEIGHT_ONE
    around = [list(row) for row in found.curvature]
    for place, index in enumerate(found.model.free):
        around[place][place] += penalty.strength[index] / (1 << PENALTY_BITS) / total
    return inverse(around)


def _used(found: PenalizedFit, spread: list[list[float]]) -> float:
    """How many postures the parameters use up: trace(H), where H takes the residuals' place in the fit."""
    pairs = zip(found.curvature, zip(*spread, strict=True), strict=True)
    return float(sum(one * other for row, column in pairs for one, other in zip(row, column, strict=True)))


def noise(used: float, mean_square: float, postures: int, prior: Prior) -> tuple[float, float]:
    """The noise [g] that residuals and prior speak for, and its degrees of freedom.

    Args:
        used: how many postures the parameters use up.
        mean_square: weighted mean of (|a|^2 - 1)^2.
    """
    surplus = postures - used
    noise_g = _noise_g(surplus, postures * mean_square / 4, prior)
    return noise_g, max(1.0, max(surplus, 0.0) + _pull(noise_g, prior)[1] / 2)


def _noise_g(surplus: float, squares: float, prior: Prior) -> float:
    """The noise that the residuals speak for, drawn to the usual one by as much as they leave open.

    Where n is the number of postures beyond those that the parameters use up, S the sum of their squared
    residuals and x the logarithm of s over the usual noise, it solves n - S / s^2 + pull(x) = 0. The pull of
    a heavy-tailed distribution fades: a sensor that is far quieter than others is believed.
    """
    low, high = prior.noise_g / NOISE_RANGE, prior.noise_g * NOISE_RANGE
    for _ in range(60):
        middle = sqrt(low * high)
        if surplus - squares / (middle * middle) + _pull(middle, prior)[0] < 0:
            low = middle
        else:
            high = middle
    return sqrt(low * high)


def _pull(noise_g: float, prior: Prior) -> tuple[float, float]:
    """First and second derivative of the noise's prior by its logarithm."""
    part = (noise_g - prior.noise_g) / (noise_g + prior.noise_g)
    square = part * part
    away = 2 * part * (15 - 4 * square) / (15 - 9 * square)  # the logarithm, by Pade's fraction of its series
    width, freedom = prior.noise_freedom * prior.noise_spread * prior.noise_spread, prior.noise_freedom + 1
    below = width + away * away
    return freedom * away / below, freedom * (width - away * away) / (below * below)
