"""The rule that adapts to the sensor's own noise (G 4.4 and Algorithm 1), causal and exact.

Grammenos, Mascolo, Crowcroft 2018: a window is still where the standard deviation of |a| is below
twice the smallest one of the recording, and that of the gyroscope below three times its smallest;
neighbouring still windows are merged. G leaves open when the minimum is known and what a window
without any spread means. Here:

- The first windows all pass, as G's do, but no window is decided at once: a candidate waits until
  `held_windows` more have come, and the minima of that moment decide. The last ones are decided by
  the minima of the whole recording. Memory is bounded, and so is what an early, higher minimum does.
- A window of one constant value has no part in the minima, and no minimum falls below what the
  sensor's step allows (`LeastSpread`).
- A first window that moves is given up at once, and so is one that the next does not agree with: G
  gathers w_min, then up to w_max; here states grow by w_min at a time (`States`).
- The rotation's standard deviation is that of the three axes together, in counts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.settings import Adaptive
from accelcal_cli.core.windows import Windows
from accelcal_cli.segment._spread import MOVING, LeastSpread, norm_bits, norms, squares
from accelcal_cli.segment._states import CANDIDATE, Candidates, States, candidates, passing
from accelcal_cli.segment.blocks import Blocks

WIDEST_TURN = 1 << 18
"""Counts; a window in which the gyroscope spreads as far is moving."""


class AdaptiveRule:
    """For windows of so many samples; remembers minima, candidates and the open state."""

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
        """Take windows in; returns the states that are decided by now."""
        found = candidates(blocks, self._spreads(blocks))
        found = found[blocks.usable & passing(found, self.numbers)]
        return self._states.add(self._decided(found))

    def rest(self) -> list[Windows]:
        """The candidates that wait, decided by the minima of the whole recording."""
        held = np.concatenate(self._waiting)
        self._waiting = [held[:0]]
        held["least_norm"], held["least_turn"] = self.least_norm.now(), self.least_turn.now()
        return [*self._states.add(held[passing(held, self.numbers)]), *self._states.rest()]

    def _decided(self, found: Candidates) -> Candidates:
        """Still windows among the candidates that enough others have followed.

        They are looked at a quarter of the waiting ones at a time, which saves copying.
        """
        self._waiting.append(found)
        wait = self.numbers.held_windows
        due = sum(map(len, self._waiting)) - wait
        if due <= wait // 4:
            return found[:0]
        held = np.concatenate(self._waiting)
        self._waiting = [held[due:].copy()]
        for name in ("least_norm", "least_turn"):
            held[name][:due] = held[name][wait:].copy()
        return held[:due][passing(held[:due], self.numbers)]

    def _spreads(self, blocks: Blocks) -> dict[str, NDArray[np.int64]]:
        """What the windows are judged by; those that were not measured have no part in the minima."""
        at = np.flatnonzero(blocks.usable & (blocks.low != blocks.high).any(axis=0))
        columns = blocks.columns[:, at]
        norm = np.zeros(len(blocks), np.int64)
        norm[at] = squares(norms(columns, self.bits), self.widest)
        turn, turning = _turns(blocks)
        return {
            "norm": norm,
            "turn": turn,
            "least_norm": self.least_norm.follow(norm, columns, at),
            "least_turn": self.least_turn.follow(turn, turning[:, at], at),
        }


def _turns(blocks: Blocks) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """n times the summed variance of the gyroscope's axes, (m,), and its columns (3, m, n).

    Without a gyroscope nothing turns.
    """
    if blocks.rotation is None:
        return np.zeros(len(blocks), np.int64), np.zeros((3, len(blocks), 1), np.int64)
    columns = np.ascontiguousarray(blocks.rotation.T).reshape(3, len(blocks), blocks.length)
    each = np.stack([squares(axis, WIDEST_TURN) for axis in columns])
    return np.where((each == MOVING).any(axis=0), MOVING, np.minimum(each, MOVING // 4).sum(axis=0)), columns
