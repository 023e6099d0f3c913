"""`accelcal evaluate methods`: every optimizer on the same points (F section III.B, Table 3)."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, astuple, dataclass, replace
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from accelcal_cli.cli import exit_codes, options
from accelcal_cli.cli.help import Command
from accelcal_cli.cli.output import aligned, each_recording, refuse_both
from accelcal_cli.core.arithmetic import mean, ratio_uncertainty95
from accelcal_cli.core.errors import AccelcalError, DivergedError, UsageError, counted, printable
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.points import MODELS, PointSet
from accelcal_cli.core.settings import NO_PRIOR, PAPER, Settings, other_rules, rule_options
from accelcal_cli.laboratory.cases import GROUPS, DescentNumbers, trace
from accelcal_cli.laboratory.segments import Stillness, stillness
from accelcal_cli.optimize import all_optimizers, named_optimizer
from accelcal_cli.output.files import csv_text, write_text
from accelcal_cli.output.numbers import formatted, number, percent
from accelcal_cli.output.sentences import begun_small, explained
from accelcal_cli.pages import svg
from accelcal_cli.pages.figures import Figure
from accelcal_cli.pages.rendering import PageTable, rendered
from accelcal_cli.pages.write import refuse_foreign_page
from accelcal_cli.pipeline.jobs import DEFAULT_CHUNK_SAMPLES, ProgressMaker
from accelcal_cli.pipeline.options import chosen_settings, read_options, recording_options
from accelcal_cli.pipeline.procedures import Procedure, fitting, make_method
from accelcal_cli.pipeline.survey import open_marked, survey
from accelcal_cli.studies.discovery import recordings_in

# The page of `evaluate methods --html`: Table 3 of F, and figures of recordings as F's 4, 5 and 7 to
# 9.

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


# `accelcal evaluate methods`.

TABLE_3_OF_F = (
    ("the authors' method", 25.1, 3.06, 820),
    ("non-iterative (Gietzelt et al.)", 25.1, 4.08, 615),
    ("MATLAB fminunc", 25.1, 3.16, 794),
    ("LabVIEW global", 25.1, 3.27, 768),
)
"""Method, error before and after [mg], improvement [%], as printed."""


@dataclass(frozen=True, slots=True)
class MethodRow:
    """One optimizer on one recording.

    Attributes:
        message: message of the verdict.
        stillness: options of the rule of stillness, with profile `paper`.
        model: model that was chosen; None if the recording was refused.
        before_mg, after_mg: mean held-out error.
        iterations, additions, multiplications: numbers in the fit to all points; None if not counted.
        seconds: wall time of that fit.
    """

    recording: str
    optimizer: str
    outcome: str
    message: str
    stillness: str | None = None
    model: str | None = None
    points: int = 0
    postures: int | None = None
    before_mg: float | None = None
    after_mg: float | None = None
    improvement_percent: float | None = None
    improvement_ci95: tuple[float, float] | None = None
    iterations: int | None = None
    additions: int | None = None
    multiplications: int | None = None
    seconds: float | None = None


def rows_of(
    path: Path, procedure: Procedure, settings: Settings, optimizers: tuple[str, ...]
) -> Iterator[MethodRow]:
    """Yield a row for each optimizer, of a recording that was read."""
    for name in optimizers:
        yield _row(path, procedure, replace(settings, optimizer=name, prior=NO_PRIOR))


def collected_to_fit(
    path: Path, options: ReadOptions, settings: Settings, progress: ProgressMaker
) -> tuple[Procedure, Settings]:
    """Return the procedure of the settings, or of the first other rule by which it calibrates."""
    rules = (settings, *(other_rules(settings) if settings.other_stillness else ()))
    found = ((collected(path, options, rule, progress), rule) for rule in rules)
    first = next(found)
    usable = (one for one in chain([first], found) if one[0].judge(fitting(one[1])).calibration is not None)
    return next(usable, first) if len(rules) > 1 else first


def collected(path: Path, options: ReadOptions, settings: Settings, progress: ProgressMaker) -> Procedure:
    """Return the procedure that has taken in a recording's still windows.

    Raises:
        AccelcalError: it cannot be read.
    """
    with open_marked(path, recording_options(path, options)) as reader:
        method = make_method(reader.recording, settings)
        shown = progress("reading", reader.recording.total_bytes)
        survey(reader.chunks(DEFAULT_CHUNK_SAMPLES), method.segmenter, (method.procedure,), shown)
    return method.procedure


def _row(path: Path, procedure: Procedure, settings: Settings) -> MethodRow:
    fitter = fitting(settings)
    try:
        verdict = procedure.judge(fitter)
    except AccelcalError as error:
        return MethodRow(printable(path), settings.optimizer, "failed", str(error))
    cells, fit, holdout = verdict.coverage.cells, verdict.fit, verdict.holdout
    rule = rule_options(settings) if settings.profile == PAPER.profile else None
    message = explained(verdict.reason, verdict.advice)
    row = MethodRow(printable(path), settings.optimizer, str(verdict.outcome), message, rule, points=cells)
    if holdout is None:
        return row
    row = replace(row, postures=holdout.postures, before_mg=holdout.before.mean)
    if fit is None or verdict.calibration is None:
        return row
    points, model = procedure.result(), MODELS[verdict.calibration.model]
    start = perf_counter()
    fitter.fit((points,), model)
    seconds = perf_counter() - start
    return replace(
        row,
        model=model.name,
        after_mg=holdout.after.mean,
        improvement_percent=holdout.improvement_percent(),
        improvement_ci95=_percent(holdout.improvement_ci95()),
        iterations=fit.iterations,
        additions=fit.operations.additions or None,
        multiplications=fit.operations.multiplications or None,
        seconds=seconds,
    )


@dataclass(frozen=True, slots=True)
class Mean:
    """One optimizer over several recordings.

    Attributes:
        recordings: number of recordings that it could calibrate; the others are left out.
        improvement_percent: ratio of the means, as all R of F are; improvement_ci95: its 95 % interval, by
            Student's t over the recordings; None for fewer than FEWEST.
    """

    optimizer: str
    recordings: int
    before_mg: float
    after_mg: float
    improvement_percent: float
    improvement_ci95: tuple[float, float] | None


def _percent(factor: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return the interval of a factor in percent."""
    return None if factor is None else (100 * factor[0], 100 * factor[1])


def means(rows: Sequence[MethodRow]) -> list[Mean]:
    """Return the means of each optimizer that calibrated a recording; none for a single recording."""
    found = []
    for name in dict.fromkeys(row.optimizer for row in rows):
        pairs = [
            (row.before_mg, row.after_mg)
            for row in rows
            if row.optimizer == name and row.before_mg is not None and row.after_mg is not None
        ]
        if pairs and len({row.recording for row in rows}) > 1:
            before, after = (mean(list(column)) for column in zip(*pairs, strict=True))
            ratio, by = before / after, ratio_uncertainty95(pairs) if len(pairs) >= FEWEST else None
            interval = None if by is None else (ratio / by, ratio * by)
            found.append(Mean(name, len(pairs), before, after, 100 * ratio, _percent(interval)))
    return found


def as_json(rows: list[MethodRow]) -> dict[str, Any]:
    """Return all rows, their means over recordings, and the published ones as JSON."""
    names = ("method", "before_mg", "after_mg", "improvement_percent")
    return {
        "rows": [asdict(row) for row in rows],
        "means": [asdict(one) for one in means(rows)],
        "published": [dict(zip(names, row, strict=True)) for row in TABLE_3_OF_F],
    }


FEWEST = 3
"""Recordings from which on R has an interval: that of two says nothing."""
INTERVAL = "95 % interval"
HEAD = (
    "optimizer", "model", "before mg", "after mg", "improved %", INTERVAL, "iterations", "operations", "ms",
)  # fmt: skip
MEANS = ("mean over recordings", "calibrated", "before mg", "after mg", "improved %", INTERVAL)
PUBLISHED = ("Table 3 of Farago, Maczak, Gingl 2024 (own recordings)", "before mg", "after mg", "improved %")
PUBLISHED_ROWS = [list(map(str, row)) for row in TABLE_3_OF_F]


@click.command(
    "methods",
    cls=Command,
    examples=("evaluate methods recording.cwa", "evaluate methods recordings --profile paper # a folder"),
)
@click.argument("recordings", nargs=-1, required=True, type=options.FILE)
@click.option("--only", type=options.OPTIMIZERS, metavar="A,B",
              help="Compare only these optimizers.  [default: all]")  # fmt: skip
@click.option("--html", "page", type=options.FILE, metavar="PAGE.html",
              help="Also write a page: the tables, and figures of the first recordings.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace a page that accelcal did not make.")
@click.option("--json", "as_json_", is_flag=True, help="Print one JSON object.")
@click.option("--csv", "as_csv", is_flag=True, help="Print a CSV table.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@options.comparing_options
def command(recordings: tuple[Path, ...], **values: Any) -> int:
    """Fit the same points of each RECORDING with every optimizer and judge them all by the same hold-out.

    A folder stands for all recordings in it, as for a study. Before and after are the mean held-out errors
    |r - 1|, improved is before / after x 100 (R, eq. 21 of the paper) with its interval, operations are
    additions and multiplications where they are counted, ms is the time of one fit. All fit without a prior,
    so that they can be compared; `calibrate` has one by default, and its figures differ. With --profile
    paper: 18 points and a second set of control points to judge by, as in the paper.
    """
    refuse_both(as_json=values["as_json_"], as_csv=values["as_csv"])
    only, to = values["only"], values["page"]
    asked = [one.name for one in all_optimizers()] if only is None else only.split(",")
    names = tuple(named_optimizer(name.strip()).name for name in asked if name.strip())
    if not names:
        raise UsageError("--only names no optimizer")
    if to is not None:
        refuse_foreign_page(to, force=values["force"])
    pictures: list[Drawn] = []

    def work(path: Path, bars: ProgressMaker) -> list[MethodRow]:
        reading = read_options(values)
        procedure, settings = collected_to_fit(path, reading, chosen_settings(values), bars)
        if to is not None and len(pictures) < MOST_DRAWN:
            pictures.append(drawn(path, reading, settings, procedure.result(), len(pictures)))
        return list(rows_of(path, procedure, settings, names))

    chosen = recordings_in(recordings, read_options(values))
    found, code = each_recording(chosen, work, quiet=values["quiet"])
    if rows := list(chain.from_iterable(found)):
        if to is not None:
            write_text(to, rendered("methods.html", tables=_page_tables(rows), recordings=pictures))
        exit_codes.show(_shown(rows, values))
    return code


def _shown(rows: list[MethodRow], values: dict[str, Any]) -> str:
    if values["as_json_"]:
        return json.dumps(as_json(rows))
    if values["as_csv"]:
        fields = list(MethodRow.__dataclass_fields__)
        return csv_text(fields, map(astuple, rows)).rstrip("\n")
    means = [aligned(MEANS, lines)] if (lines := _mean_lines(rows)) else []
    return "\n\n".join([*_tables(rows), *means, aligned(PUBLISHED, PUBLISHED_ROWS)])


def _page_tables(rows: list[MethodRow]) -> list[PageTable]:
    """Return the means, the published ones, and each recording's own."""
    lines = _mean_lines(rows)
    found = [PageTable("Mean over recordings", list(MEANS), lines)] if lines else []
    found.append(PageTable(PUBLISHED[0], ["method", *PUBLISHED[1:]], PUBLISHED_ROWS))
    for recording in dict.fromkeys(row.recording for row in rows):
        own = [_cells(row) for row in rows if row.recording == recording]
        found.append(PageTable(recording, list(HEAD), own, words=(0, 1)))
    return found


def _tables(rows: list[MethodRow]) -> list[str]:
    tables = []
    for recording in dict.fromkeys(row.recording for row in rows):
        own = [row for row in rows if row.recording == recording]
        refusals = [
            f"{row.optimizer}: {row.outcome}: {begun_small(row.message)}" for row in own if row.model is None
        ]
        rule = f" ({own[0].stillness})" if own[0].stillness else ""
        tables.append("\n".join([recording + rule, aligned(HEAD, [_cells(row) for row in own]), *refusals]))
    return tables


def _mean_lines(rows: list[MethodRow]) -> list[list[str]]:
    return [
        [
            one.optimizer,
            str(one.recordings),
            formatted(one.before_mg, ".3f"),
            formatted(one.after_mg, ".3f"),
            percent(one.improvement_percent),
            _between(one.improvement_ci95),
        ]
        for one in means(rows)
    ]


def _between(interval: tuple[float, float] | None) -> str:
    return "-" if interval is None else " to ".join(map(percent, interval))


def _cells(row: MethodRow) -> list[str]:
    counted = None if row.additions is None else row.additions + (row.multiplications or 0)
    return [
        row.optimizer,
        row.model or row.outcome,
        formatted(row.before_mg, ".3f"),
        formatted(row.after_mg, ".3f"),
        percent(row.improvement_percent),
        _between(row.improvement_ci95),
        formatted(row.iterations, "d"),
        formatted(counted, "d"),
        formatted(None if row.seconds is None else row.seconds * 1000, ".1f"),
    ]
