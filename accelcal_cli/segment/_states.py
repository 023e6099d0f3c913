"""Candidates that wait for their decision, and states made of neighbouring still windows."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.settings import Adaptive
from accelcal_cli.core.windows import Windows
from accelcal_cli.segment.blocks import Blocks

CANDIDATE = np.dtype(
    [
        ("run", np.int64),
        ("first", np.int64),
        ("sums", np.int64, 3),
        ("low", np.int64, 3),
        ("high", np.int64, 3),
        ("warm", np.int64),
        ("warm_known", np.bool_),
        ("norm", np.int64),
        ("turn", np.int64),
        ("least_norm", np.int64),
        ("least_turn", np.int64),
    ]
)
"""A window that may be still: norm and turn are n times the variance of |a| and of the rotation,
the least ones their minima when it came, later those by which it was decided."""

Candidates = NDArray[Any]


def candidates(blocks: Blocks, spreads: dict[str, NDArray[np.int64]]) -> Candidates:
    """Blocks as candidates; `spreads` holds norm, turn, least_norm and least_turn, each (m,)."""
    made = np.zeros(len(blocks), CANDIDATE)
    made["run"] = blocks.run
    made["first"] = blocks.first_samples()
    made["sums"], made["low"], made["high"] = blocks.sums.T, blocks.low.T, blocks.high.T
    if blocks.temperature_sums is not None:
        made["warm"], made["warm_known"] = blocks.temperature_sums, True
    for name, values in spreads.items():
        made[name] = values
    return made


def constant(held: Candidates) -> NDArray[np.bool_]:
    """Which windows hold one value only."""
    return np.asarray((held["low"] == held["high"]).all(axis=1))


def passing(held: Candidates, numbers: Adaptive) -> NDArray[np.bool_]:
    """G 4.4: standard deviations below so many times their minima."""
    calm = held["norm"] < numbers.acceleration_factor**2 * held["least_norm"]
    return np.asarray(calm & (held["turn"] < numbers.rotation_factor**2 * held["least_turn"]))


class States:
    """Joins still windows that follow one another and agree, in the order of time.

    A window joins the state before it if no sample and no break lies between them, the mean of each
    axis is within `acceleration_factor` times the minimum standard deviation of that of the state's
    first window, and the state is not full. A state of too few windows is none. Windows of one
    constant value are left single, for the collector to decide whether they were measured.
    """

    def __init__(self, length: int, bits: int, numbers: Adaptive) -> None:
        self.length = length
        self.bits = bits
        self.numbers = numbers
        self._open = np.zeros(0, CANDIDATE)

    def add(self, still: Candidates) -> list[Windows]:
        """Take still windows in; returns the states that are complete."""
        held = np.concatenate([self._open, still])
        starts = list(self._starts(held))
        if not starts:
            return []
        self._open = held[starts[-1] :].copy()
        return self._windows(held[: starts[-1]], np.array(starts))

    def rest(self) -> list[Windows]:
        """The last state."""
        held, self._open = self._open, self._open[:0]
        return self._windows(held, np.array([0, len(held)]))

    def _starts(self, held: Candidates) -> Iterator[int]:
        """Where states begin."""
        new = np.ones(len(held), np.bool_)
        alone = constant(held)
        new[1:] = (np.diff(held["first"]) != self.length) | (np.diff(held["run"]) != 0)
        new[1:] |= alone[1:] | alone[:-1] | (held["warm_known"][1:] != held["warm_known"][:-1])
        edges = [*np.flatnonzero(new).tolist(), len(held)]
        for low, high in pairwise(edges):
            start = low
            while start < high:
                yield start
                start = self._end(held[start : min(high, start + self.numbers.max_windows)], start)

    def _end(self, reach: Candidates, start: int) -> int:
        """Where the state of the first of these windows ends."""
        limit = self._tolerance(int(reach["least_norm"][0]))
        far = (np.abs(reach["sums"] - reach["sums"][0]) > limit).any(axis=1)
        return start + (int(far.argmax()) if far.any() else len(reach))

    def _tolerance(self, least: int) -> int:
        """Largest difference of two sums of counts whose means agree.

        With n samples a window, n var = least / 4^bits: difference^2 < factor^2 n^2 var.
        """
        square = self.numbers.acceleration_factor**2 * self.length * least
        scaled = (square - 1) >> 2 * self.bits if self.bits >= 0 else (square << -2 * self.bits) - 1
        return isqrt(scaled)

    def _windows(self, held: Candidates, starts: NDArray[np.int64]) -> list[Windows]:
        """States between consecutive starts, in batches that all have temperatures or none."""
        at, number = starts[:-1], np.diff(starts)
        if not len(held):
            return []
        enough = (number >= self.numbers.min_windows) | constant(held[at])
        known = held["warm_known"][at]
        warm = np.add.reduceat(held["warm"], at)
        spread = np.maximum.reduceat(held["high"], at) - np.minimum.reduceat(held["low"], at)
        sums = np.add.reduceat(held["sums"], at)
        made = Windows(number * self.length, held["first"][at], sums, spread, warm)
        return [
            self._with_temperature(made.select(_only(part, enough)), known=bool(known[part[0]]))
            for part in np.split(np.arange(len(at)), np.flatnonzero(np.diff(known)) + 1)
        ]

    def _with_temperature(self, made: Windows, *, known: bool) -> Windows:
        return made if known else Windows(made.samples, made.first_sample, made.sums, made.spread)


def _only(part: NDArray[np.int64], which: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask with nothing outside a part."""
    mask = np.zeros(len(which), np.bool_)
    mask[part] = which[part]
    return mask
