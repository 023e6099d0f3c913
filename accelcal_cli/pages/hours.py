"""The table of a recording hour by hour, whose rows are longer where there would be too many.

A longer row has the sums of its hours, the mean over their windows, and the worst of the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil
from typing import TypeVar

from accelcal_cli.pages.svg import number
from accelcal_cli.pages.time_series import Along, Value

HOURLY, MOST_ROWS = 14 * 24, 192
"""Rows that stand as they are, and so many at most where there are more: no page is larger than 300 KB."""

TOTALS = {
    "gap_s": "Gaps [s]",
    "filled": "Filled",
    "clipped": "Clipped",
    "recovered": "Recovered",
    "lost_bytes": "Lost bytes",
}
"""Columns of what few recordings have; those without any are left out."""

Item = TypeVar("Item")


def hours(data: Along) -> tuple[str, list[str], list[list[str]]]:
    """Caption, names of columns, and rows of cells of all that the figures along time show."""
    together = 1 if len(data.times) <= HOURLY else ceil(len(data.times) / MOST_ROWS)
    rows = _Rows(data.rows["windows"], together)
    columns: dict[str, Sequence[str]] = {
        "Start": [_start(one) for one in data.times[::together]],
        "Worn": rows.merged(data.worn, _worn),
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
    return _caption(together), list(columns), [list(row) for row in zip(*columns.values(), strict=True)]


def _caption(together: int) -> str:
    if together == 1:
        return "Hour by hour: all that the figures along time show"
    each = f"{together} rows of STEM.quality.json in each row, which has their sums, mean and worst values"
    return f"All that the figures along time show, {each}"


def _start(time: str) -> str:
    return time.partition(".")[0].replace("T", " ").removesuffix(":00")


class _Rows:
    """Columns with so many values together.

    Args:
        windows: how much each row counts in means.
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
        """Over the windows; over rows where these have no window, such as of temperatures in motion."""
        found = []
        for part, windows in zip(self._parts(values), self._parts(self.windows), strict=True):
            known = [(one, weight) for one, weight in zip(part, windows, strict=True) if one is not None]
            total = sum(weight for _, weight in known)
            weighed = known if total else [(one, 1.0) for one, _ in known]
            total = total or len(known)
            mean = sum(one * weight for one, weight in weighed) / total if known else None
            found.append(number(known[0][0] if len(known) == 1 else mean, digits))
        return found


def _worst(part: Sequence[Value]) -> str:
    """What is farthest from 0."""
    known = [one for one in part if one is not None]
    return number(max(known, key=abs) if known else None)


def _worn(part: Sequence[bool | None]) -> str:
    known = set(part)
    if True in known and False in known:
        return "in part"
    return "yes" if True in known else "no" if False in known else "–"
