"""The maker's calibration next to log.bin: calibration.json and temperature_calibration.json, and its use.

`isCalibrated` false says that the records hold counts of the bare sensor. Method 2 of calibration.json has,
for each sampling rate, offsets in counts, sensitivities of the axes in hundredths of a count per g, and those
across the axes, which are alike both ways: 1 / (250 + s / 100) - 1 / 250 g per count. Method 1 of
temperature_calibration.json is a line through two points of each thermometer. Source: the vendor's reader,
github.com/actigraph/pygt3x 0.7.1, reader.py and calibration.py.

Calibrated values are rounded to the grid of decimal fractions (`FLOAT_LSB_PER_G`). They are computed number
by number, in one order, so that every machine gives the same.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.recording import (
    FLOAT_LSB_PER_G,
    Chunk,
    Counts,
    FactoryAcceleration,
    FactoryCalibration,
    FactoryTemperature,
    Problem,
    clipped_at,
)
from accelcal_cli.formats.gt3x import records as log
from accelcal_cli.formats.gt3x.archive import CALIBRATION, TEMPERATURE_CALIBRATION, Archive, small_part
from accelcal_cli.formats.gt3x.records import RecordBatch, Records

MATRIX, LINE, IN_DEGREES = 2, 1, 0
"""Known methods: of the acceleration, of the temperature, and our own for a temperature in degrees."""

LEAST_COUNTS, MOST_COUNTS = 10.0, 1e6
"""Smallest and largest number of counts per g of an axis."""

FARTHEST_OFFSET = 32_768.0
LARGEST_G = 127.0
MOST_COUNTS = int(LARGEST_G * FLOAT_LSB_PER_G)
"""Largest calibrated value [g] on the grid; larger ones are cut off there, and marked as clipped."""

COLDEST_C, WARMEST_C = -100.0, 200.0
READING_BYTES, ACCELEROMETER = 3, 1
"""Length of a temperature reading, of a thermometer's number and 16 bits, and the number that is used."""

Values = dict[str, Any]
READ_AS_COUNTS = "--lsb-per-g, such as 256, reads the counts as they are"
DAMAGED = "{} in the zip file is damaged: its values for the sensor were not applied"
NOT_APPLIED = "the maker's calibration (calibration.json) was not applied, as --lsb-per-g is given"
OLDER_KIND = "the maker's calibration (calibration.json) was not applied: it is not for activity.bin"
NO_TEMPERATURE = (
    "no temperatures were read: there are none, or temperature_calibration.json does not say what they are"
)


def is_open(values: Values | None) -> bool:
    """Return True if the calibration in one of the two parts is still to be applied."""
    return values is not None and not values.get("isCalibrated", True)


@dataclass(frozen=True, slots=True)
class CalibrationFiles:
    """The content of both parts, None for one that is missing or damaged; and the problem of the latter."""

    acceleration: Values | None = None
    temperature: Values | None = None
    problems: tuple[Problem, ...] = ()

    @classmethod
    def of(cls, archive: Archive) -> CalibrationFiles:
        """Read both parts."""
        names = [name for name in (CALIBRATION, TEMPERATURE_CALIBRATION) if name in archive.members]
        parts: dict[str, Any] = {}
        for name in names:
            with suppress(ValueError, RecursionError):
                parts[name] = json.loads(small_part(archive, name) or b"")
        found = {name: values for name, values in parts.items() if isinstance(values, dict)}
        damaged = [DAMAGED.format(name) for name in names if name not in found]
        problems = tuple(Problem("damaged_header", text, None, 0) for text in damaged)
        return cls(found.get(CALIBRATION), found.get(TEMPERATURE_CALIBRATION), problems)

    def notes(self, done: AppliedCalibration) -> tuple[str, ...]:
        """Return notes on how the parts are used."""
        notes = () if done.factory is None else done.factory.notes()
        if is_open(self.acceleration) and done.acceleration is None:
            notes += (NOT_APPLIED,)
        if self.temperature is not None and done.first_mc is None:
            notes += (NO_TEMPERATURE,)
        return notes


@dataclass(frozen=True, slots=True)
class AppliedCalibration:
    """The maker's calibration as it is applied to the samples of a recording.

    Attributes:
        acceleration: the calibration of counts; None if they are calibrated.
        limit: raw counts from which on a row is marked as clipped; None if unknown.
        temperature: how the thermometer's counts are read; first_mc: its first reading. None without any.
    """

    acceleration: FactoryAcceleration | None = None
    limit: int | None = None
    temperature: FactoryTemperature | None = None
    first_mc: int | None = None

    @property
    def factory(self) -> FactoryCalibration | None:
        """The maker's calibration, as far as there was something to apply."""
        used = self.first_mc is not None and self.temperature is not None and self.temperature.method
        line = self.temperature if used else None
        return FactoryCalibration(self.acceleration, line) if self.acceleration or line else None

    def thermometer(self) -> Thermometer | None:
        """Return a new thermometer, for one pass over the recording."""
        if self.temperature is None or self.first_mc is None:
            return None
        return Thermometer(self.temperature, self.first_mc)

    def apply(self, chunk: Chunk) -> Chunk:
        """Return a chunk of raw counts with calibrated ones, and rows at the limit marked as clipped."""
        if self.acceleration is None:
            return chunk
        if self.limit is not None:
            chunk = clipped_at(chunk, -self.limit, self.limit - 1)
        counts = calibrated_counts(chunk.counts, self.acceleration)
        return clipped_at(replace(chunk, counts=counts), -MOST_COUNTS, MOST_COUNTS)


def acceleration_of(values: Values | None, rate: int, path: Path) -> FactoryAcceleration | None:
    """Return the calibration, which has to be usable, for a sampling rate; None if the counts need none."""
    if values is None or not is_open(values):
        return None
    method = values.get("calibrationMethod")
    if method != MATRIX or isinstance(method, bool):
        raise _unusable(f"is of the unknown method {str(method)[:40]!r}", path)
    pairs = [a + b for a, b in combinations_with_replacement("XYZ", 2)]
    offset = [_number(values.get(f"offset{axis}_{rate}")) for axis in "XYZ"]
    found = {pair: _number(values.get(f"sensitivity{pair}_{rate}")) for pair in pairs}
    if None in offset or None in found.values():
        raise _unusable(f"does not say what {rate} Hz needs", path)
    return _sensible(rate, [value or 0.0 for value in offset], {k: v or 0.0 for k, v in found.items()}, path)


def _sensible(
    rate: int, offset: list[float], sensitivity: dict[str, float], path: Path
) -> FactoryAcceleration:
    along = [sensitivity[axis + axis] * 0.01 for axis in "XYZ"]
    across = [sensitivity[pair] * 0.01 + 250 for pair in ("XY", "XZ", "YZ")]
    possible = all(LEAST_COUNTS <= value <= MOST_COUNTS for value in along + across)
    if not possible or any(abs(value) > FARTHEST_OFFSET for value in offset):
        raise _unusable("makes no sense", path)
    x, y, z = (1.0 / value for value in along)
    xy, xz, yz = (1.0 / value - 0.004 for value in across)
    matrix = ((x, xy, xz), (xy, y, yz), (xz, yz, z))
    return FactoryAcceleration(CALIBRATION, MATRIX, rate, (offset[0], offset[1], offset[2]), matrix)


def _unusable(what: str, path: Path) -> UnreadableError:
    text = f"calibration.json in it, which its counts need, {what}"
    return UnreadableError(text, path=path, hint=READ_AS_COUNTS)


def _number(value: Any) -> float | None:
    """Return a number, from a JSON number or text; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if isfinite(number) else None


def calibrated_counts(raw: Counts, factory: FactoryAcceleration) -> NDArray[np.int32]:
    """Return raw counts (n, 3) as calibrated ones, `FLOAT_LSB_PER_G` in one g."""
    x, y, z = (raw[:, axis] - factory.offset_counts[axis] for axis in range(3))
    rows = [[value * FLOAT_LSB_PER_G for value in row] for row in factory.g_per_count]
    steps = [np.rint(x * row[0] + y * row[1] + z * row[2]) for row in rows]
    return np.stack([value.clip(-MOST_COUNTS, MOST_COUNTS) for value in steps], axis=1).astype(np.int32)


def temperature_of(values: Values | None) -> FactoryTemperature | None:
    """Return how counts of the accelerometer's thermometer become degrees; None if nothing says it.

    Calibrated values are in degrees, as the vendor's reader takes them.
    """
    if values is None or "isCalibrated" not in values:
        return None
    if not is_open(values):
        return FactoryTemperature(TEMPERATURE_CALIBRATION, IN_DEGREES, (0.0, 1.0), (0.0, 1.0))
    names = ("adxlTempLow", "adxlTempHigh", "tempLow", "tempHigh")
    low, high, cold, warm = (_number(values.get(name)) for name in names)
    if values.get("calibrationMethod") != LINE or low is None or high is None or cold is None or warm is None:
        return None
    if low == high or not COLDEST_C <= min(cold, warm) <= max(cold, warm) <= WARMEST_C:
        return None
    return FactoryTemperature(TEMPERATURE_CALIBRATION, LINE, (low, high), (cold, warm))


def temperatures(
    batch: RecordBatch, factory: FactoryTemperature
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return temperatures, (k,) thousandths of a degree C, and where their records begin.

    They are those of the accelerometer's thermometer; readings that are not temperatures are left out.
    """
    found: list[tuple[int, int]] = []
    for number in np.flatnonzero(batch.records.kind == log.TEMPERATURE).tolist():
        data, begins = log.payload(batch, number), int(batch.records.start[number])
        places = range(0, len(data) - READING_BYTES + 1, READING_BYTES)
        for at in [at for at in places if data[at] == ACCELEROMETER][-1:]:
            value = int.from_bytes(data[at + 1 : at + READING_BYTES], "little", signed=True)
            found.append((value, begins))
    counts, starts = np.array(found, np.int64).reshape(-1, 2).T
    (low, high), (cold, warm) = factory.counts, factory.celsius
    celsius = (counts - low) * ((warm - cold) / (high - low)) + cold
    usable = (celsius >= COLDEST_C) & (celsius <= WARMEST_C)
    return np.rint(1000 * celsius[usable]).astype(np.int32), starts[usable]


class Thermometer:
    """Gives samples the last temperature recorded before them, `first_mc` before the first reading."""

    def __init__(self, factory: FactoryTemperature, first_mc: int) -> None:
        self._factory, self._last = factory, first_mc

    def temperatures_of(
        self, batch: RecordBatch, records: Records, rows: NDArray[np.int64]
    ) -> NDArray[np.int32]:
        """Return the temperatures of records with `rows` samples each; batches in file order."""
        found, places = temperatures(batch, self._factory)
        known = np.concatenate((np.array([self._last], np.int32), found))
        self._last = int(known[-1])
        return np.asarray(np.repeat(known[np.searchsorted(places, records.start)], rows))
