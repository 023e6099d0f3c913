"""Writes ActiGraph recordings of the newer kind: a zip file with log.bin and info.txt.

Sources: the vendor's format documents (github.com/actigraph/GT3X-File-Format): README.md for the records of
log.bin, LogRecords/Activity.md, Activity2.md and Parameters.md, info.txt.md. A record holds one second: 16
bits a value like a GT9X Link, or packed 12 bits like a wGT3X+, by the counts per g. The format has no
temperature with the main sensor's samples: the recording's is left out. Seconds follow each other: a
recording with a break is refused.
"""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from accelcal_cli.core.errors import OutputError
from accelcal_cli.core.formats import Encoder, Sampling
from accelcal_cli.core.recording import Chunk, Counts, Recording
from accelcal_cli.formats import _writing

RATES = range(30, 101, 10)
LEVEL, SEPARATOR, FRACTION_BITS, TICKS_PER_S = 1, 0x1E, 23, 10_000_000
HEADER = struct.Struct("<BBIH")
PARAMETERS, ACTIVITY, ACTIVITY2 = 21, 0, 26
SAMPLE_RATE, START_TIME, ACCEL_SCALE = (1, 10), (1, 12), (0, 55)
YEAR_1_TO_1970_S, LARGEST_S = 62_135_596_800, (1 << 32) - 1


@dataclass(frozen=True, slots=True)
class Model:
    """A device, and how it stores samples (seconds, rate, 3) as bytes (seconds, n)."""

    name: str
    serial: str
    firmware: str
    kind: int
    bits: int
    payload: Callable[[Counts], NDArray[np.uint8]]


def plain(counts: Counts) -> NDArray[np.uint8]:
    """Return samples (seconds, rate, 3) as 16-bit numbers x, y, z."""
    return counts.astype("<i2").reshape(len(counts), -1).view(np.uint8)


def packed(counts: Counts) -> NDArray[np.uint8]:
    """Return samples (seconds, rate, 3) as 12-bit numbers y, x, z, high bits first; `rate` is even."""
    values = counts[:, :, [1, 0, 2]].astype(np.uint16).reshape(len(counts), -1, 2) & 0xFFF
    first, second = values[:, :, 0], values[:, :, 1]
    parts = np.stack((first >> 4, first << 4 | second >> 8, second), axis=2)
    return parts.astype(np.uint8).reshape(len(counts), -1)


MODELS = {
    (256.0, 8.0): Model("Link", "TAS1D", "1.7.2", ACTIVITY2, 16, plain),
    (341.0, 6.0): Model("wGT3XPlus", "CLE2B", "3.2.1", ACTIVITY, 12, packed),
}
"""Devices by counts per g and range."""


def sampling(recording: Recording) -> Sampling:
    """Return the sampling in whole seconds with a rate and scale of an ActiGraph, or raise UsageError."""
    _writing.known_scale(recording, MODELS, "an ActiGraph")
    rate = _writing.known_rate(recording, RATES, "an ActiGraph")
    return Sampling(float(rate), int(rate))


def write(path: Path, recording: Recording, chunks: Iterable[Chunk]) -> None:
    """Write all chunks to `path`; raises OutputError for a gap, a part of a second, or what does not fit."""
    rate, model = sampling(recording).unit_samples, MODELS[recording.lsb_per_g, recording.range_g or 0.0]
    begun_s = int(whole_seconds(path, np.array([_writing.start_us(path, recording)]))[0])
    seconds = 0
    with (
        _writing.new_file(path) as file,
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=LEVEL) as archive,
    ):
        with archive.open("log.bin", "w", force_zip64=True) as log:
            log.write(parameters(begun_s, rate, recording.lsb_per_g))
            for rows in _writing.full_pages(path, chunks, rate):
                log.write(records(path, rows, rate, model).data)
                seconds += len(rows) // rate
        with archive.open("info.txt", "w") as about:
            about.write(info(recording, model, begun_s, begun_s + seconds).encode("ascii"))


def records(path: Path, rows: Chunk, rate: int, model: Model) -> NDArray[np.void]:
    """Return a record of samples for each second, whose counts have to fit."""
    _writing.check_bits(path, rows, model.bits)
    payload = model.payload(rows.counts.reshape(-1, rate, 3))
    fields = [("head", "u1", 2), ("second", "<u4"), ("size", "<u2"), ("payload", "u1", payload.shape[1])]
    table = np.zeros(len(payload), np.dtype([*fields, ("checksum", "u1")]))
    table["head"] = SEPARATOR, model.kind
    table["second"] = whole_seconds(path, rows.time_us[::rate])
    table["size"], table["payload"] = payload.shape[1], payload
    data = table.view(np.uint8).reshape(len(table), -1)
    table["checksum"] = ~np.bitwise_xor.reduce(data[:, :-1], axis=1)
    return table


def whole_seconds(path: Path, time_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the times of first samples as seconds since 1970."""
    seconds, rest_us = np.divmod(time_us, 1_000_000)
    if rest_us.any():
        raise OutputError("samples do not begin with a whole second", path=path, hint=_writing.OTHER_FORMAT)
    if len(seconds) and (seconds.min() < 0 or seconds.max() > LARGEST_S):
        raise OutputError("a time lies before 1970 or after 2106", path=path, hint=_writing.OTHER_FORMAT)
    return seconds


def parameters(second: int, rate: int, lsb_per_g: float) -> bytes:
    """Return the record that begins log.bin: the settings of the device."""
    fraction, exponent = np.frexp(lsb_per_g)  # a 24-bit fraction and an 8-bit exponent
    scale = int(exponent) << 24 | int(fraction * (1 << FRACTION_BITS))
    values = {ACCEL_SCALE: scale, SAMPLE_RATE: rate, START_TIME: second}
    payload = b"".join(struct.pack("<HHI", *key, value) for key, value in values.items())
    record = HEADER.pack(SEPARATOR, PARAMETERS, second, len(payload)) + payload
    return record + bytes([~reduce(xor, record) & 0xFF])


def info(recording: Recording, model: Model, begun_s: int, ended_s: int) -> str:
    """Return the text of info.txt."""
    range_g, offset = recording.range_g, _writing.fixed_offset(recording.timezone)
    values = {
        "Serial Number": f"{model.serial}{_writing.number_of(recording.device):08d}",
        "Device Type": model.name,
        "Firmware": model.firmware,
        "Battery Voltage": "4.10",
        "Sample Rate": f"{recording.rate_hz:g}",
        "Start Date": ticks(begun_s),
        "Stop Date": ticks(ended_s),
        "Last Sample Time": ticks(ended_s),
        "TimeZone": None if offset is None else f"{offset.removeprefix('+')}:00",
        "Download Date": ticks(ended_s),
        "Board Revision": 8,
        "Unexpected Resets": 0,
        "Subject Name": _writing.remark(recording.device),
        "Acceleration Scale": recording.lsb_per_g,
        "Acceleration Min": f"-{range_g}",
        "Acceleration Max": range_g,
    }
    return "".join(f"{key}: {value}\r\n" for key, value in values.items() if value is not None)


def ticks(second: int) -> int:
    """Return seconds since 1970 in units of 100 ns since the year 1."""
    return (second + YEAR_1_TO_1970_S) * TICKS_PER_S


ENCODER = Encoder("gt3x", ".gt3x", write, sampling=sampling)
