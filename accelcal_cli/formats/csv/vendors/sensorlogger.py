"""Sensor Logger, of Android and iOS: a file for each sensor, named after it, with the axes in reverse order.

All have the columns `time,seconds_elapsed,z,y,x`, the first in nanoseconds since 1970 (UTC).
`TotalAcceleration.csv` holds acceleration with gravity, in m/s2; `AccelerometerUncalibrated.csv` too, on iOS
in g; `Accelerometer.csv` is without gravity, and `Gravity.csv` holds its direction alone, of constant length
(github.com/tszheichoi/awesome-sensor-logger, README.md and UNITS.md). Only the values tell them apart.
"""

from __future__ import annotations

from math import hypot

from accelcal_cli.core.vocabulary import ACCELERATION_UNITS
from accelcal_cli.formats.csv.vendors import Doubt, ExportDescription, Head, Vendor

NAMES = ["time", "seconds_elapsed", "z", "y", "x"]
WITH_GRAVITY = (ACCELERATION_UNITS["m/s2"].rest, ACCELERATION_UNITS["g"].rest)
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
    """Return True if the columns have these names in this order; others may follow."""
    return [cell.strip('" ') for cell in head[0].split(",")][: len(NAMES)] == NAMES


def describe(head: Head) -> ExportDescription:
    """Return the doubt whether the first rows are what an accelerometer measures."""
    lengths = sorted(length for line in head[1:-1] if (length := _length(line)) is not None)
    return ExportDescription(title="Sensor Logger", doubt=_doubt(lengths))


def _length(line: str) -> float | None:
    """Return the length of a row's vector; None if a value is missing or no number."""
    try:
        return hypot(*map(float, line.split(",")[2:5]))
    except ValueError:
        return None


def _doubt(lengths: list[float]) -> Doubt | None:
    if len(lengths) < FEWEST_ROWS:
        return None
    usual, low = lengths[len(lengths) // 2], lengths[len(lengths) // 10]
    if lengths[-1] - lengths[0] <= CONSTANT * usual:
        return DIRECTION
    fits = any(least <= usual <= most for least, most in WITH_GRAVITY)
    return None if fits and low >= LEAST_SHARE * usual else WITHOUT


VENDOR = Vendor("sensorlogger", recognise, describe)
