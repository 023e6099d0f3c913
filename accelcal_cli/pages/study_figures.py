"""The figures of a study's page as paths for inline SVG: errors before and after, drifts of devices, bars.

Coordinates are in the units of the figure's view box, rounded to a tenth: the same numbers give the same text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil, floor, log10
from typing import Any

WIDTH, HEIGHT = 640, 400
LEFT, RIGHT, TOP, BOTTOM = 56, 12, 12, 44
LEAST_MG, LARGEST_MG = 0.01, 10_000.0
"""Errors beyond are drawn at the edge."""
LARGEST_DRIFTS = 30
ROW = 18
NAMES = 150
"""Width of the names in the figure of drifts."""
BAR = 1000
"""Width of a bar that stands for all."""
LONGEST_NAME = 20


@dataclass(frozen=True, slots=True)
class Drift:
    """Change in a month with its standard error, and whether it is certain."""

    per_month: float
    error: float
    certain: bool


@dataclass(frozen=True, slots=True)
class Tick:
    """A line of the grid: where, and what it says."""

    at: float
    label: str


Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Scatter:
    """Errors before (to the right) and after (upwards), both on the same logarithmic scale.

    Attributes:
        low, high: powers of ten at the ends of both axes.
        places: (x, y) of each recording; None where an error is not known.
    """

    low: int
    high: int
    places: tuple[Place | None, ...] = field(default=())
    width: int = WIDTH
    height: int = HEIGHT
    left: int = LEFT
    top: int = TOP
    right: int = WIDTH - RIGHT
    bottom: int = HEIGHT - BOTTOM

    @classmethod
    def of(cls, pairs: Sequence[tuple[float, float] | None]) -> Scatter:
        """The scatter of errors before and after [mg]."""
        known = [min(max(value, LEAST_MG), LARGEST_MG) for pair in pairs if pair for value in pair]
        low = floor(log10(min(known, default=0.1)))
        high = max(ceil(log10(max(known, default=100.0))), low + 1)
        empty = cls(low, high)
        return cls(low, high, tuple(pair and (empty.x(pair[0]), empty.y(pair[1])) for pair in pairs))

    def _share(self, mg: float) -> float:
        held = min(max(mg, 10.0**self.low), 10.0**self.high)
        return (log10(held) - self.low) / (self.high - self.low)

    def x(self, before_mg: float) -> float:
        """Where an error before the calibration lies."""
        return round(self.left + self._share(before_mg) * (self.right - self.left), 1)

    def y(self, after_mg: float) -> float:
        """Where an error after it lies."""
        return round(self.bottom - self._share(after_mg) * (self.bottom - self.top), 1)

    @property
    def known(self) -> int:
        """Recordings that are drawn."""
        return sum(place is not None for place in self.places)

    @property
    def ticks(self) -> list[tuple[Tick, Tick]]:
        """For each power of ten its place to the right and upwards."""
        powers = [10.0**power for power in range(self.low, self.high + 1)]
        return [(Tick(self.x(mg), f"{mg:g}"), Tick(self.y(mg), f"{mg:g}")) for mg in powers]

    def dots(self, outcomes: Sequence[str]) -> list[tuple[str, str, int]]:
        """For each outcome a path of dots (lines of no length with round ends), and how many they are.

        Dots at the same place to a whole unit are drawn once.
        """
        drawn: list[tuple[str, str, int]] = []
        for outcome in sorted(set(outcomes)):
            own = [
                place for place, one in zip(self.places, outcomes, strict=True) if place and one == outcome
            ]
            dots = sorted({(round(x), round(y)) for x, y in own})
            if dots:
                drawn.append((outcome, "".join(f"M{x} {y}h0" for x, y in dots), len(own)))
        return drawn

    def scale(self) -> dict[str, Any]:
        """What a script needs to find the recording of a dot."""
        box = {name: getattr(self, name) for name in ("left", "right", "top", "bottom", "low", "high")}
        return {"x": "before", "y": "after", **box}


@dataclass(frozen=True, slots=True)
class DriftRow:
    """One device in the figure of drifts: its name, the ends of its 95 % interval, and its place."""

    name: str
    text: str
    low: float
    high: float
    x: float
    y: float
    certain: bool


@dataclass(frozen=True, slots=True)
class DriftFigure:
    """The fastest drifts of offsets, a row for each device, with 0 and the limit on both sides."""

    rows: list[DriftRow]
    ticks: list[Tick]
    limits: tuple[float, float]
    zero: float
    width: int
    height: int
    omitted: int

    @property
    def bottom(self) -> int:
        """Where the rows end."""
        return self.height - BOTTOM


def drifts(devices: Sequence[tuple[str, Drift | None]], limit: float) -> DriftFigure | None:
    """The figure of the fastest drifts [mg a month]; None if no device has one.

    Args:
        limit: beyond which a drift is a reason for service [mg a month].
    """
    known = [(name, drift) for name, drift in devices if drift is not None]
    if not known:
        return None
    fastest = sorted(known, key=lambda one: -abs(one[1].per_month))[:LARGEST_DRIFTS]
    widest = max(1.25 * limit, *(abs(drift.per_month) for _, drift in fastest)) * 1.1

    def x(value: float) -> float:
        held = min(max(value, -widest), widest)
        return round(NAMES + (held + widest) / (2 * widest) * (WIDTH - NAMES - RIGHT), 1)

    rows = [
        DriftRow(
            name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…",
            f"{name}: {drift.per_month:+.3g} ± {drift.error:.2g} mg a month",
            x(drift.per_month - 2 * drift.error),
            x(drift.per_month + 2 * drift.error),
            x(drift.per_month),
            TOP + ROW * (index + 0.5),
            drift.certain,
        )
        for index, (name, drift) in enumerate(fastest)
    ]
    step = _step(widest)
    count = floor(widest / step)
    ticks = [Tick(x(step * number), f"{step * number:g}") for number in range(-count, count + 1)]
    height = TOP + ROW * len(rows) + BOTTOM
    return DriftFigure(rows, ticks, (x(-limit), x(limit)), x(0.0), WIDTH, height, len(known) - len(rows))


def _step(widest: float) -> float:
    """1, 2 or 5 times a power of ten, of which two to five go into the width."""
    power = 10.0 ** floor(log10(widest / 2))
    return next(factor * power for factor in (5, 2, 1) if widest >= 2 * factor * power)


def bar(number: int, total: int) -> int:
    """Width of a bar, of BAR for all; what is there at all can be seen."""
    return 0 if not number else max(4, round(BAR * number / total))
