"""Reads APDM Opal recordings: HDF5 files of the vendor's own layout, several sensors in one.

Version 5 (Mobility Lab, Opal V2): groups `Sensors/<id>` with `Accelerometer` [m/s2], `Gyroscope`
[rad/s], `Temperature` [C] and `Time` [us since 1970, UTC], settings as attributes of
`Configuration`. Versions 2 to 4: one group a sensor, listed in the attributes `CaseIdList` and
`MonitorLabelList`, with `Calibrated/Accelerometers`, `Calibrated/Gyroscopes` and `Time`.
Source: APDM's published example scripts for these files.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from accelcal_cli.core.clock import MICROSECONDS
from accelcal_cli.core.errors import UnreadableError, UsageError, counted
from accelcal_cli.core.formats import EACH, ReadOptions
from accelcal_cli.core.recording import Device, Recording
from accelcal_cli.core.vocabulary import PER_G, TABLES, normalized
from accelcal_cli.formats._tables.channels import (
    CHANNELS,
    Axes,
    Channel,
    CountScale,
    dps_per_lsb,
    physical_scale,
)
from accelcal_cli.formats._tables.reader import ReadingPlan, header_problems
from accelcal_cli.formats._tables.table import Attributes, Track, readable
from accelcal_cli.formats._tables.times import StampScale, measured_stamps
from accelcal_cli.formats.hdf5.file import (
    H5PY_ERRORS,
    NodeAttributes,
    attributes_of,
    members,
    open_hdf5,
    text_list,
)
from accelcal_cli.formats.hdf5.reader import Hdf5Reader, Hdf5Table, as_track

VERSION_NAMES = ("FileFormatVersion", "File_Format_Version")
OLDEST, OLD, NEW = 2, 4, 5
TIME = "Time"


@dataclass(frozen=True, slots=True)
class OpalLayout:
    """The paths of datasets within the group of a sensor.

    Attributes:
        channels: path and usual unit of each channel (see `CHANNELS`).
    """

    accel: str
    settings: str
    channels: dict[str, tuple[str, str]]


LAYOUTS = {
    OLD: OpalLayout(
        "Calibrated/Accelerometers",
        "",
        {
            "gyro_counts": ("Calibrated/Gyroscopes", "rad/s"),
            "temperature_mc": ("Calibrated/Temperature", "deg C"),
        },
    ),
    NEW: OpalLayout(
        "Accelerometer",
        "Configuration",
        {"gyro_counts": ("Gyroscope", "rad/s"), "temperature_mc": ("Temperature", "deg C")},
    ),
}


@dataclass(frozen=True, slots=True)
class OpalSensor:
    """One sensor of a file: its number, where it was worn, and the group that holds its data."""

    serial: str
    label: str
    group: str

    def __str__(self) -> str:
        return f"{self.serial} ({self.label})" if self.label else self.serial


def is_opal(path: Path) -> bool:
    """Return True if an HDF5 file has an Opal version and sensors."""
    try:
        with open_hdf5(path) as file:
            return bool(_version(file)) and ("Sensors" in file or "CaseIdList" in file.attrs)
    except (UnreadableError, *H5PY_ERRORS):
        return False


def open_recording(path: Path, options: ReadOptions) -> Hdf5Reader:
    """Open one sensor of an Opal file; `options.sensor` is its number or its label.

    Raises:
        UnreadableError: damaged, cut short, of an unsupported version, or without sensors.
        UsageError: several sensors and none chosen, or the chosen one is not there.
    """
    with open_hdf5(path) as file:
        table = Hdf5Table(file, path)
        with table.explaining(), table.guard("description of the recording"):
            layout, sensors = _contents(file, path)
            return Hdf5Reader(_plan(table, _choose(sensors, options.one_sensor, path), layout, options))


def _contents(file: Any, path: Path) -> tuple[OpalLayout, list[OpalSensor]]:
    version = _version(file)
    if version == NEW:
        return LAYOUTS[NEW], _new_sensors(file)
    if version is not None and OLDEST <= version <= OLD:
        return LAYOUTS[OLD], _old_sensors(file)
    what = "is not an APDM Opal file" if version is None else f"is an Opal file of version {version}"
    raise UnreadableError(
        f"{what}; versions {OLDEST} to {NEW} can be read",
        path=path,
        byte_offset=0,
        hint="export it again with the vendor's software, or try --format hdf5",
    )


def _version(file: Any) -> int | None:
    number = NodeAttributes([file]).number(*VERSION_NAMES)
    return None if number is None else int(number)


def _new_sensors(file: Any) -> list[OpalSensor]:
    sensors = []
    for serial, group in members(file["Sensors"]):
        if group is not None and LAYOUTS[NEW].accel in group:
            path = f"Sensors/{serial}"
            label = attributes_of(file, f"{path}/{LAYOUTS[NEW].settings}").text("Label 0", "Label 1")
            sensors.append(OpalSensor(serial, label or "", path))
    return sensors


def _old_sensors(file: Any) -> list[OpalSensor]:
    groups = text_list(file.attrs["CaseIdList"])
    labels = text_list(file.attrs["MonitorLabelList"]) if "MonitorLabelList" in file.attrs else []
    labels += [""] * (len(groups) - len(labels))
    found = zip(groups, labels, strict=False)
    return [
        OpalSensor(group, label, group) for group, label in found if f"{group}/{LAYOUTS[OLD].accel}" in file
    ]


def _choose(sensors: list[OpalSensor], wanted: str | None, path: Path) -> OpalSensor:
    listed = ", ".join(str(item) for item in sensors)
    if not sensors:
        raise UnreadableError(
            "holds no sensor with an accelerometer", path=path, hint="record with the accelerometer enabled"
        )
    if wanted is None and len(sensors) > 1:
        what = f"holds {len(sensors)} sensors: {listed}"
        hint = f"choose one with --sensor, or each in a study with --sensor {EACH}"
        raise UnreadableError(what, path=path, hint=hint, sensors=[item.serial for item in sensors])
    name = (wanted or sensors[0].serial).strip().lower()
    found = [item for item in sensors if name in (item.serial.lower(), item.label.lower())]
    if len(found) != 1:
        what = "no sensor" if not found else "several sensors"
        raise UsageError(f"{what} named {wanted!r}", path=path, hint=f"the file holds {listed}")
    return found[0]


def _plan(table: Hdf5Table, sensor: OpalSensor, layout: OpalLayout, options: ReadOptions) -> ReadingPlan:
    accel_track = _track(table, sensor, layout.accel, 3)
    settings = table.stated(f"{sensor.group}/{layout.settings}")
    stated_hz = options.rate_hz or settings.number("Sample Rate", "SampleRate") or None
    time_track = _track(table, sensor, TIME, 1, accel_track)
    stamps, rate = measured_stamps(table, time_track, StampScale("us"), stated_hz)
    accel = Axes((accel_track,), _scale(table, accel_track, options))
    channels = _channels(table, sensor, layout, accel_track)
    zone = settings.text("Timezone")
    notes = [f"worn at: {sensor.label}"] * bool(sensor.label)
    notes += [f"recorded in the time zone {zone}"] * bool(zone)
    recording = Recording(
        path=table.path,
        format="opal",
        rate_hz=rate,
        lsb_per_g=accel.scale.lsb,
        total_bytes=table.path.stat().st_size,
        device=Device("Opal", readable(sensor.serial), settings.text("Firmware Version", "VersionString1")),
        range_g=_range_g(table, accel_track),
        start_us=stamps.first_us,
        timezone="UTC",
        duration_s=(stamps.last_us - stamps.first_us + (stamps.step_us or 0)) / MICROSECONDS,
        has_temperature="temperature_mc" in channels,
        gyro_dps_per_lsb=dps_per_lsb(channels),
        notes=(*notes, *stamps.pace.notes),
    )
    problems, missing = header_problems(settings), table.missing_bytes()
    return ReadingPlan(recording, accel_track.rows, accel, stamps, channels, problems, missing)


def _track(table: Hdf5Table, sensor: OpalSensor, name: str, width: int, accel: Track | None = None) -> Track:
    """Return a dataset of the sensor with `width` numbers a row, as long as `accel`."""
    full = f"{sensor.group}/{name}"
    node = table.file.get(full)
    track = as_track(f"/{full}", node) if hasattr(node, "shape") else None
    if track is None or track.width != width or (accel is not None and track.rows != accel.rows):
        shape = counted(width, "number")
        raise UnreadableError(
            f"dataset {full} is missing or does not have one row of {shape} for each sample",
            path=table.path,
            hint="export the recording again with the vendor's software",
        )
    return track


def _scale(table: Hdf5Table, track: Track, options: ReadOptions) -> CountScale:
    unit = options.unit or _accel_unit(table.own(track.path))
    if unit not in PER_G:
        raise UnreadableError(
            f"the unit of {track.path} is not known or cannot be counts",
            path=table.path,
            hint=f"give --unit {'|'.join(PER_G)}",
        )
    return physical_scale(unit, track.dtype)


def _accel_unit(attributes: Attributes) -> str | None:
    return TABLES.accelerations.get(normalized(attributes.text("Units") or "m/s2"))


def _channels(table: Hdf5Table, sensor: OpalSensor, layout: OpalLayout, accel: Track) -> dict[str, Channel]:
    found: dict[str, Channel] = {}
    for name, (dataset, usual_unit) in layout.channels.items():
        try:
            track = _track(table, sensor, dataset, CHANNELS[name].width, accel)
        except UnreadableError:
            continue
        unit = table.own(track.path).text("Units") or usual_unit
        channel = CHANNELS[name].find(table, (track,), unit)
        if not isinstance(channel, str):
            found[name] = channel
    return found


def _range_g(table: Hdf5Table, track: Track) -> float | None:
    """Return the smaller of the two limits that the vendor gives [g]."""
    settings = table.own(track.path)
    limits = [settings.number(name) for name in ("Upper Limit", "Lower Limit")]
    unit = PER_G.get(_accel_unit(settings) or "")
    found = [abs(limit) for limit in limits if limit]
    return min(found) / unit if found and unit else None
