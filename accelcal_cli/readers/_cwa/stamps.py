"""When a data sector was written: an anchor, that is a sample number and its time.

The device notes the time, to 1/32768 s, and how many samples its buffer held at that moment. For
old software it stores the number as if the time were the whole second before, so that the two
must be put together again. Source: `Docs/ax3/ax3-technical.md` (openmovement).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.readers._cwa.sector import Sectors, Settings

HAS_FRACTION = 0x8000


@dataclass(frozen=True, slots=True, eq=False)
class Anchors:
    """One anchor a sector, (n,) each.

    Attributes:
        row: int64, number of a sample counted from the sector's first; may lie outside the sector.
        time_us: int64, its time [us since 1970, device clock].
        known: bool, the sector tells a time at all.
    """

    row: NDArray[np.int64]
    time_us: NDArray[np.int64]
    known: NDArray[np.bool_]


def anchors(sectors: Sectors, settings: Settings) -> Anchors:
    """Anchors of sectors recorded with these settings."""
    seconds, known = packed_seconds(sectors["stamp"].copy())
    if settings.is_old:
        return Anchors(np.zeros(len(sectors), np.int64), seconds * MICROSECONDS, known)
    word = sectors["fraction"].copy()
    ticks = (word & np.uint16(HAS_FRACTION - 1)).astype(np.int64)
    ticks *= word >= HAS_FRACTION
    row = sectors["offset"] + ((ticks * int(settings.rate)) >> 15)
    return Anchors(row, seconds * MICROSECONDS + ((ticks * MICROSECONDS + (1 << 14)) >> 15), known)


def packed_seconds(stamp: NDArray[np.uint32]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Seconds since 1970 of packed times, and which of them are times at all.

    From the top: years since 2000 (6 bits), month (4), day (5), hour (5), minute (6), second (6).
    """
    midnights = day_table()[stamp >> np.uint32(17)]
    hour, minute, second = ((stamp >> np.uint32(shift)) & np.uint32(63) for shift in (12, 6, 0))
    hour &= np.uint32(31)
    known = (midnights >= 0) & (hour < 24) & (minute < 60) & (second < 60)
    return midnights + (hour * np.uint32(3600) + minute * np.uint32(60) + second), known


@cache
def day_table() -> NDArray[np.int64]:
    """Seconds since 1970 at the beginning of each packed year, month and day (15 bits); -1 for none."""
    packed = np.arange(1 << 15, dtype=np.int64)
    year, month, day = packed >> 9, packed >> 5 & 15, packed & 31
    months = ((year + 30) * 12 + month - 1).astype("M8[M]")
    days = months.astype("M8[D]").astype(np.int64) + day - 1
    return np.where((month >= 1) & (month <= 12) & (day >= 1), days * 86_400, -1)
