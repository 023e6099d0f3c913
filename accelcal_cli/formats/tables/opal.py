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
from accelcal_cli.formats.tables.hdf5 import Hdf5Source, as_track
from accelcal_cli.formats.tables.hdf5_file import (
    H5PY_ERRORS,
    NodeAttributes,
    attributes_of,
    members,
    open_hdf5,
)
from accelcal_cli.formats.tables.header import Attributes, Column, Stated, plain_value, readable
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
        self.columns = tuple(_in_unit(one, by_path[f"/{one.path}"]) for one in self.columns)
        gyro = tuple(one.number for one in self.columns if f"/{one.path}" == self._paths[2])
        self.stated = Stated(xyz=(0,), time=1, gyro=gyro or None)

    def _found(self, file: Any, path: Path) -> tuple[list[Track], list[str], int]:
        """Return the acceleration, the times, and what else the sensor has for each sample."""
        self._layout = _layout(file, path)
        self._sensor = _choose(_sensors(file, self._layout), self._wanted, path)
        names = (self._layout.accel, TIME, self._layout.gyro, self._layout.temperature)
        self._paths = [f"/{self._sensor.group}/{name}" for name in names]
        found = [_track(file, one, width) for one, width in zip(self._paths, (3, 1, 3, 1), strict=True)]
        accel, time = found[:2]
        for name, width, track in zip(self._paths, (3, 1), found, strict=False):
            if track is None or accel is None or track.rows != accel.rows:
                shape = counted(width, "number")
                raise UnreadableError(
                    f"column {name} is missing or does not have one row of {shape} for each sample",
                    path=path,
                    hint="export the recording again with the vendor's software",
                )
        found[1] = time and replace(time, is_moment=True, unit="us")
        return [one for one in found if one and accel and one.rows == accel.rows], [], 0

    def settle(self, xyz: Sequence[Column], gyro: Sequence[Column], options: ReadOptions) -> None:
        """See `Source`."""
        with self.explaining(), self.opened():
            settings = attributes_of(self.file, f"{self._sensor.group}/{self._layout.settings}")
            zone, label = settings.text("Timezone"), self._sensor.label
            notes = [f"worn at: {label}"] * bool(label) + [f"recorded in the time zone {zone}"] * bool(zone)
            firmware = settings.text("Firmware Version", "VersionString1")
            self.stated = Stated(
                device=Device("Opal", readable(self._sensor.serial), firmware),
                rate_hz=settings.number("Sample Rate", "SampleRate") or None,
                range_g=_range_g(self.own(self._paths[0])),
                timezone="UTC",
                notes=tuple(notes),
            )
            self.rows, self.problems = xyz[0].rows, header_problems(settings)


def _in_unit(column: Column, unit: str) -> Column:
    """Return a column in its usual unit if none is stated of it."""
    return column if column.unit else replace(column, unit=unit, name=name_of(column.name.text, unit))


def _version(file: Any) -> int | None:
    number = NodeAttributes(file, ["/"]).number(*VERSION_NAMES)
    return None if number is None else int(number)


def _layout(file: Any, path: Path) -> OpalLayout:
    version = _version(file)
    if version is not None and OLDEST <= version <= NEW:
        return LAYOUTS[max(version, OLD)]
    what = "is not an APDM Opal file" if version is None else f"is an Opal file of version {version}"
    raise UnreadableError(
        f"{what}; versions {OLDEST} to {NEW} can be read",
        path=path,
        byte_offset=0,
        hint="export it again with the vendor's software, or try --format hdf5",
    )


def _sensors(file: Any, layout: OpalLayout) -> list[OpalSensor]:
    """Return the sensors that have an accelerometer."""
    if layout == LAYOUTS[NEW]:
        serials = [serial for serial, group in members(file["Sensors"]) if group is not None]
        groups = [f"Sensors/{serial}" for serial in serials]
        settings = [attributes_of(file, f"{group}/{layout.settings}") for group in groups]
        labels = [known.text("Label 0", "Label 1") or "" for known in settings]
    else:
        serials, labels = (_texts(file.attrs.get(name, ())) for name in ("CaseIdList", "MonitorLabelList"))
        groups = serials
    found = map(OpalSensor, serials, chain(labels, repeat("")), groups)
    return [sensor for sensor in found if f"{sensor.group}/{layout.accel}" in file]


def _texts(values: object) -> list[str]:
    """Return the texts of a list attribute, each without padding."""
    return [str(plain_value(item) or "") for item in np.atleast_1d(np.asarray(values, dtype=object))]


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


def _track(file: Any, path: str, width: int) -> Track | None:
    """Return a dataset with `width` numbers a row; None if there is none."""
    node = file.get(path)
    track = as_track(path, node) if isinstance(node, h5py.Dataset) else None
    return track if track is not None and track.dtype != TEXT and track.width == width else None


def _range_g(accel: Attributes) -> float | None:
    """Return the smaller of the two limits that the vendor gives [g]."""
    unit = PER_G.get(acceleration_unit(accel.text("Units") or ACCELERATION_UNIT) or "")
    found = [abs(limit) for name in ("Upper Limit", "Lower Limit") if (limit := accel.number(name))]
    return min(found) / unit if found and unit else None
