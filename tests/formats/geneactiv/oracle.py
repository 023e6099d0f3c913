"""What a GENEActiv file holds, decoded digit by digit as the vendor's description says."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path

import numpy as np


def signed(text: str) -> int:
    """Twelve bits of two's complement."""
    value = int(text, 16)
    return value - 4096 if value > 2047 else value


def samples(line: str) -> list[tuple[int, int, int]]:
    places = range(0, len(line) // 12 * 12, 12)
    return [
        (signed(line[k : k + 3]), signed(line[k + 3 : k + 6]), signed(line[k + 6 : k + 9])) for k in places
    ]


def raw_values(path: Path) -> np.ndarray:
    """All samples of an undamaged file, (n, 3) int64."""
    rows: list[tuple[int, int, int]] = []
    for page in path.read_text("latin-1").split("Recorded Data")[1:]:
        lines = page.splitlines()
        rows += samples(lines[9]) if len(lines) > 9 else []
    return np.array(rows, np.int64)


def factory(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Gains and offsets of x, y, z."""
    text = path.read_bytes()[:4000].decode("latin-1")
    found = [
        [int(re.search(f"{axis} {what}:(-?\\d+)", text)[1]) for axis in "xyz"] for what in ("gain", "offset")
    ]
    return np.array(found[0]), np.array(found[1])


def exact_g(raw: int, gain: int, offset: int) -> Fraction:
    """g = (raw * 100 - offset) / gain."""
    return Fraction(raw * 100 - offset, gain)


def page_times(path: Path) -> list[float]:
    """Seconds since 1970 of all page times."""
    found = re.findall(r"Page Time:(.*):(\d{3})", path.read_text("latin-1"))
    moments = [datetime.strptime(text, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC) for text, _ in found]
    return [moment.timestamp() + int(milli) / 1000 for moment, (_, milli) in zip(moments, found, strict=True)]
