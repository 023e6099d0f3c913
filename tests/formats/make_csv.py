"""Writes small CSV recordings by hand, and reads back what a reader says."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path

import numpy as np

from accelcal_cli.core.formats import ReadOptions
from accelcal_cli.core.recording import Problem, Recording
from accelcal_cli.formats.tables import CSV as FORMAT
from tests.formats.expected import Expected

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


@dataclass(frozen=True)
class Read:
    """Everything that a recording gives."""

    recording: Recording
    counts: np.ndarray
    times: np.ndarray
    breaks: list[int]
    problems: list[Problem]
    temperature: np.ndarray | None
    validity: np.ndarray

    @property
    def g(self) -> np.ndarray:
        return self.counts / self.recording.lsb_per_g

    @property
    def codes(self) -> list[str]:
        return [problem.code for problem in self.problems]

    def same_as(self, other: Read) -> bool:
        return (
            np.array_equal(self.counts, other.counts)
            and np.array_equal(self.times, other.times)
            and self.breaks == other.breaks
            and self.problems == other.problems
            and np.array_equal(self.validity, other.validity)
        )


def read(path: Path, chunk_samples: int = 1000, **options: object) -> Read:
    """All of a recording, with the chunks joined."""
    with FORMAT.open(path, ReadOptions(**options)) as reader:  # type: ignore[arg-type]
        chunks = list(reader.chunks(chunk_samples))
        firsts = [chunk.first_sample for chunk in chunks]
        sizes = [len(chunk) for chunk in chunks]
        assert firsts == [sum(sizes[:place]) for place in range(len(sizes))]
        assert max(sizes) <= chunk_samples
        spare = [chunk.temperature_mc for chunk in chunks]
        marks = [np.zeros(len(c), np.uint8) if c.validity is None else c.validity for c in chunks]
        return Read(
            reader.recording,
            np.concatenate([chunk.counts for chunk in chunks]),
            np.concatenate([chunk.clock.times(0, len(chunk)) for chunk in chunks]),
            [chunk.first_sample + int(row) for chunk in chunks for row in chunk.breaks],
            [problem for chunk in chunks for problem in chunk.problems],
            np.concatenate(spare) if reader.recording.has_temperature else None,
            np.concatenate(marks),
        )
