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
from math import log, sqrt

import numpy as np

from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.linear import inverse
from accelcal_cli.core.points import (
    PENALTY_BITS,
    WEIGHT_ONE,
    Fit,
    Model,
    PenalizedFit,
    PenalizedFitter,
    Penalty,
    PointSet,
)
from accelcal_cli.core.prior import Prior
from accelcal_cli.judge.errors import worst_direction_mg
from accelcal_cli.judge.model_ladder import FitFunction

ROUNDS = 60
"""Bound on the rounds of noise and penalties; about ten settle them."""

PENALTY_DIGITS = 10
"""Leading bits of a penalty: with fewer it settles sooner, and nothing depends on its last bits."""

ODD_ONES = 20
"""One in so many sensors is taken to be unlike what others say of it."""

NOISE_RANGE = 50
"""Noise is sought within so many times the usual one, and its inverse."""


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
        postures: how many were fitted.
        penalty: the prior at its parameters, as the fit had it; that of a part of the points is the same.
        noise_g: standard deviation of |a| from posture to posture [g].
        freedom: degrees of freedom of that noise.
        covariance: of the free parameters (slopes per scaled degree), and of the bend where there is one.
        bend: of a sensor whose response is bent; None of one that is as the model says.
    """

    model: Model
    found: PenalizedFit
    postures: int
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
    expected = _expected(prior, points)
    noise_g, start, before = 2 * prior.noise_g, IDENTITY, None
    for _ in range(ROUNDS):
        penalty = _penalty(points, postures, expected, prior.freedom, noise_g, start)
        if penalty == before:
            break
        found, before = fitter(points, model, penalty, start), penalty
        start = found.fit.parameters
        used = _used(found, _inverse(points, found, penalty))
        noise_g, freedom = noise(used, found.mean_square, postures, prior)
    found = fitter(points, model, penalty, IDENTITY)
    unit = 4 * noise_g * noise_g / postures
    covariance = tuple(tuple(unit * value for value in row) for row in _inverse(points, found, penalty))
    return Posterior(model, found, postures, penalty, noise_g, freedom, covariance)


@dataclass(frozen=True, slots=True)
class _Expected:
    """A prior in the units of the fit: twelve fixed-point parameters, and their scale parameters."""

    centre: tuple[int, ...]
    widths: tuple[float, ...]


def speaks_against(
    learnt: Posterior, usual: Posterior, priors: tuple[Prior, Prior], points: PointSet
) -> bool:
    """Whether points are so much likelier with the population's prior that the learnt one is not for them.

    One sensor in ODD_ONES was hit, or swapped, or is unlike others of its model.

    Args:
        priors: of the two posteriors of these points.
    """
    ours, theirs = (
        _log_evidence(known, prior, points) for known, prior in zip((learnt, usual), priors, strict=True)
    )
    return theirs - ours > log(ODD_ONES)


def _log_evidence(known: Posterior, prior: Prior, points: PointSet) -> float:
    """Logarithm of the probability of the points, but for a constant, by Laplace's approximation."""
    expected, freedom = _expected(prior, points), prior.freedom
    squares = known.postures * known.found.mean_square / (4 * known.noise_g * known.noise_g)
    evidence = -known.postures * log(known.noise_g) - squares / 2
    for index in known.model.free:
        width = expected.widths[index]
        away = (known.found.fit.parameters[index] - expected.centre[index]) / ONE / width
        evidence -= (freedom + 1) / 2 * log(1 + away * away / freedom) + log(width)
    away = log(known.noise_g / prior.noise_g) / prior.noise_spread
    evidence -= (prior.noise_freedom + 1) / 2 * log(1 + away * away / prior.noise_freedom)
    return evidence + float(np.linalg.slogdet(np.array(known.covariance))[1]) / 2


def _expected(prior: Prior, points: PointSet) -> _Expected:
    """The prior at the points' mean temperature, with slopes per scaled degree."""
    scale, centre = points.temperature, list(prior.centre)
    span = 1.0 if scale is None else scale.span_c
    if scale is not None and prior.reference_c is not None:
        warmer = scale.reference_mc / 1000 - prior.reference_c
        centre[6:9] = [offset + warmer * slope for offset, slope in zip(centre[6:9], centre[9:], strict=True)]
    centre[9:] = [slope * span for slope in centre[9:]]
    widths = (*prior.width[:9], *(width * span for width in prior.width[9:]))
    return _Expected(tuple(round(value * ONE) for value in centre), widths)


def _penalty(
    points: PointSet,
    postures: int,
    expected: _Expected,
    freedom: float,
    noise_g: float,
    parameters: tuple[int, ...],
) -> Penalty:
    """The prior as a penalty on the weighted sum of (|a|^2 - 1)^2, whose residuals are twice those of |a|."""
    total = sum(points.weights.tolist()) / WEIGHT_ONE
    unit = 4 * noise_g * noise_g / postures * total
    strength = []
    for value, centre, width in zip(parameters, expected.centre, expected.widths, strict=True):
        away = (value - centre) / ONE / width
        weight = (freedom + 1) / (freedom + away * away)
        strength.append(_short(unit * weight / (width * width)))
    return Penalty(expected.centre, tuple(strength))


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
    away = log_ratio(noise_g, prior.noise_g)
    width, freedom = prior.noise_freedom * prior.noise_spread * prior.noise_spread, prior.noise_freedom + 1
    below = width + away * away
    return freedom * away / below, freedom * (width - away * away) / (below * below)


def log_ratio(one: float, other: float) -> float:
    """The logarithm of a ratio within 50 of 1, by Pade's fraction of its series: the same on all machines."""
    part = (one - other) / (one + other)
    square = part * part
    return 2 * part * (15 - 4 * square) / (15 - 9 * square)
