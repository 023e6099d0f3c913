"""Numbers of a track as raw counts and times, and the units that attributes name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Counts
from accelcal_cli.core.vocabulary import PER_G, PER_SECOND, TIME, In

LARGEST_G = 127.0
EMPTY = -(1 << 63)
"""Stands for an empty cell among whole numbers of 64 bits."""

DAY_S = 86_400
EPOCH_DAYS = (719_529.0, 25_569.0)
"""1970-01-01 as MATLAB (from the year 0) and spreadsheets (from 1899-12-30) number days."""

PLAUSIBLE_HZ = (5.0, 800.0)
"""Wide enough for every actigraph; narrow enough that only one unit of time fits."""

LATEST_US = 4_102_444_800 * MICROSECONDS
"""2100-01-01: a later time is damage."""

EARLIEST_ABSOLUTE_US = 315_532_800 * MICROSECONDS
"""1980-01-01: a smaller number counts from the start of the recording, not from 1970."""


@dataclass(frozen=True, slots=True)
class Scale:
    """How numbers become counts.

    Attributes:
        lsb: counts in one unit of the result (g or deg/s).
        divisor: what one unit of the result is in the dataset; None if its numbers are counts.
        limit: largest believable magnitude, in units of the result; of no use for counts.
        exact: the type that holds all counts of the dataset, None if some may not fit.
    """

    lsb: float
    divisor: float | None = None
    limit: float = 0.0
    exact: type[np.int16] | type[np.int32] | None = None

    def counts(self, values: NDArray[Any]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
        """Counts of rows (n, 3), and by problem code the rows (n,) that have none."""
        if self.exact is np.int16 and values.dtype.kind != "f":
            return values.astype(np.int16), {}
        if self.exact is np.int32 and values.dtype.kind != "f":
            return values.astype(np.int32), {}
        if values.dtype.kind in "iu":
            return _narrowed(values)
        with np.errstate(over="ignore", invalid="ignore"):
            if values.dtype == np.float32 and self.divisor == 1.0 and self.lsb == FLOAT_LSB_PER_G:
                return self._shifted(values)
            return self._rounded(values.astype(np.float64))

    def _shifted(self, values: NDArray[np.float32]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
        """What `_rounded` gives, in half the time: a power of two moves no bit of a fraction."""
        whole = values * np.float32(self.lsb)
        np.rint(whole, out=whole)
        limit = self.limit * self.lsb
        if len(whole) and not (whole.min() >= -limit and whole.max() <= limit):
            return self._rounded(values.astype(np.float64))
        return whole.astype(np.int32), {}

    def _rounded(self, values: NDArray[np.float64]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
        missing: NDArray[np.bool_] = np.isnan(values)
        if self.divisor is None:
            whole, limit = values, float(2**31 - 1)
            broken = ~missing & np.isfinite(values) & (values != np.rint(values))
        else:
            units = values / self.divisor
            whole, limit = np.rint(units * self.lsb), self.limit * self.lsb
            broken = np.zeros_like(missing)
        beyond: NDArray[np.bool_] = np.abs(whole) > limit
        bad = missing | broken | beyond
        faults: dict[str, NDArray[np.bool_]] = {
            "missing_value": _rows(missing),
            "bad_row": _rows(broken),
            "out_of_range": _rows(beyond),
        }
        return np.where(bad, 0, whole).astype(np.int32), faults


def _rows(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Rows (n,) with any of three cells true."""
    rows: NDArray[np.bool_] = cells[:, 0] | cells[:, 1] | cells[:, 2]
    return rows


def _narrowed(values: NDArray[Any]) -> tuple[Counts, dict[str, NDArray[np.bool_]]]:
    """Whole numbers as int32, and the rows that do not fit or are empty."""
    beyond, faults = values > 2**31 - 1, {}
    if values.dtype.kind == "i":
        beyond |= values < -(2**31)
        if values.dtype.itemsize == 8:
            faults["missing_value"] = _rows(values == EMPTY)
    faults["out_of_range"] = _rows(beyond)
    return np.where(beyond, 0, values).astype(np.int32), faults


def count_scale(lsb: float, dtype: np.dtype[Any]) -> Scale:
    """Numbers that are counts already."""
    if dtype.kind == "f" or not np.can_cast(dtype, np.int32):
        return Scale(lsb)
    return Scale(lsb, exact=np.int16 if np.can_cast(dtype, np.int16) else np.int32)


def physical_scale(unit: str, dtype: np.dtype[Any]) -> Scale:
    """Numbers in g, mg or m/s2: whole ones are counts of that unit, fractions go to a fine grid."""
    if dtype.kind in "iu":
        return count_scale(PER_G[unit], dtype)
    return Scale(FLOAT_LSB_PER_G, PER_G[unit], LARGEST_G)


def time_unit(text: str) -> str | None:
    """One of s, ms, us, ns for what an attribute says (`seconds since ...` too); None if unknown."""
    return TIME.find(next(iter(text.lower().split()), ""), In.TABLES)


def unit_by_size(value: float) -> str | None:
    """The unit in which a number is a moment of 1980..2100; at most one fits."""
    moments_us = {unit: value / per_second * MICROSECONDS for unit, per_second in PER_SECOND.items()}
    return next((unit for unit, us in moments_us.items() if EARLIEST_ABSOLUTE_US <= us < LATEST_US), None)


def day_of_1970(head: NDArray[Any]) -> float | None:
    """The number of 1970-01-01 where numbers (n,) are days of our time, in fractions of a second's steps."""
    step = float(np.median(np.diff(head))) * DAY_S if len(head) > 1 and head.dtype.kind == "f" else 0.0
    if step <= 0 or not PLAUSIBLE_HZ[0] <= 1 / step <= PLAUSIBLE_HZ[1]:
        return None
    moments = {day: (float(head[0]) - day) * DAY_S * MICROSECONDS for day in EPOCH_DAYS}
    return next((day for day, us in moments.items() if EARLIEST_ABSOLUTE_US <= us < LATEST_US), None)


class Moment(NamedTuple):
    """A time in microseconds since 1970; whether it is UTC for certain, and was written with an offset."""

    us: int
    is_utc: bool = False
    had_offset: bool = False


def parse_moment(value: str | float) -> Moment | None:
    """The moment of a start attribute; None if it is none.

    A number counts s, ms, us or ns since 1970, by its size, and is UTC. A text is an ISO date and time;
    only one with `Z` or an offset is UTC for certain.
    """
    if isinstance(value, float):
        unit = unit_by_size(value)
        return None if unit is None else Moment(round(value / PER_SECOND[unit] * MICROSECONDS), is_utc=True)
    if re.fullmatch(r"\d+(\.\d*)?", value):
        return parse_moment(float(value))
    try:
        moment = datetime.fromisoformat(value.replace(" UTC", "Z"))
        known = moment.tzinfo is not None
        since = moment.astimezone(UTC) if known else moment.replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        return None
    microseconds = (since - datetime(1970, 1, 1, tzinfo=UTC)) // datetime.resolution
    if not 0 <= microseconds < LATEST_US:
        return None
    return Moment(microseconds, known, bool(moment.utcoffset()))


@dataclass(frozen=True, slots=True)
class StampScale:
    """How the numbers of a time dataset become microseconds since 1970.

    Attributes:
        unit: s, ms, us, ns or days.
        base_us: the moment from which they count.
        epoch_day: the number of 1970-01-01, of days.
    """

    unit: str
    base_us: int = 0
    epoch_day: float = 0.0

    def times(self, values: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Times (n,) [us], and which of them are believable."""
        per_second = PER_SECOND.get(self.unit, 1 / DAY_S)
        if self.epoch_day:
            values = values - self.epoch_day
        largest = LATEST_US // MICROSECONDS * per_second
        with np.errstate(invalid="ignore"):
            believable = (values >= 0) & (values < largest)
        kept = values if believable.all() else np.where(believable, values, 0)
        if kept.dtype.kind == "f":
            ticks = np.rint(kept.astype(np.float64) * (MICROSECONDS / per_second)).astype(np.int64)
        elif per_second > MICROSECONDS:
            ticks = (kept.astype(np.int64) + 500) // 1000
        else:
            ticks = kept.astype(np.int64, copy=False)
            if per_second != MICROSECONDS:
                ticks = ticks * (MICROSECONDS // int(per_second))
        times = ticks + self.base_us if self.base_us else ticks
        return times, believable & (times < LATEST_US) if self.base_us else believable


def typical_step(times: NDArray[np.int64]) -> float | None:
    """Mean step between samples [us] without gaps; None if there is no step forward."""
    changes = np.flatnonzero(np.diff(times)) + 1
    if len(changes) < 2:
        changes = np.array([0, len(times) - 1])
    steps, rows = np.diff(times[changes]), np.diff(changes)
    if not (steps > 0).any():
        return None
    usual = float(np.median(steps[steps > 0]))
    regular = (steps > 0) & (steps <= 3 * usual)
    return float(steps[regular].sum() / rows[regular].sum())


def nominal_rate(step_us: float) -> float:
    """The rate that a mean step means: whole where it is within 0.1 % of a whole number of Hz."""
    rate = MICROSECONDS / step_us
    whole = round(rate)
    return float(whole) if whole and abs(rate - whole) <= whole / 1000 else round(rate, 4)
