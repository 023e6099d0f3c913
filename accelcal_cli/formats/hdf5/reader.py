"""Opening HDF5 files of laboratories: what their datasets and attributes say (docs/hdf5-files.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import FLOAT_LSB_PER_G, Device, Recording
from accelcal_cli.formats.hdf5.datasets import all_tracks, chosen_axes, find_accel
from accelcal_cli.formats.hdf5.description import (
    Extras,
    Source,
    Timeline,
    checked_rate,
    find_extras,
    find_timeline,
    header_problems,
    known_zone,
    spread_rows,
    whole_rows_known,
)
from accelcal_cli.formats.hdf5.file import (
    Attributes,
    attributes_of,
    explaining,
    h5py_guard,
    missing_bytes,
    open_hdf5,
)
from accelcal_cli.formats.hdf5.stream import Axes, Hdf5Reader, Plan
from accelcal_cli.formats.hdf5.units import LARGEST_G, PER_G, Scale, accel_unit, count_scale, physical_scale

LSB_NAMES = ("lsb_per_g", "counts_per_g", "count_per_g", "lsbs_per_g", "sensitivity_lsb_per_g")
RANGE_NAMES = ("range_g", "accel_range_g", "full_scale_g", "dynamic_range_g")
SERIAL_NAMES = ("serial", "serial_number", "device_serial", "device_id", "sensor_id")
MODEL_NAMES = ("model", "device_model", "device", "device_type", "sensor_model")
FIRMWARE_NAMES = ("firmware", "firmware_version", "device_firmware")
ZONE_NAMES = ("timezone", "time_zone", "tz")


def open_recording(path: Path, options: ReadOptions) -> Hdf5Reader:
    """Open an HDF5 file whose acceleration is an (n, 3) dataset or three of length n.

    Raises:
        UnreadableError: damaged, cut short, or nothing in it is known as acceleration.
        UsageError: several datasets fit, or the rate, unit or counts per g are nowhere told.
    """
    with open_hdf5(path) as file, h5py_guard(path, "list of datasets"):
        tracks, damaged = all_tracks(file)
        missing = missing_bytes(file, path)
        with explaining(path, missing, damaged), h5py_guard(path, "description of the recording"):
            if options.columns is not None:
                group = chosen_axes(tracks, options.columns, path)
            else:
                group = find_accel(tracks, path, options.sensor)
            attributes = attributes_of(file, group[0].path)
            return Hdf5Reader(_plan(Source(file, path, options, tracks, group, attributes, damaged)))


def _plan(source: Source) -> Plan:
    timeline = find_timeline(source)
    rate = checked_rate(timeline.rate_hz, source.path)
    accel = Axes(source.group, _scale(source))
    extras = find_extras(source)
    rows = source.accel.rows
    return Plan(
        recording=_recording(source, timeline, rate, accel, extras),
        rows=rows,
        accel=accel,
        stamps=timeline.stamps,
        gyro=extras.gyro,
        temperature=extras.temperature,
        problems=timeline.problems + header_problems(source.attributes, source.damaged),
        missing_bytes=missing_bytes(source.file, source.path),
    )


def _recording(source: Source, timeline: Timeline, rate: float, accel: Axes, extras: Extras) -> Recording:
    told = source.attributes
    rows = source.accel.rows
    zone, zone_notes = _zone(source, timeline)
    known = whole_rows_known(accel, timeline.stamps, extras.gyro)
    return Recording(
        path=source.path,
        format="hdf5",
        rate_hz=rate,
        lsb_per_g=accel.scale.lsb,
        total_bytes=source.path.stat().st_size,
        device=Device(told.text(*MODEL_NAMES), told.text(*SERIAL_NAMES), told.text(*FIRMWARE_NAMES)),
        range_g=_range(told),
        start_us=timeline.start_us,
        timezone=zone,
        samples=rows if known else None,
        duration_s=rows / rate if timeline.duration_s is None else timeline.duration_s,
        has_temperature=extras.temperature is not None,
        gyro_dps_per_lsb=None if extras.gyro is None else extras.gyro.dps_per_lsb,
        notes=timeline.notes + extras.notes + zone_notes,
    )


def _range(told: Attributes) -> float | None:
    value = told.number(*RANGE_NAMES)
    return value if value is not None and 0 < value <= 1000 else None


def _zone(source: Source, timeline: Timeline) -> tuple[str | None, tuple[str, ...]]:
    """The zone of the times; a start with an offset from UTC outweighs any name."""
    if timeline.is_utc:
        return "UTC", ()
    if source.options.timezone is not None:
        return source.options.timezone, ()
    name = source.attributes.text(*ZONE_NAMES)
    zone = known_zone(name)
    if name is not None and zone is None:
        return None, (f"the time zone {name!r} is not known: times are taken as local times",)
    return zone, ()


def _scale(source: Source) -> Scale:
    """Counts or physical units: what the user says outweighs the attributes."""
    unit, lsb = _unit_and_lsb(source)
    dtype = np.result_type(*(item.dtype for item in source.group))
    if unit == "counts":
        return _count_scale(source, _checked_lsb(lsb, source.path), dtype)
    return physical_scale(unit, dtype)


def _unit_and_lsb(source: Source) -> tuple[str, float | None]:
    options = source.options
    told_unit, told_lsb = _told_alike(source)
    lsb = told_lsb if options.lsb_per_g is None else options.lsb_per_g
    if options.unit is not None:
        return options.unit, lsb
    whole = all(item.dtype.kind in "iu" for item in source.group)
    if lsb is not None and (whole or told_unit is None):
        return "counts", lsb
    unit = "counts" if told_unit is None and whole else accel_unit(told_unit or "")
    if unit is not None:
        return unit, lsb
    said = f"the unit {told_unit!r} is not known" if told_unit else "the file does not tell the unit"
    raise UnreadableError(
        f"{said} of {source.accel.path}", path=source.path, hint=f"give --unit {'|'.join(PER_G)}|counts"
    )


def _told_alike(source: Source) -> tuple[str | None, float | None]:
    """Unit and counts per g in the attributes of the axes, which must not contradict each other."""
    told = [attributes_of(source.file, item.path) for item in source.group]
    units = {found.text("units", "unit") for found in told} - {None}
    scales = {found.number(*LSB_NAMES) for found in told} - {None}
    if len(units) > 1 or len(scales) > 1:
        raise UnreadableError(
            "the axes have different units or counts per g", path=source.path, hint="give them one scale"
        )
    return next(iter(units), None), next(iter(scales), None)


def _checked_lsb(lsb: float | None, path: Path) -> float:
    if lsb is None:
        raise UnreadableError("the file does not tell the counts per g", path=path, hint="give --lsb-per-g N")
    if not 0 < lsb <= FLOAT_LSB_PER_G * LARGEST_G:
        raise UnreadableError(f"{lsb:g} counts per g cannot be right", path=path, hint="give --lsb-per-g N")
    return lsb


def _count_scale(source: Source, lsb: float, dtype: np.dtype[Any]) -> Scale:
    """Counts as they are; those with decimal fractions (averages) on the grid of fractions."""
    if dtype.kind == "f":
        for item in source.group:
            seen = spread_rows(source.file, item, source.path)
            seen = seen[np.isfinite(seen)]
            if np.any(seen != np.rint(seen)):
                return Scale(FLOAT_LSB_PER_G, lsb, LARGEST_G)
    return count_scale(lsb, dtype)
