"""Writes a raw dump frame by frame with struct, and its layout as text."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

START_US = 1_709_510_400_000_000
SERIAL = "012345"


def frames(counts: np.ndarray) -> bytes:
    return b"".join(struct.pack("<hhh", *(int(value) for value in row)) for row in counts)


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    path = folder / "dump.raw"
    path.write_bytes(b"HEADER" + frames(counts))
    (folder / "dump.layout.toml").write_text(
        f"""[dump]
rate_hz = {rate_hz!r}
lsb_per_g = {lsb_per_g!r}
range_g = 8.0
start_time = "2024-03-04T00:00:00"
serial = "{SERIAL}"
header_bytes = 6
[fields]
x = {{ offset = 0, type = "int16" }}
y = {{ offset = 2, type = "int16" }}
z = {{ offset = 4, type = "int16" }}
"""
    )
    step = Fraction(1_000_000) / Fraction(rate_hz).limit_denominator(10_000)
    times = np.array([START_US + round(index * step) for index in range(len(counts))])
    return Expected(path, counts / lsb_per_g, rate_hz, times, serial=SERIAL)
