"""The pace of a table's rows: by their times, by what is stated, or by the user."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS, iso_time
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.formats._stamps import (
    GAP_PERIODS,
    JITTER_ERROR,
    LOST,
    Pace,
    jittered_step,
    nice_rate,
    only_stamp_period,
    shared_pace,
    shares_stamps,
    stamp_error,
)
from accelcal_cli.formats.tables.header import Source

SLOWEST_HZ, FASTEST_HZ = 1e-7, 100_000.0
RATE = re.compile(
    r"(?:sampl\w{0,5}|update|output|data|logging|acc\w{0,12}|measurement)[ _-]*(?:rate|freq\w{0,8})"
    r"\W*(?:\(?Hz\)?\W*)?(\d{1,6}(?:[.,]\d{1,6})?)(?!\d|[.,]\d|:)\s*(?!k?s\b|kHz|MHz|%|min)",
    re.IGNORECASE,
)
"""A sampling rate among the lines above a table."""


def rate_above(text: str) -> float | None:
    """Return the rate [Hz] in lines above a table, such as `Sample rate: 100 Hz`; None without one."""
    rates = {float(rate.replace(",", ".")) for rate in RATE.findall(text)}
    return rates.pop() if len(rates) == 1 and 0 < min(rates) <= FASTEST_HZ else None


def find_pace(stamps: NDArray[np.int64] | None, source: Source, options: ReadOptions) -> Pace:
    """Return the pace of the rows: by their times, by what is stated, or by the user.

    Args:
        stamps: (n,) the first times [us]; None if the table has none.

    Raises:
        UnreadableError: nothing tells the rate, two of these contradict each other, or no recorder has it.
        UsageError: the user's rate contradicts that of the header of a table without times.
    """
    stated_hz, user_hz, path = source.stated.rate_hz, options.rate_hz, source.path
    if stamps is not None:
        known = stamps[stamps > LOST]
        by_header = user_hz is None and stated_hz is not None
        pace = _agreeing_pace(known, stated_hz or 0, path) if by_header else _pace_of(known, user_hz, path)
    elif stated_hz is not None:
        pace = Pace(agreed_rate(options, stated_hz, path))
    elif user_hz is not None:
        pace = Pace(user_hz)
    else:
        raise UnreadableError(
            "no column is known to hold the time",
            path=path,
            hint="name it with -R time_column=NAME, or give the sampling rate with --rate HZ; means of still "
            "windows are fitted with `accelcal fit`",
        )
    if not SLOWEST_HZ <= pace.rate_hz <= FASTEST_HZ:
        what = f"a sampling rate of {pace.rate_hz:g} Hz cannot be right"
        raise UnreadableError(what, path=path, hint="give it with --rate HZ")
    return pace


def _pace_of(stamps: NDArray[np.int64], user_hz: float | None, path: Path) -> Pace:
    """Return the pace of the first rows, whose times are `stamps` (n,) [us]; raises as `find_pace`."""
    pace = shared_pace(stamps) if shares_stamps(stamps) else _pace_of_single_stamps(stamps)
    if pace is None and user_hz is None:
        why = ": none of the first ones exists"
        if len(stamps):
            alike = f": {iso_time(int(stamps[0]), None)} in each of the first {len(stamps)}"
            why = alike * (not np.ptp(stamps))
        what = f"the sampling rate cannot be found from the times of its rows{why}"
        raise UnreadableError(what, path=path, hint="give it with --rate")
    if pace is None or user_hz is None:
        return pace or Pace(float(user_hz or 0), only_stamp_period(stamps))
    if not pace.agrees(user_hz):
        what = f"its times say {pace.rate_hz:g} Hz, not {user_hz:g} Hz"
        hint = "omit --rate, or ignore the times with -R time_column=none"
        raise UnreadableError(what, path=path, hint=hint)
    return Pace(user_hz, pace.stamp_period_us)


def _agreeing_pace(stamps: NDArray[np.int64], header_hz: float, path: Path) -> Pace:
    """Return the pace of the first rows of a file whose header states its rate.

    Raises:
        UnreadableError: the rows are not made at that rate.
    """
    try:
        pace = _pace_of(stamps, None, path)
    except UnreadableError:
        return _pace_of(stamps, header_hz, path)
    if not pace.agrees(header_hz):
        what = f"its header says {header_hz:g} Hz, the times of its rows say {pace.rate_hz:g} Hz"
        hint = f"export the raw data; or give --rate {pace.rate_hz:g} if the rows are right"
        raise UnreadableError(what, path=path, hint=hint)
    return Pace(header_hz, pace.stamp_period_us)


def _pace_of_single_stamps(stamps: NDArray[np.int64]) -> Pace | None:
    """Return the pace of rows that have a stamp each: the mean step without gaps, unless stamps jitter."""
    jittered = jittered_step(stamps)
    if jittered is not None:
        return Pace(nice_rate(MICROSECONDS / jittered, JITTER_ERROR))
    steps = np.diff(stamps)
    steps = steps[steps >= 0]
    usual = steps[steps <= GAP_PERIODS * max(float(np.median(steps)), 1.0)] if len(steps) else steps
    if len(usual) == 0 or usual.sum() == 0:
        return None
    error = max(stamp_error(stamps), float(np.std(usual) / np.mean(usual)) / len(usual) ** 0.5)
    return Pace(nice_rate(len(usual) * MICROSECONDS / float(usual.sum()), error))
