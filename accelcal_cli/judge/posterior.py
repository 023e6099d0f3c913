"""The most probable calibration of a recording, given what sensors are like, and how uncertain it is.

A few hours of wear determine some combinations of the parameters well and others hardly at all. A prior says
how far sensors are off: what the points leave open stays near the ideal sensor, and how wrong that may be is
known. Noise is the scatter of whole postures (breathing, soft tissue, hysteresis), estimated together with
the parameters.

Held-out postures say how wrong a calibration is where the wrist has been. Its error over the whole sphere
follows from the posterior: sensors are drawn from it, and each is calibrated, to first order, and compared
with 1 g. The scatter of rests is not an error of the calibration, and is left out.

The fit is integers; noise and penalties are computed by additions, multiplications, divisions and roots in a
fixed order, so that they are the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import log, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE, inverse, quantile, three
from accelcal_cli.core.calibration import IDENTITY, PARAMETER_NAMES, Calibration, in_standard_g
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import (
    MODELS,
    PENALTY_BITS,
    WEIGHT_ONE,
    Fit,
    Model,
    PenalizedFit,
    PenalizedFitter,
    Penalty,
    PointSet,
    Saturated,
)
from accelcal_cli.core.prior import Prior
from accelcal_cli.core.results import Outcome, SphereError
from accelcal_cli.judge.errors import directions, jacobian, worst_direction_mg
from accelcal_cli.judge.model_ladder import FitFunction

ROUNDS = 60
"""Most rounds of noise and penalties; about ten settle them."""

PENALTY_DIGITS = 10
"""Leading bits of a penalty: with few it settles sooner, and nothing depends on its last bits."""

ODD_ONES = 20
"""Number of sensors among which one is assumed to be unlike the others of its model or its own past."""

FAR = 2.0
"""Widths of the prior beyond which a sensor is unlike most; other parameters may then be as far off."""

_SCALES_AND_OFFSETS = (0, 1, 2, 6, 7, 8)

NOISE_RANGE = 50
"""Factor by which the noise may be larger or smaller than the usual one."""

WIDTH_FREEDOM = 2.0
"""Degrees of freedom of the prior's width, which all parameters share; docs/prior.md has what it is worth."""

DRAWN_NOISE_RANGE = 10
"""Factor by which a drawn noise may be larger or smaller than the most probable one."""

CHAINS, SETTLING, KEPT = 250, 10, 4
"""Chains by which sensors are drawn from the posterior, and steps of each that are left out and kept: 1000
draws give the ends of the interval to about 3 % of its width."""

SURE = 0.95
"""Probability to be better than raw values, everywhere and where the wrist has been, of a provisional fit."""

SEED = 20181
TAIL = 0.025
"""Share of the draws beyond each end of the interval."""

BEND_ROUNDS = 4
"""Iterations that invert a bend of a few percent to 1e-7 g."""

Floats = NDArray[np.float64]


class _Scaled(NamedTuple):
    """A prior in the units of the fit: twelve fixed-point parameters, and their scale parameters."""

    centre: tuple[int, ...]
    widths: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Bend:
    """Straightens the response of a sensor that is not linear: v + c v^power, axis by axis.

    Attributes:
        c: one for each of raw x, y, z in g.
    """

    power: int
    c: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Posterior:
    """The most probable parameters and their uncertainty.

    Attributes:
        found: the fit, with the curvature there.
        postures: number of postures that were fitted.
        prior: what was known of sensors beforehand.
        penalty: the prior at these parameters, as the fit used it; fits to parts of the points use the same.
        held: the precision of the free parameters by that penalty alone (slopes per scaled degree).
        noise_g: standard deviation of |a| from posture to posture [g].
        covariance: that of the free parameters (slopes per scaled degree), and of the bend if there is one.
        bend: None for a sensor with a linear response.
    """

    model: Model
    found: PenalizedFit
    postures: int
    prior: Prior
    penalty: Penalty
    held: tuple[float, ...]
    noise_g: float
    covariance: tuple[tuple[float, ...], ...]
    bend: Bend | None = None

    def fitter(self, penalized: PenalizedFitter) -> FitFunction:
        """Return a function that fits parts of the points, with the same noise and prior."""

        def fits(sets: Sequence[PointSet], model: Model) -> list[Fit]:
            return [penalized(points, model, self.penalty, IDENTITY).fit for points in sets]

        return fits

    def standard_errors(self) -> tuple[float, ...]:
        """Return those of the twelve parameters, 0 where not free; slopes per scaled degree."""
        errors = [0.0] * len(IDENTITY)
        for place, index in enumerate(self.model.free):
            errors[index] = sqrt(self.covariance[place][place])
        return tuple(errors)

    def rest_scatter_mg(self) -> float:
        """Return the mean | |a| - 1 g | that the scatter of rests makes, without any error of the sensor."""
        return 1000 * self.noise_g * sqrt(2 / pi)

    def parameters_outside_prior(self) -> list[str]:
        """Return the names of scales and offsets beyond FAR widths of the prior."""
        found, centre = self.found.fit.parameters, self.penalty.centre
        kinds = [index for index in self.model.free if index in _SCALES_AND_OFFSETS]
        far = [j for j in kinds if abs(found[j] - centre[j]) > FAR * self.prior.width[j] * ONE]
        return [PARAMETER_NAMES[index] for index in far]

    def worst_direction_mg(self) -> float:
        """Return the largest standard error of |a| over directions of the sphere [mg]."""
        free = list(self.model.free)
        return worst_direction_mg(self.found.fit.parameters, free, np.array(self.covariance))


def posterior(
    points: PointSet, postures: int, model: Model, prior: Prior, fitter: PenalizedFitter
) -> Posterior:
    """Find the most probable parameters of a model.

    Parameters, noise and the weight of each parameter's prior (the usual way to fit with Student's t:
    Lange, Little, Taylor 1989) are found in turn until none changes. The result is the fit with the last
    penalty from the ideal sensor, so that points and penalty reproduce its bits.

    Args:
        postures: number of postures, each of which counts as one independent observation.

    Raises:
        DivergedError, FixedPointOverflowError: the fit raises it.
    """
    scaled, total = _scaled(prior, points), sum(points.weights.tolist()) / WEIGHT_ONE
    noise_g, start, before = 2 * prior.noise_g, IDENTITY, None
    for _ in range(ROUNDS):
        penalty = _penalty(scaled, prior.freedom, 4 * noise_g * noise_g / postures * total, start)
        if penalty == before:
            break
        found, before = fitter(points, model, penalty, start), penalty
        start = found.fit.parameters
        spread = _inverse(points, found, penalty)
        pairs = zip(found.curvature, zip(*spread, strict=True), strict=True)
        # trace(H), with H the projection of the residuals on the fit: the postures that parameters use up
        used = sum(one * other for row, column in pairs for one, other in zip(row, column, strict=True))
        noise_g = noise(used, found.mean_square, postures, prior)
    found = fitter(points, model, penalty, IDENTITY)
    unit = 4 * noise_g * noise_g / postures
    covariance = tuple(tuple(unit * value for value in row) for row in _inverse(points, found, penalty))
    held = tuple(value / unit for value in _strengths(points, model, penalty))
    return Posterior(model, found, postures, prior, penalty, held, noise_g, covariance)


def speaks_against(
    learnt: Posterior, usual: Posterior, priors: tuple[Prior, Prior], points: PointSet
) -> bool:
    """Return True if points are so much likelier with the population's prior that the learnt one is wrong.

    One sensor in ODD_ONES was hit, or swapped, or is unlike others of its model.

    Args:
        priors: those of the two posteriors of these points.
    """
    ours, theirs = _log_evidence(learnt, priors[0], points), _log_evidence(usual, priors[1], points)
    return theirs - ours > log(ODD_ONES)


def _log_evidence(known: Posterior, prior: Prior, points: PointSet) -> float:
    """Return the log probability of the points, up to a constant, by Laplace's approximation."""
    (centres, widths), freedom = _scaled(prior, points), prior.freedom
    squares = known.postures * known.found.mean_square / (4 * known.noise_g * known.noise_g)
    evidence = -known.postures * log(known.noise_g) - squares / 2
    for index in known.model.free:
        width = widths[index]
        away = (known.found.fit.parameters[index] - centres[index]) / ONE / width
        evidence -= (freedom + 1) / 2 * log(1 + away * away / freedom) + log(width)
    away = log(known.noise_g / prior.noise_g) / prior.noise_spread
    evidence -= (prior.noise_freedom + 1) / 2 * log(1 + away * away / prior.noise_freedom)
    return evidence + float(np.linalg.slogdet(np.array(known.covariance))[1]) / 2


def _scaled(prior: Prior, points: PointSet) -> _Scaled:
    """Convert a prior to the points' mean temperature, with slopes per scaled degree."""
    scale, centre = points.temperature, list(prior.centre)
    span = 1.0 if scale is None else scale.span_c
    if scale is not None and prior.reference_c is not None:
        warmer = scale.reference_mc / 1000 - prior.reference_c
        centre[6:9] = [offset + warmer * slope for offset, slope in zip(centre[6:9], centre[9:], strict=True)]
    centre[9:] = [slope * span for slope in centre[9:]]
    widths = (*prior.width[:9], *(width * span for width in prior.width[9:]))
    return _Scaled(tuple(round(value * ONE) for value in centre), widths)


def _penalty(scaled: _Scaled, freedom: float, unit: float, parameters: tuple[int, ...]) -> Penalty:
    """Convert a prior to a penalty on the sum of (|a|^2 - 1)^2, whose residuals are twice those of |a|.

    Args:
        unit: the variance of (|a|^2 - 1) of a point that weighs 1.
    """
    strength = []
    for value, centre, width in zip(parameters, scaled.centre, scaled.widths, strict=True):
        away = (value - centre) / ONE / width
        weight = (freedom + 1) / (freedom + away * away)
        whole = round(unit * weight / (width * width) * (1 << PENALTY_BITS))
        drop = max(0, whole.bit_length() - PENALTY_DIGITS)
        strength.append(max(1, whole >> drop << drop))
    return Penalty(scaled.centre, tuple(strength))


def _inverse(points: PointSet, found: PenalizedFit, penalty: Penalty) -> list[list[float]]:
    """Return the inverse of the curvature with the prior: the covariance up to its scale."""
    around = [list(row) for row in found.curvature]
    for place, strength in enumerate(_strengths(points, found.model, penalty)):
        around[place][place] += strength
    return inverse(around)


def _strengths(points: PointSet, model: Model, penalty: Penalty) -> list[float]:
    """Return the curvature of a penalty along each free parameter, with points that weigh 1 in all."""
    total = sum(points.weights.tolist()) / WEIGHT_ONE
    return [penalty.strength[index] / (1 << PENALTY_BITS) / total for index in model.free]


def noise(used: float, mean_square: float, postures: int, prior: Prior) -> float:
    """Return the most probable noise [g], given residuals and prior.

    With n the number of postures beyond those that the parameters use up, S the sum of their squared
    residuals and x the logarithm of s over the usual noise, it solves n - S / s^2 + pull(x) = 0. The pull of
    a heavy-tailed distribution fades: a sensor that is far quieter than others is believed.

    Args:
        used: number of postures that the parameters use up.
        mean_square: weighted mean of (|a|^2 - 1)^2.
    """
    surplus, squares = postures - used, postures * mean_square / 4
    low, high = prior.noise_g / NOISE_RANGE, prior.noise_g * NOISE_RANGE
    for _ in range(60):
        middle = sqrt(low * high)
        if surplus - squares / (middle * middle) + _pull(middle, prior)[0] < 0:
            low = middle
        else:
            high = middle
    return sqrt(low * high)


def _pull(noise_g: float, prior: Prior) -> tuple[float, float]:
    """Return the first and second derivative of the noise's prior by its logarithm."""
    away = log_ratio(noise_g, prior.noise_g)
    width, freedom = prior.noise_freedom * prior.noise_spread * prior.noise_spread, prior.noise_freedom + 1
    below = width + away * away
    return freedom * away / below, freedom * (width - away * away) / (below * below)


def log_ratio(one: float, other: float) -> float:
    """Return the log of a ratio within 1/50 to 50, by a Pade approximant: the same bits on every machine."""
    part = (one - other) / (one + other)
    square = part * part
    return 2 * part * (15 - 4 * square) / (15 - 9 * square)


def sphere_errors(
    points: PointSet,
    label: NDArray[np.int64],
    known: Posterior,
    judged: Sequence[tuple[int, ...]],
    saturated: Saturated = (),
) -> list[SphereError]:
    """Return mean | |a| - 1 g | of calibrations over all directions, at the points' mean temperature.

    It is the error of the coefficients, without the scatter of rests. Raw values have the same sensors drawn,
    so that the probability to be better than they are is known.

    Args:
        points: those of the posterior; label: posture number of each, (n,).
        judged: twelve fixed-point parameters of each calibration: those of the posterior, of a simpler model,
            or of the ideal sensor.
        saturated: axes that measure nothing beyond a value.
    """
    drawn = _drawn(known, _independent(points))
    best, bend = known.found.fit.parameters, known.bend
    g, postures = points.xyz_g(), [label == one for one in sorted(set(label.tolist()))]
    visited = np.asarray([np.average(g[own], axis=0, weights=points.weights[own]) for own in postures])
    true = (_raw_directions(best), _straight(visited, bend))
    raw = (_as_measured(_bent(true[0], bend), saturated), _as_measured(visited, saturated))
    moved = [
        _lengths(where, best) + drawn @ (_columns(at, known) / 2).T
        for where, at in zip(true, raw, strict=True)
    ]
    errors = [
        [np.abs(_lengths(where, parameters) - ideal) for where, ideal in zip(raw, moved, strict=True)]
        for parameters in (IDENTITY, *judged)
    ]
    return [_summary(*of_one, *errors[0]) for of_one in errors[1:]]


def outcome_by_error(sphere: SphereError, before: SphereError, limit_mg: float, *, clearly: bool) -> Outcome:
    """Return the outcome of a fit with a prior, by its error over all directions and that of raw values.

    Args:
        clearly: True if held-out postures show that it is better than they are.
    """
    if clearly and sphere.mean < limit_mg:
        return Outcome.CALIBRATED
    if sphere.probably_better() >= SURE:
        return Outcome.PROVISIONAL
    return Outcome.ALREADY_GOOD if before.mean < limit_mg else Outcome.REFUSED


def largest_error_mg(known: Posterior, judged: tuple[int, ...]) -> float:
    """Return the largest | |a| - 1 g | over all directions of the most probable sensor, calibrated [mg]."""
    raw = _bent(_raw_directions(known.found.fit.parameters), known.bend)
    return float(1000 * np.abs(_lengths(raw, judged) - 1).max())


def _bent(straight: Floats, bend: Bend | None) -> Floats:
    """Return what a sensor with a bend measures instead of vectors (n, 3) in g."""
    if bend is None:
        return straight
    measured, c = straight, np.array(bend.c)
    for _ in range(BEND_ROUNDS):
        measured = straight - c * measured**bend.power
    return measured


def _straight(measured: Floats, bend: Bend | None) -> Floats:
    """Remove the bend from measured vectors (n, 3) in g."""
    return measured if bend is None else measured + np.array(bend.c) * measured**bend.power


def _columns(measured: Floats, known: Posterior) -> Floats:
    """Return d(|a|^2 - 1)/dp of the free parameters, and of a bend, at raw vectors (n, 3)."""
    rows = jacobian(_straight(measured, known.bend), None, known.found.fit.parameters)
    own = rows[:, list(known.model.free)]
    if known.bend is None:
        return own
    return np.column_stack([own, rows[:, 6:9] * measured**known.bend.power])


def _summary(everywhere: Floats, visited: Floats, raw_everywhere: Floats, raw_visited: Floats) -> SphereError:
    """Summarise errors [g] of draws in all directions, (DRAWS, 162), and in the postures, (DRAWS, p)."""
    of_directions, of_draws = everywhere.mean(axis=0), everywhere.mean(axis=1)
    worst = int(of_directions.argmax())
    ordered = sorted(of_draws.tolist())
    return SphereError(
        mean=1000 * float(of_draws.mean()),
        ci95=(1000 * quantile(ordered, TAIL), 1000 * quantile(ordered, 1 - TAIL)),
        worst_direction=1000 * float(of_directions[worst]),
        worst_direction_at=three(directions()[worst].tolist()),
        better_everywhere=float((of_draws < raw_everywhere.mean(axis=1)).mean()),
        better_where_worn=float((visited.mean(axis=1) < raw_visited.mean(axis=1)).mean()),
    )


def _raw_directions(parameters: tuple[int, ...]) -> Floats:
    """Return what a sensor with these parameters measures at rest in all directions, (162, 3) in g."""
    p = [value / ONE for value in parameters]
    true = directions()
    x = true[:, 0] / p[0]
    y = (true[:, 1] - p[3] * x) / p[1]
    z = (true[:, 2] - p[4] * x - p[5] * y) / p[2]
    return np.stack([x - p[6], y - p[7], z - p[8]], axis=1)


def _as_measured(raw: Floats, saturated: Saturated) -> Floats:
    """Limit raw vectors as a sensor that saturates does."""
    measured = raw.copy()
    for axis, limit_g in saturated:
        bound = np.minimum if limit_g > 0 else np.maximum
        measured[:, axis] = bound(measured[:, axis], limit_g)
    return measured


def _independent(points: PointSet) -> float:
    """Return the number of points, or fewer if some weigh more than others."""
    weights = points.weights.astype(np.float64)
    return float(weights.sum() ** 2 / (weights**2).sum())


def drawn_sensors(known: Posterior, points: PointSet, number: int, seed: int) -> list[tuple[int, ...]]:
    """Draw sensors from the posterior, each by a chain of its own: twelve fixed-point parameters of each.

    The first of many are those of few. What a library may add up in another order is far below the last bit
    of a parameter.

    Args:
        points: those of the posterior.
        seed: of the chains, from 0 to 2**32 - 1.
    """
    random, steps, free = np.random.RandomState(seed), SETTLING + 1, known.model.free
    normal, chi2 = np.empty((steps, number, 16)), np.empty((steps, number))
    for chain in range(number):
        normal[:, chain] = random.standard_normal((steps, 16))
        chi2[:, chain] = random.chisquare(WIDTH_FREEDOM + len(free), steps)
    moved = _drawn(known, _independent(points), (normal, chi2))
    drawn = np.tile(np.array(known.found.fit.parameters), (number, 1))
    drawn[:, list(free)] += np.rint(moved[:, : len(free)] * ONE).astype(np.int64)
    return [tuple(row) for row in drawn.tolist()]


def _drawn(known: Posterior, most: float, numbers: tuple[Floats, Floats] | None = None) -> Floats:
    """Draw free parameters less the best ones, (DRAWS, free), by Gibbs sampling.

    The prior is the fit's, but its width is drawn: by one factor for all parameters, with the tails of
    Student's t, so that a sensor whose fitted parameters are far off may be as far off in what the points
    leave open. The noise is drawn, too. Whether rests of one posture share their error is not known: half of
    the chains take each posture for one observation, as the fit does, the others each point.

    The parameters are turned so that points and prior are independent along each of them; `share` is the
    prior's part of what is known there.

    Args:
        most: number of observations if rests of one posture do not share their error.
        numbers: random ones as of `_random`, if not these.
    """
    normals, chi2s = _random(WIDTH_FREEDOM + len(known.model.free)) if numbers is None else numbers
    chains = normals.shape[1]
    factor = np.linalg.cholesky(np.array(known.covariance))
    free, held, away = known.model.free, np.zeros(len(factor)), np.zeros(len(factor))
    held[: len(free)] = known.held
    away[: len(free)] = [(known.found.fit.parameters[j] - known.penalty.centre[j]) / ONE for j in free]
    share, turn = np.linalg.eigh(factor.T * held @ factor)
    share = np.clip(share, 0, 1)
    basis = factor @ turn
    pull, apart = basis.T @ (held * away), float(held @ (away * away))
    noise = _NoiseDraws.of(known, float((1 - share).sum()), most, chains)
    # the points pull no harder than residuals allow: (r j)^2 is at most r^2 j^2 of residuals r, column j
    slope = np.clip(pull, -np.sqrt(noise.left * (1 - share)), np.sqrt(noise.left * (1 - share)))
    moved, found, ratio = np.zeros((chains, len(factor))), [], noise.observed
    for normal, chi2 in zip(normals, chi2s, strict=True):
        width = chi2 / (WIDTH_FREEDOM + apart + (moved * (share * moved + 2 * pull)).sum(axis=1))
        width, ratio = width[:, np.newaxis], ratio[:, np.newaxis]
        precision = ratio * (1 - share) + width * share
        apart_by_chance = normal[:, : len(factor)] @ turn / np.sqrt(precision)
        moved = (ratio * slope - width * pull) / precision + apart_by_chance
        squares = (moved * ((1 - share) * moved - 2 * slope)).sum(axis=1)
        ratio = noise.ratio(squares, normal[:, -1])
        found.append(moved)
    return np.asarray(np.concatenate(found[SETTLING:]) @ basis.T)


@dataclass(frozen=True, slots=True, eq=False)
class _NoiseDraws:
    """Knowledge of each chain about the noise, whose best value is 1 here.

    Attributes:
        observed: (chains,) number of observations, relative to postures.
        left: sum of the squared residuals of the fit.
        freedom, squares: the prior as more observations, and the sum of their squares.
    """

    postures: int
    observed: Floats
    left: float
    freedom: float
    squares: float

    @classmethod
    def of(cls, known: Posterior, used: float, most: float, chains: int) -> _NoiseDraws:
        """Match the prior of the noise by its slope and curvature at the best one."""
        slope, curvature = _pull(known.noise_g, known.prior)
        squares = max(curvature, 0.0) / 2
        times = np.where(np.arange(chains) % 2, max(1.0, most / known.postures), 1.0)
        left = max(known.postures - used + slope, 0.0)
        return cls(known.postures, times, left, slope + squares, squares)

    def ratio(self, squares: Floats, normal: Floats) -> Floats:
        """Draw the noise of each chain; return observations over its square, (chains,).

        A chi-squared variable is drawn by its cube root (Wilson, Hilferty 1931).

        Args:
            squares: by how much the draw's sum of squares is above that of the fit; normal: (chains,).
        """
        freedom = np.maximum(self.observed * self.postures + self.freedom, 1.0)
        part = 2 / (9 * freedom)
        chi2 = freedom * np.maximum(1 - part + normal * np.sqrt(part), 0.1) ** 3
        total = self.observed * np.maximum(self.left + squares, 0.0) + self.squares
        bound = DRAWN_NOISE_RANGE**2
        return np.asarray(self.observed * np.clip(chi2 / np.maximum(total, 1e-9), 1 / bound, bound))


@cache
def _random(freedom: float) -> tuple[Floats, Floats]:
    """Return normal and chi-squared numbers, (steps, CHAINS, 16) and (steps, CHAINS); always the same."""
    random, steps = np.random.RandomState(SEED), SETTLING + KEPT
    return random.standard_normal((steps, CHAINS, 16)), random.chisquare(freedom, (steps, CHAINS))


def _lengths(raw: Floats, parameters: tuple[int, ...]) -> Floats:
    """Return |a| of raw vectors, (n,)."""
    p = [value / ONE for value in parameters]
    x, y, z = (raw[:, axis] + p[6 + axis] for axis in range(3))
    ax, ay, az = p[0] * x, p[3] * x + p[1] * y, p[4] * x + p[5] * y + p[2] * z
    return np.asarray(np.sqrt(ax * ax + ay * ay + az * az))


# Calibrations in standard g: of a fit, and of sensors that its posterior holds plausible.
#
# What is computed from calibrated values is as uncertain as the calibration: the same computation
# with each of many plausible calibrations shows by how much, also where it is far from linear, as
# ENMO is at rest.


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSensors:
    """The sensors of a posterior of points in units of local gravity; see `PlausibleSensors`.

    A bend of the response, which no coefficients correct, takes no part.
    """

    known: Posterior
    points: PointSet
    gravity: Gravity

    def draws(self, number: int, seed: int) -> list[Calibration]:
        """See `PlausibleSensors`."""
        drawn = drawn_sensors(self.known, self.points, number, seed)
        return [_in_standard_units(self.known.model, one, self.points, self.gravity) for one in drawn]


def calibration_of_fit(model: str, fit: Fit, points: PointSet, gravity: Gravity) -> Calibration:
    """Return the calibration of a fit to points in units of local gravity, in standard g."""
    return _in_standard_units(MODELS[model], fit.parameters, points, gravity)


def _in_standard_units(
    model: Model, parameters: tuple[int, ...], points: PointSet, gravity: Gravity
) -> Calibration:
    scale = points.temperature if model.has_temperature else None
    return Calibration(model.name, in_standard_g(parameters, gravity.local_g()), scale, gravity)
