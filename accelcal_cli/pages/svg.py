"""Figures as inline SVG: paths, axes with round ticks, bands, bars, dots and hemispheres.

Coordinates are in the units of the figure's view box, rounded to a tenth: the same numbers give the same
text. Colours are classes of base.css: the page's policy allows no style in an element.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from math import atan2, ceil, cos, floor, hypot, log10, pi, sin, sqrt

from markupsafe import Markup

from accelcal_cli.core.errors import printable
from accelcal_cli.output.numbers import number

WIDTH = 760
LEFT, RIGHT = 70, 26
LEAST_SPAN = 1e-9
TICKS, TIME_TICKS = 6, 9
HOUR_S, DAY_S = 3600, 86_400
TIME_STEPS_S = (
    *(60 * minutes for minutes in (1, 5, 10, 30)),
    *(HOUR_S * hours for hours in (1, 2, 3, 6, 12)),
    *(DAY_S * days for days in (1, 2, 4, 7, 14, 28, 91, 364)),
)
RINGS = 5
"""Number of rings of cells on a hemisphere; ring k has 4 (2 k + 1) cells, all of the same area."""

Pair = tuple[float, float]
Tick = tuple[float, str]


def escaped(text: str) -> str:
    """Escape a text for an element or an attribute, and show control characters."""
    return html.escape(printable(text))


def coordinate(value: float) -> str:
    """Write a coordinate, to a tenth."""
    text = f"{value:.1f}"
    return text.removesuffix(".0") if text != "-0.0" else "0"


@dataclass(frozen=True, slots=True)
class AxisScale:
    """A scale from values low..high to coordinates start..end; values beyond are drawn at the edge.

    Attributes:
        powers: the scale is logarithmic; low is then above 0.
    """

    low: float
    high: float
    start: float
    end: float
    powers: bool = False

    def __call__(self, value: float) -> float:
        """Return the coordinate of a value."""
        low, high = self.low, self.high
        value = low if value < low else high if value > high else value
        if self.powers:
            low, high, value = log10(low), log10(high), log10(value)
        share = (value - low) / (high - low) if high > low else 0.5
        return self.start + share * (self.end - self.start)


def round_step(span: float, most: int = TICKS) -> float:
    """Return the smallest step of 1, 2 or 5 times a power of ten of which at most `most` fit in a span."""
    if not span > LEAST_SPAN:
        return 1.0
    power = floor(log10(span / most))
    steps = (float(f"{digit}e{power + more}") for more in range(3) for digit in (1, 2, 5))
    return next(step for step in steps if span / step <= most)


def ticks(low: float, high: float) -> list[Tick]:
    """Return round values within low..high."""
    step = round_step(high - low)
    places = max(0, -floor(log10(step)))
    values = [count * step for count in range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)]
    return [(value, f"{value + 0.0:.{places}f}".replace("-", "−")) for value in values]


def power_ticks(low: float, high: float) -> list[Tick]:
    """Return powers of ten within low..high."""
    powers = range(ceil(log10(low) - 1e-9), floor(log10(high) + 1e-9) + 1)
    return [(10.0**power, number(10.0**power, 1)) for power in powers]


def time_ticks(seconds: float, start: datetime | None) -> list[Tick]:
    """Return round times from 0 to `seconds`: clock times and dates, or hours if the start is unknown."""
    step = next((one for one in TIME_STEPS_S if seconds / one <= TIME_TICKS), seconds or 1)
    if start is None:
        return [(at * step, f"{number(at * step / HOUR_S)} h") for at in range(floor(seconds / step) + 1)]
    midnight = start.replace(hour=0, minute=0, second=0, microsecond=0)
    begun = (start - midnight).total_seconds()
    first, last = ceil(begun / step), floor((begun + seconds) / step)
    return [(at * step - begun, _moment(midnight, at * step)) for at in range(first, last + 1)]


def _moment(midnight: datetime, seconds: float) -> str:
    """Write a date at midnight, else the time of day."""
    try:
        moment = midnight + timedelta(seconds=seconds)
    except OverflowError:
        return ""
    return f"{moment.day} {moment:%b}" if seconds % DAY_S == 0 else f"{moment:%H:%M}"


def label(x: float, y: float, text: str, kind: str = "", anchor: str = "start") -> str:
    """Draw a text at a place."""
    classed = f' class="{kind}"' if kind else ""
    anchored = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text x="{coordinate(x)}" y="{coordinate(y)}"{classed}{anchored}>{escaped(text)}</text>'


def path(way: str, kind: str) -> str:
    """Draw a path of a class; nothing for an empty one."""
    return f'<path class="{kind}" d="{way}"/>' if way else ""


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot with two axes: what is drawn in it takes values, not coordinates."""

    x: AxisScale
    y: AxisScale

    def axes(self, x_ticks: Sequence[Tick], y_ticks: Sequence[Tick], x_name: str, y_name: str) -> str:
        """Draw the frame, lines of the grid, ticks and names."""
        (left, right), (bottom, top) = (self.x.start, self.x.end), (self.y.start, self.y.end)
        across = "".join(
            f"M{coordinate(left)} {coordinate(self.y(at))}H{coordinate(right)}" for at, _ in y_ticks
        )
        up = "".join(f"M{coordinate(self.x(at))} {coordinate(bottom)}v4" for at, _ in x_ticks)
        frame = f"M{coordinate(left)} {coordinate(top)}V{coordinate(bottom)}H{coordinate(right)}"
        parts = [path(across, "grid"), path(up + frame, "frame")]
        parts += [label(left - 6, self.y(at) + 4, text, "soft", "end") for at, text in y_ticks]
        parts += [label(self.x(at), bottom + 17, text, "soft", "middle") for at, text in x_ticks]
        parts.append(label((left + right) / 2, bottom + 34, x_name, "soft", "middle"))
        parts.append(label(left - 62, top - 12, y_name, "soft"))
        return "".join(parts)

    def steps(self, spans: Sequence[Pair], values: Sequence[float | None], kind: str) -> str:
        """Draw a line that keeps each value for its span of x, with a break where there is no value."""
        way, open_at = [], None
        for (begin, end), value in zip(spans, values, strict=True):
            if value is not None:
                x0, y = coordinate(self.x(begin)), coordinate(self.y(value))
                way.append(f"V{y}" if open_at == x0 else f"M{x0} {y}")
                way.append(f"H{coordinate(self.x(end))}")
            open_at = None if value is None else coordinate(self.x(end))
        return path("".join(way), kind)

    def band(
        self, spans: Sequence[Pair], lows: Sequence[float | None], highs: Sequence[float | None], kind: str
    ) -> str:
        """Draw the area between two lines of steps."""
        way = ""
        for (begin, end), low, high in zip(spans, lows, highs, strict=True):
            if low is not None and high is not None:
                x0, y0, y1 = coordinate(self.x(begin)), coordinate(self.y(low)), coordinate(self.y(high))
                wide = coordinate(float(coordinate(self.x(end))) - float(x0))  # fewer bytes than the place
                way += f"M{x0} {y0}V{y1}h{wide}V{y0}z"
        return path(way, kind)

    def bars(self, spans: Sequence[Pair], values: Sequence[float | None], kind: str) -> str:
        """Draw the area between the axis and a line of steps; neighbours that touch are one path."""
        way, ground, open_at = "", coordinate(self.y(self.y.low)), None
        for (begin, end), value in zip(spans, values, strict=True):
            x0, x1 = coordinate(self.x(begin)), coordinate(self.x(end))
            if open_at is not None and (value is None or open_at != x0):
                way, open_at = f"{way}V{ground}z", None
            if value is not None:
                way += "" if open_at == x0 else f"M{x0} {ground}"
                way, open_at = f"{way}V{coordinate(self.y(value))}H{x1}", x1
        return path(way if open_at is None else f"{way}V{ground}z", kind)

    def line(self, pairs: Iterable[Pair], kind: str) -> str:
        """Draw a line from value to value."""
        places = [f"{coordinate(self.x(x))} {coordinate(self.y(y))}" for x, y in pairs]
        return path(f"M{'L'.join(places)}" if places else "", kind)

    def dots(self, pairs: Iterable[Pair], kind: str = "dots") -> str:
        """Draw a dot at each place, to a whole coordinate; equal places once."""
        places = [f"M{self.x(x):.0f} {self.y(y):.0f}h0" for x, y in pairs]
        return path("".join(dict.fromkeys(places)), kind)

    def upright(self, at: float, text: str) -> str:
        """Draw a vertical line at a value of x, with a word next to it."""
        x = self.x(at)
        way = f"M{coordinate(x)} {coordinate(self.y.start)}V{coordinate(self.y.end)}"
        shift, anchor = (-5, "end") if x > (self.x.start + self.x.end) / 2 else (5, "start")
        return path(way, "mark") + label(x + shift, self.y.end + 12, text, "bad", anchor)


def plot(x: Pair, y: Pair, top: float, bottom: float, *, powers: bool = False) -> Plot:
    """Return a plot over the width of a figure.

    Args:
        x, y: least and largest values; top, bottom: coordinates; powers: of y, see `AxisScale`.
    """
    return Plot(AxisScale(*x, LEFT, WIDTH - RIGHT), AxisScale(*y, bottom, top, powers))


def figure(name: str, title: str, description: str, height: float, body: Sequence[str]) -> Markup:
    """Return the whole figure, with its title and a description for those who cannot see it.

    Args:
        name: prefix of the ids of its elements; letters and hyphens.
    """
    head = (
        f'<svg role="img" viewBox="0 0 {WIDTH} {coordinate(height)}" '
        f'aria-labelledby="{name}-title {name}-about">'
        f'<title id="{name}-title">{escaped(title)}</title>'
        f'<desc id="{name}-about">{escaped(description)}</desc>'
    )
    return Markup(head + "".join(body) + "</svg>")


@dataclass(frozen=True, slots=True)
class Hemisphere:
    """Half of the sphere of directions in an equal-area projection (Lambert), seen from outside.

    Attributes:
        side: 1 for z above 0, -1 for z below; x, y: of the centre; radius: coordinates.
    """

    side: int
    x: float
    y: float
    radius: float

    def place(self, direction: Sequence[float]) -> Pair:
        """Return where a unit vector of this half lies; y points up, x to the right on the upper half."""
        x, y, z = direction
        ring, flat = sqrt(max(0.0, 1 - abs(z))), hypot(x, y)
        if flat == 0:
            return self.x, self.y
        return self.x + self.side * x / flat * ring * self.radius, self.y - y / flat * ring * self.radius

    def cell(self, ring: int, sector: int) -> str:
        """Return the outline of a cell, by the numbers that `cell_of` gives."""
        number_of, near, far = sectors(ring), self.radius * ring / RINGS, self.radius * (ring + 1) / RINGS
        turns = [2 * pi * (sector + more) / number_of for more in (0, 1)]
        (ax, ay), (bx, by), (cx, cy), (dx, dy) = (
            (coordinate(self.x + self.side * one * cos(turn)), coordinate(self.y - one * sin(turn)))
            for one, turn in ((near, turns[0]), (far, turns[0]), (far, turns[1]), (near, turns[1]))
        )
        there, back = (0, 1) if self.side > 0 else (1, 0)
        arc, inner = f"A{coordinate(far)} {coordinate(far)} 0 0 {there}", ""
        if ring:
            inner = f"A{coordinate(near)} {coordinate(near)} 0 0 {back} {ax} {ay}"
        return f"M{ax} {ay}L{bx} {by}{arc} {cx} {cy}L{dx} {dy}{inner}z"


def sectors(ring: int) -> int:
    """Return the number of cells in a ring of a hemisphere."""
    return 4 * (2 * ring + 1)


def cell_of(direction: Sequence[float]) -> tuple[int, int, int]:
    """Return side, ring and sector of the cell in which a unit vector lies."""
    x, y, z = direction
    ring = min(RINGS - 1, int(RINGS * sqrt(max(0.0, 1 - abs(z)))))
    sector = int(sectors(ring) * ((atan2(y, x) / (2 * pi)) % 1.0)) % sectors(ring)
    return (1 if z >= 0 else -1), ring, sector


def all_cells() -> list[tuple[int, int]]:
    """Return ring and sector of all cells of a hemisphere."""
    return [(ring, sector) for ring in range(RINGS) for sector in range(sectors(ring))]
