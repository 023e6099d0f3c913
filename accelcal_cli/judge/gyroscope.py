"""The verdict on a gyroscope: its bias at rest, and its scale matrix from turns between rests.

Grammenos, Mascolo, Crowcroft 2018, sections 4.3 and 4.7, with a standard quaternion update for the misprinted
equations 12 and 13 (docs/gyroscope.md): gravity as the calibrated accelerometer measures it at one rest,
turned by the angular rate, is compared with what it measures at the next. A bias would grow with time, so
each turn is corrected by the rates of its own two rests; the bias that is reported comes from all rests.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import asin, cos, degrees, fsum, radians, sqrt

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import interval95, inverse, mean, quantile, student_t_975, three
from accelcal_cli.core.calibration import Calibration
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.gyroscope import (
    Bias,
    Floats,
    Gyroscope,
    Rest,
    RestRates,
    Triple,
    Turn,
    TurnHoldout,
    Turns,
)

# Gravity as a gyroscope turns it from one rest to the next, and how that depends on the scale matrix.
#
# In the sensor's frame a direction u that is fixed in the room moves as du/dt = u x w (G 4.3). With w
# constant from one sample to the next, the turn of a step is that of a unit quaternion, here as its
# matrix by Rodrigues' formula. What S does to the end follows from the same pass: a change dS of the
# scale matrix moves the end of the turn by Q(T) (u(0) x sum of Q(t)^T dS r(t) dt), where Q(t) has
# turned u(0) to u(t).
#
# All is elementwise, in a fixed order, with sums, products and quotients only (series instead of sine
# and cosine), so that turns give the same bits on every machine.

BLOCK = 32
"""Samples that are processed one after the other; blocks of them are processed side by side."""

BATCH_BLOCKS = 4096
"""Blocks that are processed at a time, so that memory is bounded and fits the processor's cache."""

SERIES = 12
"""Terms of the series of sin(x) / x and (1 - cos x) / x^2: exact to 1e-13 up to half a turn in a step."""


@dataclass(frozen=True, slots=True, eq=False)
class _TurnBatch:
    """Turns cut into blocks.

    Attributes:
        first: number of the first turn.
        steps: (BLOCK, 3, t) angle of each step by the raw rate, less the bias [rad]; zero after the end.
        begins: (p,) number of each turn's first block; blocks: (p,) number of its blocks.
    """

    first: int
    steps: Floats
    begins: NDArray[np.int64]
    blocks: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """Gravity at the end of n turns.

    Attributes:
        direction: (n, 3) unit vectors.
        slope: (n, 3, 9) derivatives with respect to the entries of S, row by row.
    """

    direction: Floats
    slope: Floats


class TurningGravity:
    """Turns of a gyroscope, with gravity's direction at their beginning.

    Args:
        before: (n, 3) unit vectors of the calibrated accelerometer.
    """

    def __init__(self, turns: Sequence[Turn], before: Floats, dps_per_lsb: Triple) -> None:
        self._before = before
        self._batches = list(_batches(turns, dps_per_lsb))

    def __len__(self) -> int:
        return len(self._before)

    def turned(self, scale: Floats) -> Turned:
        """Return gravity's direction after each turn.

        Args:
            scale: S, (3, 3), or (3, 3, n) with one for each turn.
        """
        parts = [self._turned(batch, scale) for batch in self._batches]
        return Turned(
            np.concatenate([part.direction for part in parts]), np.concatenate([part.slope for part in parts])
        )

    def _turned(self, batch: _TurnBatch, scale: Floats) -> Turned:
        turns = slice(batch.first, batch.first + len(batch.begins))
        own = scale if scale.ndim == 2 else np.repeat(scale[:, :, turns], batch.blocks, axis=2)
        turn, moment = _joined(batch, *_through_blocks(batch.steps, own))
        start = self._before[turns].T
        end = _times(turn, start[:, np.newaxis])[:, 0]
        across = _times(turn, _cross(start, moment.reshape(3, 9, -1)))
        return Turned(end.T.copy(), across.transpose(2, 0, 1).copy())


def raw_steps(turn: Turn, dps_per_lsb: Triple) -> Floats:
    """Return angles from each sample to the next by the raw rate less that of the rests [rad], (n + 1, 3).

    The first step begins at rest, the last one ends there: n samples make n + 1 trapezoids.
    """
    before, after = turn.before, turn.after
    padded = np.zeros((len(turn) + 2, 3))
    for axis in range(3):
        bias = before.gyro_sums[axis] / before.samples + after.gyro_sums[axis] / after.samples
        padded[1:-1, axis] = turn.counts[:, axis] - bias / 2
        padded[:, axis] *= radians(dps_per_lsb[axis]) * (turn.period_us / 1e6)
    return np.asarray((padded[:-1] + padded[1:]) / 2)


def _batches(turns: Sequence[Turn], dps_per_lsb: Triple) -> Iterator[_TurnBatch]:
    first, steps_of_turns, total = 0, list[Floats](), 0
    for number, turn in enumerate(turns):
        steps = raw_steps(turn, dps_per_lsb)
        blocks = -(-len(steps) // BLOCK)
        if steps_of_turns and total + blocks > BATCH_BLOCKS:
            yield _batch(first, steps_of_turns)
            first, steps_of_turns, total = number, [], 0
        padded = np.zeros((blocks * BLOCK, 3))
        padded[: len(steps)] = steps
        steps_of_turns.append(padded.reshape(blocks, BLOCK, 3))
        total += blocks
    if steps_of_turns:
        yield _batch(first, steps_of_turns)


def _batch(first: int, steps_of_turns: list[Floats]) -> _TurnBatch:
    blocks = np.array([len(one) for one in steps_of_turns], np.int64)
    steps = np.ascontiguousarray(np.concatenate(steps_of_turns).transpose(1, 2, 0))
    return _TurnBatch(first, steps, np.cumsum(blocks) - blocks, blocks)


def _through_blocks(steps: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Return Q of each block, (3, 3, t), and its sum of Q^T (x) r dt, (3, 3, 3, t)."""
    own = scale[:, :, np.newaxis] if scale.ndim == 2 else scale
    turn = np.zeros((3, 3, steps.shape[2]))
    turn[[0, 1, 2], [0, 1, 2]] = 1.0
    moment = np.zeros((3, *turn.shape))
    for step in steps:
        right = own[:, 0] * step[0] + own[:, 1] * step[1] + own[:, 2] * step[2]
        following = _times(_rotation(right), turn)
        middle = (turn + following) / 2
        moment += middle.transpose(1, 0, 2)[:, :, np.newaxis] * step
        turn = following
    return turn, moment


def _rotation(angle: Floats) -> Floats:
    """Return matrices (3, 3, t) that turn directions as a rotation of the sensor by angles (3, t) [rad]."""
    x, y, z = angle
    squared = x * x + y * y + z * z
    sine, versine = _series(squared, 1), _series(squared, 2)
    matrix = versine * (angle[:, np.newaxis] * angle[np.newaxis])
    cosine = 1.0 - versine * squared
    for axis in range(3):
        matrix[axis, axis] += cosine
        following, last = (axis + 1) % 3, (axis + 2) % 3
        matrix[following, last] += sine * angle[axis]
        matrix[last, following] -= sine * angle[axis]
    return matrix


def _series(squared: Floats, first: int) -> Floats:
    """Return sin(x) / x (first = 1) or (1 - cos x) / x^2 (first = 2) of x^2."""
    total = np.ones_like(squared)
    for term in range(SERIES, 0, -1):
        total = 1.0 - squared / ((2 * term + first - 1) * (2 * term + first)) * total
    return total if first == 1 else total / 2


def _joined(batch: _TurnBatch, turn: Floats, moment: Floats) -> tuple[Floats, Floats]:
    """Combine blocks to whole turns: Q (3, 3, p), and the sums (3, 3, 3, p)."""
    number = len(batch.begins)
    whole, total = np.zeros((3, 3, number)), np.zeros((3, 3, 3, number))
    whole[[0, 1, 2], [0, 1, 2]] = 1.0
    for place in range(int(batch.blocks.max())):
        going = np.flatnonzero(batch.blocks > place)
        block = batch.begins[going] + place
        so_far = whole[:, :, going]
        part = _times(so_far.transpose(1, 0, 2), moment[:, :, :, block].reshape(3, 9, -1))
        total[:, :, :, going] += part.reshape(3, 3, 3, -1)
        whole[:, :, going] = _times(turn[:, :, block], so_far)
    return whole, total


def _times(left: Floats, right: Floats) -> Floats:
    """Return matrix products (3, 3, t) (3, m, t), term by term."""
    parts = (left[:, index, np.newaxis] * right[np.newaxis, index] for index in range(3))
    first, second, third = parts
    return np.asarray(first + second + third)


def _cross(left: Floats, right: Floats) -> Floats:
    """Return the cross products (3, t) x (3, m, t) for each of m."""
    return np.stack(
        [left[(a + 1) % 3] * right[(a + 2) % 3] - left[(a + 2) % 3] * right[(a + 1) % 3] for a in range(3)]
    )


# The verdict on a gyroscope.

LEAST_TURN_DEG = 20.0
"""Smallest angle [degrees] between gravity before and after a turn that is used."""

LEAST_PAIRS = 12
"""Fewest turns: each gives two equations for nine unknowns, and a fifth of them is held out."""

FOLDS = 5
"""Parts of the turns that are held out one after the other."""

LEAST_SHARE = 0.03
"""Smallest share of all squared turning about the axis with the least; a third means all axes alike."""

LARGEST_ERROR = 0.02
"""Largest standard error of an entry of S that is still useful: devices are off by a few percent."""

LARGEST_DEG = 5.0
"""Median angle [degrees] on held-out turns above which something else is wrong, such as an axis's sign."""

OTHER_UNIT = 5.0
"""Scale of S, or its inverse, above which the stated unit is wrong; rad/s and deg/s differ by 57 times."""

UNUSUAL = 0.2
"""Distance of an entry of S from a perfect sensor's above which it is mentioned."""

UNDETERMINED = Reason("scale_not_determined")

ITERATIONS, STOP = 50, 1e-7
"""Most Gauss-Newton steps, and the largest change of an entry of S that ends them."""

HUBER = 1.5
"""Standard deviations above which a residual counts less (Huber 1964): turns with a jolt, rests that turn."""

GRID = float(1 << 30)
"""S and b are multiples of 1 / GRID, far below any error, as the accelerometer's parameters are."""

STRETCHES = 10
"""Stretches of time, held out in turn to see if a slope with temperature reduces the error of the bias."""

ROUNDS = 20
"""Most rounds of reweighting when a line is fitted to the rates at rest."""


Line = tuple[float, float]
"""Rate at the reference temperature, and its slope."""


def judge_gyroscope(found: Turns, calibration: Calibration | None, least_range_c: float | None) -> Gyroscope:
    """Return the verdict on a recording's gyroscope.

    Args:
        calibration: the accelerometer's; None if it was refused.
        least_range_c: range of temperatures that a slope of the bias needs; None: no slope is fitted.
    """
    bias = bias_on_grid(found, least_range_c)
    if bias is None:
        return refused(Reason("gyroscope_never_at_rest"), 0, found, None)
    if calibration is None:
        return refused(Reason("accelerometer_not_calibrated"), 0, found, bias)
    pairs = wide_turns(found, calibration)
    reason = _too_little(pairs, found.dps_per_lsb)
    if reason is not None:
        return refused(reason, len(pairs.turns), found, bias)
    return _judged(pairs, found, bias)


def bias_on_grid(found: Turns, least_range_c: float | None) -> Bias | None:
    """Return the bias at rest as it is applied, in multiples of 1 / GRID; None without rest."""
    bias = bias_at_rest(found.rates, found.dps_per_lsb, found.period_s, least_range_c)
    if bias is None:
        return None
    dps, slope = (np.rint(np.array(one) * GRID) / GRID for one in (bias.dps, bias.slope_dps_per_c))
    return replace(bias, dps=three(dps.tolist()), slope_dps_per_c=three(slope.tolist()))


def _judged(pairs: TurnPairs, found: Turns, bias: Bias) -> Gyroscope:
    gravity = TurningGravity(pairs.turns, pairs.before, found.dps_per_lsb)
    raw = gravity.turned(np.eye(3))
    try:
        fit = _fitted(gravity, pairs.after, raw)
        errors = fit.standard_errors()
    except ValueError:
        return refused(UNDETERMINED, len(pairs.turns), found, bias)
    holdout = _holdout(fit, gravity, pairs.after, raw)
    known = refused(UNDETERMINED, len(pairs.turns), found, bias)
    known = replace(known, holdout=holdout, standard_errors=rows_of(errors))
    if holdout.after > LARGEST_DEG:
        return replace(known, reason=Reason.of("gravity_still_off", after_deg=holdout.after))
    factor = mean([abs(fit.scale[axis, axis]) for axis in range(3)])
    if not 1 / OTHER_UNIT < factor < OTHER_UNIT:
        return replace(known, reason=Reason.of("wrong_unit_of_rates", factor=max(factor, 1e-12)))
    worst = float(errors.max())
    if worst > LARGEST_ERROR:
        axis = "xyz"[int(errors.max(axis=0).argmax())]
        return replace(known, reason=Reason.of("too_little_turning", axis=axis, standard_error=worst))
    if holdout.mean_after > holdout.mean_before:
        return replace(known, reason=Reason.of("scale_no_better", before_deg=holdout.mean_before))
    unusual = bool(np.abs(fit.scale - np.eye(3)).max() > UNUSUAL)
    values = {"turns": len(pairs.turns), "before_deg": holdout.before, "after_deg": holdout.after}
    why = Reason.of("gyroscope_calibrated", **values, unusual=unusual)
    scale = rows_of(np.rint(fit.scale * GRID) / GRID)
    return replace(known, outcome="calibrated", reason=why, scale=scale)


def refused(reason: Reason, pairs: int, found: Turns, bias: Bias | None) -> Gyroscope:
    """Return the verdict that there is no scale, for a reason."""
    return Gyroscope("refused", reason, pairs, found.left_out, bias=bias)


def rows_of(matrix: Floats) -> tuple[Triple, Triple, Triple]:
    """Return the rows of a matrix (3, 3)."""
    return three(map(three, matrix.tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class TurnPairs:
    """Turns, and the unit vectors of gravity (n, 3) before and after them."""

    turns: Sequence[Turn]
    before: Floats
    after: Floats


def wide_turns(found: Turns, calibration: Calibration) -> TurnPairs:
    """Return the turns of at least LEAST_TURN_DEG."""
    before, after = gravity_around(found, calibration)
    cosine = before[:, 0] * after[:, 0] + before[:, 1] * after[:, 1] + before[:, 2] * after[:, 2]
    wide = np.flatnonzero(cosine <= cos(radians(LEAST_TURN_DEG)))
    return TurnPairs([found.turns[index] for index in wide], before[wide], after[wide])


def gravity_around(found: Turns, calibration: Calibration) -> tuple[Floats, Floats]:
    """Return the unit vectors of gravity before and after each turn, (n, 3) each."""
    before = _directions([turn.before for turn in found.turns], calibration, found.lsb_per_g)
    return before, _directions([turn.after for turn in found.turns], calibration, found.lsb_per_g)


def _directions(rests: list[Rest], calibration: Calibration, lsb_per_g: float) -> Floats:
    """Return unit vectors of the calibrated means, (n, 3)."""
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


def _too_little(pairs: TurnPairs, dps_per_lsb: Triple) -> Reason | None:
    """Return why the turns alone do not allow the scale to be found, or None."""
    if len(pairs.turns) < LEAST_PAIRS:
        values = {"turns": len(pairs.turns), "least_deg": LEAST_TURN_DEG, "needed": LEAST_PAIRS}
        return Reason.of("too_few_turns", **values)
    moments = np.zeros((3, 3))
    for turn in pairs.turns:
        steps = raw_steps(turn, dps_per_lsb)
        about = np.array([fsum(steps[:, axis].tolist()) for axis in range(3)])
        moments += np.multiply.outer(about, about) / max(1e-12, float((about * about).sum()))
    shares, axes = np.linalg.eigh(moments / len(pairs.turns))
    if shares[0] >= LEAST_SHARE:
        return None
    axis = "xyz"[int(np.abs(axes[:, 0]).argmax())]
    return Reason.of("turns_miss_an_axis", axis=axis)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """S (3, 3) and the terms of each of n turns in its normal equations.

    Attributes:
        weights: (n,) Huber's.
        residuals: (n,) lengths.
        curvature: (n, 9, 9) J^T J; descent: (n, 9) J^T residual.
    """

    scale: Floats
    weights: Floats
    residuals: Floats
    curvature: Floats
    descent: Floats

    def step(self, which: NDArray[np.bool_] | slice = slice(None)) -> Floats:
        """Return the Gauss-Newton step of some turns, (3, 3).

        Raises:
            ValueError: the turns do not determine it.
        """
        weights = self.weights[which, np.newaxis, np.newaxis]
        inverted = np.array(inverse(_summed(weights * self.curvature[which])))
        weighted = self.weights[which, np.newaxis] * self.descent[which]
        right = [fsum(column) for column in weighted.T.tolist()]
        found = [fsum((row * right).tolist()) for row in inverted]
        return np.array(found).reshape(3, 3)

    def standard_errors(self) -> Floats:
        """Return those of the entries of S, (3, 3), for turns that differ in precision (White 1980).

        A turn whose weight is below 1 pulls with the same force however far off it is, so there is no
        curvature along its residual (Huber 1964).
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
    """Return the sum of matrices (n, 9, 9), each entry rounded once."""
    return [[fsum(parts[:, row, column].tolist()) for column in range(9)] for row in range(9)]


def _fitted(gravity: TurningGravity, after: Floats, raw: Turned) -> _Fit:
    """Fit S by Gauss-Newton from the identity; raises ValueError if the turns do not determine it."""
    scale, turned, weights = np.eye(3), raw, np.ones(len(after))
    for _ in range(ITERATIONS):
        fit = _linearised(scale, turned, after, weights)
        step = fit.step()
        scale = scale + step
        turned = gravity.turned(scale)
        distances = _distances(turned.direction, after)
        # the median distance in a plane is 1.18 standard deviations of a coordinate
        limit = HUBER * quantile(sorted(distances.tolist()), 0.5) / 1.1774
        weights = np.minimum(1.0, limit / np.maximum(distances, 1e-12)) if limit else np.ones(len(distances))
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
    apart = one - other
    return np.sqrt(apart[:, 0] ** 2 + apart[:, 1] ** 2 + apart[:, 2] ** 2)


def _holdout(fit: _Fit, gravity: TurningGravity, after: Floats, raw: Turned) -> TurnHoldout:
    """Return errors on fifths of the turns, in the order of time, by fits without them.

    One Gauss-Newton step from the fit of all leads to the fit without a fifth: the rest is of second order,
    a millionth.
    """
    number = len(after)
    fold = np.arange(number) * FOLDS // number
    scales = np.empty((3, 3, number))
    for one in range(FOLDS):
        scales[:, :, fold == one] = (fit.scale + fit.step(fold != one))[:, :, np.newaxis]
    return turn_errors(raw, gravity.turned(scales), after)


def turn_errors(raw: Turned, calibrated: Turned, after: Floats) -> TurnHoldout:
    """Return the errors of turns that took no part in the fit: angles from gravity as measured after them."""
    before, angles = (
        [2 * degrees(asin(min(1.0, apart / 2))) for apart in _distances(turned.direction, after).tolist()]
        for turned in (raw, calibrated)
    )
    number = len(after)
    half = student_t_975(number - 1) * sqrt(number) / 2
    low, high = (max(0.0, min(1.0, (number / 2 + one) / number)) for one in (-half, half))
    ordered = sorted(angles)
    return TurnHoldout(
        before=quantile(sorted(before), 0.5),
        after=quantile(ordered, 0.5),
        ci95=(quantile(ordered, low), quantile(ordered, high)),
        mean_before=mean(before),
        mean_after=mean(angles),
        rms_before=sqrt(mean([angle * angle for angle in before])),
        rms_after=sqrt(mean([angle * angle for angle in angles])),
    )


def bias_at_rest(
    rates: RestRates, dps_per_lsb: Triple, period_s: float, least_range_c: float | None
) -> Bias | None:
    """Return the bias, with a slope if that clearly helps on held-out stretches of time; None without rest.

    Args:
        period_s: time from one sample to the next.
        least_range_c: range of temperatures that a slope needs; None: no slope is fitted.
    """
    if not len(rates):
        return None
    dps = rates.gyro_sums / rates.samples[:, np.newaxis] * np.array(dps_per_lsb)
    weights = rates.samples / rates.samples.max()
    warmth, reference, with_slope = None, None, None
    constant = _held_out(dps, weights, None) if len(rates) >= STRETCHES else None
    known = _warmth(rates, least_range_c)
    if known is not None and constant is not None:
        with_slope = _held_out(dps, weights, known[0])
        falls = [one - other for one, other in zip(constant, with_slope, strict=True)]
        if interval95(falls)[0] > 0:
            warmth, reference = known
    lines = [_line(dps[:, axis], weights, warmth) for axis in range(3)]
    here = np.zeros(len(dps)) if warmth is None else warmth
    off = [dps[:, axis] - _on_line(line, here) for axis, line in enumerate(lines)]
    level, slope = np.array(lines).T
    fixed, sloped = (None if one is None else mean(one) for one in (constant, with_slope))
    return Bias(
        dps=three(level.tolist()),
        standard_errors=None if len(rates) < 2 else three(_weighted_errors(off, weights).tolist()),
        slope_dps_per_c=three(slope.tolist()),
        reference_c=reference,
        rest_s=float(rates.samples.sum()) * period_s,
        raw_dps=mean(_lengths(dps)),
        constant_dps=fixed,
        slope_dps=sloped,
    )


def _warmth(rates: RestRates, least_range_c: float | None) -> tuple[Floats, float] | None:
    """Return temperatures at rest less their median [C], and this; None if their range is too small."""
    if rates.temperature_sums is None or least_range_c is None:
        return None
    celsius = rates.temperature_sums / (1000 * rates.samples)
    middle = round(float(quantile(sorted(celsius.tolist()), 0.5)), 3)
    return (celsius - middle, middle) if float(celsius.max() - celsius.min()) >= least_range_c else None


def _held_out(dps: Floats, weights: Floats, warmth: Floats | None) -> list[float]:
    """Return the mean error [deg/s] of each stretch of time by lines through the others."""
    stretch, found = np.arange(len(dps)) * STRETCHES // len(dps), []
    for one in range(STRETCHES):
        out = stretch == one
        part = None if warmth is None else warmth[~out]
        lines = [_line(dps[~out, axis], weights[~out], part) for axis in range(3)]
        there = np.zeros(int(out.sum())) if warmth is None else warmth[out]
        off = np.stack([dps[out, axis] - _on_line(lines[axis], there) for axis in range(3)], axis=1)
        found.append(mean(_lengths(off)))
    return found


def _lengths(dps: Floats) -> list[float]:
    found: list[float] = np.sqrt(dps[:, 0] ** 2 + dps[:, 1] ** 2 + dps[:, 2] ** 2).tolist()
    return found


def _on_line(line: Line, warmth: Floats) -> Floats:
    return np.asarray(line[0] + line[1] * warmth)


def _line(dps: Floats, weights: Floats, warmth: Floats | None) -> Line:
    """Fit a line in which distant blocks count less (Huber 1964); it is level without temperatures."""
    line, robust = (0.0, 0.0), weights
    for _ in range(ROUNDS):
        line = _least_squares(dps, robust, warmth)
        off = np.abs(dps - _on_line(line, np.zeros(len(dps)) if warmth is None else warmth))
        limit = HUBER * quantile(sorted(off.tolist()), 0.5) / 0.6745
        if not limit:
            break
        robust = weights * np.minimum(1.0, limit / np.maximum(off, 1e-12))
    return line


def _least_squares(dps: Floats, weights: Floats, warmth: Floats | None) -> Line:
    total = fsum(weights.tolist())
    level = fsum((weights * dps).tolist()) / total
    if warmth is None:
        return level, 0.0
    centre = fsum((weights * warmth).tolist()) / total
    apart = warmth - centre
    square = fsum((weights * apart * apart).tolist())
    slope = fsum((weights * apart * dps).tolist()) / square if square else 0.0
    return level - slope * centre, slope


def _weighted_errors(off: Sequence[Floats], weights: Floats) -> Floats:
    """Return standard errors of weighted means by the scatter of at least two blocks, one for each axis."""
    total, number = fsum(weights.tolist()), len(weights)
    squares = [fsum((weights * weights * one * one).tolist()) for one in off]
    return np.array([sqrt(square * number / (number - 1)) / total for square in squares])


# The scale of a gyroscope from whole revolutions about the vertical, in a session of known
# orientations.
#
# Ferraris, Grimaldi and Parvis (1995) turn a sensor by whole revolutions about each of its axes,
# which stays upright: the integral of the rate is then a multiple of 360 degrees along gravity,
# whatever the speed. Gravity, which does not move, says nothing of these turns, so they are apart
# from those that `judge/gyroscope.py` fits. The turns from one face to another, which this fit does
# not use, judge it.

WHOLE_DEG = 360.0
OFF_SHARE = 0.1
"""Share of a revolution by which the raw integral may be off: sensors are off by a few percent."""

SAME_DEG = 8.0
"""Largest angle [degrees] between gravity before and after a revolution."""

UPRIGHT_DEG = 15.0
"""Largest angle [degrees] between the axis of a revolution and gravity."""

LEAST_TURNS = 3
"""Fewest turns from face to face that judge the scale."""


def judge_revolutions(
    found: Turns, calibration: Calibration | None, least_range_c: float | None
) -> Gyroscope | None:
    """Return the verdict by whole revolutions; None if there are none about each axis.

    Args:
        calibration, least_range_c: see `judge_gyroscope`.
    """
    bias = bias_on_grid(found, least_range_c)
    if bias is None or calibration is None:
        return None
    integrals, wanted = _revolutions(found, calibration)
    if not len(integrals):
        return None
    unit = integrals / np.sqrt((integrals * integrals).sum(axis=1, keepdims=True))
    moments = sum(np.multiply.outer(one, one) for one in unit) / len(unit)
    if np.linalg.eigvalsh(moments)[0] < LEAST_SHARE:
        return None
    scale = _fitted_revolutions(integrals, wanted)
    pairs = wide_turns(found, calibration)
    holdout = None
    if len(pairs.turns) >= LEAST_TURNS:
        gravity = TurningGravity(pairs.turns, pairs.before, found.dps_per_lsb)
        holdout = turn_errors(gravity.turned(np.eye(3)), gravity.turned(scale), pairs.after)
    values = {
        "revolutions": len(integrals),
        "turns": len(pairs.turns),
        "before_deg": None if holdout is None else holdout.before,
        "after_deg": None if holdout is None else holdout.after,
    }
    reason = Reason.of("gyroscope_by_revolutions", **values)
    known = replace(refused(reason, len(integrals), found, bias), holdout=holdout)
    if holdout is not None and holdout.mean_after > holdout.mean_before:
        return replace(known, reason=Reason.of("scale_no_better", before_deg=holdout.mean_before))
    return replace(known, outcome="calibrated", scale=rows_of(np.rint(scale * GRID) / GRID))


def _revolutions(found: Turns, calibration: Calibration) -> tuple[Floats, Floats]:
    """Return the integrals (n, 3) [degrees] of whole revolutions by the raw rate, and the true ones."""
    before, after = gravity_around(found, calibration)
    integrals, wanted = [], []
    for turn, start, end in zip(found.turns, before, after, strict=True):
        steps = raw_steps(turn, found.dps_per_lsb)
        integral = np.array([degrees(fsum(steps[:, axis].tolist())) for axis in range(3)])
        length, along = sqrt(float((integral * integral).sum())), float((integral * start).sum())
        whole = WHOLE_DEG * round(length / WHOLE_DEG)
        same = float((start * end).sum()) >= cos(radians(SAME_DEG))
        upright = abs(along) >= cos(radians(UPRIGHT_DEG)) * length
        if whole and same and upright and abs(length - whole) <= OFF_SHARE * whole:
            middle = start + end
            integrals.append(integral)
            upward = middle / sqrt(float((middle * middle).sum()))
            wanted.append((whole if along > 0 else -whole) * upward)
    return np.array(integrals).reshape(-1, 3), np.array(wanted).reshape(-1, 3)


def _fitted_revolutions(integrals: Floats, wanted: Floats) -> Floats:
    """Return S of least squares: S times the integrals is what they should be."""
    both = sum(np.multiply.outer(one, other) for one, other in zip(wanted, integrals, strict=True))
    own = sum(np.multiply.outer(one, one) for one in integrals)
    inverted = inverse(np.asarray(own).tolist())
    return np.array(
        [
            [fsum(row[k] * inverted[k][column] for k in range(3)) for column in range(3)]
            for row in np.asarray(both).tolist()
        ]
    )
