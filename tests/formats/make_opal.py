"""Writes small APDM Opal files with h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from accelcal_cli.core.formats import ReadOptions
from tests.formats.expected import Expected
from tests.formats.make_hdf5 import even_times

GRAVITY = 9.80665
GRID = 1 << 24


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    """A version 5 file of two sensors in m/s2; the second is the recording."""
    path = folder / "made.h5"
    grid = np.rint(counts / lsb_per_g * GRID) / GRID
    times = even_times(len(counts), rate_hz)
    with h5py.File(path, "w") as file:
        file.attrs["FileFormatVersion"] = np.uint32(5)
        add_sensor(file, ("XI-000001", "Lumbar"), -grid, times, rate_hz)
        add_sensor(file, ("XI-000002", "Left Wrist"), grid, times, rate_hz)
    return Expected(path, grid, rate_hz, times, 0, "XI-000002", ReadOptions(sensor="left wrist"))


def add_sensor(
    file: Any, name: tuple[str, str], values_g: np.ndarray, times: np.ndarray, rate_hz: float
) -> Any:
    """One sensor as version 5 lays it out; one HDF5 chunk a column, as the vendor does."""
    serial, label = name
    group = file.create_group(f"Sensors/{serial}")
    settings = group.create_group("Configuration").attrs
    settings["Sample Rate"] = np.uint32(rate_hz)
    settings["Label 0"] = np.bytes_(label)
    settings["Timezone"] = np.bytes_("America/New_York")
    settings["Firmware Version"] = np.bytes_("V2-TEST")
    packed: dict[str, Any] = {"compression": "gzip", "chunks": (100, 1)}
    accel = group.create_dataset("Accelerometer", data=values_g * GRAVITY, **packed)
    accel.attrs.update({"Units": np.bytes_("m/s^2"), "Upper Limit": 160.0, "Lower Limit": -160.0})
    gyro = group.create_dataset("Gyroscope", data=np.deg2rad(values_g), **packed)
    gyro.attrs["Units"] = np.bytes_("rad/s")
    warm = group.create_dataset("Temperature", data=30 + np.arange(len(times)) / 1000)
    warm.attrs["Units"] = np.bytes_("deg C")
    group.create_dataset("Time", data=times.astype(np.uint64)).attrs["Units"] = np.bytes_("microseconds")
    return group


def make_old(path: Path, version: int, values_g: np.ndarray, times: np.ndarray, rate_hz: float) -> Path:
    """A file of versions 2 to 4 with two sensors; labels and numbers are padded with zero bytes."""
    with h5py.File(path, "w") as file:
        file.attrs["FileFormatVersion" if version > 2 else "File_Format_Version"] = version
        file.attrs["CaseIdList"] = np.array([b"SI-000738\0", b"SI-000739\0"], "S16")
        file.attrs["MonitorLabelList"] = np.array([b"Left Wrist\0", b"Trunk"], "S16")
        for sign, serial in ((1, "SI-000738"), (-1, "SI-000739")):
            group = file.create_group(serial)
            group.attrs["SampleRate"] = np.uint16(rate_hz)
            group["Calibrated/Accelerometers"] = sign * values_g * GRAVITY
            group["Calibrated/Gyroscopes"] = np.deg2rad(values_g)
            group["Time"] = times.astype(np.uint64)
    return path
