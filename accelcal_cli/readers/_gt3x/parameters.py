"""Records of log.bin that describe the recording: parameters, metadata.

Sources: github.com/actigraph/GT3X-File-Format, LogRecords/Parameters.md (pairs of key and value,
floats of 24 bits with an exponent of 8) and LogRecords/Metadata.md ("Files Initialized in UTC").
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from accelcal_cli.readers._gt3x.framing import Batch
from accelcal_cli.readers._gt3x.layout import HEADER_BYTES, METADATA, PARAMETERS

Key = tuple[int, int]
"""Address space and number of a parameter."""

IMU_TEMPERATURE_SCALE, IMU_TEMPERATURE_OFFSET = (0, 57), (0, 58)
ACCEL_SCALE = (0, 55)
SAMPLE_RATE = (1, 10)
START_TIME = (1, 12)
SENSOR_CONFIGURATION = (1, 44)

_PAIR = np.dtype([("space", "<u2"), ("number", "<u2"), ("value", "<u4")])


def payload(batch: Batch, number: int) -> bytes:
    """Bytes of a record's payload."""
    start = int(batch.records.start[number]) + HEADER_BYTES
    return batch.page.data[start : start + int(batch.records.size[number])]


def payloads(batch: Batch, kind: int) -> list[bytes]:
    """Payloads of all records of a kind."""
    return [payload(batch, number) for number in np.flatnonzero(batch.records.kind == kind).tolist()]


def parameters_in(batch: Batch) -> dict[Key, int]:
    """Parameters as 32-bit words; the last word of each counts."""
    found: dict[Key, int] = {}
    for data in payloads(batch, PARAMETERS):
        pairs = np.frombuffer(data, _PAIR, len(data) // _PAIR.itemsize).tolist()
        found |= {(space, number): value for space, number, value in pairs}
    return found


def number_of(parameters: Mapping[Key, int], key: Key) -> float | None:
    """A parameter that is a float; None where it is missing or 0."""
    word = parameters.get(key)
    return float_of(word) if word else None


def float_of(word: int) -> float:
    """A float of the Simple Serial Protocol: fraction / 2^23 * 2^exponent, both signed."""
    fraction, exponent = word & 0xFFFFFF, word >> 24
    fraction -= (fraction & 0x800000) << 1
    exponent -= (exponent & 0x80) << 1
    return float(fraction / (1 << 23) * 2.0**exponent)


def in_utc(batch: Batch) -> bool:
    """Whether a metadata record says that the device's clock was set to UTC."""
    return any(_says_utc(data) for data in payloads(batch, METADATA))


def _says_utc(data: bytes) -> bool:
    try:
        said = json.loads(data)
    except (ValueError, RecursionError):
        return False
    return (
        isinstance(said, dict) and said.get("MetadataType") == "LocalTimeLog" and said.get("UsedUtc") is True
    )
