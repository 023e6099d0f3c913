"""Writes small .cwa files by hand, field by field, without anything of the package's decoding."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
START_US = 1_709_510_400_000_000
"""2024-03-04 00:00:00."""

FULL = {0x30: 120, 0x32: 80, 0x62: 40, 0x92: 26}


def header(device: int = 12345, hardware: int = 0x17, firmware: int = 47, rate_code: int = 0x4A) -> bytes:
    page = bytearray(b"\xff" * 1024)
    struct.pack_into("<2sHBHI", page, 0, b"MD", 1020, hardware, device & 0xFFFF, 777)
    struct.pack_into("<H", page, 11, device >> 16 if device >> 16 else 0xFFFF)
    page[35], page[36], page[41] = 0, rate_code, firmware
    return bytes(page)


def packed_time(time_us: int) -> int:
    t = EPOCH + timedelta(seconds=time_us // 1_000_000)
    date = (t.year - 2000) << 26 | t.month << 22 | t.day << 17
    return date | t.hour << 12 | t.minute << 6 | t.second


def unpacked_time(stamp: int) -> datetime:
    """The second that a sector's stamp means; raises ValueError where there is none."""
    date, time = (
        (2000 + (stamp >> 26), stamp >> 22 & 15, stamp >> 17 & 31),
        (stamp >> 12 & 31, stamp >> 6 & 63),
    )
    return datetime(*date, *time, stamp & 63, tzinfo=UTC)


def with_checksum(page: bytes) -> bytes:
    """The sector with its last two bytes such that all words add up to zero."""
    words = struct.unpack("<255H", page[:510])
    return page[:510] + struct.pack("<H", -sum(words) & 0xFFFF)


@dataclass(frozen=True)
class Sector:
    """One data sector; `anchor` is the sample that was taken at `time_us`."""

    data: bytes
    count: int
    sequence: int
    time_us: int = START_US
    anchor: int = 0
    session: int = 777
    rate_code: int = 0x4A
    axes: int = 0x32
    scale: int = 0
    temperature: int = 270
    light: int = 300
    battery: int = 200
    events: int = 0
    stamp: int | None = None
    fractional: bool = True

    @property
    def rate_hz(self) -> float:
        return 3200 / 2 ** (15 - (self.rate_code & 15))

    def to_bytes(self) -> bytes:
        ticks = self.time_us % 1_000_000 * 32768 // 1_000_000 if self.fractional else 0
        offset = self.anchor - (2 * ticks * int(self.rate_hz) >> 16)
        stamp = packed_time(self.time_us) if self.stamp is None else self.stamp
        word = 0x8000 | ticks if self.fractional else 12345
        fields = (b"AX", 508, word, self.session, self.sequence, stamp, self.scale << 10 | self.light)
        tail = (self.temperature, self.events, self.battery, self.rate_code, self.axes, offset, self.count)
        page = struct.pack("<2sHHIIIHHBBBBhH", *fields, *tail) + self.data.ljust(480, b"\0") + b"\0\0"
        return with_checksum(page)


def sectors(values: np.ndarray, **settings: int) -> list[Sector]:
    """Sectors of 16-bit samples (n, axes), each stamped at its first sample, at the nominal rate."""
    model = replace(Sector(b"", 0, 0), **settings)
    full = FULL[model.axes]
    found = []
    for number, at in enumerate(range(0, len(values), full)):
        rows = np.asarray(values[at : at + full], "<i2")
        time_us = model.time_us + round(at * 1_000_000 / model.rate_hz)
        found.append(replace(model, data=rows.tobytes(), count=len(rows), sequence=number, time_us=time_us))
    return found


def written(path: Path, pages: list[Sector], head: bytes | None = None) -> Path:
    path.write_bytes((header() if head is None else head) + b"".join(page.to_bytes() for page in pages))
    return path


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    """A file of full sectors and a short last one.

    Raises:
        ValueError: the format has no such rate (3200 / 2**k Hz) or scale (2**(8 + A) per g, A up to 7).
    """
    codes = {3200 / 2 ** (15 - code): code for code in range(1, 16)}
    scales = {float(1 << (8 + bits)): bits for bits in range(8)}
    if rate_hz not in codes or float(lsb_per_g) not in scales:
        raise ValueError(f"no .cwa file has {rate_hz} Hz and {lsb_per_g} counts per g")
    code, bits = codes[rate_hz], scales[float(lsb_per_g)]
    pages = sectors(counts, rate_code=0x40 | code, scale=bits << 3)
    path = written(folder / "hand.cwa", pages, header(rate_code=0x40 | code))
    times = START_US + np.array([round(k * 1_000_000 / rate_hz) for k in range(len(counts))], np.int64)
    return Expected(path, counts / lsb_per_g, rate_hz, times, tolerance_us=32, serial="12345")
