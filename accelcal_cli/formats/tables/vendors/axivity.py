"""Axivity AX3 and AX6: CSV as OmGui and cwa-convert write it, without any header.

A stamp in milliseconds, then x, y, z in g with six decimals, each a multiple of the sensor's step;
behind them the gyroscope and whatever else was asked for (github.com/digitalinteraction/openmovement,
Software/AX3/cwa-convert/c/main.c). Raw units look like those of any other logger: the reader asks.
"""

from __future__ import annotations

import re

from accelcal_cli.formats.tables.vendors import Lines, Stated, Vendor

VALUE = r",(-?\d{1,2}\.\d{6})"
ROW = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}" + 3 * VALUE + r"(,[-+.\d]*)*")
FINEST_LSB_PER_G = 16_384
"""Scale of an AX6 set to +-2 g; all coarser scales divide it."""

LEAST_ROWS = 3
LOOKED_AT = 20
"""Rows that are compared with the form, and how many there must be."""


def recognise(head: Lines) -> bool:
    """Return True if every row has the form, and values on the sensor's grid."""
    rows = [ROW.fullmatch(line) for line in head[:-1][:LOOKED_AT]]
    return len(rows) >= LEAST_ROWS and all(row is not None and _on_grid(row) for row in rows)


def _on_grid(row: re.Match[str]) -> bool:
    """Return True if x, y and z are multiples of the finest step, rounded to six decimals."""
    counts = [float(row[axis]) * FINEST_LSB_PER_G for axis in (1, 2, 3)]
    return all(abs(count - round(count)) <= 0.51e-6 * FINEST_LSB_PER_G for count in counts)


def describe(head: Lines) -> Stated:
    """Return the roles of the columns."""
    others = head[0].count(",") - 3
    return Stated(title="Axivity", names=("time", "x", "y", "z", *("other",) * others), unit="g")


VENDOR = Vendor("axivity", recognise, describe)
