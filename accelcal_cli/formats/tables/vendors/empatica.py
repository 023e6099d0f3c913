"""Empatica E4: `ACC.csv` with the start, the rate, then counts of 1/64 g.

The first line is the start in seconds since 1970 (UTC), the second the rate in Hz, each written
once a column; the sensor measures +-2 g in 8 bits (Empatica, "info.txt" of every E4 session).
"""

from __future__ import annotations

from fractions import Fraction

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.recording import Device
from accelcal_cli.formats.tables.vendors import Lines, Start, Stated, Vendor

LSB_PER_G = 64.0
RANGE_G = 2.0
EPOCH_S = (9 * 10**8, 5 * 10**9)
"""A start [s since 1970] lies between these."""

FASTEST_HZ = 1000


def _threefold(line: str) -> Fraction | None:
    """Return the number that a line holds three times over, None if it does not."""
    cells = {cell.strip() for cell in line.split(",")}
    if len(cells) != 1 or line.count(",") != 2:
        return None
    cell = cells.pop()
    plain = len(cell) < 30 and cell.replace(".", "", 1).isdecimal() and cell.isascii()
    return Fraction(cell) if plain else None


def _start_and_rate(head: Lines) -> tuple[Fraction, Fraction] | None:
    if len(head) < 2:
        return None
    start, rate = _threefold(head[0]), _threefold(head[1])
    if start is None or rate is None:
        return None
    fits = EPOCH_S[0] <= start <= EPOCH_S[1] and 0 < rate <= FASTEST_HZ
    return (start, rate) if fits else None


def recognise(head: Lines) -> bool:
    """Return True for a time since 1970 three times over, then a rate three times over."""
    return _start_and_rate(head) is not None


def describe(head: Lines) -> Stated:
    """Return start, rate, scale and range; E4 files do not name their device."""
    start, rate = _start_and_rate(head) or (Fraction(0), Fraction(0))
    return Stated(
        title="Empatica E4",
        device=Device("Empatica E4"),
        preamble=2,
        names=("x", "y", "z"),
        unit="counts",
        lsb_per_g=LSB_PER_G,
        rate_hz=float(rate),
        start=Start(round(start * MICROSECONDS)),
        timezone="UTC",
        range_g=RANGE_G,
    )


VENDOR = Vendor("empatica", recognise, describe)
