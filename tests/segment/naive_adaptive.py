"""The adaptive rule by its definition: one window after the other, in Python's integers and Fractions."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from itertools import pairwise
from math import ceil, floor, ldexp, sqrt

from accelcal_cli.core.settings import Adaptive
from accelcal_cli.segment.adaptive import WIDEST_TURN
from tests.segment.streams import Stream, variance

State = tuple[int, int, tuple[int, ...], tuple[int, ...], int | None]
"""First sample, samples, sums, spreads, temperature sum."""


@dataclass
class Least:
    """The smallest n var so far and the sensor's step; `scale` units are a count."""

    samples: int
    axes: int
    widest: int
    scale: Fraction
    found: list[int] = field(default_factory=list)
    jumps: list[int] = field(default_factory=list)

    def see(self, scatter: int | None, columns: list[list[int]]) -> None:
        if scatter:
            self.found.append(scatter)
        self.jumps += [abs(b - a) for column in columns for a, b in pairwise(column) if a != b]

    def now(self) -> int:
        step = min([self.widest, *self.jumps])
        rounding = self.axes * self.samples * (step * self.scale) ** 2 / 12
        return max(1, floor(rounding), min(self.found, default=0)) if self.found else 1 << 52


@dataclass
class Window:
    first: int
    rows: list[list[int]]
    constant: bool
    norm: int | None
    turn: int | None
    heat: int | None
    run: int
    least: tuple[int, int] = (0, 0)


def scatter(values: list[int], widest: int) -> int | None:
    """n times the variance, rounded up; None where the values are too far apart to look at."""
    return None if max(values) - min(values) >= widest else ceil(len(values) * variance(values))


class Naive:
    def __init__(self, lsb_per_g: float, length: int, numbers: Adaptive) -> None:
        self.numbers, self.length, self.bits = numbers, length, 0
        while lsb_per_g * 2.0**self.bits < 2**16:
            self.bits += 1
        while lsb_per_g * 2.0**self.bits >= 2**17:
            self.bits -= 1
        self.scale = Fraction(2) ** self.bits
        half_g = max(1, round(lsb_per_g / 2))
        self.widest = max(1, round(lsb_per_g / 2 * 2.0**self.bits))
        self.norms = Least(length, 1, half_g, self.scale)
        self.turns = Least(length, 3, WIDEST_TURN, Fraction(1))

    def states(self, stream: Stream) -> list[State]:
        waiting: list[Window] = []
        still: list[Window] = []
        for window in self._windows(stream):
            if not self._passes(window, self._least()):
                continue
            waiting.append(window)
            if len(waiting) > self.numbers.held_windows:
                self._decide(waiting.pop(0), still)
        for window in waiting:
            self._decide(window, still)
        return self._joined(still)

    def _windows(self, stream: Stream):
        edges = sorted({0, *stream.breaks, len(stream.counts)})
        for run, (low, high) in enumerate(pairwise(edges)):
            for first in range(low, high - self.length + 1, self.length):
                at = slice(first, first + self.length)
                if stream.validity is None or not stream.validity[at].any():
                    yield self._window(stream, at, run)

    def _window(self, stream: Stream, at: slice, run: int) -> Window:
        rows = stream.counts[at].tolist()
        lengths = [sqrt(float(x) * x + float(y) * y + float(z) * z) for x, y, z in rows]
        norm = scatter([round(ldexp(value, self.bits)) for value in lengths], self.widest)
        constant = all(row == rows[0] for row in rows)
        turn, turns = 0, []
        if stream.gyro is not None:
            turns = [list(column) for column in zip(*stream.gyro[at].tolist(), strict=True)]
            each = [scatter(column, WIDEST_TURN) for column in turns]
            turn = None if None in each else sum(each)
        if not constant:
            self.norms.see(norm, [list(column) for column in zip(*rows, strict=True)])
            self.turns.see(turn, turns)
        heat = None if stream.temperature_mc is None else sum(stream.temperature_mc[at].tolist())
        return Window(at.start, rows, constant, norm, turn, heat, run)

    def _least(self) -> tuple[int, int]:
        return self.norms.now(), self.turns.now()

    def _passes(self, window: Window, least: tuple[int, int]) -> bool:
        """Standard deviations compared by their squares."""
        if window.norm is None or window.turn is None:
            return False
        factors = self.numbers.acceleration_factor, self.numbers.rotation_factor
        return window.norm < factors[0] ** 2 * least[0] and window.turn < factors[1] ** 2 * least[1]

    def _decide(self, window: Window, still: list[Window]) -> None:
        window.least = self._least()
        if self._passes(window, window.least):
            still.append(window)

    def _joined(self, still: list[Window]) -> list[State]:
        states: list[list[Window]] = []
        for window in still:
            if states and self._joins(states[-1], window):
                states[-1].append(window)
            else:
                states.append([window])
        fewest = self.numbers.min_windows
        return [state_row(state) for state in states if len(state) >= fewest or state[0].constant]

    def _joins(self, state: list[Window], window: Window) -> bool:
        last, first = state[-1], state[0]
        if window.first != last.first + self.length or window.run != last.run:
            return False
        if window.constant or last.constant or len(state) == self.numbers.max_windows:
            return False
        variance_counts = Fraction(first.least[0], self.length) / self.scale**2
        for a, b in zip(zip(*first.rows, strict=True), zip(*window.rows, strict=True), strict=True):
            difference = Fraction(sum(b) - sum(a), self.length)
            if difference**2 >= self.numbers.acceleration_factor**2 * variance_counts:
                return False
        return True


def state_row(state: list[Window]) -> State:
    columns = list(zip(*(row for window in state for row in window.rows), strict=True))
    return (
        state[0].first,
        len(columns[0]),
        tuple(sum(column) for column in columns),
        tuple(max(column) - min(column) for column in columns),
        None if state[0].heat is None else sum(window.heat for window in state),
    )
