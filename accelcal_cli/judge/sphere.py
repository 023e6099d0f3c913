"""The error of a calibration over the whole sphere, also where the wrist has not been.

Held-out postures say how wrong a calibration is where the wrist has been. What it would be in every direction
follows from the posterior: sensors are drawn from it, and each is calibrated, to first order, and held
against 1 g.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import erf, exp, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.fixed import ONE
from accelcal_cli.core.points import PointSet, Saturated
from accelcal_cli.core.results import SphereError
from accelcal_cli.core.statistics import quantile
from accelcal_cli.judge.errors import directions, jacobian
from accelcal_cli.judge.posterior import Bend, Posterior

DRAWS = 1000
"""Sensors: with so many the ends of the interval are known to about 2 % of its width, if it is normal."""

SEED = 20181
TAIL = 0.025
"""Share of the draws beyond each end of the interval."""

BEND_ROUNDS = 4
"""A bend of a few percent is turned round to 1e-7 g in so many."""

LARGEST_RATIO = 6.0
"""Beyond so many standard deviations noise does not change a mean error."""

STEPS = 100
"""Places of the table of mean errors in one standard deviation."""

TOGETHER = 50
"""Draws at a time: what is worked out of them stays in the processor's cache."""

Floats = NDArray[np.float64]


def sphere_errors(
    points: PointSet,
    label: NDArray[np.int64],
    known: Posterior,
    judged: Sequence[tuple[int, ...]],
    saturated: Saturated = (),
) -> list[SphereError]:
    """Mean | |a| - 1 g | of calibrations over all directions, at the points' mean temperature.

    The interval allows for where the wrist will go: its low end (2.5 %) is for one that spends an unknown
    share of its time in the postures where it has been, its high end (97.5 %) for one that goes everywhere.

    Args:
        points: those that the posterior is of; label is the posture number of each, (n,).
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
    """Largest | |a| - 1 g | of a calibration over all directions, of the most probable sensor [mg]."""
    raw = _bent(_raw_directions(known.found.fit.parameters), known.bend)
    return float(1000 * np.abs(_lengths(raw, judged) - 1).max())


def _bent(straight: Floats, bend: Bend | None) -> Floats:
    """What a sensor whose response is bent measures instead of vectors in g, (n, 3)."""
    if bend is None:
        return straight
    measured, c = straight, np.array(bend.c)
    for _ in range(BEND_ROUNDS):
        measured = straight - c * measured**bend.power
    return measured


def _straight(measured: Floats, bend: Bend | None) -> Floats:
    """What measured vectors in g would be without the bend, (n, 3)."""
    return measured if bend is None else measured + np.array(bend.c) * measured**bend.power


def _columns(measured: Floats, known: Posterior) -> Floats:
    """d(|a|^2 - 1)/dp of the free parameters, and of the bend where there is one, at raw vectors (n, 3)."""
    rows = jacobian(_straight(measured, known.bend), None, known.found.fit.parameters)
    own = rows[:, list(known.model.free)]
    if known.bend is None:
        return own
    return np.column_stack([own, rows[:, 6:9] * measured**known.bend.power])


def _summary(everywhere: Floats, visited: Floats) -> SphereError:
    """Of each draw's mean errors [g] in all directions, (DRAWS, 162), and in the postures, (DRAWS, p)."""
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
    """What a sensor with these errors measures at rest in all directions, (162, 3) in g."""
    p = [value / ONE for value in parameters]
    true = directions()
    x = true[:, 0] / p[0]
    y = (true[:, 1] - p[3] * x) / p[1]
    z = (true[:, 2] - p[4] * x - p[5] * y) / p[2]
    return np.stack([x - p[6], y - p[7], z - p[8]], axis=1)


def _as_measured(raw: Floats, saturated: Saturated) -> Floats:
    """Raw vectors as a sensor that saturates gives them."""
    measured = raw.copy()
    for axis, limit_g in saturated:
        bound = np.minimum if limit_g > 0 else np.maximum
        measured[:, axis] = bound(measured[:, axis], limit_g)
    return measured


def _posture_means(points: PointSet, label: NDArray[np.int64]) -> Floats:
    """Raw mean of each posture, (postures, 3) in g."""
    g = points.xyz_g()
    keys = sorted(set(label.tolist()))
    rows = [np.average(g[label == key], axis=0, weights=points.weights[label == key]) for key in keys]
    return np.asarray(rows)


def _drawn(known: Posterior) -> tuple[Floats, Floats]:
    """Noise of each draw, (DRAWS, 1) in g, and its free parameters less the best ones, (DRAWS, free).

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
    """Standard normal numbers, (DRAWS, 16), and numbers from 0 to 1, (DRAWS,); always the same."""
    random = np.random.RandomState(SEED)
    normal, uniform = random.standard_normal((DRAWS, 13)), random.uniform(size=DRAWS)
    return np.column_stack([normal, random.standard_normal((DRAWS, 3))]), uniform


def _lengths(raw: Floats, parameters: tuple[int, ...]) -> Floats:
    """|a| of raw vectors, (n,)."""
    p = [value / ONE for value in parameters]
    x, y, z = (raw[:, axis] + p[6 + axis] for axis in range(3))
    ax, ay, az = p[0] * x, p[3] * x + p[1] * y, p[4] * x + p[5] * y + p[2] * z
    return np.asarray(np.sqrt(ax * ax + ay * ay + az * az))


def _mean_error(deviations: Floats, noise: Floats) -> Floats:
    """Mean of |d + noise| for each deviation d, (DRAWS, n): that of a folded normal distribution."""
    found = np.empty_like(deviations)
    for first in range(0, len(deviations), TOGETHER):
        rows = slice(first, first + TOGETHER)
        ratio = np.abs(deviations[rows]) / noise[rows]
        found[rows] = np.where(ratio < LARGEST_RATIO, _tabulated(ratio), ratio) * noise[rows]
    return found


def _tabulated(ratio: Floats) -> Floats:
    """What the table has for ratios, linear between its places; of no use beyond its end.

    The same bits as of np.interp, which searches where the even steps of the table tell the place.
    """
    places, values, slopes = _folded()
    before = (np.fmin(ratio, LARGEST_RATIO) * STEPS + 0.5).astype(np.intp)  # the nearest place
    before -= places[before] > ratio
    np.minimum(before, len(slopes) - 1, out=before)
    return np.asarray(slopes[before] * (ratio - places[before]) + values[before])


@cache
def _folded() -> tuple[Floats, Floats, Floats]:
    """Mean of |t + a standard normal number| for t from 0 to LARGEST_RATIO, and its slopes between these."""
    places = np.linspace(0, LARGEST_RATIO, round(LARGEST_RATIO * STEPS) + 1)
    means = [sqrt(2 / pi) * exp(-t * t / 2) + t * erf(t / sqrt(2)) for t in places.tolist()]
    return places, np.array(means), np.diff(means) / np.diff(places)
