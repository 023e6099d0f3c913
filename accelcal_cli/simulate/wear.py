"""What a wrist does all day: bouts of sleep, desk, walking, chores, watch on the table.

Each bout gives true acceleration in g and says which samples are motionless. Directions are of the
specific force at rest: a watch lying face up reads (0, 0, 1).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SLEEP_POSTURES = (
    (0.0, 0.1, -1.0),
    (-0.9, 0.2, -0.4),
    (0.3, -0.9, 0.3),
    (0.1, 0.4, 0.9),
    (0.8, 0.5, -0.2),
    (-0.3, 0.9, -0.1),
)
DESK_POSTURES = ((0.1, -0.2, 0.97), (0.5, 0.1, 0.85), (-0.4, 0.5, 0.75), (-0.85, -0.2, 0.4))
TABLE = (0.02, -0.03, 1.0)
ARM_DOWN = (-0.97, 0.1, 0.2)
TURN_SECONDS = (0.6, 2.5)
SETTLE_SECONDS = 0.5


@dataclass(frozen=True, slots=True)
class Bout:
    """Some seconds of wear: acceleration (n, 3) in g, motionless samples (n,), and whether worn."""

    acceleration: Floats
    still: NDArray[np.bool_]
    worn: bool


def unit(vector: Floats) -> Floats:
    """Scale to length 1 along the last axis."""
    return np.asarray(vector / np.sqrt((vector**2).sum(axis=-1, keepdims=True)))


class Wearer:
    """Makes bouts one after another; the wrist turns from each posture to the next."""

    def __init__(self, rate_hz: float, seed: int) -> None:
        self.rate_hz = rate_hz
        self.random = RandomState(seed)
        self.direction = unit(np.array(TABLE))

    def bouts(self) -> Iterator[Bout]:
        """Bouts without end, from midnight on."""
        seconds = 0.0
        while True:
            bout = self._bout(seconds / 3600 % 24)
            seconds += len(bout.still) / self.rate_hz
            yield bout

    def _bout(self, hour: float) -> Bout:
        chance = self.random.rand()
        if hour >= 23 or hour < 7:
            return self._sleep(chance)
        if 20.5 <= hour < 21 and chance < 0.5:
            return self._table()
        return self._day(chance)

    def _sleep(self, chance: float) -> Bout:
        posture = self._near(SLEEP_POSTURES, 0.25)
        if chance < 0.8:
            return self._rest(posture, self._minutes(9.0, 0.8))
        return self._moving(posture, self.random.uniform(5, 60), 0.15)

    def _table(self) -> Bout:
        bout = self._rest(self._near((TABLE,), 0.02), self.random.uniform(300, 1200))
        return Bout(bout.acceleration, bout.still, worn=False)

    def _day(self, chance: float) -> Bout:
        if chance < 0.35:
            return self._rest(self._anywhere(), self._minutes(0.6, 0.9))
        if chance < 0.6:
            return self._tremor(self._near(DESK_POSTURES, 0.3), self.random.uniform(10, 200))
        if chance < 0.8:
            return self._walking(self.random.uniform(30, 400))
        return self._moving(self._anywhere(), self._minutes(0.9, 0.9), 0.35)

    def _minutes(self, median: float, spread: float) -> float:
        return float(np.clip(60 * median * np.exp(spread * self.random.randn()), 4, 3600))

    def _near(self, postures: tuple[tuple[float, float, float], ...], spread: float) -> Floats:
        chosen = np.array(postures[self.random.randint(len(postures))])
        return unit(chosen + spread * self.random.randn(3))

    def _anywhere(self) -> Floats:
        return unit(self.random.randn(3))

    def _turn(self, target: Floats, seconds: float) -> tuple[Floats, int]:
        """Directions for a bout: a smooth turn to the target, then hold; and the turn's samples."""
        number = max(2, round(seconds * self.rate_hz))
        turning = min(number, max(1, round(self.random.uniform(*TURN_SECONDS) * self.rate_hz)))
        start = self.direction
        if float(start @ target) < -0.98:
            start = unit(start + 0.2 * self.random.randn(3))
        share = np.ones(number)
        share[:turning] = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, turning + 1) / turning)
        path = unit(start * (1 - share)[:, None] + target * share[:, None])
        self.direction = path[-1]
        return path, turning

    def _rest(self, target: Floats, seconds: float) -> Bout:
        path, turning = self._turn(target, seconds)
        still = np.zeros(len(path), np.bool_)
        still[turning + round(SETTLE_SECONDS * self.rate_hz) :] = True
        return Bout(path, still, worn=True)

    def _tremor(self, target: Floats, seconds: float) -> Bout:
        path, _ = self._turn(target, seconds)
        size = self.random.uniform(0.004, 0.03)
        return Bout(path + self._waves(len(path), size, 0.3, 9.0), np.zeros(len(path), np.bool_), worn=True)

    def _moving(self, target: Floats, seconds: float, size: float) -> Bout:
        path, _ = self._turn(target, seconds)
        swaying = unit(path + self._waves(len(path), size, 0.1, 0.6))
        self.direction = swaying[-1]
        shaken = swaying + self._waves(len(path), size * self.random.uniform(0.2, 1.0), 0.5, 4.0)
        return Bout(shaken, np.zeros(len(path), np.bool_), worn=True)

    def _walking(self, seconds: float) -> Bout:
        path, _ = self._turn(self._near((ARM_DOWN,), 0.15), seconds)
        steps = self.random.uniform(1.6, 2.1)
        time = np.arange(len(path)) / self.rate_hz
        swing = self.random.uniform(0.1, 0.5) * np.sin(np.pi * steps * time + 6.28 * self.random.rand())
        impact = self.random.uniform(0.1, 0.6) * np.sin(2 * np.pi * steps * time) ** 3
        side = unit(self.random.randn(3))
        swung = unit(path + swing[:, None] * side)
        self.direction = swung[-1]
        return Bout(swung * (1 + impact)[:, None], np.zeros(len(path), np.bool_), worn=True)

    def _waves(self, number: int, size: float, low_hz: float, high_hz: float) -> Floats:
        time = np.arange(number)[:, None] / self.rate_hz
        frequency = self.random.uniform(low_hz, high_hz, 3)
        return np.asarray(size * np.sin(2 * np.pi * (frequency * time + self.random.rand(3))))
