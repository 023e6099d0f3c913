"""Writes Avro files as an EmbracePlus makes them, by the Avro specification, with struct alone.

The schema has the fields that Empatica's scripts and other people's readers name, and some beside them.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.formats.expected import Expected

START_US = 1_709_510_400_123_456
SERIAL = "3YK3K1521D"
MARKER = bytes(range(100, 116))


def long(value: int) -> bytes:
    """A zigzag varint."""
    left, data = (value << 1) ^ (value >> 63), b""
    while left > 0x7F:
        data, left = data + bytes([left & 0x7F | 0x80]), left >> 7
    return data + bytes([left])


def text(value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return long(len(data)) + data


def array(items: Sequence[bytes], block: int = 0) -> bytes:
    block, data = block or max(1, len(items)), b""
    for number, at in enumerate(range(0, len(items), block)):
        part = items[at : at + block]
        body = b"".join(part)
        data += (long(-len(part)) + long(len(body)) if number % 2 else long(len(part))) + body
    return data + long(0)


def record(name: str, fields: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    return {"type": "record", "name": name, "fields": [{"name": key, "type": kind} for key, kind in fields]}


VERSION = record("Version", [(name, "int") for name in ("major", "minor", "patch")])
RANGES = [("physicalMin", "int"), ("physicalMax", "int"), ("digitalMin", "int"), ("digitalMax", "int")]
INTS = {"type": "array", "items": "int"}
FLOATS = {"type": "array", "items": "float"}


def schema(by_factor: bool) -> dict[str, Any]:
    params = record("ImuParams", [*RANGES, *([("conversionFactor", "double")] if by_factor else [])])
    about = [("timestampStart", "long"), ("samplingFrequency", "float")]
    imu = [("imuParams", params), ("x", INTS), ("y", INTS), ("z", INTS)]
    tag = {"type": "array", "items": "long"}
    return record(
        "empatica.format.avro.Session",
        [
            ("schemaVersion", VERSION),
            ("fwVersion", "empatica.format.avro.Version"),
            ("timezone", "int"),
            ("deviceSn", "string"),
            ("note", ["null", "string"]),
            (
                "rawData",
                record(
                    "RawData",
                    [
                        ("accelerometer", record("Accelerometer", [*about, *imu])),
                        ("gyroscope", record("Gyroscope", [*about, ("imuParams", "ImuParams"), *imu[1:]])),
                        ("eda", record("Eda", [*about, ("values", FLOATS)])),
                        ("temperature", record("Temperature", [*about, ("values", FLOATS)])),
                        ("tags", record("Tags", [("tagsTimeMicros", tag)])),
                    ],
                ),
            ),
        ],
    )


def sensor(
    columns: np.ndarray,
    ranges: tuple[int, int, int, int],
    factor: float | None,
    rate_hz: float = 64.0,
    start_us: int = START_US,
    block: int = 0,
) -> bytes:
    data = long(start_us) + struct.pack("<f", rate_hz) + b"".join(map(long, ranges))
    data += b"" if factor is None else struct.pack("<d", factor)
    return data + b"".join(array([long(int(value)) for value in column], block) for column in columns.T)


def floats(values: Sequence[float], rate_hz: float, start_us: int = START_US) -> bytes:
    return long(start_us) + struct.pack("<f", rate_hz) + array([struct.pack("<f", value) for value in values])


def session(
    accelerometer: bytes,
    gyroscope: bytes,
    *,
    version: tuple[int, int, int] = (6, 5, 0),
    temperature: Sequence[float] = (),
    zone_s: int = 3600,
) -> bytes:
    """The fields of a record in their order."""
    data = b"".join(map(long, version)) + b"".join(map(long, (3, 1, 2))) + long(zone_s) + text(SERIAL)
    data += long(1) + text("a note") + accelerometer + gyroscope
    data += floats([0.5, 0.25], 4.0) + floats(temperature, 1.0)
    return data + array([long(START_US + 5)])


def container(body: bytes, schema_json: Any, codec: str = "deflate", records: int = 1) -> bytes:
    head = {"avro.codec": codec, "avro.schema": json.dumps(schema_json)}
    data = b"Obj\x01" + array([text(key) + text(value) for key, value in head.items()]) + MARKER
    packer = zlib.compressobj(6, zlib.DEFLATED, -15)
    packed = packer.compress(body) + packer.flush() if codec == "deflate" else body
    return data + long(records) + long(len(packed)) + packed + MARKER


NONE = np.empty((0, 3), int)


def written(counts: np.ndarray, lsb_per_g: float, rate_hz: float = 64.0, codec: str = "deflate") -> bytes:
    accelerometer = sensor(counts, (0, 0, 0, 0), 1 / lsb_per_g, rate_hz)
    body = session(accelerometer, sensor(NONE, (0, 0, 0, 0), 1.0))
    return container(body, schema(True), codec)


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    path = folder / "made.avro"
    path.write_bytes(written(counts, lsb_per_g, rate_hz))
    times = START_US + np.arange(len(counts)) * 1_000_000 // round(rate_hz)
    return Expected(path, counts / lsb_per_g, rate_hz, times, serial=SERIAL)
