"""The figures of a study's page as paths for inline SVG: errors before and after, drifts of devices, bars.

Coordinates are in the units of the figure's view box, rounded: the same numbers give the same text.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import floor, log10
from typing import Any

from accelcal_cli.core.arithmetic import mean
from accelcal_cli.devices.trends import Drift
from accelcal_cli.output.advice import LIKELY_YEARS
from accelcal_cli.output.numbers import number

WIDTH, HEIGHT = 640, 400
LEFT, RIGHT, TOP, BOTTOM = 56, 20, 12, 44
LEAST_MG, LARGEST_MG = 0.01, 10_000.0
"""Errors [mg] beyond which dots are drawn at the edge."""
STEPS_MG = tuple(float(f"{step}e{power}") for power in range(-2, 6) for step in (1, 2, 5))
MOST_TICKS = 10
MANY = 1000
"""Number of dots above which they are drawn small."""
GRID = 2
"""Grid to which dots are rounded, in units of the figure; a dot is five units wide."""
LARGEST_DRIFTS = 30
ROW = 18
NAMES = 150
"""Width of the names in the figure of drifts."""
BAR = 1000
"""Width of a bar of 100 %."""
LONGEST_NAME = 20


@dataclass(frozen=True, slots=True)
class Tick:
    """A line of the grid: its place and its label."""

    at: float
    label: str


Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class LogAxis:
    """A logarithmic axis from one of 1, 2 or 5 times a power of ten to another.

    Attributes:
        low_mg, high_mg: ends of the axis; begin, end: their coordinates in the figure.
    """

    low_mg: float
    high_mg: float
    begin: int
    end: int

    @classmethod
    def of(cls, values_mg: Sequence[float], begin: int, end: int) -> LogAxis:
        """Return the axis that holds all of these errors, and spans at least a power of ten."""
        drawn = [min(max(value, LEAST_MG), LARGEST_MG) for value in values_mg] or [1.0]
        low = max(step for step in STEPS_MG if step <= min(drawn))
        high = min(step for step in STEPS_MG if step > max(drawn) and step >= 10 * low)
        return cls(low, high, begin, end)

    def at(self, mg: float) -> float:
        """Return the place of an error; beyond the ends at the end."""
        drawn = min(max(mg, self.low_mg), self.high_mg)
        share = log10(drawn / self.low_mg) / log10(self.high_mg / self.low_mg)
        return round(self.begin + share * (self.end - self.begin), 1)

    @property
    def ticks(self) -> list[Tick]:
        """Ticks at 1, 2 and 5 times the powers of ten, or at these alone if there are many."""
        inside = [step for step in STEPS_MG if self.low_mg <= step <= self.high_mg]
        few = inside if len(inside) <= MOST_TICKS else [step for step in inside if log10(step).is_integer()]
        return [Tick(self.at(step), f"{step:g}") for step in few]

    def scale(self) -> list[float]:
        """Return what a script needs to find the place of an error."""
        return [log10(self.low_mg), log10(self.high_mg), self.begin, self.end]


@dataclass(frozen=True, slots=True)
class Scatter:
    """Errors before (to the right) and after (upwards).

    Attributes:
        places: (x, y) of each recording; None where an error is not known.
    """

    x: LogAxis
    y: LogAxis
    places: tuple[Place | None, ...]
    width: int = WIDTH
    height: int = HEIGHT

    @classmethod
    def of(cls, pairs: Sequence[tuple[float, float] | None]) -> Scatter:
        """Return the scatter of errors before and after [mg]."""
        known = [pair for pair in pairs if pair]
        x = LogAxis.of([before for before, _ in known], LEFT, WIDTH - RIGHT)
        y = LogAxis.of([after for _, after in known], HEIGHT - BOTTOM, TOP)
        return cls(x, y, tuple(pair and (x.at(pair[0]), y.at(pair[1])) for pair in pairs))

    @property
    def known(self) -> int:
        """Number of recordings that are drawn."""
        return sum(place is not None for place in self.places)

    @property
    def dense(self) -> bool:
        """True if dots must be small to be told apart."""
        return self.known > MANY

    @property
    def diagonal(self) -> str:
        """Path of the line on which an error stays the same; empty if it is out of sight."""
        low, high = max(self.x.low_mg, self.y.low_mg), min(self.x.high_mg, self.y.high_mg)
        if low >= high:
            return ""
        return f"M{self.x.at(low)} {self.y.at(low)}L{self.x.at(high)} {self.y.at(high)}"

    def limit(self, limit_mg: float) -> str:
        """Path of the line of the limit; empty if it is out of sight."""
        if not self.y.low_mg < limit_mg <= self.y.high_mg:
            return ""
        return f"M{self.x.begin} {self.y.at(limit_mg)}H{self.x.end}"

    def dots(self, outcomes: Sequence[str]) -> list[tuple[str, str, int]]:
        """Return for each outcome a path of dots (lines of no length with round ends) and their number.

        Dots at the same place, to GRID units, are drawn once.
        """
        drawn: list[tuple[str, str, int]] = []
        pairs = list(zip(self.places, outcomes, strict=True))
        for outcome in sorted(set(outcomes)):
            own = [place for place, one in pairs if place and one == outcome]
            dots = sorted({(GRID * round(x / GRID), GRID * round(y / GRID)) for x, y in own})
            if dots:
                drawn.append((outcome, "".join(f"M{x} {y}h0" for x, y in dots), len(own)))
        return drawn

    def scale(self) -> dict[str, Any]:
        """Return what a script needs to find the recording of a dot."""
        return {"before": self.x.scale(), "after": self.y.scale()}


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
        """Coordinate at which the rows end."""
        return self.height - BOTTOM


def drifts(devices: Sequence[tuple[str, Drift | None]], limit: float) -> DriftFigure | None:
    """Return the figure of the fastest drifts [mg a month]; None if no device has one.

    Args:
        limit: drift [mg a month] beyond which a device needs service.
    """
    known = [(name, drift) for name, drift in devices if drift is not None]
    if not known:
        return None
    fastest = sorted(known, key=lambda one: -abs(one[1].per_month))[:LARGEST_DRIFTS]
    widest = max(1.25 * limit, *(abs(drift.per_month) for _, drift in fastest)) * 1.1

    def x(value: float) -> float:
        drawn = min(max(value, -widest), widest)
        return round(NAMES + (drawn + widest) / (2 * widest) * (WIDTH - NAMES - RIGHT), 1)

    rows = [
        DriftRow(
            shortened(name),
            f"{name}: {drift.per_month:+.3g} ± {drift.error:.2g} mg a month",
            x(drift.per_month - 2 * drift.error),
            x(drift.per_month + 2 * drift.error),
            x(drift.per_month),
            TOP + ROW * (index + 0.5),
            drift.significant,
        )
        for index, (name, drift) in enumerate(fastest)
    ]
    # two to five ticks go into each side
    power = 10.0 ** floor(log10(widest / 2))
    step = next(digit * power for digit in (5, 2, 1) if widest >= 2 * digit * power)
    count = floor(widest / step)
    ticks = [Tick(x(step * number), f"{step * number:g}") for number in range(-count, count + 1)]
    height = TOP + ROW * len(rows) + BOTTOM
    return DriftFigure(rows, ticks, (x(-limit), x(limit)), x(0.0), WIDTH, height, len(known) - len(rows))


MOST_MONTHS = 60
"""Most months that are drawn: the last."""
MONTHS_HEIGHT = 150
MONTHS_GROUND = TOP + MONTHS_HEIGHT - 20


@dataclass(frozen=True, slots=True)
class MonthBar:
    """Recordings of one outcome that began in one month: a part of the month's bar."""

    outcome: str
    text: str
    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True, slots=True)
class MonthFigure:
    """Outcomes by month, a bar for each month from the first to the last.

    Attributes:
        omitted: number of recordings that began earlier, or whose year is not known or unlikely.
    """

    bars: list[MonthBar]
    ticks: list[Tick]
    counts: list[Tick]
    omitted: int
    left: int = LEFT
    right: int = WIDTH - RIGHT
    width: int = WIDTH
    height: int = MONTHS_HEIGHT + BOTTOM


def by_month(
    starts: Sequence[str | None], outcomes: Sequence[str], order: Sequence[str]
) -> MonthFigure | None:
    """Return the outcomes by the month in which recordings began; None with fewer than two months.

    Args:
        starts: times of first samples, as ISO 8601 text; None where they are not known.
        order: outcomes from the bottom of a bar upwards.
    """
    months = Counter(
        (month, outcome)
        for start, outcome in zip(starts, outcomes, strict=True)
        if (month := _month(start)) is not None
    )
    last = max((month for month, _ in months), default=0)
    shown = {key: number for key, number in months.items() if key[0] > last - MOST_MONTHS}
    sums = Counter[int]()
    for (month, _), recordings in shown.items():
        sums[month] += recordings
    if len(sums) < 2:
        return None
    first, largest = min(sums), max(sums.values())
    step, scale = (WIDTH - LEFT - RIGHT) / (last - first + 1), (MONTHS_GROUND - TOP) / largest

    def x(month: float) -> float:
        return round(LEFT + (month - first) * step, 1)

    bars, tops = [], dict.fromkeys(sums, float(MONTHS_GROUND))
    places = {name: place for place, name in enumerate(order)}
    for month, outcome in sorted(shown, key=lambda key: (key[0], places.get(key[1], len(order)), key[1])):
        number = shown[month, outcome]
        tops[month] -= number * scale
        text = f"{_month_name(month)}: {number} {outcome.replace('_', ' ')}"
        sizes = x(month), round(tops[month], 1), round(0.8 * step, 1), round(number * scale, 1)
        bars.append(MonthBar(outcome, text, *sizes))
    every = max(1, (last - first + 1) // 8)
    ticks = [Tick(x(month + 0.4), _month_name(month)) for month in range(first, last + 1, every)]
    counts = [Tick(MONTHS_GROUND, "0"), Tick(TOP, str(largest))]
    return MonthFigure(bars, ticks, counts, len(starts) - sum(sums.values()))


def _month(start: str | None) -> int | None:
    """Number months from year 0; None for what is not a date, or is that of a clock that was never set."""
    year, month = (start or "")[:4], (start or "")[5:7]
    if not (LIKELY_YEARS[0] <= year < LIKELY_YEARS[1] and month.isdecimal()):
        return None
    return 12 * int(year) + int(month) - 1


def _month_name(month: int) -> str:
    return f"{month // 12}-{month % 12 + 1:02d}"


def shortened(name: str, longest: int = LONGEST_NAME) -> str:
    """Return a name, without its end if it is longer than there is room for."""
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


def bar(number: int, total: int) -> int:
    """Return the width of a bar, of BAR for all; a count above 0 can always be seen."""
    return 0 if not number else max(4, round(BAR * number / total))


# Hours of many recordings as strips, one under the other: worn, still, not worn, filled, missing.

MOST_STRIPS = 100
"""Most recordings that are drawn: the newest."""
MOST_ROWS = 24 * 28
"""Most rows of a recording that are drawn: four weeks of hours."""
HALF = 0.5
"""Share of a row's samples, or of its time, from which filling or a gap names it."""
STRIPS_LONGEST_NAME = 24
MOSTLY_STILL = 9
"""Still windows for each moving one from which an hour counts as still."""
STRIPS_LEFT, STRIPS_WIDTH, STRIPS_ROW, STRIPS_TOP, STRIPS_BOTTOM = 170, 900, 15, 8, 40

STATES = {
    "worn": "worn and moving",
    "still": "worn, mostly still",
    "off": "not worn",
    "filled": "filled by the device",
    "gap": "missing",
    "unknown": "too little to tell",
}
"""Words for an hour, by its class in the style sheet."""


@dataclass(frozen=True, slots=True)
class StripRow:
    """The hours of a recording: its name and address, its place, and a path for each state that occurs."""

    name: str
    href: str | None
    y: int
    paths: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class StripFigure:
    """The strips of some recordings, with a tick for each day.

    Attributes:
        ticks: places and numbers of days.
    """

    rows: list[StripRow]
    ticks: list[tuple[float, str]]
    height: int
    left: int = STRIPS_LEFT
    width: int = STRIPS_WIDTH

    @property
    def states(self) -> Mapping[str, str]:
        """Words for the states of hours."""
        return STATES

    @property
    def is_full(self) -> bool:
        """True if there may be more recordings than are drawn."""
        return len(self.rows) == MOST_STRIPS


def states_of(quality: Mapping[str, Any]) -> tuple[list[str], float] | None:
    """Return the state of each row of NAME.quality.json and the length of a row [s]; None if it has none."""
    rows, row = quality.get("rows"), quality.get("row")
    if not isinstance(rows, dict) or not isinstance(row, dict):
        return None
    try:
        seconds, names = float(row["seconds"]), ("samples", "still", "moving", "filled", "gap_s", "worn")
        columns = zip(*(rows[name] for name in names), strict=True)
        states = [_state(seconds, dict(zip(names, values, strict=True))) for values in columns]
    except (KeyError, TypeError, ValueError):
        return None
    return (states[:MOST_ROWS], seconds) if states and seconds > 0 else None


def _state(seconds: float, row: Mapping[str, Any]) -> str:
    """Return the state of a row of NAME.quality.json."""
    if row["gap_s"] >= HALF * seconds or not row["samples"]:
        return "gap"
    if row["filled"] >= HALF * row["samples"]:
        return "filled"
    if row["worn"] is None:
        return "unknown"
    if not row["worn"]:
        return "off"
    return "still" if row["still"] > MOSTLY_STILL * row["moving"] else "worn"


def strips(recordings: Sequence[tuple[str, str | None, tuple[list[str], float]]]) -> StripFigure | None:
    """Return the figure; None without recordings.

    Args:
        recordings: name, address of the page (None without one), and `states_of` of each.
    """
    if not recordings:
        return None
    longest = max(len(states) * seconds for _, _, (states, seconds) in recordings)
    scale = (STRIPS_WIDTH - STRIPS_LEFT - 10) / longest
    rows = [
        StripRow(
            shortened(name.rpartition("/")[2], STRIPS_LONGEST_NAME),
            href,
            STRIPS_TOP + STRIPS_ROW * place,
            tuple(_paths(states, seconds * scale, STRIPS_TOP + STRIPS_ROW * place)),
        )
        for place, (name, href, (states, seconds)) in enumerate(recordings)
    ]
    days = int(longest // 86_400)
    step = max(1, days // 14)
    ticks = [(round(STRIPS_LEFT + day * 86_400 * scale, 1), str(day)) for day in range(0, days + 1, step)]
    return StripFigure(rows, ticks, STRIPS_TOP + STRIPS_ROW * len(rows) + STRIPS_BOTTOM)


def _paths(states: Sequence[str], width: float, y: int) -> Iterator[tuple[str, str]]:
    """Yield a path of boxes for each state, runs of the same state as one box."""
    boxes: dict[str, list[str]] = {}
    at = 0
    for state, run in groupby(states):
        number = sum(1 for _ in run)
        x, wide = round(STRIPS_LEFT + at * width, 1), round(number * width, 1)
        boxes.setdefault(state, []).append(f"M{x} {y}h{wide}v{STRIPS_ROW - 3}h-{wide}z")
        at += number
    for state in STATES:
        if state in boxes:
            yield state, "".join(boxes[state])


# The figure of a study's page on hours of wear: the error of each recording, and how many are usable.

LENGTHS_H = (1, 3, 6, 12, 24, 72, 168)
"""Hours at which classes of wear end; the last has no end."""

MOST_KINDS = 12
"""Kinds of devices that have a row, those with most recordings."""


@dataclass(frozen=True, slots=True)
class Wear:
    """One recording: its kind, hours of wear, outcome, whether it is usable, and the error claimed [mg]."""

    kind: str
    hours: float | None
    outcome: str
    usable: bool
    error_mg: float | None


@dataclass(frozen=True, slots=True)
class WearFigure:
    """Errors (upwards) against hours of wear (to the right), and a table by kind and length.

    Attributes:
        head: names of the classes of length that have a recording.
        rows: kind, and a cell for each class: recordings, share usable, mean error; empty without any.
    """

    scatter: Scatter
    dots: list[tuple[str, str, int]]
    head: list[str]
    rows: list[tuple[str, list[str]]]


def by_wear(recordings: Sequence[Wear]) -> WearFigure | None:
    """Return the figure; None with fewer than two recordings whose hours are known."""
    hours, known = [one.hours for one in recordings if one.hours], [one for one in recordings if one.hours]
    if len(known) < 2:
        return None
    x = LogAxis.of(hours, LEFT, WIDTH - RIGHT)
    y = LogAxis.of([one.error_mg for one in known if one.error_mg is not None], HEIGHT - BOTTOM, TOP)
    places = zip(map(x.at, hours), known, strict=True)
    scatter = Scatter(
        x, y, tuple(None if one.error_mg is None else (at, y.at(one.error_mg)) for at, one in places)
    )
    kinds: dict[str, list[Wear]] = {}
    for one in known:
        kinds.setdefault(one.kind, []).append(one)
    shown = sorted(kinds.items(), key=lambda pair: (-len(pair[1]), pair[0]))[:MOST_KINDS]
    shown += [("all", known)] if len(kinds) > 1 else []
    classes = sorted(set(map(_class, known)))
    rows = [(kind, [_cell(place, own) for place in classes]) for kind, own in shown]
    return WearFigure(scatter, scatter.dots([one.outcome for one in known]), [*map(_name, classes)], rows)


def _class(one: Wear) -> int:
    """Return the number of lengths that a recording reaches."""
    return sum((one.hours or 0.0) >= hours for hours in LENGTHS_H)


def _name(place: int) -> str:
    """Return a class of length in words."""
    if place == 0:
        return f"under {LENGTHS_H[0]} h"
    low = LENGTHS_H[place - 1]
    return f"{low} h or more" if place == len(LENGTHS_H) else f"{low} to {LENGTHS_H[place]} h"


def _cell(place: int, own: Sequence[Wear]) -> str:
    """Return the share of usable recordings of a class, and their mean error; empty without any."""
    group = [one for one in own if _class(one) == place]
    if not group:
        return ""
    errors = [one.error_mg for one in group if one.usable and one.error_mg is not None]
    share = f"{100 * sum(one.usable for one in group) / len(group):.0f} % of {len(group)}"
    return f"{share}, {number(mean(errors))} mg" if errors else share
