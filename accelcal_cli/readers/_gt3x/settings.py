"""Scale, range and rate of a sensor: from info.txt, else from the parameters, else by the model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from accelcal_cli.core.errors import UnreadableError, UsageError
from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.readers._gt3x.beginning import Beginning
from accelcal_cli.readers._gt3x.imu import ACCELEROMETER, GYROSCOPE, TEMPERATURE, Imu
from accelcal_cli.readers._gt3x.info import Info
from accelcal_cli.readers._gt3x.parameters import (
    ACCEL_SCALE,
    IMU_TEMPERATURE_OFFSET,
    SAMPLE_RATE,
    SENSOR_CONFIGURATION,
    number_of,
)
from accelcal_cli.readers._gt3x.primary import Primary
from accelcal_cli.readers._gt3x.sensor import Sensor

LEAST_SCALE = 10.0
"""Recordings whose info.txt says "Acceleration Scale: 1" hold counts of a scale that is told elsewhere."""

IMU_ZERO_C = 21.0
WARMEST_C = 1000.0
IMU_FULL_SCALE = 32_768
COPY_AGAIN = "copy it again from the device"
NO_IMU = "no second sensor (IMU) recorded in it"
TURNED = "firmware 1.6.0 of this device exchanged two axes; this was undone (x = y, y = -x of the file)"
HAS_IMU = "the second sensor (IMU) recorded too: --sensor imu reads it, with gyroscope and temperature"


@dataclass(frozen=True, slots=True)
class Scale:
    """Counts in one g, and the range in g, None where unknown."""

    lsb_per_g: float
    range_g: float | None


SIX_G, EIGHT_G = Scale(341.0, 6.0), Scale(256.0, 8.0)
"""Of the models (LogRecords/Activity.md; info.txt of a device of each)."""

BY_SERIAL = {"NEO": SIX_G, "CLE": SIX_G, "MRA": SIX_G, "MOS": EIGHT_G, "TAS": EIGHT_G}


@dataclass(frozen=True, slots=True)
class Known:
    """A sensor that is understood.

    Attributes:
        gyro_dps_per_lsb: degrees per second in one count of each axis, None without a gyroscope.
    """

    sensor: Sensor
    scale: Scale
    notes: tuple[str, ...] = ()
    has_temperature: bool = False
    gyro_dps_per_lsb: tuple[float, float, float] | None = None


def primary_of(info: Info, beginning: Beginning, options: ReadOptions, path: Path) -> Known:
    """The main accelerometer.

    Raises:
        UnreadableError: it recorded nothing, or nothing says its scale.
    """
    if beginning.rate is None:
        hint = "--sensor imu reads the second sensor" if beginning.imu else COPY_AGAIN
        raise UnreadableError("holds no acceleration in log.bin", path=path, hint=hint)
    told = number_of(beginning.parameters, ACCEL_SCALE)
    scale = scale_of(info, told, options, path)
    turned = (info.device.serial or "").startswith("MOS") and info.device.firmware == "1.6.0"
    notes = [TURNED] if turned else []
    notes += [HAS_IMU] if beginning.imu or beginning.parameters.get(SENSOR_CONFIGURATION) else []
    named = info.rate_hz or beginning.parameters.get(SAMPLE_RATE)
    if named not in (None, beginning.rate):
        notes.append(f"the header says {named} Hz, the records hold {beginning.rate} samples a second")
    return Known(Primary(beginning.rate, turned), scale, tuple(notes))


def scale_of(info: Info, parameter: float | None, options: ReadOptions, path: Path) -> Scale:
    """The main accelerometer's scale.

    Raises:
        UnreadableError: nothing says it.
    """
    told = [value for value in (info.scale, parameter) if value is not None and value >= LEAST_SCALE]
    model = BY_SERIAL.get((info.device.serial or "")[:3]) if info.scale is None else None
    known = told[0] if told else model.lsb_per_g if model else options.lsb_per_g
    if known is None:
        raise UnreadableError(
            "does not say how many counts are one g", path=path, hint="give --lsb-per-g, such as 256 or 341"
        )
    usual = {scale.lsb_per_g: scale.range_g for scale in (SIX_G, EIGHT_G)}
    return Scale(options.lsb_per_g or known, info.range_g or usual.get(known))


def imu_of(beginning: Beginning, options: ReadOptions, path: Path) -> Known:
    """The second sensor of a device that has one; its 16 bits are its range.

    Raises:
        UsageError: it recorded nothing.
    """
    if beginning.schema is None or not beginning.imu:
        raise UsageError(NO_IMU, path=path, hint="leave --sensor out")
    told_c = number_of(beginning.parameters, IMU_TEMPERATURE_OFFSET)
    zero_c = told_c if told_c is not None and abs(told_c) <= WARMEST_C else IMU_ZERO_C
    schema = beginning.schema
    per_g = schema.axes(ACCELEROMETER)[0].scale
    turns = [1 / column.scale for column in schema.axes(GYROSCOPE)]
    return Known(
        Imu(schema, zero_c),
        Scale(options.lsb_per_g or per_g, IMU_FULL_SCALE / per_g),
        has_temperature=TEMPERATURE in schema.columns,
        gyro_dps_per_lsb=(turns[0], turns[1], turns[2]) if turns else None,
    )


def old_scale(info: Info) -> Scale:
    """Of the older kind; all devices of it are of one model."""
    if info.scale is None or info.scale < LEAST_SCALE:
        return SIX_G
    return Scale(info.scale, info.range_g)
