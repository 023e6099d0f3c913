"""Times in HDF5 files: start attributes and time datasets."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS

LATEST_US = 4_102_444_800 * MICROSECONDS
"""2100-01-01: a later time is damage."""
EARLIEST_ABSOLUTE_US = 315_532_800 * MICROSECONDS
"""1980-01-01: a smaller number counts from the start of the recording, not from 1970."""

PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_UNIT_NAMES = {
    "s": "s sec secs second seconds",
    "ms": "ms msec millisecond milliseconds",
    "us": "us usec microsecond microseconds µs μs",
    "ns": "ns nsec nanosecond nanoseconds",
}


def time_unit(text: str) -> str | None:
    """One of s, ms, us, ns for what an attribute says (`seconds since ...` too); None if unknown."""
    first = text.lower().split()[:1]
    for unit, names in _UNIT_NAMES.items():
        if first and first[0] in names.split():
            return unit
    return None


def unit_by_size(value: float) -> str | None:
    """The unit in which a number is a moment of 1980..2100; at most one fits."""
    for unit, per_second in PER_SECOND.items():
        if EARLIEST_ABSOLUTE_US <= value / per_second * MICROSECONDS < LATEST_US:
            return unit
    return None


def parse_moment(value: str | float) -> tuple[int, bool] | None:
    """Microseconds since 1970 of a start attribute, and whether it is UTC for certain.

    A number counts s, ms, us or ns since 1970, by its size. A text is an ISO date and time;
    only one with `Z` or an offset is UTC for certain. None where it is neither.
    """
    if isinstance(value, float):
        unit = unit_by_size(value)
        return None if unit is None else (round(value / PER_SECOND[unit] * MICROSECONDS), False)
    if re.fullmatch(r"\d+(\.\d*)?", value):
        return parse_moment(float(value))
    try:
        moment = datetime.fromisoformat(value.replace(" UTC", "Z"))
        known = moment.tzinfo is not None
        since = moment.astimezone(UTC) if known else moment.replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        return None
    microseconds = (since - datetime(1970, 1, 1, tzinfo=UTC)) // datetime.resolution
    return (microseconds, known) if 0 <= microseconds < LATEST_US else None


@dataclass(frozen=True, slots=True)
class StampScale:
    """How the numbers of a time dataset become microseconds since 1970.

    Attributes:
        unit: s, ms, us or ns.
        base_us: the moment from which they count.
    """

    unit: str
    base_us: int = 0

    def times(self, values: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Times (n,) [us], and which of them are believable."""
        per_second = PER_SECOND[self.unit]
        largest = LATEST_US // MICROSECONDS * per_second
        with np.errstate(invalid="ignore"):
            believable = (values >= 0) & (values <= largest)
        kept = np.where(believable, values, 0)
        if kept.dtype.kind == "f":
            ticks = np.rint(kept.astype(np.float64) * (MICROSECONDS / per_second)).astype(np.int64)
        elif per_second > MICROSECONDS:
            ticks = (kept.astype(np.int64) + 500) // 1000
        else:
            ticks = kept.astype(np.int64) * (MICROSECONDS // per_second)
        times = ticks + self.base_us
        return times, believable & (times < LATEST_US)


def typical_step(times: NDArray[np.int64]) -> tuple[float, int] | None:
    """Mean step between samples [us] without gaps, and how coarse equal stamps are [us].

    The second is 0 where stamps differ from each other. None where there is no step forward.
    """
    changes = np.flatnonzero(np.diff(times)) + 1
    if len(changes) < 2:
        changes = np.array([0, len(times) - 1])
    steps, rows = np.diff(times[changes]), np.diff(changes)
    if not (steps > 0).any():
        return None
    usual = float(np.median(steps[steps > 0]))
    regular = (steps > 0) & (steps <= 3 * usual)
    coarse = usual if len(changes) < len(times) * 3 // 4 else 0
    return float(steps[regular].sum() / rows[regular].sum()), int(coarse)


def nominal_rate(step_us: float) -> float:
    """The rate that a mean step means: whole where it is within 0.1 % of a whole number of Hz."""
    rate = MICROSECONDS / step_us
    whole = round(rate)
    return float(whole) if whole and abs(rate - whole) <= whole / 1000 else round(rate, 4)
