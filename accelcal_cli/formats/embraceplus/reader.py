"""An open Avro file of an Empatica EmbracePlus: half an hour of acceleration, and what was beside it.

Counts are whole numbers for x, y and z. What one is in g, `imuParams` says: from schema 6.5.0 on as
`conversionFactor`, before that by the physical range over the digital one (Empatica, "How to access Avro
files with Python", support.empatica.com). Times are microseconds since 1970 in UTC.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.clock import FIRST_US, LAST_US, MICROSECONDS, UniformClock, rate_fraction
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions, agreed_rate
from accelcal_cli.core.recording import (
    LARGEST_LSB_PER_G,
    Channels,
    Chunk,
    Device,
    Problem,
    Reader,
    Recording,
    cut_channels,
)
from accelcal_cli.formats.embraceplus.avro import AGAIN, FirstRecord, read_first

BY_FACTOR = (6, 5, 0)
"""The schema from which on `conversionFactor` is the scale."""

RATES_HZ = (1.0, 10_000.0)
COLDEST, HOTTEST = -273_150, 1_000_000
MOST_COUNTS = (1 << 31) - 1
LONGEST_ZONE_S = 14 * 3600


@dataclass(frozen=True, slots=True)
class Sensor:
    """Three axes of a sensor.

    Attributes:
        counts: (n, 3) int32.
        step: what one count is: in g, or in deg/s.
        largest: physical value that it can measure, None if the file does not say.
        spare: numbers of axes that are longer than others.
    """

    counts: NDArray[np.int32]
    step: float
    largest: float | None
    start_us: int
    rate_hz: float
    spare: int


def part(fields: Any, *names: str) -> dict[str, Any]:
    """A record within a record; empty if it is not there."""
    for name in names:
        fields = fields.get(name) if isinstance(fields, Mapping) else None
    return dict(fields) if isinstance(fields, Mapping) else {}


def number(value: Any) -> float:
    """A number; NaN for all else."""
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if plain and abs(value) < 1e300 else math.nan


def sensor_in(fields: Mapping[str, Any], version: tuple[int, ...]) -> Sensor | None:
    """A sensor's data; None if it has none that can be used."""
    axes = [fields.get(axis) for axis in "xyz"]
    if not all(isinstance(axis, np.ndarray) and axis.dtype == np.int64 for axis in axes):
        return None
    columns: list[NDArray[np.int64]] = [axis for axis in axes if isinstance(axis, np.ndarray)]
    rows = min(map(len, columns))
    if not rows or any(column.min() < -MOST_COUNTS or column.max() > MOST_COUNTS for column in columns):
        return None
    params = part(fields, "imuParams")
    low, high, first, last = (
        number(params.get(name)) for name in ("physicalMin", "physicalMax", "digitalMin", "digitalMax")
    )
    ranged = (high - low) / (last - first) if last > first else math.nan
    factor = number(params.get("conversionFactor"))
    steps = [factor, ranged] if version >= BY_FACTOR else [ranged, factor]
    step = next((value for value in steps if 0 < value < math.inf), math.nan)
    start = number(fields.get("timestampStart"))
    return Sensor(
        np.stack([column[:rows] for column in columns], axis=1).astype(np.int32),
        step,
        min(-low, high) if low < 0 < high else None,
        int(start) if FIRST_US <= start <= LAST_US else 0,
        number(fields.get("samplingFrequency")),
        max(map(len, columns)) - rows,
    )


def temperature_of(fields: Mapping[str, Any], sensor: Sensor, rate_hz: float) -> NDArray[np.int32] | None:
    """Of each row the last value measured, (n,) thousandths of a degree C; None if there is none."""
    values, rate, start = (
        fields.get("values"),
        *(number(fields.get(key)) for key in ("samplingFrequency", "timestampStart")),
    )
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f" or not 0 < rate <= RATES_HZ[1]:
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        milli = np.rint(values.astype(np.float64) * 1000)
        known = np.flatnonzero((milli >= COLDEST) & (milli <= HOTTEST))
    if not len(known) or not abs(start - sensor.start_us) < 3600 * MICROSECONDS:
        return None
    after_s = np.arange(len(sensor.counts)) / rate_hz + (sensor.start_us - start) / MICROSECONDS
    place = np.floor(after_s * rate + 1e-6).astype(np.int64)
    latest = np.maximum(np.searchsorted(known, place, side="right") - 1, 0)
    return np.asarray(milli[known[latest]].astype(np.int32))


class EmbracePlusReader(Reader):
    """Gives the rows of a file, which are all in memory: no more than LARGEST_BYTES can claim."""

    def __init__(
        self,
        recording: Recording,
        counts: NDArray[np.int32],
        channels: Channels,
        problems: tuple[Problem, ...],
    ) -> None:
        self.recording = recording
        self._counts = counts
        self._channels = channels
        self._problems = problems

    def chunks(self, chunk_samples: int) -> Iterator[Chunk]:
        """Yield all rows in order, at most `chunk_samples` at a time."""
        about, rows = self.recording, len(self._counts)
        edges = [*range(0, rows, chunk_samples), rows]
        rate = rate_fraction(about.rate_hz)
        for start, stop in pairwise(edges):
            first, end = (about.total_bytes * row // rows for row in (start, stop))
            yield Chunk(
                start,
                self._counts[start:stop],
                UniformClock(about.start_us or 0, start, rate),
                end,
                problems=() if start else self._problems,
                used_bytes=end - first,
                **cut_channels(self._channels, slice(start, stop)),
            )


def open_recording(path: Path, options: ReadOptions) -> Reader:
    """Open a file of an EmbracePlus.

    Raises:
        UnreadableError: it is damaged, or holds no acceleration that can be used.
        UsageError: --rate contradicts it.
    """
    record = read_first(path)
    fields = record.fields
    version = schema_version(fields)
    accel = sensor_in(part(fields, "rawData", "accelerometer"), version)
    if accel is None:
        raise UnreadableError("holds no acceleration", path=path, hint=AGAIN)
    if not 1 <= 1 / accel.step <= LARGEST_LSB_PER_G:
        what = "does not say how many counts make one g"
        raise UnreadableError(what, path=path, hint="its imuParams are damaged; download it again")
    rate_hz = accel.rate_hz if RATES_HZ[0] <= accel.rate_hz <= RATES_HZ[1] else options.rate_hz
    if rate_hz is None:
        what = "does not state its sampling rate"
        raise UnreadableError(what, path=path, hint="give it with --rate (an EmbracePlus samples at 64 Hz)")
    rate_hz = agreed_rate(options, rate_hz, path)
    channels, gyro_step, notes = channels_of(fields, accel, rate_hz, version)
    about = Recording(
        path=path,
        format="embraceplus",
        rate_hz=rate_hz,
        lsb_per_g=1 / accel.step,
        total_bytes=path.stat().st_size,
        device=device_of(fields),
        range_g=accel.largest,
        start_us=accel.start_us or None,
        timezone="UTC" if accel.start_us else None,
        samples=len(accel.counts),
        duration_s=len(accel.counts) / rate_hz,
        has_temperature="temperature_mc" in channels,
        gyro_dps_per_lsb=None if gyro_step is None else (gyro_step,) * 3,
        notes=(*zone_note(fields), *notes),
    )
    return EmbracePlusReader(about, accel.counts, channels, tuple(problems_of(record, accel)))


def schema_version(fields: Mapping[str, Any]) -> tuple[int, ...]:
    """Such as (6, 5, 0)."""
    version = part(fields, "schemaVersion")
    return tuple(
        value if isinstance(value := version.get(name), int) else 0 for name in ("major", "minor", "patch")
    )


def device_of(fields: Mapping[str, Any]) -> Device:
    """Serial number and firmware."""
    serial, version = fields.get("deviceSn"), part(fields, "fwVersion")
    numbers = [version.get(name) for name in ("major", "minor", "patch")]
    firmware = ".".join(map(str, numbers)) if all(isinstance(item, int) for item in numbers) else None
    return Device("EmbracePlus", serial if isinstance(serial, str) and serial else None, firmware)


def zone_note(fields: Mapping[str, Any]) -> tuple[str, ...]:
    """Where the wearer was; the times are UTC all the same."""
    ahead = fields.get("timezone")
    if not isinstance(ahead, int) or abs(ahead) > LONGEST_ZONE_S:
        return ()
    hours, minutes = divmod(abs(ahead) // 60, 60)
    return (f"the wearer's clock was UTC{'-' if ahead < 0 else '+'}{hours:02d}:{minutes:02d}; times are UTC",)


def channels_of(
    fields: Mapping[str, Any], accel: Sensor, rate_hz: float, version: tuple[int, ...]
) -> tuple[Channels, float | None, tuple[str, ...]]:
    """Gyroscope and temperature, deg/s in one count, and why a gyroscope is not used."""
    channels: Channels = {}
    gyro = sensor_in(part(fields, "rawData", "gyroscope"), version)
    step: float | None = None
    notes: tuple[str, ...] = ()
    if gyro is not None:
        apart_us = abs(gyro.start_us - accel.start_us)
        if len(gyro.counts) == len(accel.counts) and gyro.step > 0 and apart_us * rate_hz <= MICROSECONDS / 2:
            channels["gyro_counts"], step = gyro.counts, gyro.step
        else:
            notes = ("the gyroscope is not used: its samples are not those of the accelerometer",)
    temperature = temperature_of(part(fields, "rawData", "temperature"), accel, rate_hz)
    if temperature is not None:
        channels["temperature_mc"] = temperature
    return channels, step, notes


def problems_of(record: FirstRecord, accel: Sensor) -> Iterator[Problem]:
    """What is wrong with the file."""
    rows = len(accel.counts)
    if not accel.start_us:
        yield Problem("no_start_time", "it has no start time; times count from 1970-01-01", None, 0)
    if accel.spare:
        text = f"x, y and z are not equally long; {accel.spare} values of the longest are left out"
        yield Problem("truncated", text, None, rows, accel.spare)
    if not record.marked:
        text = "the marker behind the data is wrong or missing: some values may not be what was written"
        yield Problem("checksum", text, record.end, rows)
    if record.more:
        yield Problem(
            "bad_page", "more follows the first record, which is all that is read", record.end, rows
        )
