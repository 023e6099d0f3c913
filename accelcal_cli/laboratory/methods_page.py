"""The page of `evaluate methods --html`: Table 3 of F, and figures of recordings as F's 4, 5 and 7 to 9."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import DivergedError, counted, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import PointSet
from accelcal_cli.core.settings import Settings
from accelcal_cli.laboratory.descent import GROUPS, DescentNumbers, trace
from accelcal_cli.laboratory.segments import Stillness, stillness
from accelcal_cli.output.numbers import number
from accelcal_cli.pages import svg
from accelcal_cli.pages.figures import Figure
from accelcal_cli.pipeline.jobs import DEFAULT_CHUNK_SAMPLES
from accelcal_cli.pipeline.options import recording_options
from accelcal_cli.pipeline.survey import open_marked

Real = NDArray[np.float64]

MOST_DRAWN = 3
"""Recordings that have figures."""

TRACE_S, COLUMNS = 600, 600
"""Length of the trace [s], and the number of its columns."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A recording and its figures."""

    name: str
    figures: list[Figure]


@dataclass(frozen=True, slots=True)
class Sketch:
    """A figure before it has a place on the page: title, the same in a sentence, height and body."""

    name: str
    title: str
    text: str
    height: float
    body: list[str]


def drawn(path: Path, options: ReadOptions, settings: Settings, points: PointSet, place: int) -> Drawn:
    """Return the figures of a recording, of which the points were fitted.

    Args:
        place: its place on the page.

    Raises:
        AccelcalError: it cannot be read.
    """
    still, sketches = stillness(path, options, settings, DEFAULT_CHUNK_SAMPLES), []
    if len(still.windows) and len(points):
        mean = still.windows.sums / (still.windows.samples[:, np.newaxis] * still.lsb_per_g)
        sketches = [_rest(path, options, still), _orientations(mean, points)]
        with suppress(DivergedError):
            steps = trace(points, DescentNumbers())
            sketches += [_errors(mean, still, steps[-1]), *_convergence(steps)]
    found = []
    for one in sketches:
        ids = f"{one.name}-{'abc'[place]}"
        found.append(
            Figure(ids, one.title, svg.figure(ids, one.title, one.text, one.height, one.body), one.text)
        )
    return Drawn(printable(path), found)


def _rest(path: Path, options: ReadOptions, still: Stillness) -> Sketch:
    """Draw x of the ten minutes whose share of rest is nearest to a half, and their rest (F Fig. 4)."""
    windows = still.windows
    with open_marked(path, recording_options(path, options)) as reader:
        rate, lsb = reader.recording.rate_hz, reader.recording.lsb_per_g
        length = int(TRACE_S * rate)
        resting = np.bincount(windows.first_sample // length, weights=windows.samples)
        whole = resting[:-1] if len(resting) > 1 else resting  # the last ten minutes may not be whole
        first = int(np.argmin(np.abs(whole / length - 0.5))) * length
        parts = [
            chunk.counts[max(0, first - chunk.first_sample) : first + length - chunk.first_sample, 0]
            for chunk in reader.chunks(DEFAULT_CHUNK_SAMPLES)
            if chunk.first_sample < first + length and chunk.first_sample + len(chunk.counts) > first
        ]
    x = np.concatenate(parts).astype(np.float64) / lsb
    edges = np.unique(np.linspace(0, len(x), COLUMNS + 1).astype(int))[:-1]
    low, high = np.minimum.reduceat(x, edges), np.maximum.reduceat(x, edges)
    bottom, top = float(low.min()) - 0.1, float(high.max()) + 0.1
    area = svg.plot((0, TRACE_S), (bottom, top), 22, 230)
    inside = (windows.first_sample >= first) & (windows.first_sample < first + length)
    chosen = windows.select(inside)
    begun = (chosen.first_sample - first) / rate
    spans = list(zip(begun.tolist(), (begun + chosen.samples / rate).tolist(), strict=True))
    rest = area.band(spans, [bottom] * len(spans), [top] * len(spans), "before-band")
    ends = np.stack([edges, edges], axis=1).ravel() / rate
    line = area.line(zip(ends.tolist(), np.stack([low, high], axis=1).ravel().tolist(), strict=True), "after")
    axes = area.axes(svg.ticks(0, TRACE_S), svg.ticks(bottom, top), "time [s]", "x [g]")
    text = (
        f"Ten minutes from {number(first / rate / 3600)} h on. Coloured areas are the windows that were "
        f"found at rest: {counted(len(spans), 'window')}."
    )
    return Sketch("rest", "Detected rest", text, 270, [axes, rest, line])


def _orientations(mean: Real, points: PointSet) -> Sketch:
    """Draw the directions of all rests, and of the fitted points (F Figs. 5 and 7)."""
    halves = (svg.Hemisphere(1, 190, 176, 130), svg.Hemisphere(-1, 570, 176, 130))
    body = []
    for half in halves:
        edge = f"M{half.x - half.radius} {half.y}a130 130 0 1 0 260 0a130 130 0 1 0 -260 0"
        name = "+z half" if half.side > 0 else "−z half"
        rests, fitted = _places(half, mean), _places(half, points.xyz_g())
        dots = "".join(dict.fromkeys(f"M{x:.0f} {y:.0f}h0" for x, y in rests))
        crosses = "".join(f"M{x - 4:.1f} {y - 4:.1f}l8 8m-8 0l8-8" for x, y in fitted)
        body += [svg.path(edge, "frame"), svg.path(dots, "dots"), svg.path(crosses, "mark")]
        body.append(svg.label(half.x, half.y - 160, name, "soft", "middle"))
    text = (
        f"Directions of {counted(len(mean), 'window')} at rest (dots), and of the "
        f"{counted(len(points), 'point')} that were fitted (crosses). Rests crowd where the device often "
        "rests, points do not."
    )
    return Sketch("points", "Rests and fitted points in space", text, 330, body)


def _places(half: svg.Hemisphere, vectors: Real) -> list[svg.Pair]:
    """Return the places of the directions that lie in a half."""
    unit = vectors / np.sqrt((vectors**2).sum(axis=1, keepdims=True))
    return [half.place(one) for one in unit.tolist() if (one[2] >= 0) == (half.side > 0)]


def _errors(mean: Real, still: Stillness, nine: Real) -> Sketch:
    """Draw |a| - 1 g of rests along time, before and after (F Fig. 8)."""
    gain = np.array([[nine[0], 0, 0], [nine[3], nine[1], 0], [nine[4], nine[5], nine[2]]])
    before, after = (1000 * (np.sqrt((one**2).sum(axis=1)) - 1) for one in (mean, (mean + nine[6:]) @ gain.T))
    reach = max(10.0, 1.1 * float(np.percentile(np.abs(before), 99)))
    span = max(still.span_h, 0.1)
    area = svg.plot((0, span), (-reach, reach), 22, 230)
    axes = area.axes(svg.ticks(0, span), svg.ticks(-reach, reach), "hours", "|a| − 1 g [mg]")
    hours = still.hours.tolist()
    body = [axes, area.dots(zip(hours, before.tolist(), strict=True), "dots raw"),
            area.dots(zip(hours, after.tolist(), strict=True))]  # fmt: skip
    away = [number(float(np.abs(one).mean())) for one in (before, after)]
    text = (
        "Each dot is a window at rest: raw (light) and after the paper's 50 steps (dark). The mean distance "
        f"from 1 g is {away[0]} mg before and {away[1]} mg after."
    )
    return Sketch("errors", "Distance from 1 g before and after", text, 270, body)


def _convergence(steps: Real) -> list[Sketch]:
    """Draw the nine parameters after each step of the paper's descent (F Fig. 9)."""
    ideal, found = np.array([1.0] * 3 + [0.0] * 6), []
    for name, part in GROUPS.items():
        away = 1000 * (steps - ideal)[:, part]
        low, high = float(away.min()) - 1, float(away.max()) + 1
        area = svg.plot((0, len(steps) - 1), (low, high), 22, 150)
        unit = "[mg]" if name == "offset" else "[thousandths]"
        body = [area.axes(svg.ticks(0, len(steps) - 1), svg.ticks(low, high), "steps", f"{name} {unit}")]
        for column, label in zip(away.T.tolist(), _NAMES[name], strict=True):
            body.append(area.line(enumerate(column), "after"))
            body.append(svg.label(svg.WIDTH - 24, area.y(column[-1]) + 4, label, "soft"))
        ends = (f"{label} {number(one[-1])}" for label, one in zip(_NAMES[name], away.T, strict=True))
        text = f"Distance from the ideal sensor after 50 steps {unit}: {', '.join(ends)}."
        found.append(Sketch(f"steps-{name}", f"Convergence of the {name}", text, 190, body))
    return found


_NAMES = {"scale": ("x", "y", "z"), "misalignment": ("yx", "zx", "zy"), "offset": ("x", "y", "z")}
