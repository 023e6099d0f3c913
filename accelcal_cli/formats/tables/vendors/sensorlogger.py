"""Sensor Logger, of Android and iOS: a file for each sensor, named after it, with the axes in reverse order.

All have the columns `time,seconds_elapsed,z,y,x`, the first in nanoseconds since 1970 (UTC).
`TotalAcceleration.csv` holds acceleration with gravity, in m/s2; `AccelerometerUncalibrated.csv` too, on iOS
in g; `Accelerometer.csv` is without gravity, and `Gravity.csv` holds its direction alone, of constant length
(github.com/tszheichoi/awesome-sensor-logger, README.md and UNITS.md). Only the values tell them apart.
"""

from __future__ import annotations

from math import hypot

from accelcal_cli.core.vocabulary import ACCELERATION_UNITS
from accelcal_cli.formats.tables.cells import number_of
from accelcal_cli.formats.tables.vendors import Doubt, Head, Stated, Vendor

NAMES = ("time", "seconds_elapsed", "z", "y", "x")
WITH_GRAVITY = [rest for name in ("m/s2", "g") if (rest := ACCELERATION_UNITS[name].rest) is not None]
"""The usual length of acceleration with gravity, in m/s2 and in g."""

LEAST_SHARE = 0.5
"""Share of the usual length that nine rows in ten exceed where there is gravity."""

CONSTANT = 1e-5
"""Relative variation of lengths below which they are those of a direction."""

FEWEST_ROWS = 10

EXPORT = "export TotalAcceleration.csv, or AccelerometerUncalibrated.csv; or give --unit to read it anyway"
WITHOUT = Doubt("it holds acceleration without gravity, such as Accelerometer.csv", EXPORT)
DIRECTION = Doubt("it holds the direction of gravity alone, such as Gravity.csv", EXPORT)


def recognise(head: Head) -> bool:
    """Return True if there are columns of these names; others may be there, too."""
    return head.numbers(*NAMES) is not None


def describe(head: Head) -> Stated:
    """Return the doubt whether the first rows are what an accelerometer measures."""
    axes = [map(number_of, head.cells(number)) for number in head.numbers(*NAMES[2:]) or ()]
    rows = ([*row] for row in zip(*axes, strict=False))
    known = ([one for one in row if one is not None] for row in rows)
    lengths, doubt = sorted(hypot(*row) for row in known if len(row) == 3), None
    if len(lengths) >= FEWEST_ROWS:
        usual, low = lengths[len(lengths) // 2], lengths[(len(lengths) - 1) // 10]
        fits = any(least <= usual <= most for least, most in WITH_GRAVITY)
        doubt = None if fits and low >= LEAST_SHARE * usual else WITHOUT
        doubt = DIRECTION if lengths[-1] - lengths[0] <= CONSTANT * usual else doubt
    return Stated(title="Sensor Logger", time=head.plain.index("time"), doubt=doubt)


VENDOR = Vendor("sensorlogger", recognise, describe, by_names=True)
