"""phyphox: `Raw Data.csv` of its experiments on acceleration, with quoted names and exponents.

Columns are `"Time (s)","Acceleration x (m/s^2)",...`, from the start of the measurement, between commas,
semicolons or tabs, with points or commas as decimals; those of the experiment without gravity are called
`Linear Acceleration x (m/s^2)` (github.com/phyphox/phyphox-experiments, `accelerometer.phyphox` and
`linear_accelerometer.phyphox`).
"""

from __future__ import annotations

from accelcal_cli.formats.tables.vendors import Doubt, Head, Stated, Vendor

WITH_GRAVITY = tuple(f"acceleration {axis}" for axis in "xyz")
WITHOUT = tuple(f"linear acceleration {axis}" for axis in "xyz")
LINEAR = Doubt(
    "it holds acceleration without gravity",
    'record the experiment "Acceleration (with g)"; or give --unit to read it anyway',
)


def recognise(head: Head) -> bool:
    """Return True if the columns have these names."""
    axes = head.numbers(*WITH_GRAVITY) or head.numbers(*WITHOUT)
    return head.numbers("time") is not None and axes is not None


def describe(head: Head) -> Stated:
    """Return which of the two experiments it is; the names of the columns say the rest."""
    return Stated(title="phyphox", doubt=None if head.numbers(*WITH_GRAVITY) else LINEAR)


VENDOR = Vendor("phyphox", recognise, describe, by_names=True)
