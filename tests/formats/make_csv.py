"""Writes small CSV recordings by hand, and reads back what a reader says."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path

import numpy as np

from accelcal_cli.formats.tables import CSV as FORMAT
from tests.formats.expected import Expected
from tests.formats.reading import Read, read_all

START = datetime(2024, 3, 4, tzinfo=UTC)
START_US = 1_709_510_400_000_000
GRID = 1 << 24


def make(folder: Path, counts: np.ndarray, rate_hz: float, lsb_per_g: float) -> Expected:
    """A CSV in g with ISO times in microseconds. Values are put on the reader's grid, so they are exact."""
    path = folder / "made.csv"
    grid = np.rint(counts / lsb_per_g * GRID) / GRID
    rate = Fraction(rate_hz).limit_denominator(10_000)
    steps = [int(Fraction(row * 1_000_000) / rate + Fraction(1, 2)) for row in range(len(counts))]
    lines = ["time,x [g],y [g],z [g]"]
    for step, row in zip(steps, grid.tolist(), strict=True):
        lines.append(",".join([stamp(step), *map(repr, row)]))
    path.write_text("\n".join(lines) + "\n")
    return Expected(path, grid, rate_hz, START_US + np.array(steps, np.int64), 0)


def stamp(after_us: int) -> str:
    """The start and so many microseconds, as ISO 8601 without a zone."""
    return (START + timedelta(microseconds=after_us)).strftime("%Y-%m-%dT%H:%M:%S.%f")


def written(folder: Path, text: str | bytes, name: str = "a.csv") -> Path:
    """A file of this text."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def read(path: Path, chunk_samples: int = 1000, **options: object) -> Read:
    """All of a recording, with the chunks joined."""
    return read_all(path, FORMAT, chunk_samples, **options)
