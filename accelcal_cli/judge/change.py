"""Changes of a sensor while it recorded, found by errors on stretches of time that a fit has not seen.

Held-out postures do not show a sensor that changed in the middle: both halves are in every fold. So the
recording is also cut along time, and a constant sensor is compared with one whose offsets step, whose scales
step with them, all of whose parameters step, whose offsets drift in proportion to time or wander from knot to
knot. The moment of the change is searched again inside each fold.

All of this is linear about the calibration that was found. An observation is the mean of the windows of one
orientation within one block of time, since the windows of a bout err alike. What temperature explains is not
treated as a change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import (
    FRACTION_BITS,
    ONE,
    interval95,
    mean,
    rounded_quotient,
    standard_error,
    three,
)
from accelcal_cli.core.calibration import Calibration, Correction, TemperatureScale
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.errors import Reason
from accelcal_cli.core.points import WEIGHT_ONE, PointSet, TimedMeans
from accelcal_cli.core.prior import POPULATION
from accelcal_cli.core.results import PROBABLE, Change, ChangeKind, TimeHoldout, whole_percent
from accelcal_cli.judge.errors import directions, residuals
from accelcal_cli.judge.model_ladder import postures
from accelcal_cli.judge.posterior import NOISE_FREEDOM, PossibleChange, Posterior, columns

FOLDS = 5
"""Parts that stretches of time are dealt to in turn."""

MOST_STRETCHES, LONGEST_STRETCH_H, LEAST_STRETCHES = 24, 6.0, 8
"""Most stretches of time that a recording is cut into, their greatest length [h], and the fewest."""

LEAST_H = 4
"""Hours with stillness that are needed on both sides of a change: the offsets of one hour are known to 1 to
6 mg, those of four to 0.4 to 3 mg."""

LEAST_MG = 3.0
"""Size [mg] that a change must reach in some direction to be reported."""

LEAST_FALL = 0.05
"""Share by which the error must fall, beyond clearly (its 95 % interval above 0): in weeks of data, less than
a tenth of a mg would be clear."""

ALIKE_MG = 0.05
"""Difference [mg] below which errors count as equal."""

KNOT_BITS = 17
"""Fraction bits of a correction's knots, few enough that the last bits of linear algebra do not matter."""

KNOTS_H = (24, 12, 6)
"""Distances [h] between knots, from one to the next of which offsets change linearly."""

MG = 1e-3
WIDTHS = {"offset": 30 * MG, "scale": 0.03, "misalignment": 0.01, "knot": 10 * MG}
"""Usual sizes of changes, as scale parameters of their priors."""

_OFFSETS, _EVERYTHING, _RAW_SCALES, _ERROR = [6, 7, 8], list(range(9)), [12, 13, 14], 15
"""Columns of a Design, and that of the error behind them."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class ChangeHypothesis:
    """One way in which a sensor may change: columns of the design times functions of time.

    Attributes:
        columns: numbers of the q columns whose parameters change.
        widths: scale parameters of their priors, (q,).
        functions: (c, blocks, f): for each of c moments, f functions of time.
        moments: (c,) block at which the change may begin; empty if it has no moment.
        knots_h: (k,) times of the knots [h]; empty if there are none.
        at_knots: (k, f) the functions there.
    """

    kind: ChangeKind
    columns: list[int]
    widths: list[float]
    functions: Floats
    moments: Ints
    knots_h: Floats
    at_knots: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ChangeFit:
    """A hypothesis fitted to the observations.

    Attributes:
        moment: number of the moment that fits best.
        values: (f, q) by how much the functions change the parameter of each column.
        errors_mg: mean error of each stretch by a fit of the others.
    """

    hypothesis: ChangeHypothesis
    moment: int
    values: Floats
    errors_mg: list[float]

    def path(self) -> Floats:
        """Return by how much the parameter of each column is off in each block, (blocks, q)."""
        return np.asarray(self.hypothesis.functions[self.moment] @ self.values)


@dataclass(frozen=True, slots=True, eq=False)
class ComparedErrors:
    """Errors of n observations along a recording, by a calibration and by fits to the recording itself.

    Attributes:
        block: (n,) number of each one's block; stretch: (n,) that of its stretch of time.
        given_mg: (n,) errors of the calibration.
        unseen_mg: (n,) errors of fits to the other stretches, which follow a change if there is one.
    """

    block: Ints
    stretch: Ints
    given_mg: Floats
    unseen_mg: Floats


class ChangeSearch:
    """Finds out if the sensor of a recording changed, and what corrects it.

    Args:
        means: observations in standard g.
    """

    def __init__(self, means: TimedMeans) -> None:
        self._means = means
        self._design: Design | None = None
        self._fit: ChangeFit | None = None

    def find(self, found: Calibration) -> Change:
        """Look for a change about a calibration."""
        means = self._means
        hours = min(means.hours() / MOST_STRETCHES, LONGEST_STRETCH_H)
        stretch = means.block // max(1, ceil(hours / means.block_h))
        if means.hours() < 2 * LEAST_H:
            return Change("none", "too_short")
        if means.blocks() == 1:
            return Change("none", "too_many_cells")
        if len(set(stretch.tolist())) < LEAST_STRETCHES:
            return Change("none", "few_still_stretches")
        self._design = design = Design(means, found, stretch)
        still = design.errors_mg(None)
        alarms = []
        for hypothesis in _hypotheses(means):
            fit = replace(design.fit(hypothesis), errors_mg=design.errors_mg(hypothesis))
            if _falls(still, fit.errors_mg) and design.size_mg(fit) >= LEAST_MG:
                alarms.append(fit)
        if not alarms:
            return Change("none", None, TimeHoldout(len(still), mean(still)))
        self._fit = fit = _simplest(alarms)
        gain = [before - after for before, after in zip(still, fit.errors_mg, strict=True)]
        holdout = TimeHoldout(len(still), mean(still), mean(fit.errors_mg), standard_error(gain))
        moments = fit.hypothesis.moments
        at_block = int(moments[fit.moment]) if len(moments) else None
        size_mg = design.size_mg(fit)
        change = Change(fit.hypothesis.kind, None, holdout, at_block=at_block, size_mg=size_mg)
        return _measured(replace(change, correction=_correction(means, fit)), fit)

    def compared(self) -> ComparedErrors | None:
        """Compare the calibration that `find` was given with the recording; None if that is too short."""
        if self._design is None:
            return None
        return self._design.compared(None if self._fit is None else self._fit.hypothesis)

    def refined(self, found: Calibration, change: Change) -> Change:
        """Add to a change what is left of it about the calibration of the corrected observations."""
        assert self._fit is not None and change.correction is not None
        means = self._means.corrected(change.correction)
        design = Design(means, replace(found, correction=None), means.block)
        hypothesis, moment = self._fit.hypothesis, slice(self._fit.moment, self._fit.moment + 1)
        only = replace(hypothesis, functions=hypothesis.functions[moment], moments=hypothesis.moments[moment])
        rest = design.fit(only)
        more = _correction(means, rest)
        assert more is not None
        return _measured(replace(change, correction=_combined(change.correction, more)), rest)


def _correction(means: TimedMeans, fit: ChangeFit) -> Correction | None:
    """Return what corrects a change; None for another device."""
    hypothesis = fit.hypothesis
    if hypothesis.kind == "device":
        return None
    if len(hypothesis.moments):
        samples = (0, int(hypothesis.moments[fit.moment]) * means.block_samples)
        at_knots = np.concatenate([np.zeros_like(fit.values), fit.values])
    else:
        samples_per_h = means.block_samples / means.block_h
        samples = tuple(round(knot * samples_per_h) for knot in hypothesis.knots_h.tolist())
        at_knots = hypothesis.at_knots @ fit.values
    rows = [dict(zip(hypothesis.columns, row, strict=True)) for row in at_knots.tolist()]
    stretch = tuple(_knot([1 + row.get(column, 0.0) for column in _RAW_SCALES]) for row in rows)
    shift = tuple(_knot([row.get(column, 0.0) for column in _OFFSETS]) for row in rows)
    return Correction(samples, stretch, shift, lines=not len(hypothesis.moments))


def _knot(values: list[float]) -> tuple[int, int, int]:
    """Convert values to fixed point with KNOT_BITS fraction bits."""
    return three(round(value * (1 << KNOT_BITS)) << FRACTION_BITS - KNOT_BITS for value in values)


def _combined(first: Correction, then: Correction) -> Correction:
    """Combine two corrections with the same knots that are applied one after the other."""
    stretch, shift = [], []
    for knots in zip(first.stretch, first.shift, then.stretch, then.shift, strict=True):
        axes = list(zip(*knots, strict=True))
        rx, ry, rz = (rounded_quotient(r * more, ONE) for r, _, more, _ in axes)
        dx, dy, dz = (rounded_quotient(d * more, ONE) + rest for _, d, more, rest in axes)
        stretch.append((rx, ry, rz))
        shift.append((dx, dy, dz))
    return replace(first, stretch=tuple(stretch), shift=tuple(shift))


def _measured(change: Change, fit: ChangeFit) -> Change:
    """Add to a change how offsets and scales differ from beginning to end."""
    if change.correction is None:
        moved = dict(zip(fit.hypothesis.columns, (fit.path()[0] - fit.path()[-1]).tolist(), strict=True))
        moves = (np.array([moved.get(column, 0.0) for column in columns]) for columns in (_OFFSETS, range(3)))
        offset, scale = moves
    else:
        stretch, shift = (np.array(one) / ONE for one in (change.correction.stretch, change.correction.shift))
        offset = shift[0] / stretch[0] - shift[-1] / stretch[-1]
        scale = stretch[0] / stretch[-1] - 1
    offset_mg, percent = three((1000 * offset).tolist()), three((100 * scale).tolist())
    return replace(change, offset_mg=offset_mg, scale_percent=percent)


def change_reason(change: Change, offset_s: int | None, *, followed: bool) -> Reason | None:
    """Return the caution of a change; None if nothing changed.

    Args:
        offset_s: seconds that the device's clock is ahead of UTC; None if unknown.
        followed: True if the calibration follows the change.
    """
    holdout = change.holdout
    if holdout is None or change.size_mg is None:
        if change.at_us is None or change.probability is None:
            return None
        values = {"at": iso_time(change.at_us, offset_s), "percent": whole_percent(change.probability)}
        return Reason.of("may_have_changed", **values)
    errors = {"constant_mg": holdout.constant_mg, "changing_mg": holdout.changing_mg}
    what = {"kind": change.kind, "at": iso_time(change.at_us, offset_s), "size_mg": change.size_mg}
    left = change.probability is not None and change.probability >= PROBABLE
    in_part = whole_percent(change.probability or 0.0) if followed and left else None
    return Reason.of("sensor_changed", **what, followed=followed, left_percent=in_part, **errors)


def _falls(before: list[float], after: list[float]) -> bool:
    gain = [one - other for one, other in zip(before, after, strict=True)]
    return interval95(gain)[0] > 0 and mean(gain) >= LEAST_FALL * mean(before)


def _simplest(alarms: list[ChangeFit]) -> ChangeFit:
    """Return the first fit, in the order of complexity, within one standard error of the best."""
    best = min(alarms, key=lambda one: mean(one.errors_mg))
    for one in alarms:
        worse = [a - b for a, b in zip(one.errors_mg, best.errors_mg, strict=True)]
        if mean(worse) <= max(standard_error(worse), ALIKE_MG):
            return one
    return best


def _hypotheses(means: TimedMeans) -> list[ChangeHypothesis]:
    """Return all hypotheses that a recording is long enough for, by number of parameters."""
    time_h = np.asarray((np.arange(means.blocks()) + 0.5) * means.block_h, np.float64)
    offset, scale, other = WIDTHS["offset"], WIDTHS["scale"], WIDTHS["misalignment"]
    known, least = np.array(sorted(set(means.block.tolist())), np.int64), ceil(LEAST_H / means.block_h)
    moments = known[least : len(known) - least + 1]  # LEAST_H of stillness lie before and after
    nowhere, nothing = np.zeros(0, np.int64), np.zeros(0)
    line = (time_h / means.hours() - 0.5)[np.newaxis, :, np.newaxis]
    ends, halves = np.array([0.0, means.hours()]), np.array([[-0.5], [0.5]])
    found = [ChangeHypothesis("drift", _OFFSETS, [offset] * 3, line, nowhere, ends, halves)]
    if len(moments):
        after = (np.arange(means.blocks()) >= moments[:, np.newaxis]).astype(float)[:, :, np.newaxis]
        sudden: list[tuple[ChangeKind, list[int], list[float]]] = [
            ("step", _OFFSETS, [offset] * 3),
            ("gain", _RAW_SCALES + _OFFSETS, [scale] * 3 + [offset] * 3),
            ("device", _EVERYTHING, [scale] * 3 + [other] * 3 + [offset] * 3),
        ]
        found += [ChangeHypothesis(*one, after, moments, nothing, nothing) for one in sudden]
    for apart_h in KNOTS_H:
        if means.hours() >= 2 * apart_h and apart_h >= 2 * means.block_h:
            number = round(means.hours() / apart_h)
            knots = np.asarray(np.arange(number + 1) * (means.hours() / number), np.float64)
            hats = np.maximum(0.0, 1.0 - np.abs(time_h[:, np.newaxis] - knots) / knots[1])[np.newaxis]
            widths = [WIDTHS["knot"]] * 3
            found.append(ChangeHypothesis("walk", _OFFSETS, widths, hats, nowhere, knots, np.eye(number + 1)))
    return found


class Design:
    """Observations as a linear model about a calibration.

    Its columns are d|a|/dp of the twelve parameters, then of the scales of raw x, y, z.

    Args:
        stretch: (n,) number of the stretch of time that each observation is in.
    """

    def __init__(self, means: TimedMeans, found: Calibration, stretch: Ints) -> None:
        warmth = None if means.celsius is None else means.celsius - float(np.mean(means.celsius))
        self._block, self._stretch = means.block, stretch
        self._found = found
        shifted = found.straight(means.mean_g) + _shift(found, means.celsius)
        lengths, self._rows = _linear(shifted, means.mean_g, found.gain())
        if warmth is not None:
            self._rows[:, 9:12] *= warmth[:, np.newaxis]
        self._error = 1.0 - lengths / float(found.gravity.local_g())
        self._base = list(range(9 if warmth is None else 12))
        self._base_widths = list(POPULATION.width[: len(self._base)])
        full = np.column_stack([self._rows, self._error])
        ends = np.searchsorted(means.block, np.arange(means.blocks()), side="right")
        self._products = np.stack([part.T @ part for part in np.split(full, ends[:-1])])
        fold = np.full(means.blocks(), -1)
        fold[means.block] = stretch % FOLDS
        self._fold = fold

    def compared(self, hypothesis: ChangeHypothesis | None) -> ComparedErrors:
        """Return the errors of the calibration, and of fits to the other stretches."""
        given_mg = np.asarray(1000 * np.abs(self._error))
        return ComparedErrors(self._block, self._stretch, given_mg, self._unseen_mg(hypothesis))

    def _unseen_mg(self, hypothesis: ChangeHypothesis | None) -> Floats:
        """Return the error of each observation by a fit of the other stretches."""
        left = np.empty(len(self._error))
        for fold in range(FOLDS):
            out = self._fold[self._block] == fold
            if out.any():
                moment, values = self._solve(hypothesis, self._fold != fold)
                explained = self._rows[:, self._base] @ values[: len(self._base)]
                if hypothesis is not None:
                    changing = values[len(self._base) :].reshape(hypothesis.functions.shape[2], -1)
                    path = (hypothesis.functions[moment] @ changing)[self._block]
                    explained = explained + (self._rows[:, hypothesis.columns] * path).sum(axis=1)
                left[out] = (self._error - explained)[out]
        return np.asarray(1000 * np.abs(left))

    def errors_mg(self, hypothesis: ChangeHypothesis | None) -> list[float]:
        """Return the mean error of each stretch by a fit of the others."""
        deviations = self._unseen_mg(hypothesis)
        stretches = sorted(set(self._stretch.tolist()))
        return [float(deviations[self._stretch == one].mean()) for one in stretches]

    def fit(self, hypothesis: ChangeHypothesis) -> ChangeFit:
        """Fit a hypothesis to all observations."""
        moment, values = self._solve(hypothesis, np.ones(len(self._fold), np.bool_))
        changing = values[len(self._base) :].reshape(hypothesis.functions.shape[2], -1)
        return ChangeFit(hypothesis, moment, changing, [])

    def size_mg(self, fit: ChangeFit) -> float:
        """Return the largest change of |a| between two times, over all directions [mg]."""
        gain, true = self._found.gain(), directions()
        raw = np.asarray(np.linalg.solve(gain, true.T).T, np.float64)
        _, rows = _linear(raw, raw - _shift(self._found, None), gain)
        moved = rows[:, fit.hypothesis.columns] @ fit.path().T
        return float(1000 * (moved.max(axis=1) - moved.min(axis=1)).max())

    def _solve(self, hypothesis: ChangeHypothesis | None, blocks: NDArray[np.bool_]) -> tuple[int, Floats]:
        """Return the number of the best moment, and the parameters, for the observations of some blocks."""
        products = self._products[blocks]
        total, base = products.sum(axis=0), self._base
        noise = POPULATION.noise_g**2
        first = total[np.ix_(base, base)] + noise * np.diag(1 / np.square(self._base_widths))
        if hypothesis is None:
            return 0, np.linalg.solve(first, total[base, _ERROR])
        functions, columns = hypothesis.functions[:, blocks], hypothesis.columns
        number, _, each = functions.shape
        size = each * len(columns)
        with_base = np.tensordot(functions, products[:, columns][:, :, [*base, _ERROR]], (1, 0))
        with_base = with_base.reshape(number, size, len(base) + 1)
        pairs = functions[:, :, :, np.newaxis] * functions[:, :, np.newaxis, :]
        among = np.tensordot(pairs, products[:, columns][:, :, columns], (1, 0))
        among = among.transpose(0, 1, 3, 2, 4).reshape(number, size, size)
        among += noise * np.diag(np.tile(1 / np.square(hypothesis.widths), each))
        whole = np.empty((number, len(base) + size, len(base) + size))
        whole[:, : len(base), : len(base)] = first
        whole[:, len(base) :, : len(base)] = with_base[:, :, :-1]
        whole[:, : len(base), len(base) :] = with_base[:, :, :-1].transpose(0, 2, 1)
        whole[:, len(base) :, len(base) :] = among
        alone = np.broadcast_to(total[base, _ERROR], (number, len(base)))
        right = np.concatenate([alone, with_base[:, :, -1]], axis=1)
        values = np.linalg.solve(whole, right[:, :, np.newaxis])[:, :, 0]
        best = int((right * values).sum(axis=1).argmax())
        return best, values[best]


# What may have changed besides, as a term of the posterior.
#
# Whether or not a change is clear enough to be followed, a calibration is as uncertain as the sensor may have
# changed: each of several moments and two kinds of change has a probability, given the rests before and
# after it.

MOMENTS = 8
"""Parts of the time, between which the sensor may have changed."""

CHANGED = 0.05
"""Probability of a change within a recording, before its rests are seen."""

SIZES = ((0.7, (0.01,) * 6 + (20 * MG,) * 3), (0.3, tuple(1.5 * width for width in POPULATION.width[:9])))
"""Share and widths of a change of the sensor, and of one by another sensor, whose errors are independent."""

FAR_OFF = 3.0
"""Times the noise beyond which a rest pulls no harder."""

NOISE_ROUNDS = 6
LEAST_PROBABILITY = 1e-4


def possible_changes(
    means: TimedMeans, known: Posterior, scale: TemperatureScale | None, local_g: float, degrees: float
) -> list[PossibleChange]:
    """Return the changes that a recording's rests leave possible, each with its probability.

    Args:
        means: as they were fitted, in standard g; local_g: what rest measures.
        scale: of the fit's temperatures.
        degrees: width of a posture.
    """
    blocks = means.blocks()
    starts = sorted({round(blocks * part / MOMENTS) for part in range(1, MOMENTS)} - {0, blocks})
    if not starts:
        return []
    rests = _rests(means, known, scale, local_g, degrees, np.array(starts))
    centre, held, number = -known.from_centre(), known.precision(), len(known.covariance)
    changing = [place for place, index in enumerate(known.model.free) if index < len(SIZES[0][1])]
    embed = np.eye(2 * number)[:, [*range(number), *(number + place for place in changing)]]
    log, *_ = _explained(rests, rests.rows, centre, held)
    logs, found = [log + np.log(1 - CHANGED)], []
    for moment, start in enumerate(starts):
        after = rests.rows[:, changing] * (rests.part > moment)[:, np.newaxis]
        for share, widths in SIZES:
            precision = [1 / widths[known.model.free[place]] ** 2 for place in changing]
            prior = np.append(centre, np.zeros(len(changing))), np.append(held, precision)
            log, mean, covariance = _explained(rests, np.column_stack([rests.rows, after]), *prior)
            logs.append(log + np.log(CHANGED * share / len(starts)))
            found.append((start / blocks, embed @ mean, embed @ np.linalg.cholesky(covariance)))
    chances = np.exp(np.array(logs) - max(logs))
    chances /= chances.sum()
    pairs = zip(chances[1:].tolist(), found, strict=True)
    return [PossibleChange(chance, *one) for chance, one in pairs if chance > LEAST_PROBABILITY]


def probable_change(changes: Sequence[PossibleChange]) -> tuple[float, float]:
    """Return the probability of any change, and the share of the time before the most probable one."""
    if not changes:
        return 0.0, 0.0
    moments = dict.fromkeys((one.before for one in changes), 0.0)
    for one in changes:
        moments[one.before] += one.probability
    return min(1.0, sum(moments.values())), max(moments, key=lambda before: moments[before])


@dataclass(frozen=True, slots=True, eq=False)
class _Rests:
    """Means of the rests of a posture in a part of the time.

    Attributes:
        rows: (n, k) d|a|/dp of what is fitted; error: (n,) 1 - |a| by the fit [g].
        weight: (n,) of each; part: (n,) number of the part of the time.
    """

    rows: Floats
    error: Floats
    weight: Floats
    part: Ints


def _rests(
    means: TimedMeans,
    known: Posterior,
    scale: TemperatureScale | None,
    local_g: float,
    degrees: float,
    starts: Ints,
) -> _Rests:
    raw, tau, fit = means.mean_g / local_g, None, known.found.fit
    if known.model.has_temperature and scale is not None and means.celsius is not None:
        tau = (means.celsius - scale.reference_mc / 1000) / scale.span_c
    each = np.ones(len(raw), np.int64)
    windows = each if means.windows is None else means.windows
    points = PointSet(np.rint(raw * ONE).astype(np.int64), each * WEIGHT_ONE, windows)
    part = np.searchsorted(starts, means.block, side="right")
    units, unit = np.unique(np.stack([postures(points, degrees), part]), axis=1, return_inverse=True)
    straight = points.straightened(fit.bend).xyz_g()
    values = np.column_stack([columns(raw, known, tau), -residuals(straight, tau, fit.parameters)]) / 2
    sums = np.zeros((units.shape[1], values.shape[1]))
    np.add.at(sums, unit.reshape(-1), values)
    sums /= np.bincount(unit.reshape(-1))[:, np.newaxis]
    weight = 1 / np.sqrt(np.bincount(units[0])[units[0]])  # rests of one posture share a part of their error
    return _Rests(sums[:, :-1], sums[:, -1], weight, units[1])


def _explained(
    rests: _Rests, rows: Floats, centre: Floats, precision: Floats
) -> tuple[float, Floats, Floats]:
    """Return the log probability of rests, up to a constant, and mean and covariance of what explains them.

    Args:
        centre, precision: those of the prior of each column's parameter.
    """
    usual, number = POPULATION.noise_g**2, float(rests.weight.sum())
    left, noise = rests.error, 4 * usual
    for _ in range(NOISE_ROUNDS):
        weight = rests.weight * np.minimum(1, FAR_OFF * np.sqrt(noise) / np.maximum(np.abs(left), 1e-9))
        around = (rows * weight[:, np.newaxis]).T @ rows / noise
        whole = around + np.diag(precision)
        mean = np.linalg.solve(whole, rows.T @ (weight * rests.error) / noise + precision * centre)
        left = rests.error - rows @ mean
        squares = float((weight * left * left).sum())
        used = float(np.trace(np.linalg.solve(whole, around)))
        noise = (NOISE_FREEDOM * usual + squares) / (NOISE_FREEDOM + max(number - used, 0.0))
    log = -(NOISE_FREEDOM + number) * np.log1p(squares / (NOISE_FREEDOM * usual))
    log += np.log(precision).sum() - (precision * (mean - centre) ** 2).sum() - np.linalg.slogdet(whole)[1]
    return float(log) / 2, mean, np.linalg.inv(whole)


def _shift(found: Calibration, celsius: Floats | None) -> Floats:
    """Return o + s (T - Tref) of each observation; o without temperatures."""
    if celsius is None or found.temperature is None:
        return found.offset_g()
    return np.asarray(found.offset_g() + np.outer(celsius - found.reference_c(), found.slope_g_per_c()))


def _linear(shifted: Floats, raw: Floats, gain: Floats) -> tuple[Floats, Floats]:
    """Return |a| of observations, (n,), and its derivatives, (n, 15); slopes for one degree C."""
    a = shifted @ gain.T
    lengths = np.sqrt((a * a).sum(axis=1))
    along = a / lengths[:, np.newaxis]
    back = along @ gain
    pairs = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
    of_gain = np.stack([along[:, row] * shifted[:, column] for row, column in pairs], axis=1)
    return lengths, np.concatenate([of_gain, back, back, back * raw], axis=1)
