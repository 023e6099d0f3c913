"""`NAME.quality.json` as figures and the table by the hour need it, checked column by column.

The file may be that of another result, or written by somebody else: what does not fit is not drawn, and the
page says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import accumulate, pairwise
from math import ceil
from typing import Any, TypeVar

from accelcal_cli.collect.cells import MAX_BLOCKS
from accelcal_cli.collect.grid import MAX_POINTS
from accelcal_cli.output.numbers import number
from accelcal_cli.output.sections import RecordingSection, ReportView

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
