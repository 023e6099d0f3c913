"""Writes sound files as omconvert does, from its description of them, with struct alone."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

START = "2018-03-18 17:24:47.536"
START_US = 1_521_393_887_536_000
SERIAL = "37727"
SCALE = 8
FULL = 32_768 // SCALE
AXES = ("Accel-X", "Accel-Y", "Accel-Z")
SUBTYPE = bytes.fromhex("0100000000001000800000aa00389b71")


def text_chunk(name: bytes, text: str) -> bytes:
    data = text.encode("latin-1") + b"\0"
    return chunk(name, data + b"\0" * (len(data) % 2))


def chunk(name: bytes, data: bytes) -> bytes:
    return name + struct.pack("<I", len(data)) + data


def comment(labels: tuple[str, ...] = AXES, scales: tuple[object, ...] = (SCALE,) * 3) -> str:
    pairs = zip(labels, scales, strict=True)
    lines = [f"Channel-{k}: {label}\nScale-{k}: {scale}\n" for k, (label, scale) in enumerate(pairs, 1)]
    return f"Time: {START}\n" + "".join(lines)


def form(channels: int, rate_hz: int, bits: int = 16, tag: int = 0xFFFE) -> bytes:
    frame = channels * bits // 8
    data = struct.pack("<HHIIHHH", tag, channels, rate_hz, rate_hz * frame, frame, bits, 22)
    return chunk(b"fmt ", data + struct.pack("<HI", bits, 0) + SUBTYPE)


def header(
    data_bytes: int,
    *,
    channels: int = 4,
    rate_hz: int = 100,
    said: str | None = None,
    fmt: bytes | None = None,
    date: str = START,
) -> bytes:
    """The 1024 bytes before the samples."""
    info = b"INFO" + text_chunk(b"INAM", "Session: 6\nConfig-A: 100,8\n")
    info += text_chunk(b"IART", f"Id: {SERIAL}\nDevice: CWA\nRevision: 17\nFirmware: 44\n")
    info += text_chunk(b"ICMT", comment() if said is None else said) + text_chunk(b"ICRD", date)
    body = b"WAVE" + (form(channels, rate_hz) if fmt is None else fmt) + chunk(b"LIST", info)
    body += chunk(b"JUNK", bytes(1024 - 8 - len(body) - 16))
    return b"RIFF" + struct.pack("<I", 1016 + data_bytes) + body + b"data" + struct.pack("<I", data_bytes)


def samples(values: np.ndarray, aux: np.ndarray | None = None) -> bytes:
    last = np.zeros(len(values), np.int64) if aux is None else aux
    rows = np.hstack([values, last[:, None]]).tolist()
    return b"".join(struct.pack(f"<{len(row) - 1}hH", *row) for row in rows)


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    path = folder / "recording.wav"
    data = samples(counts.astype(np.int64) * round(FULL / lsb_per_g))
    path.write_bytes(header(len(data), rate_hz=round(rate_hz)) + data)
    times = START_US + np.rint(np.arange(len(counts)) * 1e6 / rate_hz).astype(np.int64)
    return Expected(path, counts / lsb_per_g, rate_hz, times, serial=SERIAL)
