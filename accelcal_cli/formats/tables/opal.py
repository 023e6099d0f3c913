"""Reads APDM Opal recordings: HDF5 files of the vendor's own layout, several sensors in one.

Version 5 (Mobility Lab, Opal V2): groups `Sensors/<id>` with `Accelerometer` [m/s2], `Gyroscope`
[rad/s], `Temperature` [C] and `Time` [us since 1970, UTC], settings as attributes of
`Configuration`. Versions 2 to 4: one group a sensor, listed in the attributes `CaseIdList` and
`MonitorLabelList`, with `Calibrated/Accelerometers`, `Calibrated/Gyroscopes` and `Time`.
Source: APDM's published example scripts for these files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, repeat
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from accelcal_cli.core.errors import UnreadableError, UsageError, counted
from accelcal_cli.core.formats import EACH, ReadOptions
from accelcal_cli.core.recording import Device
from accelcal_cli.core.vocabulary import PER_G, acceleration_unit
from accelcal_cli.formats.tables.hdf5 import (
    H5PY_ERRORS,
    Hdf5Source,
    NodeAttributes,
    as_track,
    attributes_of,
    members,
    open_hdf5,
)
from accelcal_cli.formats.tables.header import Column, Stated, plain_value, readable
from accelcal_cli.formats.tables.names import name_of
from accelcal_cli.formats.tables.reader import TableReader, open_table
from accelcal_cli.formats.tables.tracks import TEXT, Track, header_problems

VERSION_NAMES = ("FileFormatVersion", "File_Format_Version")
OLDEST, OLD, NEW = 2, 4, 5
TIME = "Time"
ACCELERATION_UNIT, TURN_UNIT, HEAT_UNIT = "m/s2", "rad/s", "deg C"
"""Units where the file states none."""


class OpalLayout(NamedTuple):
    """The paths of datasets, and of the settings, within the group of a sensor."""

    accel: str
    gyro: str
    temperature: str
    settings: str


LAYOUTS = {
    OLD: OpalLayout("Calibrated/Accelerometers", "Calibrated/Gyroscopes", "Calibrated/Temperature", ""),
    NEW: OpalLayout("Accelerometer", "Gyroscope", "Temperature", "Configuration"),
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


def open_recording(path: Path, options: ReadOptions) -> TableReader:
    """Open one sensor of an Opal file; `options.sensor` is its number or its label.

    Raises:
        UnreadableError: damaged, cut short, of an unsupported version, or without sensors.
        UsageError: several sensors and none chosen, or the chosen one is not there.
    """
    return open_table(OpalSource(path, options.one_sensor), replace(options, sensor=None))


class OpalSource(Hdf5Source):
    """One sensor of an Opal file.

    Args:
        wanted: its number or its label; None for the only one.
    """

    format = "opal"

    def __init__(self, path: Path, wanted: str | None) -> None:
        self._wanted = wanted
        super().__init__(path)
        usual = (ACCELERATION_UNIT, "us", TURN_UNIT, HEAT_UNIT)
        by_path = dict(zip(self._paths, usual, strict=True))
        units = [
            one.unit or by_path[f"/{one.path}"] for one in self.columns
        ]  # the usual one if none is stated
        self.columns = tuple(
            replace(one, unit=unit, name=name_of(one.name.text, unit))
            for one, unit in zip(self.columns, units, strict=True)
        )
        gyro = tuple(one.number for one in self.columns if f"/{one.path}" == self._paths[2])
        self.stated = Stated(xyz=(0,), time=1, gyro=gyro or None)

    def _found(self, file: Any, path: Path) -> tuple[list[Track], list[str], int]:
        """Return the acceleration, the times, and what else the sensor has for each sample."""
        self._layout = _layout(file, path)
        self._sensor = _choose(_sensors(file, self._layout), self._wanted, path)
        names = (self._layout.accel, TIME, self._layout.gyro, self._layout.temperature)
        self._paths = [f"/{self._sensor.group}/{name}" for name in names]
        found, rows = [], None
        for name, width, needed in zip(self._paths, (3, 1, 3, 1), (True, True, False, False), strict=True):
            node = file.get(name)
            track = as_track(name, node) if isinstance(node, h5py.Dataset) else None
            fits = track is not None and track.dtype != TEXT and track.width == width
            if track is not None and fits and rows in (None, track.rows):
                rows = track.rows
                found.append(replace(track, is_moment=True, unit="us") if name == self._paths[1] else track)
            elif needed:
                shape = counted(width, "number")
                what = f"column {name} is missing or does not have one row of {shape} for each sample"
                hint = "export the recording again with the vendor's software"
                raise UnreadableError(what, path=path, hint=hint)
        return found, [], 0

    def settle(self, xyz: Sequence[Column], gyro: Sequence[Column], options: ReadOptions) -> None:
        """See `Source`."""
        with self.explaining(), self.opened():
            settings = attributes_of(self.file, f"{self._sensor.group}/{self._layout.settings}")
            zone, label = settings.text("Timezone"), self._sensor.label
            notes = [f"worn at: {label}"] * bool(label) + [f"recorded in the time zone {zone}"] * bool(zone)
            firmware = settings.text("Firmware Version", "VersionString1")
            accel = self.own(self._paths[0])
            unit = PER_G.get(acceleration_unit(accel.text("Units") or ACCELERATION_UNIT) or "")
            limits = [abs(limit) for name in ("Upper Limit", "Lower Limit") if (limit := accel.number(name))]
            self.stated = Stated(
                device=Device("Opal", readable(self._sensor.serial), firmware),
                rate_hz=settings.number("Sample Rate", "SampleRate") or None,
                range_g=min(limits) / unit if limits and unit else None,
                timezone="UTC",
                notes=tuple(notes),
            )
            self.rows, self.problems = xyz[0].rows, header_problems(settings)


def _version(file: Any) -> int | None:
    number = NodeAttributes(file, ["/"]).number(*VERSION_NAMES)
    return None if number is None else int(number)


def _layout(file: Any, path: Path) -> OpalLayout:
    version = _version(file)
    if version is not None and OLDEST <= version <= NEW:
        return LAYOUTS[max(version, OLD)]
    what = "is not an APDM Opal file" if version is None else f"is an Opal file of version {version}"
    what += f"; versions {OLDEST} to {NEW} can be read"
    hint = "export it again with the vendor's software, or try --format hdf5"
    raise UnreadableError(what, path=path, byte_offset=0, hint=hint)


def _sensors(file: Any, layout: OpalLayout) -> list[OpalSensor]:
    """Return the sensors that have an accelerometer."""
    if layout == LAYOUTS[NEW]:
        serials = [serial for serial, group in members(file["Sensors"]) if group is not None]
        groups = [f"Sensors/{serial}" for serial in serials]
        settings = [attributes_of(file, f"{group}/{layout.settings}") for group in groups]
        labels = [known.text("Label 0", "Label 1") or "" for known in settings]
    else:
        lists = (file.attrs.get(name, ()) for name in ("CaseIdList", "MonitorLabelList"))
        items = (np.atleast_1d(np.asarray(values, dtype=object)) for values in lists)
        serials, labels = ([str(plain_value(one) or "") for one in some] for some in items)
        groups = serials
    found = map(OpalSensor, serials, chain(labels, repeat("")), groups)
    return [sensor for sensor in found if f"{sensor.group}/{layout.accel}" in file]


def _choose(sensors: list[OpalSensor], wanted: str | None, path: Path) -> OpalSensor:
    listed = ", ".join(str(item) for item in sensors)
    if not sensors:
        hint = "record with the accelerometer enabled"
        raise UnreadableError("holds no sensor with an accelerometer", path=path, hint=hint)
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
