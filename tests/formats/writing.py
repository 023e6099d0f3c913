"""Recordings to write, and what a reader finds in the files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from accelcal_cli.core.clock import UniformClock, rate_fraction
from accelcal_cli.core.formats import Encoder, ReadOptions
from accelcal_cli.core.recording import Chunk, Device, Recording
from accelcal_cli.formats import open_recording

START_US = 1_709_510_400_000_000
"""2024-03-04 00:00:00."""


def counts(rows: int, seed: int = 5) -> np.ndarray:
    values = np.random.default_rng(seed).integers(-2048, 2048, (rows, 3)).astype(np.int16)
    values[:2] = [[-2048, 2047, -1], [2047, -2048, 0]]
    return values


def recording(**changes: Any) -> Recording:
    usual: dict[str, Any] = {
        "rate_hz": 50.0,
        "lsb_per_g": 256.0,
        "range_g": 8.0,
        "start_us": START_US,
        "device": Device("simulated", "SIM00042"),
    }
    return Recording(Path("x"), "simulated", total_bytes=0, **(usual | changes))


def chunks(
    values: np.ndarray, what: Recording, size: int = 1_000, heat: np.ndarray | None = None
) -> Iterator[Chunk]:
    rate = rate_fraction(what.rate_hz)
    for start in range(0, len(values), size):
        part = slice(start, start + size)
        clock = UniformClock(what.start_us or 0, start, rate)
        yield Chunk(start, values[part], clock, 0, temperature_mc=None if heat is None else heat[part])


def times(rows: int, what: Recording) -> np.ndarray:
    rate = rate_fraction(what.rate_hz)
    step = rate.denominator / rate.numerator
    return (what.start_us or 0) + np.array([round(k * step * 1e6) for k in range(rows)])


@dataclass(frozen=True)
class ReadBack:
    """All of a file by the package's reader."""

    recording: Recording
    counts: np.ndarray
    times: np.ndarray
    temperature_mc: np.ndarray | None
    breaks: list[int]
    problems: list[str]


def read_back(path: Path) -> ReadBack:
    with open_recording(path, ReadOptions()) as reader:
        found = list(reader.chunks(7_000))
        heat = [chunk.temperature_mc for chunk in found if chunk.temperature_mc is not None]
        return ReadBack(
            reader.recording,
            np.concatenate([chunk.counts for chunk in found]),
            np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in found]),
            np.concatenate(heat) if heat else None,
            [chunk.first_sample + row for chunk in found for row in chunk.breaks.tolist()],
            [problem.code for chunk in found for problem in chunk.problems],
        )


def written(folder: Path, encoder: Encoder, what: Recording, values: np.ndarray, **how: Any) -> Path:
    path = folder / f"out{encoder.suffix}"
    encoder.write(path, what, chunks(values, what, **how))
    return path
