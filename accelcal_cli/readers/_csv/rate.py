"""The sampling rate, from the times of the first rows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError

GAP_PERIODS = 3
DEVICE_RATES = (1.5625, 3.125, 6.25, 12.5, 25.6, 31.25, 100 / 3, 51.2, 62.5, 200 / 3, 102.4, 204.8)
"""Rates that are no whole number, of devices in common use."""

DISAGREEMENT = 1.2
SHORTFALL = 0.2
"""Groups of rows that miss the usual size by more lie beside a gap."""


@dataclass(frozen=True, slots=True)
class Pace:
    """How the rows of a file follow each other in time.

    Attributes:
        rate_hz: rows a second.
        stamp_period_us: time from one stamp to the next where several rows share a stamp and
            must be spread; 0 where every row has its own.
    """

    rate_hz: float
    stamp_period_us: int = 0

    @property
    def period_us(self) -> float:
        """Time from one row to the next."""
        return MICROSECONDS / self.rate_hz

    @property
    def rows_per_stamp(self) -> int:
        """Rows that usually share a stamp."""
        return max(1, round(self.rate_hz * self.stamp_period_us / MICROSECONDS))


def find_pace(stamps: NDArray[np.int64], said_hz: float | None, path: Path) -> Pace:
    """The pace of the first rows, whose times are `stamps` (n,) [us].

    Raises:
        UnreadableError: too few rows or times that do not move, without a rate from the user;
            or a rate from the user that contradicts the times.
    """
    starts = np.flatnonzero(np.diff(stamps, prepend=stamps[:1] - 1))
    sizes = np.diff(starts)[1:]
    pace = _shared(stamps[starts], sizes) if len(sizes) and np.median(sizes) >= 2 else _single(stamps)
    if pace is None and said_hz is None:
        raise UnreadableError(
            "the times of its rows do not tell the sampling rate", path=path, hint="give it with --rate"
        )
    if pace is None or said_hz is None:
        return pace or Pace(float(said_hz or 0), _only_stamp_period(stamps, len(starts)))
    if not 1 / DISAGREEMENT < said_hz / pace.rate_hz < DISAGREEMENT:
        raise UnreadableError(
            f"its times say {pace.rate_hz:g} Hz, not {said_hz:g} Hz",
            path=path,
            hint="leave --rate out, or let it count alone with --time-column none",
        )
    return Pace(said_hz, pace.stamp_period_us)


def agreeing_pace(stamps: NDArray[np.int64], header_hz: float, path: Path) -> Pace:
    """The pace of the first rows of a file whose header tells its rate.

    Raises:
        UnreadableError: the rows are not made at that rate.
    """
    try:
        pace = find_pace(stamps, None, path)
    except UnreadableError:
        return find_pace(stamps, header_hz, path)
    if not 1 / DISAGREEMENT < header_hz / pace.rate_hz < DISAGREEMENT:
        raise UnreadableError(
            f"its header says {header_hz:g} Hz, the times of its rows say {pace.rate_hz:g} Hz",
            path=path,
            hint=f"export the raw data; or give --rate {pace.rate_hz:g} where the rows are right",
        )
    return Pace(header_hz, pace.stamp_period_us)


def _only_stamp_period(stamps: NDArray[np.int64], distinct: int) -> int:
    """A second, where all rows there are share one or two whole-second stamps."""
    shared = len(stamps) > 2 * distinct and not (stamps % MICROSECONDS).any()
    return MICROSECONDS if shared else 0


def _shared(stamps: NDArray[np.int64], sizes: NDArray[np.int64]) -> Pace | None:
    """Several rows a stamp; the first and last groups may be cut and do not count."""
    steps = np.diff(stamps)[1:]
    period = int(np.median(steps))
    typical = float(np.median(sizes))
    whole = np.abs(sizes - typical) <= max(1.0, SHORTFALL * typical)
    usual = whole & (steps > 0) & (2 * steps <= GAP_PERIODS * period)
    if period <= 0 or not usual.any():
        return None
    rate = float(sizes[usual].sum()) * MICROSECONDS / float(steps[usual].sum())
    return Pace(nice_rate(rate), period)


def _single(stamps: NDArray[np.int64]) -> Pace | None:
    """Every row its own stamp: the mean of the steps that are not gaps."""
    steps = np.diff(stamps)
    steps = steps[steps >= 0]
    usual = steps[steps <= GAP_PERIODS * max(float(np.median(steps)), 1.0)] if len(steps) else steps
    if len(usual) == 0 or usual.sum() == 0:
        return None
    return Pace(nice_rate(len(usual) * MICROSECONDS / float(usual.sum())))


def nice_rate(measured: float) -> float:
    """The rate a device was probably set to, or the measured one where that is not clear.

    Crystals and stamps in milliseconds miss a nominal rate by a few thousandths.
    """
    for rate in DEVICE_RATES:
        if abs(measured - rate) < 0.0005 * rate:
            return rate
    for grid, tolerance in ((5.0, 0.005), (1.0, 0.0005)):
        rate = grid * round(measured / grid)
        if measured > 9.5 and abs(measured - rate) < tolerance * rate:
            return rate
    return float(f"{measured:.6g}")
