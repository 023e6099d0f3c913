"""Did the sensor change while it recorded? Errors on whole stretches of time that a fit has not seen.

Held-out postures do not show a sensor that changed in the middle: both halves are in every fold. So the
recording is also cut along time, and a sensor that stays as it is is held against one whose offsets step,
whose scales step with them, all of whose parameters step, whose offsets drift in proportion to time or wander
from knot to knot. Where it changed is sought anew inside each fold.

All of this is linear about the calibration that was found. An observation is the mean of the windows of one
orientation within one block of time, since the windows of a bout err alike. What temperature explains belongs
to the sensor that stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.arithmetic import FRACTION_BITS, ONE, rounded_quotient
from accelcal_cli.core.calibration import Calibration, Correction
from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.points import TimedMeans
from accelcal_cli.core.prior import POPULATION
from accelcal_cli.core.results import Change, ChangeKind, TimeHoldout
from accelcal_cli.core.statistics import interval95, mean, standard_error
from accelcal_cli.judge.errors import directions

FOLDS = 5
MOST_STRETCHES, LONGEST_STRETCH_H, LEAST_STRETCHES = 24, 6.0, 8
"""A recording is cut into so many stretches of time at most; they are dealt to the folds in turn."""

LEAST_H = 4
"""With stillness on both sides of a change: the offsets of one hour are known to 1 to 6 mg, those of four to
0.4 to 3 mg."""

LEAST_MG = 3.0
LEAST_FALL = 0.05
"""An alarm needs a change of so much in some direction, and an error that clearly falls (the 95 % interval of
its fall is above 0), by at least this share: in weeks of data less than a tenth of a mg would be clear."""

ALIKE_MG = 0.05
"""Errors that differ by less are as good as equal."""

KNOT_BITS = 17
KNOTS_H = (24, 12, 6)
MG = 1e-3
WIDTHS = {"offset": 30 * MG, "scale": 0.03, "misalignment": 0.01, "knot": 10 * MG}
"""How large changes may well be, as scale parameters of their prior."""

_OFFSETS, _EVERYTHING, _RAW_SCALES, _ERROR = [6, 7, 8], list(range(9)), [12, 13, 14], 15

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """One way to change: columns of the design times functions of time.

    Attributes:
        columns: numbers of the q columns whose parameters change.
        widths: of the prior of each, (q,).
        courses: (c, blocks, f): for each of c moments f functions of time.
        moments: (c,) block at which the change may begin; empty where it has no moment.
        knots_h: (k,) where lines begin and end; empty where there are none.
        at_knots: (k, f) the functions there.
    """

    kind: ChangeKind
    columns: list[int]
    widths: list[float]
    courses: Floats
    moments: Ints
    knots_h: Floats
    at_knots: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a suspect explains, at the number `moment` of its moments.

    Attributes:
        values: (f, q) by how much its functions change each of its columns' parameters.
        errors_mg: mean error of each stretch, when a fit of the others is held against it.
    """

    suspect: Suspect
    moment: int
    values: Floats
    errors_mg: list[float]

    def path(self) -> Floats:
        """(blocks, q) by how much each column's parameter is off in each block."""
        return np.asarray(self.suspect.courses[self.moment] @ self.values)


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """Errors of n observations along a recording, by a calibration and by what the recording itself says.

    Attributes:
        block: (n,) number of the block that each is in; stretch: (n,) that of its stretch of time.
        given_mg: (n,) errors of the calibration.
        unseen_mg: (n,) errors that a fit of the other stretches leaves; it follows a change if there is one.
    """

    block: Ints
    stretch: Ints
    given_mg: Floats
    unseen_mg: Floats


class ChangeSearch:
    """Whether the sensor of a recording changed, and what puts it right.

    Args:
        means: observations in standard g.
    """

    def __init__(self, means: TimedMeans) -> None:
        self._means = means
        self._design: Design | None = None
        self._one: Found | None = None

    def find(self, found: Calibration) -> Change:
        """Look for a change about a calibration."""
        means = self._means
        stretch = means.block // _stretch_blocks(means)
        if means.hours() < 2 * LEAST_H:
            return Change("none", "the recording is too short to show a change")
        if means.blocks() == 1:
            return Change("none", "it holds too many orientations and temperatures to look at it along time")
        if len(set(stretch.tolist())) < LEAST_STRETCHES:
            return Change("none", "the device was still in too few stretches of time to show a change")
        self._design = design = Design(means, found, stretch)
        still = design.errors_mg(None)
        alarms = []
        for suspect in _suspects(means):
            one = design.found(suspect)
            if _falls(still, one.errors_mg) and design.size_mg(one) >= LEAST_MG:
                alarms.append(one)
        if not alarms:
            return Change("none", None, TimeHoldout(len(still), mean(still)))
        self._one = one = _simplest(alarms)
        gain = [before - after for before, after in zip(still, one.errors_mg, strict=True)]
        holdout = TimeHoldout(len(still), mean(still), mean(one.errors_mg), standard_error(gain))
        moments = one.suspect.moments
        change = Change(
            one.suspect.kind,
            None,
            holdout,
            at_block=int(moments[one.moment]) if len(moments) else None,
            size_mg=design.size_mg(one),
        )
        return _measured(replace(change, correction=_correction(means, one)), one)

    def compared(self) -> Compared | None:
        """The calibration that `find` was given, held against the recording; None where it is too short."""
        if self._design is None:
            return None
        suspect = None if self._one is None else self._one.suspect
        return self._design.compared(suspect)

    def refined(self, found: Calibration, change: Change) -> Change:
        """A change about the calibration of what was put right by it: what it leaves is added to it."""
        assert self._one is not None and change.correction is not None
        means = self._means.corrected(change.correction)
        design = Design(means, replace(found, correction=None), means.block)
        rest = design.explained(_at_moment(self._one))
        more = _correction(means, rest)
        assert more is not None
        return _measured(replace(change, correction=_after(change.correction, more)), rest)


def _at_moment(one: Found) -> Suspect:
    """A suspect that can have changed at one moment only."""
    suspect, moment = one.suspect, slice(one.moment, one.moment + 1)
    return replace(suspect, courses=suspect.courses[moment], moments=suspect.moments[moment])


def _correction(means: TimedMeans, one: Found) -> Correction | None:
    """What makes up for a change; of another device there is nothing to go on with."""
    suspect = one.suspect
    if suspect.kind == "device":
        return None
    if len(suspect.moments):
        samples = (0, int(suspect.moments[one.moment]) * means.block_samples)
        at_knots = np.concatenate([np.zeros_like(one.values), one.values])
    else:
        samples_per_h = means.block_samples / means.block_h
        samples = tuple(round(knot * samples_per_h) for knot in suspect.knots_h.tolist())
        at_knots = suspect.at_knots @ one.values
    rows = [dict(zip(suspect.columns, row, strict=True)) for row in at_knots.tolist()]
    stretch = tuple(_knot([1 + row.get(column, 0.0) for column in _RAW_SCALES]) for row in rows)
    shift = tuple(_knot([row.get(column, 0.0) for column in _OFFSETS]) for row in rows)
    return Correction(samples, stretch, shift, lines=not len(suspect.moments))


def _knot(values: list[float]) -> tuple[int, int, int]:
    """In fixed point, in steps so long that the last bits of linear algebra do not matter."""
    x, y, z = (round(value * (1 << KNOT_BITS)) << FRACTION_BITS - KNOT_BITS for value in values)
    return x, y, z


def _after(first: Correction, then: Correction) -> Correction:
    """What two courses with the same knots do one after the other."""
    stretch, shift = [], []
    for knots in zip(first.stretch, first.shift, then.stretch, then.shift, strict=True):
        axes = list(zip(*knots, strict=True))
        rx, ry, rz = (rounded_quotient(r * more, ONE) for r, _, more, _ in axes)
        dx, dy, dz = (rounded_quotient(d * more, ONE) + rest for _, d, more, rest in axes)
        stretch.append((rx, ry, rz))
        shift.append((dx, dy, dz))
    return replace(first, stretch=tuple(stretch), shift=tuple(shift))


def _measured(change: Change, one: Found) -> Change:
    """The change with what the sensor itself did from beginning to end."""
    if change.correction is None:
        moved = dict(zip(one.suspect.columns, (one.path()[0] - one.path()[-1]).tolist(), strict=True))
        offset = [moved.get(column, 0.0) for column in _OFFSETS]
        scale = [moved.get(column, 0.0) for column in (0, 1, 2)]
        return replace(change, offset_mg=_three(1000, offset), scale_percent=_three(100, scale))
    stretch, shift = (np.array(knots) / ONE for knots in (change.correction.stretch, change.correction.shift))
    offset = (shift[0] / stretch[0] - shift[-1] / stretch[-1]).tolist()
    scale = (stretch[0] / stretch[-1] - 1).tolist()
    return replace(change, offset_mg=_three(1000, offset), scale_percent=_three(100, scale))


def _three(factor: float, values: list[float]) -> tuple[float, float, float]:
    x, y, z = (factor * value for value in values)
    return x, y, z


def told(change: Change, offset_s: int | None, *, followed: bool) -> str | None:
    """A sentence for people; None where nothing changed.

    Args:
        offset_s: seconds that the device's clock is ahead of UTC; None if not known.
        followed: whether the calibration goes with it.
    """
    held = change.holdout
    if held is None or change.size_mg is None:
        return None
    when = (iso_time(change.at_us, offset_s) or "").partition(".")[0]
    what = {
        "none": "",
        "drift": "its offsets drift",
        "step": f"its offsets jump at {when}",
        "gain": f"its scales jump at {when}",
        "device": f"all its errors jump at {when}, as if another device went on",
        "walk": "its offsets wander",
    }[change.kind]
    text = f"the sensor changes while it records: {what}, by up to {change.size_mg:.1f} mg"
    if followed:
        return f"{text}, and the calibration follows"
    worse = f"one calibration for all of it leaves {held.constant_mg:.1f} mg"
    return f"{text}; {worse}, one that follows would leave {held.changing_mg:.1f} mg"


def _stretch_blocks(means: TimedMeans) -> int:
    hours = min(means.hours() / MOST_STRETCHES, LONGEST_STRETCH_H)
    return max(1, ceil(hours / means.block_h))


def _falls(before: list[float], after: list[float]) -> bool:
    gain = [one - other for one, other in zip(before, after, strict=True)]
    return interval95(gain)[0] > 0 and mean(gain) >= LEAST_FALL * mean(before)


def _simplest(alarms: list[Found]) -> Found:
    """The first one, by number of parameters, within one standard error of the best."""
    best = min(alarms, key=lambda one: mean(one.errors_mg))
    for one in alarms:
        worse = [a - b for a, b in zip(one.errors_mg, best.errors_mg, strict=True)]
        if mean(worse) <= max(standard_error(worse), ALIKE_MG):
            return one
    return best


def _suspects(means: TimedMeans) -> list[Suspect]:
    """All ways to change that a recording is long enough for, by number of parameters."""
    time_h = np.asarray((np.arange(means.blocks()) + 0.5) * means.block_h, np.float64)
    offset, scale, other = WIDTHS["offset"], WIDTHS["scale"], WIDTHS["misalignment"]
    moments, nowhere, nothing = _moments(means), np.zeros(0, np.int64), np.zeros(0)
    line = (time_h / means.hours() - 0.5)[np.newaxis, :, np.newaxis]
    ends, halves = np.array([0.0, means.hours()]), np.array([[-0.5], [0.5]])
    found = [Suspect("drift", _OFFSETS, [offset] * 3, line, nowhere, ends, halves)]
    if len(moments):
        after = (np.arange(means.blocks()) >= moments[:, np.newaxis]).astype(float)[:, :, np.newaxis]
        sudden: list[tuple[ChangeKind, list[int], list[float]]] = [
            ("step", _OFFSETS, [offset] * 3),
            ("gain", _RAW_SCALES + _OFFSETS, [scale] * 3 + [offset] * 3),
            ("device", _EVERYTHING, [scale] * 3 + [other] * 3 + [offset] * 3),
        ]
        found += [Suspect(*one, after, moments, nothing, nothing) for one in sudden]
    for apart_h in KNOTS_H:
        if means.hours() >= 2 * apart_h and apart_h >= 2 * means.block_h:
            number = round(means.hours() / apart_h)
            knots = np.asarray(np.arange(number + 1) * (means.hours() / number), np.float64)
            hats = np.maximum(0.0, 1.0 - np.abs(time_h[:, np.newaxis] - knots) / knots[1])[np.newaxis]
            widths = [WIDTHS["knot"]] * 3
            found.append(Suspect("walk", _OFFSETS, widths, hats, nowhere, knots, np.eye(number + 1)))
    return found


def _moments(means: TimedMeans) -> Ints:
    """Blocks at which a change may begin: those with stillness, LEAST_H of them before and after."""
    known = np.array(sorted(set(means.block.tolist())), np.int64)
    least = ceil(LEAST_H / means.block_h)
    return known[least : len(known) - least + 1]


class Design:
    """Observations as a linear model about a calibration.

    Its columns are d|a|/dp of the twelve parameters, then those of the scales of raw x, y, z.

    Args:
        stretch: (n,) number of the stretch of time that each observation is in.
    """

    def __init__(self, means: TimedMeans, found: Calibration, stretch: Ints) -> None:
        warmth = None if means.celsius is None else means.celsius - float(np.mean(means.celsius))
        self._block, self._stretch = means.block, stretch
        self._found = found
        shifted = means.mean_g + _shift(found, means.celsius)
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

    def compared(self, suspect: Suspect | None) -> Compared:
        """What the calibration leaves, and what fits do that have not seen the stretch in question."""
        given_mg = np.asarray(1000 * np.abs(self._error))
        return Compared(self._block, self._stretch, given_mg, self._unseen_mg(suspect))

    def _unseen_mg(self, suspect: Suspect | None) -> Floats:
        """Error of each observation by a fit of the other stretches."""
        left = np.empty(len(self._error))
        for fold in range(FOLDS):
            out = self._fold[self._block] == fold
            if out.any():
                left[out] = self._left(self._fit(suspect, self._fold != fold), suspect)[out]
        return np.asarray(1000 * np.abs(left))

    def errors_mg(self, suspect: Suspect | None) -> list[float]:
        """Mean error of each stretch by a fit of the others."""
        deviations = self._unseen_mg(suspect)
        stretches = sorted(set(self._stretch.tolist()))
        return [float(deviations[self._stretch == one].mean()) for one in stretches]

    def found(self, suspect: Suspect) -> Found:
        """What a suspect explains of all observations, and of those that are held out."""
        return replace(self.explained(suspect), errors_mg=self.errors_mg(suspect))

    def explained(self, suspect: Suspect) -> Found:
        """What a suspect explains of all observations."""
        moment, values = self._fit(suspect, np.ones(len(self._fold), np.bool_))
        changing = values[len(self._base) :].reshape(suspect.courses.shape[2], -1)
        return Found(suspect, moment, changing, [])

    def size_mg(self, one: Found) -> float:
        """The largest change of |a| between two times, over all directions."""
        gain, true = self._found.gain(), directions()
        raw = np.asarray(np.linalg.solve(gain, true.T).T, np.float64)
        _, rows = _linear(raw, raw - _shift(self._found, None), gain)
        moved = rows[:, one.suspect.columns] @ one.path().T
        return float(1000 * (moved.max(axis=1) - moved.min(axis=1)).max())

    def _left(self, fitted: tuple[int, Floats], suspect: Suspect | None) -> Floats:
        moment, values = fitted
        explained = self._rows[:, self._base] @ values[: len(self._base)]
        if suspect is not None:
            changing = values[len(self._base) :].reshape(suspect.courses.shape[2], -1)
            path = suspect.courses[moment] @ changing
            explained = explained + (self._rows[:, suspect.columns] * path[self._block]).sum(axis=1)
        return np.asarray(self._error - explained)

    def _fit(self, suspect: Suspect | None, blocks: NDArray[np.bool_]) -> tuple[int, Floats]:
        """The best moment (its number) and parameters for the observations of some blocks."""
        products = self._products[blocks]
        total, base = products.sum(axis=0), self._base
        noise = POPULATION.noise_g**2
        first = total[np.ix_(base, base)] + noise * np.diag(1 / np.square(self._base_widths))
        if suspect is None:
            return 0, np.linalg.solve(first, total[base, _ERROR])
        courses, columns = suspect.courses[:, blocks], suspect.columns
        number, _, functions = courses.shape
        size = functions * len(columns)
        with_base = np.tensordot(courses, products[:, columns][:, :, [*base, _ERROR]], (1, 0))
        with_base = with_base.reshape(number, size, len(base) + 1)
        pairs = courses[:, :, :, np.newaxis] * courses[:, :, np.newaxis, :]
        among = np.tensordot(pairs, products[:, columns][:, :, columns], (1, 0))
        among = among.transpose(0, 1, 3, 2, 4).reshape(number, size, size)
        among += noise * np.diag(np.tile(1 / np.square(suspect.widths), functions))
        whole = np.empty((number, len(base) + size, len(base) + size))
        whole[:, : len(base), : len(base)] = first
        whole[:, len(base) :, : len(base)] = with_base[:, :, :-1]
        whole[:, : len(base), len(base) :] = with_base[:, :, :-1].transpose(0, 2, 1)
        whole[:, len(base) :, len(base) :] = among
        right = np.concatenate(
            [np.broadcast_to(total[base, _ERROR], (number, len(base))), with_base[:, :, -1]], axis=1
        )
        values = np.linalg.solve(whole, right[:, :, np.newaxis])[:, :, 0]
        best = int((right * values).sum(axis=1).argmax())
        return best, values[best]


def _shift(found: Calibration, celsius: Floats | None) -> Floats:
    """o + s (T - Tref) of each observation; at Tref without temperatures."""
    if celsius is None or found.temperature is None:
        return found.offset_g()
    return np.asarray(found.offset_g() + np.outer(celsius - found.reference_c(), found.slope_g_per_c()))


def _linear(shifted: Floats, raw: Floats, gain: Floats) -> tuple[Floats, Floats]:
    """|a| of observations, (n,), and its derivatives, (n, 15); slopes for one degree C."""
    a = shifted @ gain.T
    lengths = np.sqrt((a * a).sum(axis=1))
    along = a / lengths[:, np.newaxis]
    back = along @ gain
    pairs = ((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))
    of_gain = np.stack([along[:, row] * shifted[:, column] for row, column in pairs], axis=1)
    return lengths, np.concatenate([of_gain, back, back, back * raw], axis=1)
