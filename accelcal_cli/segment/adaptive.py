"""The rule that adapts to the sensor's own noise (G 4.4 and Algorithm 1), causal and exact.

Grammenos, Mascolo, Crowcroft 2018: a window is still if the standard deviation of |a| is below
twice the smallest one of the recording, and that of the gyroscope below three times its smallest;
neighbouring still windows are merged. G does not say when the minimum is known, nor what a window
without any spread means. Here:

- The first windows all pass, as G's do, but no window is decided at once: a candidate waits until
  `held_windows` more have come, and the minima of that moment decide. The last ones are decided by
  the minima of the whole recording. This bounds memory, and the effect of an early, higher minimum.
- A window of one constant value does not count for the minima, and no minimum falls below what the
  sensor's step allows (`LeastSpread`).
- A first window that moves is given up at once, and so is one with which the next does not agree: G
  gathers w_min, then up to w_max; here states grow by w_min at a time (`States`).
- The rotation's standard deviation is that of the three axes together, in counts.

Variances are compared as `n times the variance, rounded up`: equal windows have equal integers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.points import Windows
from accelcal_cli.core.settings import Adaptive
from accelcal_cli.segment.segmenter import Blocks, centred_squares

CANDIDATE = np.dtype([
    ("run", np.int64), ("first", np.int64), ("sums", np.int64, 3), ("low", np.int64, 3),
    ("high", np.int64, 3), ("temperature_sum", np.int64), ("temperature_known", np.bool_),
    ("norm", np.int64), ("turn", np.int64), ("least_norm", np.int64), ("least_turn", np.int64),
])  # fmt: skip
"""A window that may be still: norm and turn are n times the variance of |a| and of the rotation, least_norm
and least_turn their minima when it came, later the minima that decide it."""

Candidates = NDArray[Any]

MOVING = 1 << 62
"""Stands for the variance of a window that is certainly moving."""

NEVER = 1 << 52
"""Stands for a minimum before there is one; 30^2 times it is below MOVING."""

NORM_BITS = 17
"""Bits of |a| at 1 g."""

WIDEST_TURN = 1 << 18
"""max - min of the gyroscope [counts] at which a window is moving."""


def candidates(blocks: Blocks, spreads: dict[str, NDArray[np.int64]]) -> Candidates:
    """Convert blocks to candidates; `spreads` holds norm, turn, least_norm and least_turn, each (m,)."""
    table = np.zeros(len(blocks), CANDIDATE)
    table["run"] = blocks.run
    table["first"] = blocks.first_samples
    table["sums"], table["low"], table["high"] = blocks.sums.T, blocks.low.T, blocks.high.T
    if (temperature_sums := blocks.temperature_sums) is not None:
        table["temperature_sum"], table["temperature_known"] = temperature_sums, True
    for name, values in spreads.items():
        table[name] = values
    return table


def constant(windows: Candidates) -> NDArray[np.bool_]:
    """Return a mask of windows that hold a single value."""
    return np.asarray((windows["low"] == windows["high"]).all(axis=1))


def passing(windows: Candidates, numbers: Adaptive) -> NDArray[np.bool_]:
    """Return a mask of windows whose standard deviations are below multiples of their minima (G 4.4)."""
    calm = windows["norm"] < numbers.acceleration_factor**2 * windows["least_norm"]
    return np.asarray(calm & (windows["turn"] < numbers.rotation_factor**2 * windows["least_turn"]))


class States:
    """Joins still windows that follow one another and agree, in the order of time.

    A window joins the state before it if no sample and no break lies between them, the mean of each
    axis differs from that of the state's first window by at most `acceleration_factor` times the minimum
    standard deviation, and the state is not full. A state of too few windows is dropped. Windows of one
    constant value stay single, so that the collector can decide if they were measured.
    """

    def __init__(self, length: int, bits: int, numbers: Adaptive) -> None:
        self.length = length
        self.bits = bits
        self.numbers = numbers
        self._open = np.zeros(0, CANDIDATE)

    def add(self, still: Candidates) -> list[Windows]:
        """Take further still windows and return the states that are complete."""
        windows = np.concatenate([self._open, still])
        starts = list(self._starts(windows))
        if not starts:
            return []
        self._open = windows[starts[-1] :].copy()
        return self._windows(windows[: starts[-1]], np.array(starts))

    def rest(self) -> list[Windows]:
        """Return the last state."""
        windows, self._open = self._open, self._open[:0]
        return self._windows(windows, np.array([0, len(windows)]))

    def _starts(self, windows: Candidates) -> Iterator[int]:
        """Yield the numbers of the windows at which states begin."""
        new = np.ones(len(windows), np.bool_)
        alone = constant(windows)
        new[1:] = (np.diff(windows["first"]) != self.length) | (np.diff(windows["run"]) != 0)
        new[1:] |= (
            alone[1:] | alone[:-1] | (windows["temperature_known"][1:] != windows["temperature_known"][:-1])
        )
        edges = [*np.flatnonzero(new).tolist(), len(windows)]
        for low, high in pairwise(edges):
            start = low
            while start < high:
                yield start
                reach = windows[start : min(high, start + self.numbers.max_windows)]
                limit = self.tolerance(int(reach["least_norm"][0]))
                far = (np.abs(reach["sums"] - reach["sums"][0]) > limit).any(axis=1)
                start += int(far.argmax()) if far.any() else len(reach)

    def tolerance(self, least: int) -> int:
        """Return the largest difference of two sums of counts whose means agree.

        With n samples a window, n var = least / 4^bits: difference^2 < factor^2 n^2 var.
        """
        square = self.numbers.acceleration_factor**2 * self.length * least
        scaled = (square - 1) >> 2 * self.bits if self.bits >= 0 else (square << -2 * self.bits) - 1
        return isqrt(scaled)

    def _windows(self, windows: Candidates, starts: NDArray[np.int64]) -> list[Windows]:
        """Return the states between consecutive starts, in batches that all have temperatures or none."""
        first, number = starts[:-1], np.diff(starts)
        if not len(windows):
            return []
        enough = (number >= self.numbers.min_windows) | constant(windows[first])
        known = windows["temperature_known"][first]
        temperature_sums = np.add.reduceat(windows["temperature_sum"], first)
        spread = np.maximum.reduceat(windows["high"], first) - np.minimum.reduceat(windows["low"], first)
        sums = np.add.reduceat(windows["sums"], first)
        states = Windows(number * self.length, windows["first"][first], sums, spread, temperature_sums)
        without = replace(states, temperature_sums=None)
        return [
            (states if known[part[0]] else without).select(part[enough[part]])
            for part in np.split(np.arange(len(first)), np.flatnonzero(np.diff(known)) + 1)
        ]


def norm_bits(lsb_per_g: float) -> int:
    """Return b with which 1 g has between 2^16 and 2^17 units of 2^-b counts."""
    return NORM_BITS - int(np.frexp(lsb_per_g)[1])


def norms(columns: NDArray[Any], bits: int) -> NDArray[np.int64]:
    """Return |a| of counts (3, ...) in units of 2^-bits counts.

    Products, sums, roots and powers of two are each rounded correctly (IEEE 754) in a fixed order,
    so that the integers are the same on every machine.
    """
    x, y, z = columns.astype(np.float64)
    return np.asarray(np.rint(np.ldexp(np.sqrt(x * x + y * y + z * z), bits)).astype(np.int64))


def squares(blocks: NDArray[Any], widest: int) -> NDArray[np.int64]:
    """Return n times the variance of (m, n) values, rounded up; MOVING where max - min reaches `widest`."""
    spread = blocks.max(axis=1).astype(np.int64) - blocks.min(axis=1)
    scaled = np.full(len(blocks), MOVING, np.int64)
    index = np.flatnonzero(spread < widest)
    if len(index):
        near = blocks[index].astype(np.int64)
        centred, r = centred_squares(near, spread[index], near.sum(axis=1))
        scaled[index] = centred - r * r // blocks.shape[1]
    return scaled


def steps(columns: NDArray[Any], widest: int) -> NDArray[np.int64]:
    """Return the smallest non-zero difference of consecutive values (axes, m, n), (m,); at most `widest`."""
    jumps = np.abs(np.diff(columns.astype(np.int64), axis=2))
    jumps[jumps == 0] = widest
    return np.asarray(jumps.min(axis=(0, 2), initial=widest))


class LeastSpread:
    """The smallest n times the variance so far, at least what the sensor's step allows.

    Readings in steps of d have a standard deviation of d / sqrt(12) from rounding alone; if a window has
    less, the value happened to lie between two steps. The step is the smallest difference of two consecutive
    readings so far, at first `widest` counts.

    Args:
        length: n, samples of a window.
        axes: number of axes whose variances are summed.
        bits: variances are in units of 2^-bits counts.
    """

    def __init__(self, length: int, axes: int, widest: int, bits: int = 0) -> None:
        self.length = length
        self.axes = axes
        self.widest = widest
        self.bits = bits
        self.step = widest
        self._least = NEVER

    def now(self) -> int:
        """Return the minimum after all windows so far."""
        return max(self._least, self._floor(self.step))

    def follow(
        self, values: NDArray[np.int64], columns: NDArray[Any], index: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return the minimum after each of m windows, (m,).

        Args:
            values: (m,) n times the variance of each; 0 and MOVING are ignored.
            columns: (axes, k, n) readings [counts] of the k windows that count.
            index: (k,) their numbers.
        """
        counted = np.full(len(values), NEVER)
        counted[index] = np.where((values[index] > 0) & (values[index] < NEVER), values[index], NEVER)
        least = np.minimum(np.minimum.accumulate(counted), self._least)
        observed = np.full(len(values), self.step)
        if self.step > 1:  # at least one count
            observed[index] = steps(columns, self.widest)
        step = np.minimum(np.minimum.accumulate(observed), self.step)
        floors = {step_size: self._floor(step_size) for step_size in set(step.tolist())}
        allowed = np.array([floors[step_size] for step_size in step.tolist()], np.int64)
        self._least, self.step = int(least[-1]), int(step[-1])
        return np.maximum(least, allowed)

    def _floor(self, step: int) -> int:
        """Return n times the variance of rounding to steps, at least 1, at most NEVER."""
        whole = self.axes * self.length * step * step
        scaled = whole << 2 * self.bits if self.bits >= 0 else whole >> -2 * self.bits
        return max(1, min(NEVER, scaled // 12))


class AdaptiveRule:
    """The rule for windows of `length` samples, with its minima, candidates and open state."""

    def __init__(self, length: int, lsb_per_g: float, numbers: Adaptive) -> None:
        self.numbers = numbers
        self.bits = norm_bits(lsb_per_g)
        half_g = max(1, round(lsb_per_g / 2))
        self.widest = max(1, round(np.ldexp(lsb_per_g / 2, self.bits)))
        self.least_norm = LeastSpread(length, 1, half_g, self.bits)
        self.least_turn = LeastSpread(length, 3, WIDEST_TURN)
        self._waiting = [np.zeros(0, CANDIDATE)]
        self._states = States(length, self.bits, numbers)

    def take(self, blocks: Blocks) -> list[Windows]:
        """Take further windows and return the states that are decided by now."""
        new = candidates(blocks, self._spreads(blocks))
        self._waiting.append(new[blocks.usable & passing(new, self.numbers)])
        wait = self.numbers.held_windows
        # they are decided a quarter of the waiting ones at a time, which saves copying
        enough = 4 * (sum(map(len, self._waiting)) - wait) > wait
        return self._states.add(self._all_decided() if enough else new[:0])

    def rest(self) -> list[Windows]:
        """Return the last states; waiting candidates are decided by the minima of the whole recording."""
        followed, waiting = self._all_decided(), self._waiting[0]
        waiting["least_norm"], waiting["least_turn"] = self.least_norm.now(), self.least_turn.now()
        last = waiting[passing(waiting, self.numbers)]
        self._waiting = [waiting[:0]]
        return [*self._states.add(np.concatenate([followed, last])), *self._states.rest()]

    def _all_decided(self) -> Candidates:
        """Return still windows among all candidates that have waited long enough; the others stay waiting."""
        waiting, wait = np.concatenate(self._waiting), self.numbers.held_windows
        due = max(0, len(waiting) - wait)
        self._waiting = [waiting[due:].copy()]
        for name in ("least_norm", "least_turn"):
            waiting[name][:due] = waiting[name][wait:].copy()
        return waiting[:due][passing(waiting[:due], self.numbers)]

    def _spreads(self, blocks: Blocks) -> dict[str, NDArray[np.int64]]:
        """Return what windows are judged by; only measured windows count for the minima."""
        index = np.flatnonzero(blocks.usable & (blocks.low != blocks.high).any(axis=0))
        columns = blocks.columns[:, index]
        norm = np.zeros(len(blocks), np.int64)
        norm[index] = squares(norms(columns, self.bits), self.widest)
        turn, turning = _turns(blocks)
        return {
            "norm": norm,
            "turn": turn,
            "least_norm": self.least_norm.follow(norm, columns, index),
            "least_turn": self.least_turn.follow(turn, turning[:, index], index),
        }


def _turns(blocks: Blocks) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Return n times the summed variance of the gyroscope's axes, (m,), and its columns (3, m, n).

    Without a gyroscope both are zero.
    """
    if blocks.rows.gyro_counts is None:
        return np.zeros(len(blocks), np.int64), np.zeros((3, len(blocks), 1), np.int64)
    columns = np.ascontiguousarray(blocks.rows.gyro_counts.T).reshape(3, len(blocks), blocks.length)
    each = np.stack([squares(axis, WIDEST_TURN) for axis in columns])
    return np.where((each == MOVING).any(axis=0), MOVING, np.minimum(each, MOVING // 4).sum(axis=0)), columns
