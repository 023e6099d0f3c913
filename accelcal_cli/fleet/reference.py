"""Offsets at one temperature, so that recordings with and without slopes can be compared."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.fleet.parameters import OFFSETS, SLOPES
from accelcal_cli.fleet.records import Floats, Records

TEMPERATURE_DOUBT_C = 4.0
"""Standard deviation of the unknown mean temperature of a recording without slopes about the reference:
our choice, of the order of the spread between people, seasons and bedrooms."""


@dataclass(frozen=True, slots=True, eq=False)
class Referred:
    """Recordings with their offsets at one temperature a device.

    Attributes:
        temperature_c: (d,) of each device; NaN where none of its recordings has slopes.
    """

    records: Records
    temperature_c: Floats


def at_one_temperature(
    records: Records, counted: NDArray[np.bool_], temperature_c: float | None = None
) -> Referred:
    """Move the offsets of recordings with slopes to one temperature, and widen the errors.

    With slopes: o + s (T - Tref), variance SE(o)^2 + (T - Tref)^2 SE(s)^2; Tref is the mean temperature of
    the recording's points, about which offset and slope are nearly uncorrelated. Without: the offset is that
    at a mean temperature which is not known; its variance grows by (TEMPERATURE_DOUBT_C s)^2, s the
    weighted mean slope of the device.

    Args:
        counted: (n,) the recordings that decide the temperature.
        temperature_c: for all devices; if None, the median of each device's reference temperatures.
    """
    warm = np.isfinite(records.values[:, SLOPES]).all(axis=1) & np.isfinite(records.number["reference_c"])
    chosen, slope = _of_devices(records, warm & counted, temperature_c)
    at, mean = chosen[records.device_of()], slope[records.device_of()]
    away = np.where(warm, at - records.number["reference_c"], nan)[:, np.newaxis]
    values, errors = records.values.copy(), records.errors.copy()
    moved = values[:, OFFSETS] + away * values[:, SLOPES]
    spread = np.where(warm[:, np.newaxis], away * errors[:, SLOPES], TEMPERATURE_DOUBT_C * mean)
    known = np.isfinite(at)[:, np.newaxis]
    values[:, OFFSETS] = np.where(known & np.isfinite(away), moved, values[:, OFFSETS])
    errors[:, OFFSETS] = np.where(
        known, np.hypot(errors[:, OFFSETS], np.nan_to_num(spread)), errors[:, OFFSETS]
    )
    return Referred(replace(records, values=values, errors=errors), chosen)


def _of_devices(
    records: Records, warm: NDArray[np.bool_], temperature_c: float | None
) -> tuple[Floats, Floats]:
    """Temperature (d,) and weighted mean slope (d, 3) of each device that has slopes."""
    chosen = np.full(len(records.devices), nan)
    slope = np.full((len(records.devices), 3), nan)
    for device in range(len(records.devices)):
        rows = [row for row in records.rows(device) if warm[row]]
        if not rows:
            continue
        own = float(np.median(records.number["reference_c"][rows]))
        chosen[device] = own if temperature_c is None else temperature_c
        weights = np.nan_to_num(1 / records.errors[rows, SLOPES] ** 2)
        total = weights.sum(axis=0)
        held = (weights * records.values[rows, SLOPES]).sum(axis=0)
        slope[device] = np.divide(held, total, out=np.zeros(3), where=total > 0)
    return chosen, slope
