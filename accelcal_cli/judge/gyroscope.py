"""Whether a gyroscope can be calibrated, and by what: its bias at rest, its scale matrix from turns.

Grammenos, Mascolo, Crowcroft 2018, sections 4.3 and 4.7, with a standard quaternion update for the misprinted
equations 12 and 13 (docs/gyroscope.md): gravity as the calibrated accelerometer measures it at one rest,
turned by the angular rate, is compared with what it measures at the next. A bias would grow with time, so
that each turn has that of its two rests; the one that is reported is of all rests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import asin, cos, degrees, fsum, radians, sqrt

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.errors import counted
from accelcal_cli.core.linear import inverse
from accelcal_cli.core.rotations import Bias, Gyroscope, Rest, Triple, Turn, TurnHoldout, Turns
from accelcal_cli.core.statistics import mean, quantile, student_t_975
from accelcal_cli.judge.restrates import bias_at_rest
from accelcal_cli.judge.turning import Gravity, Turned, raw_steps

LEAST_TURN_DEG = 20.0
LEAST_PAIRS = 12
"""Each gives two equations for nine unknowns, and a fifth of them is held out."""

FOLDS = 5
LEAST_SHARE = 0.03
"""Of all turns, squared, about the axis with the least: a third would be as much as about any other."""

LARGEST_ERROR = 0.02
"""Standard error of an entry of S that is still of use: devices are off by some percent."""

LARGEST_DEG = 5.0
"""Median angle on held-out turns beyond which something else is wrong, such as the sign of an axis."""

OTHER_UNIT = 5.0
"""The scale of S, or its inverse, beyond which the unit of the rates is not the one that is stated: rad/s and
deg/s differ by 57."""

UNUSUAL = 0.2
"""An entry of S that is so far from that of a perfect sensor is told: devices are off by some percent."""

ITERATIONS, STOP = 50, 1e-7
HUBER = 1.5
"""Residuals beyond so many standard deviations count less, as turns do that hold a jolt (Huber 1964)."""

GRID = float(1 << 30)
"""S and b are multiples of 1 / GRID, far below any error, as the accelerometer's parameters are."""

Floats = NDArray[np.float64]


def judge_gyroscope(found: Turns, calibration: Calibration | None, least_range_c: float | None) -> Gyroscope:
    """The verdict on a recording's gyroscope.

    Args:
        calibration: of the accelerometer; None if that was refused.
        least_range_c: temperatures that a slope of the bias needs; None: none is wanted.
    """
    bias = bias_at_rest(found.rates, found.dps_per_lsb, found.period_s, least_range_c)
    if bias is None:
        return _refused("it is never at rest for a second together with the accelerometer", 0, found, None)
    bias = _on_grid(bias)
    if calibration is None:
        return _refused("the accelerometer has no calibration to compare it with", 0, found, bias)
    pairs = _pairs(found, calibration)
    reason = _too_little(pairs, found.dps_per_lsb)
    if reason is not None:
        return _refused(reason, len(pairs.turns), found, bias)
    return _judged(pairs, found, bias)


def _judged(pairs: _Pairs, found: Turns, bias: Bias) -> Gyroscope:
    """The verdict on enough pairs."""
    gravity = Gravity(pairs.turns, pairs.before, found.dps_per_lsb)
    raw = gravity.turned(np.eye(3))
    try:
        fit = _fitted(gravity, pairs.after, raw)
        errors = fit.standard_errors()
    except ValueError:
        return _refused("the turns do not determine the scale", len(pairs.turns), found, bias)
    held = _holdout(fit, gravity, pairs.after, raw)
    known = replace(_refused("", len(pairs.turns), found, bias), holdout=held, standard_errors=_rows(errors))
    if held.after > LARGEST_DEG:
        text = f"on turns that it has not seen gravity is still {held.after:.2g} degrees off"
        return replace(known, message=f"{text}; units, axes or times of the gyroscope may be wrong")
    factor = mean([abs(fit.scale[axis, axis]) for axis in range(3)])
    if not 1 / OTHER_UNIT < factor < OTHER_UNIT:
        how = (
            f"{factor:.2g} times too small" if factor > 1 else f"{1 / max(factor, 1e-12):.2g} times too large"
        )
        return replace(known, message=f"its rates are about {how} for its turns: look at their unit")
    worst = float(errors.max())
    if worst > LARGEST_ERROR:
        axis = "xyz"[int(errors.max(axis=0).argmax())]
        text = f"too little turning about {axis}: an entry of its scale is known to {worst:.2g} only"
        return replace(known, message=text)
    if held.mean_after > held.mean_before:
        text = "a scale matrix makes it no better on turns that it has not seen"
        return replace(known, message=f"{text} ({held.mean_before:.2g} degrees before)")
    text = (
        f"scale found from {counted(len(pairs.turns), 'turn')} between rests; on turns that it has not seen "
        f"gravity is {held.after:.2g} degrees off, {held.before:.2g} before"
    )
    scale = _rows(np.rint(fit.scale * GRID) / GRID)
    if np.abs(fit.scale - np.eye(3)).max() > UNUSUAL:
        text += "; the scale is far from 1: look at the units and the axes of the gyroscope"
    return replace(known, outcome="calibrated", message=text, scale=scale)


def _refused(reason: str, pairs: int, found: Turns, bias: Bias | None) -> Gyroscope:
    return Gyroscope("refused", reason, pairs, found.left_out, bias=bias)


def _on_grid(bias: Bias) -> Bias:
    b, c = (_triple(np.rint(np.array(one) * GRID) / GRID) for one in (bias.dps, bias.slope_dps_per_c))
    return replace(bias, dps=b, slope_dps_per_c=c)


def _triple(values: Floats) -> Triple:
    x, y, z = values.tolist()
    return x, y, z


def _rows(matrix: Floats) -> tuple[Triple, Triple, Triple]:
    x, y, z = map(_triple, matrix)
    return x, y, z


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Turns with the unit vectors of gravity, (n, 3), before and after them."""

    turns: Sequence[Turn]
    before: Floats
    after: Floats


def _pairs(found: Turns, calibration: Calibration) -> _Pairs:
    """The turns of at least LEAST_TURN_DEG."""
    before, after = (
        _directions([getattr(turn, side) for turn in found.turns], calibration, found.lsb_per_g)
        for side in ("before", "after")
    )
    cosine = before[:, 0] * after[:, 0] + before[:, 1] * after[:, 1] + before[:, 2] * after[:, 2]
    wide = np.flatnonzero(cosine <= cos(radians(LEAST_TURN_DEG)))
    return _Pairs([found.turns[index] for index in wide], before[wide], after[wide])


def _directions(rests: list[Rest], calibration: Calibration, lsb_per_g: float) -> Floats:
    """Unit vectors of the calibrated means, (n, 3)."""
    if not rests:
        return np.empty((0, 3))
    scale = np.array([rest.samples for rest in rests]) * lsb_per_g
    raw = np.array([rest.sums for rest in rests], np.float64) / scale[:, np.newaxis]
    if calibration.correction is not None:
        raw = calibration.correction.applied(raw, np.array([rest.sample for rest in rests], np.int64))
    reference = calibration.reference_c()
    celsius = [
        reference if rest.temperature_sum is None else rest.temperature_sum / (1000 * rest.samples)
        for rest in rests
    ]
    x, y, z = calibration.applied([raw[:, axis] for axis in range(3)], np.array(celsius))
    length = np.sqrt(x * x + y * y + z * z)
    return np.stack([x / length, y / length, z / length], axis=1)


def _too_little(pairs: _Pairs, dps_per_lsb: Triple) -> str | None:
    """Why the scale cannot be found, by the turns alone."""
    if len(pairs.turns) < LEAST_PAIRS:
        number = counted(len(pairs.turns), "turn")
        return (
            f"only {number} of at least {LEAST_TURN_DEG:g} degrees from one rest to another within 30 s; "
            f"{LEAST_PAIRS} are needed"
        )
    moments = np.zeros((3, 3))
    for turn in pairs.turns:
        steps = raw_steps(turn, dps_per_lsb)
        about = np.array([fsum(steps[:, axis].tolist()) for axis in range(3)])
        moments += np.multiply.outer(about, about) / max(1e-12, float((about * about).sum()))
    shares, axes = np.linalg.eigh(moments / len(pairs.turns))
    if shares[0] >= LEAST_SHARE:
        return None
    axis = "xyz"[int(np.abs(axes[:, 0]).argmax())]
    return f"the turns do not span all axes: there is hardly any about {axis}"


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """S (3, 3) and, for each of n turns, what its normal equations are made of.

    Attributes:
        weights: (n,) Huber's.
        residuals: (n,) their lengths.
        curvature: (n, 9, 9) J^T J; descent: (n, 9) J^T residual.
    """

    scale: Floats
    weights: Floats
    residuals: Floats
    curvature: Floats
    descent: Floats

    def step(self, which: NDArray[np.bool_] | slice = slice(None)) -> Floats:
        """The Gauss-Newton step of these turns, (3, 3); raises ValueError if they do not determine it."""
        weights = self.weights[which, np.newaxis, np.newaxis]
        inverted = np.array(inverse(_summed(weights * self.curvature[which])))
        weighted = self.weights[which, np.newaxis] * self.descent[which]
        right = [fsum(column) for column in weighted.T.tolist()]
        found = [fsum((row * right).tolist()) for row in inverted]
        return np.array(found).reshape(3, 3)

    def standard_errors(self) -> Floats:
        """Of the entries of S, (3, 3), with turns that differ in how exact they are (White 1980).

        What counts less pulls with the same force however far off it is: along its residual there is no
        curvature (Huber 1964).
        """
        along = self.descent / np.maximum(self.residuals, 1e-12)[:, np.newaxis]
        along[self.weights == 1] = 0.0
        flatter = self.curvature - along[:, :, np.newaxis] * along[:, np.newaxis]
        inverted = np.array(inverse(_summed(self.weights[:, np.newaxis, np.newaxis] * flatter)))
        pulls = self.weights[:, np.newaxis] * self.descent
        moved = sum(pulls[:, index, np.newaxis] * inverted[index] for index in range(9))
        number = len(self.weights)
        squares = [fsum(column) for column in np.square(moved).T.tolist()]
        return np.sqrt(np.array(squares) * number / (number - 9)).reshape(3, 3)


def _summed(parts: Floats) -> list[list[float]]:
    """The sum of (n, 9, 9), each entry rounded once."""
    return [[fsum(parts[:, row, column].tolist()) for column in range(9)] for row in range(9)]


def _fitted(gravity: Gravity, after: Floats, raw: Turned) -> _Fit:
    """Gauss-Newton from the identity; raises ValueError if the turns do not determine S."""
    scale, turned, weights = np.eye(3), raw, np.ones(len(after))
    for _ in range(ITERATIONS):
        fit = _linearised(scale, turned, after, weights)
        step = fit.step()
        scale = scale + step
        turned = gravity.turned(scale)
        weights = _huber(_distances(turned.direction, after))
        if np.abs(step).max() < STOP:
            break
    return _linearised(scale, turned, after, weights)


def _linearised(scale: Floats, turned: Turned, after: Floats, weights: Floats) -> _Fit:
    residual, slope = after - turned.direction, turned.slope
    curvature = sum(slope[:, axis, :, np.newaxis] * slope[:, axis, np.newaxis] for axis in range(3))
    descent = sum(slope[:, axis] * residual[:, axis, np.newaxis] for axis in range(3))
    lengths = _distances(turned.direction, after)
    return _Fit(scale, weights, lengths, np.asarray(curvature), np.asarray(descent))


def _distances(one: Floats, other: Floats) -> Floats:
    """(n,) lengths of differences."""
    apart = one - other
    return np.sqrt(apart[:, 0] ** 2 + apart[:, 1] ** 2 + apart[:, 2] ** 2)


def _huber(distances: Floats) -> Floats:
    """Weights, by the median of distances in a plane, 1.18 standard deviations of a coordinate."""
    limit = HUBER * quantile(sorted(distances.tolist()), 0.5) / 1.1774
    return np.minimum(1.0, limit / np.maximum(distances, 1e-12)) if limit else np.ones(len(distances))


def _holdout(fit: _Fit, gravity: Gravity, after: Floats, raw: Turned) -> TurnHoldout:
    """Errors on fifths of the turns, one after the other in time, that took no part.

    From the fit of all, one Gauss-Newton step with the others alone leads to their own: what is left out is
    of second order, a millionth.
    """
    number = len(after)
    fold = np.arange(number) * FOLDS // number
    scales = np.empty((3, 3, number))
    for one in range(FOLDS):
        scales[:, :, fold == one] = (fit.scale + fit.step(fold != one))[:, :, np.newaxis]
    before, angles = (_degrees(turned.direction, after) for turned in (raw, gravity.turned(scales)))
    half = student_t_975(number - 1) * sqrt(number) / 2
    low, high = (max(0.0, min(1.0, (number / 2 + one) / number)) for one in (-half, half))
    ordered = sorted(angles)
    return TurnHoldout(
        before=quantile(sorted(before), 0.5),
        after=quantile(ordered, 0.5),
        ci95=(quantile(ordered, low), quantile(ordered, high)),
        mean_before=mean(before),
        mean_after=mean(angles),
        rms_before=_root_mean_square(before),
        rms_after=_root_mean_square(angles),
    )


def _root_mean_square(values: list[float]) -> float:
    return sqrt(mean([value * value for value in values]))


def _degrees(one: Floats, other: Floats) -> list[float]:
    """Angles between unit vectors."""
    return [2 * degrees(asin(min(1.0, apart / 2))) for apart in _distances(one, other).tolist()]
