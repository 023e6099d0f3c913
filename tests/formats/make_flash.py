"""Writes flash pages byte by byte from the tables of docs/flash-format.md, with struct alone."""

from __future__ import annotations

import struct
import zlib
from fractions import Fraction
from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

START_US = 1_709_510_400_123_456
SERIAL = "WL-00042"


def sealed(body: bytes) -> bytes:
    assert len(body) == 508
    return body + struct.pack("<I", zlib.crc32(body))


def header(
    rate_hz: float = 100.0,
    lsb_per_g: float = 256.0,
    *,
    flags: int = 0,
    zone: int = -32768,
    recording_id: int = 7,
    version: int = 1,
    rate: tuple[int, int] | None = None,
) -> bytes:
    exact = Fraction(rate_hz).limit_denominator(10_000)
    scale = Fraction(str(lsb_per_g))
    body = b"\x89ACL\r\n\x1a\n"
    body += struct.pack("<HHI", version, 512, recording_id)
    body += struct.pack("<II", *(rate or (exact.numerator, exact.denominator)))
    body += struct.pack("<II", scale.numerator, scale.denominator)
    body += struct.pack("<IIhH", 8000, flags, zone, 0)
    for text in (SERIAL, "Wrist Logger", "2.1.0"):
        body += text.encode("ascii").ljust(32, b"\0")
    return sealed(body.ljust(508, b"\0"))


def page(
    sequence: int,
    time_us: int,
    rows: np.ndarray,
    *,
    temperature: int = -32768,
    flags: int = 0,
    recording_id: int = 7,
    samples: int | None = None,
) -> bytes:
    count = len(rows) if samples is None else samples
    body = b"ACLP" + struct.pack("<IIII", recording_id, sequence, *divmod(time_us, 1_000_000))
    body += struct.pack("<hHI", temperature, count, flags)
    body += b"".join(struct.pack("<hhh", *(int(value) for value in row)) for row in rows)
    return sealed(body.ljust(508, b"\xff"))


def stamp(index: int, rate_hz: float) -> int:
    return START_US + round(Fraction(index * 1_000_000) / Fraction(rate_hz).limit_denominator(10_000))


def pages(counts: np.ndarray, rate_hz: float = 100.0) -> list[bytes]:
    starts = range(0, len(counts), 80)
    return [page(k, stamp(at, rate_hz), counts[at : at + 80]) for k, at in enumerate(starts)]


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    path = folder / "recording.bin"
    path.write_bytes(header(rate_hz, lsb_per_g) + b"".join(pages(counts, rate_hz)) + b"\xff" * 1024)
    times = np.array([stamp(index, rate_hz) for index in range(len(counts))])
    return Expected(path, counts / lsb_per_g, rate_hz, times, serial=SERIAL)
