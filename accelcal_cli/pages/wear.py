"""The figure of a study's page on hours of wear: the error of each recording, and how many are usable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from accelcal_cli.core.statistics import mean
from accelcal_cli.output.numbers import number
from accelcal_cli.pages.study_figures import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, LogAxis, Scatter

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
