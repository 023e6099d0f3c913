"""The most probable calibration of a recording, given what sensors are like, and how uncertain it is.

A few hours of wear determine some combinations of the parameters well and others hardly at all. A prior says
how far sensors are off: what the points leave open stays near the ideal sensor, and how wrong that may be is
known. Noise is the scatter of whole postures (breathing, soft tissue, hysteresis), estimated together with
the parameters.

Held-out postures say how wrong a calibration is where the wrist has been. Its error over the whole sphere
follows from the posterior: sensors are drawn from it, and each is calibrated, to first order, and compared
with 1 g.

The fit is integers; noise and penalties are computed by additions, multiplications, divisions and roots in a
fixed order, so that they are the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import erf, exp, log, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import ONE, inverse
from accelcal_cli.core.calibration import IDENTITY
from accelcal_cli.core.points import (
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
from accelcal_cli.core.results import SphereError
from accelcal_cli.core.statistics import quantile
from accelcal_cli.judge.errors import directions, jacobian, worst_direction_mg
from accelcal_cli.judge.model_ladder import FitFunction

ROUNDS = 60
"""Most rounds of noise and penalties; about ten settle them."""

PENALTY_DIGITS = 10
"""Leading bits of a penalty: with few it settles sooner, and nothing depends on its last bits."""

ODD_ONES = 20
"""Number of sensors among which one is assumed to be unlike the others of its model or its own past."""

NOISE_RANGE = 50
"""Factor by which the noise may be larger or smaller than the usual one."""

DRAWS = 1000
"""Sensors drawn from the posterior: their number gives the ends of the interval to about 2 % of its width."""

SEED = 20181
TAIL = 0.025
"""Share of the draws beyond each end of the interval."""

BEND_ROUNDS = 4
"""Iterations that invert a bend of a few percent to 1e-7 g."""

LARGEST_RATIO = 6.0
"""Error in standard deviations of the noise beyond which noise does not change a mean error."""

STEPS = 100
"""Entries of the table of mean errors in one standard deviation."""

TOGETHER = 50
"""Draws that are worked on at a time, so that intermediate values stay in the processor's cache."""

Floats = NDArray[np.float64]


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
        penalty: the prior at these parameters, as the fit used it; fits to parts of the points use the same.
        noise_g: standard deviation of |a| from posture to posture [g].
        freedom: degrees of freedom of that noise.
        covariance: that of the free parameters (slopes per scaled degree), and of the bend if there is one.
        bend: None for a sensor with a linear response.
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
        """Return a function that fits parts of the points, with the same noise and prior."""

        def fits(sets: Sequence[PointSet], model: Model) -> list[Fit]:
            found = []
            for points in sets:
                found.append(penalized(points, model, self.penalty, IDENTITY).fit)
            return found

        return fits

    def standard_errors(self) -> tuple[float, ...]:
        """Return those of the twelve parameters, 0 where not free; slopes per scaled degree."""
        errors = [0.0] * len(IDENTITY)
        for place, index in enumerate(self.model.free):
            errors[index] = sqrt(self.covariance[place][place])
        return tuple(errors)

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
    scaled = _scaled(prior, points)
    noise_g, start, before = 2 * prior.noise_g, IDENTITY, None
    for _ in range(ROUNDS):
        penalty = _penalty(points, postures, scaled, prior.freedom, noise_g, start)
        if penalty == before:
            break
        found, before = fitter(points, model, penalty, start), penalty
        start = found.fit.parameters
        spread = _inverse(points, found, penalty)
        pairs = zip(found.curvature, zip(*spread, strict=True), strict=True)
        # trace(H), with H the projection of the residuals on the fit: the postures that parameters use up
        used = sum(one * other for row, column in pairs for one, other in zip(row, column, strict=True))
        noise_g, freedom = noise(used, found.mean_square, postures, prior)
    found = fitter(points, model, penalty, IDENTITY)
    unit = 4 * noise_g * noise_g / postures
    covariance = tuple(tuple(unit * value for value in row) for row in _inverse(points, found, penalty))
    return Posterior(model, found, postures, penalty, noise_g, freedom, covariance)


@dataclass(frozen=True, slots=True)
class _ScaledPrior:
    """A prior in the units of the fit: twelve fixed-point parameters, and their scale parameters."""

    centre: tuple[int, ...]
    widths: tuple[float, ...]


def speaks_against(
    learnt: Posterior, usual: Posterior, priors: tuple[Prior, Prior], points: PointSet
) -> bool:
    """Return True if points are so much likelier with the population's prior that the learnt one is wrong.

    One sensor in ODD_ONES was hit, or swapped, or is unlike others of its model.

    Args:
        priors: those of the two posteriors of these points.
    """
    ours, theirs = (
        _log_evidence(known, prior, points) for known, prior in zip((learnt, usual), priors, strict=True)
    )
    return theirs - ours > log(ODD_ONES)


def _log_evidence(known: Posterior, prior: Prior, points: PointSet) -> float:
    """Return the log probability of the points, up to a constant, by Laplace's approximation."""
    scaled, freedom = _scaled(prior, points), prior.freedom
    squares = known.postures * known.found.mean_square / (4 * known.noise_g * known.noise_g)
    evidence = -known.postures * log(known.noise_g) - squares / 2
    for index in known.model.free:
        width = scaled.widths[index]
        away = (known.found.fit.parameters[index] - scaled.centre[index]) / ONE / width
        evidence -= (freedom + 1) / 2 * log(1 + away * away / freedom) + log(width)
    away = log(known.noise_g / prior.noise_g) / prior.noise_spread
    evidence -= (prior.noise_freedom + 1) / 2 * log(1 + away * away / prior.noise_freedom)
    return evidence + float(np.linalg.slogdet(np.array(known.covariance))[1]) / 2


def _scaled(prior: Prior, points: PointSet) -> _ScaledPrior:
    """Convert a prior to the points' mean temperature, with slopes per scaled degree."""
    scale, centre = points.temperature, list(prior.centre)
    span = 1.0 if scale is None else scale.span_c
    if scale is not None and prior.reference_c is not None:
        warmer = scale.reference_mc / 1000 - prior.reference_c
        centre[6:9] = [offset + warmer * slope for offset, slope in zip(centre[6:9], centre[9:], strict=True)]
    centre[9:] = [slope * span for slope in centre[9:]]
    widths = (*prior.width[:9], *(width * span for width in prior.width[9:]))
    return _ScaledPrior(tuple(round(value * ONE) for value in centre), widths)


def _penalty(
    points: PointSet,
    postures: int,
    scaled: _ScaledPrior,
    freedom: float,
    noise_g: float,
    parameters: tuple[int, ...],
) -> Penalty:
    """Convert a prior to a penalty on the sum of (|a|^2 - 1)^2, whose residuals are twice those of |a|."""
    total = sum(points.weights.tolist()) / WEIGHT_ONE
    unit = 4 * noise_g * noise_g / postures * total
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
    total = sum(points.weights.tolist()) / WEIGHT_ONE
    around = [list(row) for row in found.curvature]
    for place, index in enumerate(found.model.free):
        around[place][place] += penalty.strength[index] / (1 << PENALTY_BITS) / total
    return inverse(around)


def noise(used: float, mean_square: float, postures: int, prior: Prior) -> tuple[float, float]:
    """Return the most probable noise [g], given residuals and prior, and its degrees of freedom.

    Args:
        used: number of postures that the parameters use up.
        mean_square: weighted mean of (|a|^2 - 1)^2.
    """
    surplus = postures - used
    noise_g = _noise_g(surplus, postures * mean_square / 4, prior)
    return noise_g, max(1.0, max(surplus, 0.0) + _pull(noise_g, prior)[1] / 2)


def _noise_g(surplus: float, squares: float, prior: Prior) -> float:
    """Return the most probable noise [g], given the residuals and the prior.

    With n the number of postures beyond those that the parameters use up, S the sum of their squared
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

    The interval allows for where the wrist will go: its low end (2.5 %) is for one that spends an unknown
    share of its time in the postures where it has been, its high end (97.5 %) for one that goes everywhere.

    Args:
        points: those of the posterior; label: posture number of each, (n,).
        judged: twelve fixed-point parameters of each calibration: those of the posterior, of a simpler model,
            or of the ideal sensor.
        saturated: axes that measure nothing beyond a value.
    """
    noise, drawn = _drawn(known)
    best, bend = known.found.fit.parameters, known.bend
    visited = _posture_means(points, label)
    true = (_raw_directions(best), _straight(visited, bend))
    raw = (_as_measured(_bent(true[0], bend), saturated), _as_measured(visited, saturated))
    scatter = [drawn @ (_columns(where, known) / 2).T for where in raw]
    lengths = [_lengths(where, best) for where in true]
    found = []
    for parameters in judged:
        shifts = [_lengths(where, parameters) - length for where, length in zip(raw, lengths, strict=True)]
        means = [_mean_error(shift - moved, noise) for shift, moved in zip(shifts, scatter, strict=True)]
        found.append(_summary(*means))
    return found


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


def _summary(everywhere: Floats, visited: Floats) -> SphereError:
    """Summarise mean errors [g] of draws, in all directions (DRAWS, 162) and in the postures (DRAWS, p)."""
    of_directions, of_draws = everywhere.mean(axis=0), everywhere.mean(axis=1)
    worst = int(of_directions.argmax())
    share = _normal()[1]
    partly = share * visited.mean(axis=1) + (1 - share) * of_draws
    low = min(quantile(sorted(draws.tolist()), TAIL) for draws in (partly, of_draws))
    high = quantile(sorted(of_draws.tolist()), 1 - TAIL)
    x, y, z = directions()[worst].tolist()
    return SphereError(
        mean=1000 * float(of_directions.mean()),
        ci95=(1000 * low, 1000 * high),
        worst_direction=1000 * float(of_directions[worst]),
        worst_direction_at=(x, y, z),
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


def _posture_means(points: PointSet, label: NDArray[np.int64]) -> Floats:
    """Return the raw mean of each posture, (postures, 3) in g."""
    g = points.xyz_g()
    keys = sorted(set(label.tolist()))
    rows = [np.average(g[label == key], axis=0, weights=points.weights[label == key]) for key in keys]
    return np.asarray(rows)


def _drawn(known: Posterior) -> tuple[Floats, Floats]:
    """Draw sensors: their noise, (DRAWS, 1) in g, and free parameters less the best ones, (DRAWS, free).

    The noise is drawn by the cube-root approximation of a chi-squared variable (Wilson, Hilferty 1931).
    """
    normal, _ = _normal()
    share = 2 / (9 * known.freedom)
    ratio = np.maximum(1 - share + normal[:, :1] * sqrt(share), 0.1) ** 3
    covariance = np.array(known.covariance)
    free = normal[:, 1 : 1 + len(covariance)] @ np.linalg.cholesky(covariance).T
    return known.noise_g / np.sqrt(ratio), free


@cache
def _normal() -> tuple[Floats, Floats]:
    """Return standard normal numbers, (DRAWS, 16), and uniform ones, (DRAWS,); always the same."""
    random = np.random.RandomState(SEED)
    normal, uniform = random.standard_normal((DRAWS, 13)), random.uniform(size=DRAWS)
    return np.column_stack([normal, random.standard_normal((DRAWS, 3))]), uniform


def _lengths(raw: Floats, parameters: tuple[int, ...]) -> Floats:
    """Return |a| of raw vectors, (n,)."""
    p = [value / ONE for value in parameters]
    x, y, z = (raw[:, axis] + p[6 + axis] for axis in range(3))
    ax, ay, az = p[0] * x, p[3] * x + p[1] * y, p[4] * x + p[5] * y + p[2] * z
    return np.asarray(np.sqrt(ax * ax + ay * ay + az * az))


def _mean_error(deviations: Floats, noise: Floats) -> Floats:
    """Return the mean of |d + noise| for each deviation d, (DRAWS, n): folded normal distributions."""
    found = np.empty_like(deviations)
    for first in range(0, len(deviations), TOGETHER):
        rows = slice(first, first + TOGETHER)
        ratio = np.abs(deviations[rows]) / noise[rows]
        found[rows] = np.where(ratio < LARGEST_RATIO, _tabulated(ratio), ratio) * noise[rows]
    return found


def _tabulated(ratio: Floats) -> Floats:
    """Interpolate linearly in the table of mean errors; not valid beyond its end.

    The bits are those of np.interp, which would search for the place that the even steps already tell.
    """
    places, values, slopes = _mean_error_table()
    before = (np.fmin(ratio, LARGEST_RATIO) * STEPS + 0.5).astype(np.intp)  # the nearest place
    before -= places[before] > ratio
    np.minimum(before, len(slopes) - 1, out=before)
    return np.asarray(slopes[before] * (ratio - places[before]) + values[before])


@cache
def _mean_error_table() -> tuple[Floats, Floats, Floats]:
    """Return t from 0 to LARGEST_RATIO, means of |t + a standard normal number|, and the slopes between."""
    places = np.linspace(0, LARGEST_RATIO, round(LARGEST_RATIO * STEPS) + 1)
    means = [sqrt(2 / pi) * exp(-t * t / 2) + t * erf(t / sqrt(2)) for t in places.tolist()]
    return places, np.array(means), np.diff(means) / np.diff(places)
