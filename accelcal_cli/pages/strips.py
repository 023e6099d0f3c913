"""Hours of many recordings as strips, one under the other: worn, still, not worn, filled, missing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from accelcal_cli.pages.study_figures import shortened

MOST_STRIPS = 100
"""Most recordings that are drawn: the newest."""
MOST_ROWS = 24 * 28
"""Most rows of a recording that are drawn: four weeks of hours."""
HALF = 0.5
"""Share of a row's samples, or of its time, from which filling or a gap names it."""
LONGEST_NAME = 24
MOSTLY_STILL = 9
"""Still windows for each moving one from which an hour counts as still."""
LEFT, WIDTH, ROW, TOP, BOTTOM = 170, 900, 15, 8, 40

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
    left: int = LEFT
    width: int = WIDTH

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
    scale = (WIDTH - LEFT - 10) / longest
    rows = [
        StripRow(
            shortened(name.rpartition("/")[2], LONGEST_NAME),
            href,
            TOP + ROW * place,
            tuple(_paths(states, seconds * scale, TOP + ROW * place)),
        )
        for place, (name, href, (states, seconds)) in enumerate(recordings)
    ]
    days = int(longest // 86_400)
    step = max(1, days // 14)
    ticks = [(round(LEFT + day * 86_400 * scale, 1), str(day)) for day in range(0, days + 1, step)]
    return StripFigure(rows, ticks, TOP + ROW * len(rows) + BOTTOM)


def _paths(states: Sequence[str], width: float, y: int) -> Iterator[tuple[str, str]]:
    """Yield a path of boxes for each state, runs of the same state as one box."""
    boxes: dict[str, list[str]] = {}
    at = 0
    for state, run in groupby(states):
        number = sum(1 for _ in run)
        x, wide = round(LEFT + at * width, 1), round(number * width, 1)
        boxes.setdefault(state, []).append(f"M{x} {y}h{wide}v{ROW - 3}h-{wide}z")
        at += number
    for state in STATES:
        if state in boxes:
            yield state, "".join(boxes[state])
