"""What to read of a table: where and in which unit its acceleration is, its times, and what else it says.

The names that are understood are listed in docs/hdf5-files.md and docs/tables.md.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core import recording as recordings
from accelcal_cli.core.errors import UnreadableError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Device, Recording
from accelcal_cli.core.vocabulary import ACCELERATION, PER_G
from accelcal_cli.formats._gravity import guess_unit, likely_counts, usual_length
from accelcal_cli.formats._tables import description, units
from accelcal_cli.formats._tables.attributes import Attributes, readable
from accelcal_cli.formats._tables.channels import Axes, Channel, dps_per_lsb, find_channels
from accelcal_cli.formats._tables.description import Plan, Source, Timeline
from accelcal_cli.formats._tables.table import Table
from accelcal_cli.formats._tables.tracks import Track, chosen_axes, find_accel, split_unit
from accelcal_cli.formats._tables.units import Scale

LEAST_LSB = 1e-9
LSB_NAMES = ("lsb_per_g", "counts_per_g", "count_per_g", "lsbs_per_g", "sensitivity_lsb_per_g")
RANGE_NAMES = ("range_g", "accel_range_g", "full_scale_g", "dynamic_range_g")
SERIAL_NAMES = ("serial", "serial_number", "device_serial", "device_id", "sensor_id")
MODEL_NAMES = ("model", "device_model", "device", "device_type", "sensor_model")
FIRMWARE_NAMES = ("firmware", "firmware_version", "device_firmware")
ZONE_NAMES = ("timezone", "time_zone", "tz")


def source_of(table: Table, tracks: tuple[Track, ...], options: ReadOptions, damaged: int = 0) -> Source:
    """Where the acceleration of a table is, and what is stated of it.

    Raises:
        UnreadableError: nothing is known as acceleration, or several things are.
        UsageError: an option names nothing.
    """
    if options.columns is not None:
        group = chosen_axes(tracks, options.columns, table)
    else:
        group = find_accel(tracks, table, options.sensor)
    return Source(table, options, tracks, group, table.stated(group[0].path), damaged)


def plan_of(source: Source, format_name: str) -> Plan:
    """What to read of a table, and how.

    Raises:
        UnreadableError: its times make no sense, or no unit, rate or scale fits or is stated.
        UsageError: an option names nothing.
    """
    timeline = description.find_timeline(source)
    rate = description.checked_rate(timeline.rate_hz, source.path)
    scale, scale_notes = _scale(source)
    accel = Axes(source.group, scale)
    channels, notes = find_channels(source.table, source.tracks, source.accel, source.options)
    recording = _recording(source, format_name, timeline, rate, accel, channels)
    return Plan(
        recording=replace(recording, notes=timeline.notes + scale_notes + notes + recording.notes),
        rows=source.accel.rows,
        accel=accel,
        stamps=timeline.stamps,
        channels=channels,
        problems=timeline.problems + description.header_problems(source.attributes, source.damaged),
        missing_bytes=source.table.missing_bytes(),
    )


def _recording(
    source: Source, name: str, timeline: Timeline, rate: float, accel: Axes, channels: dict[str, Channel]
) -> Recording:
    attributes = source.attributes
    rows = source.accel.rows
    zone, zone_notes = _zone(source, timeline)
    axes = [item for item in (accel, *channels.values()) if isinstance(item, Axes)]
    known = timeline.stamps is None and all(item.scale.exact is not None for item in axes)
    return Recording(
        path=source.path,
        format=name,
        rate_hz=rate,
        lsb_per_g=accel.scale.lsb,
        total_bytes=source.path.stat().st_size,
        device=Device(
            attributes.text(*MODEL_NAMES), attributes.text(*SERIAL_NAMES), attributes.text(*FIRMWARE_NAMES)
        ),
        range_g=_range(attributes),
        start_us=timeline.start_us,
        timezone=zone,
        has_offsets=timeline.has_offsets,
        stamped=timeline.stamps is not None and not timeline.stamps.scale.base_us,
        samples=rows if known else None,
        duration_s=rows / rate if timeline.duration_s is None else timeline.duration_s,
        has_temperature="temperature_mc" in channels,
        gyro_dps_per_lsb=dps_per_lsb(channels),
        notes=zone_notes,
    )


def _range(attributes: Attributes) -> float | None:
    value = attributes.number(*RANGE_NAMES)
    return value if value is not None and 0 < value <= 1000 else None


def _zone(source: Source, timeline: Timeline) -> tuple[str | None, tuple[str, ...]]:
    """The zone that the file states; times that are UTC for certain outweigh any name."""
    name = source.attributes.text(*ZONE_NAMES)
    zone = description.known_zone(name)
    if timeline.is_utc:
        place = name if zone is None else zone
        return "UTC", () if place in (None, "UTC") else (
            f"its times are UTC; it names the time zone {place}",
        )
    return zone, () if name is None or zone else (f"its time zone {name!r} is not known and was not used",)


def _scale(source: Source) -> tuple[Scale, tuple[str, ...]]:
    """Counts or physical units, and a note where gravity decided: what the user says outweighs the rest."""
    unit, lsb = _unit_and_lsb(source)
    notes: tuple[str, ...] = ()
    if unit is None:
        unit = guess_unit(_some_values(source), source.path)
        notes = (f"unit: {unit} (judged by the length of gravity)",)
    dtype = np.result_type(*(item.dtype for item in source.group))
    if unit == "counts":
        return _count_scale(source, _checked_lsb(lsb, source), dtype), notes
    return units.physical_scale(unit, dtype), notes


def _some_values(source: Source) -> NDArray[np.float64]:
    """Values (n, 3) from all over the table."""
    with np.errstate(over="ignore", invalid="ignore"):
        parts = [description.spread_rows(source.table, item).astype(np.float64) for item in source.group]
    rows = min(map(len, parts))
    return np.concatenate([part[:rows] for part in parts], axis=1)


def _unit_and_lsb(source: Source) -> tuple[str | None, float | None]:
    """Unit (None: gravity has to tell) and counts per g."""
    options = source.options
    file_unit, file_lsb = _shared_unit_and_lsb(source)
    lsb = file_lsb if options.lsb_per_g is None else options.lsb_per_g
    if options.unit is not None:
        return options.unit, lsb
    whole = all(item.dtype.kind in "iu" for item in source.group)
    if lsb is not None and (whole or file_unit is None):
        return "counts", lsb
    if file_unit is None:
        return "counts" if whole else None, lsb
    if (unit := ACCELERATION.find_in_table(file_unit)) is not None:
        return unit, lsb
    raise UnreadableError(
        f"the unit {file_unit!r} of {readable(source.accel.path)} is not known",
        path=source.path,
        hint=f"give --unit {'|'.join(PER_G)}|counts",
    )


def _shared_unit_and_lsb(source: Source) -> tuple[str | None, float | None]:
    """Unit and counts per g in the attributes of the axes, which must not contradict each other."""
    attributes = [source.table.stated(item.path) for item in source.group]
    stated = {found.text("units", "unit") for found in attributes} - {None}
    units = stated or {split_unit(item.name)[1] for item in source.group} - {None}
    scales = {found.number(*LSB_NAMES) for found in attributes} - {None}
    if len(units) > 1 or len(scales) > 1:
        raise UnreadableError(
            "the axes have different units or counts per g", path=source.path, hint="give them one scale"
        )
    return next(iter(units), None), next(iter(scales), None)


def _checked_lsb(lsb: float | None, source: Source) -> float:
    path = source.path
    if lsb is None:
        likely = likely_counts(usual_length(_some_values(source)))
        raise UnreadableError(
            "the file does not state the counts per g",
            path=path,
            hint=f"give --lsb-per-g N{likely}, or --unit if its whole numbers are in {'|'.join(PER_G)}",
        )
    if not LEAST_LSB <= lsb <= recordings.FLOAT_LSB_PER_G * units.LARGEST_G:
        raise UnreadableError(f"{lsb:g} counts per g cannot be right", path=path, hint="give --lsb-per-g N")
    return lsb


def _count_scale(source: Source, lsb: float, dtype: np.dtype[Any]) -> Scale:
    """Counts as they are; those with decimal fractions (averages) on the grid of fractions."""
    if dtype.kind == "f":
        for item in source.group:
            seen = description.spread_rows(source.table, item)
            seen = seen[np.isfinite(seen)]
            if np.any(seen != np.rint(seen)):
                return Scale(recordings.FLOAT_LSB_PER_G, lsb, units.LARGEST_G)
    return units.count_scale(lsb, dtype)
