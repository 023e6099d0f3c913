"""Writes Matrix files byte by byte from the layout in docs/more-devices.md, with struct alone."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

START_S = 1_709_510_400
ROWS = 300
RANGE_G = 8
FULL = 32_768 // RANGE_G


def header(
    packets: int, *, range_g: int = RANGE_G, range_dps: int = 2000, remarks: bytes = b"left wrist"
) -> bytes:
    return remarks.ljust(512, b"\0") + struct.pack("<4sIHH", b"MDTC", packets, range_g, range_dps)


def sealed(body: bytes) -> bytes:
    return b"MDTCPACK" + struct.pack("<I", zlib.crc32(body)) + body


def triples(rows: np.ndarray) -> bytes:
    return b"".join(struct.pack("<hhh", *(int(value) for value in row)) for row in rows)


def packet(
    start_s: int,
    end_s: int,
    rows: np.ndarray,
    *,
    gyro: np.ndarray | None = None,
    warm: tuple[tuple[int, int], ...] = (),
    heart: tuple[tuple[int, int], ...] = (),
) -> bytes:
    """One packet; temperatures in tenths of a degree, skin and air."""
    body = struct.pack(
        "<6I", start_s, end_s, len(rows), 0 if gyro is None else len(gyro), len(warm), len(heart)
    )
    body += triples(rows) + (b"" if gyro is None else triples(gyro))
    return sealed(body + b"".join(struct.pack("<hh", *pair) for pair in (*warm, *heart)))


def packets(counts: np.ndarray, rate_hz: float = 50.0, rows: int = ROWS) -> list[bytes]:
    """Of so many rows each, which last whole seconds."""
    parts = [counts[at : at + rows] for at in range(0, len(counts), rows)]
    starts = np.cumsum([0, *(round(len(part) / rate_hz) for part in parts)]) + START_S
    return [packet(int(starts[k]), int(starts[k + 1]), part) for k, part in enumerate(parts)]


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    path = folder / "recording.BIN"
    made = packets(counts.astype(np.int64) * round(FULL / lsb_per_g), rate_hz)
    path.write_bytes(header(len(made)) + b"".join(made))
    times = START_S * 1_000_000 + np.rint(np.arange(len(counts)) * 1e6 / rate_hz).astype(np.int64)
    return Expected(path, counts / lsb_per_g, rate_hz, times)
