"""Writes a raw dump, an unbroken stream of frames, and the layout file that describes it.

A frame is x, y, z (int16, or int32 if the range needs it), then the temperature as int16 of 1/128 C and the
gyroscope as three int16, if the recording has them. A stream of frames cannot hold a gap: a recording with a
break is refused.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.formats import Companion, Encoder
from accelcal_cli.core.recording import Chunk, Recording
from accelcal_cli.formats._writing import new_file

SUFFIX = ".raw"
LAYOUT_SUFFIX = ".layout.toml"
DEGREES_PER_UNIT, USUAL_RANGE_G = 1 / 128, 16.0
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
OTHER_FORMAT = "choose another format, such as flash"


def frame_type(recording: Recording) -> np.dtype[np.void]:
    """Return the numpy record of a frame."""
    largest = recording.lsb_per_g * (recording.range_g or USUAL_RANGE_G)
    number = "<i2" if largest <= 1 << 15 else "<i4"
    fields = [(axis, number) for axis in "xyz"]
    if recording.has_temperature:
        fields.append(("temperature", "<i2"))
    if recording.gyro_dps_per_lsb is not None:
        fields += [(f"g{axis}", "<i2") for axis in "xyz"]
    return np.dtype(fields)


def write(path: Path, recording: Recording, chunks: Iterable[Chunk]) -> None:
    """Write all chunks to `path`; raises OutputError for a gap, or a value that does not fit."""
    record = frame_type(recording)
    with new_file(path) as file:
        for chunk in chunks:
            if len(chunk.breaks):
                raise OutputError("the recording has a gap", path=path, hint=OTHER_FORMAT)
            file.write(frames(path, chunk, record).data)


def frames(path: Path, chunk: Chunk, record: np.dtype[np.void]) -> NDArray[np.void]:
    """Return the chunk's rows as frames, (n,)."""
    table = np.zeros(len(chunk), record)
    for number, axis in enumerate("xyz"):
        table[axis] = fitting(path, chunk.counts[:, number], record[axis])
        if f"g{axis}" in (record.names or ()) and chunk.gyro_counts is not None:
            table[f"g{axis}"] = fitting(path, chunk.gyro_counts[:, number], record[f"g{axis}"])
    if "temperature" in (record.names or ()) and chunk.temperature_mc is not None:
        temperature = np.rint(chunk.temperature_mc / (1000 * DEGREES_PER_UNIT))
        table["temperature"] = fitting(path, temperature, record["temperature"])
    return table


def fitting(path: Path, values: NDArray[Any], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the values if all fit the frame's number type, else raise OutputError."""
    limits = np.iinfo(kind.name)
    if len(values) and (values.min() < limits.min or values.max() > limits.max):
        raise OutputError("a value does not fit its field in the frame", path=path, hint=OTHER_FORMAT)
    return values


def layout_text(recording: Recording) -> str:
    """Return the content of the layout file."""
    device, start = recording.device, None
    if recording.start_us is not None:
        moment = EPOCH + timedelta(microseconds=recording.start_us)
        start = (moment if recording.timezone == "UTC" else moment.replace(tzinfo=None)).isoformat()
    known = {
        **{"rate_hz": recording.rate_hz, "lsb_per_g": recording.lsb_per_g, "range_g": recording.range_g},
        **{"start_time": start, "serial": device.serial, "model": device.model, "firmware": device.firmware},
    }
    lines = ["[dump]", *(f"{key} = {toml(value)}" for key, value in known.items() if value is not None)]
    lines += ["", "[fields]"]
    scales = {"temperature": DEGREES_PER_UNIT}
    if recording.gyro_dps_per_lsb is not None:
        scales |= dict(zip(("gx", "gy", "gz"), recording.gyro_dps_per_lsb, strict=True))
    record, offset = frame_type(recording), 0
    for name in record.names or ():
        scale = f", per_unit = {toml(scales[name])}" if name in scales else ""
        lines.append(f'{name} = {{ offset = {offset}, type = "{record[name].name}"{scale} }}')
        offset += record[name].itemsize
    return "\n".join([*lines, ""])


def toml(value: float | str) -> str:
    """Return a TOML value; JSON text and TOML text in quotes are written alike."""
    return json.dumps(value) if isinstance(value, str) else repr(float(value))


ENCODER = Encoder("raw", SUFFIX, write, Companion(LAYOUT_SUFFIX, layout_text), gyroscope=True)
