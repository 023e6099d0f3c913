"""The most probable calibration of a recording, given what sensors are like, and how uncertain it is.

A few hours of wear determine some combinations of the parameters well and others hardly at all. A prior says
how far sensors are off: what the points leave open stays near the ideal sensor, and how wrong that may be is
known. Noise is the scatter of whole postures (breathing, soft tissue, hysteresis), estimated together with
the parameters.

Held-out postures say how wrong a calibration is where the wrist has been. Its error over the whole sphere
follows from the posterior: sensors are drawn from it, and each is calibrated, to first order, and compared
with 1 g. The scatter of rests is not an error of the calibration, and is left out.

The response of a sensor may be bent: v + q v^2 takes the place of v, axis by axis (Ang, Khosla, Riviere 2007,
IEEE Sensors J. 7, 81-88). Most sensors hardly are, so a narrow prior keeps q near 0 where the points do not
speak for it. It is fitted with the other parameters, in turn: by a Gauss-Newton step for the bend, then by
the fit of the straightened points.

The fit is integers; noise, penalties and bend are computed by additions, multiplications, divisions and roots
in a fixed order, so that they are the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import exp, log, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE, cholesky, inverse, quantile, three
from accelcal_cli.core.calibration import (
    IDENTITY,
    NO_BEND,
    PARAMETER_NAMES,
    Bend,
    Calibration,
    in_standard_g,
    scaled,
)
from accelcal_cli.core.gravity import Gravity
from accelcal_cli.core.points import (
    MODELS,
    PENALTY_BITS,
    WEIGHT_ONE,
    Fit,
    Model,
    Operations,
    PenalizedFit,
    PenalizedFitter,
    Penalty,
    PointSet,
    Saturated,
)
from accelcal_cli.core.prior import Prior
from accelcal_cli.core.results import Outcome, SphereError, UncertaintyPart, UncertaintySource
from accelcal_cli.judge.errors import directions, jacobian, residuals, worst_direction_mg
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

WIDTHS, SHARES = (0.6, 1.2, 3.0), (0.3, 0.5, 0.2)
"""Width of the drawn prior, times that of the fit's, which all parameters share: a few, with the share of the
sensors that are alike, usual and odd; docs/prior.md has what they are worth."""

DRAWN_NOISE_RANGE = 10
"""Factor by which a drawn noise may be larger or smaller than the most probable one."""

CHAINS, SETTLING, KEPT = 250, 10, 4
"""Chains by which sensors are drawn from the posterior, and steps of each that are left out and kept: 1000
draws give the ends of the interval to about 3 % of its width."""

SURE, LIKELY = 0.9, 0.8
"""Probabilities to be better than raw values, and below the limit, by which a fit is calibrated; and of being
better, by which it is provisional (docs/prior.md)."""

IDEAL = Fit(IDENTITY, 0, "nothing to fit", Operations())
"""The ideal sensor, by which raw values are judged."""

SEED = 20181
TAIL, GOLDEN = 0.025, (sqrt(5) - 1) / 2
"""Share of the draws beyond each end of the interval; step that deals chains to the widths of bends."""

BEND_BITS, BEND_STEPS, PART_ROUNDS, MOST_BEND = 20, 3, 3, 0.1
"""Fraction bits of a bend that is fitted, rounds in which its noise settles and in which a part of the points
is fitted, and its largest size [per g]."""

BENDS, BEND_SHARES = (0.0005, 0.003, 0.01), (0.8, 0.12, 0.08)
"""Widths [per g] that the bends of sensors have, and the share of the sensors that have each."""

NOISE_FREEDOM, CHANCE_ONE = 4.0, 1024
"""Postures that the usual noise counts like where hypotheses are compared; parts that probabilities are
rounded to, so that the last bits of a logarithm do not matter."""

SUM_BITS = 24
"""Fraction bits of the products whose exact sums are the slope and curvature along the bend."""

BENT = ("9", "9T")
"""Models whose sensors may be bent."""

LINEAR_SHARE = 0.6
"""Part of a bend that looks like an offset over all directions: x^3 is nearest to 0.6 x on the sphere."""

Floats = NDArray[np.float64]


class _Scaled(NamedTuple):
    """A prior in the units of the fit: twelve fixed-point parameters, and their scale parameters."""

    centre: tuple[int, ...]
    widths: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Posterior:
    """The most probable parameters and their uncertainty.

    Attributes:
        found: the fit, with the curvature there.
        postures: number of postures that were fitted.
        prior: what was known of sensors beforehand.
        penalty: the prior at these parameters, as the fit used it; fits to parts of the points use the same.
        noise_g: standard deviation of |a| from posture to posture [g].
        pull: slope of the log probability of the points along all that is fitted: the free parameters (slopes
            per scaled degree), then the bend for models BENT.
        usual: precision of the free parameters by the widths of the prior.
        chances: probability of each of BENDS.
        information: that of the points on them; covariance: theirs, by points and prior.
    """

    model: Model
    found: PenalizedFit
    postures: int
    prior: Prior
    penalty: Penalty
    noise_g: float
    pull: tuple[float, ...]
    usual: tuple[float, ...]
    chances: tuple[float, ...]
    information: tuple[tuple[float, ...], ...]
    covariance: tuple[tuple[float, ...], ...]

    def fitter(self, penalized: PenalizedFitter) -> FitFunction:
        """Return a function that fits parts of the points, with the same noise and prior."""

        def fits(sets: Sequence[PointSet], model: Model) -> list[Fit]:
            task, whole = _Task(model, self.postures, self.prior, penalized), self.found.fit
            return [self._part(task, points, whole.parameters, whole.bend) for points in sets]

        return fits

    def _part(self, task: _Task, points: PointSet, start: tuple[int, ...], bend: Bend) -> Fit:
        """Fit a part of the points, which has a bend of its own, from where the whole is."""
        for _ in range(PART_ROUNDS):
            state = _fit_at_bend(task, points, self.penalty, self.noise_g, start, bend)
            if state.moved() == bend:
                break
            start, bend = state.found.fit.parameters, state.moved()
        return state.found.fit

    @property
    def bent(self) -> bool:
        """True if a bend was fitted, too."""
        return bool(self.chances)

    def precision(self) -> Floats:
        """Return that of all that is fitted by the prior, of the bend over its widths."""
        return np.array([*self.usual, *((1 / bend_variance(self.chances),) * 3 if self.bent else ())])

    def places(self) -> list[int]:
        """Return the places of what is fitted among the twelve parameters and the bend."""
        return [*self.model.free, *(range(12, 15) if self.bent else ())]

    def from_centre(self) -> Floats:
        """Return what was fitted less the centre of its prior."""
        found, centre = self.found.fit, (*self.penalty.centre, *NO_BEND)
        fitted = (*found.parameters, *found.bend)
        return np.array([(fitted[j] - centre[j]) / ONE for j in self.places()])

    def standard_errors(self) -> tuple[float, ...]:
        """Return those of the twelve parameters, 0 where not free; slopes per scaled degree."""
        errors = [0.0] * len(IDENTITY)
        for place, index in enumerate(self.model.free):
            errors[index] = sqrt(self.covariance[place][place])
        return tuple(errors)

    def covariance_of(self, calibration: Calibration) -> tuple[tuple[float, ...], ...]:
        """Return the covariance of a calibration's parameters, 9 or 12, and of its bend, in its units."""
        local_g, scale = float(calibration.gravity.local_g()), calibration.temperature
        slope = local_g if scale is None else local_g / scale.span_c
        units = [1.0] * 6 + [local_g] * 3 + [slope] * 3 + [1 / local_g] * 3
        whole = np.zeros((len(units), len(units)))
        places = self.places()
        whole[np.ix_(places, places)] = self.covariance
        whole *= np.outer(units, units)
        kept = [*range(9 if scale is None else 12), 12, 13, 14]
        return tuple(map(tuple, whole[np.ix_(kept, kept)].tolist()))

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
        return worst_direction_mg(columns(directions(), self), np.array(self.covariance))


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
    task, noise_g, start, bend = _Task(model, postures, prior, fitter), 2 * prior.noise_g, IDENTITY, NO_BEND
    seen = set[tuple[Penalty, Bend]]()
    while len(seen) < ROUNDS:
        penalty = _penalty(scaled, prior.freedom, 4 * noise_g * noise_g / postures * total, start)
        if (penalty, bend) in seen:
            break
        seen.add((penalty, bend))
        state = _fit_at_bend(task, points, penalty, noise_g, start, bend)
        start, bend = state.found.fit.parameters, state.moved()
        noise_g = noise(state.used(), state.found.mean_square, postures, prior)
    state = _fit_at_bend(task, points, penalty, noise_g, IDENTITY, state.found.fit.bend)
    unit, averaged = 4 * noise_g * noise_g / postures, state.averaged
    information = [[value / unit for value in row] for row in state.found.curvature]
    covariance = inverse(_held(information, state.held)) if averaged is None else averaged.covariance
    return Posterior(
        model,
        state.found,
        postures,
        prior,
        penalty,
        noise_g,
        pull=tuple(-one / unit for one in state.slope),
        usual=tuple(1 / scaled.widths[place] ** 2 for place in model.free),
        chances=() if averaged is None else averaged.chances,
        information=tuple(map(tuple, information)),
        covariance=tuple(map(tuple, covariance)),
    )


class _Task(NamedTuple):
    """All that stays the same while a posterior is found."""

    model: Model
    postures: int
    prior: Prior
    fitter: PenalizedFitter


@dataclass(frozen=True, slots=True, eq=False)
class _FitAtBend:
    """A fit at a bend, and what points and prior say there.

    Attributes:
        slope: half of that of the mean of (|a|^2 - 1)^2 along all that is fitted.
        held: precision of the prior of the free parameters.
        unit: variance of (|a|^2 - 1) of all points together.
        averaged: over the widths of bends; None for a model without.
    """

    found: PenalizedFit
    slope: list[float]
    held: list[float]
    unit: float
    averaged: _Averaged | None

    def moved(self) -> Bend:
        """Return the bend after a step towards its mean."""
        bend = self.found.fit.bend
        steps = (0.0,) * 3 if self.averaged is None else self.averaged.step
        return three(_moved(q, one) for q, one in zip(bend, steps, strict=True))

    def used(self) -> float:
        """Return the postures that parameters use up: trace(H), H the projection of residuals on the fit."""
        bends = [] if self.averaged is None else [1 / bend_variance(self.averaged.chances)] * 3
        strengths = [self.unit * value for value in (*self.held, *bends)]
        spread = inverse(_held(self.found.curvature, strengths))
        return sum(_dot(row, column) for row, column in zip(self.found.curvature, spread, strict=True))


def _fit_at_bend(
    task: _Task, points: PointSet, penalty: Penalty, noise_g: float, start: tuple[int, ...], bend: Bend
) -> _FitAtBend:
    """Fit the parameters to points that a bend straightens; raises what the fitter raises."""
    found = task.fitter(points.straightened(bend), task.model, penalty, start)
    found = replace(found, fit=replace(found.fit, bend=bend))
    unit = 4 * noise_g * noise_g / task.postures
    held = [value / unit for value in _strengths(points, task.model, penalty)]
    away = [(found.fit.parameters[j] - penalty.centre[j]) / ONE for j in task.model.free]
    # at the minimum, the slopes of points and prior along the parameters cancel
    slope = [-unit * one * other for one, other in zip(held, away, strict=True)]
    if task.model.name not in BENT:
        return _FitAtBend(found, slope, held, unit, None)
    found, along = _along_bend(points, found)
    averaged = _averaged(found, [*slope, *along], held, away, task)
    return _FitAtBend(found, [*slope, *along], held, unit, averaged)


def _along_bend(points: PointSet, found: PenalizedFit) -> tuple[PenalizedFit, list[float]]:
    """Return a fit whose curvature has three more rows, of the bend, and half the slope along it.

    The sums are of integers, so the order of the points does not matter.
    """
    straight = points.straightened(found.fit.bend).xyz_g()
    tau = None if points.tau is None else points.tau / ONE
    rows = jacobian(straight, tau, found.fit.parameters)
    error = residuals(straight, tau, found.fit.parameters)[:, np.newaxis]
    rows = np.column_stack([rows[:, list(found.model.free)], rows[:, 6:9] * points.xyz_g() ** 2])
    products = np.column_stack([rows, error])[:, :, np.newaxis] * rows[:, np.newaxis, -3:]
    whole = np.rint(products * (1 << SUM_BITS)).astype(np.int64)
    sums = (whole * points.weights[:, np.newaxis, np.newaxis]).sum(axis=0).tolist()
    unit = sum(points.weights.tolist()) << SUM_BITS
    *cross, slope = [[value / unit for value in row] for row in sums]
    number = len(found.model.free)
    around = [(*row, *cross[place]) for place, row in enumerate(found.curvature)]
    around += [(*(cross[place][axis] for place in range(number)), *cross[number + axis]) for axis in range(3)]
    return replace(found, curvature=tuple(around)), slope


@dataclass(frozen=True, slots=True, eq=False)
class _Averaged:
    """Mean of what is fitted over the widths that bends may have.

    Attributes:
        chances: probability of each width.
        step: by which the bend is off [per g].
        covariance: of all that is fitted, over the widths.
    """

    chances: tuple[float, ...]
    step: list[float]
    covariance: list[list[float]]


def _averaged(
    found: PenalizedFit, slope: list[float], held: list[float], away: list[float], task: _Task
) -> _Averaged:
    """Average the bend over its widths, each as probable as the points are with it (Laplace).

    Args:
        found: with the curvature along the bend.
        slope, held: see `_FitAtBend`; away: from the centre of the prior to the fit.
    """
    size, postures, usual = len(slope), task.postures, NOISE_FREEDOM * task.prior.noise_g**2
    away = [*away, *(q / ONE for q in found.fit.bend)]
    logs, steps, spreads = [], [], []
    for width, share in zip(BENDS, BEND_SHARES, strict=True):
        precision, square = [*held, *(width**-2,) * 3], usual / NOISE_FREEDOM
        for _ in range(BEND_STEPS):
            unit = 4 * square / postures
            around = _held([[value / unit for value in row] for row in found.curvature], precision)
            spread = inverse(around)
            force = [one / unit + p * q for one, p, q in zip(slope, precision, away, strict=True)]
            step = [-_dot(row, force) for row in spread]
            fall = 2 * _dot(slope, step) + _dot([_dot(row, step) for row in found.curvature], step)
            squares = postures * max(found.mean_square + fall, 0.0) / 4
            used = size - sum(strength * spread[place][place] for place, strength in enumerate(precision))
            square = (usual + squares) / (NOISE_FREEDOM + max(postures - used, 0.0))
        there = [one + other for one, other in zip(away, step, strict=True)]
        evidence = log(share) - 3 * log(width) - (NOISE_FREEDOM + postures) / 2 * log(1 + squares / usual)
        evidence -= _dot(precision, [one * one for one in there]) / 2
        logs.append(evidence - sum(log(row[place]) for place, row in enumerate(cholesky(around))))
        steps.append(step)
        spreads.append(spread)
    whole = [round(CHANCE_ONE * exp(one - max(logs))) for one in logs]
    chances = tuple(one / sum(whole) for one in whole)
    mean = [_dot(chances, column) for column in zip(*steps, strict=True)]
    apart = [[one - middle for one, middle in zip(step, mean, strict=True)] for step in steps]
    covariance = [
        [
            _dot(
                chances, [spread[j][k] + off[j] * off[k] for spread, off in zip(spreads, apart, strict=True)]
            )
            for k in range(size)
        ]
        for j in range(size)
    ]
    return _Averaged(chances, mean[-3:], covariance)


def bend_variance(chances: Sequence[float]) -> float:
    """Return the variance of a bend whose widths have some probabilities."""
    return _dot(chances, [width * width for width in BENDS])


def _dot(one: Iterable[float], other: Iterable[float]) -> float:
    return sum(value * factor for value, factor in zip(one, other, strict=True))


def _moved(bend: int, step: float) -> int:
    """Return a bend after a step, in few enough bits for it to settle, and no larger than sensors have."""
    most = round(MOST_BEND * ONE)
    moved = bend + (round(step * (1 << BEND_BITS)) << FRACTION_BITS - BEND_BITS)
    return min(max(moved, -most), most)


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


def _held(curvature: Sequence[Sequence[float]], strengths: Sequence[float]) -> list[list[float]]:
    """Return the curvature of points and prior together."""
    around = [list(row) for row in curvature]
    for place, strength in enumerate(strengths):
        around[place][place] += strength
    return around


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


@dataclass(frozen=True, slots=True, eq=False)
class PossibleChange:
    """One way in which the sensor may have changed while it recorded, and its parameters then.

    Attributes:
        probability: of this one.
        before: share of the time before the change.
        mean: (2 k,) what is fitted, less the best fit, before the change; then by how much it changes.
        factor: (2 k, n) F of their covariance F F^T; n is at most 2 k.
    """

    probability: float
    before: float
    mean: Floats
    factor: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Circumstances:
    """All that decides about an error besides the points.

    Attributes:
        limit_mg: bound on the error.
        gravity_g: standard deviation of local gravity; 0 for a known place.
        changes: ways in which the sensor may have changed.
    """

    limit_mg: float
    gravity_g: float = 0.0
    changes: Sequence[PossibleChange] = ()


def sphere_errors(
    points: PointSet,
    label: NDArray[np.int64],
    known: Posterior,
    judged: Sequence[Fit],
    around: Circumstances,
    saturated: Saturated = (),
) -> list[SphereError]:
    """Return mean | |a| - 1 g | of calibrations over all directions, at the points' mean temperature.

    It is the error of the coefficients, without the scatter of rests; of a sensor that may have changed, the
    mean over the time of the recording. Raw values have the same sensors drawn, so that the probability to be
    better than they are is known.

    Args:
        points: those of the posterior; label: posture number of each, (n,).
        judged: fits of the posterior, of a simpler model, or of the ideal sensor.
        saturated: axes that measure nothing beyond a value.
    """
    drawn = _drawn(known, _independent(points))
    before, after, share = _drawn_changes(drawn, around.changes)
    unknown_g = around.gravity_g * np.random.RandomState(SEED + 1).standard_normal((len(drawn), 1))
    sensor = sensor_of(known.found.fit)
    g, postures = points.xyz_g(), [label == one for one in sorted(set(label.tolist()))]
    visited = np.asarray([np.average(g[own], axis=0, weights=points.weights[own]) for own in postures])
    straight = (_raw_directions(known.found.fit), sensor.straight(visited))
    raw = (_as_measured(sensor.bent(straight[0]), saturated), _as_measured(visited, saturated))
    ideal = [
        [_lengths(where, sensor.parameters) + moved @ (columns(at, known) / 2).T for moved in (before, after)]
        for where, at in zip(straight, raw, strict=True)
    ]
    errors = []
    for calibration in map(sensor_of, (IDEAL, *judged)):
        found = [_lengths(calibration.straight(where), calibration.parameters) + unknown_g for where in raw]
        errors.append(
            [
                share * np.abs(length - one) + (1 - share) * np.abs(length - other)
                for length, (one, other) in zip(found, ideal, strict=True)
            ]
        )
    return [_summary(around.limit_mg, *of_one, *errors[0]) for of_one in errors[1:]]


def uncertainty_budget(known: Posterior, around: Circumstances) -> tuple[UncertaintyPart, ...]:
    """Return the parts of the standard uncertainty of |a| at rest, to first order.

    The part of the bend is its own, and that by which it makes the other parameters less certain.
    """
    true = np.concatenate([directions(), np.eye(3), -np.eye(3)])
    rows = columns(sensor_of(known.found.fit).bent(_raw_directions(known.found.fit, true)), known) / 2
    covariance, number = np.array(known.covariance), len(known.model.free)
    alone, size = np.zeros_like(covariance), len(covariance)
    alone[:number, :number] = np.linalg.inv(np.linalg.inv(covariance)[:number, :number])
    changed = np.zeros_like(covariance)
    for one in around.changes:
        later = np.eye(2 * size)[:size] + np.eye(2 * size)[size:]
        for share, part in ((one.before, np.eye(2 * size)[:size]), (1 - one.before, later)):
            mean, factor = part @ one.mean, part @ one.factor
            changed += one.probability * share * (np.outer(mean, mean) + factor @ factor.T - covariance)
    matrices: dict[UncertaintySource, Floats] = {
        "rests": alone, "bend": covariance - alone, "change": changed,
    }  # fmt: skip
    parts = {
        source: np.maximum(np.einsum("ni,ij,nj->n", rows, matrix, rows), 0.0)
        for source, matrix in matrices.items()
    }
    parts["gravity"] = np.full(len(rows), around.gravity_g**2)
    everywhere, total = len(directions()), np.sum([*parts.values()], axis=0)
    worst, whole = int(np.argmax(total[:everywhere])), float(np.mean(total[:everywhere]))
    return tuple(
        UncertaintyPart(
            source,
            1000 * sqrt(float(variances[:everywhere].mean())),
            three((1000 * np.sqrt((variances[-6:-3] + variances[-3:]) / 2)).tolist()),
            1000 * sqrt(float(variances[worst])),
            100 * float(variances[:everywhere].mean()) / whole,
        )
        for source, variances in parts.items()
    )


def _drawn_changes(drawn: Floats, changes: Sequence[PossibleChange]) -> tuple[Floats, Floats, Floats]:
    """Return draws before and after a change, each (DRAWS, k), and the share of time before, (DRAWS, 1)."""
    before, after, share = drawn.copy(), drawn.copy(), np.ones((len(drawn), 1))
    if changes:
        random, number = np.random.RandomState(SEED + 2), len(drawn)
        normal = random.standard_normal((number, 2 * drawn.shape[1]))
        chance = (random.permutation(number) + 0.5) / number
        ends = np.cumsum([one.probability for one in changes])
        which = np.searchsorted(ends, chance)
        for index, change in enumerate(changes):
            own = which == index
            moved = change.mean + normal[own, : change.factor.shape[1]] @ change.factor.T
            before[own] = moved[:, : drawn.shape[1]]
            after[own] = before[own] + moved[:, drawn.shape[1] :]
            share[own] = change.before
    return before, after, share


def sensor_of(fit: Fit) -> Calibration:
    """Return what corrects a fitted sensor, in units of its points, at their mean temperature."""
    return Calibration("", (*fit.parameters[:9], 0, 0, 0), bend=fit.bend)


def outcome_by_probability(sphere: SphereError, before: SphereError) -> Outcome:
    """Return the outcome of a fit with a prior, by its error over all directions and that of raw values."""
    better = sphere.probably_better()
    if better >= SURE and sphere.below_limit >= SURE:
        return Outcome.CALIBRATED
    if better >= LIKELY:
        return Outcome.PROVISIONAL
    return Outcome.ALREADY_GOOD if before.below_limit >= LIKELY else Outcome.REFUSED


def columns(measured: Floats, known: Posterior, tau: Floats | None = None) -> Floats:
    """Return d(|a|^2 - 1)/dp of all that is fitted, at raw vectors (n, 3) and scaled temperatures (n,)."""
    rows = jacobian(sensor_of(known.found.fit).straight(measured), tau, known.found.fit.parameters)
    own = rows[:, list(known.model.free)]
    return np.column_stack([own, rows[:, 6:9] * measured**2]) if known.bent else own


def _summary(
    limit_mg: float, everywhere: Floats, visited: Floats, raw_everywhere: Floats, raw_visited: Floats
) -> SphereError:
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
        below_limit=float((1000 * of_draws <= limit_mg).mean()),
    )


def _raw_directions(fit: Fit, true: Floats | None = None) -> Floats:
    """Return straightened raw vectors (n, 3) of a sensor at rest [g], in some directions or in all 162."""
    p = [value / ONE for value in fit.parameters]
    true = directions() if true is None else true
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


def drawn_sensors(
    known: Posterior, points: PointSet, used: Bend, number: int, seed: int
) -> list[tuple[int, ...]]:
    """Draw sensors from the posterior, each by a chain of its own: twelve fixed-point parameters of each.

    All are for values that one bend straightens; what theirs differs by is drawn as the offset that is
    nearest to it on the sphere. The first of many are those of few. What a library may add up in another
    order is far below the last bit of a parameter.

    Args:
        points: those of the posterior.
        used: that bend.
        seed: of the chains, from 0 to 2**32 - 1.
    """
    random, steps, free = np.random.RandomState(seed), SETTLING + 1, known.model.free
    normal, uniform = np.empty((steps, number, 16)), np.empty((steps, number))
    for chain in range(number):
        normal[:, chain] = random.standard_normal((steps, 16))
        uniform[:, chain] = random.random_sample(steps)
    moved = _drawn(known, _independent(points), (normal, uniform))
    drawn = np.tile(np.array(known.found.fit.parameters), (number, 1))
    if known.bent:
        other = moved[:, -3:] + (np.array(known.found.fit.bend) - np.array(used)) / ONE
        moved[:, [free.index(offset) for offset in (6, 7, 8)]] += LINEAR_SHARE * other
    drawn[:, list(free)] += np.rint(moved[:, : len(free)] * ONE).astype(np.int64)
    return [tuple(row) for row in drawn.tolist()]


def _drawn(known: Posterior, most: float, numbers: tuple[Floats, Floats] | None = None) -> Floats:
    """Draw all that is fitted, less the best fit, (DRAWS, k), by Gibbs sampling.

    The prior is normal about the fit's centre, with one of WIDTHS for all parameters, which is drawn, too: a
    sensor whose fitted parameters are far off may be as far off in what the points leave open. The noise is
    drawn, too. Whether rests of one posture share their error is not known: half of the chains take each
    posture for one observation, as the fit does, the others each point.

    The parameters are turned so that points and prior are independent along each of them; `share` is the
    prior's part of what is known there.

    Args:
        most: number of observations if rests of one posture do not share their error.
        numbers: random ones as of `_random`, if not these.
    """
    normals, uniforms = _random() if numbers is None else numbers
    steps, chains, _ = normals.shape
    drawn = np.empty((steps - SETTLING, chains, len(known.covariance)))
    # chains of each width of the bend, in an order that any number of chains begins with
    width = np.searchsorted(np.cumsum(known.chances), np.arange(chains) * GOLDEN % 1 * 0.999)
    for number, bend in enumerate(BENDS if known.bent else (None,)):
        own = width == number
        if own.any():
            drawn[:, own] = _chains(known, most, bend, normals[:, own], uniforms[:, own], np.flatnonzero(own))
    return drawn.reshape(-1, drawn.shape[-1])


def _chains(
    known: Posterior,
    most: float,
    bend: float | None,
    normals: Floats,
    uniforms: Floats,
    numbers: NDArray[np.int64],
) -> Floats:
    """Draw by chains whose bends have one width [per g]; see `_drawn`.

    Args:
        numbers: those of the chains, (m,).

    Returns:
        (KEPT, m, k)
    """
    size, away = len(known.covariance), known.from_centre()
    usual = np.array([*known.usual, *(() if bend is None else (bend**-2,) * 3)])
    factor = np.linalg.cholesky(np.linalg.inv(np.array(known.information) + np.diag(usual)))
    share, turn = np.linalg.eigh(factor.T * usual @ factor)
    share = np.clip(share, 0, 1)
    basis = factor @ turn
    pull, apart = basis.T @ (usual * away), float(usual @ (away * away))
    noise = _NoiseDraws.of(known, float((1 - share).sum()), most, numbers)
    # the points pull no harder than residuals allow: (r j)^2 is at most r^2 j^2 of residuals r, column j
    hardest = np.sqrt(noise.left * (1 - share))
    slope = np.clip(basis.T @ np.array(known.pull), -hardest, hardest)
    moved, found, ratio = np.zeros((len(numbers), size)), [], noise.observed
    for normal, uniform in zip(normals, uniforms, strict=True):
        squares = apart + (moved * (share * moved + 2 * pull)).sum(axis=1)
        width, ratio = _drawn_widths(squares, size, uniform)[:, np.newaxis], ratio[:, np.newaxis]
        precision = ratio * (1 - share) + width * share
        apart_by_chance = normal[:, :size] @ turn / np.sqrt(precision)
        moved = (ratio * slope - width * pull) / precision + apart_by_chance
        squares = (moved * ((1 - share) * moved - 2 * slope)).sum(axis=1)
        ratio = noise.ratio(squares, normal[:, -1])
        found.append(moved)
    return np.asarray(np.stack(found[SETTLING:]) @ basis.T)


def _drawn_widths(squares: Floats, number: int, uniform: Floats) -> Floats:
    """Draw one of WIDTHS for each chain; return one over its square, (chains,).

    Args:
        squares: (chains,) sum of the squares of a number of parameters over those of the fit's widths.
    """
    widths = np.array(WIDTHS)
    log = np.log(SHARES) - number * np.log(widths) - squares[:, np.newaxis] / (2 * widths * widths)
    chance = np.exp(log - log.max(axis=1, keepdims=True)).cumsum(axis=1)
    which = (chance < uniform[:, np.newaxis] * chance[:, -1:]).sum(axis=1)
    return np.asarray(1 / widths[which] ** 2)


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
    def of(cls, known: Posterior, used: float, most: float, chains: NDArray[np.int64]) -> _NoiseDraws:
        """Match the prior of the noise by its slope and curvature at the best one."""
        slope, curvature = _pull(known.noise_g, known.prior)
        squares = max(curvature, 0.0) / 2
        times = np.where(chains % 2, max(1.0, most / known.postures), 1.0)
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
def _random() -> tuple[Floats, Floats]:
    """Return normal and uniform numbers, (steps, CHAINS, 16) and (steps, CHAINS); always the same."""
    random, steps = np.random.RandomState(SEED), SETTLING + KEPT
    return random.standard_normal((steps, CHAINS, 16)), random.random_sample((steps, CHAINS))


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

    Attributes:
        bend: that of the calibration in whose place they are plausible.
    """

    known: Posterior
    points: PointSet
    gravity: Gravity
    bend: Bend

    def draws(self, number: int, seed: int) -> list[Calibration]:
        """See `PlausibleSensors`."""
        drawn = drawn_sensors(self.known, self.points, self.bend, number, seed)
        model = self.known.model
        return [_in_standard_units(model, one, self.bend, self.points, self.gravity) for one in drawn]


def calibration_of_fit(model: str, fit: Fit, points: PointSet, gravity: Gravity) -> Calibration:
    """Return the calibration of a fit to points in units of local gravity, in standard g."""
    return _in_standard_units(MODELS[model], fit.parameters, fit.bend, points, gravity)


def _in_standard_units(
    model: Model, parameters: tuple[int, ...], bend: Bend, points: PointSet, gravity: Gravity
) -> Calibration:
    scale, local_g = points.temperature if model.has_temperature else None, gravity.local_g()
    converted = three(scaled(q, 1 / local_g) for q in bend)  # with v = u g: (q / g) v^2 = g q u^2
    return Calibration(model.name, in_standard_g(parameters, local_g), scale, gravity, bend=converted)
