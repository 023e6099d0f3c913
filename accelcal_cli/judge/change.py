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

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import iso_time
from accelcal_cli.core.points import Calibration, TimedMeans
from accelcal_cli.core.results import Change, ChangeKind, TimeHoldout
from accelcal_cli.judge.errors import directions, mean, standard_error, student_t_975
from accelcal_cli.judge.posterior import POPULATION

FOLDS = 5
MOST_STRETCHES, LONGEST_STRETCH_H, LEAST_STRETCHES = 24, 6.0, 8
"""A recording is cut into so many stretches of time at most; they are dealt to the folds in turn."""

LEAST_H = 4
"""With stillness on both sides of a change: the offsets of one hour are known to 1 to 6 mg, those of four to
0.4 to 3 mg."""

LEAST_MG = 3.0
"""An alarm needs a change of so much, and an error that clearly falls: its 95 % interval is above 0."""

ALIKE_MG = 0.05
"""Errors that differ by less are as good as equal."""

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
        places: (c,) block at which the change may begin; (0,) where it has no place.
        courses: (c, blocks, f) for each place f functions of time.
    """

    kind: ChangeKind
    columns: list[int]
    widths: list[float]
    places: Ints
    courses: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a suspect explains.

    Attributes:
        path: (blocks, q) by how much each of its columns' parameters is off in each block.
        errors_mg: mean error of each stretch, when a fit of the others is held against it.
    """

    suspect: Suspect
    place: int
    path: Floats
    errors_mg: list[float]


def find_change(means: TimedMeans, found: Calibration) -> Change:
    """Whether a recording's sensor changed, and how.

    Args:
        means: observations in standard g.
        found: the calibration about which a change is sought.
    """
    stretch = means.block // _stretch_blocks(means)
    if means.hours() < 2 * LEAST_H or len(set(stretch.tolist())) < LEAST_STRETCHES:
        return Change("none", "the recording is too short to show a change")
    design = Design(means, found, stretch)
    still = design.errors_mg(None)
    alarms = []
    for suspect in _suspects(means):
        one = design.found(suspect)
        if _falls(still, one.errors_mg) and design.size_mg(one) >= LEAST_MG:
            alarms.append(one)
    if not alarms:
        return Change("none", None, TimeHoldout(len(still), mean(still)))
    return _change(design, _simplest(alarms), still)


def told(change: Change, offset_s: int | None) -> str | None:
    """A sentence for people; None where nothing changed.

    Args:
        offset_s: seconds that the device's clock is ahead of UTC; None if not known.
    """
    if change.kind == "none" or change.holdout is None or change.size_mg is None:
        return None
    when = (iso_time(change.at_us, offset_s) or "").partition(".")[0]
    what = {
        "drift": "its offsets drift",
        "step": f"its offsets jump at {when}",
        "gain": f"its scales jump at {when}",
        "device": f"all its errors jump at {when}, as if another device went on",
        "walk": "its offsets wander",
    }[change.kind]
    held = change.holdout
    return (
        f"the sensor changes while it records: {what}, by up to {change.size_mg:.1f} mg; one calibration for "
        f"all of it leaves {held.constant_mg:.1f} mg, one that follows would leave {held.changing_mg:.1f} mg"
    )


def _stretch_blocks(means: TimedMeans) -> int:
    hours = min(means.hours() / MOST_STRETCHES, LONGEST_STRETCH_H)
    return max(1, ceil(hours / means.block_h))


def _falls(before: list[float], after: list[float]) -> bool:
    gain = [one - other for one, other in zip(before, after, strict=True)]
    return mean(gain) > student_t_975(len(gain) - 1) * standard_error(gain)


def _simplest(alarms: list[Found]) -> Found:
    """The first one, by number of parameters, within one standard error of the best."""
    best = min(alarms, key=lambda one: mean(one.errors_mg))
    for one in alarms:
        worse = [a - b for a, b in zip(one.errors_mg, best.errors_mg, strict=True)]
        if mean(worse) <= max(standard_error(worse), ALIKE_MG):
            return one
    return best


def _change(design: Design, one: Found, still: list[float]) -> Change:
    gain = [before - after for before, after in zip(still, one.errors_mg, strict=True)]
    holdout = TimeHoldout(len(still), mean(still), mean(one.errors_mg), standard_error(gain))
    moved = one.path[0] - one.path[-1]  # of the sensor, not of the coefficients that make up for it
    named = dict(zip(one.suspect.columns, moved.tolist(), strict=True))
    offset_mg = [1000 * named.get(column, 0.0) for column in _OFFSETS]
    scale = [100 * named.get(column, 0.0) for column in _RAW_SCALES]
    place = one.place if len(one.suspect.places) > 1 or one.place else None
    return Change(
        one.suspect.kind,
        None,
        holdout,
        at_block=place,
        size_mg=design.size_mg(one),
        offset_mg=(offset_mg[0], offset_mg[1], offset_mg[2]),
        scale_percent=(scale[0], scale[1], scale[2]),
    )


def _suspects(means: TimedMeans) -> list[Suspect]:
    """All ways to change that a recording is long enough for, by number of parameters."""
    blocks = means.blocks()
    time_h = np.asarray((np.arange(blocks) + 0.5) * means.block_h, np.float64)
    offset, scale, other = WIDTHS["offset"], WIDTHS["scale"], WIDTHS["misalignment"]
    line = (time_h / means.hours() - 0.5)[np.newaxis, :, np.newaxis]
    nowhere, found = np.zeros(1, np.int64), []
    found.append(Suspect("drift", _OFFSETS, [offset] * 3, nowhere, line))
    places = _places(means)
    if len(places):
        after = (np.arange(blocks) >= places[:, np.newaxis]).astype(float)[:, :, np.newaxis]
        found += [
            Suspect("step", _OFFSETS, [offset] * 3, places, after),
            Suspect("gain", _RAW_SCALES + _OFFSETS, [scale] * 3 + [offset] * 3, places, after),
            Suspect("device", _EVERYTHING, [scale] * 3 + [other] * 3 + [offset] * 3, places, after),
        ]
    for apart_h in KNOTS_H:
        if means.hours() >= 2 * apart_h:
            number = round(means.hours() / apart_h)
            knots = np.asarray(np.arange(number + 1) * (means.hours() / number), np.float64)
            away = np.abs(time_h[:, np.newaxis] - knots) / knots[1]
            hats = np.maximum(0.0, 1.0 - away)[np.newaxis]
            found.append(Suspect("walk", _OFFSETS, [WIDTHS["knot"]] * 3, nowhere, hats))
    return found


def _places(means: TimedMeans) -> Ints:
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
        kinds = (POPULATION.scale, POPULATION.misalignment, POPULATION.offset_g, POPULATION.slope_g_per_c)
        self._base = list(range(9 if warmth is None else 12))
        self._base_widths = [width for width in kinds for _ in range(3)][: len(self._base)]
        full = np.column_stack([self._rows, self._error])
        self._moments = np.zeros((means.blocks(), _ERROR + 1, _ERROR + 1))
        np.add.at(self._moments, means.block, full[:, :, np.newaxis] * full[:, np.newaxis, :])
        fold = np.full(means.blocks(), -1)
        fold[means.block] = stretch % FOLDS
        self._fold = fold

    def errors_mg(self, suspect: Suspect | None) -> list[float]:
        """Mean error of each stretch by a fit of the others."""
        left = np.empty(len(self._error))
        for fold in range(FOLDS):
            out = self._fold[self._block] == fold
            if out.any():
                left[out] = self._left(self._fit(suspect, self._fold != fold), suspect)[out]
        deviations = 1000 * np.abs(left)
        stretches = sorted(set(self._stretch.tolist()))
        return [float(deviations[self._stretch == one].mean()) for one in stretches]

    def found(self, suspect: Suspect) -> Found:
        """What a suspect explains of all observations, and of those that are held out."""
        place, values = self._fit(suspect, np.ones(len(self._fold), np.bool_))
        changing = values[len(self._base) :].reshape(suspect.courses.shape[2], -1)
        path = suspect.courses[place] @ changing
        return Found(suspect, int(suspect.places[place]), path, self.errors_mg(suspect))

    def size_mg(self, one: Found) -> float:
        """The largest change of |a| between two times, over all directions."""
        gain, true = self._found.gain(), directions()
        raw = np.asarray(np.linalg.solve(gain, true.T).T, np.float64)
        _, rows = _linear(raw, raw - _shift(self._found, None), gain)
        moved = rows[:, one.suspect.columns] @ one.path.T
        return float(1000 * (moved.max(axis=1) - moved.min(axis=1)).max())

    def _left(self, fitted: tuple[int, Floats], suspect: Suspect | None) -> Floats:
        place, values = fitted
        explained = self._rows[:, self._base] @ values[: len(self._base)]
        if suspect is not None:
            changing = values[len(self._base) :].reshape(suspect.courses.shape[2], -1)
            path = suspect.courses[place] @ changing
            explained = explained + (self._rows[:, suspect.columns] * path[self._block]).sum(axis=1)
        return np.asarray(self._error - explained)

    def _fit(self, suspect: Suspect | None, blocks: NDArray[np.bool_]) -> tuple[int, Floats]:
        """The best place (its number) and parameters for the observations of some blocks."""
        moments = self._moments[blocks]
        total, base = moments.sum(axis=0), self._base
        noise = POPULATION.noise_g**2
        first = total[np.ix_(base, base)] + noise * np.diag(1 / np.square(self._base_widths))
        if suspect is None:
            return 0, np.linalg.solve(first, total[base, _ERROR])
        courses, columns = suspect.courses[:, blocks], suspect.columns
        number, _, functions = courses.shape
        size = functions * len(columns)
        with_base = np.tensordot(courses, moments[:, columns][:, :, [*base, _ERROR]], (1, 0))
        with_base = with_base.reshape(number, size, len(base) + 1)
        products = courses[:, :, :, np.newaxis] * courses[:, :, np.newaxis, :]
        among = np.tensordot(products, moments[:, columns][:, :, columns], (1, 0))
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
