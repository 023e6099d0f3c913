"""The figures of one recording's page: what each shows, its picture, and the same as a sentence.

All numbers are those of the report and of `NAME.quality.json`; errors are | |a| - 1 g | in mg. `figures_of`
says which figures there are, and in which section of the page.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import accumulate, pairwise
from math import ceil, floor, hypot, log10
from typing import Any, TypeVar

from markupsafe import Markup

from accelcal_cli.collect.cells import MAX_BLOCKS, MAX_POINTS
from accelcal_cli.core.arithmetic import weighted_percentile
from accelcal_cli.core.errors import counted, listed
from accelcal_cli.output.numbers import number
from accelcal_cli.output.sections import ChangeSection, RecordingSection, ReportView
from accelcal_cli.pages import svg
from accelcal_cli.pages.svg import LEFT, RIGHT, WIDTH, label, path

# `NAME.quality.json` as figures and the table by the hour need it, checked column by column.
#
# The file may be that of another result, or written by somebody else: what does not fit is not drawn,
# and the page says so.

Value = float | None
Column = list[Value]
Item = TypeVar("Item")

COUNTS = ("samples", "still", "moving", "windows", "filled", "clipped", "recovered", "lost_bytes", "gap_s")
SIZE, OFF = ("mean", "p95"), ("p5", "p50", "p95")
POINTS = ("x", "y", "z", "windows", "posture", "before")
LARGEST = 1e15
"""Bound on the size of all numbers that the file can hold."""

LEAST_HZ = 1e-6
MOST_STEPS = 1000
"""Bound on the number of steps of a fit."""

HOURLY, MOST_ROWS = 14 * 24, 192
"""Rows that are shown as they are, and the number of rows into which more are merged (pages below 300 KB)."""

TOTALS = {
    "gap_s": "Gaps [s]",
    "filled": "Filled",
    "clipped": "Clipped",
    "recovered": "Recovered",
    "lost_bytes": "Lost bytes",
}
"""Columns that are shown only if one of their rows is not 0, and their titles."""


class UnfitError(Exception):
    """The file is not what the page needs; the text says why."""


@dataclass(frozen=True, slots=True)
class TimeSeries:
    """A recording along its time, and its points.

    Attributes:
        start: time of the first sample; None where the file has no times or they do not ascend.
        spans: seconds from the first sample at which each of b rows begins and ends.
        rows: columns of numbers by name, (b,).
        errors: mean and p95 of | |a| - 1 g | by `before` and `after`; off: p5, p50 and p95 of |a| - 1 g.
        worn: (b,) True where the device was worn; None where that is not known.
        points: columns of the p points by name, `before` and `after` in mg, `temperature` in degrees C.
        convergence: mean error after each step of the fit [mg].
        seconds: time from the first sample to the end.
    """

    start: datetime | None
    spans: list[tuple[float, float]]
    rows: dict[str, list[float]]
    errors: dict[str, dict[str, Column]]
    off: dict[str, dict[str, Column]]
    temperature: Column
    worn: list[bool | None]
    times: list[str]
    points: dict[str, list[float]]
    convergence: list[float]
    seconds: float

    def since_start(self, time: str | None) -> float | None:
        """Return the seconds from the first sample to a time; None if it is not known, or not within."""
        try:
            begun = datetime.fromisoformat(time or "") - datetime.fromisoformat(self.times[0])
        except (ValueError, TypeError):
            return None
        return begun.total_seconds() if 0 <= begun.total_seconds() <= self.seconds else None


def time_series(quality: Mapping[str, Any], report: ReportView) -> TimeSeries:
    """Read the quality file of a report; raises UnfitError if it is not of this result, or damaged."""
    if "sha256" not in quality:
        raise UnfitError("is damaged")
    made = (quality.get("sha256"), quality.get("outcome"), quality.get("model"))
    model = None if report.calibration is None else report.calibration.model
    if made != (report.recording.sha256, report.outcome, model):
        raise UnfitError("is of another result")
    rows, points = _object(quality, "rows"), _object(quality, "points")
    times = rows.get("start")
    if not isinstance(times, list) or not all(isinstance(one, str) for one in times):
        raise UnfitError("is damaged (rows.start)")
    if len(times) > MAX_BLOCKS:
        raise UnfitError("is damaged (too many rows)")
    length = len(times)
    counts = {name: _numbers(rows, name, length) for name in COUNTS}
    when = ("before",) if rows.get("after_mg") is None else ("before", "after")
    start, spans = _spans(times, counts, _rate(quality), report.recording)
    return TimeSeries(
        start=start,
        spans=spans,
        rows=counts,
        errors={name: _table(rows, f"{name}_mg", SIZE, length) for name in when},
        off={name: _table(rows, f"{name}_off_mg", OFF, length) for name in when},
        temperature=_column(rows, "temperature_c", length),
        worn=[one if isinstance(one, bool) else None for one in _listed(rows, "worn", length)],
        times=times,
        points=_points(points),
        convergence=_steps(quality),
        seconds=max((end for _, end in spans), default=0.0),
    )


def _object(quality: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    value = quality.get(name)
    if not isinstance(value, dict):
        raise UnfitError(f"is damaged ({name})")
    return value


def _listed(table: Mapping[str, Any], name: str, length: int) -> list[Any]:
    values = table.get(name)
    if not isinstance(values, list) or len(values) != length:
        raise UnfitError(f"is damaged ({name})")
    return values


def _column(table: Mapping[str, Any], name: str, length: int) -> Column:
    """Return a column of numbers and nulls."""
    values = _listed(table, name, length)
    known = [one for one in values if one is not None]
    if not set(map(type, known)) <= {int, float} or not all(-LARGEST < one < LARGEST for one in known):
        raise UnfitError(f"is damaged ({name})")
    return values


def _numbers(table: Mapping[str, Any], name: str, length: int) -> list[float]:
    """Return a column without nulls."""
    values = [one for one in _column(table, name, length) if one is not None]
    if len(values) != length:
        raise UnfitError(f"is damaged ({name})")
    return values


def _table(rows: Mapping[str, Any], name: str, names: Sequence[str], length: int) -> dict[str, Column]:
    inner = _object(rows, name)
    return {one: _column(inner, one, length) for one in names}


def _rate(quality: Mapping[str, Any]) -> float:
    rate: Any = _object(quality, "row").get("rate_hz")
    if type(rate) not in (int, float) or not LEAST_HZ < rate < LARGEST:
        raise UnfitError("is damaged (row.rate_hz)")
    return float(rate)


def _points(table: Mapping[str, Any]) -> dict[str, list[float]]:
    """Return the columns of the points, in g, mg and degrees C."""
    length = len(table["x"]) if isinstance(table.get("x"), list) else 0
    if length > MAX_POINTS:
        raise UnfitError("is damaged (too many points)")
    columns = {name: _numbers(table, name, length) for name in POINTS}
    for name, unit in (("before", 100), ("after", 100), ("temperature", 10)):
        if table.get(name) is not None:
            columns[name] = [value / unit for value in _numbers(table, name, length)]
    return columns


def _steps(quality: Mapping[str, Any]) -> list[float]:
    steps = quality.get("convergence")
    if not isinstance(steps, list) or len(steps) > MOST_STEPS:
        return []
    return _numbers(quality, "convergence", len(steps))


def _spans(
    times: Sequence[str], rows: Mapping[str, list[float]], rate_hz: float, recording: RecordingSection
) -> tuple[datetime | None, list[tuple[float, float]]]:
    """Return when the rows begin and end, by their times where these ascend, else by their samples."""
    lengths = [samples / rate_hz for samples in rows["samples"]]
    try:
        moments = [datetime.fromisoformat(one) for one in times]
        begun = [(one - moments[0]).total_seconds() for one in moments]
    except (ValueError, TypeError):
        moments, begun = [], []
    if not begun or any(later <= one for one, later in pairwise(begun)):
        ends = list(accumulate(lengths))
        return None, [(end - length, end) for end, length in zip(ends, lengths, strict=True)]
    full = [one + length + gap for one, length, gap in zip(begun, lengths, rows["gap_s"], strict=True)]
    last = min(full[-1], recording.duration_s or full[-1])
    ends = [min(pair) for pair in zip(full, [*begun[1:], last], strict=True)]
    dated = recording.start_time is not None
    return (moments[0] if dated else None), list(zip(begun, ends, strict=True))


def hourly_table(data: TimeSeries) -> tuple[str, list[str], list[list[str]]]:
    """Return the caption, names of columns, and rows of cells of all that the figures along time show.

    Where there would be too many rows, one has the sums of several, the mean over their windows, and the
    worst of the rest.
    """
    together = 1 if len(data.times) <= HOURLY else ceil(len(data.times) / MOST_ROWS)
    rows = _MergedRows(data.rows["windows"], together)
    columns: dict[str, Sequence[str]] = {
        "Start": [
            time.partition(".")[0].replace("T", " ").removesuffix(":00") for time in data.times[::together]
        ],
        "Worn": rows.merged(data.worn, _worn_cell),
        **{name.capitalize(): rows.sums(data.rows[name]) for name in ("still", "moving")},
    }
    worst = "" if together == 1 else "largest "
    for when, table in data.errors.items():
        columns[f"error {when}, mean [mg]"] = rows.means(table["mean"])
        columns[f"error {when}, {worst}95 % [mg]"] = rows.merged(table["p95"], _worst)
    middle = "median" if together == 1 else "median farthest off"
    for when, table in data.off.items():
        columns[f"|a| − 1 g {when}, {middle} [mg]"] = rows.merged(table["p50"], _worst)
    columns["°C"] = rows.means(data.temperature, 4)
    columns |= {title: rows.sums(data.rows[name]) for name, title in TOTALS.items() if any(data.rows[name])}
    caption = "Hour by hour: the numbers of the figures over time"
    if together > 1:
        each = (
            f"{together} rows of NAME.quality.json in each row, which has their sums, mean and worst values"
        )
        caption = f"The numbers of the figures over time, {each}"
    return caption, list(columns), [list(row) for row in zip(*columns.values(), strict=True)]


class _MergedRows:
    """Columns of which `together` rows each are merged into one cell.

    Args:
        windows: (b,) weights of the rows in means.
    """

    def __init__(self, windows: Sequence[float], together: int) -> None:
        self.windows = windows
        self.together = together

    def _parts(self, values: Sequence[Item]) -> list[Sequence[Item]]:
        return [values[at : at + self.together] for at in range(0, len(values), self.together)]

    def merged(self, values: Sequence[Item], how: Callable[[Sequence[Item]], str]) -> list[str]:
        return [how(part) for part in self._parts(values)]

    def sums(self, values: Sequence[float]) -> list[str]:
        return [f"{sum(part):g}" if sum(part) < 1e6 else f"{sum(part):.0f}" for part in self._parts(values)]

    def means(self, values: Sequence[Value], digits: int = 3) -> list[str]:
        """Average over the windows, or over rows where these have none (as for temperatures in motion)."""
        means = []
        for part, windows in zip(self._parts(values), self._parts(self.windows), strict=True):
            known = [(one, weight) for one, weight in zip(part, windows, strict=True) if one is not None]
            total = sum(weight for _, weight in known)
            weighed = known if total else [(one, 1.0) for one, _ in known]
            total = total or len(known)
            mean = sum(one * weight for one, weight in weighed) / total if known else None
            means.append(number(known[0][0] if len(known) == 1 else mean, digits))
        return means


def _worst(part: Sequence[Value]) -> str:
    """Write the value farthest from 0."""
    known = [one for one in part if one is not None]
    return number(max(known, key=abs) if known else None)


def _worn_cell(part: Sequence[bool | None]) -> str:
    known = set(part)
    if True in known and False in known:
        return "in part"
    return "yes" if True in known else "no" if False in known else "–"


# The figures of one recording's page.

BARS = 40
LEAST_MG, LARGEST_MG = 0.01, 1e4
"""Ends of a scale of powers of ten, at which errors [mg] beyond it are drawn."""

WORDS = {"before": "before calibration", "after": "after calibration"}
NEAR = ("−1 g", "0 g", "+1 g")
WINDOWS_OF_CELLS = (12, 120)
"""Numbers of still windows from which on a cell is drawn stronger: one and ten minutes of 5 s windows."""

SHADES = "faint: fewer than 12 still windows · stronger: fewer than 120 · full: more"
LEAST_BAR = 0.12
"""Least height of a bar on the timeline, as a share of its lane."""

LANES = (
    ("filled", "Filled", "lane"),
    ("clipped", "Clipped", "lane-bad"),
    ("recovered", "Recovered", "lane-bad"),
)


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure: its heading, the picture, and the same in a sentence.

    Attributes:
        name: beginning of the ids of its elements.
    """

    name: str
    title: str
    picture: Markup
    text: str


def figures_of(data: TimeSeries | None, report: ReportView) -> dict[str, list[Figure]]:
    """Return the figures of each section of the page, in their order, of which there is something to draw."""
    if data is None:
        return {name: [] for name in ("change", "sphere", "time", "fit")}
    sections = {
        "change": (length_along_time(data), histogram(data)),
        "sphere": (sphere(data, report),),
        "time": (
            error_by_hour(data, report.change),
            timeline(data, report.recording),
            residual_by_temperature(data),
        ),
        "fit": (convergence(data),),
    }
    return {name: [one for one in drawn if one is not None] for name, drawn in sections.items()}


def length_along_time(data: TimeSeries) -> Figure | None:
    """Draw |a| of still windows along time, before and after (F Fig. 1)."""
    values = [
        one for table in data.off.values() for column in table.values() for one in column if one is not None
    ]
    if not values:
        return None
    low, high = min(0.0, *values), max(0.0, *values)
    room = 0.06 * max(high - low, 0.1)
    area = svg.plot((0, data.seconds), (low - room, high + room), 22, 250)
    body = [_time_axes(area, data, svg.ticks(low - room, high + room), "|a| − 1 g [mg]")]
    for when, table in data.off.items():
        body.append(area.band(data.spans, table["p5"], table["p95"], f"{when}-band"))
        body.append(area.steps(data.spans, table["p50"], when))
    body.append(_legend(list(data.off)))
    title = "Measured gravity at rest, over time"
    sentences = [
        f"{WORDS[when]} the hourly median is {_range(known)} mg"
        for when, table in data.off.items()
        if (known := [one for one in table["p50"] if one is not None])
    ]
    text = (
        f"At rest |a| should be 1 g: 0 on this scale. {_sentence(sentences)} "
        "Lines are medians, areas hold 90 % of the still windows."
    )
    return Figure("length", title, svg.figure("length", title, text, 290, body), text)


def histogram(data: TimeSeries) -> Figure | None:
    """Draw how often |a| − 1 g of the points has which size; each still window counts once."""
    weights, drawn = data.points["windows"], [one for one in WORDS if one in data.points]
    if not sum(weights):
        return None
    spread = {when: _percentiles(data.points[when], weights, (0.5, 99.5)) for when in drawn}
    low, high = min(one for one, _ in spread.values()), max(one for _, one in spread.values())
    step = max(svg.round_step(high - low, BARS), LEAST_MG)
    first, last = floor(low / step), max(ceil(high / step), floor(low / step) + 1)
    body, shares = [], {when: _shares(data.points[when], weights, step, (first, last)) for when in drawn}
    for row, when in enumerate(drawn):
        top = 22 + 150 * row
        largest = max(shares[when])
        area = svg.plot((first * step, last * step), (0, 100 * largest), top, top + 96)
        axis = svg.ticks(first * step, last * step)
        body.append(area.axes(axis, svg.ticks(0, 100 * largest), "", f"{WORDS[when]}: % of still windows"))
        body.append(_bars(area, [100 * share for share in shares[when]], first * step, step, f"{when}-bar"))
    height = 22 + 150 * len(drawn)
    body.append(label((LEFT + WIDTH) / 2, height - 14, "|a| − 1 g [mg]", "soft", "middle"))
    inner = {when: _percentiles(data.points[when], weights, (5, 95)) for when in drawn}
    ranges = [f"from {number(low)} to {number(high)} mg {WORDS[one]}" for one, (low, high) in inner.items()]
    title = "Distance from 1 g, before and after"
    text = f"90 % of the still windows lie {listed(ranges)}. "
    text += "The outermost bars include all values beyond them."
    return Figure("histogram", title, svg.figure("histogram", title, text, height, body), text)


def _shares(
    values: Sequence[float], weights: Sequence[float], step: float, ends: tuple[int, int]
) -> list[float]:
    """Return the share of the weight in each bar; what lies beyond is in the outermost."""
    first, last = ends
    sums = [0.0] * (last - first)
    for value, weight in zip(values, weights, strict=True):
        sums[min(max(floor(value / step) - first, 0), len(sums) - 1)] += weight
    return [one / sum(weights) for one in sums]


def _bars(area: svg.Plot, heights: Sequence[float], start: float, step: float, kind: str) -> str:
    way = ""
    for place, height in enumerate(heights):
        if height:
            left, right = (svg.coordinate(area.x(start + step * (place + one))) for one in (0, 1))
            low, high = (svg.coordinate(area.y(one)) for one in (0, height))
            way += f"M{left} {low}V{high}H{right}V{low}z"
    return path(way, kind)


def _percentiles(
    values: Sequence[float], weights: Sequence[float], percents: tuple[float, float]
) -> tuple[float, float]:
    ordered = sorted(zip(values, weights, strict=True))
    low, high = (weighted_percentile(ordered, percent) for percent in percents)
    return low, high


def error_by_hour(data: TimeSeries, change: ChangeSection | None) -> Figure | None:
    """Draw the mean error of each row, its 95th percentile, and where the sensor changed."""
    columns = [column for table in data.errors.values() for column in table.values()]
    values = [min(max(one, LEAST_MG), LARGEST_MG) for column in columns for one in column if one is not None]
    if not values:
        return None
    ends = _powers_around(values)
    area = svg.plot((0, data.seconds), ends, 22, 250, powers=True)
    body = [_time_axes(area, data, svg.power_ticks(*ends), "error [mg]")]
    for when, table in data.errors.items():
        body.append(area.band(data.spans, table["mean"], table["p95"], f"{when}-band"))
        body.append(area.steps(data.spans, table["mean"], when))
    body.append(_legend(list(data.errors)))
    changed_at, changed = "", None if change is None else change.at
    if changed is not None:
        changed_at = f" The sensor changed at {changed.partition('.')[0].replace('T', ' ')}."
        if (at := data.since_start(changed)) is not None:
            body.append(area.upright(at, "the sensor changed"))
    sentences = [
        f"{WORDS[when]} the hourly mean is {_range([one for one in table['mean'] if one is not None])} mg"
        for when, table in data.errors.items()
    ]
    title = "Error by the hour"
    text = (
        f"{_sentence(sentences)} Lines are means, areas reach up to the 95th percentile; "
        f"the scale is logarithmic.{changed_at}"
    )
    return Figure("error", title, svg.figure("error", title, text, 290, body), text)


def residual_by_temperature(data: TimeSeries) -> Figure | None:
    """Draw |a| − 1 g of each point against its temperature, after calibration if there is one."""
    heat = data.points.get("temperature")
    if not heat:
        return None
    when = "after" if "after" in data.points else "before"
    values = data.points[when]
    windows = data.points["windows"]
    ends = _percentiles(values, windows, (0.5, 99.5)) if sum(windows) else (0.0, 0.0)
    reach = max(*map(abs, ends), 0.05) * 1.1
    cool, warm = min(heat) - 0.2, max(heat) + 0.2
    area = svg.plot((cool, warm), (-reach, reach), 22, 230)
    axes = area.axes(svg.ticks(cool, warm), svg.ticks(-reach, reach), "temperature [°C]", "|a| − 1 g [mg]")
    body = [axes, area.dots(zip(heat, values, strict=True))]
    title = f"Remaining error by temperature, {WORDS[when]}"
    per_c = _slope(heat, values, windows)
    text = (
        "Each dot is the mean of one orientation at rest "
        f"({len(heat)} in all, {number(min(heat))} to {number(max(heat))} °C). "
        f"On average the error changes by {number(per_c, 2)} mg per °C. "
        "Dots at an edge may lie beyond."
    )
    return Figure("temperature", title, svg.figure("temperature", title, text, 270, body), text)


def _slope(x: Sequence[float], y: Sequence[float], weights: Sequence[float]) -> float:
    """Return the slope of the straight line through weighted places."""
    total = sum(weights) or 1.0
    middle = [
        sum(weight * one for weight, one in zip(weights, values, strict=True)) / total for values in (x, y)
    ]
    across = sum(weight * (one - middle[0]) ** 2 for weight, one in zip(weights, x, strict=True))
    both = zip(weights, x, y, strict=True)
    return sum(w * (a - middle[0]) * (b - middle[1]) for w, a, b in both) / across if across else 0.0


def timeline(data: TimeSeries, recording: RecordingSection) -> Figure | None:
    """Draw wear, stillness, gaps, and samples that are filled, clipped or damaged, along time."""
    if not data.spans:
        return None
    samples, rows = data.rows["samples"], data.rows
    still = [a / (a + b) if a + b else 0.0 for a, b in zip(rows["still"], rows["moving"], strict=True)]
    lanes = [("Still", still, "lane")]
    lanes += [
        (word, [a / max(1, b) for a, b in zip(rows[name], samples, strict=True)], kind)
        for name, word, kind in LANES
    ]
    lanes.append(("Lost bytes", [float(one > 0) for one in rows["lost_bytes"]], "lane-bad"))
    body = [_worn_lane(data), label(0, 33, "Worn")]
    body += [_lane(data, 42 + 26 * row, *lane) for row, lane in enumerate(lanes)]
    bottom = 42 + 26 * len(lanes)
    body += [label(0, bottom + 15, "Gaps"), _gap_lane(data, recording, bottom)]
    area = svg.plot((0, data.seconds), (0, 1), 16, bottom + 24)
    body.append(_time_axes(area, data, [], ""))
    title = "Recording overview"
    text = _timeline_sentence(data, recording)
    return Figure("timeline", title, svg.figure("timeline", title, text, bottom + 66, body), text)


def _worn_lane(data: TimeSeries) -> str:
    kinds = {True: "lane", False: "lane-off", None: "lane-unknown"}
    ways: dict[str, str] = dict.fromkeys(kinds.values(), "")
    for span, worn in zip(data.spans, data.worn, strict=True):
        ways[kinds[worn]] += _box(data, span, 20, 16)
    return "".join(path(way, kind) for kind, way in ways.items())


def _lane(data: TimeSeries, top: float, word: str, shares: Sequence[float], kind: str) -> str:
    """Draw a row of the timeline: bars as high as the share."""
    heights = [max(LEAST_BAR, min(1.0, share)) if share > 0 else None for share in shares]
    area = svg.Plot(svg.AxisScale(0, data.seconds, LEFT, WIDTH - RIGHT), svg.AxisScale(0, 1, top + 18, top))
    track = path(_box(data, (0, data.seconds), top, 18), "lane-off")
    return label(0, top + 14, word) + track + area.bars(data.spans, heights, kind)


def _box(data: TimeSeries, span: tuple[float, float], top: float, height: float) -> str:
    x = svg.AxisScale(0, data.seconds, LEFT, WIDTH - RIGHT)
    left, right = x(span[0]), x(span[1])
    wide = max(right - left, 1.0)
    left = min(left, WIDTH - RIGHT - wide)
    across = svg.coordinate(wide)
    return f"M{svg.coordinate(left)} {svg.coordinate(top)}h{across}v{svg.coordinate(height)}h-{across}z"


def _gap_lane(data: TimeSeries, recording: RecordingSection, top: float) -> str:
    """Draw the gaps that the report lists."""
    ways, track = [], path(_box(data, (0, data.seconds), top + 2, 16), "lane-off")
    for gap in recording.gaps:
        if gap.seconds > 0 and (seconds := data.since_start(gap.start_time)) is not None:
            ways.append(_box(data, (seconds, seconds + gap.seconds), top + 2, 16))
    return track + path("".join(dict.fromkeys(ways)), "lane-bad")


def _timeline_sentence(data: TimeSeries, recording: RecordingSection) -> str:
    """Put the timeline into a sentence."""
    worn, known, rows = data.worn.count(True), len(data.worn) - data.worn.count(None), data.rows
    sentences = ["no hour has enough data to tell whether the device was worn"]
    if known:
        which = f"all {known}" if worn == known else f"{worn} of the {known}"
        sentences = [f"worn in {which} hours with enough data to tell"]
    still, windows = sum(rows["still"]), sum(rows["still"]) + sum(rows["moving"])
    share = f"{number(100 * still / windows)} % of the windows were still" if windows else ""
    sentences.append(share or "there is no window")
    gaps, gap_s = recording.all_gaps, number(sum(rows["gap_s"]))
    sentences.append(f"{counted(gaps, 'gap')} of {gap_s} s in all" if gaps else "no gaps")
    for name, word, _ in LANES:
        if total := sum(rows[name]):
            sentences.append(f"{counted(int(total), 'sample')} {word.lower()}")
    if lost := sum(rows["lost_bytes"]):
        sentences.append(f"{counted(int(lost), 'byte')} lost to damage")
    return f"{_sentence(sentences)} Heights of bars are shares of time."


def convergence(data: TimeSeries) -> Figure | None:
    """Draw the error of the fitted points after each step of the fit (F Fig. 9)."""
    values = [min(max(one, LEAST_MG / 100), LARGEST_MG) for one in data.convergence]
    if len(values) < 2:
        return None
    ends = _powers_around(values)
    area = svg.plot((0, len(values) - 1), ends, 22, 200, powers=True)
    whole = [(at, text) for at, text in svg.ticks(0, len(values) - 1) if float(at).is_integer()]
    axes = area.axes(whole, svg.power_ticks(*ends), "steps of the fit", "error [mg]")
    places = list(enumerate(values))
    body = [axes, area.line(places, "after"), area.dots(places)]
    steps = listed([number(one) for one in data.convergence[:20]])
    more = "" if len(values) <= 20 else " and so on"
    title = "How the fit converged"
    text = f"Mean error of the fitted orientations, for the raw data and after each step: {steps}{more} mg."
    return Figure("convergence", title, svg.figure("convergence", title, text, 240, body), text)


def sphere(data: TimeSeries, report: ReportView) -> Figure | None:
    """Draw the halves of the sphere of directions, with cells in which the sensor rested (F Figs. 4, 5)."""
    filled = _filled(data)
    if not filled:
        return None
    halves = (svg.Hemisphere(1, 190, 176, 130), svg.Hemisphere(-1, 570, 176, 130))
    body = [_half(half, filled) for half in halves]
    body += _faces(halves, report.coverage.subsets)
    if report.calibration_error_mg is not None:
        body.append(_least_certain(halves, report.calibration_error_mg.worst_direction_at))
    body.append(label(WIDTH / 2, 350, SHADES, "soft", "middle"))
    number_of = 2 * len(svg.all_cells())
    subsets = report.coverage.subsets
    missing = [
        f"{axis} near {near}"
        for place, axis in enumerate("xyz")
        for near, counts in zip(NEAR, subsets, strict=True)
        if not counts[place]
    ]
    named = f"Missing: {listed(missing)}." if missing else "It was still near −1, 0 and +1 g on each axis."
    title = "Orientations in which the device was still"
    text = f"The device was still in {len(filled)} of {number_of} equal areas of the sphere. {named}"
    if report.calibration_error_mg is not None:
        text += " The cross marks the orientation in which the calibration is least certain."
    return Figure("sphere", title, svg.figure("sphere", title, text, 362, body), text)


def _filled(data: TimeSeries) -> dict[tuple[int, int, int], float]:
    """Count the still windows in each cell of the sphere."""
    windows_of: Counter[tuple[int, int, int]] = Counter()
    columns = (data.points[name] for name in ("x", "y", "z", "windows"))
    for x, y, z, windows in zip(*columns, strict=True):
        if length := hypot(x, y, z):
            windows_of[svg.cell_of((x / length, y / length, z / length))] += int(windows)
    return dict(windows_of)


def _half(half: svg.Hemisphere, filled: Mapping[tuple[int, int, int], float]) -> str:
    ways = [""] * (len(WINDOWS_OF_CELLS) + 2)
    for ring, sector in svg.all_cells():
        windows = filled.get((half.side, ring, sector), 0)
        kind = 0 if not windows else 1 + sum(windows >= one for one in WINDOWS_OF_CELLS)
        ways[kind] += half.cell(ring, sector)
    return "".join(path(way, f"cell{kind}") for kind, way in enumerate(ways))


def _faces(halves: Sequence[svg.Hemisphere], subsets: Sequence[Sequence[int]]) -> list[str]:
    """Name the directions of the axes, with the number of points near each; those without any stand out."""
    parts = []
    for half in halves:
        sign = "+" if half.side > 0 else "−"
        for axis, turn in (("x", (1, 0)), ("y", (0, 1))):
            for level, way in ((2, 1), (0, -1)):
                at = half.place((way * turn[0], way * turn[1], 0))
                number_of = subsets[level]["xyz".index(axis)]
                parts.append(_face(at, half, f"{'+' if way > 0 else '−'}{axis}", number_of))
        points = subsets[2 if half.side > 0 else 0][2]
        text = f"{sign}z half, {counted(points, 'point') if points else 'no point'} near {sign}z"
        parts.append(label(half.x, half.y - 160, text, "strong" if points else "bad", "middle"))
    return parts


def _face(at: tuple[float, float], half: svg.Hemisphere, name: str, points: int) -> str:
    """Write the name of a direction next to its place on the rim, and `empty` if no point is near it."""
    x, y = at
    out = 10 if x > half.x + 1 else -10 if x < half.x - 1 else 0
    down = 16 if y > half.y + 1 else -6 if y < half.y - 1 else 4
    anchor = "start" if out > 0 else "end" if out < 0 else "middle"
    if points:
        return label(x + out, y + down, name, "strong", anchor)
    if not out:
        return label(x, y + down, f"{name} empty", "bad", anchor)
    below = label(x + out, y + down + 14, "empty", "bad", anchor)
    return label(x + out, y + down, name, "bad", anchor) + below


def _least_certain(halves: Sequence[svg.Hemisphere], direction: Sequence[float]) -> str:
    """Draw a cross at a direction."""
    length = hypot(*direction)
    if not length:
        return ""
    unit = [one / length for one in direction]
    x, y = halves[0 if unit[2] >= 0 else 1].place(unit)
    corner = f"{svg.coordinate(x - 6)} {svg.coordinate(y - 6)}"
    return path(f"M{corner}l12 12m-12 0l12-12", "mark")


def _powers_around(values: Sequence[float]) -> tuple[float, float]:
    """Return the two different powers of ten between which values lie."""
    low, high = floor(log10(min(values))), ceil(log10(max(values)))
    return 10.0**low, 10.0 ** max(high, low + 1)


def _time_axes(area: svg.Plot, data: TimeSeries, y_ticks: list[svg.Tick], y_name: str) -> str:
    name = "time" if data.start is not None else "time from the first sample"
    return area.axes(svg.time_ticks(data.seconds, data.start), y_ticks, name, y_name)


def _range(values: Sequence[float]) -> str:
    """Write the least and the largest of some values, once if they are the same."""
    ends = dict.fromkeys(map(number, (min(values), max(values))))
    return " to ".join(ends)


def _legend(names: Iterable[str]) -> str:
    """Say above the area which line is which."""
    parts = []
    for place, when in enumerate(names):
        x = 420 + 170 * place
        parts.append(path(f"M{x} 10h28", when) + label(x + 34, 14, WORDS[when]))
    return "".join(parts)


def _sentence(parts: Sequence[str]) -> str:
    """Join parts into a sentence that begins with a capital."""
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""
