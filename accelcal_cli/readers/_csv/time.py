"""Times as a text file writes them, as whole microseconds since 1970."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.readers._csv.arrays import filled, floats
from accelcal_cli.readers._csv.cells import MISSING, number_of

NO_TIME = -(1 << 62)
"""Stands for a missing time; far enough from every real one to subtract without overflow."""

EMPTY_NS = -(1 << 63)
"""Stands for an empty cell among Arrow's times."""

STAMP = re.compile(r"\d{4}[-/]\d\d[-/]\d\d([T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(?P<zone>Z|[+-]\d\d(:?\d\d)?)?)?")
DAY_US = 86_400e6
UNITS_US = (1e6, 1e3, 1.0, 1e-3)
EPOCH_DAYS = (25_569.0, 719_529.0)
"""1970-01-01 as spreadsheets (from 1899-12-30) and as MATLAB number days."""

EPOCH_S = (9e8, 5e9)
"""Plain numbers count from 1970 where they then mean 1998 to 2128."""

LONGEST_PERIOD_US = 60e6
PLAUSIBLE_HZ = (5.0, 800.0)
"""Wide enough for every actigraph; narrow enough that only one unit of time fits."""


@dataclass(frozen=True, slots=True)
class TimeFormat:
    """How the cells of the time column are written.

    Attributes:
        unit_us: microseconds in one unit of a plain number; None for ISO 8601.
        zoned: every ISO time ends in Z or an offset, so that the times are UTC.
        since_1970: False where the numbers count from the start of the recording.
        epoch_day: the number of 1970-01-01 where days are counted from another date.
    """

    unit_us: float | None
    zoned: bool = False
    since_1970: bool = True
    epoch_day: float = 0.0

    @property
    def arrow_type(self) -> Any:
        """The type that pyarrow is to give the column."""
        if self.unit_us is not None:
            return pa.float64()
        return pa.timestamp("ns", tz="UTC" if self.zoned else None)

    def microseconds(self, column: Any) -> NDArray[np.int64]:
        """A column (n,) of that type as times (n,) [us], NO_TIME where the cell is empty."""
        if self.unit_us is None:
            whole = filled(column.cast(pa.int64()), np.int64, EMPTY_NS)
            return np.where(whole == EMPTY_NS, NO_TIME, (whole + 500) // 1000)
        values = np.rint((floats(column) - self.epoch_day) * self.unit_us)
        usable = np.abs(values) < 1 << 60
        return np.where(usable, np.where(usable, values, 0).astype(np.int64), NO_TIME)


def find_time_format(
    cells: Sequence[str], unit_us: float | None, rate_hz: float | None, path: Path, line: int
) -> TimeFormat:
    """How the first cells of the time column are written; `unit_us` is what its name says.

    Raises:
        UnreadableError: they can be read in more than one way, or are no times.
    """
    filled = [cell.strip() for cell in cells if cell.strip() not in MISSING]
    numbers = [value for cell in filled if (value := number_of(cell)) is not None]
    if numbers and len(numbers) == len(filled):
        return _number_format(numbers, unit_us, rate_hz, path)
    stamps = [STAMP.fullmatch(cell) for cell in filled]
    if None in stamps or not stamps:
        wrong = next((cell for cell, stamp in zip(filled, stamps, strict=True) if stamp is None), "")
        raise UnreadableError(
            f"the time {wrong!r} is not written as 2024-03-04 12:34:56.789",
            path=path,
            line=line,
            hint="rewrite the times that way, with the date and the time of day in one column, or give "
            "--time-column none and --rate",
        )
    zones = {bool(stamp and stamp["zone"]) for stamp in stamps}
    if len(zones) == 2:
        raise UnreadableError(
            "some times have a zone and some have none",
            path=path,
            line=line,
            hint="write all of them with Z or an offset, or none",
        )
    return TimeFormat(None, zoned=zones == {True})


def _number_format(
    values: Sequence[float], unit_us: float | None, rate_hz: float | None, path: Path
) -> TimeFormat:
    step = _usual_step(values)
    middle = sorted(values)[len(values) // 2]
    units = UNITS_US if unit_us is None else (unit_us,)
    since = [unit for unit in units if _is_epoch(middle * unit) and step * unit <= LONGEST_PERIOD_US]
    fitting = [unit for unit in (*UNITS_US, DAY_US) if _fits(step * unit, rate_hz)]
    sure = [unit for unit in since if unit in fitting]
    if sure or (since and not fitting):
        return TimeFormat((sure or since)[0])
    if unit_us is not None:
        return TimeFormat(unit_us, since_1970=bool(since))
    for epoch_day in EPOCH_DAYS:
        if fitting == [DAY_US] and _is_epoch((middle - epoch_day) * DAY_US):
            return TimeFormat(DAY_US, epoch_day=epoch_day)
    if len(fitting) == 1 and (rate_hz or not since):
        return TimeFormat(fitting[0], since_1970=False)
    known = f"does not fit {rate_hz:g} Hz" if rate_hz else "may be seconds or milliseconds"
    raise UnreadableError(
        f"the time column rises by {step:g} a row, which {known}",
        path=path,
        hint="give the right --rate, or --time-column none with --rate where it only counts rows",
    )


def _is_epoch(time_us: float) -> bool:
    """Whether microseconds since 1970 mean a date in the life of actigraphs."""
    return EPOCH_S[0] <= time_us / 1e6 <= EPOCH_S[1]


def _usual_step(values: Sequence[float]) -> float:
    """The rise a row: the median, or the mean where stamps repeat."""
    steps = sorted(right - left for left, right in pairwise(values))
    if not steps:
        return 0.0
    return steps[len(steps) // 2] or (max(values) - min(values)) / len(steps)


def _fits(period_us: float, rate_hz: float | None) -> bool:
    low, high = (rate_hz / 2, rate_hz * 2) if rate_hz else PLAUSIBLE_HZ
    return period_us > 0 and low <= 1e6 / period_us <= high
