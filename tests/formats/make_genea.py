"""Writes GENEA files slot by slot from the layout in docs/more-devices.md, with plain integers."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from tests.formats.expected import Expected

START_S = 1_269_950_917
SERIAL = "01275"
UNIT = 8192 * 340


def header(
    rate: str = "80Hz", gains: str = "10880 10880 10880", offsets: str = "0 0 0", lines: tuple[str, ...] = ()
) -> bytes:
    text = (
        "GENEA/1.00",
        f"Serial-Number:{SERIAL}",
        "Firmware-Version:c7931 /trunk 601",
        "Study-Centre:",
        "Trial-Start:2010-03-30 12:08:36",
        f"Accel-Offsets:{offsets}",
        f"Accel-Gains:{gains}",
        "Battery-Voltage:4.0",
        f"Sample-Rate:{rate}",
        *lines,
        "Upload:Finished  ",
    )
    return ("\r\n".join(text) + "\r\n\r\n").encode("latin-1")


@lru_cache(1 << 16)
def crc8(data: bytes) -> int:
    state = 0
    for byte in data:
        state ^= byte
        for _ in range(8):
            state = (state << 1 ^ (0x85 if state & 0x80 else 0)) & 0xFF
    return state


def slot(body: bytes) -> bytes:
    assert len(body) == 5
    return bytes([crc8(body)]) + body


def sample(row: np.ndarray) -> bytes:
    """A row of x, y, z whose first and last value are stored with the sign changed."""
    x, y, z = (int(value) & 0xFFF for value in (-row[0], row[1], -row[2]))
    return slot((x << 24 | y << 12 | z).to_bytes(5, "big"))


def time(seconds: int) -> bytes:
    return slot(b"\x20" + seconds.to_bytes(4, "big"))


def battery() -> bytes:
    return slot(bytes([0x40, 113, 10, 30, 207]))


def slots(counts: np.ndarray, rate_hz: int, ahead: int = 0) -> list[bytes]:
    """Samples, a time before each second of them and now and then a voltage; `ahead` of the first time."""
    made = [sample(row) for row in counts[:ahead]]
    for second, at in enumerate(range(ahead, len(counts), rate_hz)):
        made += [time(START_S + second), *([battery()] if second % 3 == 2 else [])]
        made += [sample(row) for row in counts[at : at + rate_hz]]
    return made


def pages(made: list[bytes], fill: bytes = b"\0") -> bytes:
    """Pages of 341 slots, the last one filled up."""
    parts = [b"".join(made[at : at + 341]) for at in range(0, len(made), 341)]
    whole = [part.ljust(2046, fill) + b"\0\0" for part in parts]
    return b"".join(whole)


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    path = folder / "recording.bin"
    gain = round(UNIT / lsb_per_g)
    body = pages(slots(counts, round(rate_hz)))
    path.write_bytes(header(f"{rate_hz:g}Hz", f"{gain} {gain} {gain}") + body)
    times = START_S * 1_000_000 + np.rint(np.arange(len(counts)) * 1e6 / rate_hz).astype(np.int64)
    return Expected(path, counts / lsb_per_g, rate_hz, times, serial=SERIAL)
