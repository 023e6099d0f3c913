"""Writes small .gt3x files by hand from the vendor's format documents, without the package's decoding."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Iterable, Mapping
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

START_S = 1_709_510_400
"""2024-03-04 00:00:00."""

START_US = START_S * 1_000_000
SERIAL = "TAS1D48140206"
OLD_SERIAL = "NEO1C04110003"
ACTIVITY, BATTERY, EVENT, LUX, METADATA = 0, 2, 3, 5, 6
PARAMETERS, SENSOR_SCHEMA, SENSOR_DATA, ACTIVITY2, ACTIVITY3, TEMPERATURE = 21, 24, 25, 26, 27, 30
ASLEEP, AWAKE = b"\x08", b"\x09"


def ticks(second: float) -> int:
    return int((second + 62_135_596_800) * 10_000_000)


def record(kind: int, second: int, payload: bytes) -> bytes:
    body = struct.pack("<BBIH", 0x1E, kind, second, len(payload)) + payload
    return body + bytes([~reduce(xor, body) & 0xFF])


def packed(counts: np.ndarray, order: tuple[int, int, int] = (1, 0, 2)) -> bytes:
    """Three values of 12 bits a sample, most significant bits first, y x z; a last half byte is 0."""
    values = (np.asarray(counts, np.int64) & 0xFFF)[:, order].ravel().tolist()
    digits = ("%03x" * len(values)) % tuple(values)
    return bytes.fromhex(digits + "0" * (len(digits) % 2))


def activity(second: int, counts: np.ndarray, kind: int = ACTIVITY2) -> bytes:
    if kind == ACTIVITY2:
        return record(kind, second, np.asarray(counts, "<i2").tobytes())
    return record(kind, second, packed(counts, (1, 0, 2) if kind == ACTIVITY else (0, 1, 2)))


def seconds(counts: np.ndarray, rate: int, kind: int = ACTIVITY2, start_s: int = START_S) -> list[bytes]:
    parts = (counts[at : at + rate] for at in range(0, len(counts), rate))
    return [activity(start_s + k, part, kind) for k, part in enumerate(parts)]


def event(second: int, payload: bytes) -> bytes:
    return record(EVENT, second, payload)


def battery(second: int, millivolts: int = 4100) -> bytes:
    return record(BATTERY, second, struct.pack("<H", millivolts))


def temperature(second: int, counts: int, processor: int | None = None) -> bytes:
    """Readings of the accelerometer's thermometer and, before it, the processor's."""
    before = b"" if processor is None else struct.pack("<BH", 0, processor)
    return record(TEMPERATURE, second, before + struct.pack("<Bh", 1, counts))


def parameters(pairs: Mapping[tuple[int, int], int], second: int = START_S) -> bytes:
    return record(
        PARAMETERS, second, b"".join(struct.pack("<HHI", *key, value) for key, value in pairs.items())
    )


def encoded(value: float) -> int:
    """A float in the 24-bit fraction and 8-bit exponent of parameters."""
    fraction, exponent = np.frexp(value)
    return (int(fraction * (1 << 23)) & 0xFFFFFF) | (int(exponent) & 0xFF) << 24


def info(rate: int = 50, scale: float = 256.0, **others: object) -> str:
    values = {
        "Serial Number": SERIAL,
        "Device Type": "wGT3XBT",
        "Firmware": "1.9.2",
        "Battery Voltage": "4,18",
        "Sample Rate": rate,
        "Start Date": ticks(START_S),
        "Stop Date": 0,
        "Last Sample Time": ticks(START_S + 24),
        "TimeZone": "00:00:00",
        "Acceleration Scale": scale,
        "Acceleration Min": "-8.0",
        "Acceleration Max": "8.0",
    } | {key.replace("_", " "): value for key, value in others.items()}
    return "".join(f"{key}: {value}\r\n" for key, value in values.items() if value is not None)


def zipped(parts: Mapping[str, bytes | str], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, data in parts.items():
            archive.writestr(zipfile.ZipInfo(name), data, method)
    return buffer.getvalue()


def written(
    path: Path,
    log: Iterable[bytes],
    text: str | None = None,
    method: int = zipfile.ZIP_DEFLATED,
    **beside: object,
) -> Path:
    parts = {"log.bin": b"".join(log), "info.txt": info() if text is None else text}
    more = {f"{name}.json": json.dumps(values) for name, values in beside.items()}
    path.write_bytes(zipped(parts | more, method))
    return path


def old_info(rate: int = 30, **others: object) -> str:
    device = {"Serial_Number": OLD_SERIAL, "Device_Type": "GT3XPlus", "Firmware": "2.5.0"}
    missing = dict.fromkeys(
        ("Acceleration_Scale", "Acceleration_Min", "Acceleration_Max", "Last_Sample_Time")
    )
    return info(rate, **device | missing | others)


def written_old(path: Path, data: bytes, text: str | None = None, method: int = zipfile.ZIP_DEFLATED) -> Path:
    parts = {"activity.bin": data, "lux.bin": b"", "info.txt": old_info() if text is None else text}
    path.write_bytes(zipped(parts, method))
    return path


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    rate = int(rate_hz)
    log = [parameters({(1, 10): rate, (0, 55): encoded(lsb_per_g)})]
    for k, one in enumerate(seconds(counts, rate, ACTIVITY)):
        log += [one, record(LUX, START_S + k, b"\0\0"), battery(START_S + k - 1)][: 1 + k % 3]
    path = written(folder / "recording.gt3x", log, info(rate, lsb_per_g))
    times = START_US + np.array([round(k * 1_000_000 / rate) for k in range(len(counts))])
    return Expected(path, counts / lsb_per_g, rate_hz, times, serial=SERIAL)
