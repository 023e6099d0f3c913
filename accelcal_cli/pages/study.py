"""The page of a study: outcomes of its recordings, and which of them and of its devices to look at first.

Everything that it shows is in the study's table and in the review of its devices. All texts are treated as
hostile: names are made printable here, the template escapes what it is given, and the data for the script are
JSON that cannot end their element (`embedded`).
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import groupby
from math import floor, isfinite, log10
from statistics import median
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from accelcal_cli.core.arithmetic import mean
from accelcal_cli.core.errors import counted, printable
from accelcal_cli.core.results import Outcome
from accelcal_cli.devices.review import Verdict
from accelcal_cli.output import sentences
from accelcal_cli.output.advice import LIKELY_YEARS, LIMIT_MG
from accelcal_cli.output.decisions import CAUTIOUS, COLUMNS, MOST_FINDINGS, NAME
from accelcal_cli.output.numbers import mg_of_two_digits, number
from accelcal_cli.output.sentences import OUTCOMES, outcome_words
from accelcal_cli.pages.rendering import rendered

# The figures of a study's page as paths for inline SVG: errors before and after, drifts of devices,
# bars.
#
# Coordinates are in the units of the figure's view box, rounded: the same numbers give the same text.

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
class Drift:
    """Change in a month with its standard error, and whether it is certain."""

    per_month: float
    error: float
    certain: bool


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
            drift.certain,
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


# Decisions of people on the page of a study: the rows of their file, and the faults of some of them.
#
# Both come from `study.json`, which others may have changed: what does not fit is left out.

USE = COLUMNS.index("use")
"""Place of the decision in a row."""


def _section(summary: Mapping[str, Any], name: str) -> list[Any]:
    """Return a list under `decisions` of `study.json`; empty if there is none."""
    held = summary.get("decisions")
    found = held.get(name) if isinstance(held, dict) else None
    return found if isinstance(found, list) else []


def rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Return the rows of the file for the script of the page: texts in the order of COLUMNS."""
    return [list(map(printable, row)) for row in _section(summary, "rows") if _fits(row)]


def _fits(row: Any) -> bool:
    """Return True for a row as a study writes it."""
    texts = isinstance(row, list) and len(row) == len(COLUMNS) and all(isinstance(one, str) for one in row)
    return texts and row[USE] in CAUTIOUS


def findings(summary: Mapping[str, Any]) -> list[str]:
    """Return a line for each finding about decisions, with the name of their file."""
    held = summary.get("decisions")
    file = str(held.get("file") or NAME) if isinstance(held, dict) else NAME
    found = [one for one in _section(summary, "findings") if isinstance(one, dict)][: MOST_FINDINGS + 1]
    return [printable(f"{file}: {one.get('message')}") for one in found]


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


WANTED = (
    "path", "use", "why", "wear_hours", "outcome", "reason", "message", "model", "copy_of", "borrowed_from",
    "before_mg", "after_mg",
    "calibration_error_mg",
    "calibration_error_high_mg", "calibration_error_before_mg", "change", "change_at", "change_mg", "misfits",
    "device_model", "device_serial", "start_time", "duration_s", "lost_percent", "report",
    "decided_by", "result",
)  # fmt: skip
"""Columns of the study's table that the page shows."""

REASONS = 8
"""Number of reasons of an outcome that have a line of their own."""
FIRST = 3
"""Number of recordings of each kind of problem to look at first."""
LISTED = 1000
"""Number of recordings in the list of problems: some thirty printed pages."""
DAMAGED_FROM_PERCENT = 0.1
"""Share of a recording's bytes from which damage is a problem, as for `accelcal devices`."""
SIZES = {
    "changed": "change_mg",
    "uncertain": "calibration_error_high_mg",
    "damaged": "lost_percent",
    "misfit": "calibration_error_mg",
}
"""Columns that say how bad a problem is, by its kind."""
COPY = "copy"
"""Name in the table of what a recording is that has the bytes of another; it counts nowhere else."""
VERDICTS = tuple(map(sentences.in_words, Verdict))
"""Verdicts on devices in words, the weightiest first."""
SERVICE, TROUBLED = VERDICTS[:2], VERDICTS[:3]
"""Verdicts that ask for something to be done, and also those that ask for a look."""
HOUR_S = 3600


@dataclass(frozen=True, slots=True)
class DeviceLine:
    """A device of the study, as `accelcal devices` judges it.

    Attributes:
        verdict: one of VERDICTS.
        reasons: reasons of the verdict, the weightiest first.
        first, last: dates of its first and last recording.
        offset, percent: the fastest drift of an offset [mg a month] and of scale or misalignment [% a month],
            each with its standard error and whether it is certain; None if there are too few recordings.
    """

    name: str
    verdict: str
    reasons: tuple[str, ...]
    recordings: int
    used: int
    refused: int
    first: str | None
    last: str | None
    held_out_mg: float | None
    offset: Drift | None
    percent: Drift | None


@dataclass(frozen=True, slots=True)
class StudyContent:
    """All that the page of a study is made of.

    Attributes:
        rows: rows of the study's table, as dictionaries with at least the keys WANTED.
        pages: path of each recording's page, relative to this one; None where there is none.
        summary: content of `study.json`; empty if there is none.
        devices: all devices, those to service first.
        nameless: number of recordings without a serial number.
        drift_limit_mg: drift of an offset in a month that is a reason for service.
        csv: name of the table next to the page.
        origin: folder, command and time of the newest result, by name.
        hours: number of a row, and the states of its recording's hours (`strips.states_of`), in their order.
    """

    rows: Sequence[dict[str, Any]]
    pages: Sequence[str | None]
    summary: dict[str, Any]
    devices: Sequence[DeviceLine]
    nameless: int
    drift_limit_mg: float
    csv: str = "study.csv"
    origin: Sequence[tuple[str, str]] = ()
    hours: Sequence[tuple[int, tuple[list[str], float]]] = ()


@dataclass(frozen=True, slots=True)
class ProblemKind:
    """A kind of problem, and what to do about it.

    Attributes:
        short: its name in the table of all recordings.
    """

    key: str
    short: str
    title: str
    advice: str


KINDS = (
    ProblemKind("failed", "failed", "Could not be processed",
                "The message says what is wrong with the file. "
                "If it is damaged, copy it again from the device."),
    ProblemKind("changed", "sensor changed", "The sensor changed while it recorded",
                "The recording's page shows since when, and whether the calibration follows. "
                "Have the device checked if it happens again."),
    ProblemKind("refused", "refused", "Refused: no calibration could be trusted",
                "The message says what is missing. Record longer, or use the coefficients of another "
                "recording of the device (accelcal study --borrow)."),
    ProblemKind("uncertain", "uncertain", "Calibrated, but uncertain",
                "The true error may be beyond the limit in orientations that were not recorded. "
                "A longer recording with more turns of the wrist helps."),
    ProblemKind("damaged", "file damaged", "Parts of the file are lost",
                "Copy the file again from the device; if the damage stays, have the device checked."),
    ProblemKind("misfit", "not described", "Sensor behaviour outside the model",
                "The error is larger than it could be. The recording's page names what was found."),
)  # fmt: skip
"""Kinds of problems, the weightiest first: a recording is listed under the first that it has."""


def page(study: StudyContent) -> str:
    """Return the whole page as HTML; the same content gives the same text."""
    devices = _devices(study)
    limit_mg = _limit_mg(study.summary)
    entries = [_Entry(row, href, limit_mg) for row, href in zip(study.rows, study.pages, strict=True)]
    once = [entry for entry in entries if not entry.copy_of]
    scatter = Scatter.of([None if entry.copy_of else entry.errors for entry in entries])
    groups = _groups(once)
    return rendered(
        "study.html",
        style="study.css",
        script="study.js",
        headline=_headline(once, len(entries) - len(once)),
        notes=_notes(study.summary),
        outcomes=_outcomes(once),
        first=[(kind, len(members), members[:FIRST]) for kind, members in groups],
        groups=_listed(groups),
        scatter=scatter,
        dots=scatter.dots([entry.outcome for entry in entries]),
        limit=scatter.limit(limit_mg),
        limit_mg=f"{limit_mg:g}",
        months=by_month(
            [entry.row["start_time"] for entry in once], [entry.outcome for entry in once], list(OUTCOMES)
        ),
        wear=by_wear([entry.wear for entry in once]),
        marked=_marked(scatter, entries, groups),
        **devices,
        csv=study.csv,
        strips=strips([(entries[at].path, entries[at].href, hours) for at, hours in study.hours]),
        origin=[(name, printable(value)) for name, value in study.origin],
        left_out=_left_out(study.summary),
        decided=[entry for entry in entries if entry.row["decided_by"]][:LISTED],
        doubtful=findings(study.summary),
        recordings=len(once),
        data=embedded(
            {
                "recordings": _recordings_table(entries, scatter),
                "devices": _devices_table(devices["devices"]),
                "decisions": rows(study.summary),
            }
        ),
    )


def _devices(study: StudyContent) -> dict[str, Any]:
    """Return what the page says of the devices."""
    lines = [
        replace(line, name=printable(line.name), reasons=tuple(map(printable, line.reasons)))
        for line in study.devices
    ]
    service = [line for line in lines if line.verdict in SERVICE]
    return {
        "devices": lines,
        "service": service[:FIRST],
        "to_service": len(service),
        "troubled": [line for line in lines if line.verdict in TROUBLED],
        "verdicts": Counter(line.verdict for line in lines),
        "drifts": drifts([(line.name, line.offset) for line in lines], study.drift_limit_mg),
        "drift_limit": f"{study.drift_limit_mg:g}",
        "nameless": counted(study.nameless, "recording") if study.nameless else None,
    }


class _Entry:
    """A recording: its row with printable texts, its page, and its weightiest problem.

    Attributes:
        copy_of: path of the recording with the same bytes that counts; None or empty if this one counts.
        href: address of its page, None if there is none; `./` keeps a name from being treated as a scheme.
    """

    def __init__(self, row: dict[str, Any], address: str | None, limit_mg: float) -> None:
        self.row = {name: _shown(row.get(name)) for name in WANTED}
        self.address = address
        quoted = None if address is None else quote(address.encode("utf-8", "surrogateescape"))
        self.href = None if quoted is None else f"./{quoted}"
        self.path: str = self.row["path"] or "?"
        self.outcome: str = self.row["outcome"] or "failed"
        self.copy_of: str | None = self.row["copy_of"]
        self.message: str = self.row["message"] or ""
        self.changed = self.row["change"] not in (None, "none")
        has = {
            "failed": self.row["outcome"] == "failed",
            "changed": self.changed,
            "refused": self.row["outcome"] == "refused",
            "uncertain": self.outcome == Outcome.PROVISIONAL
            or (self.row["calibration_error_high_mg"] or 0.0) > limit_mg,
            "damaged": (self.row["lost_percent"] or 0.0) >= DAMAGED_FROM_PERCENT,
            "misfit": self.row["misfits"] not in (None, "none"),
        }
        self.problem = next((kind for kind in KINDS if has[kind.key]), None)

    def order(self) -> tuple[float, str]:
        """Return the place among recordings with the same problem, the worst first."""
        size = self.row.get(SIZES.get(self.problem.key, "")) if self.problem else None
        return -(size or 0.0), self.path

    @property
    def device(self) -> str:
        """Serial number, or what else is known of the device."""
        return self.row["device_serial"] or self.row["device_model"] or "-"

    @property
    def excluded(self) -> bool:
        """True if a person decided not to use it."""
        return bool(self.row["decided_by"]) and self.row["use"] == "no"

    @property
    def problem_name(self) -> str:
        """Name of the problem in the table, or that it is a copy; empty without one."""
        return COPY if self.copy_of else self.problem.short if self.problem else ""

    @property
    def change_mg(self) -> float | None:
        """Size of the sensor's change; None if it did not change."""
        size: float | None = self.row["change_mg"] if self.changed else None
        return size

    @property
    def hours(self) -> float | None:
        """Length of the recording [h]."""
        seconds = self.row["duration_s"]
        return None if seconds is None else seconds / HOUR_S

    @property
    def wear(self) -> Wear:
        """Hours of wear, or else of the recording, and the error over all orientations."""
        worn, error = self.row["wear_hours"], self.row["calibration_error_mg"]
        kind = sentences.kind_of(self.path, self.row["device_model"])
        usable = outcome_words(self.outcome).usable
        return Wear(kind, self.hours if worn is None else worn, self.outcome, usable, error)

    @property
    def errors(self) -> tuple[float, float] | None:
        """Error before and after [mg]: over the sphere, or where that is not known on held-out postures."""
        everywhere = self.row["calibration_error_before_mg"], self.row["calibration_error_mg"]
        pairs = (everywhere, (self.row["before_mg"], self.row["after_mg"]))
        return next((pair for pair in pairs if None not in pair), None)

    @property
    def finding(self) -> str:
        """Words about the problem, or what the recording is a copy of; empty without one."""
        row, kind = self.row, "" if self.problem is None else self.problem.key
        if self.copy_of:
            return sentences.copied(self.copy_of)
        if kind == "uncertain":
            return sentences.uncertain(row["calibration_error_mg"], row["calibration_error_high_mg"])
        if kind == "damaged":
            return sentences.lost(row["lost_percent"])
        if kind == "changed":
            return sentences.changed(row["change"], row["change_at"], row["change_mg"])
        if kind == "misfit":
            return sentences.not_described(row["misfits"])
        return self.message if kind else ""

    @property
    def link(self) -> int | str:
        """Address for the script: 0 for none, 1 where it follows from the recording's name."""
        if self.address is None:
            return 0
        same = self.address == re.sub(r"\.[^./]+$", "", self.path) + ".html"
        return 1 if same else self.href or 0


def _shown(value: Any) -> Any:
    """Make texts printable, and numbers that are not finite None."""
    if isinstance(value, str):
        return printable(value)
    return None if isinstance(value, float) and not isfinite(value) else value


def _limit_mg(summary: dict[str, Any]) -> float:
    settings = summary.get("settings")
    limit = settings.get("max_error_mg") if isinstance(settings, dict) else None
    return float(limit) if isinstance(limit, int | float) else LIMIT_MG


Group = tuple[ProblemKind, list[_Entry]]


def _groups(entries: Sequence[_Entry]) -> list[Group]:
    """Return the recordings with each kind of problem, the worst first."""
    groups = [(kind, [entry for entry in entries if entry.problem is kind]) for kind in KINDS]
    return [(kind, sorted(members, key=_Entry.order)) for kind, members in groups if members]


def _listed(groups: Sequence[Group]) -> list[tuple[ProblemKind, list[_Entry], int]]:
    """Cut the groups to LISTED recordings in all; the number is that of all of the kind."""
    left, listed = LISTED, []
    for kind, members in groups:
        listed.append((kind, members[:left], len(members)))
        left -= len(listed[-1][1])
    return listed


def _headline(entries: Sequence[_Entry], copies: int) -> dict[str, str]:
    """Return the study in a few figures, to which copies do not count."""
    usable = sum(outcome_words(entry.outcome).usable and not entry.excluded for entry in entries)
    pairs = [entry.errors for entry in entries if entry.errors is not None]
    headline = {
        "Recordings": f"{len(entries):,}{f' (and {copies:,} copied from them)' if copies else ''}",
        "Can be used": f"{usable:,} ({100 * usable / len(entries):.1f} %)" if entries else "0",
        "With a problem": f"{sum(entry.problem is not None for entry in entries):,}",
        "Devices": f"{len({entry.row['device_serial'] for entry in entries} - {None, ''}):,}",
    }
    if pairs:
        before, after = (median(errors) for errors in zip(*pairs, strict=True))
        headline["Median error"] = f"{mg_of_two_digits(before)} mg before, {mg_of_two_digits(after)} mg after"
    return headline


def _notes(summary: dict[str, Any]) -> list[str]:
    """Return what users must know that the study says of itself."""
    waiting, mixed, pools = summary.get("waiting"), summary.get("mixed_times"), summary.get("pools") or {}
    notes = []
    if isinstance(waiting, int) and waiting:
        notes.append(f"{counted(waiting, 'recording')} waiting: not started yet.")
    if isinstance(mixed, str):
        notes.append(f"{printable(mixed)}.")
    if pools:
        notes.append(f"{counted(len(pools), 'pool')} of recordings of one device.")
    return notes


def _left_out(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return name and reason of the files that the study leaves out, those by its options aside."""
    listed = summary.get("files_left_out")
    found = [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []
    texts = [
        (printable(str(one.get("path"))), printable(str(one.get("message"))))
        for one in found
        if one.get("code") != "excluded"
    ]
    return texts[:LISTED]


def _outcomes(entries: Sequence[_Entry]) -> list[dict[str, Any]]:
    """Return a line for each outcome, and one for each reason of those that are not usable."""
    total, numbers = len(entries), Counter(entry.outcome for entry in entries)
    lines: list[dict[str, Any]] = []
    for outcome in sorted(numbers, key=lambda one: list(OUTCOMES).index(one) if one in OUTCOMES else 99):
        number, words = numbers[outcome], outcome_words(outcome)
        own = [entry for entry in entries if entry.outcome == outcome]
        lines.append(
            {"outcome": outcome, "name": outcome.replace("_", " "), "meaning": words.use,
             "number": number, "share": bar(number, total), "percent": f"{100 * number / total:.1f}",
             "reasons": [] if words.usable else _reasons(own, total)}
        )  # fmt: skip
    return lines


def _reasons(entries: Sequence[_Entry], total: int) -> list[dict[str, Any]]:
    """Return the reasons of an outcome, the most frequent first."""
    numbers = Counter(sentences.in_words(entry.row["reason"] or "no reason is known") for entry in entries)
    often = sorted(numbers.items(), key=lambda one: (-one[1], one[0]))
    lines, others = often[:REASONS], sum(number for _, number in often[REASONS:])
    if others:
        lines.append((counted(len(often) - REASONS, "other reason"), others))
    return [{"text": text, "number": number, "share": bar(number, total)} for text, number in lines]


def _marked(
    scatter: Scatter, entries: Sequence[_Entry], groups: Sequence[Group]
) -> list[tuple[_Entry, float, float]]:
    """Return the recordings to look at first with their places in the scatter: links that need no script."""
    places = {id(entry): place for entry, place in zip(entries, scatter.places, strict=True)}
    first = [entry for _, members in groups for entry in members[:FIRST]]
    return [(entry, *place) for entry in first if (place := places[id(entry)]) is not None]


def _spaced(names: Iterable[str]) -> list[str]:
    return [name.replace("_", " ") for name in names]


def _recordings_table(entries: Sequence[_Entry], scatter: Scatter) -> dict[str, Any]:
    """Return the table of all recordings, column by column, as the script reads it."""

    def of(name: str) -> list[Any]:
        return [getattr(entry, name) for entry in entries]

    def of_row(name: str, absent: Any = None) -> list[Any]:
        return [absent if entry.row[name] is None else entry.row[name] for entry in entries]

    pairs = [errors or (None, None) for errors in of("errors")]
    return {
        "what": "recording",
        "columns": [
            column("path", "recording", "text", 19, of("path")),
            choice_column("outcome", 8, _spaced(of("outcome")), _spaced(OUTCOMES)),
            choice_column("use", 7, of_row("use", ""), ["yes", "with care", "no", ""]),
            choice_column("problem", 9, of("problem_name"), ["", *(kind.short for kind in KINDS), COPY]),
            number_column("before", "before, mg", 7.5, (pair[0] for pair in pairs), kind="mg"),
            number_column("after", "after, mg", 7, (pair[1] for pair in pairs), kind="mg"),
            choice_column("device", 9, of("device")),
            column("start", "start", "minutes", 10, [_minutes(start) for start in of_row("start_time")]),
            number_column("hours", "hours", 5.5, of("hours")),
            number_column("worn", "worn, h", 6, of_row("wear_hours")),
            choice_column("reason", 13, of_row("reason", "")),
            choice_column("model", 5.5, of_row("model", "")),
            number_column("change", "change, mg", 8, of("change_mg"), kind="mg"),
            number_column("lost", "lost, %", 6, (percent or None for percent in of_row("lost_percent"))),
            message_column("message", "finding", 70, of("finding")),
        ],
        "pages": of("link"),
        "results": of_row("result", ""),
        "scatter": scatter.scale(),
    }


def _devices_table(devices: Sequence[DeviceLine]) -> dict[str, Any]:
    """Return the table of all devices."""
    verdicts = [line.verdict for line in devices]
    return {
        "what": "device",
        "columns": [
            column("device", "device", "text", 12, [line.name for line in devices]),
            choice_column("verdict", 6, verdicts, VERDICTS),
            number_column("recordings", "recordings", 7.5, (line.recordings for line in devices)),
            number_column("used", "used", 5, (line.used for line in devices)),
            number_column("refused", "refused", 6, (line.refused for line in devices)),
            column("first", "first", "text", 8, [(line.first or "")[:10] for line in devices]),
            column("last", "last", "text", 8, [(line.last or "")[:10] for line in devices]),
            number_column("held", "held out, mg", 8.5, (line.held_out_mg for line in devices), kind="mg"),
            *_drift("offset", "offset, mg a month", [line.offset for line in devices]),
            *_drift("percent", "scale, % a month", [line.percent for line in devices]),
            column("why", "why", "text", 60, ["; ".join(line.reasons) for line in devices]),
        ],
        "pages": [],
    }


def _drift(key: str, label: str, drifts: Sequence[Drift | None]) -> list[dict[str, Any]]:
    """Return two columns: the drift and its standard error."""
    pairs = [(None, None) if drift is None else (drift.per_month, drift.error) for drift in drifts]
    return [
        number_column(key, label, 11, (pair[0] for pair in pairs)),
        number_column(f"{key}_error", "±", 6, (pair[1] for pair in pairs)),
    ]


NUMBER = re.compile(r"\d+(?:\.\d+)?")
"""Pattern of a number in a message."""


def column(key: str, label: str, kind: str, width: float, values: Sequence[Any]) -> dict[str, Any]:
    """Return a column `width` rem wide, whose values are of a kind that the script knows."""
    return {"key": key, "label": label, "kind": kind, "width": width, "values": values}


def choice_column(key: str, width: float, values: Sequence[str], order: Sequence[str] = ()) -> dict[str, Any]:
    """Return a column of few different texts: their list, and the place of each value in it."""
    there = set(values)
    names = [*(name for name in order if name in there), *sorted(there - set(order))]
    place = {name: index for index, name in enumerate(names)}
    return column(key, key, "choice", width, [place[one] for one in values]) | {"names": names}


def number_column(
    key: str, label: str, width: float, values: Iterable[float | None], kind: str = "number"
) -> dict[str, Any]:
    """Return a column of numbers to four significant digits."""
    short = [None if value is None else float(f"{value:.4g}") for value in values]
    shown = [int(one) if one is not None and one.is_integer() else one for one in short]
    return column(key, label, kind, width, shown)


def _minutes(start: str | None) -> int | None:
    """Return a time by the clock that wrote it, in minutes since 1970."""
    try:
        moment = datetime.fromisoformat((start or "")[:16])
    except ValueError:
        return None
    return int((moment.replace(tzinfo=None) - datetime(1970, 1, 1)).total_seconds() // 60)


def message_column(key: str, label: str, width: float, texts: Sequence[str]) -> dict[str, Any]:
    """Return a column of messages: the texts without their numbers once, and the numbers of each.

    Thousands of messages differ in their numbers alone. A value is [which text, its numbers ...]; 0 for none.
    """
    places: dict[str, int] = {}
    values: list[Any] = []
    for message in texts:
        place = places.setdefault(NUMBER.sub("\0", message), len(places)) if message else 0
        values.append([place, *NUMBER.findall(message)] if message else 0)
    return column(key, label, "message", width, values) | {"names": [text.split("\0") for text in places]}


def embedded(value: Any) -> Markup:
    """Write JSON for a script element: nothing in it ends the element or a line of script."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for char in "<>&\u2028\u2029":
        text = text.replace(char, f"\\u{ord(char):04x}")
    return Markup(text)
