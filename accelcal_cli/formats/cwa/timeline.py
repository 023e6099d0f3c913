"""Finds how each sector continues the one before (lost sectors, restarts, jumps of the clock), and its times.

The sensor has its own oscillator, which is percents off its nominal rate and drifts with temperature, so that
only the anchors show when a sample was taken: times lie on straight lines between them. Before the
first and after the last anchor of an unbroken run the line continues with the run's own rate at that end.
Sectors begin and end on these lines; the samples of a sector are evenly spread.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import cut_columns, joined_columns
from accelcal_cli.formats._pages.timeline import (
    CLOCK_AHEAD,
    CLOCK_BACK,
    LONGEST_GAP_S,
    NO_SPANS,
    RATE_TOLERANCE,
    Findings,
    Spans,
)
from accelcal_cli.formats.cwa.sector import SectorBlock

MISSING_SECTORS = ("sequence_gap", "data sectors missing by their sequence numbers")
RESTARTED = ("sequence_back", "restarts of the logging, where the sequence numbers begin again")
SESSION = ("session_change", "changes of the session number: the device was set up again")
OVERFLOW = ("device_overflow", "data sectors where the device says that it lost samples")
UNTIMED = (
    "missing_value",
    "data sectors without a valid time, placed by counting samples at the nominal rate",
)

STAMP_TOLERANCE_US, END_ANCHORS = 250_000, 32
"""Difference of the clock [us] that a slow memory makes, and anchors that show the rate of an end."""

LONGEST_PERIODS, LONGEST_BRIDGE = 4, 100
"""Most periods for each of a few samples between anchors; lost sectors from which on times begin again."""

RUN_SHIFT = 42
ROW_ORIGIN = 1 << 20
"""Bits and origin of sample numbers in an ascending key of run and sample; rows stay below 2**41."""


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Sectors on the time axis; (p,) each.

    Attributes:
        row: int64, number of the first sample; lost sectors that are bridged count too.
        rows: int64, samples in the sector.
        anchor_row, anchor_us: int64, a sample number on the same axis and its time [us].
        fresh: bool, the times begin again here.
        untimed: bool, the sector has no time of its own.
    """

    row: NDArray[np.int64]
    rows: NDArray[np.int64]
    anchor_row: NDArray[np.int64]
    anchor_us: NDArray[np.int64]
    fresh: NDArray[np.bool_]
    untimed: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.row)

    def followed_by(self, second: Links) -> Links:
        """Return the sectors of both, in order."""
        return Links(**joined_columns((self, second), self.__dataclass_fields__))

    def part(self, sectors: slice) -> Links:
        """Return some of the sectors."""
        return Links(**cut_columns(self, self.__dataclass_fields__, sectors))


NO_LINKS = Links(*(np.empty(0, np.int64),) * 4, *(np.empty(0, np.bool_),) * 2)


@dataclass(frozen=True, slots=True)
class _Last:
    """The sector before a block, and `known`: the last anchor that a sector gave itself."""

    position: int
    sequence: int
    session: int
    row: int
    rows: int
    anchor_row: int
    anchor_us: int
    known_row: int
    known_us: int


def nominal_us(rows: NDArray[np.int64], rate: Fraction) -> NDArray[np.int64]:
    """Return how long samples last at the nominal rate, rounded to whole microseconds."""
    return (2 * MICROSECONDS * rate.denominator * rows + rate.numerator) // (2 * rate.numerator)


class Linker:
    """Finds how sectors continue each other; takes blocks of good sectors in file order.

    Stamps may be early by `unit_us` if they are whole seconds, which several sectors may share; None: they
    are finer.
    """

    def __init__(self, rate: Fraction, full_rows: int, unit_us: int | None = None) -> None:
        self._rate, self._early_us = rate, unit_us or 0
        self._repeat = 0 if unit_us is None else full_rows
        self._full_rows = full_rows
        self._longest_gap = int(LONGEST_GAP_S * rate / full_rows) + 1
        self._last: _Last | None = None

    def link(self, block: SectorBlock) -> tuple[Links, NDArray[np.bool_], Findings]:
        """Link at least one sector to those before; return which (p,) do not continue the one before, too."""
        first = self._last is None
        last = self._last or self._before(block)
        forward, missing, restarted = self._steps(block, last)
        rows_before = _previous(last.rows, block.rows)
        bridged = np.minimum(forward, LONGEST_BRIDGE) - 1
        row = last.row + np.cumsum(rows_before + bridged * self._full_rows)
        anchor_row = row + block.anchors.row
        anchor_us, source = self._filled(block, anchor_row, last)
        lost = (forward - 1 - bridged) * self._full_rows
        passed = _steps(anchor_row, last.anchor_row) + lost
        few = (rows_before < self._full_rows) | (2 * passed < self._full_rows)
        off = self._clock_jumps(passed, _steps(anchor_us, last.anchor_us), few)
        session = _steps(block.session, last.session) != 0
        fresh = (off != 0) | restarted | session | (forward > LONGEST_BRIDGE)
        broken = fresh | (forward > 1) | block.overflow
        fresh[0] |= first
        broken[0] &= not first  # the first row of a recording is not a break
        columns = (block.position, block.sequence, block.session, row, block.rows, anchor_row, anchor_us)
        self._last = _Last(*[*(int(column[-1]) for column in columns), *source])
        untimed = ~block.anchors.known
        counts = {MISSING_SECTORS: missing, RESTARTED: restarted, SESSION: session}
        counts |= {OVERFLOW: block.overflow, UNTIMED: untimed}
        times_us = {CLOCK_AHEAD: np.maximum(off, 0), CLOCK_BACK: np.maximum(-off, 0)}
        links = Links(row, block.rows, anchor_row, anchor_us, fresh, untimed)
        return links, broken, Findings(counts, times_us)

    def _before(self, block: SectorBlock) -> _Last:
        """Return a full sector that the recording's first one would continue; sample 0 is in the latter."""
        anchor_row = int(block.anchors.row[0])
        start = np.array([anchor_row, self._full_rows], np.int64)
        since_1970, length = (int(us) for us in nominal_us(start, self._rate))
        anchor_us = int(block.anchors.time_us[0]) if block.anchors.known[0] else since_1970
        return _Last(
            position=int(block.position[0]) - 1,
            sequence=int(block.sequence[0]) - 1,
            session=int(block.session[0]),
            row=-self._full_rows,
            rows=self._full_rows,
            anchor_row=anchor_row - self._full_rows,
            anchor_us=anchor_us - length,
            known_row=anchor_row,
            known_us=anchor_us,
        )

    def _steps(self, block: SectorBlock, last: _Last) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return steps of the numbering, lost sectors, and marks of new numberings; (p,) each."""
        rise = _steps(block.sequence, last.sequence)
        if (rise == 1).all():
            return rise, np.zeros_like(rise), np.zeros(len(rise), np.bool_)
        across = _steps(block.position, last.position)
        restarted = (rise <= 0) | (rise > self._longest_gap)
        missing = np.where(restarted, 0, np.maximum(rise - across, 0))
        return np.where(restarted, 1, rise), missing, restarted

    def _filled(
        self, block: SectorBlock, anchor_row: NDArray[np.int64], last: _Last
    ) -> tuple[NDArray[np.int64], tuple[int, int]]:
        """Return anchor times, by counting samples where a sector has none, and the last true anchor."""
        known, time_us = block.anchors.known, block.anchors.time_us
        if known.all():
            return time_us, (int(anchor_row[-1]), int(time_us[-1]))
        source = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
        from_row = np.where(source < 0, last.known_row, anchor_row[source])
        from_us = np.where(source < 0, last.known_us, time_us[source])
        filled = from_us + nominal_us(anchor_row - from_row, self._rate)
        return np.where(known, time_us, filled), (int(from_row[-1]), int(from_us[-1]))

    def _clock_jumps(
        self, passed: NDArray[np.int64], passed_us: NDArray[np.int64], few: NDArray[np.bool_]
    ) -> NDArray[np.int64]:
        """Return the jump of the clock before each sector [us], 0 where it continues as it should.

        Where `few` samples lie between (the sector before is not full, or anchors are close), they may not be
        spread over a hole.
        """
        expected = passed * (MICROSECONDS * self._rate.denominator / self._rate.numerator)
        off = passed_us - expected
        tolerance = STAMP_TOLERANCE_US + self._early_us
        jump = np.abs(off) > np.maximum(RATE_TOLERANCE * np.abs(expected), tolerance)
        jump |= (passed + self._repeat <= 0) | (passed_us + MICROSECONDS * (self._repeat > 0) <= 0)
        jump |= few & (passed_us > LONGEST_PERIODS * expected + self._early_us)
        if not jump.any():
            return np.zeros(len(jump), np.int64)
        size = np.rint(off).astype(np.int64)
        return np.where(jump, np.where(size == 0, -1, size), 0)


def _steps(column: NDArray[np.int64], last: int) -> NDArray[np.int64]:
    """Return the step from each sector to the next, the first from `last`."""
    return column - _previous(last, column)


def _previous(last: int, column: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate(([last], column[:-1]))


class _Lines:
    """Straight lines from each anchor of a window to the next, and on at both ends of each run."""

    def __init__(self, window: Links, rate: Fraction) -> None:
        self._window = window
        self._rate = rate
        run = np.cumsum(window.fresh, dtype=np.int64)
        self._run = run - run[0]
        self._starts = np.append(0, np.flatnonzero(window.fresh[1:]) + 1)
        self._key = (self._run << RUN_SHIFT) + (window.anchor_row + ROW_ORIGIN)
        ends = np.append(self._starts[1:], len(window)) - 1
        self._over_rows = np.append(window.anchor_row[1:] - window.anchor_row[:-1], 0)
        self._over_us = np.append(window.anchor_us[1:] - window.anchor_us[:-1], 0)
        back = np.maximum(self._starts, ends - END_ANCHORS + 1)
        self._over_rows[ends], self._over_us[ends] = self._chord(back, ends)
        self._head = self._chord(self._starts, np.minimum(self._starts + END_ANCHORS - 1, ends))

    def _chord(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> tuple[Any, Any]:
        """Return samples and time [us] between two anchors; at the nominal rate where they are the same."""
        window, alone = self._window, first == second
        over_rows = window.anchor_row[second] - window.anchor_row[first]
        over_us = window.anchor_us[second] - window.anchor_us[first]
        nominal = self._rate.numerator, MICROSECONDS * self._rate.denominator
        return np.where(alone, nominal[0], over_rows), np.where(alone, nominal[1], over_us)

    def times(self, sector: NDArray[np.int64], row: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the times of samples `row` of the runs to which the sectors belong, rounded half up."""
        run = self._run[sector]
        key = (run << RUN_SHIFT) + (row + ROW_ORIGIN)
        before = np.searchsorted(self._key, key, side="right") - 1
        anchor = np.maximum(before, self._starts[run])
        over_rows, over_us = self._over_rows[anchor], self._over_us[anchor]
        early = np.flatnonzero(before < anchor)
        over_rows[early], over_us[early] = self._head[0][run[early]], self._head[1][run[early]]
        into = (row - self._window.anchor_row[anchor]) * over_us
        return np.asarray(self._window.anchor_us[anchor] + (2 * into + over_rows) // (2 * over_rows))


class Timeline:
    """Takes linked sectors in file order; gives times as soon as they are settled.

    A sector is settled when an anchor after its end is known, or its run has ended; sectors at the beginning
    of a run wait for the anchors that show its rate.
    """

    def __init__(self, rate: Fraction) -> None:
        self._rate, self._window, self._done = rate, NO_LINKS, 0

    def feed(self, links: Links) -> Spans:
        """Add sectors; return the times of the next settled ones."""
        self._window = self._window.followed_by(links)
        return self._release(self._settled())

    def finish(self) -> Spans:
        """Return the times of all sectors that remain; none follows."""
        return self._release(len(self._window))

    def _settled(self) -> int:
        window = self._window
        begun = self._last_run()
        if window.fresh[begun] and len(window) - begun < END_ANCHORS:  # the rate is not known yet
            return begun
        ends = window.row[begun:] + window.rows[begun:]
        return max(self._done, begun + int(np.searchsorted(ends, window.anchor_row[-1], side="right")))

    def _last_run(self) -> int:
        """Return where the last run begins in the window."""
        begun = np.flatnonzero(self._window.fresh)
        return int(begun[-1]) if len(begun) else 0

    def _release(self, settled: int) -> Spans:
        """Return the times of the sectors up to `settled`; each ends where the next begins, if it follows."""
        if settled == self._done:
            return NO_SPANS
        window, lines = self._window, _Lines(self._window, self._rate)
        ends = window.row + window.rows
        apart = window.fresh[1:settled] | (ends[: settled - 1] != window.row[1:settled])
        lonely = np.append(np.flatnonzero(apart[self._done :]) + self._done, settled - 1)
        sector = np.append(np.arange(self._done, settled), lonely)
        time_us = lines.times(sector, np.append(window.row[self._done : settled], ends[lonely]))
        begin, end = time_us[: settled - self._done], time_us[1 : settled - self._done + 1].copy()
        end[lonely - self._done] = time_us[settled - self._done :]
        rows = window.rows[self._done : settled]
        # what is unsettled is kept, with the anchor before it, and enough anchors for the end's rate
        begun = self._last_run()
        before = begun + int(np.searchsorted(window.anchor_row[begun:], ends[settled - 1], side="right")) - 1
        first = max(begun, min(settled, before, len(window) - END_ANCHORS))
        self._window, self._done = window.part(slice(first, None)), settled - first
        return Spans(begin, rows, end - begin)


# Times of sectors whose stamps are whole seconds, as early firmware and other writers have them.
#
# Such a stamp says that a sample was taken within the second that follows. Firmware that knows the
# fraction of the second moves the number of the sample instead, to the one that was taken as the
# second began: these stamps are exact (`ax3-technical.md`, `timestampOffset`). `stamp_unit` tells the
# two apart.
#
# Neighbouring stamps together are better than one: of the lines that lie within the second of each of
# `WINDOW` stamps, or miss the fewest microseconds, the middle one is taken. Windows overlap by half.
# Times lie on straight lines from the middle of each window to that of the next, so that a clock that
# drifts is followed.

WINDOW, LEAST_SECTORS = 128, 4
"""Sectors whose stamps make one line (a minute and more), and fewest that show how exact they are."""

LEAST_SPREAD_US = 100_000
"""Spread of the middle half of stamps around a line [us] from which they are not exact: half a second for
whole seconds, 30 ms for exact ones at a rate that is 6 % off."""

SLOPES, ROUNDS = 33, 5
"""Slopes of a line that are tried at a time, and how often; each time they lie 16 times as close."""


def stamp_unit(block: SectorBlock, rate: Fraction, full_rows: int) -> int | None:
    """Return by how much stamps may be early [us], 0 or a second, by some sectors; None if they are finer."""
    known = block.anchors.known
    if (block.anchors.time_us[known] % MICROSECONDS).any():
        return None
    links, *_ = Linker(rate, full_rows, MICROSECONDS).link(block)
    run = (np.cumsum(links.fresh) == 1) & known
    row, time_us = links.anchor_row[run], links.anchor_us[run]
    half = len(row) // 2
    if len(row) < LEAST_SECTORS:
        return None
    slope = float(np.median((time_us[half:] - time_us[:-half]) / np.maximum(row[half:] - row[:-half], 1)))
    low, high = np.percentile(time_us - time_us[0] - slope * (row - row[0]), (25, 75))
    return MICROSECONDS if high - low > LEAST_SPREAD_US else 0


class _Line(NamedTuple):
    """A straight line through a sample and its time [us], with the time from one sample to the next."""

    row: int
    time_us: int
    slope: float

    def times(self, row: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.asarray(self.time_us + np.rint(self.slope * (row - self.row)).astype(np.int64))


class SecondsTimeline:
    """Gives sectors times as `Timeline` does, by anchors on lines instead of the stamps."""

    def __init__(self, rate: Fraction, unit_us: int) -> None:
        self._timeline, self._unit_us = Timeline(rate), unit_us
        self._nominal = float(MICROSECONDS / rate)
        self._held = NO_LINKS
        self._before: _Line | None = None

    def feed(self, links: Links) -> Spans:
        """Add sectors; return the times of the next settled ones."""
        held, found = self._held.followed_by(links), NO_LINKS
        while True:
            fresh = np.flatnonzero(held.fresh[1:])
            end = int(fresh[0]) + 1 if len(fresh) else len(held)
            if len(fresh) and end <= WINDOW:
                found = found.followed_by(self._placed(held.part(slice(end)), whole=True))
                self._before = None
                held = held.part(slice(end, None))
            elif end > WINDOW:
                placed = self._placed(held.part(slice(WINDOW)), whole=False)
                found, held = found.followed_by(placed), held.part(slice(len(placed), None))
            else:
                break
        self._held = held
        return self._timeline.feed(found) if len(found) else NO_SPANS

    def finish(self) -> Spans:
        """Return the times of all sectors that remain; none follows."""
        spans = self._timeline.feed(self._placed(self._held, whole=True)) if len(self._held) else NO_SPANS
        return spans.followed_by(self._timeline.finish())

    def _placed(self, links: Links, *, whole: bool) -> Links:
        """Return sectors with anchors on the line from the last one to theirs: all, or up to the middle."""
        middle = (len(links) + 1) // 2
        line, before = self._line(links, int(links.row[middle - 1])), self._before
        anchor_us = line.times(links.row)
        if before is not None:
            slope = (line.time_us - before.time_us) / (line.row - before.row)
            anchor_us[:middle] = line._replace(slope=slope).times(links.row[:middle])
        self._before = line
        placed = replace(links, anchor_row=links.row, anchor_us=anchor_us)
        return placed if whole else placed.part(slice(middle))

    def _line(self, links: Links, at: int) -> _Line:
        """Return the line that lies best within the seconds of the stamps, by its time at a sample."""
        known = ~links.untimed
        if not known.any():
            known = ~known
        row, origin = links.anchor_row[known] - at, int(links.anchor_us[known][0])
        time_us = links.anchor_us[known] - origin
        slope = self._nominal
        fits = np.ptp(time_us - slope * row) <= self._unit_us
        if not fits or self._before is not None or len(row) >= WINDOW // 2:
            slope = _best_slope(row, time_us, slope)
        off = time_us - slope * row
        return _Line(at, origin + round((off.min() + off.max() + self._unit_us) / 2), slope)


def _best_slope(row: NDArray[np.int64], time_us: NDArray[np.int64], nominal: float) -> float:
    """Return the slope of the narrowest band that holds all stamps."""
    over = int(row[-1] - row[0])
    if over <= 0:
        return nominal
    best, reach = float(time_us[-1] - time_us[0]) / over, 2 * MICROSECONDS / over
    for _ in range(ROUNDS):
        slopes = best + reach * np.linspace(-1, 1, SLOPES)
        widths = np.ptp(time_us - slopes[:, np.newaxis] * row, axis=1)
        best, reach = float(slopes[np.argmin(widths)]), 2 * reach / (SLOPES - 1)
    return best
